"""Spoilt tables of DH rows: how often three poses off a pendant name the cell that is wrong.

    python scripts/dh_cells_study.py
    python scripts/dh_cells_study.py --seeds 40 --arms own seven drawn
    python scripts/dh_cells_study.py --measured 20

Of each arm 21 tables are spoilt, one for each mistake in `MISTAKES`, in a row or rows drawn from those where it changes
the robot. The controller of the right rows shows its poses at random joint values, every number to 0.01 mm or
0.01 deg; the target is the flange, as given. With ``--measured N`` an arm with typical errors is measured at N poses
instead, by an instrument with 0.05 mm of noise, with a target that is estimated, and a base frame that is known.

The arms: ``own`` and ``seven`` are written down here; ``drawn`` is another one for every seed: six axes, either
convention, lengths and angles as arms have them; other names are those of `calib/example/rows`. Printed are the tables
whose wrong cell is named first; those for which another cell is named that makes the same robot; those where the right
one is among several that the poses cannot tell apart; other remedies, which are false; those of which nothing is said;
what is said of the right rows; and the longest time of a check.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations, pairwise
from typing import Any

import numpy as np
from studies import add_noise, print_table, run_jobs, study_parser

from calib.basics.arrays import Array, read_only
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.diagnosis.reasons import Reason
from calib.diagnosis.usual_mistakes import find_usual_mistake
from calib.example import dh_rows
from calib.robot.dh_file import read_dh_robot
from calib.robot.dh_rows import MODIFIED, STANDARD, DHRobot, DHRow, DHTable, screw
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.robot.ur_models import MODELS
from calib.robot.urdf import urdf_of_dh
from calib.verbs.simulate.truth import draw_truth

#: theta, d, a, alpha [deg and mm], direction and offset [deg] of a painting arm with a bent, hollow wrist.
OWN = (
    (0.0, 512.0, 128.0, 90.0, 1, 0.0),
    (0.0, 0.0, 806.0, 0.0, -1, 90.0),
    (0.0, -37.0, 93.0, 90.0, 1, 0.0),
    (0.0, 741.0, 0.0, 60.0, -1, 0.0),
    (0.0, 84.0, 0.0, -60.0, 1, 0.0),
    (90.0, 113.0, 0.0, 0.0, 1, 0.0),
)

#: Theta, d, a(i-1), alpha(i-1), direction, offset of an arm with seven axes, in Craig's convention.
SEVEN = (
    (0.0, 287.0, 0.0, 0.0, 1, 0.0),
    (0.0, 0.0, 31.0, -90.0, 1, 0.0),
    (0.0, 354.0, 0.0, 90.0, -1, 0.0),
    (0.0, 0.0, 47.0, 90.0, 1, 0.0),
    (180.0, 331.0, -47.0, -90.0, 1, 0.0),
    (0.0, 0.0, 0.0, 90.0, -1, 0.0),
    (0.0, 126.0, 76.0, 90.0, 1, 0.0),
)

#: The arms that are written down here, with their conventions.
WRITTEN = {"own": (OWN, STANDARD), "seven": (SEVEN, MODIFIED)}

#: Joint values at which two robots are compared.
COMPARED = 50

#: Entries of poses of two robots that differ by no more at these are the same [m or 1]: for poses of a controller, and
#: for poses of an arm that was measured, whose errors go into the numbers that fit.
SAME = 1.5e-3
SAME_MEASURED = 0.03

#: The last digit that a pendant shows [m] and [rad].
LAST_DIGIT_M = 1e-5
LAST_DIGIT_RAD = np.radians(0.01)

#: Noise of the instrument that measures an arm [m].
NOISE = 5e-5

#: The columns of outcomes.
OUTCOMES = ("tables", "named", "same robot", "among several", "false", "silent")

Spoilt = tuple[DHRobot, frozenset[tuple[str, str]]]


# Arms


def rows_of(numbers: Sequence[tuple[float, float, float, float, int, float]]) -> tuple[DHRow, ...]:
    """Return rows of numbers in deg and mm, with joints J1, J2, ..."""
    rows = []
    for i, (theta, d, a, alpha, direction, offset) in enumerate(numbers):
        turns = {"theta": theta, "alpha": alpha, "offset": offset}
        angles: dict[str, Any] = {name: float(np.radians(turn)) for name, turn in turns.items()}
        rows.append(DHRow(f"J{i + 1}", d=1e-3 * d, a=1e-3 * a, direction=direction, **angles))
    return tuple(rows)


def drawn_arm(seed: int) -> DHRobot:
    """Draw an arm of six axes: most angles quarter turns, half of the lengths 0, directions and offsets of any kind."""
    rng = np.random.default_rng(seed)
    numbers = []
    for _ in range(6):
        d, a = (np.round(rng.choice([-1, 1, 1]) * rng.uniform(30.0, 700.0, 2))) * rng.integers(
            0, 2, 2
        )
        alpha = rng.choice([-90.0, 90.0, -90.0, 90.0, 0.0, rng.choice([-60.0, 45.0])])
        theta, offset = rng.choice([0.0, 0.0, 0.0, 90.0, -90.0, 180.0], 2)
        numbers.append((theta, float(d), float(a), alpha, int(rng.choice([-1, 1])), offset))
    convention = str(rng.choice([STANDARD, MODIFIED]))
    return DHRobot(DHTable(rows_of(numbers), np.eye(4), np.eye(4), convention), "drawn")


def arm_of(name: str, seed: int) -> DHRobot:
    """Return the rows of an arm, by its name."""
    if name == "drawn":
        return drawn_arm(seed)
    if name not in WRITTEN:
        return read_dh_robot(dh_rows(name))
    numbers, convention = WRITTEN[name]
    return DHRobot(DHTable(rows_of(numbers), np.eye(4), np.eye(4), convention), name)


def robot_of(dh: DHRobot) -> Robot:
    """Return the robot of DH rows."""
    return Robot.from_urdf(urdf_of_dh(dh, dh.name), dh.base, dh.tip)


# Mistakes


def spoilt(dh: DHRobot, changes: Mapping[int, Mapping[str, Any]]) -> Spoilt:
    """Return rows with other numbers in some cells, by row from 0 and column, and the cells that are wrong."""
    rows = list(dh.table.rows)
    for i, cells in changes.items():
        rows[i] = replace(rows[i], **cells)
    wrong = frozenset((rows[i].joint, column) for i, cells in changes.items() for column in cells)
    return replace(dh, table=replace(dh.table, rows=tuple(rows))), wrong


def each_row(change: Callable[[DHRow], Mapping[str, Any]], dh: DHRobot) -> Iterator[Spoilt]:
    """Yield the tables in which one row is changed."""
    for i, row in enumerate(dh.table.rows):
        yield spoilt(dh, {i: change(row)})


def missing(column: str, dh: DHRobot) -> Iterator[Spoilt]:
    """Yield the tables in which a number of a column is 0."""
    yield from each_row(lambda _: {column: 0.0}, dh)


def reversed_sign(column: str, dh: DHRobot) -> Iterator[Spoilt]:
    """Yield the tables in which a number of a column has the other sign."""
    yield from each_row(lambda row: {column: -getattr(row, column)}, dh)


def added(column: str, number: float, dh: DHRobot) -> Iterator[Spoilt]:
    """Yield the tables in which a number [m or rad] is added in a column."""
    yield from each_row(lambda row: {column: getattr(row, column) + number}, dh)


def digits_exchanged(column: str, dh: DHRobot) -> Iterator[Spoilt]:
    """Yield the tables in which the last two of the digits of a length in mm are exchanged."""

    def exchanged(row: DHRow) -> dict[str, float]:
        size = round(1e3 * abs(getattr(row, column)))
        tens, ones = size // 10 % 10, size % 10
        return {column: getattr(row, column) + 9e-3 * (ones - tens) * np.sign(getattr(row, column))}

    yield from each_row(exchanged, dh)


def two_cells(column: str, dh: DHRobot) -> Iterator[Spoilt]:
    """Yield the tables in which two numbers of a column are exchanged."""
    for (i, first), (j, second) in combinations(enumerate(dh.table.rows), 2):
        if getattr(first, column) != getattr(second, column):
            yield spoilt(
                dh, {i: {column: getattr(second, column)}, j: {column: getattr(first, column)}}
            )


def other_lengths(count: int, dh: DHRobot) -> Iterator[Spoilt]:
    """Yield the tables in which so many lengths are those of another size of the arm."""
    cells = [(i, c) for i, row in enumerate(dh.table.rows) for c in ("d", "a") if getattr(row, c)]
    for chosen in combinations(cells, count):
        if len({i for i, _ in chosen}) == count:
            yield spoilt(
                dh, {i: {c: 1.25 * getattr(dh.table.rows[i], c) + 4e-3} for i, c in chosen}
            )


def lines_exchanged(alone: bool, dh: DHRobot) -> Iterator[Spoilt]:
    """Yield the tables in which two neighbouring lines are exchanged: with their joints, or their numbers alone."""
    for i, (first, second) in enumerate(pairwise(dh.table.rows)):
        rows = list(dh.table.rows)
        rows[i], rows[i + 1] = second, first
        if alone:
            rows[i] = replace(second, joint=first.joint)
            rows[i + 1] = replace(first, joint=second.joint)
        yield replace(dh, table=replace(dh.table, rows=tuple(rows))), frozenset()


def other_convention(dh: DHRobot) -> Iterator[Spoilt]:
    """Yield the numbers as rows of the other convention."""
    other = STANDARD if dh.table.convention == MODIFIED else MODIFIED
    yield replace(dh, table=replace(dh.table, convention=other)), frozenset()


def in_other_unit(column: str, factor: float, dh: DHRobot) -> Iterator[Spoilt]:
    """Yield the table in which a column holds numbers of another unit."""
    changes = {i: {column: factor * getattr(row, column)} for i, row in enumerate(dh.table.rows)}
    yield spoilt(dh, changes)[0], frozenset()


MISTAKES: dict[str, Callable[[DHRobot], Iterator[Spoilt]]] = {
    "alpha: sign": partial(reversed_sign, "alpha"),
    "alpha: missing": partial(missing, "alpha"),
    "alpha: a quarter turn": partial(added, "alpha", np.pi / 2.0),
    "a: sign": partial(reversed_sign, "a"),
    "a: missing": partial(missing, "a"),
    "a: 9 mm": partial(added, "a", -9e-3),
    "a: digits": partial(digits_exchanged, "a"),
    "d: sign": partial(reversed_sign, "d"),
    "d: missing": partial(missing, "d"),
    "d: 9 mm": partial(added, "d", -9e-3),
    "d: digits": partial(digits_exchanged, "d"),
    "theta: a quarter turn": partial(added, "theta", np.pi / 2.0),
    "offset: missing": partial(missing, "offset"),
    "direction": partial(each_row, lambda row: {"direction": -row.direction}),
    "a and d of a row": partial(each_row, lambda row: {"a": row.d, "d": row.a}),
    "two alphas": partial(two_cells, "alpha"),
    "order: lines": partial(lines_exchanged, False),
    "order: numbers": partial(lines_exchanged, True),
    "convention": other_convention,
    "variant: two lengths": partial(other_lengths, 2),
    "a in cm": partial(in_other_unit, "a", 0.1),
}
"""Mistakes by what they are called in the output: each yields all the tables that it may make of the right one."""


# Outcomes


def poses_of(dh: DHRobot, q: Array, names: Sequence[str]) -> Array:
    """Return the poses of rows at readings of the joints ``names``, shape (N, n)."""
    return dh.poses(q[:, [names.index(name) for name in dh.joint_names]])


def remedied(dh: DHRobot, values: Mapping[str, Any]) -> DHRobot | None:
    """Return the rows after what a reason says is done; None if it says something else than to change the rows."""
    rows = list(dh.table.rows)
    names = dh.joint_names
    table = dh.table
    code = values["code"]
    for cell in values.get("cells", ()):
        i = names.index(cell["joint"])
        rows[i] = replace(rows[i], **{cell["column"]: cell["wanted"]})
    if code in ("dh_rows_exchanged", "dh_numbers_exchanged"):
        i, j = names.index(values["first"]), names.index(values["second"])
        rows[i], rows[j] = rows[j], rows[i]
        if code == "dh_numbers_exchanged":
            rows[i], rows[j] = replace(rows[i], joint=names[i]), replace(rows[j], joint=names[j])
    elif code == "dh_convention":
        table = replace(table, convention=values["convention"])
    elif code == "dh_unit":
        factor = {"cm": 10.0, "m": 1e3, "in": 25.4, "rad": np.degrees(1.0)}[values["unit"]]
        columns = [c for c in ("d", "a", "theta", "alpha") if c in values["what"].split()]
        rows = [replace(row, **{c: factor * getattr(row, c) for c in columns}) for row in rows]
    elif code == "dh_variant":
        (model,) = (model for model in MODELS if model.name == values["arm"])
        lengths = zip(rows, model.rows, strict=True)
        rows = [replace(row, a=float(a), d=float(d)) for row, (_, a, d, _) in lengths]
    elif code == "joints_turned":  # the sense of joints, or the sign of their readings
        turned = values["joints"].split(", ")
        rows = [replace(r, direction=r.direction * (-1 if r.joint in turned else 1)) for r in rows]
    elif code == "joint_zero":
        i = names.index(values["joint"])
        rows[i] = replace(rows[i], theta=rows[i].theta + rows[i].direction * values["add_rad"])
    elif code != "dh_cells":
        return None
    return replace(dh, table=replace(table, rows=tuple(rows)))


def outcome(
    right: DHRobot,
    wrong: DHRobot,
    cells: frozenset[tuple[str, str]],
    reason: Reason | None,
    tolerance: float,
) -> str:
    """Return one of `OUTCOMES`.

    Args:
        right: The rows of the arm.
        wrong: Those given.
        cells: The wrong cells, by joint and column; empty if whole rows or columns are wrong.
        reason: What calib says.
        tolerance: Entries of poses that differ by no more are the same [m or 1].
    """
    if reason is None:
        return "silent"
    q = np.random.default_rng(0).uniform(-2.0, 2.0, (COMPARED, len(right.joint_names)))
    poses = right.poses(q)

    def is_right(values: Mapping[str, Any]) -> bool:
        dh = remedied(wrong, values)
        if dh is None:
            return False
        return bool(
            np.allclose(poses_of(dh, q, right.joint_names), poses, rtol=0.0, atol=tolerance)
        )

    first = {"code": reason.code, **reason.values}
    others = first.pop("others", ())
    if not is_right(first):
        return "among several" if any(map(is_right, others)) else "false"
    if not all(map(is_right, others)):
        return "among several"
    zeros = {"offset": "theta"}  # both are the zero of a joint
    named = {(c["joint"], zeros.get(c["column"], c["column"])) for c in first.get("cells", ())}
    return "named" if named == {(j, zeros.get(c, c)) for j, c in cells} else "same robot"


# Runs


@dataclass(frozen=True)
class Shown:
    """Joint values and poses that stand in a table, whatever the rows are."""

    #: The joints of the columns of ``q``.
    names: tuple[str, ...]
    q: Array
    points: Array
    #: None: only points were measured.
    rotations: Array | None

    def table(self, names: Sequence[str]) -> Measurements:
        """Return the table with the joints in this order."""
        order = [self.names.index(name) for name in names]
        kind = "point" if self.rotations is None else "pose"
        return Measurements(
            tuple(names),
            self.q[:, order],
            self.points,
            kinds=(kind,) * len(self.q),
            rotations=self.rotations,
        )


def shown_by_controller(right: DHRobot, poses: int, seed: int) -> Shown:
    """Return what a pendant shows of the right rows at random joint values."""
    q = random_joint_values(robot_of(right), poses, seed)
    T = right.poses(q)
    angles = np.round(_euler(T[:, :3, :3]) / LAST_DIGIT_RAD) * LAST_DIGIT_RAD
    return Shown(
        right.joint_names,
        np.round(q / LAST_DIGIT_RAD) * LAST_DIGIT_RAD,
        np.round(T[:, :3, 3] / LAST_DIGIT_M) * LAST_DIGIT_M,
        _rotations(angles),
    )


def measured(right: DHRobot, poses: int, seed: int) -> Shown:
    """Return points of a target on an arm with typical errors, at random joint values."""
    robot = robot_of(right)
    q = random_joint_values(robot, poses, seed)
    T = draw_truth(robot, "dh", {}, seed, cell=Cell()).tip_poses(q)
    points = T[:, :3, 3] + T[:, :3, :3] @ np.array([0.04, -0.03, 0.06])
    return Shown(right.joint_names, q, add_noise(points, NOISE, np.random.default_rng(seed)), None)


def study(arm: str, seed: int, poses: int, is_measured: bool) -> list[tuple[str, str, float]]:
    """Spoil the rows of an arm once for each mistake, and once not.

    Args:
        arm: ``own``, ``seven`` or ``drawn``.
        seed: Of the joint values, of the rows that are spoilt, and of a drawn arm.
        poses: Number of poses.
        is_measured: The arm is measured; else its controller shows its poses.

    Returns:
        Of each table the mistake, the outcome, and the time of the check [s].
    """
    right = arm_of(arm, seed)
    shown = (measured if is_measured else shown_by_controller)(right, poses, seed)
    cell = Cell() if is_measured else Cell(target=read_only(np.zeros(3)), estimate_target=False)
    q = np.random.default_rng(seed).uniform(-2.0, 2.0, (COMPARED, len(right.joint_names)))
    rng = np.random.default_rng(seed)
    same = SAME_MEASURED if is_measured else SAME
    least = 4.0 * same
    tables: list[tuple[str, Spoilt]] = [("none", (right, frozenset()))]
    for name, mistake in MISTAKES.items():
        may_be = [
            made
            for made in mistake(right)
            if np.max(np.abs(poses_of(made[0], q, right.joint_names) - right.poses(q))) > least
        ]
        if may_be:
            tables.append((name, may_be[int(rng.integers(len(may_be)))]))

    results = []
    for name, (wrong, cells) in tables:
        robot, table = robot_of(wrong), shown.table(wrong.joint_names)
        start = time.perf_counter()
        reason = find_usual_mistake(robot, cell, table)
        seconds = time.perf_counter() - start
        if name == "none":
            results.append((name, "silent" if reason is None else "false", seconds))
        else:
            results.append((name, outcome(right, wrong, cells, reason, same), seconds))
    return results


def main() -> None:
    """Print the outcomes by arm, and by mistake."""
    parser = study_parser(__doc__, parallel=True)
    parser.add_argument("--arms", nargs="+", default=["own", "seven", "drawn"])
    parser.add_argument("--seeds", type=int, default=5, help="number of seeds (default: 5)")
    parser.add_argument("--first", type=int, default=1, help="the first seed (default: 1)")
    parser.add_argument("--poses", type=int, default=3, help="poses of the controller (default: 3)")
    parser.add_argument("--measured", type=int, metavar="N", help="measure N poses of the arm")
    arguments = parser.parse_args()
    poses = arguments.measured or arguments.poses
    jobs = [
        (arm, seed, poses, arguments.measured is not None)
        for arm in arguments.arms
        for seed in range(arguments.first, arguments.first + arguments.seeds)
    ]
    by_arm: dict[str, Counter[str]] = {}
    by_mistake: dict[str, Counter[str]] = {name: Counter() for name in MISTAKES}
    right: Counter[str] = Counter()
    longest = 0.0
    for job, results in zip(jobs, run_jobs(study, jobs, workers=arguments.workers), strict=True):
        for name, result, seconds in results:
            longest = max(longest, seconds)
            if name == "none":
                right[result] += 1
                continue
            for counts in (by_arm.setdefault(job[0], Counter()), by_mistake[name]):
                counts.update((result, "tables"))

    for title, table in (("arm", by_arm), ("mistake", by_mistake)):
        lines = [
            [name, *(counts[outcome] for outcome in OUTCOMES)] for name, counts in table.items()
        ]
        print_table([title, *OUTCOMES], lines, [22])
        print()
    print(f"Of right rows nothing is said in {right['silent']} of {right.total()}.")
    print(f"The longest check took {longest:.2f} s.")


def _euler(R: Array) -> Array:
    """Return the angles A, B, C about z, y, x of rotations (N, 3, 3), shape (N, 3) [rad]."""
    a = np.arctan2(R[:, 1, 0], R[:, 0, 0])
    b = np.arctan2(-R[:, 2, 0], np.hypot(R[:, 2, 1], R[:, 2, 2]))
    return np.stack([a, b, np.arctan2(R[:, 2, 1], R[:, 2, 2])], axis=1)


def _rotations(angles: Array) -> Array:
    """Return the rotations (N, 3, 3) of angles A, B, C about z, y, x, shape (N, 3) [rad]."""
    z, y, x = (
        np.asarray(screw(axis, angles[:, k], 0.0))[:, :3, :3] for k, axis in enumerate((2, 1, 0))
    )
    return np.asarray(z @ y @ x)


if __name__ == "__main__":
    main()
