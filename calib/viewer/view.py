"""What is shown: which robots, at which poses, with what was measured there; values only.

At the rows of a table each row is a pose; of robots alone poses are spread over the joint limits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.errors import ModelError, choices
from calib.report.figure_base import angles_of, flagged_rows, lengths_of, measured_in_base, placed
from calib.result.calibration import Calibration
from calib.result.comparison import Comparison
from calib.result.evaluation import PLACES, Evaluation, evaluate
from calib.robot.readback import column_ranges, spread_poses
from calib.robot.robot import Robot, rigid_inverse
from calib.text.comparison import sentence
from calib.text.verdict import reason_text
from calib.viewer.scene import translation

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: What two robots are called, and what that means.
Names = Sequence[tuple[str, str]]
NAMES: Names = (("Nominal", "the URDF as given"), ("Calibrated", "the corrected URDF"))

#: Poses of two robots of which nothing was measured.
_POSES = 24

#: At most this many rows are shown.
MOST_ROWS = 400

#: Frames nearer to the base's than this are the base's own: there is no instrument to show [m, and 1].
_THE_BASE = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """What is shown: N poses, one of them at a time, and the marks of all of them. What is left out is filled in.

    Attributes:
        nominal: The robot before calibration.
        calibrated: The robot after it, the same chain; None to show one robot alone.
        q: shape (N, m), [rad] or [m], in the order of ``nominal.joint_names``.
        labels: What each pose is called, such as ``"row 31"``.
        kinds: ``"estimation"``, ``"validation"``, ``"flagged"`` or, where nothing was measured, ``"pose"``.
        nominal_target: shape (N, 4, 4) or (4, 4), T_tip_target of the nominal robot [m].
        calibrated_target: Likewise of the calibrated one.
        T_base_nominal: shape (N, 4, 4) or (4, 4), base of the nominal robot in the calibrated one's [m].
        measured: shape (N, 3), the measured targets in the base [m]; NaN where nothing was measured.
        errors: shape (2, N), norm of each robot's residual of lengths [m]; NaN where none was measured.
        angles: shape (2, N), likewise of orientations [rad].
        instruments: shape (K, 4, 4), poses in the base of what the targets were seen with [m].
        start: Which pose is shown first.
        rows: How many rows there are, where those shown are a choice; 0 where all are shown.
        title: The page's heading.
        verdict: What a calibration's verdict is.
        note: A sentence below the heading, such as the verdict's first reason.
        names: What the two robots are called, and what that means.

    Raises:
        ModelError: The robots have different joints.
    """

    nominal: Robot
    calibrated: Robot | None
    q: Array
    labels: tuple[str, ...] = ()
    kinds: tuple[str, ...] = ()
    nominal_target: Array = field(default_factory=lambda: np.eye(4))
    calibrated_target: Array = field(default_factory=lambda: np.eye(4))
    T_base_nominal: Array = field(default_factory=lambda: np.eye(4))
    measured: Array = field(default_factory=lambda: np.array(np.nan))
    errors: Array = field(default_factory=lambda: np.array(np.nan))
    angles: Array = field(default_factory=lambda: np.array(np.nan))
    instruments: Array = field(default_factory=lambda: np.zeros((0, 4, 4)))
    start: int = 0
    rows: int = 0
    title: str = ""
    verdict: str = ""
    note: str = ""
    names: Names = NAMES

    def __post_init__(self) -> None:
        """Fill in what was left out."""
        robot, other, count = self.nominal, self.calibrated, len(self.q)
        if other is not None and robot.joint_names != other.joint_names:
            raise ModelError(
                f"The nominal robot has the joints {choices(robot.joint_names)}, the calibrated one "
                f"{choices(other.joint_names)}. Show two robots with the same chain."
            )
        shapes = {"measured": (count, 3), "errors": (2, count), "angles": (2, count)}
        poses = ("nominal_target", "calibrated_target", "T_base_nominal")
        for name, shape in (shapes | dict.fromkeys(poses, (count, 4, 4))).items():
            object.__setattr__(self, name, np.broadcast_to(getattr(self, name), shape))
        labels = self.labels or tuple(f"pose {k + 1}" for k in range(count))
        object.__setattr__(self, "labels", labels)
        object.__setattr__(self, "kinds", self.kinds or ("pose",) * count)

    @property
    def robots(self) -> dict[str, Robot]:
        """``"nominal"`` and, if there is one, ``"calibrated"``."""
        both = {"nominal": self.nominal}
        return both if self.calibrated is None else {**both, "calibrated": self.calibrated}

    @property
    def measures(self) -> bool:
        """Whether any row tells where the target was."""
        return bool(np.any(np.isfinite(self.measured)))

    @property
    def predicted(self) -> Array:
        """Where each robot puts the target, in the base, shape (2, N, 3), [m]; of one robot twice."""
        nominal = self.T_base_nominal @ self.nominal.poses(self.q) @ self.nominal_target
        other = (self.calibrated or self.nominal).poses(self.q) @ self.calibrated_target
        return np.array([nominal[:, :3, 3], other[:, :3, 3]])


def view_of(calibration: Calibration) -> View:
    """The view of a calibration: every row a pose."""
    c, m, tracker = calibration, calibration.measurements, calibration.cell.tracker
    before = Evaluation(c.nominal, m, c.nominal_setup, (), c.residual_nominal, c.used)
    after = Evaluation(c.robot, m, c.setup, (), c.residual_calibrated, c.used)
    shown = _at_rows(before, after, flagged_rows(c))
    if tracker is not None and not len(shown.instruments):  # points measured in the base itself
        shown = replace(shown, instruments=translation(tracker.position)[None])
    return _judged(replace(shown, title=f"{c.nominal.name or 'Robot'}: nominal and calibrated"), c)


def view_of_result(
    result: Calibration,
    robot: Robot,
    table: Measurements | None = None,
    cell: Cell | None = None,
    *,
    known: Sequence[str] = PLACES,
    source: str = "the result",
) -> View:
    """A robot with the origins before and after a result that was read from a file, at the rows of a table.

    Errors are those of the result's frames and targets, as `calib.evaluate` finds them; ``known`` says which of them
    the result has, not the cell. Without a table two robots go through poses over the joint limits. Rows that the fit
    flagged are marked if the table is the one that was fitted. ``source`` is what the result is called.
    """
    cell = cell or Cell()
    both = result.uncorrected(robot), result.corrected(robot)
    setups = result.nominal_setup, result.setup
    if table is None:
        shown = view_of_robots(*both, cells=(cell, cell))
        if "target" in known:
            first, second = (setup.T_tip_target[0] for setup in setups)
            shown = replace(shown, nominal_target=first, calibrated_target=second)
    else:
        before, after = (
            evaluate(one, table, cell, known=setup, which=tuple(known))
            for one, setup in zip(both, setups, strict=True)
        )
        rows = [one.row for one in (*result.outliers, *result.suspects)]
        same = result.source.sha256 == table.sha256
        shown = _at_rows(before, after, np.isin(table.rows, rows) & same)
    origins = ("Nominal", "before the calibration"), ("Calibrated", f"joint origins of {source}")
    return _judged(replace(shown, names=origins), result)


def view_of_robots(
    nominal: Robot,
    calibrated: Robot | None = None,
    table: Measurements | None = None,
    *,
    cells: Sequence[Cell] | None = None,
    names: Names | None = None,
) -> View:
    """One or two robots at the rows of a table, with the errors that `calib.evaluate` finds.

    Without a table two robots go through poses spread over the joint limits, and one moves one joint after the other.
    ``cells`` have target and frame of each robot, where they are known; ``names`` what the robots are called, and what
    that means, by default nominal and calibrated, and their files.
    """
    cells = cells or [Cell()] * 2
    robots = [nominal] if calibrated is None else [nominal, calibrated]
    title = nominal.name if calibrated is None else ""
    words = (title or "Nominal", "Calibrated")
    names = names or [(w, Path(r.urdf.source).name) for w, r in zip(words, robots, strict=False)]
    if table is not None:
        found = [evaluate(one, table, cell) for one, cell in zip(robots, cells, strict=False)]
        none = np.zeros(len(table), dtype=np.bool_)
        shown = _at_rows(found[0], found[1] if len(found) > 1 else None, none)
        return replace(shown, names=names, title=title)
    if calibrated is None:
        q, labels = _one_joint_after_the_other(nominal)
    else:
        q = spread_poses(nominal, _POSES)
        labels = tuple(f"pose {k + 1} of {len(q)} over the joint limits" for k in range(len(q)))
    points = [[*cell.targets.values(), cell.target] for cell in cells]
    targets = [translation((0.0, 0.0, 0.0) if own[0] is None else own[0]) for own in points]
    view = View(nominal, calibrated, q, labels, names=names, title=title)
    return replace(view, nominal_target=targets[0], calibrated_target=targets[-1])


def view_of_comparison(comparison: Comparison) -> View:
    """The view of two results of one robot, with the first one's target, each in the base as its own fit has it.

    The poses are not measured ones: they are spread over the joint limits, and their labels say so.
    """
    c = comparison
    view = view_of_robots(
        *c.robots,
        names=((f"a: {c.names[0]}", "the first result"), (f"b: {c.names[1]}", "the second result")),
    )
    title, target = f"{c.a.nominal.name or 'Robot'}: two calibrations", translation(c.a.target)
    view = replace(view, nominal_target=target, calibrated_target=target)
    return replace(view, title=title, note=sentence(c))


def _judged(view: View, c: Calibration) -> View:
    """The view with the verdict of a result and its first reason."""
    if c.verdict is None:
        return replace(view, note="No verdict: nothing was cross-validated.")
    return replace(
        view, verdict=c.verdict.use, note=" ".join(map(reason_text, c.verdict.reasons[:1]))
    )


def _at_rows(first: Evaluation, second: Evaluation | None, flagged: Mask) -> View:
    """One or two robots at the rows of a table; of many rows at an even choice, with flagged ones.

    Shown first is the row where the nominal robot is furthest off, of the validation rows if there are any, flagged
    ones aside.
    """
    m, last, count = first.measurements, second or first, len(flagged)
    errors = np.array([lengths_of(one.residual, one.used) for one in (first, last)])
    angles = np.array([angles_of(one.residual, one.used) for one in (first, last)])
    rank = np.where(flagged, 0.0, np.where(m.validation, 2e6, 1e6))
    start = int(np.argmax(np.where(np.isfinite(errors[0]), rank + errors[0], -1.0)))
    at = np.arange(count)
    if count > MOST_ROWS:
        evenly = np.linspace(0, count - 1, MOST_ROWS - 50).round().astype(int)
        at = np.unique([start, *np.flatnonzero(flagged)[:49], *evenly])
    T_frame_nominal, nominal_target = placed(first.setup, m)
    T_frame_base, calibrated_target = placed(last.setup, m)
    T_base_frame = rigid_inverse(T_frame_base)
    # The error in the picture is then that of the tables, not where each of the two finds the tracker. Where nothing
    # tells a place, neither finds where it stands: the two share their base.
    places = np.any(m.where(lambda kind: kind.coordinates))
    T_base_nominal = T_base_frame @ T_frame_nominal if places else np.eye(4)
    elsewhere = np.max(np.abs(T_base_frame - np.eye(4)), axis=(1, 2)) > _THE_BASE
    kinds = np.where(flagged, "flagged", np.where(m.validation, "validation", "estimation"))
    return View(
        nominal=first.robot,
        calibrated=None if second is None else second.robot,
        q=m.joints_for(first.robot.joint_names)[at],
        labels=tuple(f"row {m.rows[k]}" for k in at),
        kinds=tuple(kinds[at].tolist()),
        nominal_target=nominal_target[at],
        calibrated_target=calibrated_target[at],
        T_base_nominal=np.broadcast_to(T_base_nominal, (count, 4, 4))[at],
        measured=measured_in_base(m, T_frame_base)[at],
        errors=errors[:, at],
        angles=angles[:, at],
        instruments=np.unique(T_base_frame[m.positions & elsewhere], axis=0),
        start=int(np.searchsorted(at, start)),
        rows=count if count > MOST_ROWS else 0,
    )


def _one_joint_after_the_other(robot: Robot) -> tuple[Array, tuple[str, ...]]:
    """Poses in which each joint in turn goes through its range, and what they are called."""
    ranges = column_ranges(robot)
    middle = np.clip(0.0, ranges[:, 0], ranges[:, 1])
    poses, labels = [middle], ["all joints at zero, or as near as they can be"]
    for k, joint in enumerate(robot.inputs):
        scale, unit = (1e3, "mm") if joint.type == "prismatic" else (np.degrees(1.0), "deg")
        for value in np.linspace(ranges[k, 0], ranges[k, 1], 9):
            poses.append(np.where(np.arange(len(middle)) == k, value, middle))
            labels.append(f"{joint.name} at {scale * value:.4g} {unit}")
    return np.array(poses), tuple(labels)
