"""Usual mistakes of an input: where a nominal arm is off by centimetres, each one is undone in a trial.

In each trial the target is registered anew. Explanations that the rows cannot tell apart are all named.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import calib.data.kinds as registry
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.diagnosis.reasons import Reason, Why
from calib.errors import MeasurementError
from calib.model.error_model import DIRECTIONS
from calib.numerics.errors import LENGTHS
from calib.registration.registration import register
from calib.registration.rows import Rows
from calib.registration.setup import Setup
from calib.registration.table_rows import rows_and_setup
from calib.robot.robot import Robot
from calib.units import Array

#: Nominal errors below this need no other explanation than an uncalibrated arm [m].
PLAUSIBLE = 0.02

#: Errors of orientations below this need no other explanation than an uncalibrated arm [rad].
_PLAUSIBLE_ANGLE = 0.1

#: A mistake is named only if undoing it lowers the error to this share.
_FAR_BETTER = 0.2

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

#: Tolerance of a registration: five digits are enough to compare.
_TOLERANCE = 1e-6

#: Ranges about the last value in which the value of a joint without values is sought, one after the other [rad].
_REACHES = (np.pi, np.pi, np.pi, 0.2, 0.2, 0.02, 0.002)

#: Values that are tried in each range.
_TRIED = 41

#: The fewest joints that carry another tip: on the axes of two joints a target stands still, as points in a wrong unit
#: nearly do.
_FEWEST_JOINTS_OF_TIP = 3

#: Factors where lengths are in one unit and their header says another.
_LENGTHS = {("in", "mm"): 25.4, ("mm", "in"): 1.0 / 25.4, ("m", "mm"): 1e3, ("mm", "m"): 1e-3}

#: Factors where angles are in one unit and their header says another.
_ANGLES = {("rad", "deg"): np.degrees(1.0), ("deg", "rad"): np.radians(1.0)}

#: Offsets of joint zeros between conventions [deg].
_TURNS_DEG = (90.0, -90.0, 180.0)

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

    #: On the trial's error when trials are ranked; the freer the trial, the larger
    factor: float
    #: The robot
    robot: Robot
    #: Frames and targets, with what is registered anew
    setup: Setup
    #: The rows
    rows: Rows
    #: Code of the mistake
    why: Why
    #: Of its reason
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
    points, tips = rows.measured[chosen, :LENGTHS], robot.poses(rows.joints[chosen])[:, :3, 3]
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
    if not np.all(table.of_kind("point", "pose")):
        return None
    chosen = np.zeros(len(table), dtype=bool)
    chosen[np.linspace(0, len(table) - 1, min(len(table), _ROWS)).astype(int)] = True
    table = table.select(chosen)
    cell = _naming_only(cell, table)
    poses, setup = rows_and_setup(robot, table, cell)
    rows = _as_points(poses)
    given = _misfit(robot, setup, rows)[0]
    if given < PLAUSIBLE:
        return _other_orientations(robot, setup, poses)
    usual = itertools.chain(
        _trials(robot, cell, setup, rows),
        _tips(robot, cell, table),
        _constant_joints(robot, setup, rows),
        _inverted(robot, setup, poses),
    )
    # An unknown frame makes a trial a hundred times as expensive: then two joints at most, and last.
    most = len(robot.inputs) if len(robot.inputs) <= _MOST_SIGNS else 1
    counts = ((1,), (2,)) if any(setup.unknown) else (range(1, most + 1),)
    first, *others = (_turned_joints(robot, setup, rows, count) for count in counts)
    for trials in (itertools.chain(usual, first), *others):
        explanations = _explanations(trials, given)
        if explanations:
            return _all_as_good(explanations)
    return None


def _explanations(trials: Iterable[Trial], given: float) -> list[tuple[float, Reason]]:
    """Find the trials that explain the rows.

    Args:
        trials: The trials.
        given: The rms error of the input as given [m].

    Returns:
        The weighted error, for ranking, and the reason of each trial whose error is far smaller.
    """
    explanations = []
    for trial in trials:
        error = _misfit(trial.robot, trial.setup, trial.rows)[0]
        weighted = trial.factor * error
        if error <= _EXPLAINED and weighted <= _FAR_BETTER * given:
            reason = Reason.of(trial.why, given_m=given, error_m=error, **trial.values)
            explanations.append((weighted, reason))
    return explanations


def _all_as_good(explanations: list[tuple[float, Reason]]) -> Reason:
    """Choose the explanation of the smallest weighted error, with those that the rows cannot tell from it."""
    ordered = [reason for _, reason in sorted(explanations, key=lambda pair: pair[0])]
    best = ordered[0]
    limit = _AS_GOOD * best.values["error_m"] + _ROUNDING
    others = []
    for reason in ordered[1:]:
        if reason.values["error_m"] <= limit:
            values = {name: value for name, value in reason.values.items() if name != "given_m"}
            others.append({"code": reason.code, **values})
    return replace(best, values={**best.values, "others": others}) if others else best


def _naming_only(cell: Cell, table: Measurements) -> Cell:
    """Copy a cell without the targets and frames that it names and no row of the table sees."""
    targets = {name: place for name, place in cell.targets.items() if name in table.targets}
    frames = {name: pose for name, pose in cell.frames.items() if name in table.groups}
    return replace(cell, targets=targets, frames=frames)


def _misfit(robot: Robot, setup: Setup, rows: Rows) -> tuple[float, float]:
    """Errors of the robot after registration of what the setup leaves unknown, rms [m], [rad]."""
    T_base_tip = robot.poses(rows.joints)
    placed = register(T_base_tip, setup, rows, tolerance=_TOLERANCE)
    residual = rows.residual(placed.target_poses(T_base_tip, rows.samples))
    square = np.mean(residual**2, axis=0)
    return float(np.sqrt(np.sum(square[:LENGTHS]))), float(np.sqrt(np.sum(square[LENGTHS:])))


def _other_orientations(robot: Robot, setup: Setup, rows: Rows) -> Reason | None:
    """Explain orientations that make no sense as given, but do as other software writes them; None if none does."""
    if not np.all(rows.where(lambda kind: kind.orientation)):
        return None
    given = _misfit(robot, setup, rows)[1]
    if given < _PLAUSIBLE_ANGLE:
        return None
    turned = Rotation.from_matrix(rows.measured[:, LENGTHS:12].reshape(-1, 3, 3))
    wxyz = turned.as_quat(scalar_first=True)
    trials = {
        "last": Rotation.from_quat(wxyz),
        "first": Rotation.from_quat(np.roll(wxyz, -2, 1)),
        "": turned.inv(),
    }
    best, reason = np.inf, None
    for scalar, rotation in trials.items():
        columns = np.hstack([rows.measured[:, :LENGTHS], rotation.as_matrix().reshape(-1, 9)])
        error = _misfit(robot, setup, replace(rows, measured=columns))[1]
        if error >= best:
            continue
        best = error
        why = Why.SCALAR_ELSEWHERE if scalar else Why.ORIENTATIONS_INVERSE
        values = {"scalar": scalar} if scalar else {}
        reason = Reason.of(why, given_rad=given, error_rad=error, **values)
    return reason if best < _FAR_BETTER * given else None


def _trials(robot: Robot, cell: Cell, setup: Setup, rows: Rows) -> Iterator[Trial]:
    """Undo the usual mistakes of targets, frames, joints, the order of rows, and points, one at a time."""
    free = _with_unknown_targets(setup)
    if not setup.estimate_target:
        yield Trial(_PLAIN, robot, free, rows, Why.TARGET_ELSEWHERE)
    if not cell.estimate_frame and cell.T_frame_base is None:
        yield from _bases(robot, free, rows)
    for joints, why, values in _joint_trials(robot, rows.joints):
        yield Trial(_ONE_OF_MANY, robot, free, _with_joints(rows, joints), why, values)
    after, before = rows.select(slice(1, None)), rows.select(slice(None, -1))
    for later, kept, joints in ((True, after, rows.joints[:-1]), (False, before, rows.joints[1:])):
        shifted, values = _with_joints(kept, joints), {"later": later}
        yield Trial(_ONE_OF_MANY, robot, free, shifted, Why.ROWS_SHIFTED, values)
    turns = any(len(directions) == len(DIRECTIONS) for directions in setup.unknown)
    for points, why, values in _point_trials(rows.measured, turns=turns):
        yield Trial(_ONE_OF_MANY, robot, free, replace(rows, measured=points), why, values)


def _bases(robot: Robot, setup: Setup, rows: Rows) -> Iterator[Trial]:
    """Try other links that are fixed to the base as the frame of the points, and an unknown frame."""
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
    """Try other links that carry the target: one for each set of joints that the table has values of."""
    fixed = {joint.name for joint in robot.urdf.joints if joint.type == "fixed"}
    tried = {frozenset(robot.joint_names)}
    for link in robot.urdf.links:
        moving = frozenset(itertools.chain(*robot.urdf.chain(robot.base, link))) - fixed
        measured = moving <= set(table.joint_names)
        if len(moving) < _FEWEST_JOINTS_OF_TIP or moving in tried or not measured:
            continue
        tried.add(moving)
        other = robot.rebuilt(tip=link)
        rows, setup = rows_and_setup(other, table, cell)
        free, points = _with_unknown_targets(setup), _as_points(rows)
        yield Trial(_FREE, other, free, points, Why.OTHER_TIP, {"link": link})


def _constant_joints(robot: Robot, setup: Setup, rows: Rows) -> Iterator[Trial]:
    """Try joints whose column holds one value at the values that would explain each row."""
    free = _with_unknown_targets(setup)
    for joint in np.flatnonzero(np.ptp(rows.joints, axis=0) == 0.0).tolist():
        moved = rows
        for reach in _REACHES:
            moved = _nearest_values(robot, free, moved, joint, reach)
        values = {"joint": robot.joint_names[joint]}
        yield Trial(_FREE, robot, free, moved, Why.JOINT_CONSTANT, values)


def _nearest_values(robot: Robot, setup: Setup, rows: Rows, joint: int, reach: float) -> Rows:
    """Copy rows with the value of a joint, by its number, that fits each row best, within a reach [rad] or [m]."""
    count, every = len(rows), np.arange(len(rows))
    T_base_tip = robot.poses(rows.joints)
    placed = register(T_base_tip, setup, rows, tolerance=_TOLERANCE)
    q = np.repeat(rows.joints, _TRIED, axis=0)
    q[:, joint] += np.tile(np.linspace(-reach, reach, _TRIED), count)
    repeated = rows.select(np.repeat(every, _TRIED))
    residual = repeated.residual(placed.target_poses(robot.poses(q), repeated.samples))
    nearest = np.argmin(np.sum(residual**2, axis=1).reshape(-1, _TRIED), axis=1)
    return _with_joints(rows, q[every * _TRIED + nearest])


def _with_joints(rows: Rows, q: Array) -> Rows:
    """Copy rows with other joint values, shape (N, m) [rad] or [m]."""
    return replace(rows, samples=replace(rows.samples, q=q))


def _with_unknown_targets(setup: Setup) -> Setup:
    """Copy a setup with every target unknown."""
    return replace(setup, target_unknown=np.ones(len(setup.targets), dtype=bool))


def _as_points(rows: Rows) -> Rows:
    """Copy poses as the points of their positions."""
    kinds = np.full_like(rows.kinds, registry.names().index("point"))
    return replace(rows, kinds=kinds, measured=rows.measured[:, :LENGTHS])


def _inverted(robot: Robot, setup: Setup, rows: Rows) -> Iterator[Trial]:
    """Invert poses, as if they were those of the frame in the target; no trial where not every row is a pose."""
    if not np.all(rows.where(lambda kind: kind.orientation)):
        return
    R = rows.measured[:, LENGTHS:12].reshape(-1, 3, 3)
    points = -np.einsum("nji,nj->ni", R, rows.measured[:, :LENGTHS])
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
    number = np.arange(3)
    if turns:
        yield -points, Why.POINTS_MIRRORED, {}
    else:
        orders = ([0, 2, 1], [2, 1, 0], [1, 0, 2])
        for i, axis in enumerate("xyz"):
            first, second = (other for other in "xyz" if other != axis)
            columns = {"first": first, "second": second}
            yield points[:, orders[i]], Why.COLUMNS_SWAPPED, columns
            yield points * np.where(number == i, -1.0, 1.0), Why.SIGN_TURNED, {"column": axis}
    for (unit, header), factor in _LENGTHS.items():
        units = {"unit": unit, "header": header}
        yield factor * points, Why.WRONG_UNIT, {"what": "points", **units}
        for i, axis in enumerate("xyz"):
            scaled = points * np.where(number == i, factor, 1.0)
            yield scaled, Why.WRONG_UNIT, {"what": f"values of '{axis}'", **units}


def _turned_joints(
    robot: Robot, setup: Setup, rows: Rows, counts: Iterable[int]
) -> Iterator[Trial]:
    """Reverse the sign of joints, in every combination of each of these numbers of joints at a time."""
    every = range(len(robot.inputs))
    free = _with_unknown_targets(setup)
    for count in counts:
        for joints in itertools.combinations(every, count):
            q = rows.joints * np.where(np.isin(every, joints), -1.0, 1.0)
            values = {"joints": ", ".join(robot.joint_names[i] for i in joints)}
            # The more signs, the more combinations.
            factor = 1.0 + 0.2 * count
            yield Trial(factor, robot, free, _with_joints(rows, q), Why.JOINTS_TURNED, values)


def _joint_trials(robot: Robot, q: Array) -> Iterator[tuple[Array, Why, dict[str, Any]]]:
    """Shift zeros of joints, swap their columns, and scale them from another unit.

    Args:
        robot: The robot.
        q: Joint values of the rows, shape (N, m) [rad] or [m].

    Yields:
        The joint values, the code of the mistake, and the values of its reason.
    """
    names, count = robot.joint_names, len(robot.inputs)
    turns = np.array([joint.type != "prismatic" for joint in robot.inputs])
    for i, turn in itertools.product(np.flatnonzero(turns).tolist(), np.radians(_TURNS_DEG)):
        values = {"add_rad": float(turn), "joint": names[i]}
        yield q + turn * np.eye(count)[i], Why.JOINT_ZERO, values
    for i, j in itertools.combinations(range(count), 2):
        order = list(range(count))
        order[i], order[j] = j, i
        yield q[:, order], Why.COLUMNS_SWAPPED, {"first": names[i], "second": names[j]}
    yield q[:, ::-1], Why.COLUMNS_REVERSED, {}
    for (unit, header), factor in _ANGLES.items():
        values = {"what": "joints", "unit": unit, "header": header}
        yield np.where(turns, factor, 1.0) * q, Why.WRONG_UNIT, values
