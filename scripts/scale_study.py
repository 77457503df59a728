"""An instrument whose scale is wrong: verdicts, expected errors and true errors of the arms that it measures.

    python scripts/scale_study.py 20 [FIRST]
    python scripts/scale_study.py 20 --said tracker
    python scripts/scale_study.py 20 --said certified

All measured positions are a share too long. The corrected URDF is evaluated at 1,000 other poses over the joint limits
without noise and without the scale error, with the target registered to them, and the frame where it is unknown. The
expected error is that over the joint limits, as the verdict has it. With ``certified`` the cell states the scale with
its uncertainty, 0.01 %: up to that, verdicts and errors are those of an ``exact`` instrument, whose scale error is 0; a
scale error far beyond it contradicts what is stated, and has to be told where rows can tell it from lengths of the arm.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import islice, product

import numpy as np
from arms import load_arm
from studies import add_noise, draw_seed, print_table, run_jobs, study_parser, verdict_of
from verdict_study import urdf_error

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.diagnosis.reasons import CARE, NO, USE
from calib.result.calibrate import calibrate
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.verbs.simulate.truth import draw_truth

ARMS = ("ur3", "ur10e", "panda")

#: Scale errors of the instrument, as shares.
SCALES = (0.0, 2e-5, 1e-4, 5e-4, 1e-3, 2e-3, 3e-3, 5e-3, 1e-2)

#: Reasons that tell of the scale.
OF_SCALE = {"lengths_scaled", "scale_hidden"}

#: Points of a table.
COUNT = 40

#: Noise of a coordinate [m].
NOISE = 5e-5

#: A URDF is worth using if no more than this share of the nominal one's error remains.
BETTER = 0.8

#: The expected error covers the true one if that is no larger than so many times the expected error.
COVERED = 1.0

#: Standard uncertainty of a certified scale, a share: a bar of 1 m that is known to 0.1 mm.
CERTIFICATE = 1e-4

#: What the cell says of the scale, by name.
SAID = {
    "nothing": lambda cell: cell,
    "tracker": lambda cell: replace(cell, instrument="tracker"),
    "certified": lambda cell: replace(cell, scale_certified=True, stated_scale_sigma=CERTIFICATE),
    "exact": lambda cell: replace(cell, scale_certified=True),
}

TITLES = (
    "scale [%]",
    "frame",
    USE,
    CARE,
    NO,
    "wrong use",
    "told",
    "nominal [mm]",
    "true [mm]",
    "expected [mm]",
    "covered",
)


@dataclass(frozen=True)
class Outcome:
    """A simulated calibration."""

    use: str  # The verdict
    codes: tuple[str, ...]  # Of its reasons
    nominal: float  # True error of the nominal URDF, rms [m]
    corrected: float  # True error of the corrected URDF, rms [m]
    expected: float  # Expected error of the corrected URDF over the joint limits, rms [m]

    @property
    def is_wrong(self) -> bool:
        """True if the verdict is `use` and the corrected URDF is not better by a fifth."""
        return self.use == USE and self.corrected > BETTER * self.nominal

    @property
    def is_told(self) -> bool:
        """True if the verdict tells of the scale."""
        return bool(OF_SCALE & {*self.codes})

    @property
    def is_covered(self) -> bool:
        """True if the expected error covers the true one."""
        return self.corrected <= COVERED * self.expected


@cache
def arm_of(name: str) -> Robot:
    """Return a robot; one of the arms that calib knows by name has the base and tip of its URDF."""
    return Robot.load(name) if name == "ur10e" else load_arm(name)


def simulate(scale: float, free: bool, said: str, arm: str, seed: int) -> Outcome:
    """Draw an arm, measure it by an instrument with a scale error of either sign, calibrate and evaluate.

    Args:
        scale: Share by which the instrument's lengths are too long or too short.
        free: Whether the measurement frame is unknown.
        said: What the cell says of the scale, one of `SAID`.
        arm: The arm, one of `ARMS`.
        seed: Of the random numbers.
    """
    rng = np.random.default_rng([44, seed, ARMS.index(arm)])
    robot = arm_of(arm)
    truth = draw_truth(robot, seed=draw_seed(rng), cell=Cell(estimate_frame=free))
    q = random_joint_values(robot, COUNT, draw_seed(rng))
    sign = rng.choice((-1.0, 1.0))
    points = add_noise((1.0 + sign * scale) * truth.points(q), NOISE, rng)
    cell = SAID[said](Cell(estimate_frame=free))
    result = calibrate(robot, Measurements(robot.joint_names, q, points), cell=cell)
    verdict = verdict_of(result)
    return Outcome(
        use=verdict.use,
        codes=tuple(reason.code for reason in verdict.reasons),
        nominal=urdf_error(robot, truth, cell),
        corrected=urdf_error(result.robot, truth, cell),
        expected=result.geometry.new_point[1],
    )


def case_row(scale: float, free: bool, outcomes: Sequence[Outcome]) -> list[str]:
    """Return the row of a scale error: verdicts, and means and shares over its arms."""
    uses = [outcome.use for outcome in outcomes]
    errors = np.array([(one.nominal, one.corrected, one.expected) for one in outcomes])
    means = [f"{1e3 * mean:.2f}" for mean in errors.mean(axis=0)]
    return [
        f"{100.0 * scale:g}",
        "estimated" if free else "known",
        *(str(uses.count(use)) for use in (USE, CARE, NO)),
        str(sum(outcome.is_wrong for outcome in outcomes)),
        str(sum(outcome.is_told for outcome in outcomes)),
        *means,
        f"{100.0 * np.mean([outcome.is_covered for outcome in outcomes]):.0f} %",
    ]


def main() -> None:
    """Print a row for each scale error and frame, then the sums."""
    parser = study_parser(__doc__, parallel=True)
    parser.add_argument("count", type=int, metavar="COUNT", help="of each arm")
    parser.add_argument("first", type=int, nargs="?", default=0, metavar="FIRST", help="seed")
    parser.add_argument("--said", choices=tuple(SAID), default="nothing", help="in the cell")
    arguments = parser.parse_args()
    seeds = range(arguments.first, arguments.first + arguments.count)
    cases = [(scale, free, arguments.said) for scale in SCALES for free in (False, True)]
    runs = list(product(ARMS, seeds))
    jobs = [(*case, *run) for case in cases for run in runs]
    results = run_jobs(simulate, jobs, workers=arguments.workers)
    every: list[Outcome] = []

    def rows() -> Iterator[list[str]]:
        """Yield the row of each case as soon as it is there."""
        for scale, free, _ in cases:
            outcomes = list(islice(results, len(runs)))
            every.extend(outcomes)
            yield case_row(scale, free, outcomes)

    print_table(TITLES, rows())
    wrong = sum(outcome.is_wrong for outcome in every)
    covered = sum(outcome.is_covered for outcome in every)
    print(f"\nwrong {USE}: {wrong} of {len(every)}; covered: {covered} of {len(every)}")


if __name__ == "__main__":
    main()
