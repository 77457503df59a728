"""Mistakes in the DH rows that a robot was made from: the cell that is wrong, and what it should hold.

Each mistake is a change of the rows that undoes it. All are tried alike: the robot of the changed rows is compared with
the measured poses, given targets and frames where they were given. Some changes leave a number x open. The target's
pose is then B S(x) C with S a screw along or about an axis z or x of the rows, so that the sum of squares is a parabola
of x for a length, and a sinusoid for an angle: few values of it give the best x. Positions are linear in all lengths
together, so two or three that are wrong are found by linear least squares.

Poses that a controller computes from its own rows agree with the right ones except for rounding. A change that lowers
centimetres, or millimetres, to that is the mistake; no error of a real arm does so.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from calib.basics.arrays import Array
from calib.diagnosis.reasons import Reason, Why
from calib.diagnosis.screening import errors_of_tips
from calib.diagnosis.trials import (
    AS_GOOD,
    FAR_BETTER,
    PLAUSIBLE,
    PLAUSIBLE_ANGLE,
    REGISTERED,
    misfit,
    with_joints,
)
from calib.fit.registration.rows import Rows
from calib.fit.registration.setup import Setup
from calib.robot.dh_rows import MODIFIED, STANDARD, DHRobot, DHRow
from calib.robot.robot import Robot
from calib.robot.ur_models import MODELS
from calib.robot.urdf import urdf_of_dh

#: What each reading of a joint may be off in poses of a controller: two units of the last digit that it shows [rad].
_LAST_DIGITS = np.radians(0.02)

#: A smaller change of an angle is not a slip but an error of an arm, whose joint's zero may be off by as much [rad].
_LEAST_TURN = np.radians(3.0)

#: The most lengths that are wrong together.
_MOST_LENGTHS = 3

#: Measured numbers that have to remain besides those that are free, which would explain anything otherwise.
_LEFT_OVER = 4

#: First step of the search for the best length of a cell, in levers (half lengths of the arm).
_LENGTH_STEP = 0.2

#: First step of that for the best angle [rad].
_ANGLE_STEP = np.pi / 6.0

#: Factor on the step from one round to the next.
_FINER = 0.05

#: Rounds of the search: one parabola is exact for a length, and two leave 1e-5 rad of an angle's sinusoid.
_ROUNDS = 2

#: The least curvature of the mean square that determines a number: 2 if this moves all rows by its own amount.
_LEAST_CURVATURE = 1e-3

#: Two or three lengths are not determined together if their columns are worse conditioned.
_WORST_CONDITION = 1e3

#: Errors that differ by less than this share of the rounding are equal.
_OF_ROUNDING = 0.1

#: Likely angles of rows [rad].
_QUARTER_TURNS = (0.0, np.pi / 2.0, -np.pi / 2.0, np.pi)

#: A length that fits and is this near to a likely one is that one: errors of an arm are of this size [m].
_SLIP = 3e-3

#: Numbers that differ by less are the same [m or rad].
_SAME = 1e-6

#: Entries of poses of two robots that differ by less are the same for rounded poses [m or 1].
_SAME_POSE = 1e-3

#: Units that a column may be in under a heading of another, with the heading and the factor: of lengths, and of angles.
_LENGTH_UNITS = (("cm", "mm", 10.0), ("m", "mm", 1e3), ("in", "mm", 25.4))
_ANGLE_UNITS = (("rad", "deg", float(np.degrees(1.0))),)

#: The columns of lengths, and of angles.
_LENGTHS = ("d", "a")
_ANGLES = ("theta", "alpha")


@dataclass(frozen=True, slots=True)
class DHCell:
    """A cell of a table of DH rows, with the number that it holds and the one that would explain the poses."""

    #: The row's joint.
    joint: str
    #: The column's name, such as ``"alpha"``.
    column: str
    #: ``"m"``, ``"rad"``, or empty for a direction.
    unit: str
    #: What it holds, in this unit.
    stated: float
    #: What it should hold.
    wanted: float
    #: Line of the table; 0: the rows are of no table.
    line: int


@dataclass(frozen=True, slots=True, eq=False)
class Change:
    """DH rows in which a mistake is undone."""

    #: The changed rows.
    rows: DHRobot
    #: The mistake.
    why: Why
    #: The cells that are changed; none if whole rows or columns are.
    cells: tuple[DHCell, ...] = ()
    #: Numbers that the measured poses determine.
    free: int = 0
    #: Numbers and names of the mistake's reason; of cells, these are its values instead.
    values: dict[str, Any] = field(default_factory=dict)

    @property
    def rank(self) -> tuple[int, int]:
        """The smaller, the likelier: an empty cell may be meant so, and one cell is likelier than two."""
        return sum(abs(cell.stated) < _SAME for cell in self.cells), len(self.cells)

    @property
    def mistake(self) -> Reason:
        """The mistake as a reason, without errors: of cells, these and what has the same effect."""
        if not self.cells:
            return Reason.of(self.why, **self.values)
        places = {_elsewhere(self.rows, cell) for cell in self.cells}
        elsewhere = places.pop() if len(places) == 1 else ""  # of two places it would be two
        cells = [asdict(cell) for cell in self.cells]
        return Reason.of(self.why, cells=cells, elsewhere=elsewhere)

    def robot(self) -> Robot:
        """Return the robot of the changed rows, whose joints are in their order."""
        return Robot.from_urdf(urdf_of_dh(self.rows, self.rows.name), self.rows.base, self.rows.tip)

    def in_order(self, q: Array, names: Sequence[str]) -> Array:
        """Return joint values, shape (N, n), of the joints ``names`` in the order of the changed rows."""
        return q[:, [names.index(name) for name in self.rows.joint_names]]

    def makes_same_robot(self, other: Change) -> bool:
        """Return whether the rows of another change are the same robot, stated in another way."""
        names = self.rows.joint_names
        q = np.linspace(-1.0, 1.0, 5)[:, None] * np.arange(1.0, 1.0 + len(names))
        poses = other.rows.poses(other.in_order(q, names))
        return bool(np.allclose(self.rows.poses(q), poses, rtol=0.0, atol=_SAME_POSE))


def stated_rows(robot: Robot, q: Array) -> DHRobot | None:
    """Return the DH rows of a robot; None if it was not made from rows, or is no longer the robot of its rows.

    Args:
        robot: The robot. A corrected one still has the rows of the nominal one, and base or tip may be other links.
        q: Readings of its joints, shape (N, m) [rad] or [m].
    """
    dh = robot.urdf.dh
    if dh is None or dh.joint_names != robot.joint_names:
        return None
    dh = replace(dh, coupling=robot.reading_coupling)
    return dh if np.allclose(dh.poses(q), robot.poses(q), rtol=0.0, atol=_SAME) else None


def find_wrong_rows(trials: DHTrials) -> Reason | None:
    """Find the mistake in DH rows that poses of a controller show, which agree with the right ones except for rounding.

    Args:
        trials: The rows as they are stated, and the poses.

    Returns:
        The mistake, with the errors as given and with it undone [m] and [rad], and others that explain the rows as
        well; None if the rows agree as they are, or no change explains them except for rounding.
    """
    dh, rows = trials.dh, trials.rows
    limit = _rounding(dh)
    given = trials.errors(Change(dh, Why.DH_CELLS))
    has_orientations = rows.where(lambda kind: kind.orientation)
    # Errors of a frame or a target that is registered may be those of an arm.
    is_known = trials.setup.count == 0 and bool(np.all(has_orientations))
    if np.all(given < (limit / FAR_BETTER if is_known else (PLAUSIBLE, PLAUSIBLE_ANGLE))):
        return None

    found = []
    for errors, change in trials.tried:
        error = float(np.max(errors / limit))
        # What a free number explains has to be far more.
        share = FAR_BETTER / (1 + change.free)
        if error <= min(1.0, share * np.max(given / limit)):
            found.append((error, errors, change))
    if not found:
        return None
    # What leaves fewer numbers open is likelier.
    fewest = min(change.free for _, _, change in found)
    found = [entry for entry in found if entry[2].free == fewest]
    smallest = min(error for error, _, _ in found)
    equal = max(AS_GOOD * smallest, smallest + _OF_ROUNDING)
    as_good = [entry for entry in found if entry[0] <= equal]
    as_good.sort(key=lambda entry: (*entry[2].rank, entry[0]))

    names = ("m", "rad") if np.any(has_orientations) else ("m",)
    mistakes = []
    for _, errors, change in as_good:
        sizes = {f"error_{name}": float(errors[k]) for k, name in enumerate(names)}
        mistakes.append(change.mistake.with_values(**sizes))
    _, _, best = as_good[0]
    given_sizes = {f"given_{name}": float(given[k]) for k, name in enumerate(names)}
    # The same robot, stated in another way, is not another explanation.
    others = [
        mistake.entry
        for (_, _, change), mistake in zip(as_good[1:], mistakes[1:], strict=True)
        if not change.makes_same_robot(best)
    ]
    reason = mistakes[0].with_values(**given_sizes)
    return reason.with_others(others)


def _rounding(dh: DHRobot) -> Array:
    """Return the largest rms errors that rounding of a controller's poses explains: [m] and [rad], shape (2,).

    Every joint turns by `_LAST_DIGITS`, with half of the stretched arm as its lever.
    """
    angle = np.sqrt(len(dh.table.rows)) * _LAST_DIGITS
    return np.array([angle * _lever(dh), angle])


def _lever(dh: DHRobot) -> float:
    """Return half the length of the stretched arm, or 0.1 m of a shorter one [m]."""
    return max(0.5 * float(sum(np.hypot(row.a, row.d) for row in dh.table.rows)), 0.1)


# Changes that leave no number open


def _cells_of_a_row(dh: DHRobot) -> Iterator[Change]:
    """Yield the rows with one joint counting the other way, or with two numbers of a row in each other's cell."""
    for i, row in enumerate(dh.table.rows):
        yield _with_cells(dh, [(i, "direction", -row.direction)])
        for first, second in (_LENGTHS, _ANGLES):
            yield _with_cells(
                dh, [(i, first, getattr(row, second)), (i, second, getattr(row, first))]
            )


def _cells_of_a_column(dh: DHRobot) -> Iterator[Change]:
    """Yield the rows with two numbers of a column in each other's cell."""
    for (i, first), (j, second) in itertools.combinations(enumerate(dh.table.rows), 2):
        for column in (*_LENGTHS, *_ANGLES):
            yield _with_cells(
                dh, [(i, column, getattr(second, column)), (j, column, getattr(first, column))]
            )


def _exchanged_rows(dh: DHRobot) -> Iterator[Change]:
    """Yield the rows with two of them exchanged: with their joints, or their numbers alone."""
    for (i, first), (j, second) in itertools.combinations(enumerate(dh.table.rows), 2):
        lines = [first.line, second.line]
        values = {"first": first.joint, "second": second.joint, "lines": lines}
        yield Change(_with_rows(dh, {i: second, j: first}), Why.DH_ROWS_EXCHANGED, values=values)
        if first.prismatic == second.prismatic:
            numbers = {
                i: replace(second, joint=first.joint, lower=first.lower, upper=first.upper),
                j: replace(first, joint=second.joint, lower=second.lower, upper=second.upper),
            }
            yield Change(_with_rows(dh, numbers), Why.DH_NUMBERS_EXCHANGED, values=values)


def _other_convention(dh: DHRobot) -> Iterator[Change]:
    """Yield the same numbers read in the other convention; none for rows with a beta."""
    if any(row.beta for row in dh.table.rows):
        return
    stated = dh.table.convention
    other = STANDARD if stated == MODIFIED else MODIFIED
    rows = replace(dh, table=replace(dh.table, convention=other))
    yield Change(rows, Why.DH_CONVENTION, values={"convention": other, "stated": stated})


def _other_arms(dh: DHRobot) -> Iterator[Change]:
    """Yield the rows of each arm of Universal Robots, if the stated ones have its angles.

    If only one or two lengths differ, these cells are named, and not the arm: arms differ in more.
    """
    rows = dh.table.rows
    if dh.table.convention == MODIFIED:
        return
    alphas = [row.alpha for row in rows]
    for model in MODELS:
        _, a, d, of_arm = model.rows.T
        if len(alphas) != len(of_arm) or not np.allclose(alphas, of_arm, atol=_LEAST_TURN):
            continue
        lengths = [(i, "a", float(a[i])) for i in range(len(rows))]
        lengths += [(i, "d", float(d[i])) for i in range(len(rows))]
        changed = _with_cells(
            dh, [c for c in lengths if abs(c[2] - getattr(rows[c[0]], c[1])) > _SAME]
        )
        if len(changed.cells) > 2:
            changed = Change(changed.rows, Why.DH_VARIANT, values={"arm": model.name})
        yield changed


def _other_units(dh: DHRobot) -> Iterator[Change]:
    """Yield the rows in which a column, or both columns of lengths or of angles, are in another unit than stated."""
    columns_and_units = (
        *itertools.product((("a",), ("d",), _LENGTHS), _LENGTH_UNITS),
        *itertools.product((("alpha",), ("theta",), _ANGLES), _ANGLE_UNITS),
    )
    for columns, (unit, header, factor) in columns_and_units:
        scaled = {
            i: replace(row, **{column: factor * getattr(row, column) for column in columns})
            for i, row in enumerate(dh.table.rows)
        }
        what = f"numbers of {' and '.join(columns)}"
        values = {"what": what, "factor": factor, "unit": unit, "header": header}
        yield Change(_with_rows(dh, scaled), Why.DH_UNIT, values=values)


#: Changes of rows by what is changed: each yields rows in which one mistake is undone.
_CHANGES: tuple[Callable[[DHRobot], Iterator[Change]], ...] = (
    _cells_of_a_row,
    _cells_of_a_column,
    _exchanged_rows,
    _other_convention,
    _other_arms,
    _other_units,
)


# Changes with free numbers


@dataclass(frozen=True, eq=False)
class DHTrials:
    """Trials of every change of a robot's DH rows, and of each number of them at the value that fits best."""

    #: The DH rows as they are stated.
    dh: DHRobot
    #: Frames and targets; what was given is held, all else is registered.
    setup: Setup
    #: N rows of points or poses, with the joints of ``dh`` in their order.
    rows: Rows

    @cached_property
    def tried(self) -> list[tuple[Array, Change]]:
        """Each change, with the rms errors that it leaves: positions [m] and orientations [rad], 0 of points.

        If a frame is sought, which takes long, only the best ones on a screen of positions.
        """
        of_rows = itertools.chain(*(changes_of(self.dh) for changes_of in _CHANGES))
        changes = [*of_rows, *self.with_a_number(), *self.with_lengths()]
        if any(self.setup.unknown):
            changes = sorted(changes, key=self.position_error)[:REGISTERED]
        return [(self.errors(change), change) for change in changes]

    def errors(self, change: Change) -> Array:
        """Return the rms errors that a change leaves: positions [m] and orientations [rad], 0 of points, shape (2,)."""
        moved = with_joints(self.rows, change.in_order(self.rows.joints, self.dh.joint_names))
        return np.nan_to_num(misfit(change.rows, self.setup, moved))

    def position_error(self, change: Change) -> float:
        """Return the rms error of positions that a change leaves on a screen, all frames and targets unknown [m]."""
        T_base_tip = change.rows.poses(change.in_order(self.rows.joints, self.dh.joint_names))
        points = self.rows.measured[None, :, :3]
        return float(errors_of_tips(self.setup, self.rows, T_base_tip[None], points)[0])

    def with_a_number(self) -> Iterator[Change]:
        """Yield the rows with each number at the value that fits best."""
        if self.rows.count - self.setup.count - 1 < _LEFT_OVER:
            return
        rows = self.dh.table.rows
        has_offsets = any(row.offset for row in rows)
        for i, row in enumerate(rows):
            # The zero of a joint is the offset, if rows have offsets and this one has no theta.
            by_offset = has_offsets and not row.prismatic and abs(row.theta) <= _SAME
            for column in (*_LENGTHS, *_ANGLES):
                cell = "offset" if by_offset and column == "theta" else column
                number = self._best_number(i, cell)
                if number is not None:
                    yield _at_a_likely_value(self.dh, i, cell, number)

    def _best_number(self, i: int, column: str) -> float | None:
        """Return the number [m or rad] of a cell that fits best, row from 0; None if it is stated or not determined.

        Near its least value the mean square is a parabola: three values give the next number, closer ones a better one.
        """
        lever, stated = _lever(self.dh), getattr(self.dh.table.rows[i], column)

        def square(number: float) -> float:
            """Return the mean square of the errors with a number, of positions in levers, of orientations in rad."""
            change = _with_cells(self.dh, [(i, column, number)])
            if any(self.setup.unknown):
                return (self.position_error(change) / lever) ** 2
            position, angle = self.errors(change)
            return float((position / lever) ** 2 + (2.0 * np.sin(0.5 * angle)) ** 2)

        if column in _LENGTHS:
            unit, step = lever, _LENGTH_STEP * lever
            starts = [stated, -stated, 0.0]
        else:
            unit, step = 1.0, _ANGLE_STEP
            starts = [stated + k * step for k in range(round(2.0 * np.pi / step))]
        number = min(dict.fromkeys(starts), key=square)
        for _ in range(_ROUNDS):
            before, here, after = (square(number + change) for change in (-step, 0.0, step))
            curvature = before - 2.0 * here + after
            # What registered places make up for has no curvature.
            if curvature < _LEAST_CURVATURE * (step / unit) ** 2:
                return None
            number += 0.5 * step * (before - after) / curvature
            step *= _FINER
        if column in _LENGTHS:
            return float(number)
        return _turned(number) if abs(_turned(number - stated)) > _LEAST_TURN else None

    def with_lengths(self) -> Iterator[Change]:
        """Yield the rows with two or three lengths at the values that fit best, if they explain the positions.

        Nothing if a frame or a target is registered.
        """
        if self.setup.count:
            return
        cells = [(i, column) for i in range(len(self.dh.table.rows)) for column in _LENGTHS]
        stated = [getattr(self.dh.table.rows[i], column) for i, column in cells]
        points = self._points(self.dh)
        residual = (self.rows.measured[:, :3] - points).ravel()
        longer = [
            _with_cells(self.dh, [(i, c, x + 1.0)]) for (i, c), x in zip(cells, stated, strict=True)
        ]
        J = np.stack([(self._points(change.rows) - points).ravel() for change in longer], axis=1)
        rounding, _ = _rounding(self.dh)
        for count in range(2, _MOST_LENGTHS + 1):
            if residual.size - count < _LEFT_OVER:
                return
            for chosen in itertools.combinations(range(len(cells)), count):
                part = J[:, chosen]
                if np.linalg.cond(part) > _WORST_CONDITION:
                    continue
                change = np.linalg.lstsq(part, residual, rcond=None)[0]
                left = np.sum((residual - part @ change) ** 2)
                if left <= len(points) * rounding**2 and np.all(np.abs(change) > rounding):
                    wanted = [
                        (*cells[k], stated[k] + float(x))
                        for k, x in zip(chosen, change, strict=True)
                    ]
                    yield _with_cells(self.dh, wanted, free=count)

    def _points(self, dh: DHRobot) -> Array:
        """Return the targets in their frames at the rows, shape (N, 3) [m], of DH rows with the joints as they are."""
        poses = self.setup.target_poses(dh.poses(self.rows.joints), self.rows.samples)
        return poses[:, :3, 3]


def _at_a_likely_value(dh: DHRobot, i: int, column: str, number: float) -> Change:
    """Return the rows with a number [m or rad] in a cell, or with the likely one that it nearly is.

    A length is likely with the other sign, or 0; an angle with the other sign too, or at quarter turns.
    """
    stated = getattr(dh.table.rows[i], column)
    if column in _LENGTHS:
        likely: tuple[float, ...] = (-stated, 0.0)
        distance = _SLIP
    else:
        likely = (-stated, *_QUARTER_TURNS)
        distance = _LEAST_TURN
    for value in likely:
        apart = value - number if column in _LENGTHS else _turned(value - number)
        if abs(apart) < distance:
            return _with_cells(dh, [(i, column, value)])
    return _with_cells(dh, [(i, column, number)], free=1)


# Cells


def _with_cells(dh: DHRobot, cells: Sequence[tuple[int, str, float]], *, free: int = 0) -> Change:
    """Return the rows with other numbers in some cells: row from 0, column, number [m or rad]."""
    rows = dict(enumerate(dh.table.rows))
    changed = []
    for i, column, number in cells:
        stated = float(getattr(rows[i], column))
        slides = column == "offset" and rows[i].prismatic
        unit = "" if column == "direction" else "m" if column in _LENGTHS or slides else "rad"
        changed.append(DHCell(rows[i].joint, column, unit, stated, float(number), rows[i].line))
        cell: dict[str, Any] = {column: number}
        rows[i] = replace(rows[i], **cell)
    return Change(_with_rows(dh, rows), Why.DH_CELLS, tuple(changed), free)


def _with_rows(dh: DHRobot, rows: Mapping[int, DHRow]) -> DHRobot:
    """Return a robot with other rows in some places, from 0."""
    every = tuple(rows.get(i, row) for i, row in enumerate(dh.table.rows))
    return replace(dh, table=replace(dh.table, rows=every))


def _turned(angle: float) -> float:
    """Return an angle in (-pi, pi], [rad]."""
    return float(np.pi - (np.pi - angle) % (2.0 * np.pi))


def _elsewhere(dh: DHRobot, cell: DHCell) -> str:
    """Return what has the effect of a wrong cell: the controller's ``base`` or ``tool``, the ``joint``, or nothing."""
    rows, is_modified = dh.table.rows, dh.table.convention == MODIFIED
    along_z = cell.column in ("theta", "offset", "d")
    if cell.column == "direction":
        return "joint"
    if cell.joint == rows[-1].joint and (along_z or not is_modified):
        return "tool"
    if cell.joint == rows[0].joint and (along_z or is_modified):
        return "base"
    return "joint" if cell.column in ("theta", "offset") else ""
