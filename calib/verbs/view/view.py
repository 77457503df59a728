"""The content of a page of robots: robots, poses, measured targets and errors; values only.

At the rows of a table each row is a pose; of robots alone poses are spread over the joint limits.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from calib.basics.arrays import Array, Integers, Mask, rigid_inverse
from calib.basics.values import ReadOnlyMapping
from calib.camera.camera import Camera
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.errors import ModelError, choices
from calib.result.calibration import Calibration
from calib.robot.ranges import column_ranges, spread_poses
from calib.robot.robot import Robot
from calib.show.row_values import (
    flagged_rows,
    measured_in_base,
    setup_of_rows,
)
from calib.show.scene.puppet import translation
from calib.show.verdict import against, reason_text
from calib.verbs.evaluate.evaluation import PLACES, Evaluation, evaluate
from calib.verbs.view.sight import Sight, sight_of
from calib.verbs.view.standing import standing
from calib.verbs.view.steps import steps_of

#: Name of each of two robots, and a description that stands below it.
Names = Sequence[tuple[str, str]]

#: Poses of two robots without a table.
_POSES = 24

#: Poses of each joint of a robot alone.
_POSES_PER_JOINT = 9

#: Where nothing is known of cameras.
NO_CAMERAS: Mapping[str, Camera] = ReadOnlyMapping()

#: A station whose frame is nearer to the base than this [m, rad] is the base.
_SAME_FRAME = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """The content of a page: N poses, one of them at a time, and the marks of all of them.

    Fields that are not given are filled in.

    Raises:
        ModelError: The robots have different joints.
    """

    #: The robot before calibration
    nominal: Robot
    #: The robot after it, the same chain; None to show one robot alone
    calibrated: Robot | None
    #: Shape (N, m), [rad] or [m], in the order of ``nominal.joint_names``
    q: Array
    #: Name of each pose, such as ``"row 31"``
    labels: tuple[str, ...] = ()
    #: ``"estimation"``, ``"validation"``, ``"flagged"`` or, where nothing was measured, ``"pose"``
    kinds: tuple[str, ...] = ()
    #: shape (N, 4, 4) or (4, 4), T_tip_target of the nominal robot [m]
    nominal_target: Array = field(default_factory=lambda: np.eye(4))
    #: Of the calibrated one
    calibrated_target: Array = field(default_factory=lambda: np.eye(4))
    #: shape (N, 4, 4) or (4, 4), base of the nominal robot in the calibrated one's as each was registered [m]
    T_base_nominal: Array = field(default_factory=lambda: np.eye(4))
    #: shape (N, 3), the measured targets in the base [m]; NaN where nothing was measured
    measured: Array = field(default_factory=lambda: np.array(np.nan))
    #: shape (2, N), norm of each robot's residual by the unit's symbol; NaN where a row measures nothing in it
    errors: Mapping[str, Array] = field(default_factory=dict)
    #: shape (K, 4, 4), frames of the stations in the base [m], but for those that are the base
    instruments: Array = field(default_factory=lambda: np.zeros((0, 4, 4)))
    #: Index of the pose shown first, from 0
    start: int = 0
    #: Number of rows of the table, where those shown are a choice; 0 where all are shown
    rows: int = 0
    #: The page's heading
    title: str = ""
    #: Verdict of the calibration; empty without one
    verdict: str = ""
    #: A sentence below the heading, such as the verdict's first reason
    note: str = ""
    #: Cameras, boards and the corners of each step, where the steps are images
    sight: Sight | None = None
    #: Name and description of each robot
    names: Names = (("Nominal", "the URDF as given"), ("Calibrated", "the corrected URDF"))
    #: What is shown in words for each pose, by the name of it: N texts, such as a joint's values with their unit
    numbers: Mapping[str, Sequence[str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Fill in fields that were not given, and broadcast arrays to their shapes."""
        self._check_joints()
        count = len(self.q)
        shapes = {
            "measured": (count, 3),
            "nominal_target": (count, 4, 4),
            "calibrated_target": (count, 4, 4),
            "T_base_nominal": (count, 4, 4),
        }
        for name, shape in shapes.items():
            object.__setattr__(self, name, np.broadcast_to(getattr(self, name), shape))
        errors = {
            unit: np.broadcast_to(of_unit, (2, count)) for unit, of_unit in self.errors.items()
        }
        object.__setattr__(self, "errors", ReadOnlyMapping(errors))
        object.__setattr__(self, "numbers", ReadOnlyMapping(self.numbers))
        labels = self.labels or tuple(f"pose {k + 1}" for k in range(count))
        object.__setattr__(self, "labels", labels)
        object.__setattr__(self, "kinds", self.kinds or ("pose",) * count)

    def _check_joints(self) -> None:
        """Refuse two robots with different joints."""
        nominal = self.nominal.joint_names
        if self.calibrated is not None and self.calibrated.joint_names != nominal:
            raise ModelError(
                f"The nominal robot has the joints {choices(nominal)}, the calibrated one "
                f"{choices(self.calibrated.joint_names)}. Show two robots with the same chain."
            )

    @property
    def robots(self) -> dict[str, Robot]:
        """The robots by ``"nominal"`` and, if there is one, ``"calibrated"``."""
        robots = {"nominal": self.nominal}
        if self.calibrated is not None:
            robots["calibrated"] = self.calibrated
        return robots

    @property
    def measures(self) -> bool:
        """True if any row measures the target's position."""
        return bool(np.any(np.isfinite(self.measured)))

    @property
    def is_registered_apart(self) -> bool:
        """True if the bases of the two robots were registered at different places."""
        return not np.allclose(self.T_base_nominal, np.eye(4), 0.0, _SAME_FRAME)

    @property
    def predicted(self) -> Array:
        """Target of each robot as registered, in the calibrated one's base, (2, N, 3) [m]; of one robot twice."""
        T_base_first = self.T_base_nominal @ self.nominal.poses(self.q) @ self.nominal_target
        second = self.calibrated or self.nominal
        T_base_second = second.poses(self.q) @ self.calibrated_target
        return np.array([T_base_first[:, :3, 3], T_base_second[:, :3, 3]])


def view_of(calibration: Calibration, *, accepted: bool = False) -> View:
    """Return the view of a calibration: every row a pose.

    Args:
        calibration: The result.
        accepted: The corrected URDF is used whatever the verdict says.
    """
    c = calibration
    m = c.fit.measurements
    before = Evaluation(c.nominal, m, c.nominal_setup, (), c.rows.residual_nominal, c.rows.channels)
    after = Evaluation(c.robot, m, c.setup, (), c.rows.residual_calibrated, c.rows.channels)
    view = _at_rows(before, after, flagged_rows(c), c.optics.cameras)
    names = (view.names[0], ("Calibrated", _calibrated_is(c, accepted=accepted)))
    view = replace(view, title=f"{c.nominal.name or 'Robot'}: nominal and calibrated", names=names)
    return _with_verdict(view, c)


def _calibrated_is(c: Calibration, *, accepted: bool) -> str:
    """Describe the calibrated robot: what its URDF is, if it has one.

    Args:
        c: The calibration.
        accepted: The corrected URDF is used whatever the verdict says.
    """
    if np.array_equal(c.robot.placements, c.nominal.placements):
        return "unchanged: no joint origin was corrected"
    if not against(c.verdict):
        return "the corrected URDF"
    if accepted:
        return "the corrected URDF, accepted all the same"
    return "as fitted, not to be used: no URDF is written"


def view_of_result(
    result: Calibration,
    robot: Robot,
    table: Measurements | None = None,
    cell: Cell | None = None,
    *,
    known: Sequence[str] = PLACES,
    source: str = "the result",
) -> View:
    """Return the view of a robot with the joint origins before and after a result that was read from a file.

    Args:
        result: The result.
        robot: The robot, nominal or corrected.
        table: The rows that are shown; rows that the fit flagged are marked if the fit used this table. None for
            poses over the joint limits.
        cell: Frames and targets that the result does not give.
        known: Those of ``"frame"`` and ``"target"`` that are the result's, not the cell's.
        source: Name of the result on the page.

    Returns:
        The view; its errors are those of `calib.evaluate`.
    """
    cell = result.optics.given_to(cell or Cell())
    before = result.uncorrected(robot)
    after = result.corrected(robot)
    if table is None:
        view = view_of_robots(before, after, cells=(cell, cell))
        if "target" in known:
            first = result.nominal_setup.T_tip_target[0]
            second = result.setup.T_tip_target[0]
            view = replace(view, nominal_target=first, calibrated_target=second)
    else:
        which = tuple(known)
        first = evaluate(before, table, cell, known=result.nominal_setup, which=which)
        second = evaluate(after, table, cell, known=result.setup, which=which)
        view = _at_rows(
            first, second, _flagged_by(result, table), result.optics.cameras or cell.cameras
        )
    origins = f"joint origins of {source}"
    if np.array_equal(before.placements, after.placements):
        origins = "unchanged: no joint origin was corrected"
    names = (("Nominal", "before the calibration"), ("Calibrated", origins))
    return _with_verdict(replace(view, names=names), result)


def _flagged_by(result: Calibration, table: Measurements) -> Mask:
    """Return the rows of a table (N,) that a result flagged; none if it is not the table that was fitted."""
    numbers = [outlier.row for outlier in (*result.rows.outliers, *result.rows.suspects)]
    is_same_table = result.source.sha256 == table.sha256
    return np.isin(table.rows, numbers) & is_same_table


def view_of_robots(
    nominal: Robot,
    calibrated: Robot | None = None,
    table: Measurements | None = None,
    *,
    cells: Sequence[Cell] = (Cell(), Cell()),
    names: Names = (),
) -> View:
    """Return the view of one or two robots.

    Args:
        nominal: The first robot.
        calibrated: The second one, of the same chain; None to show one robot alone.
        table: The rows that are shown, with the errors of `calib.evaluate`. None: two robots go through poses spread
            over the joint limits, and one moves one joint after the other.
        cells: Target and frame of each robot, where they are known.
        names: Name and description of each robot; by default nominal and calibrated, and their files.
    """
    title = nominal.name if calibrated is None else ""
    names = names or _default_names(nominal, calibrated)
    if table is not None:
        first = evaluate(nominal, table, cells[0])
        second = evaluate(calibrated, table, cells[1]) if calibrated else None
        view = _at_rows(first, second, np.zeros(len(table), bool), cells[-1].cameras)
        return replace(view, names=names, title=title)
    q, labels = _poses_without_table(nominal, alone=calibrated is None)
    targets = [_first_target(cell) for cell in cells]
    view = View(nominal, calibrated, q, labels, names=names, title=title)
    if calibrated is None:
        view = replace(view, numbers=joint_texts(nominal, q))
    return replace(view, nominal_target=targets[0], calibrated_target=targets[-1])


def _default_names(nominal: Robot, calibrated: Robot | None) -> Names:
    """Return name and file of each robot: nominal and calibrated, or of one robot alone its name."""
    file = Path(nominal.urdf.source).name
    if calibrated is None:
        return [(nominal.name or "Nominal", file)]
    return [("Nominal", file), ("Calibrated", Path(calibrated.urdf.source).name)]


def _first_target(cell: Cell) -> Array:
    """Return T_tip_target, (4, 4), [m], of a cell's only or first target; the tip where it has none."""
    point = next(iter(cell.targets.values()), cell.target)
    return translation((0.0, 0.0, 0.0) if point is None else point)


def _poses_without_table(robot: Robot, *, alone: bool) -> tuple[Array, tuple[str, ...]]:
    """Return joint values (N, m) [rad or m] and their labels: of one robot ``alone``, one joint after the other."""
    if alone:
        return _one_joint_after_the_other(robot)
    q = spread_poses(robot, _POSES)
    labels = [f"pose {k + 1} of {len(q)} over the joint limits" for k in range(len(q))]
    return q, tuple(labels)


def _with_verdict(view: View, c: Calibration) -> View:
    """Return the view with the verdict of a result and its first reason."""
    if c.verdict is None:
        return replace(view, note="No verdict: the result was not cross-validated.")
    note = ""
    if c.verdict.reasons:
        note = reason_text(c.verdict.reasons[0])
    return replace(view, verdict=c.verdict.use, note=note)


def _at_rows(
    first: Evaluation,
    second: Evaluation | None,
    flagged: Mask,
    cameras: Mapping[str, Camera] = NO_CAMERAS,
) -> View:
    """Return the view of one or two robots at the rows of a table, or at its images.

    Args:
        first: The first robot's residuals.
        second: The second robot's of the same rows; None to show one robot alone.
        flagged: shape (N,), the flagged rows.
        cameras: Cameras of images by their stations; without any, neither they nor boards are drawn.

    Returns:
        The view of all steps, or of an even choice of many, with flagged ones; a typical one is shown first.
    """
    chain = first.robot
    first = standing(first)
    second = standing(second) if second is not None else None
    last = second or first
    steps = steps_of(first, last, flagged)
    sight = sight_of(first, last, steps, cameras, carries_camera=first.robot is not chain)
    at = steps.shown
    view = _at_steps(first, last, steps.m, at)
    view = replace(
        view,
        labels=tuple(steps.labels[k] for k in at),
        kinds=tuple(steps.kinds[k] for k in at),
        errors={unit: of_unit[:, at] for unit, of_unit in steps.errors.items()},
        start=int(np.searchsorted(at, steps.start)),
        sight=sight.at(at) if sight is not None else None,
    )
    if second is not None:
        view = replace(view, calibrated=second.robot)
    if len(at) < len(steps.flagged):
        view = replace(view, rows=len(steps.flagged))
    return view


def _at_steps(first: Evaluation, last: Evaluation, m: Measurements, at: Integers) -> View:
    """Return the view of the first robot alone, with poses and places.

    Args:
        first: The first robot's frames and targets.
        last: Those in whose base everything is.
        m: One row of each of N steps.
        at: Indices of those that are shown, from 0.
    """
    nominal_target = setup_of_rows(first.setup, m)[1]
    T_frame_base, calibrated_target = setup_of_rows(last.setup, m)
    return View(
        nominal=first.robot,
        calibrated=None,
        q=m.joints_for(first.robot.joint_names)[at],
        nominal_target=nominal_target[at],
        calibrated_target=calibrated_target[at],
        T_base_nominal=_bases_of_first(first, last, m)[at],
        measured=measured_in_base(m, T_frame_base)[at],
        instruments=_stations(m, T_frame_base),
    )


def _bases_of_first(first: Evaluation, last: Evaluation, m: Measurements) -> Array:
    """Return the base of the first robot in the last one's at the rows ``m``, shape (N, 4, 4), [m].

    Both are seen from the same station, so that the errors in the picture are those of the tables. Where no row
    measures a position, neither estimates its place: the two robots share their base.
    """
    if not np.any(m.where(lambda kind: kind.coordinates)):
        return np.broadcast_to(np.eye(4), (len(m), 4, 4))
    T_frame_first, _ = setup_of_rows(first.setup, m)
    T_frame_last, _ = setup_of_rows(last.setup, m)
    return rigid_inverse(T_frame_last) @ T_frame_first


def _stations(m: Measurements, T_frame_base: Array) -> Array:
    """Return the frames of stations that measured positions, in the base, (K, 4, 4) [m]; none that is the base."""
    T_base_frame = rigid_inverse(T_frame_base)
    is_base = np.all(np.isclose(T_base_frame, np.eye(4), 0.0, _SAME_FRAME), axis=(1, 2))
    return np.unique(T_base_frame[m.positions & ~is_base], axis=0)


def _one_joint_after_the_other(robot: Robot) -> tuple[Array, tuple[str, ...]]:
    """Return poses (N, m) [rad or m] in which each joint in turn goes through its range, and their labels."""
    ranges = column_ranges(robot)
    middle = np.clip(0.0, *ranges.T)
    poses = [middle]
    labels = ["all joints at zero, or as near as they can be"]
    for k, joint in enumerate(robot.inputs):
        scale, unit = _shown_unit(joint.type)
        low, high = ranges[k]
        for value in np.linspace(low, high, _POSES_PER_JOINT):
            pose = middle.copy()
            pose[k] = value
            poses.append(pose)
            labels.append(f"{joint.name} at {scale * value:.4g} {unit}")
    return robot.readings(np.array(poses)), tuple(labels)


def _shown_unit(joint_type: str) -> tuple[float, str]:
    """Return the unit that a joint's values are shown in, and its number in one SI unit, before it."""
    return (1e3, "mm") if joint_type == "prismatic" else (float(np.degrees(1.0)), "deg")


def joint_texts(robot: Robot, q: Array) -> dict[str, tuple[str, ...]]:
    """Return the values of each joint as texts with their unit.

    Args:
        robot: The robot.
        q: shape (N, m), joint values [rad or m], columns as ``robot.joint_names``.

    Returns:
        N texts by the joint's name, degrees or for sliding joints millimetres, with three decimals.
    """
    texts = {}
    for values, (name, joint_type) in zip(q.T, robot.joint_types.items(), strict=True):
        scale, unit = _shown_unit(joint_type)
        texts[name] = tuple(f"{scale * value + 0.0:.3f} {unit}" for value in values)
    return texts
