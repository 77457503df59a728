"""Shared parts of the studies: random draws, jobs in several processes, command lines and tables.

A study draws virtual robots, measures and calibrates them, and prints tables in Markdown. Each is a program of its own.
Every random number comes from a seed, so that the same arguments give the same figures, in any number of processes.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import islice, product, starmap, zip_longest
from typing import Any, TypeVar

import numpy as np
from rich.console import Console
from rich.progress import Progress

from calib.basics.arrays import Array
from calib.basics.jobs import core_count
from calib.diagnosis.reasons import Verdict
from calib.model.error_model import ErrorModel
from calib.result.calibration import Calibration
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot

Case = TypeVar("Case")
Item = TypeVar("Item")
Result = TypeVar("Result")
Run = TypeVar("Run")

#: Standard deviations of the errors of an uncalibrated arm, by family and in the family's unit.
TYPICAL_ERRORS = {
    "length": 0.3e-3,  # [m]
    "angle": 3e-3,  # [rad]
    "zero": 5e-3,  # [rad]
    "gain": 5e-4,  # [rad/rad]
    "eccentricity": 0.5e-3,  # [rad]
    "compliance": 2e-5,  # [rad/Nm]
}


# Random draws


def unchanged(value: Item) -> Item:
    """Return a value as it is: the change of a table without a fault."""
    return value


def draw_seed(rng: np.random.Generator) -> int:
    """Draw the seed of another generator."""
    return int(rng.integers(10**6))


def draw_errors(model: ErrorModel, length: float, angle: float, rng: np.random.Generator) -> Array:
    """Draw the errors of a model.

    Args:
        model: The model.
        length: Standard deviation of lengths [m].
        angle: Standard deviation of the others, which are angles [rad].
        rng: Random numbers.

    Returns:
        The errors, shape (p,).
    """
    std = np.where(np.array(model.units) == "m", length, angle)
    return std * rng.normal(size=len(model))


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """Draw a number between two limits, each power of ten as likely."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def add_noise(points: Array, sigma: float, rng: np.random.Generator) -> Array:
    """Return points with normal noise of standard deviation sigma [m] on each coordinate."""
    return points + sigma * rng.normal(size=points.shape)


def joint_values_around(centre: Array, share: float, robot: Robot, count: int, seed: int) -> Array:
    """Draw joint values in a part of the joint ranges.

    Args:
        centre: shape (1, m), joint values that the part contains [rad] or [m].
        share: Size of the part over that of the ranges, along each joint; 1 is all of them.
        robot: The robot, whose limits are the ranges.
        count: Number of joint values.
        seed: Of the random numbers.

    Returns:
        Joint values, shape (count, m), [rad] or [m].
    """
    return centre + share * (random_joint_values(robot, count, seed) - centre)


# Figures


def rms(values: Array) -> float:
    """Return the root mean square of values, shape (N,)."""
    return float(np.sqrt(np.mean(values**2)))


def rms_length(vectors: Array) -> float:
    """Return the root mean square of the lengths of vectors, shape (N, 3)."""
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))


def verdict_of(result: Calibration) -> Verdict:
    """Return the verdict of a calibration that has one."""
    if result.verdict is None:
        raise RuntimeError("The calibration was made without validation and has no verdict.")
    return result.verdict


def verdict_text(result: Calibration) -> str:
    """Return the verdict of a calibration and the codes of its reasons, ``use: gain, outside``."""
    verdict = verdict_of(result)
    codes = ", ".join(reason.code for reason in verdict.reasons)
    return f"{verdict.use}: {codes}"


# Jobs


def show_progress(items: Iterable[Item], label: str, count: int | None = None) -> Iterator[Item]:
    """Yield items behind a progress bar on stderr, which disappears at the end.

    Args:
        items: What is counted.
        label: Text before the bar.
        count: Number of items, if they cannot tell it themselves.
    """
    # The bar would take what is printed meanwhile to its own console, also where stdout is a file.
    redirect = sys.stdout.isatty()
    console = Console(stderr=True)
    with Progress(console=console, transient=True, redirect_stdout=redirect) as bar:
        yield from bar.track(items, total=count, description=label)


def process_pool(workers: int) -> ProcessPoolExecutor:
    """Return a pool of so many processes, each with one thread of linear algebra.

    The matrices are small: threads of one process would only stand in the way of the other processes.
    """
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    os.environ["OMP_NUM_THREADS"] = "1"
    return ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"))


def run_jobs(
    function: Callable[..., Result],
    jobs: Iterable[tuple[Any, ...]],
    *,
    workers: int = 1,
    label: str = "",
) -> Iterator[Result]:
    """Yield ``function(*job)`` of each job in the order of the jobs, each as soon as it is there.

    Args:
        function: A function at the top of a module, so that other processes can import it.
        jobs: Arguments of each call; with several processes they and the results are pickled.
        workers: Number of processes; with 1 the jobs run in this process.
        label: Text before the progress bar.
    """
    listed = list(jobs)
    if workers == 1:
        yield from show_progress(starmap(function, listed), label, len(listed))
        return
    with process_pool(workers) as pool:
        yield from show_progress(pool.map(function, *zip(*listed, strict=True)), label, len(listed))


def run_cases(
    function: Callable[[Case, Run], Result],
    cases: Iterable[Case],
    runs: Sequence[Run],
    *,
    workers: int = 1,
    label: str = "",
) -> Iterator[tuple[Case, list[Result]]]:
    """Yield each case of a study with the results of its runs, ``function(case, run)``.

    Args:
        function: One run; see `run_jobs`.
        cases: The cases.
        runs: Seeds of the runs of each case.
        workers: Number of processes.
        label: Text before the progress bar.
    """
    listed = list(cases)
    results = run_jobs(function, product(listed, runs), workers=workers, label=label)
    for case in listed:
        yield case, list(islice(results, len(runs)))


def study_parser(doc: str | None, *, parallel: bool = False) -> argparse.ArgumentParser:
    """Return the parser of a study's command line.

    Args:
        doc: Docstring of the study's module, for the help.
        parallel: Give it the option ``--workers``, the number of processes.
    """
    parser = argparse.ArgumentParser(
        description=doc, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    if parallel:
        help_text = "number of processes (default: one for each core)"
        parser.add_argument("--workers", type=int, default=core_count(), help=help_text)
    return parser


# Tables


def table_line(cells: Iterable[object], widths: Sequence[int] = ()) -> str:
    """Return a line of a Markdown table, its cells padded to the widths that are given."""
    pairs = zip_longest(cells, widths, fillvalue=0)
    padded = [str(cell).ljust(width) for cell, width in pairs]
    return f"| {' | '.join(padded)} |"


def table_lines(
    titles: Sequence[str], rows: Iterable[Iterable[object]], widths: Sequence[int] = ()
) -> Iterator[str]:
    """Yield the lines of a Markdown table.

    Args:
        titles: Titles of the columns.
        rows: Cells of each row.
        widths: Smallest widths of the first columns, for readers of the text.
    """
    yield table_line(titles, widths)
    yield "|" + len(titles) * "---|"
    for row in rows:
        yield table_line(row, widths)


def print_table(
    titles: Sequence[str], rows: Iterable[Iterable[object]], widths: Sequence[int] = ()
) -> None:
    """Print a Markdown table, each row as soon as it is there; arguments as for `table_lines`."""
    for line in table_lines(titles, rows, widths):
        print(line, flush=True)
