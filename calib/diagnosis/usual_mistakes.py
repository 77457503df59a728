"""Usual mistakes of an input: if a nominal arm is centimetres off, each one is undone in a trial.

In each trial the target is registered again. Explanations that the rows cannot tell apart are all named. A joint that
counts the other way is also looked for in images that fit: frames and zeros may make up for it.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

import calib.data.kinds as registry
from calib.basics.arrays import Array, Integers
from calib.basics.progress import trying
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.data.priors import Priors
from calib.diagnosis.dh_changes import DHTrials, find_wrong_rows, stated_rows
from calib.diagnosis.flange_mistakes import flange_mistakes
from calib.diagnosis.reasons import Reason, Why
from calib.diagnosis.screening import screened_errors
from calib.diagnosis.trials import (
    AS_GOOD,
    FAR_BETTER,
    PLAUSIBLE,
    PLAUSIBLE_ANGLE,
    REGISTERED,
    SIMPLE_FACTORS,
    TOLERANCE,
    Correction,
    correct_columns,
    correct_joints,
    correct_orientations,
    correct_points,
    misfit,
    poses_of_images,
    scale_column,
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
from calib.robot.flange import is_flange_robot
from calib.robot.robot import Robot

#: A mistake is named only if the error is at most this with it undone [m].
_EXPLAINED = 0.05

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

#: The least angle that the farthest reading of a joint turns it by, if its factor is sought [rad].
_LEAST_TURN = 0.1

#: Relative step of factors of a joint: at one turn it is 0.2 rad, within which a minimum of the error is found.
_FACTOR_STEP = 0.03

#: Rounds in which a factor is sought: each twenty times as fine, the last one to 1e-5.
_FACTOR_ROUNDS = 3

#: The fewest rows in whose order a mistake is found: some before the place and some after it.
_FEWEST_ROWS_OF_ORDER = 8

#: Places from which on measurements may be moved that are tried at first, evenly over a table.
_ORDERS = 120

#: Mistakes of the setup that are not combined with one of the joints: these have so much freedom that both together
#: explain too much.
_ALONE = (Why.TARGET_ELSEWHERE, Why.OTHER_TIP)

#: The fewest numbers beyond the unknowns for which pairs are tried. Of ten thousand pairs one lowers an error to a
#: fifth by chance with a probability of about 1e4 0.2^d: below 1e-3 from here on, though errors are not independent.
_FEWEST_FREEDOM_OF_PAIR = 12

#: Factor on the error of a trial of two mistakes, of which there are thousands.
_ONE_OF_TWO = 2.0

#: The fewest joints that carry another tip: on the axes of two joints a target stands still, as points in a wrong unit
#: nearly do.
_FEWEST_JOINTS_OF_TIP = 3

#: Positions that differ by less are one position [m].
_ONE_PLACE = 1e-6

#: A tip that moves by more than this cannot have stayed at one position [m].
_FAR_APART = 1e-2

#: A given target with a smaller error is where it was given, or nearly [m].
_TARGET_MOVED = 5e-3

#: A target is given to a millimetre or so: it may be off by this besides [m].
_ROUND_TARGET = 2e-3

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
    #: The nominal robot, perhaps with another base or tip
    robot: Robot
    #: Frames and targets, with what is registered again
    setup: Setup
    #: The rows, as points
    rows: Rows
    #: The mistake, without errors
    mistake: Reason


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
    tips = robot.poses(rows.joints[chosen], rows.select(chosen).samples.chain)[:, :3, 3]
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
    a local minimum, or the robot or the table is wrong: the rows do not show which.

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
    T_base_tip = robot.poses(rows.joints, rows.samples.chain)
    registered = nominal_setup(T_base_tip, setup.with_estimated_not_given(), rows)
    for f in sought:
        of_frame = rows.with_partners(rows.samples.frame == f)
        if not is_plausible(registered, T_base_tip[of_frame], rows.select(of_frame)):
            station = setup.groups[f] if len(setup.groups) > 1 else ""
            return Reason.of(Why.FRAME_NOT_FOUND, station=station)
    return None


def find_usual_mistake(
    robot: Robot, cell: Cell, table: Measurements, in_order: Measurements | None = None
) -> Reason | None:
    """Find a usual mistake that explains why the nominal robot is far off the rows of a table.

    Of poses the positions are examined first, and the orientations if the positions are plausible; several targets and
    frames are examined together, on at most some tens of rows. If no single mistake explains the rows, every pair
    of two is tried: all of them by `calib.diagnosis.screening`, the best by a registration.

    Args:
        robot: The nominal robot.
        cell: The cell as given.
        table: Points, poses or images; other kinds are not examined.
        in_order: All rows of the file, of which ``table`` may be a part; None: it is all. Only their order is examined,
            as they were measured and by their row numbers.

    Returns:
        The mistake, with the rms errors as given and with it undone [m] (of orientations [rad]), and others that
        explain the rows as well; None if the nominal error is plausible or no mistake explains it.
    """
    if is_flange_robot(robot.joint_names):
        return next(flange_mistakes(robot, cell, table), None)
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
    whole, table = table, _some_rows(table)
    cell = _seen_cell(cell, table)
    poses, setup = rows_and_setup(robot, table, cell)
    rows = _as_points(poses)
    given_places = setup.with_given_fixed()
    dh = stated_rows(robot, rows.joints)
    of_dh = None if dh is None else DHTrials(dh, given_places, poses)
    wrong_rows = None if of_dh is None else find_wrong_rows(of_dh)
    if wrong_rows is not None:
        return wrong_rows
    given, _ = misfit(robot, setup, rows)
    turned = _given_target_turned(robot, setup, rows)
    # Of a quarter turn the given numbers may be exchanged, or have other signs, as well.
    if turned is not None and not np.isclose(np.sin(2.0 * turned.values["add_rad"]), 0.0):
        return turned
    if given < PLAUSIBLE:
        return _orientation_mistake(robot, setup, poses)

    setups = list(_trials_of_setup(robot, cell, table, setup, poses))
    searches: list[Iterator[Trial]] = [
        itertools.chain(
            setups,
            () if of_dh is None else _trials_of_dh_rows(of_dh, setup),
            _trials_of_joints(robot, table, setup, rows),
            _trials_of_orders(robot, cell, whole if in_order is None else in_order),
            _turned_joints(robot, setup, rows),
        ),
        _pairs(robot, table, setup, rows, setups),
    ]
    # If everything is given, as in what a controller shows of its rows, the orientations have to agree too.
    all_given = dh is not None and given_places.count == 0
    explanations = [(False, turned.values["error_m"], turned)] if turned else []
    for trials in searches:
        for trial in trials:
            trying(trial.mistake.code)
            error, _ = misfit(trial.robot, trial.setup, trial.rows)
            weighted = trial.factor * error
            largest = PLAUSIBLE if trial.mistake.why is Why.TWO_MISTAKES else _EXPLAINED
            # A robot that stands still is off by the rms distance of the points from their centre.
            spread = float(np.sqrt(np.sum(np.var(trial.rows.measured, axis=0))))
            far_better = weighted <= FAR_BETTER * min(given, spread)
            if error > largest or not far_better:
                continue
            held = all_given and trial.mistake.why is not Why.TARGET_ELSEWHERE
            if held and _contradicts_orientations(replace(trial, setup=given_places), poses):
                continue
            mistake = trial.mistake.with_values(error_m=error)
            explanations.append((_contradicts_orientations(trial, poses), weighted, mistake))
        # One that leaves more than an uncalibrated arm has may be half of the truth.
        if any(not c and r.values["error_m"] < PLAUSIBLE for c, _, r in explanations):
            break
    return _choose(explanations).with_values(given_m=given) if explanations else None


def _given_target_turned(robot: Robot, setup: Setup, rows: Rows) -> Reason | None:
    """Return the zero of the last joint with which the targets are where they were given, if they seem to be elsewhere.

    For rows that are points, that zero and the target's place have the same effect: with the target estimated, any zero
    fits.
    None if some target was not given, is where it was, or no turn by a round angle puts it there.
    """
    last = len(robot.inputs) - 1
    if not np.all(setup.target_given) or robot.inputs[last].type == "prismatic":
        return None
    fixed = replace(setup, target_unknown=np.zeros_like(setup.target_unknown))
    given, _ = misfit(robot, fixed, rows)
    found, _ = misfit(robot, _with_unknown_targets(setup), rows)
    if given < _TARGET_MOVED or found > min(FAR_BETTER * given, PLAUSIBLE):
        return None
    trials = []
    for joints, mistake in shift_zeros(robot.joint_names[last], last, rows.joints):
        error, _ = misfit(robot, fixed, with_joints(rows, joints))
        trials.append(mistake.with_values(given_m=given, error_m=error))
    best = min(trials, key=lambda reason: reason.values["error_m"])
    limit = min(FAR_BETTER * given, AS_GOOD * found + _ROUND_TARGET)
    return best if best.values["error_m"] <= limit else None


def _choose(explanations: Sequence[tuple[bool, float, Reason]]) -> Reason:
    """Choose the explanation of the smallest weighted error, with those that the rows cannot distinguish from it.

    Each states whether the orientations of the rows speak against it, its weighted error [m], and the mistake.
    """
    best, *others = sorted(explanations, key=lambda explanation: explanation[:2])
    contradicted, _, mistake = best
    limit = AS_GOOD * mistake.values["error_m"] + _ROUNDING
    as_good = []
    for other_contradicted, _, other in others:
        if other.values["error_m"] <= limit and other_contradicted == contradicted:
            # The error as given is stated once.
            values = {name: value for name, value in other.entry.items() if name != "given_m"}
            as_good.append(values)
    return mistake.with_others(as_good)


def _contradicts_orientations(trial: Trial, poses: Rows) -> bool:
    """Return whether the orientations of the rows speak against a trial of other joint values.

    False for a trial that changes the rows' points instead, and if some rows (``poses``) have no orientation.
    """
    is_of_joints = trial.rows.measured.shape[0] == poses.measured.shape[0] and np.array_equal(
        trial.rows.measured, poses.measured[:, :3]
    )
    if not is_of_joints or not np.all(poses.where(lambda kind: kind.orientation)):
        return False
    _, angle = misfit(trial.robot, trial.setup, with_joints(poses, trial.rows.joints))
    return angle > PLAUSIBLE_ANGLE


def _orientation_mistake(robot: Robot, setup: Setup, poses: Rows) -> Reason | None:
    """Explain orientations that make no sense as given, though the positions are plausible.

    The mistake has the rms errors [rad] as given and with it undone. None if the orientations are plausible, if some
    rows have none, or if no mistake lowers the error far. A target on the last joint's axis stays in place whatever
    that joint's sign and zero are.
    """
    if not np.all(poses.where(lambda kind: kind.orientation)):
        return None
    _, given = misfit(robot, setup, poses)
    if given < PLAUSIBLE_ANGLE:
        return None

    trials: list[tuple[Rows, Reason]] = []
    for measured, mistake in correct_orientations(poses.measured):
        trials.append((replace(poses, measured=measured), mistake))
    q = poses.joints
    for i, joint in enumerate(robot.inputs):
        if joint.type == "prismatic":
            continue
        turned = with_joints(poses, q * (1.0 - 2.0 * np.eye(q.shape[1])[i]))
        trials.append((turned, Reason.of(Why.ORIENTATIONS_JOINT_TURNED, joint=joint.name)))
        for shifted, zero in shift_zeros(joint.name, i, q):
            of_zero = Reason(Why.ORIENTATIONS_JOINT_ZERO, zero.values)
            trials.append((with_joints(poses, shifted), of_zero))

    best, reason = np.inf, None
    for changed, mistake in trials:
        position_error, error = misfit(robot, setup, changed)
        if error < best and position_error < PLAUSIBLE:
            best = error
            reason = mistake.with_values(given_rad=given, error_rad=error)
    return reason if best < FAR_BETTER * given else None


def _seen_cell(cell: Cell, table: Measurements) -> Cell:
    """Copy a cell without the targets and frames that it names and no row of a table sees."""
    targets = {name: place for name, place in cell.targets.items() if name in table.targets}
    frames = {name: pose for name, pose in cell.frames.items() if name in table.groups}
    return replace(cell, targets=targets, frames=frames)


def _some_rows(table: Measurements) -> Measurements:
    """Copy a table with at most about `_ROWS` of its rows, evenly over those of each station and target."""
    labels = [*zip(table.groups, table.targets, strict=True)]
    share = min(_ROWS / max(len(table), 1), 1.0)
    chosen = np.zeros(len(table), dtype=bool)
    for label in dict.fromkeys(labels):
        rows = np.flatnonzero([other == label for other in labels])
        count = min(max(round(share * len(rows)), _FEWEST_ROWS_OF_FRAME), len(rows))
        chosen[rows[np.linspace(0, len(rows) - 1, count).astype(int)]] = True
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


def _trials_of_setup(
    robot: Robot, cell: Cell, table: Measurements, setup: Setup, poses: Rows
) -> Iterator[Trial]:
    """Yield trials in which mistakes besides those of the joints' values are undone one at a time.

    Each has all targets unknown. ``poses`` are the rows of the table, whose positions are the rows of the trials.
    """
    rows = _as_points(poses)
    free = _with_unknown_targets(setup)
    if not setup.estimate_target:
        yield Trial(_PLAIN, robot, free, rows, Reason.of(Why.TARGET_ELSEWHERE))

    # Points in the frame of another link that is fixed to the base, or in an unknown frame.
    links = robot.urdf.links
    fixed = {joint.name for joint in robot.urdf.joints if joint.type == "fixed"}
    if not cell.estimate_frame and cell.T_frame_base is None:
        # Of several chains the links were named one by one.
        for link in () if robot.branches else links:
            between = itertools.chain(*robot.urdf.chain(robot.base, link))
            if link != robot.base and fixed.issuperset(between):
                other = robot.rebuilt(base=link)
                yield Trial(_PLAIN, other, free, rows, Reason.of(Why.OTHER_BASE, link=link))
        if len(rows) >= _FEWEST_ROWS_OF_FRAME:
            unknown = replace(free, unknown=(DIRECTIONS,) * len(setup.groups))
            yield Trial(_FREE_FRAME, robot, unknown, rows, Reason.of(Why.OWN_FRAME))

    turns = any(len(directions) == len(DIRECTIONS) for directions in setup.unknown)
    for points, mistake in correct_points(rows.measured, table.units, turns=turns):
        yield Trial(_ONE_OF_MANY, robot, free, replace(rows, measured=points), mistake)

    # Another link carries the target: one for each set of joints that the table has values of.
    tried = {frozenset(robot.joint_names)}
    for link in () if robot.branches else links:
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
        yield Trial(_FREE, other, other_free, other_rows, Reason.of(Why.OTHER_TIP, link=link))

    # Poses of the frame in the target.
    if np.all(poses.where(lambda kind: kind.orientation)):
        R = poses.measured[:, 3:12].reshape(-1, 3, 3)
        points = -np.einsum("nji,nj->ni", R, poses.measured[:, :3])
        inverse = replace(rows, measured=points)
        yield Trial(_ONE_OF_MANY, robot, free, inverse, Reason.of(Why.POSES_INVERSE))


def _trials_of_dh_rows(of_dh: DHTrials, setup: Setup) -> Iterator[Trial]:
    """Yield the best of the trials in which a mistake in the DH rows that a robot was made from is undone.

    Targets that are held stay where they were given: almost any row would explain what the freedom of a target does.
    """
    poses = of_dh.rows
    for _, change in sorted(of_dh.tried, key=lambda entry: float(entry[0][0]))[:REGISTERED]:
        rows = with_joints(_as_points(poses), change.in_order(poses.joints, of_dh.dh.joint_names))
        # One cell is likelier than what has its effect, and what a free number explains has to be far more.
        factor = (_PLAIN if len(change.cells) == 1 else _ONE_OF_MANY) * (1.0 + change.free)
        yield Trial(factor, change.robot(), setup, rows, change.mistake)


def _trials_of_joints(
    robot: Robot, table: Measurements, setup: Setup, rows: Rows
) -> Iterator[Trial]:
    """Yield the best of the trials in which one mistake of joint values is undone, other than reversed signs.

    ``rows`` are points. Every trial has all targets unknown.
    """
    free = _with_unknown_targets(setup)
    corrections = [
        correction
        for correction in _single_corrections(robot, rows.joints, table.units)
        if correction[1].why is not Why.JOINTS_TURNED
    ]
    of_columns = _best(robot, free, rows, corrections)
    for joints, mistake in (*of_columns, *_best_factors(robot, free, rows)):
        yield Trial(_ONE_OF_MANY, robot, free, with_joints(rows, joints), mistake)

    # A joint whose column holds one value, at the values that would explain each row.
    is_constant = np.ptp(rows.joints, axis=0) == 0.0
    for joint in np.flatnonzero(is_constant).tolist():
        moved = rows
        for reach in _REACHES:
            moved = _with_nearest_values(robot, free, moved, joint, reach)
        constant = Reason.of(Why.JOINT_CONSTANT, joint=robot.joint_names[joint])
        yield Trial(_FREE, robot, free, moved, constant)


def _single_corrections(robot: Robot, q: Array, units: Mapping[str, str]) -> list[Correction]:
    """List the corrections of one mistake of joint values: of one column, then of several."""
    of_columns = (correction for _, correction in correct_columns(robot, q, units))
    return [*of_columns, *correct_joints(robot, q, units)]


def _best(
    robot: Robot, setup: Setup, rows: Rows, corrections: Sequence[Correction]
) -> list[Correction]:
    """Choose the corrections of joint values, at most `REGISTERED`, with the smallest errors on a screen."""
    q = np.array([joints for joints, _ in corrections])
    errors = screened_errors(robot, setup, rows, q, rows.measured)
    return [corrections[k] for k in np.argsort(errors, kind="stable")[:REGISTERED].tolist()]


def _best_factors(robot: Robot, setup: Setup, rows: Rows) -> Iterator[Correction]:
    """Yield for each turning joint the factor on its readings that explains the rows best, of either sign.

    Factors are tried that make the largest reading between `_LEAST_TURN` and one turn, in steps of `_FACTOR_STEP`; then
    those between the best one's neighbours. A factor is not yielded if the next simple one, such as -1, explains the
    rows as well: the errors of an uncalibrated arm move it, most at the last joint.
    """
    for joint, (name, largest) in enumerate(
        zip(robot.joint_names, np.max(np.abs(rows.joints), axis=0).tolist(), strict=True)
    ):
        if robot.inputs[joint].type == "prismatic" or not largest:
            continue
        least, most = np.log(_LEAST_TURN / largest), np.log(2.0 * np.pi / largest)
        sizes = np.exp(np.arange(least, most, _FACTOR_STEP))
        factors = np.concatenate([sizes, -sizes])
        step = _FACTOR_STEP
        for _ in range(_FACTOR_ROUNDS):
            corrections = list(scale_column(name, joint, rows.joints, factors))
            best, *_ = _best(robot, setup, rows, corrections)
            factor = best[1].values["factor"]
            factors = factor * np.exp(np.linspace(-step, step, _TRIED))
            step *= 2.0 / (_TRIED - 1)
        distances = np.abs(np.log(abs(factor) / np.array(SIMPLE_FACTORS)))
        simple = np.copysign(SIMPLE_FACTORS[int(np.argmin(distances))], factor)
        both = list(scale_column(name, joint, rows.joints, np.array([factor, simple])))
        q = np.array([joints for joints, _ in both])
        of_best, of_simple = screened_errors(robot, setup, rows, q, rows.measured)
        if of_simple > AS_GOOD * of_best:
            yield best


def _trials_of_orders(robot: Robot, cell: Cell, table: Measurements) -> Iterator[Trial]:
    """Yield the trials of each order that rows may have had when a measurement went missing or was entered twice.

    It was that of the measurements, or that of the file, by its row numbers, if they are sorted otherwise there.
    """
    poses, setup = rows_and_setup(robot, table, _seen_cell(cell, table))
    rows, numbers = _as_points(poses), np.array(table.rows)
    yield from _trials_of_order(robot, setup, rows, numbers)
    in_file = np.argsort(numbers, kind="stable")
    if np.any(np.diff(in_file) < 0):
        yield from _trials_of_order(robot, setup, rows.select(in_file), numbers[in_file])


def _trials_of_order(
    robot: Robot, setup: Setup, rows: Rows, row_numbers: Integers
) -> Iterator[Trial]:
    """Yield the best trials in which measurements are moved by a row against joint values, from some row to the last.

    From the first row on all are shifted. From a later one on, one measurement is missing and the others moved up, or
    one is there twice and they moved down. Names of frames and targets belong to the joint values or to the
    measurements. The rows, which are points, have these numbers in the table, (N,).
    """
    free = _with_unknown_targets(setup)
    last = len(rows) - 1
    if last < _FEWEST_ROWS_OF_ORDER:
        return

    def moved(first: int, *, up: bool, named: bool) -> Rows:
        """Return some rows, the measurements from a row on put back; names belong to the joint values or to these."""
        numbers = np.arange(last + 1)
        without, whole = numbers != first, numbers < last
        joints, measured = (without, whole) if up else (whole, without)
        labelled = rows.select(joints if named else measured)
        samples = replace(labelled.samples, q=rows.joints[joints])
        put_back = replace(labelled, samples=samples, measured=rows.measured[measured])
        return put_back.select(put_back.evenly(_ROWS))

    def error(first: int, *, up: bool, named: bool) -> float:
        """Return the error on a screen if the measurements from a row on are put back [m]."""
        trial = moved(first, up=up, named=named)
        (of_trial,) = screened_errors(robot, free, trial, trial.joints[None], trial.measured)
        return float(of_trial)

    places = np.unique(np.linspace(0, last, _ORDERS).astype(int)).tolist()
    spacing = int(np.max(np.diff(places)))
    several = len(setup.groups) > 1 or len(setup.targets) > 1
    for up, named in itertools.product((True, False), (False, True) if several else (False,)):
        of_place = partial(error, up=up, named=named)
        near = min(places, key=of_place)
        between = range(max(near - spacing + 1, 0), min(near + spacing, last + 1))
        best = min(between, key=of_place)
        if best == last:
            continue
        factor, mistake = _ONE_OF_MANY, Reason.of(Why.ROWS_SHIFTED, later=not up)
        if best > 0:
            row = int(row_numbers[best])
            factor, mistake = _FREE, Reason.of(Why.ROWS_MOVED, row=row, up=up)
        yield Trial(factor, robot, free, moved(best, up=up, named=named), mistake)


def _pairs(
    robot: Robot, table: Measurements, setup: Setup, rows: Rows, setups: Sequence[Trial]
) -> Iterator[Trial]:
    """Yield the best of the trials in which two mistakes are undone: both of joint values, or one of the setup.

    ``rows`` are points. ``setups`` are the trials of `_trials_of_setup`. Every trial has all targets unknown.
    """
    free = _with_unknown_targets(setup)
    if rows.count - free.count < _FEWEST_FREEDOM_OF_PAIR:
        return
    plain = Trial(_PLAIN, robot, free, rows, Reason.of(Why.TWO_MISTAKES))
    ranked: list[tuple[float, Trial]] = []
    with_first = [(plain, list(_two_of_joints(robot, rows.joints, table.units)))]
    for trial in setups:
        if trial.mistake.why not in _ALONE:
            corrections = _single_corrections(trial.robot, trial.rows.joints, table.units)
            both_undone = [(joints, (trial.mistake, other)) for joints, other in corrections]
            with_first.append((trial, both_undone))
    for trial, changed in with_first:
        factor = _ONE_OF_TWO * trial.factor
        q = np.array([joints for joints, _ in changed])
        errors = screened_errors(trial.robot, trial.setup, trial.rows, q, trial.rows.measured)
        for k in np.argsort(errors, kind="stable")[:REGISTERED].tolist():
            joints, both = changed[k]
            mistake = Reason.of(Why.TWO_MISTAKES, both=[one.entry for one in both])
            if all(one.why is Why.JOINTS_TURNED for one in both):
                names = ", ".join(one.values["joints"] for one in both)
                mistake = Reason.of(Why.JOINTS_TURNED, joints=names)
            pair = replace(
                trial, factor=factor, rows=with_joints(trial.rows, joints), mistake=mistake
            )
            ranked.append((factor * float(errors[k]), pair))
    ranked.sort(key=lambda entry: entry[0])
    for _, trial in ranked[:REGISTERED]:
        yield trial


def _two_of_joints(
    robot: Robot, q: Array, units: Mapping[str, str]
) -> Iterator[tuple[Array, tuple[Reason, Reason]]]:
    """Yield joint values in which two mistakes are undone, and both: first of one column, then another or of several.

    Of one column two are its sign and then its zero.
    """
    for i, (once, first) in correct_columns(robot, q, units):
        for j, (twice, second) in correct_columns(robot, once, units):
            of_one = first.why is Why.JOINTS_TURNED and second.why is Why.JOINT_ZERO
            if j > i or (j == i and of_one):
                yield twice, (first, second)
        for twice, second in correct_joints(robot, once, units):
            yield twice, (first, second)


def _with_nearest_values(robot: Robot, setup: Setup, rows: Rows, joint: int, reach: float) -> Rows:
    """Copy rows with the value of one joint changed, by up to ``reach`` [rad] or [m], so that each row fits best.

    Frames and targets that the setup leaves unknown are registered with the values before.
    """
    every = np.arange(len(rows))
    T_base_tip = robot.poses(rows.joints, rows.samples.chain)
    registered = register(T_base_tip, setup, rows, tolerance=TOLERANCE)
    q = np.repeat(rows.joints, _TRIED, axis=0)
    changes = np.linspace(-reach, reach, _TRIED)
    q[:, joint] += np.tile(changes, len(rows))
    repeated = rows.select(np.repeat(every, _TRIED))
    seen = registered.sightings(robot.poses(q, repeated.samples.chain), repeated.samples)
    squares = np.sum(repeated.residual(seen) ** 2, axis=1)
    nearest = np.argmin(squares.reshape(-1, _TRIED), axis=1)
    return with_joints(rows, q[every * _TRIED + nearest])


def _turned_joints(robot: Robot, setup: Setup, rows: Rows) -> Iterator[Trial]:
    """Yield trials in which the signs of some joints' values are reversed: of each set of joints, or of single ones.

    ``rows`` are points. Every trial has all targets unknown; the more joints, the larger the factor on its error.
    """
    every = range(len(robot.inputs))
    free = _with_unknown_targets(setup)
    # An unknown frame makes a trial a hundred times as expensive. Two signs are among the pairs of mistakes.
    singly = any(setup.unknown) or len(every) > _MOST_SIGNS
    for count in range(1, 2 if singly else len(every) + 1):
        # The more signs, the more combinations.
        factor = 1.0 + 0.2 * count
        for joints in itertools.combinations(every, count):
            signs = np.where(np.isin(every, joints), -1.0, 1.0)
            turned = with_joints(rows, rows.joints * signs)
            names = ", ".join(robot.joint_names[i] for i in joints)
            yield Trial(factor, robot, free, turned, Reason.of(Why.JOINTS_TURNED, joints=names))


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
