"""What a result rests on: the poses that were measured, the rows whose weight was lowered, the set-up as it was given.

A fit answers for what was measured; robust weights rest on the belief that a few rows are accidents; and where a
nominal arm is off by centimetres, the usual mistakes are tried on it, with the target registered anew.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import calib.data.kinds as registry
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.errors import MeasurementError
from calib.estimate.cross_validation import linear_cross_validation
from calib.estimate.fitting import Fitted, fit
from calib.estimate.registration import register
from calib.estimate.setup import LENGTHS, Rows, Setup, rows_of
from calib.estimate.statistics import Errors
from calib.model.error_model import DIRECTIONS
from calib.result.prediction import without_rigid_motion
from calib.result.verdict import Reason, Why
from calib.robot.robot import Robot
from calib.units import Array

#: A joint value is outside when it is further from the measured range than this share of it; less is none [rad or m].
_MARGIN, _STILL = 0.05, 1e-3


@dataclass(frozen=True, slots=True)
class Beyond:
    """A joint value outside the measured range."""

    joint: str  # The joint's name
    prismatic: bool  # Whether it slides
    by: float  # How far beyond the nearest measured value [rad or m]


@dataclass(frozen=True, slots=True)
class OutsideRow:
    """A row with joint values outside the measured range."""

    index: int  # Which of the rows asked for, from 0 on
    beyond: tuple[Beyond, ...]  # The joint furthest out first, in shares of their measured range


def outside(
    measured: Array, asked: Array, names: Sequence[str], types: Sequence[str]
) -> tuple[OutsideRow, ...]:
    """The rows asked for, (K, m), with joint values outside the range of the measured ones, (N, m) [rad or m].

    A continuous joint's range is what the largest gap on the circle leaves; a margin of 5 % is allowed.
    """
    if not len(measured) or not len(asked):
        return ()
    far, spans = np.zeros(asked.shape), np.zeros(len(names))
    for j, kind in enumerate(types):
        low, spans[j] = _range(measured[:, j], kind)
        after = asked[:, j] - low - spans[j]
        far[:, j] = np.maximum(0.0, np.maximum(low - asked[:, j], after))
        if kind == "continuous":
            after = np.mod(asked[:, j] - low, 2.0 * np.pi) - spans[j]
            nearest = np.minimum(after, 2.0 * np.pi - spans[j] - after)
            far[:, j] = np.where(after <= 0.0, 0.0, nearest)
    spans = np.maximum(spans, _STILL)
    out = far > np.maximum(_MARGIN * spans, _STILL)
    result = []
    for i in np.flatnonzero(out.any(axis=1)):
        order = [j for j in np.argsort(-far[i] / spans, kind="stable") if out[i, j]]
        beyond = (Beyond(names[j], types[j] == "prismatic", float(far[i, j])) for j in order)
        result.append(OutsideRow(int(i), tuple(beyond)))
    return tuple(result)


def spread_of(tips: Array, everywhere: Array) -> float:
    """Root mean square distance of measured tips (N, 3) from their mean, over that of tips all over the workspace."""
    one, other = (
        float(np.sum((points - points.mean(axis=0)) ** 2)) / max(len(points) - 1, 1)
        for points in (tips, everywhere)
    )
    # An arm whose tip cannot move at all has been measured everywhere.
    return float(np.sqrt(one / other)) if other > 0.0 else 1.0


def shares_of_ranges(joints: Array, ranges: Array, types: Sequence[str]) -> Array:
    """The share of each joint's range (m, 2), a full turn at most, that rows (N, m) use, 0 to 1, (m,)."""
    spans = np.array([_range(q, kind)[1] for q, kind in zip(joints.T, types, strict=True)])
    turning = np.array([kind != "prismatic" for kind in types])
    room = np.minimum(ranges[:, 1] - ranges[:, 0], np.where(turning, 2.0 * np.pi, np.inf))
    some = (room > 0.0) & np.isfinite(room)
    return np.where(some, np.minimum(spans / np.where(some, room, 1.0), 1.0), 1.0)


def _range(q: Array, kind: str) -> tuple[float, float]:
    """Where the measured values begin, and how far they reach from there."""
    if kind != "continuous":
        return float(q.min()), float(np.ptp(q))
    turned = np.sort(np.mod(q, 2.0 * np.pi))
    gaps = np.diff(turned, append=turned[0] + 2.0 * np.pi)
    widest = int(np.argmax(gaps))
    return float(turned[(widest + 1) % len(turned)]), float(2.0 * np.pi - gaps[widest])


@dataclass(frozen=True, slots=True, eq=False)
class Robustness:
    """The fit with the weights of doubtful rows lowered, beside the one with every row in full."""

    lowered: bool  # Whether it is the calibration that has the weights lowered, or the fit that it is compared with
    moved_rms: float  # How far the other fit's predictions at the measured poses lie from the calibration's [m]
    moved_max: float  # The same at most [m]
    # Of rows not flagged, left out of a linearised fit, with weights lowered
    errors_lowered: Errors
    errors_full: Errors  # The same with every row in full


def compare_weights(fitted: Fitted) -> Robustness:
    """Fit once more with robust weights where there were none, or without where there were, and compare."""
    estimate, rows = fitted.estimate, fitted.estimate.problem.rows
    task = replace(fitted.task, robust=not fitted.task.robust)
    other = fit(task, replace(rows, weights=None), started=fitted.setup)
    samples = rows.samples
    as_one_body = not any(kind.position for kind in rows.present)
    if as_one_body:
        samples = replace(samples, frame=np.zeros_like(samples.frame))
    here = fitted.kinematics.points(estimate.x, samples)
    moves = (other.kinematics.points(other.estimate.x, samples) - here)[:, :, None]
    if as_one_body:
        moves = without_rigid_motion(here, moves)
    flagged, both = estimate.outliers, (fitted, other) if fitted.task.robust else (other, fitted)
    try:
        left = [linear_cross_validation(one).residual[~flagged] for one in both]
        lowered, full = (Errors.of(residual, rows.used[~flagged]) for residual in left)
    except MeasurementError:  # rows of a single pose, of which none can be left out
        lowered = full = Errors.of(np.zeros((0, rows.width)))
    moved = np.linalg.norm(moves[:, :, 0], axis=1)
    return Robustness(
        lowered=fitted.task.robust,
        moved_rms=float(np.sqrt(np.mean(moved**2))),
        moved_max=float(np.max(moved)),
        errors_lowered=lowered,
        errors_full=full,
    )


#: Nominal errors below this need no other explanation than an uncalibrated arm [m]; another set-up must lower the error
#: to this share, and to this [m], to be named.
PLAUSIBLE, _FAR_BETTER, _EXPLAINED = 0.02, 0.2, 0.05

#: Joints up to which every combination of turned signs is tried, rows that are looked at, and the tolerance of a
#: registration: five digits are enough to compare.
_MOST_SIGNS, _ROWS, _TOLERANCE = 7, 60, 1e-6

#: The same of angles [rad]; how far round a joint without values it is sought in turn [rad], at so many values.
_PLAUSIBLE_ANGLE, _REACHES, _TRIED = 0.1, (np.pi, np.pi, np.pi, 0.2, 0.2, 0.02, 0.002), 41

#: Factors where numbers are in one unit and their header says another; the zeros that conventions differ by [deg].
_LENGTHS = {("in", "mm"): 25.4, ("mm", "in"): 1.0 / 25.4, ("m", "mm"): 1e3, ("mm", "m"): 1e-3}
_ANGLES = {("rad", "deg"): np.degrees(1.0), ("deg", "rad"): np.radians(1.0)}
_TURNS_DEG = (90.0, -90.0, 180.0)

#: A mistake undone: what its error counts times, robot, set-up, rows, and what it would mean.
Trial = tuple[float, Robot, Setup, Rows, Why, dict[str, Any]]


def better_setup(robot: Robot, cell: Cell, table: Measurements) -> Reason | None:
    """The set-up which explains the rows of a table far better than the one given, if there is one.

    Of poses the positions come first, of several targets and frames all are looked at together.
    """
    if not np.all(table.of_kind("point", "pose")):
        return None
    chosen = np.zeros(len(table), dtype=bool)
    chosen[np.linspace(0, len(table) - 1, min(len(table), _ROWS)).astype(int)] = True
    table = table.select(chosen)
    poses, setup = rows_of(robot, table, cell)
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
        ((1.2, robot, _loose(setup), *one) for one in more),
    )
    # A frame that is estimated too makes a trial a hundred times dearer: then two joints at most, and in the end.
    n = len(robot.inputs) if len(robot.inputs) <= _MOST_SIGNS else 1
    counts = ((1,), (2,)) if any(setup.unknown) else (range(1, n + 1),)
    first, *others = (_turned_joints(robot, setup, rows, some) for some in counts)
    for trials in (itertools.chain(usual, first), *others):
        best, found = np.inf, None
        for factor, other, asked, changed, why, values in trials:
            error = _misfit(other, asked, changed)[0]
            if factor * error < best:
                best, found = factor * error, Reason.of(why, given_m=given, error_m=error, **values)
        if found and best <= _FAR_BETTER * given and found.values["error_m"] <= _EXPLAINED:
            return found
    return None


def _misfit(robot: Robot, setup: Setup, rows: Rows) -> tuple[float, float]:
    """Errors of the robot where target (and frame, if asked) are registered, rms [m], [rad]."""
    T_base_tip = robot.poses(rows.joints)
    placed = register(T_base_tip, setup, rows, tolerance=_TOLERANCE)
    square = np.mean(rows.residual(placed.seen(T_base_tip, rows.samples)) ** 2, axis=0)
    return float(np.sqrt(np.sum(square[:LENGTHS]))), float(np.sqrt(np.sum(square[LENGTHS:])))


def _other_orientations(robot: Robot, setup: Setup, rows: Rows) -> Reason | None:
    """Orientations as other software writes them, where those given make no sense and these do."""
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
    """The usual mistakes, undone."""
    asked = _loose(setup)
    if not setup.estimate_target:
        yield 1.0, robot, asked, rows, Why.TARGET_ELSEWHERE, {}
    if not cell.estimate_frame and cell.T_frame_base is None:
        moving = {joint.name for joint in robot.urdf.joints if joint.type != "fixed"}
        for link in robot.urdf.links:
            way = itertools.chain(*robot.urdf.chain(robot.base, link))
            if link != robot.base and moving.isdisjoint(way):
                yield 1.0, robot.rebuilt(base=link), asked, rows, Why.OTHER_BASE, {"link": link}
        if len(rows) >= 4:
            # A frame of its own always fits a little better: it must do more than that.
            own = replace(asked, unknown=(DIRECTIONS,) * len(setup.groups))
            yield 2.0, robot, own, rows, Why.OWN_FRAME, {}
    for joints, why, values in _joint_trials(robot, rows.joints):
        turned = replace(rows, samples=replace(rows.samples, q=joints))
        yield 1.2, robot, asked, turned, why, values
    for later, some in ((True, slice(1, None)), (False, slice(None, -1))):
        kept = rows.select(some)
        others = rows.joints[:-1] if later else rows.joints[1:]
        shifted = replace(kept, samples=replace(kept.samples, q=others))
        yield 1.2, robot, asked, shifted, Why.ROWS_SHIFTED, {"later": later}
    turns = any(len(directions) == len(DIRECTIONS) for directions in setup.unknown)
    for points, why, values in _point_trials(rows.measured, turns=turns):
        yield 1.2, robot, asked, replace(rows, measured=points), why, values


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
            rows, setup = rows_of(other, table, cell)
            yield 1.5, other, _loose(setup), _as_points(rows), Why.OTHER_TIP, {"link": link}


def _constant_joints(robot: Robot, setup: Setup, rows: Rows) -> Iterator[Trial]:
    """Joints whose column holds one value, where they would have been at each row to explain it."""
    asked = _loose(setup)
    for j in np.flatnonzero(np.ptp(rows.joints, axis=0) == 0.0).tolist():
        turned, every = rows, np.arange(len(rows))
        for reach in _REACHES:
            T_base_tip = robot.poses(turned.joints)
            placed = register(T_base_tip, asked, turned, tolerance=_TOLERANCE)
            q = np.repeat(turned.joints, _TRIED, axis=0)
            q[:, j] += np.tile(np.linspace(-reach, reach, _TRIED), len(rows))
            again = turned.select(np.repeat(every, _TRIED))
            error = again.residual(placed.seen(robot.poses(q), again.samples))
            nearest = np.argmin(np.sum(error**2, axis=1).reshape(-1, _TRIED), axis=1)
            found = q[every * _TRIED + nearest]
            turned = replace(turned, samples=replace(turned.samples, q=found))
        yield 1.5, robot, asked, turned, Why.JOINT_CONSTANT, {"joint": robot.joint_names[j]}


def _loose(setup: Setup) -> Setup:
    """With every target to be found."""
    return replace(setup, target_unknown=np.ones(len(setup.targets), dtype=bool))


def _as_points(rows: Rows) -> Rows:
    """The positions of poses."""
    kinds = np.full_like(rows.kinds, registry.names().index("point"))
    return replace(rows, kinds=kinds, measured=rows.measured[:, :LENGTHS])


def _inverted(rows: Rows) -> tuple[Rows, Why, dict[str, Any]] | None:
    """Poses of the frame in the target, turned round; None where not every row is a pose."""
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
    """So many joints at a time with the other sign."""
    every = range(len(robot.inputs))
    for some in itertools.chain(*(itertools.combinations(every, count) for count in counts)):
        q = rows.joints * np.where(np.isin(every, some), -1.0, 1.0)
        turned = replace(rows, samples=replace(rows.samples, q=q))
        values = {"joints": ", ".join(robot.joint_names[i] for i in some)}
        factor = 1.0 + 0.2 * len(some)
        yield factor, robot, _loose(setup), turned, Why.JOINTS_TURNED, values


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
