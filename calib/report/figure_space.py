"""Errors in space: the measured points, and the uncertainty over the workspace."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

import calib.report.figure_base as base
import calib.report.label_rows as labels
from calib.result.calibration import Calibration
from calib.result.uncertainty import workspace_uncertainty
from calib.robot.readback import SPREAD

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: The two axes of each view, and what it is called.
VIEWS = ((0, 1, "from above"), (0, 2, "from the front"), (1, 2, "from the side"))

#: The height of the upper views [in] at least, and of all at most.
_LEAST, _HIGHEST = 2.2, 5.8

#: More rows than this stand on no lines down to the floor, and more are not drawn over the uncertainty.
_MOST_STILTS, _MOST_RINGS = 100, 150

#: Joint values over which the uncertainty is drawn, and cells across a view.
POSES, _CELLS = 4000, 22


def measured_places(c: Calibration) -> Array:
    """Where the target was, in the base, shape (N, 3), [m]; predicted by the calibrated robot where nothing tells."""
    m = c.measurements
    T_frame_base, T_tip_target = labels.placed(c.setup, m)
    places = labels.measured_in_base(m, T_frame_base)
    predicted = labels.target_places(c, m.joints_for(c.nominal.joint_names), T_tip_target)
    return np.where(np.isfinite(places), places, predicted)


@base.figure(
    "points",
    "errors",
    "Points of the target",
    "Where the target was at the {rows}, in the base frame, [mm]: in space, and seen from three sides. Rows that "
    "measure no position are where the calibrated robot predicts them.",
    base.always,
)
def points(c: Calibration) -> Figure:
    """The measured points in the base frame: in space, and from three sides; as the paper's figure 7."""
    places, kinds = 1e3 * measured_places(c), base.row_kinds(c)
    limits = _limits(places)
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
    _space(panels["space"], places, kinds, limits)
    numbered = c.measurements.validation | labels.flagged_rows(c)
    pixels = len(places) > base.MOST_SHAPES
    for i, j, name in VIEWS:
        ax = panels[name]
        ax.set_title(f"Seen {name}")
        for order, kind in enumerate(kinds, start=2):
            at = places[kind.mask][:, [i, j]].T
            ax.plot(*at, rasterized=pixels, zorder=order, **kind.style(0.85))
        _flat(ax, limits, (i, j))
        base.number_points(ax, c.measurements.rows, places[:, [i, j]], numbered)
    handles = [kind.handle() for kind in kinds]
    if _holds_base(limits):
        handles.append(base.line("base", ls="none", marker="+", ms=9, mew=1.4, color=labels.SOFT))
    base.legend_above(figure, handles)
    return figure


@base.figure(
    "workspace-uncertainty",
    "unknown",
    "Uncertainty over the workspace",
    "Standard deviation of the predicted position of the corrected URDF over "
    f"{POSES:,} poses spread over the joint limits, from the covariance of the parameters, [mm]: root mean square of "
    "the poses in each cell, in the base frame seen from three sides. The rms over the joint limits is that of the "
    f"first {SPREAD} of these poses. It knows nothing of errors that the model lacks.",
    base.always,
)
def uncertainty(c: Calibration) -> Figure:
    """The standard deviation of predicted positions: three views, and how often which size occurs."""
    found = workspace_uncertainty(c, POSES, larger=False)
    T = c.robot.poses(found.q)
    places, std = 1e3 * (T[:, :3, :3] @ c.target + T[:, :3, 3]), 1e3 * found.std
    limits = _limits(places)
    measured = 1e3 * measured_places(c)
    measured = measured[:: max(-(-len(measured) // _MOST_RINGS), 1)]
    ring: dict[str, Any] = {"ls": "none", "marker": "o", "ms": 3.0, "mfc": "white", "mew": 0.6}
    ring["mec"] = labels.INK
    figure = base.new_figure(6.2)
    *views, last = figure.subplots(2, 2).ravel()
    images = []
    for ax, (i, j, name) in zip(views, VIEWS, strict=True):
        _flat(ax, limits, (i, j))
        images.append(_cells(ax, places[:, [i, j]], std, limits[:, [i, j]]))
        ax.plot(*measured[:, [i, j]].T, **ring)
        ax.set_title(f"Seen {name}")
    every = np.concatenate([np.asarray(image.get_array()) for image in images])
    low, high = float(every.min()), float(np.quantile(every, 0.98))
    for image in images:  # one scale of colours; one cell must not make all others alike
        image.set_clim(low, max(high, 1.01 * low + 1e-9))
    bar = figure.colorbar(images[1], ax=views[1], shrink=0.95, pad=0.02, extend="max")
    bar.set_label("standard deviation [mm]")
    _how_often(last, std, c)
    cell = base.area(f"rms of the poses in a cell, {POSES:,} poses", facecolor="#8a8678")
    base.legend_above(figure, [cell, base.line("measured rows", **ring)])
    return figure


def _space(ax: Any, places: Array, kinds: tuple[base.RowKind, ...], limits: Array) -> None:  # noqa: ANN401
    """The points in perspective, with lines down to the floor where they are few."""
    for kind in kinds:
        p = places[kind.mask]
        ax.plot(*p.T, rasterized=len(places) > base.MOST_SHAPES, **kind.style())
        for x, y, z in p if len(places) <= _MOST_STILTS else ():
            ax.plot([x, x], [y, y], [limits[0, 2], z], color=kind.colour, lw=0.5, alpha=0.35)
    ax.set_box_aspect(limits[1] - limits[0], zoom=0.85)
    ax.set_title("In space, base frame")
    for k, axis in enumerate((ax.xaxis, ax.yaxis, ax.zaxis)):
        (ax.set_xlim, ax.set_ylim, ax.set_zlim)[k](*limits[:, k])
        axis.set_label_text(f"{'xyz'[k]} [mm]")
        axis.labelpad = 1.5
        axis.set_major_locator(base.few_ticks(4))
        axis.set_pane_color((0.97, 0.975, 0.98, 1.0))
    ax.tick_params(labelsize=7.5, pad=1)
    ax.view_init(elev=20, azim=-62)


def _holds_base(limits: Array) -> bool:
    """Whether the base's origin lies inside of what is shown."""
    return bool(np.all(limits[0] <= 0.0) and np.all(limits[1] >= 0.0))


def _flat(ax: Axes, limits: Array, pair: tuple[int, int]) -> None:
    """Equal scales, labels, and the base where it lies inside."""
    shown = limits[:, list(pair)]
    ax.set_aspect("equal")
    ax.set_xlim(*shown[:, 0])
    ax.set_ylim(*shown[:, 1])
    ax.set_xlabel(f"{'xyz'[pair[0]]} [mm]")
    ax.set_ylabel(f"{'xyz'[pair[1]]} [mm]", labelpad=1)
    ax.xaxis.set_major_locator(base.few_ticks(4))
    ax.yaxis.set_major_locator(base.few_ticks(4))
    if _holds_base(shown):
        ax.plot(0.0, 0.0, marker="+", ms=8, mew=1.4, color=labels.SOFT, zorder=4)


def _limits(places: Array) -> Array:
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
        extent=(limits[0, 0], limits[1, 0], limits[0, 1], limits[1, 1]),
        cmap="cividis",
        linewidths=0.15,
        edgecolors="face",
        zorder=2,
    )


def _how_often(ax: Axes, std: Array, c: Calibration) -> None:
    """The share of poses below each standard deviation, with the rms at the measured poses and over the limits."""
    values = np.sort(std)
    ax.plot(values, np.linspace(0.0, 100.0, len(values)), color=labels.INK, lw=1.4)
    for value, style, word in (
        (1e3 * c.expected_measured, ":", "rms, measured poses"),
        # Not of the poses drawn, which are more: the report has one number for one thing.
        (1e3 * c.expected_everywhere, "--", "rms, joint limits"),
        (float(np.quantile(std, 0.95)), "-.", "95 % of the joint limits"),
    ):
        look: dict[str, Any] = {"color": labels.SOFT, "ls": style, "lw": 1.1}
        ax.vlines(value, 0.0, 100.0, label=f"{value:.3f} mm: {word}", **look)
    ax.set_xlim(0.0, 1.08 * max(float(np.quantile(std, 0.99)), 1e3 * c.expected_measured, 1e-9))
    ax.set_ylim(0.0, 145.0)  # room for the legend above the curve
    ax.set_yticks(range(0, 101, 20))
    ax.set_xlabel("standard deviation [mm]")
    ax.set_ylabel("poses below [%]")
    ax.set_title("How often, over the joint limits")
    ax.legend(loc="upper left", handlelength=2.2, fontsize=7.5, frameon=True, edgecolor="none")
