"""Expected errors of compensated commands against true ones, over virtual cells; a part of compensation_study.py.

Cells are drawn one after the other from a seed, with the measurement frame known and estimated by turns. A tool is 100
to 200 mm from the nearest target; one target is estimated, or three are known. A third of the commands are made by the
geometry alone.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from arms import load_arm, without_masses
from scipy.special import chdtr
from studies import TYPICAL_ERRORS, add_noise, draw_seed, log_uniform, print_table, run_jobs

from calib.basics.arrays import Array
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.numerics.geometry import pose_of
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.robot.gravity import Payload
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.verbs.compensate.compensate import compensate
from calib.verbs.compensate.expected import mean_of_chi
from calib.verbs.compensate.robot_program import Program
from calib.verbs.simulate.truth import Truth, draw_truth

ARMS = ("ur3", "ur5", "ur10", "panda")

#: Models of the true robots' errors; real ones have errors in all placements more often than not.
TRUTHS = (
    "placement",
    "placement",
    "dh",
    "zeros",
    "dh+eccentricity",
    "placement+compliance",
    "placement+gain+eccentricity+compliance",
)

#: Three targets on a plate at the tip [m].
PLATE = {
    "a": np.array([0.06, 0.0, 0.05]),
    "b": np.array([-0.04, 0.06, 0.05]),
    "c": np.array([-0.04, -0.06, 0.08]),
}

#: Payload of the tip, which the fit does not know.
PAYLOAD = Payload(3.0, np.array([0.0, 0.0, 0.05]))

#: Range of the standard deviations of the errors over typical ones.
SIZES = (0.3, 2.0)

#: Range of the noise of a coordinate [m].
SIGMAS = (2e-5, 2e-4)

#: Smallest and largest number of measured poses.
POSES = (12, 60)

#: Range of the distance between the tool and the nearest target [m].
TOOL_DISTANCES = (0.1, 0.2)

#: Poses of a program.
PROGRAM = 200

#: Relative difference from the true error up to which an expected error counts as near.
NEAR = 0.2

TITLES = (
    "cells",
    "programs",
    "true mm",
    "expected/true",
    "within 20 %",
    "possible",
    "below half",
    "in range",
    "held-out/true",
)


@dataclass(frozen=True)
class VirtualCell:
    """A virtual cell and its calibration."""

    nominal: Robot
    truth: Truth
    result: Calibration
    T_tip_tool: Array  # shape (4, 4), [m]
    program: Array  # shape (PROGRAM, m), joint values of the nominal robot [rad]
    plate: bool  # Three known targets instead of one that is estimated
    geometry: bool  # Commands are made by the geometry alone


def draw_cell(seed: int) -> VirtualCell:
    """Draw a cell, measure and calibrate it; the noise is stated to the fit."""
    rng = np.random.default_rng([26, seed])
    plate = seed // 2 % 2 == 1
    robot = load_arm(str(rng.choice(ARMS)))
    true_model = str(rng.choice(TRUTHS))
    cell = Cell(
        estimate_frame=seed % 2 == 1, targets=PLATE if plate else {}, estimate_target=not plate
    )
    size = log_uniform(rng, *SIZES)
    poses = int(rng.integers(POSES[0], POSES[1] + 1))
    std = {family: size * typical for family, typical in TYPICAL_ERRORS.items()}
    truth = draw_truth(robot, true_model, std, seed, cell=replace(cell, payload=PAYLOAD))
    sigma = log_uniform(rng, *SIGMAS)
    table = measure(truth, poses, sigma, rng)
    given = robot if rng.integers(2) else without_masses(robot)
    result = calibrate(given, table, cell=replace(cell, sigma={"m": sigma}, scale_certified=True))
    direction = rng.normal(size=3)
    distance = rng.uniform(*TOOL_DISTANCES)
    away = distance * direction / np.linalg.norm(direction)
    T_tip_tool = pose_of(truth.stated_T_tip_target[0, :3, 3] + away)
    program = random_joint_values(robot, PROGRAM, draw_seed(rng))
    return VirtualCell(
        nominal=given,
        truth=truth,
        result=result,
        T_tip_tool=T_tip_tool,
        program=program,
        plate=plate,
        geometry=seed // 4 % 3 == 0,
    )


def measure(truth: Truth, poses: int, sigma: float, rng: np.random.Generator) -> Measurements:
    """Measure all targets of a robot at random poses.

    Args:
        truth: The robot and its targets.
        poses: Number of poses.
        sigma: Noise of a coordinate [m].
        rng: Random numbers.
    """
    robot = truth.nominal
    targets = truth.targets
    q = random_joint_values(robot, poses, draw_seed(rng))
    points = np.stack([truth.points(q, name) for name in targets], axis=1).reshape(-1, 3)
    return Measurements(
        robot.joint_names,
        np.repeat(q, len(targets), axis=0),
        add_noise(points, sigma, rng),
        targets=targets * poses,
    )


@dataclass(frozen=True)
class Outcome:
    """Expected and true error of the commands of a program."""

    groups: tuple[str, ...]  # Rows of the table that it belongs to
    true: float  # Mean error of the true robot [m]
    expected: float  # Expected mean error [m]
    band: tuple[float, float]  # Range of the mean error that is printed [m]
    freedom: float  # Degrees of freedom of the expected mean square
    held_out: float  # Mean held-out error [m]

    @property
    def ratio(self) -> float:
        """Expected over true error."""
        return self.expected / self.true

    @property
    def inside(self) -> bool:
        """True if the true error is within the printed range."""
        low, high = self.band
        return low <= self.true <= high

    @property
    def possible(self) -> float:
        """Probability of an expected error near the true one, if its distribution is exactly right."""
        quantiles = mean_of_chi(self.freedom) / np.array([1.0 - NEAR, 1.0 + NEAR])
        high, low = chdtr(self.freedom, quantiles**2)
        return float(high - low)


def cell_outcomes(seed: int) -> list[Outcome]:
    """Draw a cell and command programs in the base, and in the measurement frame where it was estimated."""
    cell = draw_cell(seed)
    setup = cell.result.part(non_geometric=not cell.geometry).setup
    poses = cell.nominal.poses(cell.program) @ cell.T_tip_tool
    in_base = Program.of_poses(poses, cell.program)
    if not cell.result.method.frame_estimated:
        return [command(cell, in_base, None, "frame known")]
    in_frame = Program.of_poses(setup.T_frame_base[0] @ poses, cell.program)
    return [
        command(cell, in_frame, "", "frame estimated, program in it"),
        command(cell, in_base, None, "frame estimated, program in base"),
    ]


def command(cell: VirtualCell, program: Program, frame: str | None, title: str) -> Outcome:
    """Compute the commands of a program, and where the true robot goes.

    Args:
        cell: The cell.
        program: The program.
        frame: Frame of the program: ``""`` for the estimated measurement frame, None for the base.
        title: Title of the frame's row in the table.
    """
    use_non_geometric = not cell.geometry
    commands = compensate(
        cell.result,
        program,
        nominal=cell.nominal,
        tool=cell.T_tip_tool,
        frame=frame,
        non_geometric=use_non_geometric,
    )
    validation = cell.result.part(non_geometric=use_non_geometric).cross_validation
    if commands.expected is None or validation is None:
        raise RuntimeError("The calibration has no held-out errors.")
    T_program_base = np.eye(4) if frame is None else cell.truth.T_frame_base[0]
    reached = commands.reached
    poses = T_program_base @ cell.truth.tip_poses(commands.q[reached]) @ cell.T_tip_tool
    misses = (poses - commands.T_wanted[reached])[:, :3, 3]
    targets = "three known targets" if cell.plate else "one target"
    groups = [title, f"{title}, {targets}"]
    if cell.geometry and cell.result.non_geometric is not None:
        groups.append(f"{title}, {targets}, model lacks families")
    return Outcome(
        groups=tuple(groups),
        true=float(np.linalg.norm(misses, axis=1).mean()),
        expected=commands.expected.mean,
        band=commands.expected.band,
        freedom=commands.expected.freedom,
        held_out=validation.errors_without_outliers["m"].mean,
    )


def group_row(title: str, outcomes: Sequence[Outcome]) -> list[str]:
    """Return the row of a group of programs."""
    count = len(outcomes)
    true = sum(outcome.true for outcome in outcomes)
    expected = sum(outcome.expected for outcome in outcomes)
    held_out = sum(outcome.held_out for outcome in outcomes)
    ratios = np.array([outcome.ratio for outcome in outcomes])
    possible = np.mean([outcome.possible for outcome in outcomes])
    inside = np.mean([outcome.inside for outcome in outcomes])
    return [
        title,
        str(count),
        f"{1e3 * true / count:.3f}",
        f"{expected / true:.2f}",
        f"{100 * np.mean(np.abs(ratios - 1.0) < NEAR):.0f} %",
        f"{100 * possible:.0f} %",
        str(np.sum(ratios < 0.5)),
        f"{100 * inside:.0f} %",
        f"{held_out / true:.2f}",
    ]


def group_rows(results: Iterator[list[Outcome]]) -> Iterator[list[str]]:
    """Yield a row for each group of programs."""
    groups = defaultdict(list)
    for outcomes in results:
        for outcome in outcomes:
            for title in outcome.groups:
                groups[title].append(outcome)
    for title in sorted(groups):
        yield group_row(title, groups[title])


def print_cells(count: int, seed: int, workers: int) -> None:
    """Print the table of expected and true errors.

    Args:
        count: Number of virtual cells.
        seed: Seed of the first one; the next have the next numbers.
        workers: Number of processes.
    """
    seeds = [(number,) for number in range(seed, seed + count)]
    print(f"{count} virtual cells from seed {seed}: mean error of {PROGRAM} poses\n", flush=True)
    results = run_jobs(cell_outcomes, seeds, workers=workers, label="cells")
    print_table(TITLES, group_rows(results), [44])
