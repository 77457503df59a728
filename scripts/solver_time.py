"""Times of small tables, after import: one fit, whole calibrations and trials of a study.

    OPENBLAS_NUM_THREADS=1 .venv/bin/python scripts/solver_time.py

`fit` is everything between the arrays and the estimate: DH rows and error model, registration, all solves, robust
weights, sizes of noise and priors, covariance, scores, of the paper's 30 rows with 27 parameters. `calibrate` is the
whole of `calib.calibrate` with these rows, a trial one of `calib simulate ur3 --count 30 --study`. Processor time of
one process, medians and the smallest of many runs: other programs disturb it less than time by the clock.
"""

from __future__ import annotations

import itertools
import statistics
import time
from collections.abc import Callable
from functools import partial

from calib.calibration import calibrate
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.estimate.fitting import Task, fit
from calib.estimate.setup import rows_of
from calib.example import PAPER_TARGET, paper_measurements, paper_urdf
from calib.robot.robot import Robot, read_only
from calib.simulation.scenario import Scenario
from calib.simulation.study import Trials, one_trial

_RUNS, _FEW_RUNS = 200, 20


def milliseconds(function: Callable[[], object], runs: int = _RUNS) -> tuple[float, float]:
    """Median and smallest processor time of a call [ms]."""
    function()
    times = []
    for _ in range(runs):
        began = time.process_time()
        function()
        times.append(1e3 * (time.process_time() - began))
    return statistics.median(times), min(times)


def row(name: str, function: Callable[[], object], runs: int = _RUNS, note: str = "") -> None:
    """Print a line."""
    median, smallest = milliseconds(function, runs)
    print(f"{name:<40}{median:>12.1f}{smallest:>15.1f}{note:>13}")


def main() -> None:
    """Print a line for each solver, calibration and study."""
    robot = Robot.load(paper_urdf(), base="base", tip="tool0")
    table = Measurements.read(paper_measurements(), robot.joint_names, robot.joint_types)
    cell = Cell(target=read_only(PAPER_TARGET), model="paper")
    every, setup = rows_of(robot, table, cell)
    rows = every.select(table.estimation)
    print(f"{'':<40}{'median [ms]':>12}{'smallest [ms]':>15}{'evaluations':>13}")
    for solver in ("lm", "paper", "scipy"):
        task = Task(robot, cell, setup, cell.model, solver=solver)
        count = fit(task, rows).estimate.solution.evaluations
        row(f"fit, {solver}", partial(fit, task, rows), note=str(count))
    for model, validate in itertools.product(("dh", "auto"), (False, True)):
        words = "with left-out rows" if validate else "without"
        whole = partial(calibrate, robot, table, cell=cell, model=model, validate=validate)
        row(f"calibrate, {model}, {words}", whole, _FEW_RUNS)
    scenario = Scenario(robot)
    for model, validate in itertools.product(("dh", "auto"), (False, True)):
        words = "with left-out rows" if validate else "without"
        trials = Trials(scenario, Cell(model=model), validate=validate)
        seeds = itertools.count()
        trial = partial(lambda t, s: one_trial(t, next(s)), trials, seeds)
        row(f"trial, {model}, {words}", trial, _FEW_RUNS)


if __name__ == "__main__":
    main()
