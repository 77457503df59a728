"""What compensated commands reach: for docs/compensation.md.

A robot whose errors are known takes the commands that calib computes; how far it then is from what was wanted is
counted by its own forward kinematics, and where poses are sent, after the inverse kinematics of a controller that keeps
the nominal model. The paper's rows 31 to 35 are judged by a model that was fitted to all 35.

With --cells, what is expected of commands against what the true robot does: virtual cells, drawn one after the other
from a seed, frame known and estimated by turns; a tool 100 to 200 mm from the nearest target; one target whose place is
estimated, or three that are known. A third of the commands are made by the geometry alone.

    python scripts/compensation_study.py
    python scripts/compensation_study.py --cells 200 --seed 1000
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from scipy.special import chdtr
from selection_study import without_masses

from calib.calibration import Calibration, calibrate
from calib.compensation.commands import Commands, compensate
from calib.compensation.expected import ExpectedErrors, mean_of_chi
from calib.compensation.inverse import Matching, solve
from calib.compensation.nominal_actual import Arm
from calib.compensation.program import Program
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.example import PAPER_TARGET, paper_measurements, paper_urdf
from calib.robot.payload import Payload
from calib.robot.ranges import column_limits, random_joint_values
from calib.robot.robot import Robot, read_only
from calib.simulation.scenario import Scenario
from calib.simulation.truth import Truth, draw_truth

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
    parser.add_argument("--cells", type=int, default=0, help="Virtual cells; none of the others.")
    arguments = parser.parse_args()
    if arguments.cells:
        print_cells(arguments.cells, arguments.seed)
        return
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


# What is expected of commands, against what the true robot does.

ARMS = {
    "ur3": ("base", "tool0"),
    "ur5": ("base_link", "tool0"),
    "ur10": ("base_link", "tool0"),
    "panda": ("panda_link0", "panda_link8"),
}

#: What is wrong with the true robots; real ones have errors in all placements more often than not.
TRUTHS = (
    *("placement", "placement", "dh", "zeros", "dh+eccentricity"),
    *("placement+compliance", "placement+gain+eccentricity+compliance"),
)

#: Standard deviations of the errors, before a cell's own factor.
SIZES = {
    "length": 0.3e-3,
    "angle": 3e-3,
    "zero": 5e-3,
    "gain": 5e-4,
    "eccentricity": 0.5e-3,
    "compliance": 2e-5,
}

#: Three targets on a plate at the tip [m].
PLATE = {"a": (0.06, 0.0, 0.05), "b": (-0.04, 0.06, 0.05), "c": (-0.04, -0.06, 0.08)}

#: Poses of a program, and how far an expected error may be from the true one.
PROGRAM, NEAR = 200, 0.2

#: What the tip carries: the fit does not know it [kg].
CARRIED = 3.0


@dataclass(frozen=True)
class Drawn:
    """One virtual cell and its calibration."""

    nominal: Robot
    truth: Truth
    result: Calibration
    T_tip_tool: Array
    program: Array  # Joint values of the nominal robot, shape (PROGRAM, m)
    plate: bool  # Three known targets, not one that is estimated
    geometry: bool  # Commands by the geometry alone


@dataclass(frozen=True)
class Outcome:
    """What was expected of a program, and what came of it."""

    group: tuple[str, ...]  # Rows of the table that it belongs to
    true: float  # Mean error of the true robot [m]
    expected: ExpectedErrors
    held_out: float  # Mean error on held-out rows, which was promised before [m]

    @property
    def ratio(self) -> float:
        """Expected over true."""
        return self.expected.mean / self.true

    @property
    def inside(self) -> bool:
        """Whether the true error is within the range that is told."""
        low, high = self.expected.band
        return low <= self.true <= high

    @property
    def possible(self) -> float:
        """Probability of an expected error within `NEAR` of the true one, if its distribution is exactly right."""
        n = self.expected.freedom
        near = (mean_of_chi(n) / np.array([1.0 - NEAR, 1.0 + NEAR])) ** 2
        return float(chdtr(n, near[0]) - chdtr(n, near[1]))


def print_cells(count: int, seed: int) -> None:
    """The table of expected and true errors, by groups of cells."""
    groups = defaultdict(list)
    cells = range(seed, seed + count)
    for number in track(cells, "cells", console=Console(stderr=True), transient=True):
        for outcome in outcomes(drawn(number)):
            for name in outcome.group:
                groups[name].append(outcome)
    print(
        f"{count} virtual cells from seed {seed}: expected over true mean error of {PROGRAM} poses\n"
        f"{'':44}programs  true mm  expected/true  within 20 %  possible  below half  in range  held-out/true"
    )
    for name in sorted(groups):
        print(f"{name:44}{figures_of(groups[name])}")


def figures_of(found: Sequence[Outcome]) -> str:
    """One line of the table."""
    true = sum(one.true for one in found)
    ratios = np.array([one.ratio for one in found])
    near = np.mean(np.abs(ratios - 1.0) < NEAR)
    possible = np.mean([one.possible for one in found])
    inside = np.mean([one.inside for one in found])
    return (
        f"{len(found):8}{1e3 * true / len(found):9.3f}"
        f"{sum(one.expected.mean for one in found) / true:15.2f}{100 * near:11.0f} %{100 * possible:8.0f} %"
        f"{np.sum(ratios < 0.5):12}{100 * inside:8.0f} %{sum(one.held_out for one in found) / true:15.2f}"
    )


def outcomes(cell: Drawn) -> Iterator[Outcome]:
    """The program in the base, and in the measurement frame where that was estimated."""
    setup = cell.result.part(non_geometric=not cell.geometry).setup
    targets = "three known targets" if cell.plate else "one target"
    wanted = cell.nominal.poses(cell.program) @ cell.T_tip_tool
    lacks = cell.geometry and cell.result.non_geometric is not None
    programs: list[tuple[str, Program, str | None, Array]] = []
    if cell.result.frame_estimated:
        in_frame = Program.of_poses(setup.T_frame_base[0] @ wanted, cell.program)
        programs.append(("estimated, program in it", in_frame, "", cell.truth.T_frame_base[0]))
    where = "estimated, program in base" if cell.result.frame_estimated else "known"
    programs.append((where, Program.of_poses(wanted, cell.program), None, np.eye(4)))
    for name, program, frame, T in programs:
        group = [f"frame {name}, {targets}", f"frame {name}"]
        group += [f"frame {name}, {targets}, model lacks families"] * lacks
        yield outcome(cell, program, frame, T, tuple(group))


def outcome(
    cell: Drawn, program: Program, frame: str | None, T: Array, group: tuple[str, ...]
) -> Outcome:
    """Commands of one program, and where the true robot goes; T: the true pose of the base in the program's frame."""
    result, non_geometric = cell.result, not cell.geometry
    commands = compensate(
        result,
        program,
        nominal=cell.nominal,
        tool=cell.T_tip_tool,
        frame=frame,
        non_geometric=non_geometric,
    )
    assert commands.expected is not None
    reached = commands.reached
    arrived = T @ cell.truth.tip_poses(commands.q[reached]) @ cell.T_tip_tool
    missed = (arrived - commands.T_wanted[reached])[:, :3, 3]
    crossed = result.part(non_geometric=non_geometric).cross_validation
    assert crossed is not None
    true = float(np.linalg.norm(missed, axis=1).mean())
    return Outcome(group, true, commands.expected, crossed.errors_without_outliers.mean)


def drawn(seed: int) -> Drawn:
    """One virtual cell, measured and calibrated; the noise is stated to the fit."""
    rng = np.random.default_rng([26, seed])
    free, plate, geometry = bool(seed % 2), bool(seed // 2 % 2), seed // 4 % 3 == 0
    arm, model = str(rng.choice(list(ARMS))), str(rng.choice(TRUTHS))
    robot = Robot.load(arm, *ARMS[arm])
    places = {name: np.array(place) for name, place in PLATE.items()} if plate else {}
    told = Cell(estimate_frame=free, targets=places, estimate_target=not plate)
    carried = Payload(CARRIED, np.array([0.0, 0.0, 0.05]))
    factor, rows = float(np.exp(rng.uniform(np.log(0.3), np.log(2.0)))), int(rng.integers(12, 61))
    sizes = {family: factor * size for family, size in SIZES.items()}
    truth = draw_truth(robot, model, sizes, seed, cell=replace(told, payload=carried))
    sigma = float(np.exp(rng.uniform(np.log(2e-5), np.log(2e-4))))
    q = random_joint_values(robot, rows, int(rng.integers(10**6)))
    names = truth.targets
    points = np.stack([truth.points(q, name) for name in names], axis=1).reshape(-1, 3)
    table = Measurements(
        robot.joint_names,
        np.repeat(q, len(names), axis=0),
        points + sigma * rng.normal(size=points.shape),
        targets=names * rows,
    )
    known = robot if rng.integers(2) else without_masses(robot)
    result = calibrate(known, table, cell=replace(told, sigma=sigma))
    direction = rng.normal(size=3)
    tool = np.eye(4)
    away = rng.uniform(0.1, 0.2) * direction / np.linalg.norm(direction)
    tool[:3, 3] = truth.said_T_tip_target[0, :3, 3] + away
    program = random_joint_values(robot, PROGRAM, int(rng.integers(10**6)))
    return Drawn(known, truth, result, tool, program, plate, geometry)


if __name__ == "__main__":
    main()
