"""What planned poses are worth: the figures of docs/planning.md, on the paper's UR3 with virtual measurements.

    python scripts/planning_study.py            # all of it, a few minutes
    python scripts/planning_study.py --quick    # fewer trials and candidates, for a look

Model: DH with Hayati's beta, one target, measurement frame known. The noise of one coordinate is that of a laser
tracker 3 m away and of the robot's repeatability.
"""

from __future__ import annotations

import argparse
import os
import resource
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track

from calib.data.cell import Box, Cell, Reflector, Tracker
from calib.data.measurements import Measurements
from calib.design.candidates import draw, planning_ranges
from calib.design.choice import PlanRequest
from calib.design.forecast import Forecast, Workspace
from calib.design.plan import plan
from calib.design.sensitivity import Sensitivity
from calib.robot.robot import Robot
from calib.simulation.scenario import Scenario
from calib.simulation.study import Study, Trials, study

ROOT = Path(__file__).resolve().parents[1]
TARGET = np.array([-0.06997, 0.07020, 0.02252])
Array = NDArray[np.float64]


def ur3() -> Robot:
    """The paper's robot."""
    return Robot.load(ROOT / "urdf" / "ur3.urdf", base="base", tip="tool0")


def cell_of(model: str = "hayati") -> Cell:
    """What is planned for: the paper's target, its place not known to better than a millimetre."""
    return Cell(target=TARGET, model=model)


def surroundings() -> Cell:
    """The same with what stands around: a tracker, a reflector that faces one way, a table and a pillar."""
    table = np.eye(4)
    table[2, 3] = -0.03
    pillar = np.eye(4)
    pillar[:3, 3] = (-0.45, -0.45, 0.5)
    return replace(
        cell_of(),
        tracker=Tracker(np.array([2.5, 1.5, 0.8]), nearest=0.8, farthest=20.0),
        reflector=Reflector(np.array([0.0, 0.0, 1.0]), acceptance=np.radians(50.0)),
        boxes=(
            Box("table", np.array([1.2, 1.2, 0.04]), table),
            Box("pillar", np.array([0.1, 0.1, 1.0]), pillar),
        ),
    )


def free(count: int, candidates: int, criterion: str) -> tuple[Forecast, float]:
    """A plan among free candidates, and how long it took [s]."""
    began = time.perf_counter()
    made = plan(
        ur3(),
        cell_of(),
        PlanRequest(count, 0, criterion, candidates, ladder=False),
        collisions=None,
    )
    return made.forecast, time.perf_counter() - began


def yardstick(candidates: int) -> list[str]:
    """30 poses of the paper, 30 random ones and 30 planned ones: prediction error in noise of one measurement."""
    robot = ur3()
    sensitivity = Sensitivity.of(robot, cell_of())
    pool = draw(robot, planning_ranges(robot, {}, 0.0), [], candidates, 0)
    workspace = Workspace.of(sensitivity, pool.workspace)
    table = Measurements.read(ROOT / "calib" / "example" / "ur3_leica.csv", robot.joint_names)
    rows = table.joints_for(robot.joint_names)[table.estimation]
    rng = np.random.default_rng(0)
    of_paper = Forecast.of(sensitivity, workspace, rows)
    draws = [rng.choice(len(pool.q), 30, replace=False) for _ in range(21)]
    of_random = np.median(
        [Forecast.of(sensitivity, workspace, pool.q[one]).mean_variance for one in draws]
    )
    planned, _ = free(30, candidates, "V")
    return [
        f"| the paper's 30 | {np.sqrt(of_paper.mean_variance):.2f} |",
        f"| 30 at random (median of 21 draws) | {np.sqrt(of_random):.2f} |",
        f"| 30 planned | {np.sqrt(planned.mean_variance):.2f} |",
        f"| the yardstick, sqrt(rank / N) = sqrt({planned.workspace_rank} / 30) | "
        f"{np.sqrt(planned.workspace_rank / 30):.2f} |",
    ]


def criteria(candidates: int) -> list[str]:
    """Mean and worst prediction variance over the pool, in rank / N."""
    lines = []
    for criterion in ("V", "D", "A"):
        found, seconds = free(30, candidates, criterion)
        bound = found.workspace_rank / found.poses
        lines.append(
            f"| {criterion} | {found.mean_variance / bound:.3f} | {found.worst_variance / bound:.3f} | "
            f"{seconds:.1f} s |"
        )
    return lines


def obstacles(candidates: int) -> list[str]:
    """A plan among limits, collisions and sight against the free one, both over the free workspace."""
    robot = ur3()
    began = time.perf_counter()
    request = PlanRequest(30, 0, candidates=candidates, ladder=False)
    made = plan(robot, surroundings(), request)
    seconds = time.perf_counter() - began
    # Over the same workspace and with the same noise, so that the poses alone differ.
    cell = replace(cell_of(), tracker=surroundings().tracker)
    without = plan(robot, cell, request, collisions=None)
    refused = ", ".join(f"{n} {reason}" for reason, n in made.refused.items())
    return [
        f"- of {made.drawn} candidates {made.candidates} could be measured ({refused}), {seconds:.1f} s;",
        f"- forecast {1e3 * made.forecast.rms:.4f} mm rms, free {1e3 * without.forecast.rms:.4f} mm: ratio "
        f"{made.forecast.rms / without.forecast.rms:.3f};",
        f"- moves between poses that are not free: {len(made.blocked)}.",
    ]


def trials(count: int, model: str, poses: Array | None, number: int) -> Study:
    """Simulated calibrations at these poses, or at random ones that differ each time."""
    robot = ur3()
    what = Trials(
        scenario=Scenario(robot, cell=cell_of(model), model=model),
        cell=cell_of(model),
        poses=poses,
        sets=() if poses is None else ("estimate",) * len(poses),
        count=number,
        validate=False,
    )
    with ProcessPoolExecutor(max(1, len(os.sched_getaffinity(0)))) as executor:
        return study(what, count, executor=executor)


def comparison(count: int, candidates: int) -> list[str]:
    """Planned poses against random ones, and forecasts against what is reached."""
    lines = []
    for model in ("hayati", "placement"):
        random = trials(count, model, None, 30)
        for number in (30, 15):
            made = plan(
                ur3(),
                cell_of(model),
                PlanRequest(number, 0, candidates=candidates, ladder=False),
                collisions=None,
            )
            found = trials(count, model, made.estimation, number)
            foreseen = found.forecast
            if foreseen is None:
                raise RuntimeError("A study with noise has a forecast.")
            lines.append(
                f"| {model}, {number} planned | {1e3 * found.rms:.4f} ± {1e3 * found.rms_error:.4f} | "
                f"{found.rms / random.rms:.3f} | {foreseen.rms / found.rms:.3f} | "
                f"{100 * float(np.mean(found.values('covered'))):.1f} % |"
            )
        foreseen = random.forecast
        lines.append(
            f"| {model}, 30 random | {1e3 * random.rms:.4f} ± {1e3 * random.rms_error:.4f} | 1 | | "
            f"{100 * float(np.mean(random.values('covered'))):.1f} % |"
        )
    return lines


def large(candidates: int) -> list[str]:
    """Time and memory of very many candidates."""
    found, seconds = free(30, candidates, "V")
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    bound = found.workspace_rank / found.poses
    return [
        f"{candidates} candidates: {seconds:.1f} s, {memory:.2f} GB at most, mean "
        f"{found.mean_variance / bound:.3f} rank/N"
    ]


def main(arguments: Sequence[str] | None = None) -> None:
    """Print all tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--quick", action="store_true")
    quick = parser.parse_args(arguments).quick
    candidates, count = (4000, 20) if quick else (20_000, 200)
    titled: dict[str, Callable[[], list[str]]] = {
        "poses | rms error over the workspace, in noise of one measurement": lambda: yardstick(
            candidates
        ),
        "criterion | mean, in rank/N | worst, in rank/N | time": lambda: criteria(candidates),
        "limits, collisions, sight": lambda: obstacles(candidates),
        f"{count} calibrations each | rms error at unseen poses [mm] | over 30 random | forecast over reached | "
        "inside 95 % regions": lambda: comparison(count, candidates),
        "many candidates": lambda: large(5 * candidates),
    }
    for title, lines in track(titled.items(), "tables", console=Console(stderr=True)):
        print(f"\n{title}", *lines(), sep="\n", flush=True)


if __name__ == "__main__":
    main()
