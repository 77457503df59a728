"""Mistakes in DH rows: how often three poses of a controller name the wrong cell.

    python scripts/dh_rows_study.py 1

Of the six arms in `calib/example/rows`, each number of each row is spoilt in turn: its sign, a length missing or 9 mm
short, an angle missing or off by 90 deg, a joint's sense; a and d of a row are exchanged, rows with the next one, and
the convention is the other one. Mistakes that change no pose are left out. The controller shows three poses at random
joint values, each number to 0.01 mm and 0.01 deg, or an arm with typical errors is measured there. Printed are the
mistakes whose cell is named, those for which another cell is named that makes the same robot, those that another
mistake explains as well, other remedies (wrong ones), and those of which nothing is said.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from studies import print_table, run_jobs, study_parser

from calib.basics.arrays import Array, read_only
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.diagnosis.reasons import Reason
from calib.diagnosis.usual_mistakes import find_usual_mistake
from calib.example import dh_rows
from calib.robot.dh_file import read_dh_robot
from calib.robot.dh_rows import MODIFIED, STANDARD, DHRobot
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.robot.urdf import urdf_of_dh
from calib.verbs.simulate.truth import draw_truth

ARMS = (
    "abb_irb120",
    "epson_gx4_a351s",
    "fanuc_lrmate200id",
    "franka_panda",
    "kuka_kr6_r900",
    "ur10e",
)

#: Poses that the controller shows.
POSES = 3

#: Joint values at which two robots are compared.
COMPARED = 50

#: Robots whose poses differ by no more at these are the same for three rounded poses [m and entries of rotations].
SAME = 5e-4

#: Decimals of lengths [m] that a pendant shows.
DECIMALS = 5

#: The last digit of an angle that a pendant shows [rad].
LAST_DIGIT = np.radians(0.01)

#: The columns of outcomes.
OUTCOMES = ("cell named", "same robot", "as good", "wrong", "silent")

GIVEN = Cell(target=read_only(np.zeros(3)), estimate_target=False)


def robot_of(dh: DHRobot) -> Robot:
    """Return the robot of DH rows."""
    return Robot.from_urdf(urdf_of_dh(dh, dh.name), dh.base, dh.tip)


def mistakes(dh: DHRobot) -> Iterator[tuple[DHRobot, frozenset[tuple[str, str]]]]:
    """Yield spoilt rows, with the cells that are wrong: joint and column; none if whole rows are."""
    rows = dh.table.rows
    for i, row in enumerate(rows):
        wrong = [
            ("alpha", -row.alpha),
            ("alpha", 0.0),
            ("theta", row.theta + np.pi / 2.0),
            ("a", -row.a),
            ("a", 0.0),
            ("a", row.a - 0.009),
            ("d", -row.d),
            ("d", 0.0),
            ("d", row.d - 0.009),
            ("direction", -row.direction),
        ]
        changes = [{column: value} for column, value in wrong]
        changes.append({"a": row.d, "d": row.a})
        for change in changes:
            spoilt = [*rows]
            spoilt[i] = replace(row, **change)
            cells = frozenset((row.joint, column) for column in change)
            yield replace(dh, table=replace(dh.table, rows=tuple(spoilt))), cells
    for i in range(len(rows) - 1):
        spoilt = [*rows]
        spoilt[i], spoilt[i + 1] = rows[i + 1], rows[i]
        yield replace(dh, table=replace(dh.table, rows=tuple(spoilt))), frozenset()
    other = STANDARD if dh.table.convention == MODIFIED else MODIFIED
    yield replace(dh, table=replace(dh.table, convention=other)), frozenset()


def remedied(spoilt: DHRobot, values: dict[str, object]) -> DHRobot:
    """Return the rows with the remedy of a reason, by its values."""
    rows = list(spoilt.table.rows)
    names = [row.joint for row in rows]
    table = spoilt.table
    cells = values.get("cells", ())
    assert isinstance(cells, list | tuple)
    for cell in cells:
        i = names.index(cell["joint"])
        rows[i] = replace(rows[i], **{cell["column"]: cell["wanted"]})
    if "first" in values:
        i, j = names.index(str(values["first"])), names.index(str(values["second"]))
        rows[i], rows[j] = rows[j], rows[i]
        if values["code"] == "dh_numbers_exchanged":
            rows[i] = replace(rows[i], joint=names[i])
            rows[j] = replace(rows[j], joint=names[j])
    if "convention" in values:
        table = replace(table, convention=str(values["convention"]))
    return replace(spoilt, table=replace(table, rows=tuple(rows)))


def same(first: DHRobot, second: DHRobot, q: Array) -> bool:
    """Return whether two robots have the same poses at readings of the first one's joints, shape (N, n)."""
    order = [first.joint_names.index(name) for name in second.joint_names]
    return bool(np.allclose(first.poses(q), second.poses(q[:, order]), rtol=0.0, atol=SAME))


def outcome(
    right: DHRobot,
    spoilt: DHRobot,
    cells: frozenset[tuple[str, str]],
    reason: Reason | None,
    q: Array,
) -> str:
    """Return one of `OUTCOMES`.

    Args:
        right: The rows of the arm.
        spoilt: Those given.
        cells: The wrong cells; empty if whole rows are wrong.
        reason: What calib says.
        q: Readings of the right rows' joints, shape (N, n) [rad] or [m].
    """
    if reason is None:
        return "silent"
    first = {"code": reason.code, **reason.values}
    if same(right, remedied(spoilt, first), q):
        named = frozenset((cell["joint"], cell["column"]) for cell in first.get("cells", ()))
        zeros = {"offset": "theta"}
        plain = frozenset((joint, zeros.get(column, column)) for joint, column in named)
        return "cell named" if plain == cells else "same robot"
    others = reason.values.get("others", ())
    return "as good" if any(same(right, remedied(spoilt, o), q) for o in others) else "wrong"


def study(arm: str, seed: int, errors: bool) -> Counter[str]:
    """Spoil the rows of an arm, and count the outcomes.

    Args:
        arm: One of `ARMS`.
        seed: Of joint values and errors.
        errors: The arm has typical errors, and is measured; else its controller shows the poses of the right rows.
    """
    right = read_dh_robot(dh_rows(arm))
    robot = robot_of(right)
    q = random_joint_values(robot, POSES, seed)
    compared = random_joint_values(robot, COMPARED, seed + 1)
    shown = np.round(q / LAST_DIGIT) * LAST_DIGIT
    for i, row in enumerate(right.table.rows):
        if row.prismatic:
            shown[:, i] = np.round(q[:, i], DECIMALS)
    T = right.poses(q)
    if errors:
        T = draw_truth(robot, "dh", {}, seed, cell=Cell(estimate_frame=True)).tip_poses(q)
    counts: Counter[str] = Counter()
    for spoilt, cells in mistakes(right):
        if same(right, spoilt, compared):
            continue
        order = [right.joint_names.index(name) for name in spoilt.joint_names]
        table = Measurements(
            joint_names=spoilt.joint_names,
            joints=shown[:, order],
            points=np.round(T[:, :3, 3], DECIMALS),
            kinds=("pose",) * POSES,
            rotations=T[:, :3, :3],
        )
        reason = find_usual_mistake(robot_of(spoilt), GIVEN, table)
        counts[outcome(right, spoilt, cells, reason, compared)] += 1
    return counts


def main() -> None:
    """Print the outcomes of each arm, of poses of controllers and of measured ones."""
    parser = study_parser(__doc__, parallel=True)
    parser.add_argument("seed", type=int, nargs="?", default=1, metavar="SEED")
    arguments = parser.parse_args()
    jobs = [(arm, arguments.seed, errors) for errors in (False, True) for arm in ARMS]
    results = list(run_jobs(study, jobs, workers=arguments.workers, label="arms"))
    rows = []
    for (arm, _, errors), counts in zip(jobs, results, strict=True):
        poses = "measured" if errors else "controller's"
        rows.append([arm, poses, *(str(counts[name]) for name in OUTCOMES)])
    for errors in (False, True):
        total: Counter[str] = Counter()
        for (_, _, of_job), counts in zip(jobs, results, strict=True):
            if of_job is errors:
                total += counts
        poses = "measured" if errors else "controller's"
        rows.append(["all", poses, *(str(total[name]) for name in OUTCOMES)])
    print_table(["arm", "poses", *OUTCOMES], rows, [18, 13])


if __name__ == "__main__":
    main()
