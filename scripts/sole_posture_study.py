"""Tables in which one joint moves in one row only: the weight of that row, and the error of the robot elsewhere.

    python scripts/sole_posture_study.py [TABLES] [SEED]

Each table is calibrated three times: without the row, with it, and with it 10 mm off. Printed are the weight of the
row, whether the verdict names it with its joint, and the true error at fresh poses where that joint stands as in the
other rows, over the error without the row.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import tee

import numpy as np
from arms import load_arm
from studies import add_noise, print_table, rms_length, run_jobs, study_parser, verdict_of

from calib.basics.arrays import Array
from calib.data.measurements import Measurements
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.robot.ranges import random_joint_values
from calib.verbs.simulate.truth import Truth, draw_truth

ARMS = ("ur3", "ur5", "panda")

#: Rows of a table.
ROWS = 36

#: Fresh poses.
FRESH = 200

#: Noise of a coordinate [m].
NOISE = 5e-5

#: Error of the row where it is wrong [m].
OFF = 10e-3

#: Smallest move of its joint [rad].
APART = 0.5


@dataclass(frozen=True)
class Table:
    """Points of a robot, in which one joint moves in one row only."""

    truth: Truth
    q: Array  # shape (ROWS, n), [rad]
    points: Array  # shape (ROWS, 3), [m]
    row: int  # The row in which the joint moves, from 0
    joint: int  # The joint, from 0
    fresh: Array  # shape (FRESH, n), poses where the joint stands still [rad]

    def calibrate_with(self, error: Array) -> Calibration:
        """Calibrate with the row displaced by an error, shape (3,), [m]."""
        points = self.points.copy()
        points[self.row] += error
        robot = self.truth.nominal
        return calibrate(robot, Measurements(robot.joint_names, self.q, points), model="dh")

    def calibrate_without(self) -> Calibration:
        """Calibrate without the row."""
        robot = self.truth.nominal
        others = np.arange(ROWS) != self.row
        table = Measurements(robot.joint_names, self.q[others], self.points[others])
        return calibrate(robot, table, model="dh")

    def error(self, result: Calibration) -> float:
        """Return the true error of the calibrated robot at the fresh poses, rms [m]."""
        T_tip_target = result.setup.T_tip_target[0]
        predicted = (result.robot.poses(self.fresh) @ T_tip_target)[:, :3, 3]
        return rms_length(predicted - self.truth.points(self.fresh))

    def named_by(self, result: Calibration) -> bool:
        """Return True if the verdict names the row with its joint."""
        pair = (self.row + 1, self.truth.nominal.joint_names[self.joint])
        for reason in verdict_of(result).reasons:
            if reason.code == "sole_posture":
                values = reason.values
                if pair in zip(values["rows"], values["joints"], strict=True):
                    return True
        return False


def draw_table(arm: str, seed: int) -> Table:
    """Draw a robot, its errors, and a table of it."""
    robot = load_arm(arm)
    rng = np.random.default_rng([7, seed])
    truth = draw_truth(robot, "dh", seed=seed)
    # The last joint moves a target near its axis by little; the others move it enough to be told apart.
    joint = int(rng.integers(1, len(robot.joint_names) - 1))
    row = int(rng.integers(ROWS))
    q = random_joint_values(robot, ROWS, 2 * seed)
    fresh = random_joint_values(robot, FRESH, 2 * seed + 1)
    still = q[(row + 1) % ROWS, joint]
    moved = q[:, joint][np.abs(q[:, joint] - still) > APART][0]
    q[:, joint] = still
    fresh[:, joint] = still
    q[row, joint] = moved
    points = add_noise(truth.points(q), NOISE, rng)
    return Table(truth, q, points, row, joint, fresh)


@dataclass(frozen=True)
class Outcome:
    """Figures of a calibration with the row."""

    weight: float  # Of the row
    named: bool  # The verdict names row and joint
    ratio: float  # True error elsewhere over that without the row


@dataclass(frozen=True)
class Outcomes:
    """Figures of a table."""

    arm: str
    joint: int  # From 1
    error: float  # True error elsewhere without the row [m]
    right: Outcome  # With the row as measured
    wrong: Outcome  # With the row off


def calibrate_table(arm: str, seed: int) -> Outcomes:
    """Draw a table and calibrate it three times."""
    table = draw_table(arm, seed)
    direction = np.random.default_rng([8, seed]).normal(size=3)
    error = table.error(table.calibrate_without())

    def outcome(row_error: Array) -> Outcome:
        """Return the figures with the row displaced, shape (3,), [m]."""
        result = table.calibrate_with(row_error)
        ratio = table.error(result) / error
        return Outcome(float(result.rows.weights[table.row]), table.named_by(result), ratio)

    return Outcomes(
        arm=arm,
        joint=table.joint + 1,
        error=error,
        right=outcome(np.zeros(3)),
        wrong=outcome(OFF * direction / np.linalg.norm(direction)),
    )


def table_row(outcomes: Outcomes) -> list[str]:
    """Return the row of a table."""
    cells = [outcomes.arm, str(outcomes.joint), f"{1e3 * outcomes.error:.3f}"]
    for outcome in (outcomes.right, outcomes.wrong):
        named = "named" if outcome.named else "-"
        cells += [f"{outcome.weight:.2f}", named, f"{outcome.ratio:.3f}"]
    return cells


def summary_rows(tables: Sequence[Outcomes]) -> Iterator[list[str]]:
    """Yield shares over all tables, with the row as measured and with the row off."""
    for title, outcomes in (
        ("right", [table.right for table in tables]),
        ("10 mm off", [table.wrong for table in tables]),
    ):
        kept = np.mean([outcome.weight > 0.99 for outcome in outcomes])
        named = np.mean([outcome.named for outcome in outcomes])
        ratios = np.array([outcome.ratio for outcome in outcomes])
        yield [
            title,
            f"{kept:.1%}",
            f"{named:.1%}",
            f"{ratios.max():.3f}",
            str(np.sum(ratios > 1.1)),
        ]


def main() -> None:
    """Print a row for each table, and the shares."""
    parser = study_parser(__doc__, parallel=True)
    parser.add_argument("tables", type=int, nargs="?", default=6, metavar="TABLES")
    parser.add_argument("seed", type=int, nargs="?", default=0, metavar="SEED")
    arguments = parser.parse_args()
    jobs = [(ARMS[k % len(ARMS)], arguments.seed + k) for k in range(arguments.tables)]
    results = run_jobs(calibrate_table, jobs, workers=arguments.workers, label="tables")
    printed, counted = tee(results)
    titles = ["arm", "joint", "error without [mm]", "weight", "right row", "error over it"]
    titles += ["weight", "row off", "error over it"]
    print_table(titles, map(table_row, printed), [5, 5])
    print()
    titles = ["row", "weight kept", "named", "largest error over it", "above 1.1"]
    print_table(titles, summary_rows(list(counted)), [9])


if __name__ == "__main__":
    main()
