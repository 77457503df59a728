"""How far an acceptance test is from the true accuracy of a robot: the figures of docs/acceptance.md.

    python scripts/acceptance_study.py --trials 300

The first table shows what it does to AP to register a target or a frame to the evaluated rows, the second how few
repeats change RP and how noise changes AP. The robot is a UR3, at poses anywhere within its joint limits.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from studies import add_noise, draw_errors, print_table, show_progress, study_parser

from calib.basics.arrays import Array
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.example import PAPER_TARGET, paper_urdf
from calib.model.kinematics import Kinematics
from calib.model.parameter_sets import error_model
from calib.numerics.geometry import pose_of
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.verbs.evaluate.accuracy import Accuracy, accuracy
from calib.verbs.evaluate.evaluation import evaluate

#: Points that a robot reaches at joint values, shape (N, m), with errors from random numbers: shape (N, 3), [m].
DrawPoints = Callable[[Kinematics, Array, np.random.Generator], Array]

#: Nothing is registered: target and frame are given.
GIVEN = Cell(target=np.array(PAPER_TARGET), estimate_target=False)

#: Cells of an evaluation by what it registers to its own rows.
REGISTERING = {
    "target": Cell(),
    "frame": Cell(target=np.array(PAPER_TARGET), estimate_target=False, estimate_frame=True),
    "target and frame": Cell(estimate_frame=True),
}

#: Numbers of evaluated poses.
COUNTS = (5, 10, 20, 50)

#: Numbers of repeats of one pose.
REPEATS = (1, 3, 5, 10, 30, 100)

#: Constant errors of a pose, over the standard deviation of one coordinate's scatter.
CONSTANT_ERRORS = (0.0, 1.0, 3.0, 10.0)


def points_with_random_errors(kinematics: Kinematics, q: Array, rng: np.random.Generator) -> Array:
    """Draw points of a robot whose errors, 0.1 mm a coordinate, are independent at each pose."""
    right = np.zeros(len(kinematics.model))
    return add_noise(kinematics.points(right, q), 1e-4, rng)


def points_with_robot_errors(kinematics: Kinematics, q: Array, rng: np.random.Generator) -> Array:
    """Draw points of a robot with errors of 0.05 mm and 0.1 mrad in all placements."""
    return kinematics.points(draw_errors(kinematics.model, 5e-5, 1e-4, rng), q)


def accuracy_of(robot: Robot, q: Array, points: Array, cell: Cell) -> Accuracy:
    """Return the accuracy that an evaluation finds of points, shape (N, 3), [m], at joint values q."""
    return accuracy(evaluate(robot, Measurements(robot.joint_names, q, points), cell))


def ap_ratios(
    kinematics: Kinematics, draw: DrawPoints, cell: Cell, count: int, rng: np.random.Generator
) -> tuple[float, float]:
    """Return the largest AP after registration over the true one, of one draw.

    Args:
        kinematics: The robot, with target and frame where they truly are.
        draw: Draws the points.
        cell: States what is registered.
        count: Number of poses.
        rng: Random numbers.

    Returns:
        The ratio as evaluated, and with the factor that corrects for registration.
    """
    robot = kinematics.robot
    q = random_joint_values(robot, count, int(rng.integers(2**31)))
    points = draw(kinematics, q, rng)
    true = accuracy_of(robot, q, points, GIVEN).of("ap", "m").max()
    registered = accuracy_of(robot, q, points, cell)
    ap = registered.of("ap", "m").max()
    return ap / true, registered.factor * ap / true


def registration_rows(trials: int, rng: np.random.Generator) -> Iterator[list[str]]:
    """Yield mean ratios of AP for each registration and number of poses."""
    robot = Robot.load(paper_urdf(), base="base", tip="tool0")
    model = error_model(robot, "placement", target=False)
    kinematics = Kinematics(robot, model, np.eye(4), pose_of(PAPER_TARGET))
    for name, cell in REGISTERING.items():
        for count in COUNTS:
            row = [name, str(count)]
            for draw in (points_with_random_errors, points_with_robot_errors):
                ratios = [
                    ap_ratios(kinematics, draw, cell, count, rng)
                    for _ in show_progress(range(trials), f"{name}, {count} poses")
                ]
                row += [f"{mean:.2f}" for mean in np.mean(ratios, axis=0)]
            yield row


def repeat_rows(trials: int, rng: np.random.Generator) -> Iterator[list[str]]:
    """Yield RP and its scatter, and mean AP with each constant error, for numbers of repeats."""
    for repeats in REPEATS:
        points = rng.normal(size=(100 * trials, repeats, 3))
        mean = points.mean(axis=1)
        distance = np.linalg.norm(points - mean[:, None], axis=2)
        rp = np.full(1, np.nan)
        if repeats > 1:
            rp = distance.mean(axis=1) + 3.0 * distance.std(axis=1, ddof=1)
        row = [str(repeats), f"{rp.mean():.2f}", f"{rp.std():.2f}"]
        for error in CONSTANT_ERRORS:
            ap = np.linalg.norm(mean + np.array([error, 0.0, 0.0]), axis=1)
            row.append(f"{ap.mean():.2f}")
        yield row


def main() -> None:
    """Print the tables."""
    parser = study_parser(__doc__)
    parser.add_argument("--trials", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    rng = np.random.default_rng(arguments.seed)
    print("Largest AP after registration over the true one\n")
    titles = ["registered", "poses", "random errors", "with the factor"]
    titles += ["errors of the robot", "with the factor"]
    print_table(titles, registration_rows(arguments.trials, rng), widths=[16])
    print(
        "\nRP of few repeats, and mean AP with a constant error, over the scatter of one coordinate\n"
    )
    titles = ["repeats", "RP", "std of RP"]
    titles += [f"AP, error {error:g}" for error in CONSTANT_ERRORS]
    print_table(titles, repeat_rows(arguments.trials, rng))


if __name__ == "__main__":
    main()
