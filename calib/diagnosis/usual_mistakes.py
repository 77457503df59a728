"""The usual mistakes of a set-up: where a nominal arm is off by centimetres, each one is undone in a trial.

In each trial the target is registered anew. Explanations that the rows cannot tell apart are all named.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import replace
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

#: Another set-up must lower the error to this share of it, and to so much [m], to be named.
_FAR_BETTER = 0.2
_EXPLAINED = 0.05

#: Explanations whose errors are within this factor cannot be told apart: errors of an uncalibrated arm may favour any.
_AS_GOOD = 1.5
_ROUNDING = 1e-6

#: The most joints of which every combination of reversed signs is tried.
_MOST_SIGNS = 7

#: The most rows that are looked at.
_ROWS = 60

#: Tolerance of a registration: five digits are enough to compare.
_TOLERANCE = 1e-6

#: Errors of orientations below this need no other explanation than an uncalibrated arm [rad].
_PLAUSIBLE_ANGLE = 0.1

#: Ranges about the last value in which the value of a joint without values is sought, one after the other [rad].
_REACHES = (np.pi, np.pi, np.pi, 0.2, 0.2, 0.02, 0.002)

#: Values that are tried in each range.
_TRIED = 41

#: Factors where lengths are in one unit and their header says another.
_LENGTHS = {("in", "mm"): 25.4, ("mm", "in"): 1.0 / 25.4, ("m", "mm"): 1e3, ("mm", "m"): 1e-3}

#: The same of angles.
_ANGLES = {("rad", "deg"): np.degrees(1.0), ("deg", "rad"): np.radians(1.0)}

#: Offsets of joint zeros between conventions [deg].
_TURNS_DEG = (90.0, -90.0, 180.0)

#: A mistake undone: factor on its error when trials are ranked, robot, set-up, rows, code and values of its reason.
Trial = tuple[float, Robot, Setup, Rows, Why, dict[str, Any]]


#: Positions that differ by less are one position [m].
_ONE_PLACE = 1e-6

#: A tip that moves by more than this cannot have stayed at one position [m].
_FAR_APART = 1e-2


def check_positions(robot: Robot, rows: Rows, source: str) -> None:
    """Refuse measured positions that are all the same, though the joint values move the tip: any fit of them collapses.

    Raises:
        MeasurementError: They are; the text names the file ``source`` and the place.
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
    """Find a set-up that explains the rows of a table far better than the one given, if there is one.

    Of poses the positions are examined first; several targets and frames are examined together.
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
    inverse = _inverted(poses)
    more = [inverse] if inverse is not None else []
    usual = itertools.chain(
        _trials(robot, cell, setup, rows),
        _tips(robot, cell, table),
        _constant_joints(robot, setup, rows),
        ((1.2, robot, _with_unknown_targets(setup), *one) for one in more),
    )
    # An unknown frame makes a trial a hundred times as expensive: then two joints at most, and last.
    n = len(robot.inputs) if len(robot.inputs) <= _MOST_SIGNS else 1
    counts = ((1,), (2,)) if any(setup.unknown) else (range(1, n + 1),)
    first, *others = (_turned_joints(robot, setup, rows, some) for some in counts)
    for trials in (itertools.chain(usual, first), *others):
        explanations = [
            (factor * error, Reason.of(why, given_m=given, error_m=error, **values))
            for factor, other, loose, changed, why, values in trials
            if (error := _misfit(other, loose, changed)[0]) <= _EXPLAINED
        ]
        explanations = [one for one in explanations if one[0] <= _FAR_BETTER * given]
        if explanations:
            return _all_as_good(explanations)
    return None


def _all_as_good(explanations: list[tuple[float, Reason]]) -> Reason:
    """The best of some explanations, ranked by their weighted errors, with those that the rows cannot tell from it."""
    ordered = sorted(explanations, key=lambda one: one[0])
    best = ordered[0][1]
    limit = _AS_GOOD * best.values["error_m"] + _ROUNDING
    others = [
        {"code": reason.code, **{k: v for k, v in reason.values.items() if k != "given_m"}}
        for _, reason in ordered[1:]
        if reason.values["error_m"] <= limit
    ]
    return replace(best, values={**best.values, "others": others}) if others else best


def _naming_only(cell: Cell, table: Measurements) -> Cell:
    """The cell without the targets and frames that it names and no row of the table sees."""
    targets = {name: place for name, place in cell.targets.items() if name in table.targets}
    frames = {name: pose for name, pose in cell.frames.items() if name in table.groups}
    return replace(cell, targets=targets, frames=frames)


def _misfit(robot: Robot, setup: Setup, rows: Rows) -> tuple[float, float]:
    """Errors of the robot after registration of what the set-up leaves unknown, rms [m], [rad]."""
    T_base_tip = robot.poses(rows.joints)
    placed = register(T_base_tip, setup, rows, tolerance=_TOLERANCE)
    square = np.mean(rows.residual(placed.target_poses(T_base_tip, rows.samples)) ** 2, axis=0)
    return float(np.sqrt(np.sum(square[:LENGTHS]))), float(np.sqrt(np.sum(square[LENGTHS:])))


def _other_orientations(robot: Robot, setup: Setup, rows: Rows) -> Reason | None:
    """Explain orientations that make no sense as given, but do as other software writes them."""
    if not np.all(rows.where(lambda kind: kind.orientation)):
        return None
    given, best, found = _misfit(robot, setup, rows)[1], np.inf, None
    if given < _PLAUSIBLE_ANGLE:
        return None
    turned = Rotation.from_matrix(rows.measured[:, LENGTHS:12].reshape(-1, 3, 3))
    wxyz = turned.as_quat(scalar_first=True)
    trials = {"last": Rotation.from_quat(wxyz), "first": Rotation.from_quat(np.roll(wxyz, -2, 1))}
    for scalar, other in (*trials.items(), ("", turned.inv())):
        columns = np.hstack([rows.measured[:, :LENGTHS], other.as_matrix().reshape(-1, 9)])
        error = _misfit(robot, setup, replace(rows, measured=columns))[1]
        if error < best:
            why = Why.SCALAR_ELSEWHERE if scalar else Why.ORIENTATIONS_INVERSE
            best, values = error, {"scalar": scalar} if scalar else {}
            found = Reason.of(why, given_rad=given, error_rad=error, **values)
    return found if best < _FAR_BETTER * given else None


def _trials(robot: Robot, cell: Cell, setup: Setup, rows: Rows) -> Iterator[Trial]:
    """Undo the usual mistakes, one at a time."""
    loose = _with_unknown_targets(setup)
    if not setup.estimate_target:
        yield 1.0, robot, loose, rows, Why.TARGET_ELSEWHERE, {}
    if not cell.estimate_frame and cell.T_frame_base is None:
        moving = {joint.name for joint in robot.urdf.joints if joint.type != "fixed"}
        for link in robot.urdf.links:
            way = itertools.chain(*robot.urdf.chain(robot.base, link))
            if link != robot.base and moving.isdisjoint(way):
                yield 1.0, robot.rebuilt(base=link), loose, rows, Why.OTHER_BASE, {"link": link}
        if len(rows) >= 4:
            # An unknown frame always fits a little better: it must do better than that.
            own = replace(loose, unknown=(DIRECTIONS,) * len(setup.groups))
            yield 2.0, robot, own, rows, Why.OWN_FRAME, {}
    for joints, why, values in _joint_trials(robot, rows.joints):
        turned = replace(rows, samples=replace(rows.samples, q=joints))
        yield 1.2, robot, loose, turned, why, values
    for later, some in ((True, slice(1, None)), (False, slice(None, -1))):
        kept = rows.select(some)
        others = rows.joints[:-1] if later else rows.joints[1:]
        shifted = replace(kept, samples=replace(kept.samples, q=others))
        yield 1.2, robot, loose, shifted, Why.ROWS_SHIFTED, {"later": later}
    turns = any(len(directions) == len(DIRECTIONS) for directions in setup.unknown)
    for points, why, values in _point_trials(rows.measured, turns=turns):
        yield 1.2, robot, loose, replace(rows, measured=points), why, values


def _tips(robot: Robot, cell: Cell, table: Measurements) -> Iterator[Trial]:
    """Other links that carry the target: one for each set of joints that the table has values of."""
    fixed = {joint.name for joint in robot.urdf.joints if joint.type == "fixed"}
    seen = {frozenset(robot.joint_names)}
    for link in robot.urdf.links:
        moving = frozenset(itertools.chain(*robot.urdf.chain(robot.base, link))) - fixed
        # On the axes of two joints a target stands still, as points in a wrong unit nearly do.
        if len(moving) > 2 and moving not in seen and moving <= set(table.joint_names):
            seen.add(moving)
            other = robot.rebuilt(tip=link)
            rows, setup = rows_and_setup(other, table, cell)
            yield (
                1.5,
                other,
                _with_unknown_targets(setup),
                _as_points(rows),
                Why.OTHER_TIP,
                {"link": link},
            )


def _constant_joints(robot: Robot, setup: Setup, rows: Rows) -> Iterator[Trial]:
    """Joints whose column holds one value, where they would have been at each row to explain it."""
    loose = _with_unknown_targets(setup)
    for j in np.flatnonzero(np.ptp(rows.joints, axis=0) == 0.0).tolist():
        turned, every = rows, np.arange(len(rows))
        for reach in _REACHES:
            T_base_tip = robot.poses(turned.joints)
            placed = register(T_base_tip, loose, turned, tolerance=_TOLERANCE)
            q = np.repeat(turned.joints, _TRIED, axis=0)
            q[:, j] += np.tile(np.linspace(-reach, reach, _TRIED), len(rows))
            again = turned.select(np.repeat(every, _TRIED))
            error = again.residual(placed.target_poses(robot.poses(q), again.samples))
            nearest = np.argmin(np.sum(error**2, axis=1).reshape(-1, _TRIED), axis=1)
            found = q[every * _TRIED + nearest]
            turned = replace(turned, samples=replace(turned.samples, q=found))
        yield 1.5, robot, loose, turned, Why.JOINT_CONSTANT, {"joint": robot.joint_names[j]}


def _with_unknown_targets(setup: Setup) -> Setup:
    """The set-up with every target unknown."""
    return replace(setup, target_unknown=np.ones(len(setup.targets), dtype=bool))


def _as_points(rows: Rows) -> Rows:
    """The positions of poses."""
    kinds = np.full_like(rows.kinds, registry.names().index("point"))
    return replace(rows, kinds=kinds, measured=rows.measured[:, :LENGTHS])


def _inverted(rows: Rows) -> tuple[Rows, Why, dict[str, Any]] | None:
    """Invert poses, as if they were those of the frame in the target; None where not every row is a pose."""
    if not np.all(rows.where(lambda kind: kind.orientation)):
        return None
    R = rows.measured[:, LENGTHS:12].reshape(-1, 3, 3)
    points = -np.einsum("nji,nj->ni", R, rows.measured[:, :LENGTHS])
    return replace(_as_points(rows), measured=points), Why.POSES_INVERSE, {}


def _point_trials(points: Array, *, turns: bool) -> Iterator[tuple[Array, Why, dict[str, Any]]]:
    """Points, shape (N, 3), of a mirrored frame, and in other units; ``turns``: in a frame that may turn freely."""
    if turns:  # then every swap of two columns is a mirror, and so is every sign
        yield -points, Why.POINTS_MIRRORED, {}
    for i, axis in enumerate("" if turns else "xyz"):
        order = [[0, 2, 1], [2, 1, 0], [1, 0, 2]][i]
        first, second = (one for one in "xyz" if one != axis)
        yield points[:, order], Why.COLUMNS_SWAPPED, {"first": first, "second": second}
        yield points * np.where(np.arange(3) == i, -1.0, 1.0), Why.SIGN_TURNED, {"column": axis}
    for (unit, header), size in _LENGTHS.items():
        yield size * points, Why.WRONG_UNIT, {"what": "points", "unit": unit, "header": header}
        for i, axis in enumerate("xyz"):
            values = {"what": f"values of '{axis}'", "unit": unit, "header": header}
            yield points * np.where(np.arange(3) == i, size, 1.0), Why.WRONG_UNIT, values


def _turned_joints(
    robot: Robot, setup: Setup, rows: Rows, counts: Iterable[int]
) -> Iterator[Trial]:
    """Reverse the sign of ``counts`` joints at a time."""
    every = range(len(robot.inputs))
    for some in itertools.chain(*(itertools.combinations(every, count) for count in counts)):
        q = rows.joints * np.where(np.isin(every, some), -1.0, 1.0)
        turned = replace(rows, samples=replace(rows.samples, q=q))
        values = {"joints": ", ".join(robot.joint_names[i] for i in some)}
        factor = 1.0 + 0.2 * len(some)
        yield factor, robot, _with_unknown_targets(setup), turned, Why.JOINTS_TURNED, values


def _joint_trials(robot: Robot, q: Array) -> Iterator[tuple[Array, Why, dict[str, Any]]]:
    """Joints of another zero, in other units, and in each other's columns; q has shape (N, n)."""
    names, n = robot.joint_names, len(robot.inputs)
    turns = np.array([joint.type != "prismatic" for joint in robot.inputs])
    for i, turn in itertools.product(np.flatnonzero(turns).tolist(), np.radians(_TURNS_DEG)):
        values = {"add_rad": float(turn), "joint": names[i]}
        yield q + turn * np.eye(n)[i], Why.JOINT_ZERO, values
    for i, j in itertools.combinations(range(n), 2):
        order = [{i: j, j: i}.get(k, k) for k in range(n)]
        yield q[:, order], Why.COLUMNS_SWAPPED, {"first": names[i], "second": names[j]}
    yield q[:, ::-1], Why.COLUMNS_REVERSED, {}
    for (unit, header), size in _ANGLES.items():
        values = {"what": "joints", "unit": unit, "header": header}
        yield np.where(turns, size, 1.0) * q, Why.WRONG_UNIT, values
