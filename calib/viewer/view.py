"""View: which robots are shown, at which poses, with what was measured there; values only.

Of a calibration every row is a pose; of robots alone poses are spread over the joint limits.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.data.measurements import Measurements
from calib.errors import ModelError, choices
from calib.estimate.setup import Setup
from calib.report.label_rows import angles_of, flagged_rows, lengths_of, measured_in_base, placed
from calib.result.calibration import Calibration
from calib.result.comparison import Comparison
from calib.result.evaluation import Evaluation
from calib.robot.readback import column_ranges, spread_between, spread_poses
from calib.robot.robot import Robot, read_only, rigid_inverse
from calib.text.comparison import sentence

Array = NDArray[np.float64]

#: What two robots are called, and what that means.
Names = tuple[tuple[str, str], tuple[str, str]]
NAMES: Names = (("Nominal", "the URDF as given"), ("Calibrated", "the corrected URDF"))

#: Poses of two robots of which nothing was measured.
_POSES = 24

#: At most this many poses are shown, and fewer where robots have many links: so many numbers of movers in all.
MOST_POSES, _MOST_MOVERS = 400, 16_000

#: Points of the cloud over the joint limits, and within the measured joint values.
EVERYWHERE, MEASURED = 4000, 2000

#: Frames nearer to the base's than this are the base's own: there is no instrument to show [m, and 1].
_THE_BASE = 1e-9

#: One robot, where its frames and targets are, and what it leaves over of which columns of each row.
_Half = tuple[Robot, Setup, Array, NDArray[np.bool_]]


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """Points of the workspace and how well the calibrated robot knows them.

    Attributes:
        points: shape (K, 3), in the base [m].
        std: shape (K,), standard deviation of the predicted position there [m].
        measured: shape (K,), whether all joint values lie within the range of the rows that were fitted.
    """

    points: Array
    std: Array
    measured: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """What is shown. N poses, one of them at a time; the marks of all of them at once.

    Attributes:
        nominal: The robot before calibration.
        calibrated: The robot after it, the same chain; None to show one robot alone.
        q: shape (N, m), [rad] or [m], the poses, in the order of ``nominal.joint_names``.
        labels: What each pose is called, such as ``"row 31"``, N of them; none for numbers from 1.
        kinds: ``"estimation"``, ``"validation"``, ``"flagged"`` or, where nothing was measured, ``"pose"``, N of them;
            none for ``"pose"``.
        nominal_target: shape (N, 4, 4) or (4, 4), T_tip_target of the nominal robot [m].
        calibrated_target: shape (N, 4, 4) or (4, 4), T_tip_target of the calibrated robot [m].
        measured: shape (N, 3), the measured targets in the base [m]; NaN where nothing was measured; may be empty.
        errors: shape (2, N), the size of what the nominal and the calibrated robot leave over of each row [m]; NaN
            where nothing was measured; empty to take the distances in the picture.
        angles: shape (2, N), likewise of orientations [rad]; may be empty.
        T_base_nominal: shape (N, 4, 4) or (4, 4), where the nominal robot stands in the calibrated one's base: the two
            find the measurement frame a little differently [m].
        instruments: shape (N, 4, 4), pose in the base of what each row was seen with, such as a tracker [m]; NaN where
            that is not known; may be empty.
        cloud: How well positions are known over the workspace; None for none.
        start: Which pose is shown first.
        rows: How many rows there are, where those shown are a choice; 0 where all are shown.
        title: The page's heading.
        verdict: What a calibration's verdict is; none for none.
        note: A sentence or two below the heading, such as what the verdict stands on.
        names: What the two robots are called, and what that means.

    Raises:
        ModelError: The robots have different joints, or an array has another shape or is not finite.
    """

    nominal: Robot
    calibrated: Robot | None
    q: Array
    labels: tuple[str, ...] = ()
    kinds: tuple[str, ...] = ()
    nominal_target: Array = field(default_factory=lambda: np.eye(4))
    calibrated_target: Array = field(default_factory=lambda: np.eye(4))
    measured: Array = field(default_factory=lambda: np.zeros((0, 3)))
    errors: Array = field(default_factory=lambda: np.zeros((2, 0)))
    angles: Array = field(default_factory=lambda: np.zeros((2, 0)))
    T_base_nominal: Array = field(default_factory=lambda: np.eye(4))
    instruments: Array = field(default_factory=lambda: np.zeros((0, 4, 4)))
    cloud: Cloud | None = None
    start: int = 0
    rows: int = 0
    title: str = ""
    verdict: str = ""
    note: str = ""
    names: Names = NAMES

    def __post_init__(self) -> None:
        """Copy the arrays, fill in what was left out, and check that all of it fits together."""
        robot, other = self.nominal, self.calibrated
        if other is not None and robot.joint_names != other.joint_names:
            raise ModelError(
                f"The nominal robot has the joints {choices(robot.joint_names)}, the calibrated one "
                f"{choices(other.joint_names)}. Show two robots with the same chain."
            )
        count = len(self.q)
        poses, gaps = (count, 4, 4), np.nan
        for name, shape, otherwise in (
            ("q", (count, len(robot.joint_names)), None),
            ("nominal_target", poses, None),
            ("calibrated_target", poses, None),
            ("T_base_nominal", poses, None),
            ("measured", (count, 3), gaps),
            ("instruments", poses, gaps),
            ("errors", (2, count), gaps),
            ("angles", (2, count), gaps),
        ):
            given = np.asarray(getattr(self, name), dtype=np.float64)
            values = given if given.size else np.full(shape, otherwise)
            values = np.broadcast_to(values, shape) if values.shape == (4, 4) else values
            if values.shape != shape or not count or (otherwise is None and np.isnan(values).any()):
                wanted = f"finite numbers of shape {shape} are wanted, for one pose at least"
                raise ModelError(f"{name} has shape {given.shape}; {wanted}.")
            object.__setattr__(self, name, read_only(values))
        for words, default in (
            ("labels", tuple(f"pose {k + 1}" for k in range(count))),
            ("kinds", ("pose",) * count),
        ):
            object.__setattr__(self, words, tuple(getattr(self, words)) or default)

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
    def distances(self) -> Array:
        """The errors as they are in the picture, from measured to predicted target, shape (2, N), [m]; or NaN."""
        return np.array([np.linalg.norm(self.measured - at, axis=1) for at in self.predicted])

    @property
    def predicted(self) -> Array:
        """Where each robot puts the target, in the base, shape (2, N, 3), [m]; of one robot twice."""
        robots = [self.nominal, self.calibrated or self.nominal]
        targets = [self.nominal_target, self.calibrated_target]
        own = [robot.poses(self.q) @ T for robot, T in zip(robots, targets, strict=True)]
        return np.array([(self.T_base_nominal @ own[0])[:, :3, 3], own[1][:, :3, 3]])

    def select(self, chosen: ArrayLike, start: int = 0) -> View:
        """Some of the poses by their numbers, and which of those chosen is shown first."""
        at = np.asarray(chosen, dtype=int)
        new: dict[str, object] = {"start": start, "rows": self.rows or len(self.q)}
        for name in ("q", "nominal_target", "calibrated_target", "measured", "T_base_nominal"):
            new[name] = getattr(self, name)[at]
        for name in ("labels", "kinds"):
            new[name] = tuple(getattr(self, name)[i] for i in at)
        new |= {"errors": self.errors[:, at], "angles": self.angles[:, at]}
        return replace(self, instruments=self.instruments[at], **new)  # type: ignore[arg-type]


def thinned(view: View) -> View:
    """The view, or a choice of its poses where they are many: the first one shown, flagged ones, others evenly."""
    count = len(view.q)
    most = max(1, min(MOST_POSES, _MOST_MOVERS // (len(view.nominal.urdf.links) + 3)))
    if count <= most:
        return view
    flagged = np.array(view.kinds) == "flagged"
    kept = np.union1d(_spread(np.flatnonzero(flagged), most // 4), [view.start])
    rest = np.setdiff1d(np.flatnonzero(~flagged), kept)
    chosen = np.union1d(kept, _spread(rest, max(most - len(kept), 0)))
    return view.select(chosen, int(np.searchsorted(chosen, view.start)))


def _spread(numbers: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    """At most so many of some numbers, evenly spread."""
    if len(numbers) <= most:
        return numbers
    at = np.linspace(0, len(numbers) - 1, most).round().astype(int)
    return numbers[at] if most else numbers[:0]


def translated(point: ArrayLike) -> Array:
    """A pose without rotation, shape (4, 4): that of a target of which only the place is known, shape (3,), [m]."""
    T = np.eye(4)
    T[:3, 3] = point
    return T


def view_of(calibration: Calibration, *, cloud: bool = True) -> View:
    """The view of a calibration: every row a pose, with the ``cloud`` of how well positions are known if asked for.

    Shown first is the one where the nominal robot is furthest off, of the validation rows if there are any, flagged
    ones aside.
    """
    c, m = calibration, calibration.measurements
    flagged = frozenset(np.array(m.rows)[flagged_rows(c)].tolist())
    shown = _view_of_rows(
        m,
        (c.nominal, c.nominal_setup, c.residual_nominal, c.used),
        (c.robot, c.setup, c.residual_calibrated, c.used),
        flagged,
    )
    if c.cell.tracker is not None:  # the instrument of points that were measured in the base itself
        seen = (m.positions & np.isnan(shown.instruments[:, 0, 0]))[:, None, None]
        where = np.where(seen, translated(c.cell.tracker.position), shown.instruments)
        shown = replace(shown, instruments=where)
    reasons = ["No verdict: nothing was cross-validated."]
    return replace(
        shown,
        cloud=cloud_of(c) if cloud else None,
        title=f"{c.nominal.name or 'Robot'}: nominal and calibrated",
        verdict="" if c.verdict is None else c.verdict.use,
        note=" ".join(reasons if c.verdict is None else map(str, c.verdict.reasons[:1])),
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
        after: _Half | None = None
        if calibrated is not None and second is not None:
            after = (calibrated, second.setup, second.residual, second.used)
        before = (nominal, first.setup, first.residual, first.used)
        shown = _view_of_rows(first.measurements, before, after, flagged)
    elif calibrated is None:
        shown = _one_joint_after_the_other(nominal)
        title = title or nominal.name
    else:
        q = spread_poses(nominal, _POSES)
        labels = tuple(f"pose {k + 1} of {len(q)} over the joint limits" for k in range(len(q)))
        shown = View(nominal, calibrated, q, labels)
    return replace(shown, names=names, title=title, verdict=verdict, note=note)


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


def _view_of_rows(
    m: Measurements, first: _Half, second: _Half | None, flagged: frozenset[int]
) -> View:
    """The view of one or two robots at the rows of a table."""
    T_frame_nominal, nominal_target = placed(first[1], m)
    T_frame_base, calibrated_target = placed((second or first)[1], m)
    T_base_frame = rigid_inverse(T_frame_base)
    # Its error in the picture is then that of the tables, not where each of the two finds the tracker. Where nothing
    # tells a place, neither finds where it stands: the two share their base.
    places = np.any(m.where(lambda kind: kind.coordinates))
    elsewhere = np.max(np.abs(T_base_frame - np.eye(4)), axis=(1, 2)) > _THE_BASE
    kinds = np.where(m.validation, "validation", "estimation").astype(object)
    kinds[np.isin(m.rows, list(flagged))] = "flagged"
    halves = [(residual, used) for _, _, residual, used in (first, second or first)]
    errors = np.array([lengths_of(*half) for half in halves])
    return View(
        nominal=first[0],
        calibrated=None if second is None else second[0],
        q=m.joints_for(first[0].joint_names),
        labels=tuple(f"row {row}" for row in m.rows),
        kinds=tuple(kinds),
        nominal_target=nominal_target,
        calibrated_target=calibrated_target,
        measured=measured_in_base(m, T_frame_base),
        errors=errors,
        angles=np.array([angles_of(*half) for half in halves]),
        T_base_nominal=T_base_frame @ T_frame_nominal if places else np.eye(4),
        instruments=np.where((m.positions & elsewhere)[:, None, None], T_base_frame, np.nan),
        start=_worst(errors[0], kinds),
    )


def _worst(lengths: Array, kinds: NDArray[np.object_]) -> int:
    """The row with the largest length, of validation rows if there are any, flagged ones aside."""
    for wanted in ("validation", "estimation", "flagged"):
        chosen = (kinds == wanted) & np.isfinite(lengths)
        if np.any(chosen):
            return int(np.argmax(np.where(chosen, lengths, -1.0)))
    return 0


def _one_joint_after_the_other(robot: Robot) -> View:
    """Poses in which each joint in turn goes through its range."""
    ranges = column_ranges(robot)
    middle = np.clip(0.0, ranges[:, 0], ranges[:, 1])
    poses, labels = [middle], ["all joints at zero, or as near as they can be"]
    for k, joint in enumerate(robot.inputs):
        scale, unit = (1e3, "mm") if joint.type == "prismatic" else (np.degrees(1.0), "deg")
        for value in np.linspace(ranges[k, 0], ranges[k, 1], 9):
            poses.append(np.where(np.arange(len(middle)) == k, value, middle))
            labels.append(f"{joint.name} at {scale * value:.4g} {unit}")
    return View(robot, None, np.array(poses), tuple(labels))
