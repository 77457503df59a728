"""Mistakes in DH rows: the cell that is wrong, and what it should hold.

Each mistake is undone in the rows, and the robot of these rows is compared with the measured poses. Rows with a cell
undone are either *likely* ones (another sign, a quarter turn, cells or rows exchanged, the other convention, another
arm of the same make) or have *free* numbers, which the measured poses determine. A free number is that of one screw
along or about an axis z or x of the rows, S: with the poses B before and C after it,

    T_base_target = B S(x) C,    sum |B^-1 P - S(x) c|^2 = min,

P the measured points (and the columns of the measured rotations), c those that C predicts. Of a length x is a mean, of
an angle it is an arctangent. Positions are linear in all lengths together, so two or three that are wrong are found by
linear least squares.

Poses that a controller computes from its own rows agree with the right ones but for rounding. A single cell that lowers
centimetres, or millimetres, to that is the wrong one; no error of a real arm does so.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calib.basics.arrays import Array, rigid_inverse
from calib.diagnosis.reasons import Reason, Why
from calib.diagnosis.trials import misfit
from calib.fit.registration.rows import Rows
from calib.fit.registration.setup import Setup
from calib.robot.dh_file import lines_of_joints
from calib.robot.dh_rows import HAYATI, MODIFIED, STANDARD, DHRobot, DHRow, screw
from calib.robot.robot import Robot
from calib.robot.ur_models import MODELS

#: What each reading of a joint may be off in poses of a controller: two units of the last digit that it shows [rad].
_LAST_DIGITS = np.radians(0.02)

#: A mistake without a free number is named only if undoing it lowers the error to this share; with free numbers to
#: this share divided by one more than these are.
_FAR_BETTER = 0.2

#: A smaller change of an angle is an error of an arm, whose joint's zero may be off by as much, and no slip [rad].
_LEAST_TURN = np.radians(3.0)

#: Nominal errors below these may be those of an arm, if a frame or a target is registered [m] and [rad].
_PLAUSIBLE = {"m": 0.02, "rad": 0.1}

#: The most lengths that are wrong together.
_MOST_LENGTHS = 3

#: Measured coordinates that have to remain after the free numbers, so that these do not explain anything.
_LEFT_OVER = 4

#: The columns of two or three lengths are the same if their Gram matrix is worse conditioned.
_WORST_CONDITION = 1e6

#: Errors within this factor, or below this share of the rounding, are equal.
_AS_GOOD = 1.5
_OF_ROUNDING = 0.1

#: Angles of rows that are usual [rad].
_USUAL_ANGLES = (0.0, np.pi / 2.0, -np.pi / 2.0, np.pi)

#: Turns by which conventions of a row's theta differ [rad].
_TURNS = (np.pi / 2.0, -np.pi / 2.0, np.pi)

#: Numbers that differ by less are the same [m or rad].
_SAME = 1e-6

#: Lengths whose columns are in another unit than the heading says: that unit, the heading's, and the factor.
_LENGTH_UNITS = (("cm", "mm", 10.0), ("m", "mm", 1e3), ("in", "mm", 25.4))

#: The columns of lengths, and of angles.
_LENGTHS = ("d", "a")
_ANGLES = ("theta", "alpha")

#: Axes about and along which the numbers of a row are: x or z.
_AXES = {"d": 2, "theta": 2, "a": 0, "alpha": 0}


@dataclass(frozen=True, slots=True)
class Cell:
    """A cell of a table of DH rows, with the number that it holds and the one that would explain the poses."""

    #: The row's joint.
    joint: str
    #: The column's name, such as ``"alpha"``.
    column: str
    #: What it holds [m or rad]; 1 or -1 of a direction.
    stated: float
    #: What it should hold.
    wanted: float


@dataclass(frozen=True, slots=True, eq=False)
class CorrectedRows:
    """DH rows in which a mistake is undone."""

    #: The robot of these rows.
    robot: DHRobot
    #: The mistake.
    why: Why
    #: The cells that are changed; none if whole rows or columns are.
    cells: tuple[Cell, ...] = ()
    #: Further values of the reason.
    values: tuple[tuple[str, Any], ...] = ()
    #: Numbers that the measured poses determine.
    free: int = 0

    def poses(self, q: Array, names: Sequence[str]) -> Array:
        """Return T_base_tip, shape (N, 4, 4) [m].

        Args:
            q: Readings of the joints, shape (N, n) [rad] or [m].
            names: The joint of each column.
        """
        return self.robot.poses(q[:, [names.index(name) for name in self.robot.joint_names]])

    def reason_values(self, lines: Mapping[str, int]) -> dict[str, Any]:
        """Return the values of the reason, without errors.

        Args:
            lines: Line of each joint's row in the file of the rows, by the joint's name; those not known are left out.
        """
        values = dict(self.values)
        if not self.cells:
            return values
        cells = []
        for cell in self.cells:
            told: dict[str, Any] = {
                "joint": cell.joint,
                "column": cell.column,
                "stated": cell.stated,
                "wanted": cell.wanted,
                "unit": _unit_of(cell.column, self.robot.table.rows, cell.joint),
            }
            if cell.joint in lines:
                told["line"] = lines[cell.joint]
            cells.append(told)
        return {**values, "cells": cells, **_elsewhere(self.robot, self.cells)}


def stated_rows(robot: Robot, q: Array) -> DHRobot | None:
    """Return the DH rows of a robot; None if it was not made from rows, or is not the robot of its rows any more.

    Args:
        robot: The robot. A corrected one still has the rows of the nominal one, and base or tip may be other links.
        q: Readings of its joints, shape (N, m) [rad] or [m].
    """
    rows = robot.urdf.dh
    if rows is None or set(rows.joint_names) != set(robot.joint_names):
        return None
    rows = replace(rows, coupling=robot.reading_coupling)
    same = CorrectedRows(rows, Why.DH_CELLS).poses(q, robot.joint_names)
    return rows if np.allclose(same, robot.poses(q), rtol=0.0, atol=_SAME) else None


def find_wrong_cell(robot: Robot, setup: Setup, rows: Rows) -> Reason | None:
    """Find the mistake in a robot's DH rows that poses of its controller show, which agree but for rounding.

    Frames and targets that were given count as they were given; others are registered.

    Args:
        robot: The robot; of one that was not made from DH rows nothing is examined.
        setup: Frames and targets, with what is estimated.
        rows: N rows of points or poses.

    Returns:
        The mistake, with the errors as given and with it undone [m] and [rad], and others that explain the rows as
        well; None if the rows agree as they are, or no single mistake explains them but for rounding.
    """
    dh = stated_rows(robot, rows.joints)
    if dh is None:
        return None
    names = robot.joint_names
    places = setup.with_given_fixed()

    def errors_of(corrected: CorrectedRows) -> tuple[float, float]:
        position, angle = misfit(corrected.poses(rows.joints, names), places, rows)
        return position, (angle if np.isfinite(angle) else 0.0)

    limit = _rounding(dh)
    given = np.array(errors_of(CorrectedRows(dh, Why.DH_CELLS)))
    known = places.count == 0 and bool(np.all(rows.where(lambda kind: kind.orientation)))
    smallest = limit / _FAR_BETTER if known else np.array([*_PLAUSIBLE.values()])
    if np.all(given < smallest):
        return None

    measured = _MeasuredPoses.of(setup, rows) if places.count == 0 else None
    searches: list[Iterable[CorrectedRows]] = [likely_rows(dh)]
    if measured is None:
        searches.append(rows_of_fitting_lengths(dh, names, places, rows))
    else:
        searches.append(measured.rows_of_one_number(dh, names))
        searches.append(measured.rows_of_lengths(dh, names, 2, limit[0]))
        searches.append(measured.rows_of_lengths(dh, names, 3, limit[0]))
    for search in searches:
        found = []
        for corrected in search:
            errors = np.array(errors_of(corrected))
            share = _FAR_BETTER / (1 + corrected.free)
            if np.all(errors <= limit) and np.max(errors / limit) <= share * np.max(given / limit):
                found.append((float(np.max(errors / limit)), corrected, errors))
        if found:
            return _reason_of(robot, dh, found, given, rows)
    return None


def _reason_of(
    robot: Robot,
    dh: DHRobot,
    found: Sequence[tuple[float, CorrectedRows, Array]],
    given: Array,
    rows: Rows,
) -> Reason:
    """Make the reason of the best of several corrections, with the others that fit as well.

    Each has its error in units of the rounding, and its errors [m] and [rad]. Of those that fit as well, cells that
    hold a number come before empty ones, and fewer cells before more.
    """
    smallest = min(error for error, _, _ in found)
    limit = max(_AS_GOOD * smallest, smallest + _OF_ROUNDING)
    as_good = [entry for entry in found if entry[0] <= limit]

    def likelihood(entry: tuple[float, CorrectedRows, Array]) -> tuple[int, int, float]:
        error, corrected, _ = entry
        empty = sum(abs(cell.stated) < _SAME for cell in corrected.cells)
        return empty, len(corrected.cells), error

    lines = lines_of_joints(robot.urdf.path)
    has_angles = bool(np.any(rows.where(lambda kind: kind.orientation)))
    reasons = []
    for _, corrected, errors in sorted(as_good, key=likelihood):
        values = {"error_m": float(errors[0])}
        if has_angles:
            values["error_rad"] = float(errors[1])
        reasons.append((corrected, {**values, **corrected.reason_values(lines)}))
    best, best_values = reasons[0]
    stated = {"given_m": float(given[0])}
    if has_angles:
        stated["given_rad"] = float(given[1])
    # The same robot, told otherwise, is no other explanation.
    rng_free = np.linspace(-1.0, 1.0, 5)[:, None] * np.arange(1.0, 1.0 + len(dh.joint_names))
    chosen = best.poses(rng_free, robot.joint_names)
    others = []
    for corrected, values in reasons[1:]:
        poses = corrected.poses(rng_free, robot.joint_names)
        if not np.allclose(poses, chosen, rtol=0.0, atol=1e-3):
            others.append({"code": str(corrected.why.value), **values})
    found_values: dict[str, Any] = {**stated, **best_values}
    if others:
        found_values["others"] = others
    return Reason.of(best.why, **found_values)


def _rounding(dh: DHRobot) -> Array:
    """Return the largest rms errors that rounding of a controller's poses explains: [m] and [rad], shape (2,).

    Every joint turns by `_LAST_DIGITS`, with half of the stretched arm as its lever.
    """
    angle = np.sqrt(len(dh.table.rows)) * _LAST_DIGITS
    lever = 0.5 * sum(np.hypot(row.a, row.d) for row in dh.table.rows)
    return np.array([angle * max(lever, 0.1), angle])


# Likely mistakes


def likely_rows(dh: DHRobot) -> Iterator[CorrectedRows]:
    """Yield rows in which a mistake that leaves no number open is undone.

    Args:
        dh: The robot as its rows state it.
    """
    rows = dh.table.rows
    for i, row in enumerate(rows):
        yield from _likely_cells(dh, i)
        for pair in (_LENGTHS, _ANGLES):
            first, second = (getattr(row, column) for column in pair)
            if abs(first - second) > _SAME:
                yield _with_cells(dh, [(i, pair[0], second), (i, pair[1], first)])
    for i, j in itertools.combinations(range(len(rows)), 2):
        for column in _AXES:
            first, second = getattr(rows[i], column), getattr(rows[j], column)
            if abs(first - second) > _SAME:
                yield _with_cells(dh, [(i, column, second), (j, column, first)])
        yield from _exchanged_rows(dh, i, j)
    yield from _other_conventions(dh)
    yield from _other_arms(dh)
    yield from _other_units(dh)


def _likely_cells(dh: DHRobot, i: int) -> Iterator[CorrectedRows]:
    """Yield rows with one number of row i, from 0, reversed, or at a usual angle, or its joint's sense reversed."""
    row = dh.table.rows[i]
    for column in _LENGTHS:
        if abs(getattr(row, column)) > _SAME:
            yield _with_cells(dh, [(i, column, -getattr(row, column))])
    for angle in dict.fromkeys((-row.alpha, *_USUAL_ANGLES)):
        if abs(_turn(angle - row.alpha)) > _LEAST_TURN:
            yield _with_cells(dh, [(i, "alpha", angle)])
    yield _with_cells(dh, [(i, "direction", -row.direction)])
    if row.prismatic:
        return
    for column in ("theta", "offset"):
        angle = getattr(row, column)
        if abs(_turn(-2.0 * angle)) > _LEAST_TURN:
            yield _with_cells(dh, [(i, column, -angle)])
    column = _column_of_zero(dh, i)
    for turn in _TURNS:
        yield _with_cells(dh, [(i, column, _turn(getattr(row, column) + turn))])


def _exchanged_rows(dh: DHRobot, i: int, j: int) -> Iterator[CorrectedRows]:
    """Yield the rows i and j, from 0, exchanged with their joints, and their numbers exchanged alone."""
    rows = [*dh.table.rows]
    first, second = rows[i], rows[j]
    values = (("first", first.joint), ("second", second.joint))
    rows[i], rows[j] = second, first
    whole = replace(dh, table=replace(dh.table, rows=tuple(rows)))
    yield CorrectedRows(whole, Why.DH_ROWS_EXCHANGED, values=values)
    if first.prismatic != second.prismatic:
        return
    rows[i] = replace(second, joint=first.joint, lower=first.lower, upper=first.upper)
    rows[j] = replace(first, joint=second.joint, lower=second.lower, upper=second.upper)
    numbers = replace(dh, table=replace(dh.table, rows=tuple(rows)))
    yield CorrectedRows(numbers, Why.DH_NUMBERS_EXCHANGED, values=values)


def _other_conventions(dh: DHRobot) -> Iterator[CorrectedRows]:
    """Yield the same numbers read in the other convention; none for rows with a beta."""
    if any(row.beta for row in dh.table.rows):
        return
    stated = dh.table.convention
    other = STANDARD if stated == MODIFIED else MODIFIED
    table = replace(dh.table, convention=other)
    yield CorrectedRows(
        replace(dh, table=table),
        Why.DH_CONVENTION,
        values=(("convention", other), ("stated", stated)),
    )


def _other_arms(dh: DHRobot) -> Iterator[CorrectedRows]:
    """Yield the other arms of Universal Robots, if the rows have the angles of these."""
    table = dh.table
    if table.convention not in (STANDARD, HAYATI) or len(table.rows) != len(MODELS[0].rows):
        return
    for model in MODELS:
        # Rows of theta, a, d, alpha.
        if any(
            abs(_turn(row.alpha - of_arm[3])) > 1e-3
            for row, of_arm in zip(table.rows, model.rows, strict=True)
        ):
            return
        rows = tuple(
            replace(row, a=float(of_arm[1]), d=float(of_arm[2]))
            for row, of_arm in zip(table.rows, model.rows, strict=True)
        )
        yield CorrectedRows(
            replace(dh, table=replace(table, rows=rows)),
            Why.DH_VARIANT,
            values=(("arm", model.name),),
        )


def _other_units(dh: DHRobot) -> Iterator[CorrectedRows]:
    """Yield rows in which a column, or both columns of lengths or of angles, are in another unit than stated."""
    for columns in (("a",), ("d",), _LENGTHS):
        for unit, header, factor in _LENGTH_UNITS:
            yield _in_unit(dh, columns, unit, header, factor)
    for columns in (("alpha",), ("theta",), _ANGLES):
        yield _in_unit(dh, columns, "rad", "deg", np.degrees(1.0))


def _in_unit(
    dh: DHRobot, columns: Sequence[str], unit: str, header: str, factor: float
) -> CorrectedRows:
    """Return the rows with the numbers of some columns multiplied by the factor between two units."""
    rows = []
    for row in dh.table.rows:
        scaled: dict[str, Any] = {column: factor * getattr(row, column) for column in columns}
        rows.append(replace(row, **scaled))
    what = f"numbers of {' and '.join(columns)} in the DH rows"
    values = (("what", what), ("unit", unit), ("header", header))
    return CorrectedRows(
        replace(dh, table=replace(dh.table, rows=tuple(rows))), Why.DH_UNIT, values=values
    )


def _with_cells(
    dh: DHRobot, cells: Sequence[tuple[int, str, float]], *, free: int = 0
) -> CorrectedRows:
    """Return the rows with other numbers in some cells: row from 0, column, number [m or rad]."""
    rows = [*dh.table.rows]
    changed = []
    for i, column, number in cells:
        stated = getattr(rows[i], column)
        changed.append(Cell(rows[i].joint, column, float(stated), float(number)))
        cell: dict[str, Any] = {column: number}
        rows[i] = replace(rows[i], **cell)
    table = replace(dh.table, rows=tuple(rows))
    return CorrectedRows(replace(dh, table=table), Why.DH_CELLS, tuple(changed), free=free)


def _column_of_zero(dh: DHRobot, i: int) -> str:
    """Return the column of the zero of row i, from 0: ``offset`` if rows have offsets and this one no theta."""
    row = dh.table.rows[i]
    if abs(row.theta) > _SAME:
        return "theta"
    return "offset" if any(other.offset for other in dh.table.rows) else "theta"


def _turn(angle: float) -> float:
    """Return an angle in (-pi, pi], [rad]."""
    return float(np.pi - (np.pi - angle) % (2.0 * np.pi))


def _unit_of(column: str, rows: Sequence[DHRow], joint: str) -> str:
    """Return the SI unit of a row's cell; empty for a direction."""
    if column == "direction":
        return ""
    slides = any(row.prismatic and row.joint == joint for row in rows)
    return "m" if column in _LENGTHS or (column == "offset" and slides) else "rad"


def _elsewhere(dh: DHRobot, cells: Sequence[Cell]) -> dict[str, str]:
    """Return what a wrong cell cannot be told from: the controller's ``base`` or ``tool``, or the ``joint`` itself."""
    if len(cells) == 1 and cells[0].column == "direction":
        return {"elsewhere": "joint"}
    ends = set()
    rows, modified = dh.table.rows, dh.table.convention == MODIFIED
    for cell in cells:
        along_z = cell.column in ("theta", "offset", "d")
        if (
            cell.joint == rows[-1].joint
            and cell.column != "direction"
            and (along_z or not modified)
        ):
            ends.add("tool")
        elif cell.joint == rows[0].joint and (along_z or modified):
            ends.add("base")
        else:
            ends.add("joint" if cell.column in ("theta", "offset") else "")
    return {"elsewhere": ends.pop()} if len(ends) == 1 and "" not in ends else {}


# Free numbers


def rows_of_fitting_lengths(
    dh: DHRobot, names: Sequence[str], setup: Setup, rows: Rows
) -> Iterator[CorrectedRows]:
    """Yield rows with one length that fits best while frames and targets are registered.

    The squares of the error are nearly a parabola of the length.

    Args:
        dh: The robot as its rows state it.
        names: The joint of each column of q.
        setup: Frames and targets, with what is registered.
        rows: N rows of points or poses.
    """
    step = 0.1 * max(sum(np.hypot(row.a, row.d) for row in dh.table.rows), 0.1)
    for i, row in enumerate(dh.table.rows):
        for column in _LENGTHS:
            stated = getattr(row, column)
            squares = []
            for change in (-step, 0.0, step):
                corrected = _with_cells(dh, [(i, column, stated + change)], free=1)
                squares.append(misfit(corrected.poses(rows.joints, names), setup, rows)[0] ** 2)
            curvature = squares[0] - 2.0 * squares[1] + squares[2]
            # A length that the registered places make up for has no curvature.
            if curvature <= 1e-3 * step**2:
                continue
            change = 0.5 * step * (squares[0] - squares[2]) / curvature
            yield _with_cells(dh, [(i, column, stated + change)], free=1)


@dataclass(frozen=True, slots=True, eq=False)
class _MeasuredPoses:
    """Measured targets in the base, of N rows, if frames and targets are known."""

    #: Readings of the joints, shape (N, m) [rad] or [m].
    q: Array
    #: Position of each target, shape (N, 3) [m].
    points: Array
    #: Orientation of each target, shape (N, 3, 3); None if some row has none.
    rotations: Array | None
    #: Pose of each row's target in the tip, shape (N, 4, 4) [m].
    T_tip_target: Array

    @classmethod
    def of(cls, setup: Setup, rows: Rows) -> _MeasuredPoses:
        """Return what rows measured in given frames of given targets."""
        T_base_frame = rigid_inverse(setup.T_frame_base)[rows.samples.frame]
        R = T_base_frame[:, :3, :3]
        points = np.einsum("nij,nj->ni", R, rows.measured[:, :3]) + T_base_frame[:, :3, 3]
        rotations = None
        if np.all(rows.where(lambda kind: kind.orientation)):
            rotations = R @ rows.measured[:, 3:12].reshape(-1, 3, 3)
        return cls(rows.joints, points, rotations, setup.T_tip_target[rows.samples.target])

    def axes(self, dh: DHRobot, names: Sequence[str]) -> tuple[dict[tuple[int, str], Array], Array]:
        """Return frames on the axes of all numbers of the rows, by row and column, and T_base_target, (N, 4, 4) [m]."""
        columns = [names.index(name) for name in dh.joint_names]
        values = dh.values(self.q[:, columns])
        T = np.tile(dh.table.T_base_0, (len(values), 1, 1))
        frames = {}
        for i, (row, value) in enumerate(zip(dh.table.rows, values.T, strict=True)):
            along_x = screw(0, row.alpha, row.a)
            along_z = replace(row, a=0.0, alpha=0.0, beta=0.0).matrix(value)
            parts = [("z", along_z), ("x", along_x)]
            if dh.table.convention == MODIFIED:
                parts.reverse()
            for axis, part in parts:
                T = T @ part
                for column in ("theta", "d") if axis == "z" else ("alpha", "a"):
                    frames[i, column] = T
            T = T @ screw(1, row.beta, 0.0)
        return frames, T @ dh.table.T_n_tip @ self.T_tip_target

    def rows_of_one_number(self, dh: DHRobot, names: Sequence[str]) -> Iterator[CorrectedRows]:
        """Yield rows with each number at the value that fits best; see the module's text."""
        frames, T_base_target = self.axes(dh, names)
        if self.points.size - 1 < _LEFT_OVER:
            return
        lever = max(0.5 * sum(np.hypot(row.a, row.d) for row in dh.table.rows), 0.1)
        for (i, column), B in frames.items():
            back = np.swapaxes(B[:, :3, :3], 1, 2)
            offset = B[:, :3, 3]
            predicted = np.einsum("nij,nj->ni", back, T_base_target[:, :3, 3] - offset)
            measured = np.einsum("nij,nj->ni", back, self.points - offset)
            axis = _AXES[column]
            row = dh.table.rows[i]
            if column in _LENGTHS:
                change = float(np.mean(measured[:, axis] - predicted[:, axis]))
                yield _with_cells(dh, [(i, column, getattr(row, column) + change)], free=1)
                continue
            before, after = predicted[..., None] / lever, measured[..., None] / lever
            if self.rotations is not None:
                before = np.concatenate([before, back @ T_base_target[:, :3, :3]], axis=2)
                after = np.concatenate([after, back @ self.rotations], axis=2)
            j, k = (axis + 1) % 3, (axis + 2) % 3
            sine = np.sum(after[:, k] * before[:, j] - after[:, j] * before[:, k])
            cosine = np.sum(after[:, j] * before[:, j] + after[:, k] * before[:, k])
            turn = float(np.arctan2(sine, cosine))
            if abs(turn) < _LEAST_TURN:
                continue
            cell = column
            if column == "theta":
                cell = "theta" if row.prismatic else _column_of_zero(dh, i)
            yield _with_cells(dh, [(i, cell, _turn(getattr(row, cell) + turn))], free=1)

    def rows_of_lengths(
        self, dh: DHRobot, names: Sequence[str], count: int, rounding: float
    ) -> Iterator[CorrectedRows]:
        """Yield rows with ``count`` lengths at the values that fit best, if these explain the positions [m]."""
        if self.points.size - count < _LEFT_OVER:
            return
        frames, T_base_target = self.axes(dh, names)
        cells = [key for key in frames if key[1] in _LENGTHS]
        residual = (self.points - T_base_target[:, :3, 3]).ravel()
        J = np.stack([frames[cell][:, :3, _AXES[cell[1]]].ravel() for cell in cells], axis=1)
        gram, moment = J.T @ J, J.T @ residual
        largest = len(self.points) * rounding**2
        for chosen in itertools.combinations(range(len(cells)), count):
            part = gram[np.ix_(chosen, chosen)]
            if np.linalg.cond(part) > _WORST_CONDITION:
                continue
            change = np.linalg.solve(part, moment[list(chosen)])
            squares = float(np.sum((residual - J[:, chosen] @ change) ** 2))
            if squares > largest or np.any(np.abs(change) < rounding):
                continue
            changed = []
            for number, delta in zip(chosen, change, strict=True):
                i, column = cells[number]
                changed.append((i, column, getattr(dh.table.rows[i], column) + float(delta)))
            yield _with_cells(dh, changed, free=count)
