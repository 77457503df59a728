"""Errors in space and over the joints: measured points, uncertainty over the workspace, what is left over by joint."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from calib.report.figure_base import (
    MOST_SHAPES,
    WIDTH,
    RowKind,
    area,
    few_ticks,
    legend_above,
    line,
    new_figure,
    number_points,
    row_kinds,
    short_names,
)
from calib.report.label_rows import (
    CALIBRATED,
    INK,
    SOFT,
    flagged_rows,
    measured_in_base,
    placed,
    target_places,
)
from calib.result.calibration import Calibration
from calib.result.uncertainty import workspace_uncertainty

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Room around the views and between them for titles, labels and legend [in].
_LEFT, _BETWEEN, _RIGHT, _ABOVE, _MIDDLE, _BELOW = 0.65, 0.75, 0.2, 0.62, 0.8, 0.48

#: The most height of the figure, and the least of the view in space [in].
_HIGHEST, _LEAST = 7.4, 2.2

#: The two axes of each view, and what it is called.
VIEWS = ((0, 1, "from above"), (0, 2, "from the front"), (1, 2, "from the side"))

#: More rows than this are thinned.
MOST_ROWS = 2000

#: Up to so many points stand on lines down to the floor, and so many are drawn over the uncertainty.
_MOST_STILTS, _MOST_RINGS = 100, 150

#: Points of a plane seen from its edge have no numbers there [m].
_FLAT = 0.01

#: Joint values over which the uncertainty is drawn, and cells across a view.
POSES, _CELLS = 4000, 22

#: A step that derivatives are taken with [rad] or [m]; a joint that moves the target less has no direction [m/rad].
_STEP, _NO_LEVER = 1e-6, 2e-3

#: The mean over runs of rows is drawn from so many rows on, over so many runs at most.
_FEWEST_ROWS, _RUNS = 24, 12


def measured_places(c: Calibration) -> Array:
    """Where the target was, in the base, shape (N, 3), [m]; predicted by the calibrated robot where nothing tells."""
    m = c.measurements
    T_frame_base, T_tip_target = placed(c.setup, m)
    places = measured_in_base(m, T_frame_base)
    predicted = target_places(c, m.joints_for(c.nominal.joint_names), T_tip_target)
    return np.where(np.isfinite(places), places, predicted)


def points(c: Calibration) -> Figure:
    """The measured points in the base frame: in space, and from three sides; as the paper's figure 7."""
    places, kinds = measured_places(c), row_kinds(c)
    limits = _limits(places)
    height, room, boxes = _boxes(limits)
    figure = new_figure(height)
    figure.set_layout_engine("none")  # the boxes say where everything stands
    _space(figure.add_axes(room, projection="3d"), places, kinds, limits)
    numbered = c.measurements.validation | flagged_rows(c)
    for (i, j, name), box in zip(VIEWS, boxes, strict=True):
        ax = figure.add_axes(box)
        ax.set_title(f"Seen {name}")
        for order, kind in enumerate(kinds, start=2):
            at = 1e3 * places[_thinned(kind.mask)][:, [i, j]]
            style = kind.style()
            style["markersize"] *= 0.85
            ax.plot(*at.T, rasterized=len(places) > MOST_SHAPES, zorder=order, **style)
        _flat(ax, limits, (i, j))
        if np.min(np.ptp(places[:, [i, j]], axis=0)) > _FLAT:
            number_points(ax, c.measurements.rows, 1e3 * places[:, [i, j]], numbered)
    handles = [kind.handle() for kind in kinds]
    if _holds_base(limits):
        handles.append(line("base", ls="none", marker="+", ms=9, mew=1.4, color=SOFT))
    legend_above(figure, handles)
    return figure


def uncertainty(c: Calibration) -> Figure:
    """How sure predicted positions are over the joint limits: three views, and how often which size occurs."""
    found = workspace_uncertainty(c, POSES, larger=False)
    T = c.robot.poses(found.q)
    places = T[:, :3, :3] @ c.target + T[:, :3, 3]
    std = 1e3 * found.std
    limits = _limits(places)
    measured = measured_places(c)
    measured = measured[:: max(-(-len(measured) // _MOST_RINGS), 1)]
    ring = {"ls": "none", "marker": "o", "ms": 3.0, "mfc": "white", "mec": INK, "mew": 0.6}
    figure = new_figure(6.2)
    grid = figure.add_gridspec(2, 2)
    images = []
    for (i, j, name), at in zip(VIEWS, (grid[0, 0], grid[0, 1], grid[1, 0]), strict=True):
        ax = figure.add_subplot(at)
        _flat(ax, limits, (i, j))
        images.append(_cells(ax, 1e3 * places[:, [i, j]], std, 1e3 * limits[:, [i, j]]))
        ax.plot(*(1e3 * measured[:, [i, j]].T), **ring)  # type: ignore[arg-type]
        ax.set_title(f"Seen {name}")
    every = np.concatenate([np.asarray(image.get_array()) for image in images])
    low, high = float(every.min()), float(np.quantile(every, 0.98))
    for image in images:  # one scale of colours; one cell must not make all others alike
        image.set_clim(low, max(high, 1.01 * low + 1e-9))
    bar = figure.colorbar(images[1], ax=images[1].axes, shrink=0.95, pad=0.02, extend="max")
    bar.set_label("standard deviation [mm]")
    bar.outline.set_visible(False)
    _how_often(figure.add_subplot(grid[1, 1]), std, c)
    cell = area(f"rms of the poses in a cell, {POSES:,} poses", facecolor="#8a8678")
    legend_above(figure, [cell, line("measured rows", **ring)])
    return figure


def joints(c: Calibration) -> Figure:
    """What is left over along each joint's motion, against its value; a panel for each joint.

    Of each row's error only that part is drawn which lies along the direction in which the joint moves the target
    there: with the derivative g of the predicted position by the joint's value, r.g / |g|. An error of this joint that
    the model lacks, of its gear, its encoder or its stiffness, then stands out as a slope or a wave.
    """
    chosen = drawn_rows(c)
    parts = 1e3 * along_joints(c, chosen)
    q = c.measurements.joints_for(c.nominal.joint_names)[chosen]
    kinds = [kind for kind in row_kinds(c) if np.any(kind.mask & chosen)]
    good = ~flagged_rows(c)[chosen]
    fitted = c.measurements.estimation[chosen] & good
    names = short_names(c.nominal.joint_names)
    columns = 2 if len(names) in (2, 4) else min(len(names), 3)
    figure = new_figure(1.65 * -(-len(names) // columns) + 0.6)
    grid = (-(-len(names) // columns), columns)
    panels = figure.subplots(*grid, squeeze=False, sharey=True).ravel()
    shown = parts[good] if np.any(good) else parts
    reach = max(1.15 * float(np.abs(shown[np.isfinite(shown)]).max(initial=0.0)), 1e-3)
    for j, (ax, joint) in enumerate(zip(panels, c.nominal.inputs, strict=False)):
        scale, unit = (1e3, "mm") if joint.type == "prismatic" else (np.degrees(1.0), "deg")
        ax.axhline(0.0, color=INK, lw=0.7, zorder=1.5)
        ax.set_ylim(-1.08 * reach, 1.08 * reach)
        for kind in kinds:
            mask, style = kind.mask[chosen], kind.style(len(q))
            style["markersize"] *= 0.8
            at = np.clip(parts[mask, j], -reach, reach)
            ax.plot(scale * q[mask, j], at, rasterized=len(q) > MOST_SHAPES, zorder=2, **style)
        if not np.any(np.isfinite(parts[:, j])):
            word = "does not move the target"
            ax.text(0.5, 0.7, word, transform=ax.transAxes, ha="center", color=SOFT)
        _mean(ax, scale * q[fitted, j], parts[fitted, j])
        ax.set_title(names[j], size=8.5)
        ax.set_xlabel(f"joint value [{unit}]")
        ax.xaxis.set_major_locator(few_ticks(4))
    for ax in panels[len(names) :]:
        ax.set_visible(False)
    for ax in panels[::columns]:
        ax.set_ylabel("left over [mm]")
    handles = [kind.handle() for kind in kinds]
    if np.count_nonzero(fitted) >= _FEWEST_ROWS:
        label = "mean of the estimation rows ± 2 standard errors"
        handles.append(area(label, facecolor=CALIBRATED, alpha=0.4))
    legend_above(figure, handles)
    return figure


def drawn_rows(c: Calibration) -> Mask:
    """The rows whose part along the joints is drawn, shape (N,); lengths between two rows belong to both."""
    own = c.used[:, 0] & ~c.measurements.of_kind("pair")
    return np.asarray(own & (_thinned(own) | flagged_rows(c)))


def along_joints(c: Calibration, chosen: Mask) -> Array:
    """The part of what is left over of some rows, none a pair's, that lies along each joint's motion of the target.

    Shape (M, m), [m], for M rows and the robot's m joints; NaN where a joint moves nothing.
    """
    m = c.measurements
    q = m.joints_for(c.nominal.joint_names)[chosen]
    T_frame_base, T_tip_target = (T[chosen] for T in placed(c.setup, m))

    def places(q: Array) -> Array:
        """Predicted positions in the measurement frame."""
        points = target_places(c, q, T_tip_target)
        turned = np.einsum("nij,nj->ni", T_frame_base[:, :3, :3], points)
        return np.asarray(turned + T_frame_base[:, :3, 3])

    at = places(q)
    # Of a distance the part along the beam counts, of a plane that along its normal.
    beam = at / np.maximum(np.linalg.norm(at, axis=1, keepdims=True), 1e-12)
    distance, plane = (m.of_kind(kind)[chosen] for kind in ("distance", "plane"))
    residual = np.where(c.used, c.residual_calibrated, 0.0)[chosen, :3]
    result = np.full(q.shape, np.nan)
    for j, step in enumerate(_STEP * np.eye(q.shape[1])):
        move = (places(q + step) - places(q - step)) / (2.0 * _STEP)
        move[distance, 0] = np.sum(beam[distance] * move[distance], axis=1)
        move[plane, 0] = move[plane, 2]
        move[distance | plane, 1:] = 0.0
        move = move[:, : residual.shape[1]]
        length = np.linalg.norm(move, axis=1)
        part = np.sum(residual * move, axis=1) / np.maximum(length, 1e-12)
        result[:, j] = np.where(length > _NO_LEVER, part, np.nan)
    return result


def _thinned(mask: Mask) -> Mask:
    """Some of the rows, evenly spread: `MOST_ROWS` at most."""
    rows = np.flatnonzero(mask)
    result = np.zeros(len(mask), dtype=np.bool_)
    result[rows[:: max(-(-len(rows) // MOST_ROWS), 1)]] = True
    return result


def _boxes(limits: Array) -> tuple[float, Any, tuple[Any, Any, Any]]:
    """The figure's height [in], the room of the view in space, and the boxes of the three others: all of one scale.

    From above and from the front share x, from the front and from the side share z, as in drawings. A box is left,
    bottom, width and height, in parts of the figure.
    """
    x, y, z = (float(value) for value in limits[1] - limits[0])
    across = WIDTH - _LEFT - _BETWEEN - _RIGHT
    scale = min(across / (x + y), (_HIGHEST - _ABOVE - _MIDDLE - _BELOW) / (y + z))
    x, y, z = scale * x, scale * y, scale * z
    upper = max(y, _LEAST)
    height = _ABOVE + upper + _MIDDLE + z + _BELOW
    second, raised = _LEFT + x + _BETWEEN, _BELOW + z + _MIDDLE

    def box(left: float, bottom: float, wide: float, high: float) -> tuple[float, ...]:
        """Inches as parts of the figure."""
        return left / WIDTH, bottom / height, wide / WIDTH, high / height

    start = second - 0.5 * _BETWEEN
    space = box(start, raised, WIDTH - start - 0.5 * _RIGHT, upper)
    front, side = box(_LEFT, _BELOW, x, z), box(second, _BELOW, y, z)
    return height, space, (box(_LEFT, raised, x, y), front, side)


def _space(ax: Any, places: Array, kinds: tuple[RowKind, ...], limits: Array) -> None:  # noqa: ANN401
    """The points in perspective, with lines down to the floor where they are few."""
    floor = 1e3 * limits[0, 2]
    for kind in kinds:
        p = 1e3 * places[_thinned(kind.mask)]
        ax.plot(*p.T, rasterized=len(places) > MOST_SHAPES, **kind.style(len(places)))
        if len(places) <= _MOST_STILTS:
            for x, y, z in p:
                ax.plot([x, x], [y, y], [floor, z], color=kind.colour, lw=0.5, alpha=0.35)
    if _holds_base(limits):
        ax.plot([0.0], [0.0], [0.0], marker="+", ms=9, mew=1.4, color=SOFT)
    size = limits[1] - limits[0]
    # A low box is drawn wider: then its labels need more room.
    ax.set_box_aspect(size, zoom=0.8 if size[2] > 0.6 * size.max() else 0.68)
    ax.set_title("In space, base frame")
    for k, axis in enumerate((ax.xaxis, ax.yaxis, ax.zaxis)):
        (ax.set_xlim, ax.set_ylim, ax.set_zlim)[k](*(1e3 * limits[:, k]))
        axis.set_label_text(f"{'xyz'[k]} [mm]")
        axis.labelpad = 1.5
        axis.set_major_locator(few_ticks(4))
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
    ax.set_xlim(*(1e3 * shown[:, 0]))
    ax.set_ylim(*(1e3 * shown[:, 1]))
    ax.set_xlabel(f"{'xyz'[pair[0]]} [mm]")
    ax.set_ylabel(f"{'xyz'[pair[1]]} [mm]", labelpad=1)
    ax.xaxis.set_major_locator(few_ticks(4))
    ax.yaxis.set_major_locator(few_ticks(4))
    if _holds_base(shown):
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
    look = {"frameon": True, "edgecolor": "none", "framealpha": 1.0}
    ax.legend(loc="upper left", handlelength=2.2, fontsize=7.5, **look)


def _mean(ax: Axes, at: Array, parts: Array) -> None:
    """The mean over runs of rows that are neighbours in the joint's value, twice its standard error about it."""
    at, parts = at[np.isfinite(parts)], parts[np.isfinite(parts)]
    if len(at) < _FEWEST_ROWS:
        return
    order = np.argsort(at, kind="stable")
    runs = [(at[run], parts[run]) for run in np.array_split(order, min(len(at) // 8, _RUNS))]
    x, mean, error = np.transpose(
        [(np.mean(q), np.mean(p), np.std(p, ddof=1) / np.sqrt(len(p))) for q, p in runs]
    )
    low, high = mean - 2 * error, mean + 2 * error
    ax.fill_between(x, low, high, color=CALIBRATED, alpha=0.45, lw=0, zorder=3)
    ax.plot(x, mean, color=CALIBRATED, lw=1.3, zorder=3)
