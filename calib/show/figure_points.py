"""Points in space: where the target was measured, and how sure predictions are over the workspace."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from calib.identify.result import Calibration
from calib.identify.uncertainty import workspace_uncertainty
from calib.show.figure_base import MOST_SHAPES, few_ticks, legend_above, new_figure
from calib.show.figure_rows import RowKind, measured_places, number_points, row_kinds
from calib.show.palette import INK, SOFT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

#: The two axes of each view, and what it is called.
_VIEWS = ((0, 1, "from above"), (0, 2, "from the front"), (1, 2, "from the side"))

#: More rows than this are thinned.
MOST_POINTS = 3000

#: Measured rows in the figure of the uncertainty: more are thinned.
_MOST_RINGS = 150

#: Up to so many points stand on lines down to the floor.
_MOST_STILTS = 100

#: Points of a plane seen from its edge have no numbers there [m].
_FLAT = 0.01

#: Joint values over which the uncertainty is drawn, and cells across a view.
POSES, _CELLS = 4000, 22


def points_figure(c: Calibration) -> Figure:
    """The measured points in the base frame: in space, and from three sides; as the paper's figure 7."""
    from matplotlib.lines import Line2D

    places, seen = measured_places(c)
    kinds = row_kinds(c)
    limits = _limits(places)
    figure = new_figure(6.6)
    x, y, z = _shares(limits)
    grid = figure.add_gridspec(2, 2, width_ratios=(x, y), height_ratios=(y, z))
    space: Any = figure.add_subplot(grid[0, 1], projection="3d")
    _space(space, places, kinds, limits)
    # From above and from the front share x, from the front and from the side share z, as in drawings.
    for (i, j, name), at in zip(_VIEWS, (grid[0, 0], grid[1, 0], grid[1, 1]), strict=True):
        ax = figure.add_subplot(at)
        ax.set_title(f"Seen {name}")
        for kind in kinds:
            _dots(ax, 1e3 * _thinned(places, kind)[:, [i, j]], kind, many=len(places) > MOST_SHAPES)
        _flat(ax, limits, (i, j))
        if np.min(np.ptp(places[:, [i, j]], axis=0)) > _FLAT:
            number_points(ax, c, 1e3 * places[:, [i, j]])
    handles = [Line2D([], [], label=kind.label, **kind.style(1)) for kind in kinds]
    if _holds_base(limits):
        cross = Line2D([], [], ls="none", marker="+", ms=9, mew=1.4, color=SOFT, label="base")
        handles.append(cross)
    legend_above(figure, handles)
    if not np.all(seen):
        what = "All" if not np.any(seen) else "Some"
        figure.supxlabel(
            f"{what} rows measure no position: there it is the calibrated robot's prediction.",
            size=8,
            color=SOFT,
        )
    return figure


def _shares(limits: Array) -> list[float]:
    """The room that x, y and z take on the page, so that the views have about one scale."""
    size = limits[1] - limits[0]
    return [float(value) for value in np.maximum(size, 0.75 * size.max())]


def _thinned(places: Array, kind: RowKind) -> Array:
    """The points of a kind, evenly thinned where they are many."""
    every = 1 if kind.word == "outlier" else -(-len(places) // MOST_POINTS)
    return places[np.flatnonzero(kind.mask)[::every][:MOST_POINTS]]


def _space(ax: Any, places: Array, kinds: tuple[RowKind, ...], limits: Array) -> None:  # noqa: ANN401
    """The points in perspective, with lines down to the floor where they are few."""
    floor = 1e3 * limits[0, 2]
    for kind in kinds:
        p = 1e3 * _thinned(places, kind)
        ax.plot(*p.T, rasterized=len(places) > MOST_SHAPES, **kind.style(len(places)))
        if len(places) <= _MOST_STILTS:
            for x, y, z in p:
                ax.plot([x, x], [y, y], [floor, z], color=kind.colour, lw=0.5, alpha=0.35)
    if _holds_base(limits):
        ax.plot([0.0], [0.0], [0.0], marker="+", ms=9, mew=1.4, color=SOFT)
    for k, setter in enumerate((ax.set_xlim, ax.set_ylim, ax.set_zlim)):
        setter(*(1e3 * limits[:, k]))
    size = limits[1] - limits[0]
    # A low box is drawn wider: then its labels need more room.
    ax.set_box_aspect(size, zoom=0.8 if size[2] > 0.6 * size.max() else 0.68)
    ax.set_title("In space, base frame")
    for axis, letter in zip((ax.xaxis, ax.yaxis, ax.zaxis), "xyz", strict=True):
        axis.set_label_text(f"{letter} [mm]")
        axis.labelpad = 1.5
        axis.set_major_locator(few_ticks(4))
        axis.set_pane_color((0.97, 0.975, 0.98, 1.0))
    ax.tick_params(labelsize=7.5, pad=1)
    ax.view_init(elev=20, azim=-62)


def _holds_base(limits: Array) -> bool:
    """Whether the base's origin lies inside of what is shown."""
    return bool(np.all(limits[0] <= 0.0) and np.all(limits[1] >= 0.0))


def _dots(ax: Axes, places: Array, kind: RowKind, *, many: bool) -> None:
    """Points of one kind in a view."""
    order = {"estimation": 2, "validation": 3, "outlier": 4}[kind.word]
    style = kind.style()
    ax.plot(
        *places.T,
        rasterized=many,
        zorder=order,
        **(style | {"markersize": 0.85 * style["markersize"]}),
    )


def _flat(ax: Axes, limits: Array, pair: tuple[int, int]) -> None:
    """Equal scales, labels, and the base where it lies inside."""
    ax.set_aspect("equal")
    ax.set_xlim(*(1e3 * limits[:, pair[0]]))
    ax.set_ylim(*(1e3 * limits[:, pair[1]]))
    ax.set_xlabel(f"{'xyz'[pair[0]]} [mm]")
    ax.set_ylabel(f"{'xyz'[pair[1]]} [mm]", labelpad=1)
    ax.xaxis.set_major_locator(few_ticks(4))
    ax.yaxis.set_major_locator(few_ticks(4))
    if np.all((limits[0, list(pair)] <= 0.0) & (limits[1, list(pair)] >= 0.0)):
        ax.plot(0.0, 0.0, marker="+", ms=8, mew=1.4, color=SOFT, zorder=4)


def _limits(places: Array) -> Array:
    """What the views show, shape (2, 3), [m]: the points, and the base if it is near."""
    low, high = places.min(axis=0), places.max(axis=0)
    size = max(float(np.max(high - low)), 0.05)
    if np.all((low < size) & (high > -size)):
        low, high = np.minimum(low, 0.0), np.maximum(high, 0.0)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    # Flat clouds get some height, so that no view is a line.
    half = np.maximum(1.1 * half, 0.3 * max(float(half.max()), 0.025))
    return np.array([middle - half, middle + half])


def uncertainty_figure(c: Calibration) -> Figure:
    """How sure predicted positions are over the joint limits: three views, and how often which size occurs."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    found = workspace_uncertainty(c, POSES)
    T = c.robot.poses(found.q)
    places = T[:, :3, :3] @ c.target + T[:, :3, 3]
    std = 1e3 * found.std
    limits = _limits(places)
    measured, _ = measured_places(c)
    measured = measured[:: max(-(-len(measured) // _MOST_RINGS), 1)]
    figure = new_figure(6.2)
    grid = figure.add_gridspec(2, 2)
    images = []
    for (i, j, name), at in zip(_VIEWS, (grid[0, 0], grid[0, 1], grid[1, 0]), strict=True):
        ax = figure.add_subplot(at)
        _flat(ax, limits, (i, j))
        images.append(_cells(ax, 1e3 * places[:, [i, j]], std, 1e3 * limits[:, [i, j]]))
        ax.plot(*(1e3 * measured[:, [i, j]].T), **_RING)
        ax.set_title(f"Seen {name}")
    every = np.concatenate([np.asarray(image.get_array()) for image in images])
    low, high = float(every.min()), float(np.quantile(every, 0.98))
    for image in images:  # one scale of colours; one cell must not make all others alike
        image.set_clim(low, max(high, 1.01 * low + 1e-9))
    bar = figure.colorbar(images[1], ax=images[1].axes, shrink=0.95, pad=0.02, extend="max")
    bar.set_label("standard deviation [mm]")
    bar.outline.set_visible(False)
    _how_often(figure.add_subplot(grid[1, 1]), std, c)
    cell = Patch(facecolor="#8a8678", label=f"rms of the poses in a cell, {POSES:,} poses")
    rows = Line2D([], [], **_RING, label="measured rows")
    legend_above(figure, [cell, rows])
    return figure


#: A measured row on coloured ground.
_RING: dict[str, Any] = {
    "linestyle": "none",
    "marker": "o",
    "markersize": 3.0,
    "markerfacecolor": "white",
    "markeredgecolor": INK,
    "markeredgewidth": 0.6,
}


def _cells(ax: Axes, places: Array, std: Array, limits: Array) -> Any:  # noqa: ANN401  a collection of matplotlib
    """The root mean square of the standard deviations of the poses in each hexagon of a view."""
    width, height = limits[1] - limits[0]
    across = max(int(_CELLS * width / max(width, height)), 4)
    down = max(int(_CELLS * height / max(width, height) / np.sqrt(3.0)), 3)
    return ax.hexbin(
        places[:, 0],
        places[:, 1],
        C=std**2,
        reduce_C_function=lambda squares: float(np.sqrt(np.mean(squares))),
        gridsize=(across, down),
        extent=(limits[0, 0], limits[1, 0], limits[0, 1], limits[1, 1]),
        cmap="cividis",
        linewidths=0.15,
        edgecolors="face",
        zorder=2,
    )


def _how_often(ax: Axes, std: Array, c: Calibration) -> None:
    """The share of poses below each standard deviation, with the rms at the measured poses and over the limits."""
    values = np.sort(std)[:: max(len(std) // 400, 1)]
    ax.plot(values, 100.0 * np.arange(1, len(values) + 1) / len(values), color=INK, lw=1.4)
    for value, style, word in (
        (1e3 * c.expected_measured, ":", "rms, measured poses"),
        (float(np.sqrt(np.mean(std**2))), "--", "rms, joint limits"),
        (float(np.quantile(std, 0.95)), "-.", "95 % of the joint limits"),
    ):
        ax.vlines(value, 0.0, 100.0, color=SOFT, ls=style, lw=1.1, label=f"{value:.3g} mm: {word}")
    most = max(1.08 * float(np.quantile(std, 0.99)), 1.08e3 * c.expected_measured, 1e-9)
    ax.set_xlim(0.0, most)
    # Room for the legend above the curve.
    ax.set_ylim(0.0, 145.0)
    ax.set_yticks(range(0, 101, 20))
    ax.set_xlabel("standard deviation [mm]")
    ax.set_ylabel("poses below [%]")
    ax.set_title("How often, over the joint limits")
    ax.legend(
        loc="upper left",
        handlelength=2.2,
        fontsize=7.5,
        frameon=True,
        edgecolor="none",
        framealpha=1.0,
    )
