"""What compensated commands reach: for docs/compensation.md.

A robot whose errors are known takes the commands that calib computes; how far it then is from what was wanted is
counted by its own forward kinematics, and where poses are sent, after the inverse kinematics of a controller that keeps
the nominal model. The paper's rows 31 to 35 are judged by a model that was fitted to all 35.

    python scripts/compensation_study.py
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track

from calib.calibration import Calibration, calibrate
from calib.compensation.commands import Commands, compensate
from calib.compensation.inverse import Matching, solve
from calib.compensation.nominal_actual import Arm
from calib.compensation.program import Program
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.example import PAPER_TARGET, paper_measurements, paper_urdf
from calib.robot.readback import column_limits, random_joint_values
from calib.robot.robot import Robot, read_only
from calib.simulation.scenario import Scenario

Array = NDArray[np.float64]

POSE = Matching("pose", 0.01)

#: Where the straight path begins [rad].
START = np.radians([-20.0, -80.0, 60.0, -70.0, -90.0, 10.0])


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--poses", type=int, default=1000, help="Random poses of each robot.")
    parser.add_argument("--points", type=int, default=2000, help="Points of the straight path.")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    paper = paper_calibration()
    print(f"{arguments.poses} random joint values between the limits, poses of the tip", flush=True)
    tables: list[Callable[[], None]] = [
        lambda: print_random("UR3, the paper's data", paper, arguments.poses, arguments.seed),
        lambda: print_random(
            "Panda, simulated", panda_calibration(), arguments.poses, arguments.seed
        ),
        lambda: print_paper(paper),
        lambda: print_path(paper, arguments.points),
    ]
    for table in track(tables, "tables", console=Console(stderr=True), transient=True):
        table()


def paper_calibration() -> Calibration:
    """The demo's."""
    robot = Robot.load(paper_urdf(), base="base", tip="tool0")
    table = Measurements.read(paper_measurements(), robot.joint_names)
    return calibrate(robot, table, cell=Cell(target=read_only(PAPER_TARGET), model="paper"))


def panda_calibration() -> Calibration:
    """A Panda whose errors are drawn, measured at 60 poses by a tracker."""
    robot = Robot.load("panda", base="panda_link0", tip="panda_link8")
    scenario = Scenario(robot, Cell(model="dh"), model="dh")
    q = scenario.random_poses(60, 3)
    found = scenario.draw(3).measure(q, 3, ("estimate",) * 60).measurements
    return calibrate(robot, found, cell=scenario.cell, validate=False)


def print_random(title: str, result: Calibration, count: int, seed: int) -> None:
    """Both modes at random poses: joint values, and poses sent to a controller with the nominal model."""
    nominal, true = result.nominal, result.robot
    q = random_joint_values(nominal, count, seed)
    begun = time.perf_counter()
    found = compensate(result, Program.of_joints(q))
    seconds = time.perf_counter() - begun
    wanted = nominal.poses(q)
    before = POSE.misses(true.poses(q), wanted)
    reached = found.reached
    by_joints = POSE.misses(true.poses(found.q[reached]), wanted[reached])
    near = np.array([any(w.code == "near singularity" for w in said) for said in found.warnings])
    plain = reached & np.array(
        [not any(w.code == "ambiguous pose" for w in said) for said in found.warnings]
    )
    sent = sent_to_controller(nominal, found, plain)
    by_poses = POSE.misses(true.poses(sent), wanted[plain])
    named = all(found.reasons[i] for i in np.flatnonzero(~reached))
    print(f"\n{title}: {seconds:.2f} s")
    print(f"  without correction    {figures(before)}")
    print(f"  joint values          {figures(by_joints)}   {reached.sum()} poses")
    print(f"  poses to a controller {figures(by_poses)}   {plain.sum()} poses")
    warned = reached & np.array(
        [any(w.code == "ambiguous pose" for w in s) for s in found.warnings]
    )
    print(f"  warned that poses may go astray: {warned.sum()}")
    print(f"  without command: {(~reached).sum()}, each with its reason: {named}")
    print(f"  near a singularity: {(near & reached).sum()}")


def sent_to_controller(nominal: Robot, found: Commands, rows: NDArray[np.bool_]) -> Array:
    """What the controller's own inverse kinematics makes of the poses that are sent."""
    believed = Arm.of(nominal, np.eye(4))
    limits = column_limits(nominal)
    return solve(believed, found.T_send[rows], found.q_nominal[rows], POSE, limits).q


def figures(misses: Array) -> str:
    """Mean and largest distance and angle."""
    mean, worst = misses.mean(axis=0), misses.max(axis=0)
    return f"mean {mean[0]:.2e} m {mean[1]:.2e} rad, max {worst[0]:.2e} m {worst[1]:.2e} rad"


def print_paper(result: Calibration) -> None:
    """Commands for the measured points of rows 31 to 35."""
    table, robot = result.measurements, result.nominal
    everything = replace(table, sets=("estimate",) * len(table))
    judge = calibrate(robot, everything, cell=result.cell, validate=False)
    rows = table.validation
    points, q = table.points[rows], table.joints_for(robot.joint_names)[rows]
    found = compensate(result, Program.of_points(points, q), tool="", frame="")
    print("\nThe paper's rows 31 to 35, judged by a fit of all 35 rows [mm]")
    for name, values in (("nominal", found.q_nominal), ("compensated", found.q)):
        miss = 1e3 * np.linalg.norm(judge.predict(values) - points, axis=1)
        print(f"  {name:<12} mean {miss.mean():.3f}  max {miss.max():.3f}")


def print_path(result: Calibration, count: int) -> None:
    """A straight path, given as poses alone and as joint values."""
    robot = result.nominal
    path = np.tile(robot.poses(START)[0], (count, 1, 1))
    path[:, :3, 3] += np.linspace(0.0, 1.0, count)[:, None] * [0.1, 0.15, -0.05]
    start = dict(zip(robot.joint_names, START.tolist(), strict=True))
    begun = time.perf_counter()
    found = compensate(result, replace(Program.of_poses(path), start=start))
    by_poses = time.perf_counter() - begun
    begun = time.perf_counter()
    compensate(result, Program.of_joints(found.q_nominal))
    by_joints = time.perf_counter() - begun
    jumps = [np.degrees(np.abs(np.diff(q, axis=0)).max()) for q in (found.q_nominal, found.q)]
    print(f"\nA straight path of {count} points, 190 mm, {found.reached.sum()} with commands")
    print(f"  largest step of a joint: nominal {jumps[0]:.5f} deg, compensated {jumps[1]:.5f} deg")
    print(f"  given as poses {by_poses:.2f} s, as joint values {by_joints:.2f} s")


if __name__ == "__main__":
    main()
