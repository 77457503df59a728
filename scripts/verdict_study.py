"""Simulated calibrations from hopeless to excellent: whether the verdict on the URDF is right, without validation rows.

    .venv/bin/python scripts/verdict_study.py 500 [FIRST]

Drawn are the arm, what is wrong with it and how much, the number of points, which part of the joints' ranges they use,
noise, accidents, whether the frame is known and whether the URDF has masses. Judged is each URDF by its error at 1,000
other poses all over the joint limits, without noise, the frame registered to them where it is unknown, and the target;
and the error to expect of a new point by 400 rows like those that were fitted.
"""

from __future__ import annotations

import sys
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from selection_study import ARMS, TRUTHS, without_masses

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.diagnosis.reasons import CARE, NO, USE, Verdict
from calib.result.calibrate import calibrate
from calib.result.calibration import CalibrationValues
from calib.result.evaluation import evaluate
from calib.robot.payload import Payload
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.simulation.truth import Truth, draw_truth
from calib.units import Array

COUNTS = (5, 6, 8, 10, 12, 15, 20, 30, 50, 100)
TYPICAL = {
    "length": 0.3e-3,
    "angle": 3e-3,
    "zero": 5e-3,
    "gain": 5e-4,
    "eccentricity": 0.5e-3,
    "compliance": 2e-5,
}
FRESH, LIKE_THOSE = 1000, 400

#: Nothing is wrong with a table of so many points or more, of no more noise [m], over so much of the joints' ranges or
#: more, without accidents; and a verdict `use` asks that less than this share of the error remains.
ENOUGH, QUIET, WIDE, REMAINS = 10, 0.5e-3, 0.5, 0.4

#: Shares of a range of joint values, and of accidents: all over it, and none, are drawn more often.
CORNERS, ACCIDENTS = (1.0, 1.0, 1.0, 0.5, 0.2, 0.1), (0.0, 0.0, 0.0, 0.05, 0.1, 0.25)


@dataclass(frozen=True)
class Found:
    """What came of one calibration."""

    result: CalibrationValues
    accidents: float  # Share of rows
    sigma: float  # Noise of a coordinate [m]
    corner: float  # Which part of each joint's range was used
    nominal: float  # Error of the nominal URDF at the fresh poses [m]
    corrected: float  # Of the corrected one [m]
    expected: dict[
        str, float
    ]  # Error to expect of a new point over that of rows like those fitted, by model

    @property
    def outcome(self) -> str:
        """What became of the error."""
        if self.corrected < 0.5 * self.nominal:
            return "halved"
        return "falls" if self.corrected < (1.0 - 1e-6) * self.nominal else "does not fall"

    @property
    def sound(self) -> bool:
        """Whether nothing is wrong with the table, and little of the error remains."""
        rows = len(self.result.rows.numbers)
        good = rows >= ENOUGH and self.sigma <= QUIET and self.corner >= WIDE
        return good and not self.accidents and self.corrected < REMAINS * self.nominal

    @property
    def verdict(self) -> Verdict:
        """On the URDF."""
        assert self.result.verdict is not None
        return self.result.verdict

    def __str__(self) -> str:
        """One line."""
        verdict = self.verdict
        size, told = f"{1e3 * self.nominal:.3f} -> {1e3 * self.corrected:.3f} mm", verdict.reasons
        return f"{self.outcome}: {size}, {verdict.use}: {', '.join(one.code for one in told)}"


def rms(errors: Array) -> float:
    """Root mean square length of errors (N, 3)."""
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=1))))


def calibration(seed: int) -> Found:
    """One calibration."""
    rng = np.random.default_rng([7, seed])
    arm, true = str(rng.choice(list(ARMS))), str(rng.choice(list(TRUTHS.values())))
    robot, count, size = Robot.load(arm, *ARMS[arm]), int(rng.choice(COUNTS)), _log(rng, 0.03, 3.0)
    sigma, free, share = _log(rng, 1e-5, 1e-3), bool(rng.integers(2)), float(rng.choice(ACCIDENTS))
    off, corner, masses = _log(rng, 1e-3, 3e-2), float(rng.choice(CORNERS)), bool(rng.integers(2))
    cell = Cell(estimate_frame=free, payload=Payload(3.0, np.array([0.0, 0.0, 0.05])))
    sizes = None if true == "frames" else {family: size * one for family, one in TYPICAL.items()}
    truth = draw_truth(robot, true, sizes, int(rng.integers(10**6)), cell=cell)

    middle = random_joint_values(robot, 1, int(rng.integers(10**6)))
    seeds = int(rng.integers(10**6)), 98
    measured, like_those = (
        middle + corner * (random_joint_values(robot, n, s) - middle)
        for n, s in zip((count, LIKE_THOSE), seeds, strict=True)
    )
    points, seen = (_seen(truth, q, sigma, rng) for q in (measured, like_those))
    wild = rng.random(count) < share
    points[wild] += off * rng.normal(size=(int(np.sum(wild)), 3))
    known = robot if masses else without_masses(robot)
    told = Cell(estimate_frame=free)
    result = calibrate(known, Measurements(robot.joint_names, measured, points), cell=told)

    fresh = random_joint_values(robot, FRESH, 99)
    table = Measurements(robot.joint_names, fresh, truth.points(fresh))
    errors = [evaluate(one, table, told).errors["all"].rms for one in (known, result.robot)]
    expected = {
        "geometry": result.new_point[0]
        / rms(result.predict(like_those, non_geometric=False) - seen)
    }
    if result.non_geometric is not None:
        expected["non_geometric"] = result.non_geometric.new_point[0] / rms(
            result.predict(like_those) - seen
        )
    return Found(result, share, sigma, corner, errors[0], errors[1], expected)


def _log(rng: np.random.Generator, low: float, high: float) -> float:
    """A number between two, each power of ten as likely."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _seen(truth: Truth, q: Array, sigma: float, rng: np.random.Generator) -> Array:
    """Points with noise."""
    return truth.points(q) + sigma * rng.normal(size=(len(q), 3))


def table(found: list[Found]) -> Iterator[str]:
    """Outcomes against verdicts; and expected errors."""
    counts = Counter((one.outcome, one.verdict.use) for one in found)
    yield f"{'':14}" + "".join(f"{use:>15}" for use in (USE, CARE, NO))
    for outcome in ("halved", "falls", "does not fall"):
        yield f"{outcome:14}" + "".join(f"{counts[outcome, use]:15}" for use in (USE, CARE, NO))
    sound = [one.verdict.use for one in found if one.sound]
    yield f"nothing wrong  {sound.count(USE)} of {len(sound)} {USE}"
    rises = [one.verdict.use for one in found if one.corrected > one.nominal * (1 + 1e-6)]
    yield f"rises          {rises.count(NO)} of {len(rises)} {NO}"
    ratios = defaultdict(list)
    for one in found:
        for model, ratio in one.expected.items():
            rows = len(one.result.rows.numbers)
            group = "below 9" if rows < 9 else "9 to 15" if rows < 16 else "16 and more"
            if one.accidents < 0.06 and one.result.cross_validation is not None:
                ratios[model, group].append(ratio)
    for (model, group), some in sorted(ratios.items()):
        yield (
            f"expected over found, {model}, {group} rows: mean {np.mean(some):.3f}, "
            f"median {np.median(some):.3f} of {len(some)}"
        )


def main() -> None:
    """Print a line each, then the table."""
    first = int(sys.argv[2]) if len(sys.argv) > 2 else 0
    found = []
    for seed in range(first, first + int(sys.argv[1])):
        found.append(calibration(seed))
        print(seed, found[-1], flush=True)
    for line in table(found):
        print(line)


if __name__ == "__main__":
    main()
