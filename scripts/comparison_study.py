"""How often `calib compare` finds a drift, where there is none and where there is one: for docs/comparison.md.

A UR3 whose DH parameters err by 0.3 mm and 1 mrad is measured twice by a tracker of 0.05 mm noise a coordinate, which
stands elsewhere the second time; the target is mounted anew. In between nothing changes, or one joint's zero does.

    python scripts/comparison_study.py --trials 300 --workers 4
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial

import numpy as np
from rich.console import Console
from rich.progress import track
from scipy.spatial.transform import Rotation

from calib.calibration import Calibration, calibrate
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.example import PAPER_TARGET, paper_urdf
from calib.model.error_model import error_model
from calib.model.kinematics import Kinematics
from calib.result.comparison import ComparisonValues, compare
from calib.robot.robot import Robot


@dataclass(frozen=True)
class Case:
    """One set-up: what is wrong with the robot, how it is measured, what changes in between."""

    title: str
    rows: tuple[int, int] = (30, 30)
    noise: float = 5e-5
    span: float = 2.5
    frame: bool = True
    models: tuple[str, str] = ("dh", "dh")
    truth: str = "dh"
    size: float = 1.0
    same_poses: bool = False
    joint: str = ""
    drift: float = 0.0


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
DRIFTED = (
    *(
        Case(
            f"theta{joint} by 0.3 mrad, {rows} poses",
            rows=(rows, rows),
            joint=f"theta{joint}",
            drift=3e-4,
        )
        for rows in (30, 60)
        for joint in (1, 2, 3, 4, 5)
    ),
    Case("theta3, 60 poses, no errors", rows=(60, 60), size=0.0, joint="theta3", drift=3e-4),
    Case("theta1, frame known", frame=False, joint="theta1", drift=3e-4),
)
#: Where the progress is shown; tables go to stdout, each as soon as it is there.
BARS = Console(stderr=True)

HEAD = ("drift", "untold", "p < 0.05", "chi2/k", "rms mm", "noise mm")


def trial(case: Case, seed: int) -> ComparisonValues:
    """Measure twice, calibrate twice, compare."""
    rng = np.random.default_rng([2026, seed])
    robot = Robot.load(paper_urdf(), base="base", tip="tool0")
    errors = error_model(robot, case.truth, target=False)
    x = rng.normal(size=len(errors)) * np.where(np.array(errors.units) == "m", 3e-4, 1e-3)
    x *= case.size
    changed = x.copy()
    if case.joint:
        changed[errors.index(case.joint)] += case.drift
    results: list[Calibration] = []
    q = rng.uniform(-case.span, case.span, (case.rows[0], 6))
    for truth, count, model in zip((x, changed), case.rows, case.models, strict=True):
        if not case.same_poses:
            q = rng.uniform(-case.span, case.span, (count, 6))
        T_frame_base, T_tip_target = np.eye(4), np.eye(4)
        if case.frame:
            T_frame_base[:3, :3] = Rotation.random(random_state=rng).as_matrix()
            T_frame_base[:3, 3] = rng.uniform(-3.0, 3.0, 3)
        T_tip_target[:3, 3] = PAPER_TARGET + rng.normal(0.0, 0.02, 3)
        points = Kinematics(robot, errors, T_frame_base, T_tip_target).points(truth, q)
        points += rng.normal(0.0, case.noise, points.shape)
        table = Measurements(robot.joint_names, q, points)
        cell = Cell(estimate_frame=case.frame, model=model)
        results.append(calibrate(robot, table, cell=cell, validate=False))
    return compare(results[0], results[1])


def figures(case: Case, seed: int) -> tuple[float, ...]:
    """p, chi-square over combinations, outcome, rms and expected rms of the move."""
    c = trial(case, seed)
    move = c.moves[0]
    return (
        c.test.p,
        c.test.chi_square / max(c.test.combinations, 1),
        {"drift": 1.0, "no drift shown": 0.0, "cannot tell": -1.0}[c.outcome],
        move.rms,
        move.noise,
    )


def main() -> None:
    """Print a row for each case."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--trials", type=int, default=300)
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    with ProcessPoolExecutor(given.workers) as pool:
        for title, cases in (("Nothing changed", UNCHANGED), ("One joint's zero changed", DRIFTED)):
            print(f"\n{title}: {given.trials} trials each")
            print(f"{'':<44}" + "".join(f"{name:>11}" for name in HEAD))
            for case in cases:
                trials = pool.map(partial(figures, case), range(given.trials), chunksize=5)
                bar = track(trials, case.title, given.trials, console=BARS, transient=True)
                found = np.array(list(bar))
                p, chi, outcome, rms, noise = found.T
                numbers = (
                    np.mean(outcome == 1),
                    np.mean(outcome == -1),
                    np.mean(p < 0.05),
                    np.mean(chi),
                    1e3 * np.sqrt(np.mean(rms**2)),
                    1e3 * np.sqrt(np.mean(noise**2)),
                )
                print(f"{case.title:<44}" + "".join(f"{n:>11.3f}" for n in numbers), flush=True)


if __name__ == "__main__":
    main()
