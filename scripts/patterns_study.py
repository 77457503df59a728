"""Faults of a table that leave held-out errors small: verdicts on them, and how often clean tables have reasons.

python scripts/patterns_study.py faults      each fault once for each arm and model
python scripts/patterns_study.py clean 200   so many clean tables, with the share of each reason
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

import numpy as np
from studies import print_table, run_jobs, study_parser, unchanged, verdict_of, verdict_text

from calib.data.cell import Cell, TrackerNoise
from calib.data.measurements import Measurements
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.robot.robot import Robot
from calib.verbs.simulate.disturbances import Encoder, MovedTarget, Outliers
from calib.verbs.simulate.scenario import Scenario, simulate

#: Name, base and tip of the arms.
ARMS = (("ur5", "base", "tool0"), ("panda", "panda_link0", "panda_link8"))

#: Models of the errors of the robots with clean tables.
TRUE_MODELS = ("dh", "placement", "dh+gain", "dh+eccentricity", "dh+compliance")

#: Models that are fitted.
MODELS = ("dh", "auto")

#: Noise of a coordinate [m].
SIGMA = 5e-5


@dataclass(frozen=True)
class Fault:
    """A table with a fault."""

    scenario: dict[str, Any] = field(default_factory=dict)  # Arguments of its `Scenario`
    poses: int = 60
    change: Callable[[Measurements], Measurements] = (
        unchanged  # From the measured table to the faulty one
    )


def scaled(share: float) -> Fault:
    """Return a fault: all positions are longer by a share."""
    return Fault(change=lambda table: replace(table, points=(1.0 + share) * table.points))


def rounded(step: float) -> Fault:
    """Return a fault: joint values are read in steps [rad]."""
    return Fault({"encoder": Encoder(step)})


def knocked(row: int, length: float) -> Fault:
    """Return a fault: from a row on, the target is displaced by a length [m]."""
    return Fault({"moved": MovedTarget(row, np.array([length, 0.0, 0.0]))})


def rows_twice(table: Measurements) -> Measurements:
    """Return a table with each row twice."""
    rows = np.arange(2 * len(table)) // 2
    return Measurements(table.joint_names, joints=table.joints[rows], points=table.points[rows])


def with_sigma(table: Measurements) -> Measurements:
    """Return a table that states the tracker's noise."""
    return replace(table, sigma={"m": np.full(len(table), SIGMA)})


FAULTS = {
    "joints to 1 deg, sigma stated": replace(rounded(np.radians(1.0)), change=with_sigma),
    "joints to 1 deg": rounded(np.radians(1.0)),
    "joints to 0.1 deg": rounded(np.radians(0.1)),
    "target knocked by 3 mm half way": knocked(31, 3e-3),
    "target knocked by 1 mm late": knocked(46, 1e-3),
    "scale 1.01": scaled(0.01),
    "scale 1.02": scaled(0.02),
    "4 poses, right arm": Fault({"sizes": None}, poses=4),
    "half the rows off by 10 mm, right arm": Fault(
        {"sizes": None, "outliers": Outliers(share=0.5, size=0.01)}
    ),
    "every row copied": Fault(poses=40, change=rows_twice),
}


def calibrate_table(
    seed: int, fault: Fault, model: str, cell: Cell, true_model: str, *, sort: bool
) -> Calibration:
    """Measure and calibrate an arm.

    Args:
        seed: Of the random numbers; even for the first arm, odd for the second.
        fault: Fault of the table.
        model: Model that is fitted.
        cell: Cell of the simulation and the fit.
        true_model: Model of the robot's errors.
        sort: Order the rows by the values of the first joint.
    """
    name, base, tip = ARMS[seed % 2]
    usual = {
        "noise": TrackerNoise(constant=SIGMA),
        "model": true_model,
        "cell": cell,
        "sigma": {"rad": 1e-4},
    }
    scenario = Scenario(Robot.load(name, base=base, tip=tip), **{**usual, **fault.scenario})
    q = scenario.random_poses(fault.poses, seed)
    if sort:
        q = q[np.argsort(q[:, 0])]
    table = simulate(scenario, validation=0, seed=seed, poses=q).measurements
    return calibrate(scenario.robot, fault.change(table), cell=cell, model=model)


def fault_row(name: str, seed: int, model: str) -> list[str]:
    """Return the row of a fault, with the verdict on it."""
    result = calibrate_table(seed, FAULTS[name], model, Cell(), "dh", sort=False)
    return [name, ARMS[seed][0], model, verdict_text(result)]


def clean_codes(seed: int) -> list[str]:
    """Calibrate a clean table; return the verdict and the codes of its reasons."""
    rng = np.random.default_rng(seed)
    true_model = str(rng.choice(TRUE_MODELS))
    model = str(rng.choice(["dh", "auto"]))
    frame = bool(rng.integers(2))
    sort = bool(rng.integers(2))
    kind = ("point", "pose")[int(rng.integers(2))]
    sigma = ({}, {"m": SIGMA})[int(rng.integers(2))]
    cell = Cell(estimate_frame=frame, sigma=sigma, kind=kind)
    clean = Fault(poses=int(rng.integers(20, 151)))
    verdict = verdict_of(calibrate_table(seed, clean, model, cell, true_model, sort=sort))
    return [verdict.use, *(reason.code for reason in verdict.reasons)]


def clean_rows(tables: Sequence[list[str]]) -> Iterator[list[str]]:
    """Yield how many tables have each code."""
    counts = Counter(code for codes in tables for code in codes)
    for code, count in sorted(counts.items()):
        yield [code, str(count), f"{count / len(tables):.1%}"]


def main() -> None:
    """Print one of the two tables."""
    parser = study_parser(__doc__, parallel=True)
    parser.add_argument("part", choices=["faults", "clean"])
    parser.add_argument("count", type=int, nargs="?", default=200, help="number of clean tables")
    arguments = parser.parse_args()
    workers = arguments.workers
    if arguments.part == "faults":
        cases = product(FAULTS, range(len(ARMS)), MODELS)
        rows = run_jobs(fault_row, cases, workers=workers, label="faults")
        print_table(["fault", "arm", "model", "verdict"], rows, [38, 5, 5])
    else:
        seeds = [(seed,) for seed in range(arguments.count)]
        tables = list(run_jobs(clean_codes, seeds, workers=workers, label="clean tables"))
        print_table(["code", "tables", "share"], clean_rows(tables), [24])


if __name__ == "__main__":
    main()
