"""Poses that compensated commands reach: the figures of docs/compensation.md.

    python scripts/compensation_study.py
    python scripts/compensation_study.py --cells 200 --seed 1000

A robot with known errors is given the commands that calib computes. Its own forward kinematics tells how far it is from
the program; where poses are sent, after the inverse kinematics of a controller with the nominal model. The paper's rows
31 to 35 are evaluated with a model fitted to all 35.

With --cells, expected errors of commands against true ones (compensation_cells.py).
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from arms import load_arm
from compensation_cells import print_cells
from numpy.typing import NDArray
from studies import print_table, study_parser

from calib.basics.arrays import Array, read_only
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.example import PAPER_TARGET, paper_measurements, paper_urdf
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.robot.ranges import column_limits, random_joint_values
from calib.robot.robot import Robot
from calib.verbs.compensate.commands import Commands
from calib.verbs.compensate.compensate import compensate
from calib.verbs.compensate.inverse import Matching, solve
from calib.verbs.compensate.nominal_actual import Arm
from calib.verbs.compensate.robot_program import Program
from calib.verbs.simulate.scenario import Scenario

#: Whole poses are matched; the length that weighs angles is 0.01 m.
POSE = Matching("pose", 0.01)

#: First joint values of the straight path [rad].
START = np.radians([-20.0, -80.0, 60.0, -70.0, -90.0, 10.0])

#: The straight path, from its first point to its last [m].
PATH = np.array([0.1, 0.15, -0.05])


def paper_calibration() -> Calibration:
    """Calibrate the paper's UR3, as the demo does."""
    robot = Robot.load(paper_urdf(), base="base", tip="tool0")
    table = Measurements.read(paper_measurements(), robot.joint_names)
    return calibrate(
        robot, table, cell=Cell(target=read_only(PAPER_TARGET), model="paper", instrument="tracker")
    )


def panda_calibration() -> Calibration:
    """Draw a Panda's errors, measure it at 60 poses by a tracker and calibrate it."""
    robot = load_arm("panda")
    scenario = Scenario(robot, Cell(model="dh"), model="dh")
    q = scenario.random_poses(60, 3)
    table = scenario.draw(3).measure(q, 3, ("estimate",) * 60).measurements
    return calibrate(robot, table, cell=scenario.cell, validate=False)


def warned(commands: Commands, code: str) -> NDArray[np.bool_]:
    """Return for each row if its command has a warning with a code."""
    return np.array([any(w.code == code for w in warnings) for warnings in commands.warnings])


def sent_to_controller(nominal: Robot, commands: Commands, rows: NDArray[np.bool_]) -> Array:
    """Return the joint values that a controller's inverse kinematics makes of the poses of some rows.

    Args:
        nominal: The robot as the controller has it.
        commands: The commands, whose poses are sent.
        rows: shape (N,), rows to send.

    Returns:
        shape (rows, m), [rad].
    """
    arm = Arm.of(nominal, np.eye(4))
    limits = column_limits(nominal)
    return solve(arm, commands.T_send[rows], commands.q_nominal[rows], POSE, limits).q


def misses_row(title: str, misses: Array) -> list[str]:
    """Return a row of the mean and largest of misses, shape (N, 2), [m] and [rad]."""
    mean = misses.mean(axis=0)
    worst = misses.max(axis=0)
    return [
        title,
        str(len(misses)),
        f"{mean[0]:.2e} m, {mean[1]:.2e} rad",
        f"{worst[0]:.2e} m, {worst[1]:.2e} rad",
    ]


def random_rows(result: Calibration, q: Array, commands: Commands) -> Iterator[list[str]]:
    """Yield the misses of poses without correction, with commands as joint values, and with poses sent.

    Args:
        result: The calibration; the true robot is its corrected one.
        q: shape (N, m), joint values of the nominal robot [rad].
        commands: Their commands.
    """
    nominal, true = result.nominal, result.robot
    poses = nominal.poses(q)
    reached = commands.reached
    sendable = reached & ~warned(commands, "ambiguous pose")
    sent = sent_to_controller(nominal, commands, sendable)
    by_joints = POSE.misses(true.poses(commands.q[reached]), poses[reached])
    yield misses_row("without correction", POSE.misses(true.poses(q), poses))
    yield misses_row("joint values", by_joints)
    yield misses_row("poses to a controller", POSE.misses(true.poses(sent), poses[sendable]))


def print_random(title: str, result: Calibration, count: int, seed: int) -> None:
    """Command random poses as joint values, and as poses to a controller with the nominal model.

    Args:
        title: Title of the table.
        result: The calibration.
        count: Number of poses.
        seed: Of the random numbers.
    """
    q = random_joint_values(result.nominal, count, seed)
    began = time.perf_counter()
    commands = compensate(result, Program.of_joints(q))
    seconds = time.perf_counter() - began
    print(f"\n{title}: {seconds:.2f} s\n")
    titles = ["commands", "poses", "mean", "largest"]
    print_table(titles, random_rows(result, q, commands), [21])
    reached = commands.reached
    ambiguous = reached & warned(commands, "ambiguous pose")
    with_reason = all(commands.reasons[row] for row in np.flatnonzero(~reached))
    near_singularity = reached & warned(commands, "near singularity")
    print(f"\nwarned that poses may go astray: {ambiguous.sum()}")
    print(f"without command: {(~reached).sum()}, each with its reason: {with_reason}")
    print(f"near a singularity: {near_singularity.sum()}")


def paper_rows(result: Calibration) -> Iterator[list[str]]:
    """Yield errors of commands for the points of rows 31 to 35, with a model fitted to all 35 rows."""
    table, robot = result.fit.measurements, result.nominal
    all_rows = replace(table, sets=("estimate",) * len(table))
    reference = calibrate(robot, all_rows, cell=result.fit.cell, validate=False)
    points = table.points[table.validation]
    q = table.joints_for(robot.joint_names)[table.validation]
    commands = compensate(result, Program.of_points(points, q), tool="", frame="")
    for title, values in (("nominal", commands.q_nominal), ("compensated", commands.q)):
        miss = 1e3 * np.linalg.norm(reference.predict(values) - points, axis=1)
        yield [title, f"{miss.mean():.3f}", f"{miss.max():.3f}"]


def print_path(result: Calibration, count: int) -> None:
    """Command a straight path, given as poses alone and as joint values.

    Args:
        result: The calibration.
        count: Number of points.
    """
    robot = result.nominal
    path = np.tile(robot.poses(START)[0], (count, 1, 1))
    path[:, :3, 3] += np.linspace(0.0, 1.0, count)[:, None] * PATH
    start = dict(zip(robot.joint_names, START.tolist(), strict=True))
    program = replace(Program.of_poses(path), start=start)
    began = time.perf_counter()
    commands = compensate(result, program)
    by_poses = time.perf_counter() - began
    began = time.perf_counter()
    compensate(result, Program.of_joints(commands.q_nominal))
    by_joints = time.perf_counter() - began

    def largest_step(q: Array) -> float:
        """Return the largest step of a joint between points [deg]."""
        return float(np.degrees(np.abs(np.diff(q, axis=0)).max()))

    length = 1e3 * np.linalg.norm(PATH)
    print(
        f"\nA straight path of {count} points, {length:.0f} mm, {commands.reached.sum()} with commands\n"
    )
    print(f"largest step of a joint, nominal: {largest_step(commands.q_nominal):.5f} deg")
    print(f"largest step of a joint, compensated: {largest_step(commands.q):.5f} deg")
    print(f"given as poses {by_poses:.2f} s, as joint values {by_joints:.2f} s")


def main() -> None:
    """Print the tables."""
    parser = study_parser(__doc__, parallel=True)
    parser.add_argument("--poses", type=int, default=1000, help="random poses of each robot")
    parser.add_argument("--points", type=int, default=2000, help="points of the straight path")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cells", type=int, default=0, help="virtual cells, and nothing else")
    arguments = parser.parse_args()
    poses, seed = arguments.poses, arguments.seed
    if arguments.cells:
        print_cells(arguments.cells, seed, arguments.workers)
        return
    paper = paper_calibration()
    print(f"{poses} random joint values between the limits, poses of the tip", flush=True)
    print_random("UR3, the paper's data", paper, poses, seed)
    print_random("Panda, simulated", panda_calibration(), poses, seed)
    print("\nThe paper's rows 31 to 35, evaluated with a fit of all 35 rows [mm]\n")
    print_table(["commands", "mean", "largest"], paper_rows(paper), [11])
    print_path(paper, arguments.points)


if __name__ == "__main__":
    main()
