"""Tables in which one joint moves in one row only: what becomes of that row, and of the robot elsewhere.

    .venv/bin/python scripts/sole_posture_study.py [TABLES] [SEED]

Each table is calibrated three times: without the row, with it, and with it 10 mm off. Shown are its weight, whether the
verdict names it with its joint, and the true error at fresh poses where that joint stands as in the other rows, over
the error without the row.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass

import numpy as np

from calib.data.measurements import Measurements
from calib.result.calibrate import calibrate
from calib.result.calibration import CalibrationValues
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.simulation.truth import Truth, draw_truth
from calib.units import Array

ARMS = {
    "ur3": ("base", "tool0"),
    "ur5": ("base_link", "tool0"),
    "panda": ("panda_link0", "panda_link8"),
}
ROWS, FRESH, NOISE = 36, 200, 5e-5

#: How far the row is off that is wrong [m], and how far its joint moves at least [rad].
OFF, APART = 10e-3, 0.5


@dataclass(frozen=True)
class Table:
    """One robot and its joint values, of which one moves a joint that stands still in all others."""

    truth: Truth
    q: Array  # (ROWS, n), [rad]
    points: Array  # (ROWS, 3), [m]
    row: int  # The one in which the joint moves
    joint: int  # The joint
    fresh: Array  # (FRESH, n), where the joint stands still

    def calibrated(self, off: Array) -> CalibrationValues:
        """The calibration with the row measured so far off, shape (3,), [m]."""
        points = self.points.copy()
        points[self.row] += off
        robot = self.truth.nominal
        return calibrate(robot, Measurements(robot.joint_names, self.q, points), model="dh")

    def without_row(self) -> CalibrationValues:
        """The calibration without the row."""
        robot, kept = self.truth.nominal, np.arange(ROWS) != self.row
        rows = Measurements(robot.joint_names, self.q[kept], self.points[kept])
        return calibrate(robot, rows, model="dh")

    def error(self, result: CalibrationValues) -> float:
        """The true error where the joint stands still, rms [m]."""
        T_target = result.setup.T_tip_target[0]
        predicted = (result.robot.poses(self.fresh) @ T_target)[:, :3, 3]
        apart = predicted - self.truth.points(self.fresh)
        return float(np.sqrt(np.mean(np.sum(apart**2, axis=1))))

    def named(self, result: CalibrationValues) -> bool:
        """Whether the verdict names row and joint."""
        assert result.verdict is not None
        pair = (self.row + 1, self.truth.nominal.joint_names[self.joint])
        reasons = [r.values for r in result.verdict.reasons if r.code == "sole_posture"]
        return any(pair in zip(v["rows"], v["joints"], strict=True) for v in reasons)


def table(arm: str, seed: int) -> Table:
    """Draw a table."""
    robot, rng = Robot.load(arm, *ARMS[arm]), np.random.default_rng([7, seed])
    truth = draw_truth(robot, "dh", seed=seed)
    # The last joint moves a target near its axis by little; the others move it enough to be told apart.
    joint, row = int(rng.integers(1, len(robot.joint_names) - 1)), int(rng.integers(ROWS))
    q, fresh = (random_joint_values(robot, n, 2 * seed + k) for k, n in enumerate((ROWS, FRESH)))
    still = q[(row + 1) % ROWS, joint]
    moved = q[:, joint][np.abs(q[:, joint] - still) > APART][0]
    q[:, joint], fresh[:, joint] = still, still
    q[row, joint] = moved
    points = truth.points(q) + NOISE * rng.normal(size=(ROWS, 3))
    return Table(truth, q, points, row, joint, fresh)


def main() -> None:
    """Print a line for each table, and the shares."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 6
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 0
    found = []
    for k in range(count):
        arm = list(ARMS)[k % len(ARMS)]
        one = table(arm, seed + k)
        away = np.random.default_rng([8, seed + k]).normal(size=3)
        without = one.error(one.without_row())
        line = []
        for off in (np.zeros(3), OFF * away / np.linalg.norm(away)):
            result = one.calibrated(off)
            line.append((result.weights[one.row], one.named(result), one.error(result) / without))
        found.append(line)
        text = "   ".join(f"{w:4.2f} {'named' if n else '-':5} {r:6.3f}" for w, n, r in line)
        print(f"{arm:6} joint {one.joint + 1}  {1e3 * without:6.3f} mm   {text}", flush=True)
    for k, name in enumerate(("right", "10 mm off")):
        weights, named, ratios = map(np.array, zip(*(line[k] for line in found), strict=True))
        print(
            f"{name}: weight kept in {np.mean(weights > 0.99):.1%}, named in {np.mean(named):.1%}, "
            f"error elsewhere at most {ratios.max():.3f}, above 1.1 in {np.sum(ratios > 1.1)}"
        )


if __name__ == "__main__":
    main()
