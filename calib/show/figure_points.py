"""Points in space: where the target was measured, and how sure predictions are over the workspace."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from calib.identify.result import Calibration
from calib.identify.uncertainty import workspace_uncertainty
from calib.show.figure_base import (
    RowKind,
    legend_above,
    measured_places,
    new_figure,
    row_kinds,
)
from calib.show.palette import INK, SOFT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

#: The two axes of each view, and what it is called.
_VIEWS = ((0, 1, "from above"), (0, 2, "from the front"), (1, 2, "from the side"))

#: Rows are numbered in the figure if there are not more than this.
_MOST_NUMBERS = 12

#: More points than this are drawn as pixels in SVG and PDF.
_MOST_SHAPES = 1500

#: Joint values at which the uncertainty is drawn.
POSES = 1000


def points_figure(c: Calibration) -> Figure:
    """The measured points in the base frame: in space, and from three sides; as the paper's figure 7."""
    from matplotlib.lines import Line2D

    places, seen = measured_places(c)
    kinds = row_kinds(c)
    figure = new_figure(6.4)
    grid = figure.add_gridspec(2, 2)
    limits = _limits(places)
    space: Any = figure.add_subplot(grid[0, 0], projection="3d")
    _space(space, places, kinds, limits)
    for (i, j, name), at in zip(_VIEWS, (grid[0, 1], grid[1, 0], grid[1, 1]), strict=True):
        ax = figure.add_subplot(at)
        ax.set_title(f"Seen {name}")
        for kind in kinds:
            _dots(ax, places[kind.mask][:, [i, j]], kind)
        _flat(ax, limits, (i, j))
        _number(ax, c, places[:, [i, j]], kinds)
    handles = [Line2D([], [], label=kind.label, **kind.style(1)) for kind in kinds]
    handles.append(Line2D([], [], ls="none", marker="+", ms=9, mew=1.4, color=SOFT, label="base"))
    legend_above(figure, handles)
    if not np.all(seen):
        what = "as the calibrated robot predicts them" if not np.any(seen) else "partly predicted"
        figure.supxlabel(f"Points {what}: not every row measures a position.", size=8, color=SOFT)
    return figure


def _space(ax: Any, places: Array, kinds: tuple[RowKind, ...], limits: Array) -> None:  # noqa: ANN401
    """The points in perspective, with the lines down to the floor where they are few."""
    floor = limits[0, 2]
    few = len(places) <= 100
    for kind in kinds:
        p = 1e3 * places[kind.mask]
        style = kind.style(len(places)) | {
            "markersize": 0.8 * kind.style(len(places))["markersize"]
        }
        ax.plot(p[:, 0], p[:, 1], p[:, 2], rasterized=len(places) > _MOST_SHAPES, **style)
        if few:
            for x, y, z in p:
                ax.plot([x, x], [y, y], [1e3 * floor, z], color=kind.colour, lw=0.5, alpha=0.35)
    for k, setter in enumerate((ax.set_xlim, ax.set_ylim, ax.set_zlim)):
        setter(*(1e3 * limits[:, k]))
    ax.set_box_aspect(limits[1] - limits[0], zoom=0.92)
    ax.set_title("In space, base frame")
    for axis, letter in zip((ax.xaxis, ax.yaxis, ax.zaxis), "xyz", strict=True):
        axis.set_label_text(f"{letter} [mm]")
        axis.set_major_locator(_few_ticks(4))
        axis.set_pane_color((0.97, 0.975, 0.98, 1.0))
    ax.tick_params(labelsize=7, pad=0)
    ax.view_init(elev=22, azim=-58)


def _few_ticks(count: int) -> Any:  # noqa: ANN401  a locator of matplotlib
    """A few round numbers."""
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(count, steps=[1, 2, 2.5, 5, 10])


def _dots(ax: Axes, places: Array, kind: RowKind) -> None:
    """Points of one kind in a view."""
    many = len(places) > _MOST_SHAPES
    order = {"estimation": 2, "validation": 3, "outlier": 4}[kind.word]
    ax.plot(*(1e3 * places.T), rasterized=many, zorder=order, **kind.style())


def _flat(ax: Axes, limits: Array, pair: tuple[int, int]) -> None:
    """Equal scales, labels, and the base where it lies inside."""
    ax.set_aspect("equal")
    ax.set_xlim(*(1e3 * limits[:, pair[0]]))
    ax.set_ylim(*(1e3 * limits[:, pair[1]]))
    ax.set_xlabel(f"{'xyz'[pair[0]]} [mm]")
    ax.set_ylabel(f"{'xyz'[pair[1]]} [mm]")
    ax.xaxis.set_major_locator(_few_ticks(5))
    ax.yaxis.set_major_locator(_few_ticks(5))
    if np.all((limits[0, list(pair)] <= 0.0) & (limits[1, list(pair)] >= 0.0)):
        ax.plot(0.0, 0.0, marker="+", ms=9, mew=1.4, color=SOFT, zorder=1)


def _number(ax: Axes, c: Calibration, places: Array, kinds: tuple[RowKind, ...]) -> None:
    """Row numbers beside validation rows and outliers, if they are few."""
    from matplotlib.patheffects import withStroke

    chosen = np.any([kind.mask for kind in kinds if kind.word != "estimation"] or [[False]], axis=0)
    if np.count_nonzero(chosen) > _MOST_NUMBERS:
        return
    for k in np.flatnonzero(chosen):
        ax.annotate(
            str(c.measurements.rows[k]),
            (1e3 * places[k, 0], 1e3 * places[k, 1]),
            (4, 3),
            textcoords="offset points",
            size=7.5,
            color=INK,
            zorder=5,
            path_effects=[withStroke(linewidth=2.0, foreground="white")],
        ).set_in_layout(False)


def _limits(places: Array) -> Array:
    """What the views show, shape (2, 3), [m]: the points, and the base if it is near."""
    low, high = places.min(axis=0), places.max(axis=0)
    size = max(float(np.max(high - low)), 0.05)
    if np.all((low < size) & (high > -size)):
        low, high = np.minimum(low, 0.0), np.maximum(high, 0.0)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    # Flat clouds get some height, so that no view is a line.
    half = np.maximum(1.08 * half, 0.3 * max(float(half.max()), 0.025))
    return np.array([middle - half, middle + half])


def uncertainty_figure(c: Calibration) -> Figure:
    """How sure predicted positions are over the joint limits: three views, and how often which size occurs."""
    from matplotlib.lines import Line2D

    found = workspace_uncertainty(c, POSES)
    T = c.robot.poses(found.q)
    places = T[:, :3, :3] @ c.target + T[:, :3, 3]
    std = 1e3 * found.std
    order = np.argsort(std, kind="stable")  # the least sure on top
    figure = new_figure(6.4)
    grid = figure.add_gridspec(2, 2)
    limits = _limits(places)
    measured, _ = measured_places(c)
    # Outside of what 2 % exceed colours no longer differ: one pose must not make all others alike.
    low, high = float(std.min()), float(np.quantile(std, 0.98))
    panels = []
    for (i, j, name), at in zip(_VIEWS, (grid[0, 0], grid[0, 1], grid[1, 0]), strict=True):
        ax = figure.add_subplot(at)
        image = ax.scatter(
            1e3 * places[order, i],
            1e3 * places[order, j],
            c=std[order],
            s=9,
            linewidths=0,
            cmap="cividis",
            vmin=low,
            vmax=max(high, low * 1.01 + 1e-9),
            rasterized=True,
        )
        few = measured if len(measured) <= _MOST_SHAPES else measured[:: len(measured) // 1000]
        ax.plot(
            1e3 * few[:, i],
            1e3 * few[:, j],
            ls="none",
            marker="o",
            ms=3.0,
            mfc="white",
            mec=INK,
            mew=0.6,
            rasterized=len(few) > 300,
        )
        ax.set_title(f"Seen {name}")
        _flat(ax, limits, (i, j))
        panels.append(ax)
    bar = figure.colorbar(image, ax=panels[1], shrink=0.9, pad=0.02, extend="max")
    bar.set_label("standard deviation of the position [mm]")
    bar.outline.set_visible(False)  # type: ignore[operator]
    _how_often(figure.add_subplot(grid[1, 1]), std, c)
    spot = Line2D([], [], ls="none", marker="o", ms=4, color="#7c7b78", mec="none")
    spot.set_label(f"{POSES:,} poses spread over the joint limits")
    rows = Line2D([], [], ls="none", marker="o", ms=3.5, mfc="white", mec=INK, mew=0.6)
    rows.set_label("measured rows")
    legend_above(figure, [spot, rows])
    return figure


def _how_often(ax: Axes, std: Array, c: Calibration) -> None:
    """The share of poses below each standard deviation, with the rms at the measured poses and over the limits."""
    values = np.sort(std)
    ax.plot(values, 100.0 * np.arange(1, len(values) + 1) / len(values), color=INK, lw=1.4)
    for value, style, word in (
        (1e3 * c.expected_measured, ":", "rms, measured poses"),
        (float(np.sqrt(np.mean(std**2))), "--", "rms, joint limits"),
        (float(np.quantile(std, 0.95)), "-.", "95 % of the joint limits"),
    ):
        ax.axvline(value, color=SOFT, ls=style, lw=1.1, label=f"{value:.3g} mm  {word}")
    ax.set_xlim(0.0, 1.05 * float(np.quantile(std, 0.99)) + 1e-9)
    ax.set_ylim(0.0, 100.0)
    ax.set_xlabel("standard deviation of the position [mm]")
    ax.set_ylabel("poses below [%]")
    ax.set_title("How often")
    ax.legend(loc="lower right", handlelength=2.2)
