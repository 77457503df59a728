"""Faults of a table that leave held-out errors small: what the verdict says, and how often of clean tables.

``faults`` makes each fault once for each arm and model; ``clean 200`` makes so many clean tables, and counts reasons.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from calib.data.cell import Cell, TrackerNoise
from calib.data.measurements import Measurements
from calib.result.calibrate import calibrate
from calib.result.calibration import CalibrationValues
from calib.robot.robot import Robot
from calib.simulation.scenario import Scenario, simulate
from calib.simulation.truth import Encoder, MovedTarget, Outliers

ARMS = (("ur5", "base", "tool0"), ("panda", "panda_link0", "panda_link8"))
TRUE_MODELS = ("dh", "placement", "dh+gain", "dh+eccentricity", "dh+compliance")
SIGMA = 5e-5
HALF = Outliers(share=0.5, size=0.01)
NOISE = TrackerNoise(constant=SIGMA)


@dataclass(frozen=True)
class Fault:
    """A table with a fault: what the scenario has, how many poses, and what is done to the table."""

    scenario: dict[str, Any] = field(default_factory=dict)
    poses: int = 60
    change: Callable[[Measurements], Measurements] = lambda m: m


def scaled(by: float) -> Fault:
    """All positions longer by a share."""
    return Fault(change=lambda m: replace(m, points=(1.0 + by) * m.points))


def rounded(step: float) -> Fault:
    """Joint values read in steps [rad]."""
    return Fault({"encoder": Encoder(step)})


def knocked(row: int, by: float) -> Fault:
    """A target that sits elsewhere from a row on [m]."""
    return Fault({"moved": MovedTarget(row, np.array([by, 0.0, 0.0]))})


def copied(m: Measurements) -> Measurements:
    """Every row twice."""
    each = np.arange(2 * len(m)) // 2
    return Measurements(m.joint_names, joints=m.joints[each], points=m.points[each])


def stated(m: Measurements) -> Measurements:
    """With the tracker's noise in the table."""
    return replace(m, sigma=np.full(len(m), SIGMA))


FAULTS = {
    "joints to 1 deg, sigma stated": replace(rounded(np.radians(1.0)), change=stated),
    "joints to 1 deg": rounded(np.radians(1.0)),
    "joints to 0.1 deg": rounded(np.radians(0.1)),
    "target knocked by 3 mm half way": knocked(31, 3e-3),
    "target knocked by 1 mm late": knocked(46, 1e-3),
    "scale 1.01": scaled(0.01),
    "scale 1.02": scaled(0.02),
    "4 poses, right arm": Fault({"sizes": None}, 4),
    "half the rows off by 10 mm, right arm": Fault({"sizes": None, "outliers": HALF}),
    "every row copied": Fault(poses=40, change=copied),
}


def judged(
    seed: int, fault: Fault, model: str, cell: Cell, true: str, tidy: bool
) -> CalibrationValues:
    """The calibration of a table; tidy: rows in the order of the first joint's values."""
    name, base, tip = ARMS[seed % 2]
    robot = Robot.load(name, base=base, tip=tip)
    usual: dict[str, Any] = {"noise": NOISE, "model": true, "cell": cell, "sigma_angle": 1e-4}
    scenario = Scenario(robot, **{**usual, **fault.scenario})
    q = scenario.random_poses(fault.poses, seed)
    q = q[np.argsort(q[:, 0])] if tidy else q
    made = simulate(scenario, validation=0, seed=seed, poses=q).measurements
    return calibrate(robot, fault.change(made), cell=cell, model=model)


def codes(result: CalibrationValues) -> list[str]:
    """The verdict and its reasons."""
    assert result.verdict is not None
    return [result.verdict.use, *(reason.code for reason in result.verdict.reasons)]


def main() -> None:
    """Either of the two."""
    for name, fault in FAULTS.items() if sys.argv[1] == "faults" else ():
        for seed, model in ((0, "dh"), (0, "auto"), (1, "dh"), (1, "auto")):
            told = codes(judged(seed, fault, model, Cell(), "dh", False))
            print(f"{name:38} {ARMS[seed][0]:6} {model:5} {told[0]}: {', '.join(told[1:])}")
    found: Counter[str] = Counter()
    count = int(sys.argv[2]) if sys.argv[1] == "clean" else 0
    for seed in range(count):
        rng = np.random.default_rng(seed)
        true, model = str(rng.choice(TRUE_MODELS)), str(rng.choice(["dh", "auto"]))
        frame, tidy = bool(rng.integers(2)), bool(rng.integers(2))
        kind, sigma = (("point", "pose")[int(rng.integers(2))], (None, SIGMA)[int(rng.integers(2))])
        cell = Cell(estimate_frame=frame, sigma=sigma, kind=kind)
        clean = Fault(poses=int(rng.integers(20, 151)))
        found.update(codes(judged(seed, clean, model, cell, true, tidy)))
    for code, number in sorted(found.items()):
        print(f"{code:60} {number:5} {number / count:7.1%}")


if __name__ == "__main__":
    main()
