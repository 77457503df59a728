"""Verdicts on simulated calibrations from hopeless to excellent, without validation rows.

    python scripts/verdict_study.py 500 [FIRST]
    python scripts/verdict_study.py 700 FIRST --sound    only those of these seeds with nothing wrong in the table

Drawn are the arm, its errors and their size, the number of points, the part of the joint ranges that they use, noise,
outliers, if the frame is known and if the URDF has masses. A URDF is evaluated at 1,000 other poses all over the joint
limits, without noise, with the target registered to them, and the frame where it is unknown. The expected error at a
new point is compared with that of 400 rows like the fitted ones.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import tee

import numpy as np
from arms import load_arm, without_masses
from selection_study import ARMS, TRUTHS
from studies import (
    TYPICAL_ERRORS,
    add_noise,
    draw_seed,
    joint_values_around,
    log_uniform,
    print_table,
    rms_length,
    run_jobs,
    study_parser,
    verdict_of,
)

from calib.basics.arrays import Array
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.diagnosis.reasons import CARE, NO, USE
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.robot.gravity import Payload
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.verbs.evaluate.evaluation import evaluate
from calib.verbs.simulate.truth import Truth, draw_truth

#: Numbers of points.
COUNTS = (5, 6, 8, 10, 12, 15, 20, 30, 50, 100)

#: Range of the errors' standard deviations over typical ones.
SIZES = (0.03, 3.0)

#: Range of the noise of a coordinate [m].
SIGMAS = (1e-5, 1e-3)

#: Shares of the joint ranges that the poses use; all of them more often.
RANGE_SHARES = (1.0, 1.0, 1.0, 0.5, 0.2, 0.1)

#: Shares of the rows that are outliers; none more often.
OUTLIER_SHARES = (0.0, 0.0, 0.0, 0.05, 0.1, 0.25)

#: Range of the outliers' standard deviation [m].
OUTLIER_SIZES = (1e-3, 3e-2)

#: Poses at which a URDF is evaluated.
FRESH = 1000

#: Poses like the fitted ones.
LIKE_FITTED = 400

#: Fewest points of a sound table.
SOUND_COUNT = 10

#: Largest noise of a sound table [m].
SOUND_SIGMA = 0.5e-3

#: Smallest share of the joint ranges that a sound table uses.
SOUND_RANGE = 0.5

#: Largest share of the error that remains after a calibration which is to be `use`.
SOUND_REMAINS = 0.4

#: Relative change of an error below which it neither falls nor rises.
ROUNDING = 1e-6

#: Changes of the URDF's error.
HALVED = "halved"
FALLS = "falls"
DOES_NOT_FALL = "does not fall"

TITLES = ("seed", "outcome", "error [mm]", "verdict", "reasons")


@dataclass(frozen=True)
class Setting:
    """A calibration to simulate."""

    arm: str
    true_model: str  # Of the robot's errors
    count: int  # Number of points
    size: float  # The errors' standard deviations over typical ones
    sigma: float  # Noise of a coordinate [m]
    free: bool  # The measurement frame is unknown
    outlier_share: float  # Of the rows
    outlier_size: float  # Standard deviation of an outlier's coordinate [m]
    range_share: float  # Of each joint's range
    masses: bool  # The URDF has masses

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Setting:
        """Draw a setting; the order of the fields is that of the draws."""
        return cls(
            arm=str(rng.choice(ARMS)),
            true_model=str(rng.choice(list(TRUTHS.values()))),
            count=int(rng.choice(COUNTS)),
            size=log_uniform(rng, *SIZES),
            sigma=log_uniform(rng, *SIGMAS),
            free=bool(rng.integers(2)),
            outlier_share=float(rng.choice(OUTLIER_SHARES)),
            outlier_size=log_uniform(rng, *OUTLIER_SIZES),
            range_share=float(rng.choice(RANGE_SHARES)),
            masses=bool(rng.integers(2)),
        )

    @property
    def sound(self) -> bool:
        """True if nothing is wrong with the table."""
        return (
            self.count >= SOUND_COUNT
            and self.sigma <= SOUND_SIGMA
            and self.range_share >= SOUND_RANGE
            and self.outlier_share == 0.0
        )

    def truth(self, rng: np.random.Generator) -> Truth:
        """Draw the robot's errors and what is true of its cell."""
        std = {family: self.size * typical for family, typical in TYPICAL_ERRORS.items()}
        sizes = None if self.true_model == "frames" else std
        cell = Cell(estimate_frame=self.free, payload=Payload(3.0, np.array([0.0, 0.0, 0.05])))
        return draw_truth(load_arm(self.arm), self.true_model, sizes, draw_seed(rng), cell=cell)


@dataclass(frozen=True)
class Outcome:
    """A simulated calibration, and its verdict."""

    setting: Setting
    rows: int  # Number of fitted rows
    use: str  # The verdict
    codes: tuple[str, ...]  # Of its reasons
    nominal: float  # Error of the nominal URDF at the fresh poses, rms [m]
    corrected: float  # Error of the corrected URDF there, rms [m]
    expected: dict[
        str, float
    ]  # Expected error at a new point over that of rows like the fitted ones, by model
    validated: bool  # The calibration has a cross-validation

    @property
    def change(self) -> str:
        """Change of the URDF's error: `HALVED`, `FALLS` or `DOES_NOT_FALL`."""
        if self.corrected < 0.5 * self.nominal:
            return HALVED
        return FALLS if self.corrected < (1.0 - ROUNDING) * self.nominal else DOES_NOT_FALL

    @property
    def rises(self) -> bool:
        """True if the corrected URDF is worse than the nominal one."""
        return self.corrected > self.nominal * (1.0 + ROUNDING)

    @property
    def sound(self) -> bool:
        """True if nothing is wrong with the table, and little of the error remains."""
        return self.setting.sound and self.corrected < SOUND_REMAINS * self.nominal


def seeded(seed: int) -> np.random.Generator:
    """Return the random numbers of a calibration."""
    return np.random.default_rng([7, seed])


def simulate(seed: int) -> Outcome:
    """Draw a setting, measure, calibrate and evaluate."""
    rng = seeded(seed)
    setting = Setting.draw(rng)
    truth = setting.truth(rng)
    robot = truth.nominal
    share = setting.range_share
    centre = random_joint_values(robot, 1, draw_seed(rng))
    q = joint_values_around(centre, share, robot, setting.count, draw_seed(rng))
    q_like = joint_values_around(centre, share, robot, LIKE_FITTED, 98)
    points = add_noise(truth.points(q), setting.sigma, rng)
    points_like = add_noise(truth.points(q_like), setting.sigma, rng)
    outlier = rng.random(setting.count) < setting.outlier_share
    points[outlier] += setting.outlier_size * rng.normal(size=(int(np.sum(outlier)), 3))
    given = robot if setting.masses else without_masses(robot)
    cell = Cell(estimate_frame=setting.free)
    result = calibrate(given, Measurements(robot.joint_names, q, points), cell=cell)
    verdict = verdict_of(result)
    return Outcome(
        setting=setting,
        rows=len(result.rows.numbers),
        use=verdict.use,
        codes=tuple(reason.code for reason in verdict.reasons),
        nominal=urdf_error(given, truth, cell),
        corrected=urdf_error(result.robot, truth, cell),
        expected=expected_ratios(result, q_like, points_like),
        validated=result.cross_validation is not None,
    )


def urdf_error(robot: Robot, truth: Truth, cell: Cell) -> float:
    """Return the error of a robot at fresh poses without noise, rms [m]."""
    q = random_joint_values(truth.nominal, FRESH, 99)
    table = Measurements(truth.nominal.joint_names, q, truth.points(q))
    return evaluate(robot, table, cell).errors["all"]["m"].rms


def expected_ratios(result: Calibration, q: Array, points: Array) -> dict[str, float]:
    """Return the expected error at a new point over that of other measured points.

    Args:
        result: The calibration.
        q: shape (N, m), joint values like the fitted ones [rad].
        points: shape (N, 3), points measured there [m].

    Returns:
        The ratio of the geometry, and of the non-geometric model if there is one.
    """
    parts = {"geometry": result.geometry}
    if result.non_geometric is not None:
        parts["non_geometric"] = result.non_geometric
    ratios = {}
    for name, part in parts.items():
        error = rms_length(result.predict(q, non_geometric=name != "geometry") - points)
        # The same instrument measured these points: what its scale error adds is not to be seen.
        without_scale = np.sqrt(part.new_point[0] ** 2 - part.by_scale[0] ** 2)
        ratios[name] = without_scale / error
    return ratios


def outcome_row(seed: int, outcome: Outcome) -> list[str]:
    """Return the row of one calibration."""
    error = f"{1e3 * outcome.nominal:.3f} -> {1e3 * outcome.corrected:.3f}"
    return [str(seed), outcome.change, error, outcome.use, ", ".join(outcome.codes)]


def verdict_rows(outcomes: Sequence[Outcome]) -> Iterator[list[str]]:
    """Yield how many calibrations of each outcome have each verdict."""
    counts = Counter((outcome.change, outcome.use) for outcome in outcomes)
    for change in (HALVED, FALLS, DOES_NOT_FALL):
        yield [change, *(str(counts[change, use]) for use in (USE, CARE, NO))]


def expected_rows(outcomes: Sequence[Outcome]) -> Iterator[list[str]]:
    """Yield the expected over the true error at a new point, by model and number of rows."""
    ratios = defaultdict(list)
    for outcome in outcomes:
        if outcome.setting.outlier_share > 0.06 or not outcome.validated:
            continue
        rows = "16 and more"
        if outcome.rows < 16:
            rows = "below 9" if outcome.rows < 9 else "9 to 15"
        for model, ratio in outcome.expected.items():
            ratios[model, rows].append(ratio)
    for (model, rows), of_group in sorted(ratios.items()):
        mean, median = np.mean(of_group), np.median(of_group)
        yield [model, rows, f"{mean:.3f}", f"{median:.3f}", str(len(of_group))]


def main() -> None:
    """Print a row for each calibration, then the counts."""
    parser = study_parser(__doc__, parallel=True)
    parser.add_argument("count", type=int, metavar="COUNT")
    parser.add_argument("first", type=int, nargs="?", default=0, metavar="FIRST", help="seed")
    parser.add_argument("--sound", action="store_true", help="only tables with nothing wrong")
    arguments = parser.parse_args()
    seeds = list(range(arguments.first, arguments.first + arguments.count))
    if arguments.sound:
        seeds = [seed for seed in seeds if Setting.draw(seeded(seed)).sound]
    jobs = [(seed,) for seed in seeds]
    printed, counted = tee(run_jobs(simulate, jobs, workers=arguments.workers))
    print_table(TITLES, map(outcome_row, seeds, printed), [6, 13, 16, 12])

    outcomes = list(counted)
    print()
    print_table(["", USE, CARE, NO], verdict_rows(outcomes), [13])
    sound = [outcome.use for outcome in outcomes if outcome.sound]
    rises = [outcome.use for outcome in outcomes if outcome.rises]
    print(f"\nnothing wrong: {sound.count(USE)} of {len(sound)} {USE}")
    print(f"the error rises: {rises.count(NO)} of {len(rises)} {NO}\n")
    titles = ["expected over true error", "rows", "mean", "median", "number"]
    print_table(titles, expected_rows(outcomes), [13, 11])


if __name__ == "__main__":
    main()
