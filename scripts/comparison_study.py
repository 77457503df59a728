"""How often `calib compare` reports a drift, with and without one: the figures of docs/comparison.md.

    python scripts/comparison_study.py --trials 300

A UR3 whose DH parameters err by 0.3 mm and 1 mrad is measured twice by a tracker of 0.05 mm noise a coordinate, which
stands elsewhere the second time; the target is mounted anew. In between nothing changes, or the zero of one joint does.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation
from studies import add_noise, draw_errors, print_table, rms, run_cases, study_parser

from calib.basics.arrays import Array
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.example import PAPER_TARGET, paper_urdf
from calib.model.error_model import ErrorModel
from calib.model.kinematics import Kinematics
from calib.model.parameter_sets import error_model
from calib.numerics.geometry import pose_of
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.robot.robot import Robot
from calib.verbs.compare.comparison import Comparison, compare

#: Outcomes of a comparison that are counted: a drift, and too little in common to tell.
DRIFT = "drift"
CANNOT_TELL = "cannot tell"

TITLES = ("case", "drift", "cannot tell", "p < 0.05", "chi2/k", "rms mm", "noise mm")


@dataclass(frozen=True)
class Case:
    """Two measurements of a robot: its errors, how it is measured, and what changes in between."""

    title: str
    rows: tuple[int, int] = (30, 30)  # Poses of each measurement
    noise: float = 5e-5  # Standard deviation of a coordinate [m]
    span: float = 2.5  # Joint values are from -span to span [rad]
    frame: bool = True  # The tracker stands anywhere, and its pose is estimated
    models: tuple[str, str] = ("dh", "dh")  # Fitted to each measurement
    truth: str = "dh"  # Model of the robot's errors
    size: float = 1.0  # Factor of their standard deviations
    same_poses: bool = False  # The second measurement repeats the poses of the first
    joint: str = ""  # Parameter that changes in between; none if empty
    drift: float = 0.0  # Its change [m] or [rad]


UNCHANGED = (
    Case("30 poses"),
    Case("60 poses", rows=(60, 60)),
    Case("15 poses", rows=(15, 15)),
    Case("30 and 100 poses", rows=(30, 100)),
    Case("frame known", frame=False),
    Case("joints within +-34 deg", span=0.6),
    Case("noise 0.2 mm", noise=2e-4),
    Case("errors five times as large", size=5.0),
    Case("no errors at all", size=0.0),
    Case("model placement", models=("placement", "placement")),
    Case("models dh and placement", models=("dh", "placement")),
    Case("model auto", models=("auto", "auto")),
    Case("errors that dh lacks, other poses", truth="placement"),
    Case("errors that dh lacks, the same poses", truth="placement", same_poses=True),
)


def drifted_cases() -> Iterator[Case]:
    """Yield the cases in which the zero of one joint changes by 0.3 mrad."""
    drift = 3e-4
    for rows in (30, 60):
        for joint in ("theta1", "theta2", "theta3", "theta4", "theta5"):
            title = f"{joint} by 0.3 mrad, {rows} poses"
            yield Case(title, rows=(rows, rows), joint=joint, drift=drift)
    yield Case("theta3, 60 poses, no errors", rows=(60, 60), size=0.0, joint="theta3", drift=drift)
    yield Case("theta1, frame known", frame=False, joint="theta1", drift=drift)


@dataclass(frozen=True)
class Figures:
    """Figures of one comparison."""

    p: float  # Of the test for a drift
    chi_square: float  # Over the number of combinations that are compared
    outcome: str
    rms: float  # Change of the predicted positions [m]
    noise: float  # Expected of it from noise alone [m]


def draw_placement(case: Case, rng: np.random.Generator) -> tuple[Array, Array]:
    """Draw T_frame_base of the tracker and T_tip_target of the target, shape (4, 4) each, [m]."""
    T_frame_base = np.eye(4)
    if case.frame:
        R = Rotation.random(random_state=rng).as_matrix()
        T_frame_base = pose_of(rng.uniform(-3.0, 3.0, 3), R)
    return T_frame_base, pose_of(PAPER_TARGET + rng.normal(0.0, 0.02, 3))


def measure(
    case: Case, robot: Robot, errors: ErrorModel, x: Array, q: Array, rng: np.random.Generator
) -> Measurements:
    """Measure a robot whose errors are x, shape (p,), at joint values q, shape (N, 6), [rad]."""
    kinematics = Kinematics(robot, errors, *draw_placement(case, rng))
    points = kinematics.points(x, q)
    return Measurements(robot.joint_names, q, add_noise(points, case.noise, rng))


def compare_twice(case: Case, seed: int) -> Comparison:
    """Measure a robot twice, calibrate each time, and compare the two calibrations."""
    rng = np.random.default_rng([2026, seed])
    robot = Robot.load(paper_urdf(), base="base", tip="tool0")
    errors = error_model(robot, case.truth, target=False)
    x = draw_errors(errors, 3e-4, 1e-3, rng) * case.size
    changed = x.copy()
    if case.joint:
        changed[errors.index(case.joint)] += case.drift
    results: list[Calibration] = []
    q = rng.uniform(-case.span, case.span, (case.rows[0], 6))
    for truth, count, model in zip((x, changed), case.rows, case.models, strict=True):
        if not case.same_poses:
            q = rng.uniform(-case.span, case.span, (count, 6))
        table = measure(case, robot, errors, truth, q, rng)
        cell = Cell(estimate_frame=case.frame, model=model)
        results.append(calibrate(robot, table, cell=cell, validate=False))
    return compare(results[0], results[1])


def run_once(case: Case, seed: int) -> Figures:
    """Return the figures of one comparison."""
    comparison = compare_twice(case, seed)
    test = comparison.test
    move = comparison.moves[0]
    return Figures(
        p=test.p,
        chi_square=test.chi_square / max(test.combinations, 1),
        outcome=comparison.outcome,
        rms=move.rms,
        noise=move.noise,
    )


def case_row(case: Case, runs: Sequence[Figures]) -> list[str]:
    """Return the row of a case: shares and means over its runs."""
    numbers = (
        np.mean([run.outcome == DRIFT for run in runs]),
        np.mean([run.outcome == CANNOT_TELL for run in runs]),
        np.mean([run.p < 0.05 for run in runs]),
        np.mean([run.chi_square for run in runs]),
        1e3 * rms(np.array([run.rms for run in runs])),
        1e3 * rms(np.array([run.noise for run in runs])),
    )
    return [case.title, *(f"{number:.3f}" for number in numbers)]


def main() -> None:
    """Print a row for each case."""
    parser = study_parser(__doc__, parallel=True)
    parser.add_argument("--trials", type=int, default=300)
    arguments = parser.parse_args()
    seeds = range(arguments.trials)
    tables = {"Nothing changed": UNCHANGED, "One joint's zero changed": tuple(drifted_cases())}
    for title, cases in tables.items():
        print(f"\n{title}: {arguments.trials} trials each\n")
        results = run_cases(run_once, cases, seeds, workers=arguments.workers, label=title)
        print_table(TITLES, (case_row(case, runs) for case, runs in results), widths=[36])


if __name__ == "__main__":
    main()
