"""How well an acceptance test tells a robot's accuracy: for docs/acceptance.md.

What registering a target or a frame to the judged rows takes away, what few repeats make of RP, and what noise makes of
AP. A UR3, poses anywhere within its joint limits.

    python scripts/acceptance_study.py --trials 300
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.example import PAPER_TARGET, paper_urdf
from calib.model.error_model import error_model
from calib.model.kinematics import Kinematics
from calib.result.evaluation import Accuracy, accuracy, evaluate
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot

Array = NDArray[np.float64]

#: Where the progress is shown; tables go to stdout, each as soon as it is there.
BARS = Console(stderr=True)

#: What is registered to the rows, with what is known else.
CELLS = {
    "target": Cell(),
    "frame": Cell(target=np.array(PAPER_TARGET), estimate_target=False, estimate_frame=True),
    "target and frame": Cell(estimate_frame=True),
}
KNOWN = Cell(target=np.array(PAPER_TARGET), estimate_target=False)


def judged(robot: Robot, q: Array, points: Array, cell: Cell) -> Accuracy:
    """The accuracy of a robot that puts its target at these points."""
    return accuracy(evaluate(robot, Measurements(robot.joint_names, q, points), cell))


def registering(robot: Robot, trials: int, rng: np.random.Generator) -> None:
    """The largest AP after registering, over the true one: as it is, and with the factor."""
    T_tip_target = np.eye(4)
    T_tip_target[:3, 3] = PAPER_TARGET
    model = error_model(robot, "placement", target=False)
    kinematics = Kinematics(robot, model, np.eye(4), T_tip_target)
    sizes = np.where([unit == "m" for unit in model.units], 5e-5, 1e-4)

    def of_robot(q: Array) -> Array:
        return kinematics.points(sizes * rng.normal(size=len(sizes)), q)

    def of_chance(q: Array) -> Array:
        return kinematics.points(np.zeros(len(sizes)), q) + 1e-4 * rng.normal(size=(len(q), 3))

    errors: dict[str, Callable[[Array], Array]] = {"random": of_chance, "robot": of_robot}
    print(f"{'registered':<18}{'poses':>6}" + "".join(f"{f'{e} errors':>24}" for e in errors))
    for what, cell in CELLS.items():
        for count in (5, 10, 20, 50):
            line = f"{what:<18}{count:>6}"
            for draw in errors.values():
                shares = []
                bar = track(range(trials), line.strip(), console=BARS, transient=True)
                for _ in bar:
                    q = random_joint_values(robot, count, int(rng.integers(2**31)))
                    points = draw(q)
                    true = judged(robot, q, points, KNOWN).of("ap").max()
                    found = judged(robot, q, points, cell)
                    shares.append(np.array([1.0, found.factor]) * found.of("ap").max() / true)
                bare, mended = np.mean(shares, axis=0)
                line += f"{bare:>16.2f}{mended:>8.2f}"
            print(line, flush=True)


def repeating(trials: int, rng: np.random.Generator) -> None:
    """RP of few repeats, and the mean AP of an error and noise, in units of the scatter of one coordinate."""
    print("\nrepeats        RP    spread     AP of an error of 0, 1, 3, 10")
    for repeats in (1, 3, 5, 10, 30, 100):
        e = rng.normal(size=(100 * trials, repeats, 3))
        mean = e.mean(axis=1)
        away = np.linalg.norm(e - mean[:, None], axis=2)
        rp = (
            away.mean(axis=1) + 3.0 * away.std(axis=1, ddof=1)
            if repeats > 1
            else np.full(1, np.nan)
        )
        sizes = [
            float(np.linalg.norm(mean + np.array([error, 0.0, 0.0]), axis=1).mean())
            for error in (0.0, 1.0, 3.0, 10.0)
        ]
        told = "".join(f"{size:>8.2f}" for size in sizes)
        print(f"{repeats:>7}{rp.mean():>10.2f}{rp.std():>10.2f}   {told}")


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    rng = np.random.default_rng(given.seed)
    registering(Robot.load(paper_urdf(), base="base", tip="tool0"), given.trials, rng)
    repeating(given.trials, rng)


if __name__ == "__main__":
    main()
