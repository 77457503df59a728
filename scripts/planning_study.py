"""Value of planned poses on the paper's UR3 with virtual measurements: the figures of docs/planning.md.

    python scripts/planning_study.py            all of it, a few minutes
    python scripts/planning_study.py --quick    fewer calibrations and candidates

The model is DH with Hayati's beta, with one target and a known measurement frame. The noise of a coordinate is that of
a laser tracker 3 m away and of the robot's repeatability.
"""

from __future__ import annotations

import resource
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from studies import print_table, process_pool, study_parser
from trials import Task, Trials, run_trials

from calib.basics.arrays import Array
from calib.basics.jobs import core_count
from calib.data.cell import Box, Cell, Reflector, Tracker
from calib.data.measurements import Measurements
from calib.example import PAPER_TARGET, paper_measurements, paper_urdf
from calib.numerics.geometry import pose_of
from calib.robot.robot import Robot
from calib.verbs.plan.choice import PlanRequest
from calib.verbs.plan.forecast import Forecast, Workspace
from calib.verbs.plan.plan import Plan, plan
from calib.verbs.plan.pose_candidates import draw, planning_ranges
from calib.verbs.plan.sensitivity import Sensitivity
from calib.verbs.simulate.scenario import Scenario


def ur3() -> Robot:
    """Return the paper's robot."""
    return Robot.load(paper_urdf(), base="base", tip="tool0")


def paper_cell(model: str = "hayati") -> Cell:
    """Return a cell with the paper's target, whose place is known to a millimetre only."""
    return Cell(target=np.array(PAPER_TARGET), model=model)


def surroundings() -> Cell:
    """Return that cell with a tracker, a reflector that faces one way, a table and a pillar."""
    return replace(
        paper_cell(),
        tracker=Tracker(np.array([2.5, 1.5, 0.8]), nearest=0.8, farthest=20.0),
        reflector=Reflector(np.array([0.0, 0.0, 1.0]), acceptance=np.radians(50.0)),
        boxes=(
            Box("table", np.array([1.2, 1.2, 0.04]), pose_of([0.0, 0.0, -0.03])),
            Box("pillar", np.array([0.1, 0.1, 1.0]), pose_of([-0.45, -0.45, 0.5])),
        ),
    )


def free_plan(
    count: int, candidates: int, criterion: str = "V", model: str = "hayati"
) -> tuple[Plan, float]:
    """Plan poses among free candidates.

    Args:
        count: Number of poses.
        candidates: Number of candidates.
        criterion: Criterion of the plan.
        model: Model that is planned for.

    Returns:
        The plan, and the time that it took [s].
    """
    began = time.perf_counter()
    request = PlanRequest(count, 0, criterion, candidates, ladder=False)
    planned = plan(ur3(), paper_cell(model), request, collisions=None)
    return planned, time.perf_counter() - began


def worth_rows(candidates: int) -> Iterator[list[str]]:
    """Yield the forecast error of the paper's 30 poses, 30 random and 30 planned ones, in noise of a measurement."""
    robot = ur3()
    sensitivity = Sensitivity.of(robot, paper_cell())
    pool = draw(robot, planning_ranges(robot, {}, 0.0), [], candidates, 0)
    workspace = Workspace.of(sensitivity, pool.workspace)
    table = Measurements.read(paper_measurements(), robot.joint_names)
    q_paper = table.joints_for(robot.joint_names)[table.estimation]
    of_paper = Forecast.of(sensitivity, workspace, q_paper)
    rng = np.random.default_rng(0)
    of_random = []
    for _ in range(21):
        poses = rng.choice(len(pool.q), 30, replace=False)
        of_random.append(Forecast.of(sensitivity, workspace, pool.q[poses]).mean_variance)
    of_planned = free_plan(30, candidates)[0].forecast
    rank = of_planned.workspace_rank
    yield ["the paper's 30", f"{np.sqrt(of_paper.mean_variance):.2f}"]
    yield ["30 at random (median of 21 draws)", f"{np.sqrt(np.median(of_random)):.2f}"]
    yield ["30 planned", f"{np.sqrt(of_planned.mean_variance):.2f}"]
    yield [f"the least, sqrt(rank / N) = sqrt({rank} / 30)", f"{np.sqrt(rank / 30):.2f}"]


def criterion_rows(candidates: int) -> Iterator[list[str]]:
    """Yield mean and worst variance over the pool, in rank / N, for each criterion."""
    for criterion in ("V", "D", "A"):
        planned, seconds = free_plan(30, candidates, criterion)
        forecast = planned.forecast
        bound = forecast.workspace_rank / forecast.poses
        mean = forecast.mean_variance / bound
        worst = forecast.worst_variance / bound
        yield [criterion, f"{mean:.3f}", f"{worst:.3f}", f"{seconds:.1f} s"]


def approach_rows(candidates: int) -> Iterator[list[str]]:
    """Yield forecasts of 30 measurements, by the approach of their poses, of an arm with lost motion."""
    cell = paper_cell("hayati+lost_motion")
    for approach, count in (("straight", 30), ("both", 15), ("one", 30)):
        request = PlanRequest(count, 0, candidates=candidates, ladder=False, approach=approach)
        found = plan(ur3(), cell, request, collisions=None).forecast
        names_and_std = zip(found.names, found.parameter_std, strict=True)
        of_order = [std for name, std in names_and_std if name.endswith(".lost_motion")]
        lost_motion = 1e3 * np.sqrt(np.mean(np.square(of_order)))
        yield [
            approach,
            f"{count}",
            f"{lost_motion:.3f} mrad",
            f"{1e3 * found.rms:.4f} mm",
        ]


def obstacle_rows(candidates: int) -> Iterator[list[str]]:
    """Yield figures of a plan among limits, collisions and sight beside a free one."""
    robot = ur3()
    began = time.perf_counter()
    request = PlanRequest(30, 0, candidates=candidates, ladder=False)
    planned = plan(robot, surroundings(), request)
    seconds = time.perf_counter() - began
    # Over the same workspace and with the same noise, so that the poses alone differ.
    cell = replace(paper_cell(), tracker=surroundings().tracker)
    unhindered = plan(robot, cell, request, collisions=None)
    refused = ", ".join(f"{count} {reason}" for reason, count in planned.refused.items())
    rms, free_rms = planned.forecast.rms, unhindered.forecast.rms
    yield ["candidates", str(planned.drawn)]
    yield ["that could be measured", f"{planned.candidates} ({refused})"]
    yield ["time", f"{seconds:.1f} s"]
    yield ["forecast, rms", f"{1e3 * rms:.4f} mm"]
    yield ["forecast of the free plan, rms", f"{1e3 * free_rms:.4f} mm"]
    yield ["ratio", f"{rms / free_rms:.3f}"]
    yield ["moves between poses that are not free", str(len(planned.blocked))]


def simulate(runs: int, model: str, count: int, poses: Array | None = None) -> Trials:
    """Simulate calibrations.

    Args:
        runs: Number of calibrations.
        model: Model of the robots' errors and of the fits.
        count: Number of poses.
        poses: shape (count, 6), the poses [rad]; None: random ones that differ each time.
    """
    cell = paper_cell(model)
    task = Task(
        scenario=Scenario(ur3(), cell=cell, model=model),
        cell=cell,
        poses=poses,
        count=count,
        validate=False,
    )
    with process_pool(core_count()) as executor:
        return run_trials(task, runs, executor=executor)


def comparison_rows(runs: int, candidates: int) -> Iterator[list[str]]:
    """Yield errors reached with planned poses over those with random ones, and forecasts over errors."""
    for model in ("hayati", "placement"):
        random = simulate(runs, model, 30)
        for count in (30, 15):
            planned, _ = free_plan(count, candidates, model=model)
            reached = simulate(runs, model, count, planned.estimation)
            if reached.forecast is None:
                raise RuntimeError("A study with noise has a forecast.")
            yield [
                f"{model}, {count} planned",
                f"{1e3 * reached.rms:.4f} ± {1e3 * reached.rms_error:.4f}",
                f"{reached.rms / random.rms:.3f}",
                f"{reached.forecast.rms / reached.rms:.3f}",
                f"{100 * float(np.mean(reached.values('covered'))):.1f} %",
            ]
        yield [
            f"{model}, 30 random",
            f"{1e3 * random.rms:.4f} ± {1e3 * random.rms_error:.4f}",
            "1",
            "",
            f"{100 * float(np.mean(random.values('covered'))):.1f} %",
        ]


def many_rows(candidates: int) -> Iterator[list[str]]:
    """Yield time, memory and mean variance with very many candidates."""
    planned, seconds = free_plan(30, candidates)
    gigabytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    forecast = planned.forecast
    mean = forecast.mean_variance * forecast.poses / forecast.workspace_rank
    yield [str(candidates), f"{seconds:.1f} s", f"{gigabytes:.2f} GB", f"{mean:.3f}"]


def main() -> None:
    """Print all tables."""
    parser = study_parser(__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer calibrations and candidates")
    arguments = parser.parse_args()
    candidates, runs = 20_000, 200
    if arguments.quick:
        candidates, runs = 4000, 20
    print_table(
        ["poses", "rms error over the workspace, in noise of one measurement"],
        worth_rows(candidates),
    )
    print()
    titles = ["criterion", "mean, in rank/N", "worst, in rank/N", "time"]
    print_table(titles, criterion_rows(candidates))
    print()
    titles = ["approach", "poses", "std of lost motion", "rms error over the workspace"]
    print_table(titles, approach_rows(candidates))
    print()
    print_table(["limits, collisions, sight", ""], obstacle_rows(candidates), [37])
    print()
    titles = [f"{runs} calibrations each", "rms error at other poses [mm]", "over 30 random"]
    titles += ["forecast over reached", "inside 95 % regions"]
    print_table(titles, comparison_rows(runs, candidates))
    print()
    titles = ["candidates", "time", "memory at most", "mean, in rank/N"]
    print_table(titles, many_rows(5 * candidates))


if __name__ == "__main__":
    main()
