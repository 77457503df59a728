"""Tables of a tracker that drifts: the robot's true error over the one that is said, with the drift and without.

    python scripts/drift_study.py [TABLES] [SEED]

Each arm is measured in the base or in a tracker's own frame. The tracker drifts evenly from the first row to the last.
Printed are the true error of predictions at fresh poses, in the frame as it was at the first row and after the best
rigid motion, the error that is said of new measured points, the ratio of theirs to it, and how often the drift is taken
out or a doubt, and the verdict is `use`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from arms import load_arm
from studies import (
    TYPICAL_ERRORS,
    add_noise,
    print_table,
    rms,
    rms_length,
    run_cases,
    study_parser,
    verdict_of,
)

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.diagnosis.reasons import USE
from calib.numerics.rigid_motion import without_rigid_motion
from calib.result.calibrate import calibrate
from calib.robot.ranges import random_joint_values
from calib.verbs.simulate.truth import draw_truth

ARMS = ("ur3", "ur10", "panda")

#: Rows of a table.
ROWS = 40

#: Fresh poses.
FRESH = 300

#: Noise of a coordinate [m].
NOISE = 3e-5

#: Lengths of a drift [m].
DRIFTS = (0.0, 3e-4, 1e-3)


@dataclass(frozen=True)
class Case:
    """A drift, and whether the tracker's frame is estimated."""

    drift: float  # From the first row to the last [m]
    free: bool


@dataclass(frozen=True)
class Outcome:
    """Figures of one table."""

    true: float  # Error at fresh poses as at the first row, rms [m]
    arm: float  # The same after the best rigid motion, rms [m]
    said: float  # Expected error at a new point, rms [m]
    codes: tuple[str, ...]  # Of the verdict's reasons
    use: str


def run_once(case: Case, seed: int) -> Outcome:
    """Draw a robot, measure it with a drift, and calibrate."""
    rng = np.random.default_rng([46, seed])
    cell = Cell(estimate_frame=case.free)
    robot = load_arm(ARMS[seed % len(ARMS)])
    truth = draw_truth(robot, "dh", dict(TYPICAL_ERRORS), seed, cell=cell)
    q = random_joint_values(robot, ROWS, 2 * seed)
    fresh = random_joint_values(robot, FRESH, 2 * seed + 1)
    direction = rng.normal(size=3)
    drift = case.drift * direction / np.linalg.norm(direction)
    points = add_noise(truth.points(q), NOISE, rng) + np.linspace(0.0, 1.0, ROWS)[:, None] * drift
    result = calibrate(robot, Measurements(robot.joint_names, q, points), cell=cell, model="dh")
    predicted, true = result.predict(fresh), truth.points(fresh)
    error = predicted - true
    of_arm = without_rigid_motion(true, error[:, :, None])[:, :, 0]
    verdict = verdict_of(result)
    return Outcome(
        true=rms_length(error),
        arm=rms_length(of_arm),
        said=result.new_point[0],
        codes=tuple(reason.code for reason in verdict.reasons),
        use=verdict.use,
    )


def case_row(case: Case, runs: Sequence[Outcome]) -> list[str]:
    """Return the row of a case."""
    true, arm, said = (
        np.array([getattr(run, name) for run in runs]) for name in ("true", "arm", "said")
    )
    removed, doubted = (
        np.mean([code in run.codes for run in runs]) for code in ("drift_removed", "drift")
    )
    return [
        f"{1e3 * case.drift:.1f}",
        "estimated" if case.free else "known",
        f"{1e3 * rms(true):.3f}",
        f"{1e3 * rms(arm):.3f}",
        f"{1e3 * rms(said):.3f}",
        f"{np.median(np.hypot(true, np.sqrt(3.0) * NOISE) / said):.2f}",
        f"{removed:.0%}",
        f"{doubted:.0%}",
        f"{np.mean([run.use == USE for run in runs]):.0%}",
    ]


def main() -> None:
    """Print a row for each drift, by frame."""
    parser = study_parser(__doc__, parallel=True)
    parser.add_argument("tables", type=int, nargs="?", default=6, metavar="TABLES")
    parser.add_argument("seed", type=int, nargs="?", default=0, metavar="SEED")
    arguments = parser.parse_args()
    cases = [Case(drift, free) for free in (False, True) for drift in DRIFTS]
    seeds = range(arguments.seed, arguments.seed + arguments.tables)
    results = run_cases(run_once, cases, seeds, workers=arguments.workers, label="tables")
    titles = ["drift [mm]", "frame", "true [mm]", "of the arm", "said", "measured over said"]
    titles += ["taken out", "a doubt", "use"]
    print_table(titles, (case_row(case, runs) for case, runs in results), [10, 9])


if __name__ == "__main__":
    main()
