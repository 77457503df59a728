"""Which robots, poses and rows are shown: of a calibration, of two robots and a table, or of two results."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calib.identify.comparison import Comparison
from calib.identify.comparison_text import sentence
from calib.identify.evaluation import Evaluation
from calib.identify.result import Calibration
from calib.identify.setup import Setup
from calib.measure.measurements import Measurements
from calib.model.readback import column_ranges, spread_between, spread_poses
from calib.model.robot import Robot, rigid_inverse
from calib.show.robots_page import write_view
from calib.show.rows import angles_of, flagged_rows, lengths_of, measured_in_base, placed
from calib.show.view import NAMES, Cloud, Names, View, translated

Array = NDArray[np.float64]

#: Poses of two robots of which nothing was measured.
_POSES = 24

#: Points of the cloud over the joint limits, and within the measured joint values.
EVERYWHERE, MEASURED = 4000, 2000

#: Frames nearer to the base's than this are the base's own: there is no instrument to show [m, and 1].
_THE_BASE = 1e-9


def view_of(calibration: Calibration, *, cloud: bool = True) -> View:
    """The view of a calibration: every row a pose.

    Shown first is the one where the nominal robot is furthest off, of the validation rows if there are any, flagged
    ones aside.

    Args:
        calibration: The calibration.
        cloud: Whether to compute how well positions are known over the workspace.
    """
    c = calibration
    flagged = frozenset(np.array(c.measurements.rows)[flagged_rows(c)].tolist())
    before = _Half(c.nominal, c.nominal_setup, c.residual_nominal, c.used)
    after = _Half(c.robot, c.setup, c.residual_calibrated, c.used)
    shown = _view_of_rows(c.measurements, before, after, flagged)
    return replace(
        shown,
        instruments=_with_tracker(c, shown.instruments),
        cloud=cloud_of(c) if cloud else None,
        title=f"{c.nominal.name or 'Robot'}: nominal and calibrated",
        verdict="" if c.verdict is None else c.verdict.use,
        note=_note(c),
    )


def view_of_robots(
    nominal: Robot,
    calibrated: Robot | None = None,
    *,
    names: Names = NAMES,
    evaluations: tuple[Evaluation, Evaluation | None] | None = None,
    flagged: frozenset[int] = frozenset(),
    title: str = "",
    verdict: str = "",
    note: str = "",
) -> View:
    """The view of one or two robots, with what was measured if there is a table.

    Without measurements two robots go through poses spread over the joint limits, and one robot moves one joint after
    the other.

    Args:
        nominal: The first robot.
        calibrated: The second; None for none.
        names: What they are called, and what that means.
        evaluations: What `calib.evaluate` says of the two robots and one table; None for no table.
        flagged: Rows that do not belong to the others.
        title: The page's heading.
        verdict: What a calibration's verdict is; none for none.
        note: A sentence or two below the heading.
    """
    if evaluations is not None:
        first, second = evaluations
        after = None
        if calibrated is not None and second is not None:
            after = _Half(calibrated, second.setup, second.residual, second.used)
        before = _Half(nominal, first.setup, first.residual, first.used)
        shown = _view_of_rows(first.measurements, before, after, flagged)
        return replace(shown, names=names, title=title, verdict=verdict, note=note)
    if calibrated is None:
        q, labels = _one_joint_after_the_other(nominal)
    else:
        q = spread_poses(nominal, _POSES)
        labels = tuple(f"pose {k + 1} of {len(q)} over the joint limits" for k in range(len(q)))
    return View(
        nominal=nominal,
        calibrated=calibrated,
        q=q,
        labels=labels,
        names=names,
        title=title or (nominal.name if calibrated is None else ""),
        verdict=verdict,
        note=note,
    )


def view_of_comparison(comparison: Comparison) -> View:
    """The view of two results of one robot, with the first one's target, each in the base as its own fit has it.

    The poses are not measured ones: they are spread over the joint limits, and their labels say so.
    """
    c = comparison
    first, second = c.robots
    target = translated(c.a.target)
    view = view_of_robots(
        first,
        second,
        names=((f"a: {c.names[0]}", "the first result"), (f"b: {c.names[1]}", "the second result")),
        title=f"{c.a.nominal.name or 'Robot'}: two calibrations",
        note=sentence(c),
    )
    return replace(view, nominal_target=target, calibrated_target=target)


def cloud_of(calibration: Calibration) -> Cloud:
    """Predicted positions and their standard deviation, sqrt(trace(J C J^T)), over the workspace.

    Half as many points again lie within the range of the joint values that were fitted as over the joint limits. The
    standard deviations are those of `calib.workspace_uncertainty`: they know nothing of errors that the model lacks.
    """
    robot = calibration.robot
    seen = calibration.measurements.joints_for(robot.joint_names)[calibration.weights > 0.0]
    limits = column_ranges(robot)
    inner = np.stack([seen.min(axis=0), seen.max(axis=0)], axis=1) if len(seen) else limits
    q = np.concatenate([spread_between(limits, EVERYWHERE), spread_between(inner, MEASURED)])
    std = calibration.position_std(q, larger=False)
    T = robot.poses(q)
    points = T[:, :3, :3] @ calibration.target + T[:, :3, 3]
    return Cloud(points, std, np.all((q >= inner[:, 0]) & (q <= inner[:, 1]), axis=1))


def write_page(calibration: Calibration, path: str | Path, *, overwrite: bool = False) -> Path:
    """Write a self-contained page that shows both robots.

    Raises:
        FileError: The file exists, or cannot be written.
    """
    return write_view(view_of(calibration), path, overwrite=overwrite)


@dataclass(frozen=True, slots=True, eq=False)
class _Half:
    """One robot, where its frames and targets are, and what it leaves over of each row: shapes (N, D), [m], [rad]."""

    robot: Robot
    setup: Setup
    residual: Array
    used: NDArray[np.bool_]


def _view_of_rows(
    m: Measurements, first: _Half, second: _Half | None, flagged: frozenset[int]
) -> View:
    """The view of one or two robots at the rows of a table."""
    before = placed(first.setup, m)
    after = before if second is None else placed(second.setup, m)
    kinds = _kinds(m, flagged)
    halves = (first, second or first)
    errors = np.array([lengths_of(half.residual, half.used) for half in halves])
    return View(
        nominal=first.robot,
        calibrated=None if second is None else second.robot,
        q=m.joints_for(first.robot.joint_names),
        labels=tuple(f"row {row}" for row in m.rows),
        kinds=kinds,
        nominal_target=before[1],
        calibrated_target=after[1],
        measured=measured_in_base(m, after[0]),
        errors=errors,
        angles=np.array([angles_of(half.residual, half.used) for half in halves]),
        # Its error in the picture is then that of the tables, not where each of the two finds the tracker.
        T_base_nominal=_between(m, before[0], after[0]),
        instruments=_instruments(m, after[0]),
        start=_worst(errors[0], kinds),
    )


def _between(m: Measurements, nominal: Array, calibrated: Array) -> Array:
    """Where the nominal robot stands in the calibrated one's base, by where each finds the frames.

    Shape (N, 4, 4), [m]. Where nothing tells a place, neither finds where it stands: the two then share their base.
    """
    if not np.any(m.where(lambda kind: kind.coordinates)):
        return np.broadcast_to(np.eye(4), nominal.shape)
    return rigid_inverse(calibrated) @ nominal


def _instruments(m: Measurements, T_frame_base: Array) -> Array:
    """Where the measuring frame of each row stands in the base, shape (N, 4, 4); NaN where it is the base itself."""
    T_base_frame = rigid_inverse(T_frame_base)
    elsewhere = np.max(np.abs(T_base_frame - np.eye(4)), axis=(1, 2)) > _THE_BASE
    known = m.positions & elsewhere
    return np.where(known[:, None, None], T_base_frame, np.nan)


def _with_tracker(c: Calibration, instruments: Array) -> Array:
    """The instruments; for points that were measured in the base itself the cell's tracker, shape (N, 4, 4)."""
    if c.cell.tracker is None:
        return instruments
    seen = c.measurements.positions & np.isnan(instruments[:, 0, 0])
    return np.where(seen[:, None, None], translated(c.cell.tracker.position), instruments)


def _kinds(m: Measurements, flagged: frozenset[int]) -> tuple[str, ...]:
    """What each row is."""
    sets = np.where(m.validation, "validation", "estimation")
    return tuple(
        "flagged" if row in flagged else str(word) for row, word in zip(m.rows, sets, strict=True)
    )


def _worst(lengths: Array, kinds: tuple[str, ...]) -> int:
    """The row with the largest length, of validation rows if there are any, flagged ones aside."""
    for wanted in (("validation",), ("estimation",), ("flagged",)):
        chosen = np.isin(kinds, wanted) & np.isfinite(lengths)
        if np.any(chosen):
            return int(np.argmax(np.where(chosen, lengths, -1.0)))
    return 0


def _note(c: Calibration) -> str:
    """What the verdict stands on, in a sentence; on which rows stands in it."""
    if c.verdict is None:
        return "No verdict: nothing was cross-validated."
    return str(c.verdict.reasons[0]) if c.verdict.reasons else ""


def _one_joint_after_the_other(robot: Robot) -> tuple[Array, tuple[str, ...]]:
    """Poses in which each joint in turn goes through its range, with what they are called."""
    ranges = column_ranges(robot)
    middle = np.clip(0.0, ranges[:, 0], ranges[:, 1])
    poses, labels = [middle], ["all joints at zero, or as near as they can be"]
    for k, joint in enumerate(robot.inputs):
        low, high = ranges[k]
        for value in np.linspace(low, high, 9):
            q = middle.copy()
            q[k] = value
            slides = joint.type == "prismatic"
            amount = f"{1e3 * value:.4g} mm" if slides else f"{np.degrees(value):.4g} deg"
            poses.append(q)
            labels.append(f"{joint.name} at {amount}")
    return np.array(poses), tuple(labels)
