"""Usual mistakes of an input: if a nominal arm is centimetres off, each one is undone in a trial.

In each trial the target is registered again. Explanations that the rows cannot tell apart are all named. A joint that
counts the other way is also looked for in images that fit: frames and zeros may make up for it.
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
from calib.data.priors import Priors
from calib.diagnosis.dh_cells import (
    find_wrong_cell,
    likely_rows,
    rows_of_fitting_lengths,
    stated_rows,
)
from calib.diagnosis.reasons import Reason, Why
from calib.diagnosis.trials import (
    TOLERANCE,
    correct_joints,
    correct_orientations,
    correct_points,
    misfit,
    poses_of_images,
    shift_zeros,
    with_joints,
)
from calib.errors import CalibError, MeasurementError, UrdfError
from calib.fit.estimate.fitting import fit
from calib.fit.estimate.task import Task
from calib.fit.registration.frame_search import frames_to_search, is_plausible
from calib.fit.registration.registration import nominal_setup, register
from calib.fit.registration.rows import Rows
from calib.fit.registration.setup import Setup
from calib.fit.registration.table_rows import rows_and_setup
from calib.model.parameter_sets import DIRECTIONS
from calib.robot.dh_file import lines_of_joints
from calib.robot.dh_rows import DHRobot
from calib.robot.robot import Robot

#: Nominal errors below this need no other explanation than an uncalibrated arm [m].
_PLAUSIBLE = 0.02

#: Errors of orientations below this need no other explanation than an uncalibrated arm [rad].
_PLAUSIBLE_ANGLE = 0.1

#: A mistake is named only if undoing it lowers the error to this share.
_FAR_BETTER = 0.2

#: A mistake is named only if the error is at most this with it undone [m].
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

#: Reversed values of a joint fit far better if their error is less than this share of that of the values as given.
_REVERSED_FAR_BETTER = 0.5

#: They fit as well if their error is no more than this multiple of it.
_REVERSED_AS_WELL = 1.5

#: Views of boards that are enough to find the senses of joints.
_VIEWS = 60

#: The fewest views for that.
_FEWEST_VIEWS = 6


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """An input in which a mistake is undone."""

    #: Factor on the trial's error when trials are ranked; the freer the trial, the larger
    factor: float
    #: Pose of the tip in the base at each row, shape (N, 4, 4) [m]
    T_base_tip: Array
    #: Frames and targets, with what is registered again
    setup: Setup
    #: The rows, as points
    rows: Rows
    #: The mistake
    why: Why
    #: Numbers and names of its reason, errors aside
    values: dict[str, Any] = field(default_factory=dict)
    #: The rows with their orientations; None: they are all those of the table
    poses: Rows | None = None


def check_positions(robot: Robot, rows: Rows, source: str) -> None:
    """Refuse measured positions that are all the same though the joint values move the tip: any fit would collapse.

    Args:
        robot: The nominal robot.
        rows: The rows of the table; those that measure no position do not count.
        source: Name of the table's file, for the message; may be empty.

    Raises:
        MeasurementError: There are two or more, all the same, and the joint values move the tip by more than would go
            unnoticed; the text names the file and the place [mm].
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


def frame_not_found(robot: Robot, setup: Setup, rows: Rows) -> Reason | None:
    """Name a frame that registration sought and did not find.

    A frame in the right place leaves the errors of an uncalibrated arm. If the best place leaves far larger ones, it is
    a local minimum, or the robot or the table is wrong: the rows cannot tell which.

    Args:
        robot: The nominal robot.
        setup: Frames and targets as given, with what is estimated of them.
        rows: N rows that are fitted.

    Returns:
        The first such frame by the name of its station; None if there is none, or none was sought.

    Raises:
        MeasurementError: Fewer numbers than unknowns.
    """
    sought = frames_to_search(setup, rows)
    if not sought:
        return None
    T_base_tip = robot.poses(rows.joints)
    registered = nominal_setup(T_base_tip, setup.with_estimated_not_given(), rows)
    for f in sought:
        of_frame = rows.with_partners(rows.samples.frame == f)
        if not is_plausible(registered, T_base_tip[of_frame], rows.select(of_frame)):
            station = setup.groups[f] if len(setup.groups) > 1 else ""
            return Reason.of(Why.FRAME_NOT_FOUND, station=station)
    return None


def find_usual_mistake(robot: Robot, cell: Cell, table: Measurements) -> Reason | None:
    """Find a usual mistake that explains why the nominal robot is far off the rows of a table.

    Of poses the positions are examined first, and the orientations if the positions are plausible; several targets and
    frames are examined together, on at most some tens of rows.

    Args:
        robot: The nominal robot.
        cell: The cell as given.
        table: Points, poses or images; other kinds are not examined.

    Returns:
        The mistake, with the rms errors as given and with it undone [m] (of orientations [rad]), and others that
        explain the rows as well; None if the nominal error is plausible or no mistake explains it.
    """
    from_images = poses_of_images(robot, cell, table)
    if from_images is not None:
        table_of_poses, cell_of_poses = from_images
        mistake = find_usual_mistake(robot, cell_of_poses, table_of_poses)
        if mistake is None or mistake.why is not Why.POSES_INVERSE:
            return mistake
        links = {"base": robot.base, "tip": robot.tip}
        return Reason.of(Why.CAMERA_ON_OTHER_LINK, **mistake.values, **links)

    if not np.all(table.of_kind("point", "pose")):
        return None
    table = _some_rows(table)
    # Targets and frames that the cell names and none of these rows sees are left out.
    targets = {name: place for name, place in cell.targets.items() if name in table.targets}
    frames = {name: pose for name, pose in cell.frames.items() if name in table.groups}
    cell = replace(cell, targets=targets, frames=frames)
    poses, setup = rows_and_setup(robot, table, cell)
    rows = _as_points(poses)
    wrong_cell = find_wrong_cell(robot, setup, poses)
    if wrong_cell is not None:
        return wrong_cell
    given, _ = misfit(robot.poses(rows.joints), setup, rows)
    if given < _PLAUSIBLE:
        return _orientation_mistake(robot, setup, poses)

    usual = _trials(robot, cell, table, setup, poses)
    first, *further = _counts_of_turned_joints(robot, setup)
    if stated_rows(robot, rows.joints) is not None:
        first = [count for count in first if count > 1]  # one of them is a cell of the rows
    searches: list[Iterator[Trial]] = [
        itertools.chain(usual, _turned_joints(robot, setup, rows, first)),
        *(_turned_joints(robot, setup, rows, counts) for counts in further),
    ]
    for trials in searches:
        explanations = []
        for trial in trials:
            error, _ = misfit(trial.T_base_tip, trial.setup, trial.rows)
            weighted = trial.factor * error
            explains = error <= _EXPLAINED and weighted <= _FAR_BETTER * given
            if explains and not _contradicts_orientations(trial, poses):
                reason = Reason.of(trial.why, given_m=given, error_m=error, **trial.values)
                explanations.append((weighted, reason))
        if explanations:
            return _choose(explanations)
    return None


def _choose(explanations: Sequence[tuple[float, Reason]]) -> Reason:
    """Choose the explanation of the smallest weighted error, with those that the rows cannot tell from it.

    Each states its weighted error [m] and the mistake. The value ``"others"`` lists codes and values of those as good,
    without the error as given, which all share.
    """
    (_, reason), *others = sorted(explanations, key=lambda explanation: explanation[0])
    limit = _AS_GOOD * reason.values["error_m"] + _ROUNDING
    as_good = []
    for _, other in others:
        if other.values["error_m"] <= limit:
            values = {name: value for name, value in other.values.items() if name != "given_m"}
            as_good.append({"code": other.code, **values})
    if not as_good:
        return reason
    return replace(reason, values={**reason.values, "others": as_good})


def _contradicts_orientations(trial: Trial, poses: Rows) -> bool:
    """Return whether the orientations of the rows speak against a trial, in whatever convention they were read.

    False for a trial that changes the rows' points, and if some rows (``poses``) have no orientation.
    """
    of_trial = trial.poses or poses
    if len(of_trial) != len(trial.rows):
        return False
    if not np.array_equal(trial.rows.measured, of_trial.measured[:, :3]):
        return False
    if not np.all(poses.where(lambda kind: kind.orientation)):
        return False
    read = [of_trial.measured, *(other for other, _, _ in correct_orientations(of_trial.measured))]
    return all(
        misfit(trial.T_base_tip, trial.setup, replace(of_trial, measured=measured))[1]
        > _PLAUSIBLE_ANGLE
        for measured in read
    )


def _orientation_mistake(robot: Robot, setup: Setup, poses: Rows) -> Reason | None:
    """Explain orientations that make no sense as given, though the positions are plausible.

    The mistake has the rms errors [rad] as given and with it undone. None if the orientations are plausible, if some
    rows have none, or if no mistake lowers the error far. A target on the last joint's axis stays in place whatever
    that joint's sign and zero are.
    """
    if not np.all(poses.where(lambda kind: kind.orientation)):
        return None
    _, given = misfit(robot.poses(poses.joints), setup, poses)
    if given < _PLAUSIBLE_ANGLE:
        return None

    trials: list[tuple[Rows, Why, dict[str, Any]]] = []
    for measured, why, values in correct_orientations(poses.measured):
        trials.append((replace(poses, measured=measured), why, values))
    q = poses.joints
    for i, joint in enumerate(robot.inputs):
        if joint.type == "prismatic":
            continue
        turned = with_joints(poses, q * (1.0 - 2.0 * np.eye(q.shape[1])[i]))
        trials.append((turned, Why.ORIENTATIONS_JOINT_TURNED, {"joint": joint.name}))
        for shifted, _, values in shift_zeros(joint.name, i, q):
            trials.append((with_joints(poses, shifted), Why.ORIENTATIONS_JOINT_ZERO, values))

    best, reason = np.inf, None
    for changed, why, values in trials:
        position_error, error = misfit(robot.poses(changed.joints), setup, changed)
        if error < best and position_error < _PLAUSIBLE:
            best = error
            reason = Reason.of(why, given_rad=given, error_rad=error, **values)
    return reason if best < _FAR_BETTER * given else None


def _some_rows(table: Measurements) -> Measurements:
    """Copy a table with at most `_ROWS` of its rows, evenly over it."""
    count = min(len(table), _ROWS)
    numbers = np.linspace(0, len(table) - 1, count).astype(int)
    chosen = np.zeros(len(table), dtype=bool)
    chosen[numbers] = True
    return table.select(chosen)


def _as_points(rows: Rows) -> Rows:
    """Copy rows of poses as rows of the kind ``point``, with their positions only."""
    kind = np.zeros(len(rows), dtype=np.int_)
    points = rows.measured[:, :3]
    return replace(rows, kinds=(registry.get("point"),), kind=kind, measured=points)


def _with_unknown_targets(setup: Setup) -> Setup:
    """Copy a setup with every target unknown."""
    return replace(setup, target_unknown=np.ones(len(setup.targets), dtype=bool))


# Trials


def _trials(
    robot: Robot, cell: Cell, table: Measurements, setup: Setup, poses: Rows
) -> Iterator[Trial]:
    """Yield trials in which the usual mistakes, other than reversed signs, are undone one at a time.

    Each has all targets unknown. ``poses`` are the rows of the table, whose positions are the rows of the trials.
    """
    rows = _as_points(poses)
    free = _with_unknown_targets(setup)
    T_base_tip = robot.poses(rows.joints)
    dh = stated_rows(robot, rows.joints)
    if not setup.estimate_target:
        # A target has more freedom than a cell of DH rows.
        factor = _PLAIN if dh is None else _ONE_OF_MANY
        yield Trial(factor, T_base_tip, free, rows, Why.TARGET_ELSEWHERE)

    # Points in the frame of another link that is fixed to the base, or in an unknown frame.
    links = robot.urdf.links
    fixed = {joint.name for joint in robot.urdf.joints if joint.type == "fixed"}
    if not cell.estimate_frame and cell.T_frame_base is None:
        for link in links:
            between = itertools.chain(*robot.urdf.chain(robot.base, link))
            if link != robot.base and fixed.issuperset(between):
                other = robot.rebuilt(base=link)
                tips = other.poses(rows.joints)
                yield Trial(_PLAIN, tips, free, rows, Why.OTHER_BASE, {"link": link})
        if len(rows) >= _FEWEST_ROWS_OF_FRAME:
            unknown = replace(free, unknown=(DIRECTIONS,) * len(setup.groups))
            yield Trial(_FREE_FRAME, T_base_tip, unknown, rows, Why.OWN_FRAME)

    if dh is not None:
        yield from _trials_of_dh_rows(robot, dh, setup, rows)

    for joints, why, values in correct_joints(robot, rows.joints):
        if dh is not None and why is Why.JOINT_ZERO:  # a cell of the rows
            continue
        yield Trial(_ONE_OF_MANY, robot.poses(joints), free, rows, why, values)

    # Measurements one row after their joint values, and one before; the first or last row falls away.
    later = rows.select(slice(1, None))
    values = {"later": True}
    poses_later = poses.select(slice(1, None))
    yield Trial(_ONE_OF_MANY, T_base_tip[:-1], free, later, Why.ROWS_SHIFTED, values, poses_later)
    earlier = rows.select(slice(None, -1))
    values = {"later": False}
    poses_earlier = poses.select(slice(None, -1))
    yield Trial(
        _ONE_OF_MANY, T_base_tip[1:], free, earlier, Why.ROWS_SHIFTED, values, poses_earlier
    )

    turns = any(len(directions) == len(DIRECTIONS) for directions in setup.unknown)
    for points, why, values in correct_points(rows.measured, turns=turns):
        changed = replace(rows, measured=points)
        yield Trial(_ONE_OF_MANY, T_base_tip, free, changed, why, values)

    # Another link carries the target: one for each set of joints that the table has values of.
    tried = {frozenset(robot.joint_names)}
    for link in links:
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
        other_poses, other_setup = rows_and_setup(other, table, cell)
        other_free, other_rows = _with_unknown_targets(other_setup), _as_points(other_poses)
        tips = other.poses(other_rows.joints)
        yield Trial(_FREE, tips, other_free, other_rows, Why.OTHER_TIP, {"link": link})

    # A joint whose column holds one value, at the values that would explain each row.
    is_constant = np.ptp(rows.joints, axis=0) == 0.0
    for joint in np.flatnonzero(is_constant).tolist():
        moved = rows
        for reach in _REACHES:
            moved = _with_nearest_values(robot, free, moved, joint, reach)
        values = {"joint": robot.joint_names[joint]}
        tips = robot.poses(moved.joints)
        yield Trial(_FREE, tips, free, moved, Why.JOINT_CONSTANT, values)

    # Poses of the frame in the target.
    if np.all(poses.where(lambda kind: kind.orientation)):
        R = poses.measured[:, 3:12].reshape(-1, 3, 3)
        points = -np.einsum("nji,nj->ni", R, poses.measured[:, :3])
        inverse = replace(rows, measured=points)
        yield Trial(_ONE_OF_MANY, T_base_tip, free, inverse, Why.POSES_INVERSE)


def _trials_of_dh_rows(robot: Robot, dh: DHRobot, setup: Setup, rows: Rows) -> Iterator[Trial]:
    """Yield trials in which a mistake in the rows that a robot was made from is undone.

    Targets that are held stay where they were given: almost any row would explain what the freedom of a target does.
    """
    names = robot.joint_names
    lines = lines_of_joints(robot.urdf.path)
    fitting = rows_of_fitting_lengths(dh, names, setup, rows)
    for corrected in itertools.chain(likely_rows(dh), fitting):
        tips = corrected.poses(rows.joints, names)
        # One cell is likelier than two that have its effect.
        factor = _PLAIN if len(corrected.cells) <= 1 else _ONE_OF_MANY
        yield Trial(factor, tips, setup, rows, corrected.why, corrected.reason_values(lines))


def _with_nearest_values(robot: Robot, setup: Setup, rows: Rows, joint: int, reach: float) -> Rows:
    """Copy rows with the value of one joint changed, by up to ``reach`` [rad] or [m], so that each row fits best.

    Frames and targets that the setup leaves unknown are registered with the values before.
    """
    every = np.arange(len(rows))
    T_base_tip = robot.poses(rows.joints)
    registered = register(T_base_tip, setup, rows, tolerance=TOLERANCE)
    q = np.repeat(rows.joints, _TRIED, axis=0)
    changes = np.linspace(-reach, reach, _TRIED)
    q[:, joint] += np.tile(changes, len(rows))
    repeated = rows.select(np.repeat(every, _TRIED))
    seen = registered.sightings(robot.poses(q), repeated.samples)
    squares = np.sum(repeated.residual(seen) ** 2, axis=1)
    nearest = np.argmin(squares.reshape(-1, _TRIED), axis=1)
    return with_joints(rows, q[every * _TRIED + nearest])


def _counts_of_turned_joints(robot: Robot, setup: Setup) -> tuple[Sequence[int], ...]:
    """List how many joints have their sign reversed at a time, for one search after the other.

    The next search is made if none before has explained the rows. Without an unknown frame there is one search, of any
    number of joints, or of one at a time if the robot has many. An unknown frame makes a trial a hundred times as
    expensive: then one joint, and two in a second search.
    """
    if any(setup.unknown):
        return (1,), (2,)
    joints = len(robot.inputs)
    most = joints if joints <= _MOST_SIGNS else 1
    return (range(1, most + 1),)


def _turned_joints(
    robot: Robot, setup: Setup, rows: Rows, counts: Iterable[int]
) -> Iterator[Trial]:
    """Yield trials in which the signs of some joints' values are reversed: every combination of each of ``counts``.

    ``rows`` are points. Every trial has all targets unknown; the more joints, the larger the factor on its error.
    """
    every = range(len(robot.inputs))
    free = _with_unknown_targets(setup)
    for count in counts:
        # The more signs, the more combinations.
        factor = 1.0 + 0.2 * count
        for joints in itertools.combinations(every, count):
            signs = np.where(np.isin(every, joints), -1.0, 1.0)
            tips = robot.poses(rows.joints * signs)
            values = {"joints": ", ".join(robot.joint_names[i] for i in joints)}
            yield Trial(factor, tips, free, rows, Why.JOINTS_TURNED, values)


# Senses of joints in images


def doubtful_senses(robot: Robot, cell: Cell, table: Measurements) -> Iterator[Reason]:
    """Find joints that seem to count the other way, and joints whose direction the images do not determine.

    Frames, targets and joint zeros may make up for a joint with the wrong sign: it then fits within millimetres, and
    every figure looks good. So each joint's values are reversed in turn, and the poses of the boards are fitted again.

    Args:
        robot: The nominal robot.
        cell: The cell as given.
        table: The rows that are fitted; none is examined unless all are images, and of several views.

    Yields:
        At most one reason of each sort: the joint that surest counts the other way, with the median errors [m] as given
        and reversed; and the names of all joints that fit as well reversed.
    """
    from_images = poses_of_images(robot, cell, table)
    if from_images is None:
        return
    table_of_poses, cell_of_poses = from_images
    if len(table_of_poses) < _FEWEST_VIEWS:
        return
    rows, setup = rows_and_setup(robot, table_of_poses, cell_of_poses)
    rows = rows.select(rows.evenly(_VIEWS))
    given = _errors_with_free_zeros(robot, setup, rows)
    if given is None:
        return

    turned, unknown = [], []
    for j, name in enumerate(robot.joint_names):
        reversed_joint = np.where(np.arange(rows.joints.shape[1]) == j, -1.0, 1.0)
        other = _errors_with_free_zeros(
            robot, setup, with_joints(rows, rows.joints * reversed_joint)
        )
        if other is None:
            continue
        ratio = max(other[0] / given[0], other[1] / given[1])
        if ratio < _REVERSED_FAR_BETTER:
            turned.append((ratio, name, other[0]))
        elif ratio < _REVERSED_AS_WELL:
            unknown.append(name)
    if turned:
        _, name, error = min(turned)
        yield Reason.of(Why.SENSE_REVERSED, joint=name, given_m=given[0], error_m=error)
    if unknown:
        yield Reason.of(Why.SENSE_UNKNOWN, joints=", ".join(unknown))


def _errors_with_free_zeros(robot: Robot, setup: Setup, rows: Rows) -> tuple[float, float] | None:
    """Return median errors of positions [m] and orientations [rad] after a fit of frames, targets and joint zeros.

    The rows are poses. Both are above 0; None if the fit fails.
    """
    cell = Cell(priors=Priors("given"))
    try:
        fitted = fit(Task(robot, cell, setup, "zeros"), rows)
    except CalibError:
        return None
    residual = fitted.residual(rows)
    lengths = np.linalg.norm(residual[:, :3], axis=1)
    angles = np.linalg.norm(residual[:, 3:6], axis=1)
    tiny = np.finfo(float).tiny
    return max(float(np.median(lengths)), tiny), max(float(np.median(angles)), tiny)
