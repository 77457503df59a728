"""Time of one fit on the paper's 30 rows, 27 parameters, after import.

    .venv/bin/python scripts/solver_time.py

`fit` is everything between the arrays and the estimate: DH rows and error model, registration, all solves, robust
weights, sizes of noise and priors, covariance, scores. Medians of 200 runs in one process.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

from calib.data import PAPER_TARGET, paper_measurements, paper_urdf
from calib.identify.fitting import Task, fit
from calib.identify.table_rows import rows_of
from calib.measure.cell import Cell
from calib.measure.measurements import Measurements
from calib.model.robot import Robot, read_only

_RUNS = 200


def milliseconds(function: Callable[[], object], runs: int = _RUNS) -> tuple[float, float]:
    """Median and smallest time of a call [ms]."""
    function()
    times = []
    for _ in range(runs):
        began = time.perf_counter()
        function()
        times.append(1e3 * (time.perf_counter() - began))
    return statistics.median(times), min(times)


def main() -> None:
    """Print a line for each solver."""
    robot = Robot.load(paper_urdf(), base="base", tip="tool0")
    table = Measurements.read(paper_measurements(), robot.joint_names, robot.joint_types)
    cell = Cell(target=read_only(PAPER_TARGET), model="paper")
    every, setup = rows_of(robot, table, cell)
    rows = every.select(table.estimation)
    print(f"{'solver':<10}{'median [ms]':>12}{'smallest [ms]':>15}{'evaluations':>13}")
    for solver in ("lm", "paper", "scipy"):
        task = Task(robot, cell, setup, cell.model, solver=solver)
        estimate = fit(task, rows).estimate
        median, smallest = milliseconds(lambda task=task: fit(task, rows))  # type: ignore[misc]
        print(f"{solver:<10}{median:>12.1f}{smallest:>15.1f}{estimate.solution.evaluations:>13}")


if __name__ == "__main__":
    main()
