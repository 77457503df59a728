"""Points in space: where the target was measured, and how sure predictions are over the workspace."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from calib.identify.result import Calibration
from calib.identify.uncertainty import workspace_uncertainty
from calib.show.figure_base import MOST_SHAPES, WIDTH, few_ticks, legend_above, new_figure
from calib.show.figure_rows import RowKind, measured_places, number_points, row_kinds
from calib.show.palette import INK, SOFT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

#: Left, bottom, width and height, in parts of a figure.
Box: TypeAlias = tuple[float, float, float, float]

#: Room around the views and between them for titles, labels and legend [in].
_LEFT, _BETWEEN, _RIGHT, _ABOVE, _MIDDLE, _BELOW = 0.65, 0.75, 0.2, 0.62, 0.8, 0.48

#: More room below for a line of text [in].
_FOOT = 0.2

#: The most height of the figure, and the least of the view in space [in].
_HIGHEST, _LEAST = 7.4, 2.2

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
    height, room, boxes = _boxes(limits, _BELOW if np.all(seen) else _BELOW + _FOOT)
    figure = new_figure(height)
    figure.set_layout_engine("none")  # the boxes say where everything stands
    space: Any = figure.add_axes(room, projection="3d")
    _space(space, places, kinds, limits)
    for (i, j, name), box in zip(_VIEWS, boxes, strict=True):
        ax = figure.add_axes(box)
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


def _boxes(limits: Array, below: float) -> tuple[float, Box, tuple[Box, Box, Box]]:
    """The figure's height [in], the room of the view in space, and the boxes of the three others: all of one scale.

    From above and from the front share x, from the front and from the side share z, as in drawings. A box is left,
    bottom, width and height, in parts of the figure.

    Args:
        limits: shape (2, 3), what is shown [m].
        below: Room for the labels below [in].
    """
    x, y, z = (float(value) for value in limits[1] - limits[0])
    across = WIDTH - _LEFT - _BETWEEN - _RIGHT
    scale = min(across / (x + y), (_HIGHEST - _ABOVE - _MIDDLE - below) / (y + z))
    x, y, z = scale * x, scale * y, scale * z
    upper = max(y, _LEAST)
    height = _ABOVE + upper + _MIDDLE + z + below
    second, raised = _LEFT + x + _BETWEEN, below + z + _MIDDLE

    def box(left: float, bottom: float, wide: float, high: float) -> Box:
        """Inches as parts of the figure."""
        return left / WIDTH, bottom / height, wide / WIDTH, high / height

    start = second - 0.5 * _BETWEEN
    space = box(start, raised, WIDTH - start - 0.5 * _RIGHT, upper)
    return (
        height,
        space,
        (box(_LEFT, raised, x, y), box(_LEFT, below, x, z), box(second, below, y, z)),
    )


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

    found = workspace_uncertainty(c, POSES, larger=False)
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
        # Not of the poses drawn, which are more: the report has one number for one thing.
        (1e3 * c.expected_everywhere, "--", "rms, joint limits"),
        (float(np.quantile(std, 0.95)), "-.", "95 % of the joint limits"),
    ):
        ax.vlines(value, 0.0, 100.0, color=SOFT, ls=style, lw=1.1, label=f"{value:.3f} mm: {word}")
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
