"""Usual mistakes of an input: where a nominal arm is off by centimetres, each one is undone in a trial.

In each trial the target is registered anew. Explanations that the rows cannot tell apart are all named.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

import calib.data.kinds as registry
from calib.basics.arrays import Array
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.diagnosis.images.poses import as_poses
from calib.diagnosis.joint_mistakes import joint_trials
from calib.diagnosis.misfit import TOLERANCE, misfit, with_joints
from calib.diagnosis.orientation_mistakes import (
    FAR_BETTER,
    PLAUSIBLE,
    PLAUSIBLE_ANGLE,
    orientation_mistake,
)
from calib.diagnosis.reasons import Reason, Why
from calib.errors import MeasurementError, UrdfError
from calib.fit.registration.registration import register
from calib.fit.registration.rows import Rows
from calib.fit.registration.setup import Setup
from calib.fit.registration.table_rows import rows_and_setup
from calib.model.error_model import DIRECTIONS
from calib.robot.robot import Robot

#: And to no more than this [m].
_EXPLAINED = 0.05

#: Explanations whose errors are within this factor cannot be told apart: errors of an uncalibrated arm may favour any.
_AS_GOOD = 1.5

#: Errors that differ by less are the same [m].
_ROUNDING = 1e-6

#: The most joints of which every combination of reversed signs is tried.
_MOST_SIGNS = 7

#: The most rows that are looked at, evenly over the table.
_ROWS = 60

#: The fewest rows that determine an unknown frame: it takes six numbers, and a target three.
_FEWEST_ROWS_OF_FRAME = 4

#: Ranges about the last value in which the value of a joint without values is sought, one after the other [rad].
_REACHES = (np.pi, np.pi, np.pi, 0.2, 0.2, 0.02, 0.002)

#: Values that are tried in each range.
_TRIED = 41

#: The fewest joints that carry another tip: on the axes of two joints a target stands still, as points in a wrong unit
#: nearly do.
_FEWEST_JOINTS_OF_TIP = 3

#: Factors where lengths are in one unit and their header says another.
_LENGTHS = {("in", "mm"): 25.4, ("mm", "in"): 1.0 / 25.4, ("m", "mm"): 1e3, ("mm", "m"): 1e-3}

#: Positions that differ by less are one position [m].
_ONE_PLACE = 1e-6

#: A tip that moves by more than this cannot have stayed at one position [m].
_FAR_APART = 1e-2

#: Factor on the error of a trial without a further unknown, when trials are ranked.
_PLAIN = 1.0

#: Factor on the error of a trial that is one of many of its sort: one of these fits a little better by chance.
_ONE_OF_MANY = 1.2

#: Factor on the error of a trial with further freedom: another tip, or a joint whose values are sought.
_FREE = 1.5

#: Factor on the error of a trial with an unknown frame, which always fits a little better.
_FREE_FRAME = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """An input in which a mistake is undone."""

    #: Factor on the trial's error when trials are ranked; the freer the trial, the larger
    factor: float
    #: The nominal robot, perhaps with another base or tip
    robot: Robot
    #: Frames and targets, with what is registered anew
    setup: Setup
    #: The rows, as points
    rows: Rows
    #: Code of the mistake
    why: Why
    #: Numbers and names of its reason, errors aside
    values: dict[str, Any] = field(default_factory=dict)


def check_positions(robot: Robot, rows: Rows, source: str) -> None:
    """Refuse measured positions that are all the same though the joint values move the tip: any fit would collapse.

    Args:
        robot: The nominal robot.
        rows: The rows of the table.
        source: The table's file; may be empty.

    Raises:
        MeasurementError: They are all the same; the text names the file and the place.
    """
    chosen = rows.where(lambda kind: kind.position)
    if np.sum(chosen) < 2:
        return
    points = rows.measured[chosen, :3]
    tips = robot.poses(rows.joints[chosen])[:, :3, 3]
    apart = float(np.max(np.ptp(tips, axis=0)))
    if np.max(np.ptp(points, axis=0)) > _ONE_PLACE or apart < _FAR_APART:
        return
    place = ", ".join(f"{1e3 * value:.3f}" for value in points[0])
    raise MeasurementError(
        f"{source or 'Measurements'}: all {len(points)} measured positions are ({place}) mm, while the joint values "
        f"move the tip by up to {1e3 * apart:.0f} mm. Give what was measured at each pose; if the target stayed in a "
        "socket, say --kind fixed and leave x, y and z out."
    )


def find_usual_mistake(robot: Robot, cell: Cell, table: Measurements) -> Reason | None:
    """Find a usual mistake that explains why the nominal robot is far off the rows of a table.

    Of poses the positions are examined first; several targets and frames are examined together.

    Args:
        robot: The nominal robot.
        cell: The cell as given.
        table: Points or poses; other kinds are not examined.

    Returns:
        The mistake, with the rms errors as given and with it undone [m] (of orientations [rad]), and others that
        explain the rows as well; None if the nominal error is plausible or no mistake explains it.
    """
    if len(table) and np.all(table.where(lambda kind: kind.optical)):
        of_images, cell_of_poses = as_poses(robot, cell, table)
        return _of_images(find_usual_mistake(robot, cell_of_poses, of_images), robot)
    if not np.all(table.of_kind("point", "pose")):
        return None
    table = _some_rows(table)
    cell = _naming_only(cell, table)
    poses, setup = rows_and_setup(robot, table, cell)
    rows = _as_points(poses)
    given = misfit(robot, setup, rows)[0]
    if given < PLAUSIBLE:
        return orientation_mistake(robot, setup, poses)
    usual = itertools.chain(
        _trials(robot, cell, setup, rows),
        _tips(robot, cell, table),
        _constant_joints(robot, setup, rows),
        _inverted(robot, setup, poses),
    )
    counts_by_search = _counts_of_turned_joints(robot, setup)
    turned = [_turned_joints(robot, setup, rows, counts) for counts in counts_by_search]
    searches = [itertools.chain(usual, turned[0]), *turned[1:]]
    for trials in searches:
        explanations = _explanations(trials, given, poses)
        if explanations:
            return _all_as_good(explanations)
    return None


def _of_images(mistake: Reason | None, robot: Robot) -> Reason | None:
    """Word a mistake of poses as that of the images from which these poses are.

    Args:
        mistake: The mistake; None: none.
        robot: The robot: its base carries the camera, its tip the board.
    """
    if mistake is None or mistake.why is not Why.POSES_INVERSE:
        return mistake
    links = {"base": robot.base, "tip": robot.tip}
    return Reason.of(Why.CAMERA_ON_OTHER_LINK, **mistake.values, **links)


def _some_rows(table: Measurements) -> Measurements:
    """Copy a table with at most `_ROWS` of its rows, evenly over it."""
    count = min(len(table), _ROWS)
    numbers = np.linspace(0, len(table) - 1, count).astype(int)
    chosen = np.zeros(len(table), dtype=bool)
    chosen[numbers] = True
    return table.select(chosen)


def _counts_of_turned_joints(robot: Robot, setup: Setup) -> tuple[Sequence[int], ...]:
    """List how many joints have their sign reversed at a time, for one search after the other.

    An unknown frame makes a trial a hundred times as expensive: then two joints at most, and last.

    Returns:
        The numbers of joints that each search tries, for one or more searches; the next search is made where none
        before has explained the rows.
    """
    if any(setup.unknown):
        return (1,), (2,)
    joints = len(robot.inputs)
    most = joints if joints <= _MOST_SIGNS else 1
    return (range(1, most + 1),)


@dataclass(frozen=True, slots=True, eq=False)
class _Explanation:
    """A mistake that explains the rows."""

    #: Error of its trial times the trial's factor [m]
    weighted: float
    #: The mistake
    reason: Reason
    #: Whether the orientations of the rows speak against it
    turned: bool

    @property
    def rank(self) -> tuple[bool, float]:
        """Return the key by which explanations are sorted, the best first."""
        return self.turned, self.weighted


def _explanations(trials: Iterable[Trial], given: float, poses: Rows) -> list[_Explanation]:
    """Find the trials that explain the rows: their error is far smaller.

    Args:
        trials: The trials.
        given: The rms error of the input as given [m].
        poses: The rows as measured, points or poses.
    """
    explanations = []
    for trial in trials:
        error, _ = misfit(trial.robot, trial.setup, trial.rows)
        weighted = trial.factor * error
        if error <= _EXPLAINED and weighted <= FAR_BETTER * given:
            reason = Reason.of(trial.why, given_m=given, error_m=error, **trial.values)
            explanations.append(_Explanation(weighted, reason, _is_turned(trial, poses)))
    return explanations


def _is_turned(trial: Trial, poses: Rows) -> bool:
    """Return True if the orientations of poses are far off in a trial of other joint values."""
    is_of_joints = trial.rows.measured.shape[0] == poses.measured.shape[0] and np.array_equal(
        trial.rows.measured, poses.measured[:, :3]
    )
    if not is_of_joints or not np.all(poses.where(lambda kind: kind.orientation)):
        return False
    _, angle = misfit(trial.robot, trial.setup, with_joints(poses, trial.rows.joints))
    return angle > PLAUSIBLE_ANGLE


def _all_as_good(explanations: list[_Explanation]) -> Reason:
    """Choose the explanation of the smallest weighted error, with those that the rows cannot tell from it.

    Args:
        explanations: One or more.

    Returns:
        The reason; its value ``"others"`` lists codes and values of those that explain the rows as well, if any.
    """
    best, *others = sorted(explanations, key=lambda explanation: explanation.rank)
    limit = _AS_GOOD * best.reason.values["error_m"] + _ROUNDING
    as_good = [
        _as_values(other.reason)
        for other in others
        if other.reason.values["error_m"] <= limit and other.turned == best.turned
    ]
    if not as_good:
        return best.reason
    return replace(best.reason, values={**best.reason.values, "others": as_good})


def _as_values(reason: Reason) -> dict[str, Any]:
    """Code and values of a reason that stands behind another, without the error as given, which both share."""
    values = {name: value for name, value in reason.values.items() if name != "given_m"}
    return {"code": reason.code, **values}


def _naming_only(cell: Cell, table: Measurements) -> Cell:
    """Copy a cell without the targets and frames that it names and no row of the table sees."""
    targets = {name: place for name, place in cell.targets.items() if name in table.targets}
    frames = {name: pose for name, pose in cell.frames.items() if name in table.groups}
    return replace(cell, targets=targets, frames=frames)


def _trials(robot: Robot, cell: Cell, setup: Setup, rows: Rows) -> Iterator[Trial]:
    """Undo the usual mistakes of targets, frames, joints, the order of rows, and points, one at a time.

    Args:
        robot: The nominal robot.
        cell: The cell as given.
        setup: Its frames and targets.
        rows: Rows of points.
    """
    free = _with_unknown_targets(setup)
    if not setup.estimate_target:
        yield Trial(_PLAIN, robot, free, rows, Why.TARGET_ELSEWHERE)
    if not cell.estimate_frame and cell.T_frame_base is None:
        yield from _bases(robot, free, rows)
    for joints, why, values in joint_trials(robot, rows.joints):
        yield Trial(_ONE_OF_MANY, robot, free, with_joints(rows, joints), why, values)
    yield from _shifted_rows(robot, free, rows)
    turns = any(len(directions) == len(DIRECTIONS) for directions in setup.unknown)
    for points, why, values in _point_trials(rows.measured, turns=turns):
        other_points = replace(rows, measured=points)
        yield Trial(_ONE_OF_MANY, robot, free, other_points, why, values)


def _shifted_rows(robot: Robot, setup: Setup, rows: Rows) -> Iterator[Trial]:
    """Take the joint values of the row before, then those of the row behind, for each measurement.

    Args:
        robot: The nominal robot.
        setup: Frames and targets, with what is registered anew.
        rows: N rows of points; the first or last one falls away.
    """
    after = with_joints(rows.select(slice(1, None)), rows.joints[:-1])
    yield Trial(_ONE_OF_MANY, robot, setup, after, Why.ROWS_SHIFTED, {"later": True})
    before = with_joints(rows.select(slice(None, -1)), rows.joints[1:])
    yield Trial(_ONE_OF_MANY, robot, setup, before, Why.ROWS_SHIFTED, {"later": False})


def _bases(robot: Robot, setup: Setup, rows: Rows) -> Iterator[Trial]:
    """Try other links that are fixed to the base as the frame of the points, and an unknown frame.

    Args:
        robot: The nominal robot.
        setup: Frames and targets, with what is registered anew.
        rows: Rows of points.
    """
    moving = {joint.name for joint in robot.urdf.joints if joint.type != "fixed"}
    for link in robot.urdf.links:
        between = itertools.chain(*robot.urdf.chain(robot.base, link))
        if link != robot.base and moving.isdisjoint(between):
            other = robot.rebuilt(base=link)
            yield Trial(_PLAIN, other, setup, rows, Why.OTHER_BASE, {"link": link})
    if len(rows) >= _FEWEST_ROWS_OF_FRAME:
        unknown = replace(setup, unknown=(DIRECTIONS,) * len(setup.groups))
        yield Trial(_FREE_FRAME, robot, unknown, rows, Why.OWN_FRAME)


def _tips(robot: Robot, cell: Cell, table: Measurements) -> Iterator[Trial]:
    """Try other links that carry the target: one for each set of joints that the table has values of.

    Args:
        robot: The nominal robot.
        cell: The cell as given.
        table: Points or poses.
    """
    fixed = {joint.name for joint in robot.urdf.joints if joint.type == "fixed"}
    tried = {frozenset(robot.joint_names)}
    for link in robot.urdf.links:
        between = itertools.chain(*robot.urdf.chain(robot.base, link))
        moving = frozenset(between) - fixed
        measured = moving <= set(table.joint_names)
        if len(moving) < _FEWEST_JOINTS_OF_TIP or moving in tried or not measured:
            continue
        tried.add(moving)
        try:
            other = robot.rebuilt(tip=link)
        except UrdfError:  # the reading of a joint beyond this tip is needed
            continue
        rows, setup = rows_and_setup(other, table, cell)
        free, points = _with_unknown_targets(setup), _as_points(rows)
        yield Trial(_FREE, other, free, points, Why.OTHER_TIP, {"link": link})


def _constant_joints(robot: Robot, setup: Setup, rows: Rows) -> Iterator[Trial]:
    """Try joints whose column holds one value at the values that would explain each row.

    Args:
        robot: The nominal robot.
        setup: Frames and targets as given.
        rows: Rows of points.
    """
    free = _with_unknown_targets(setup)
    is_constant = np.ptp(rows.joints, axis=0) == 0.0
    for joint in np.flatnonzero(is_constant).tolist():
        moved = rows
        for reach in _REACHES:
            moved = _nearest_values(robot, free, moved, joint, reach)
        values = {"joint": robot.joint_names[joint]}
        yield Trial(_FREE, robot, free, moved, Why.JOINT_CONSTANT, values)


def _nearest_values(robot: Robot, setup: Setup, rows: Rows, joint: int, reach: float) -> Rows:
    """Copy rows with the value of a joint that fits each row best.

    Args:
        robot: The nominal robot.
        setup: Frames and targets, with what is registered.
        rows: Rows of points.
        joint: Number of the joint, from 0.
        reach: Largest change of its value [rad] or [m].
    """
    every = np.arange(len(rows))
    T_base_tip = robot.poses(rows.joints)
    placed = register(T_base_tip, setup, rows, tolerance=TOLERANCE)
    q = np.repeat(rows.joints, _TRIED, axis=0)
    changes = np.linspace(-reach, reach, _TRIED)
    q[:, joint] += np.tile(changes, len(rows))
    repeated = rows.select(np.repeat(every, _TRIED))
    T_frame_target = placed.target_poses(robot.poses(q), repeated.samples)
    squares = np.sum(repeated.residual(T_frame_target) ** 2, axis=1)
    nearest = np.argmin(squares.reshape(-1, _TRIED), axis=1)
    return with_joints(rows, q[every * _TRIED + nearest])


def _with_unknown_targets(setup: Setup) -> Setup:
    """Copy a setup with every target unknown."""
    return replace(setup, target_unknown=np.ones(len(setup.targets), dtype=bool))


def _as_points(rows: Rows) -> Rows:
    """Copy poses as the points of their positions."""
    kind = np.zeros(len(rows), dtype=np.int_)
    points = rows.measured[:, :3]
    return replace(rows, kinds=(registry.get("point"),), kind=kind, measured=points)


def _inverted(robot: Robot, setup: Setup, rows: Rows) -> Iterator[Trial]:
    """Invert poses, as if they were those of the frame in the target; no trial where not every row is a pose.

    Args:
        robot: The nominal robot.
        setup: Frames and targets as given.
        rows: Rows as measured, points or poses.
    """
    if not np.all(rows.where(lambda kind: kind.orientation)):
        return
    R = rows.measured[:, 3:12].reshape(-1, 3, 3)
    points = -np.einsum("nji,nj->ni", R, rows.measured[:, :3])
    inverse = replace(_as_points(rows), measured=points)
    free = _with_unknown_targets(setup)
    yield Trial(_ONE_OF_MANY, robot, free, inverse, Why.POSES_INVERSE)


def _point_trials(points: Array, *, turns: bool) -> Iterator[tuple[Array, Why, dict[str, Any]]]:
    """Mirror points, and scale them from another unit.

    Args:
        points: Measured positions, shape (N, 3) [m].
        turns: Whether their frame may turn freely: then every swap of two columns is a mirror, and so is every sign.

    Yields:
        The points, the code of the mistake, and the values of its reason.
    """
    if turns:
        yield -points, Why.POINTS_MIRRORED, {}
    else:
        yield from _mirrored_points(points)
    for (unit, header), factor in _LENGTHS.items():
        units = {"unit": unit, "header": header}
        yield factor * points, Why.WRONG_UNIT, {"what": "points", **units}
        for axis in "xyz":
            scaled = points * _factor_on_axis(axis, factor)
            yield scaled, Why.WRONG_UNIT, {"what": f"values of '{axis}'", **units}


def _mirrored_points(points: Array) -> Iterator[tuple[Array, Why, dict[str, Any]]]:
    """Swap two columns of points, and reverse the sign of one; arguments and yields as of `_point_trials`."""
    orders = {"x": [0, 2, 1], "y": [2, 1, 0], "z": [1, 0, 2]}
    for axis, order in orders.items():
        first, second = (other for other in "xyz" if other != axis)
        columns = {"first": first, "second": second}
        yield points[:, order], Why.COLUMNS_SWAPPED, columns
        turned = points * _factor_on_axis(axis, -1.0)
        yield turned, Why.SIGN_TURNED, {"column": axis}


def _factor_on_axis(axis: str, factor: float) -> Array:
    """Factors on x, y and z, shape (3,): the given one on one axis, ``"x"``, ``"y"`` or ``"z"``, else 1."""
    return np.array([factor if other == axis else 1.0 for other in "xyz"])


def _turned_joints(
    robot: Robot,
    setup: Setup,
    rows: Rows,
    counts: Iterable[int],
) -> Iterator[Trial]:
    """Reverse the sign of joints.

    Args:
        robot: The nominal robot.
        setup: Frames and targets as given.
        rows: Rows of points.
        counts: Numbers of joints that are reversed at a time, each in every combination.
    """
    every = range(len(robot.inputs))
    free = _with_unknown_targets(setup)
    for count in counts:
        # The more signs, the more combinations.
        factor = 1.0 + 0.2 * count
        for joints in itertools.combinations(every, count):
            signs = np.where(np.isin(every, joints), -1.0, 1.0)
            turned = with_joints(rows, rows.joints * signs)
            values = {"joints": ", ".join(robot.joint_names[i] for i in joints)}
            yield Trial(factor, robot, free, turned, Why.JOINTS_TURNED, values)
