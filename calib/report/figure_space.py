"""Errors in space: the measured points, and the uncertainty over the workspace."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import calib.report.figure_base as base
from calib.result.calibration import CalibrationValues
from calib.robot.ranges import spread_poses
from calib.units import Array

#: The two axes of each view, and what it is called.
VIEWS = ((0, 1, "from above"), (0, 2, "from the front"), (1, 2, "from the side"))

#: The height of the upper views [in] at least, and of all at most.
_LEAST, _HIGHEST = 2.2, 5.8

#: Joint values over which the uncertainty is drawn, and cells across a view.
POSES, _CELLS = 4000, 22


def measured_places(c: CalibrationValues) -> Array:
    """Where the target was, in the base, shape (N, 3), [m]; predicted by the calibrated robot where nothing tells."""
    m = c.measurements
    T_frame_base, T_tip_target = base.placed(c.setup, m)
    places = base.measured_in_base(m, T_frame_base)
    predicted = c.robot.poses(m.joints_for(c.nominal.joint_names)) @ T_tip_target
    return np.where(np.isfinite(places), places, predicted[:, :3, 3])


def points(c: CalibrationValues) -> Figure:
    """The measured points in the base frame: in space, and from three sides; as the paper's figure 7."""
    places, kinds = 1e3 * measured_places(c), base.row_kinds(c)
    limits = limits_of(places)
    x, y, z = limits[1] - limits[0]
    scale = min(0.85 * base.WIDTH / (x + max(y, 0.7 * x)), _HIGHEST / (y + z))
    upper = max(scale * y, _LEAST)
    figure = base.new_figure(upper + scale * z + 1.4)
    panels: dict[str, Any] = figure.subplot_mosaic(
        [["from above", "space"], ["from the front", "from the side"]],
        width_ratios=[x, max(y, 0.7 * x)],
        height_ratios=[upper, scale * z],
        per_subplot_kw={"space": {"projection": "3d"}},
    )
    numbered = c.measurements.validation | base.flagged_rows(c)
    pixels = len(places) > base.MOST_SHAPES
    for i, j, name in VIEWS:
        ax = panels[name]
        ax.set_title(f"Seen {name}")
        for order, kind in enumerate(kinds, start=2):
            at = places[kind.mask][:, [i, j]].T
            ax.plot(*at, rasterized=pixels, zorder=order, **kind.style(0.85))
        flat(ax, limits, (i, j))
        base.number_points(ax, c.measurements.rows, places[:, [i, j]], numbered)
    ax = panels["space"]
    for kind in kinds:
        ax.plot(*places[kind.mask].T, rasterized=pixels, **kind.style())
    ax.set_box_aspect(limits[1] - limits[0], zoom=0.85)
    ax.set(xlim=limits[:, 0], ylim=limits[:, 1], zlim=limits[:, 2], title="In space, base frame")
    ax.title.set_y(1.0)  # axes in space put it lower, into the picture
    for letter, axis in zip("xyz", (ax.xaxis, ax.yaxis, ax.zaxis), strict=True):
        axis.set_label_text(f"{letter} [mm]")
        axis.labelpad = 1.5
        axis.set_major_locator(base.few_ticks(4))
    ax.tick_params(labelsize=7.5, pad=1)
    ax.view_init(elev=20, azim=-62)
    base.legend_above(figure)
    return figure


def uncertainty(c: CalibrationValues) -> Figure:
    """The standard deviation of predicted positions: three views, and how often which size occurs."""
    q = spread_poses(c.nominal, POSES)
    T = c.robot.poses(q)
    places, std = (
        1e3 * (T[:, :3, :3] @ c.target + T[:, :3, 3]),
        1e3 * c.position_std(q, non_geometric=False),
    )
    limits = limits_of(places)
    measured = 1e3 * measured_places(c)
    measured = measured[:: 1 + len(measured) // 150]
    ring: dict[str, Any] = {"ls": "none", "marker": "o", "ms": 3.0, "mfc": "white", "mew": 0.6}
    figure = base.new_figure(6.2)
    *views, last = figure.subplots(2, 2).ravel()
    images = []
    for ax, (i, j, name) in zip(views, VIEWS, strict=True):
        images.append(_cells(ax, places[:, [i, j]], std, limits[:, [i, j]]))
        ax.plot(*measured[:, [i, j]].T, mec=base.INK, label="measured rows", **ring)
        ax.set_title(f"Seen {name}")
        flat(ax, limits, (i, j))
    every = np.concatenate([np.asarray(image.get_array()) for image in images])
    low, high = float(every.min()), float(np.quantile(every, 0.98))
    for image in images:  # one scale of colours; one cell must not make all others alike
        image.set_clim(low, max(high, 1.01 * low + 1e-9))
    bar = figure.colorbar(images[1], ax=views[1], shrink=0.95, pad=0.02, extend="max")
    bar.set_label("standard deviation [mm]")
    _how_often(last, std, c)
    base.legend_above(figure)
    return figure


def flat(ax: Axes, limits: Array, pair: tuple[int, int]) -> None:
    """Equal scales, labels, and the base where it lies inside."""
    (i, j), at = pair, limits[:, pair]
    ax.set(aspect="equal", xlim=at[:, 0], ylim=at[:, 1])
    ax.set(xlabel=f"{'xyz'[i]} [mm]", ylabel=f"{'xyz'[j]} [mm]")
    ax.xaxis.set_major_locator(base.few_ticks(4))
    ax.yaxis.set_major_locator(base.few_ticks(4))
    if np.all(at[0] <= 0.0) and np.all(at[1] >= 0.0):
        ax.plot(0.0, 0.0, "+", ms=8, mew=1.4, color=base.SOFT, zorder=4, label="base")


def limits_of(places: Array) -> Array:
    """What the views show, shape (2, 3), [mm]: the points, and the base if it is near; no view is a line."""
    low, high = places.min(axis=0), places.max(axis=0)
    size = max(float(np.max(high - low)), 50.0)
    if np.all((low < size) & (high > -size)):
        low, high = np.minimum(low, 0.0), np.maximum(high, 0.0)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    half = np.maximum(1.1 * half, 0.3 * max(float(half.max()), 25.0))
    return np.array([middle - half, middle + half])


def _cells(ax: Axes, places: Array, std: Array, limits: Array) -> Any:  # noqa: ANN401  a collection of matplotlib
    """The root mean square of the standard deviations of the poses in each hexagon of a view."""
    share = _CELLS * (limits[1] - limits[0]) / np.max(limits[1] - limits[0])
    return ax.hexbin(
        places[:, 0],
        places[:, 1],
        C=std**2,
        reduce_C_function=lambda squares: float(np.sqrt(np.mean(squares))),
        gridsize=(max(int(share[0]), 4), max(int(share[1] / np.sqrt(3.0)), 3)),
        extent=limits.T.ravel().tolist(),
        cmap="cividis",
        linewidths=0.15,
        edgecolors="face",
        zorder=2,
    )


def _how_often(ax: Axes, std: Array, c: CalibrationValues) -> None:
    """The share of poses below each standard deviation, with the rms at the measured poses and over the limits."""
    ax.ecdf(std, color=base.INK, lw=1.4)
    for value, style, word in (
        (1e3 * c.expected_measured, ":", "rms, measured poses"),
        # Not of the poses drawn, which are more: the report has one number for one thing.
        (1e3 * c.expected_everywhere, "--", "rms, joint limits"),
        (float(np.quantile(std, 0.95)), "-.", "95 % of the joint limits"),
    ):
        ax.vlines(value, 0, 1, colors=base.SOFT, ls=style, lw=1.1, label=f"{value:.3f} mm: {word}")
    ax.set_xlim(0.0, 1.08 * max(float(np.quantile(std, 0.99)), 1e3 * c.expected_measured, 1e-9))
    ax.set_ylim(0.0, 1.45)  # room for the legend above the curve
    ax.set_yticks(np.linspace(0.0, 1.0, 6), [f"{share}" for share in range(0, 101, 20)])
    ax.set(xlabel="standard deviation [mm]", ylabel="poses below [%]")
    ax.set_title("How often, over the joint limits")
    ax.legend(loc="upper left", fontsize=7.5)
