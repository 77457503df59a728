"""What is left over against the value of each joint.

Of each row's error only that part is drawn which lies along the direction in which the joint moves the target there:
with the derivative g of the predicted position by the joint's value, r.g / |g|. An error of this joint that the model
lacks, of its gear, its encoder or its stiffness, then stands out as a slope or a wave.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from calib.identify.result import Calibration
from calib.model.kinematics import Samples
from calib.show.figure_base import MOST_SHAPES, few_ticks, legend_above, new_figure, short_names
from calib.show.figure_rows import RowKind, flagged_rows, row_kinds
from calib.show.palette import CALIBRATED, INK, SOFT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: More rows than this are thinned.
MOST_ROWS = 2500

#: A step that derivatives are taken with [rad] or [m].
_STEP = 1e-6

#: A joint that moves the target less than this has no direction [m/rad] or [m/m].
_NO_LEVER = 2e-3

#: The mean over runs of rows is drawn from so many rows on, over so many runs at most.
_FEWEST_ROWS, _RUNS = 24, 12


def has_parts(c: Calibration) -> bool:
    """Whether any row has an error of length of its own: lengths between two rows belong to both."""
    return bool(np.any(c.used[:, 0] & ~c.measurements.of_kind("pair")))


def drawn_rows(c: Calibration) -> Mask:
    """The rows that are drawn, shape (N,): all of them, or every so many and all that are flagged."""
    every = max(-(-len(c.measurements) // MOST_ROWS), 1)
    chosen = np.arange(len(c.measurements)) % every == 0
    for kind in row_kinds(c):
        if kind.word == "outlier" and np.count_nonzero(kind.mask) <= MOST_ROWS:
            chosen |= kind.mask
    return np.asarray(chosen & c.used[:, 0] & ~c.measurements.of_kind("pair"))


def mean_rows(c: Calibration) -> Mask:
    """The rows that the mean is of, shape (N,): those drawn for estimation, without outliers."""
    return np.asarray(drawn_rows(c) & c.measurements.estimation & ~flagged_rows(c))


def has_mean(c: Calibration) -> bool:
    """Whether there are rows enough for a mean."""
    return bool(np.count_nonzero(mean_rows(c)) >= _FEWEST_ROWS)


def along_joints(c: Calibration, chosen: Mask) -> Array:
    """The part of what is left over that lies along each joint's motion of the target, NaN where it moves nothing.

    Args:
        c: The calibration.
        chosen: shape (N,), M of the rows, none of them a pair's.

    Returns:
        shape (M, m), [m], for the robot's m joints.
    """
    m = c.measurements
    rows = np.flatnonzero(chosen)
    q = m.joints_for(c.nominal.joint_names)[rows]
    frame = np.array([c.setup.groups.index(m.groups[k]) for k in rows], dtype=np.int_)
    target = np.array([c.setup.targets.index(m.targets[k]) for k in rows], dtype=np.int_)
    samples = replace(Samples.at(q), frame=frame, target=target)
    points = _points(c, samples)
    kinds = np.array(m.kinds)[rows]
    residual = np.where(c.used[rows], c.residual_calibrated[rows], 0.0)[:, :3]
    result = np.full(q.shape, np.nan)
    for j in range(q.shape[1]):
        step = _STEP * np.eye(q.shape[1])[j]
        ahead, behind = (_points(c, replace(samples, q=q + sign * step)) for sign in (1, -1))
        move = (ahead - behind) / (2.0 * _STEP)
        # Of a distance the part along the beam counts, of a plane that along its normal.
        beam = points / np.maximum(np.linalg.norm(points, axis=1, keepdims=True), 1e-12)
        distance, plane = kinds == "distance", kinds == "plane"
        move[distance, 0] = np.sum(beam[distance] * move[distance], axis=1)
        move[plane, 0] = move[plane, 2]
        move[distance | plane, 1:] = 0.0
        width = residual.shape[1]
        length = np.linalg.norm(move[:, :width], axis=1)
        part = np.sum(residual * move[:, :width], axis=1) / np.maximum(length, 1e-12)
        result[:, j] = np.where(length > _NO_LEVER, part, np.nan)
    return result


def _points(c: Calibration, samples: Samples) -> Array:
    """Predicted positions by the calibrated geometry, shape (N, 3), [m]."""
    return c.fitted.kinematics.points(c.fitted.estimate.x, samples)


def joints_figure(c: Calibration) -> Figure:
    """What is left over along each joint's motion, against its value; a panel for each joint."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    chosen = drawn_rows(c)
    parts = 1e3 * along_joints(c, chosen)
    q = c.measurements.joints_for(c.nominal.joint_names)[chosen]
    kinds = [replace(kind, mask=kind.mask[chosen]) for kind in row_kinds(c)]
    kinds = [kind for kind in kinds if np.any(kind.mask)]
    good = ~flagged_rows(c)[chosen]
    fitted = mean_rows(c)[chosen]
    names = short_names(c.nominal.joint_names)
    columns = 2 if len(names) in (2, 4) else min(len(names), 3)
    lines = -(-len(names) // columns)
    figure = new_figure(1.65 * lines + 0.6)
    panels = figure.subplots(lines, columns, squeeze=False, sharey=True).ravel()
    reach = _reach(parts[good] if np.any(good) else parts)
    for j, (ax, joint) in enumerate(zip(panels, c.nominal.inputs, strict=False)):
        slides = joint.type == "prismatic"
        at = 1e3 * q[:, j] if slides else np.degrees(q[:, j])
        _panel(ax, at, parts[:, j], kinds, reach)
        _mean(ax, at[fitted], parts[fitted, j])
        ax.set_title(names[j], size=8.5)
        ax.set_xlabel(f"joint value [{'mm' if slides else 'deg'}]")
        ax.xaxis.set_major_locator(few_ticks(4))
    for ax in panels[len(names) :]:
        ax.set_visible(False)
    for ax in panels[::columns]:
        ax.set_ylabel("left over [mm]")
    counts = {kind.word: kind.label for kind in row_kinds(c)}
    handles = [Line2D([], [], label=counts[kind.word], **kind.style(1)) for kind in kinds]
    if has_mean(c):
        label = "mean of the estimation rows ± 2 standard errors"
        patch = Patch(facecolor=CALIBRATED, alpha=0.4, label=label)
        handles.append(patch)  # type: ignore[arg-type]
    legend_above(figure, handles)
    return figure


def _reach(parts: Array) -> float:
    """Half the height of the panels [mm]: all but the outliers."""
    sizes = np.abs(parts[np.isfinite(parts)])
    return max(1.15 * float(sizes.max(initial=0.0)), 1e-3)


def _panel(ax: Axes, at: Array, parts: Array, kinds: list[RowKind], reach: float) -> None:
    """The rows of one joint; what lies beyond the scale stands at its edge."""
    ax.axhline(0.0, color=INK, lw=0.7, zorder=1.5)
    ax.set_ylim(-1.08 * reach, 1.08 * reach)
    if not np.any(np.isfinite(parts)):
        ax.text(
            0.5, 0.7, "does not move the target", transform=ax.transAxes, ha="center", color=SOFT
        )
    for kind in kinds:
        values = np.clip(parts[kind.mask], -reach, reach)
        style = kind.style(len(at))
        style["markersize"] *= 0.8
        ax.plot(at[kind.mask], values, rasterized=len(at) > MOST_SHAPES, zorder=2, **style)


def _mean(ax: Axes, at: Array, parts: Array) -> None:
    """The mean over runs of rows that are neighbours in the joint's value, twice its standard error about it."""
    there = np.isfinite(parts)
    count = int(np.count_nonzero(there))
    if count < _FEWEST_ROWS:
        return
    order = np.argsort(at[there], kind="stable")
    runs = np.array_split(order, min(count // 8, _RUNS))
    x = [float(np.mean(at[there][run])) for run in runs]
    mean = np.array([np.mean(parts[there][run]) for run in runs])
    error = np.array([np.std(parts[there][run], ddof=1) / np.sqrt(len(run)) for run in runs])
    ax.fill_between(
        x, mean - 2 * error, mean + 2 * error, color=CALIBRATED, alpha=0.45, lw=0, zorder=3
    )
    ax.plot(x, mean, color=CALIBRATED, lw=1.3, zorder=3)
