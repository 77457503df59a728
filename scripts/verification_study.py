"""The table of docs/verification.md: what calib finds of robots whose errors are known.

    .venv/bin/python scripts/verification_study.py            all of it, on all cores
    .venv/bin/python scripts/verification_study.py --quick    few runs of each
    .venv/bin/python scripts/verification_study.py --only accuracy --only auto

Seeds are fixed: every call gives the same numbers. Errors are drawn anew in each run, in the parameters that the
robot is said to be wrong in; `study_robots` makes the measurements without `calib.identify`.
"""

from __future__ import annotations

import argparse
import functools
import multiprocessing
import os
import sys
import time
import zlib
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed

import numpy as np
import study_models as models
import study_points as points
from study_table import Found, Line, Study

STUDIES: Mapping[str, Study] = {
    "accuracy": Study(
        "Error on unseen poses over the Cramer-Rao bound",
        points.accuracy_cases,
        (200, 20),
        points.accuracy,
        points.accuracy_lines,
    ),
    "coverage": Study(
        "95 % intervals and predicted uncertainty",
        points.coverage_cases,
        (500, 30),
        points.coverage,
        points.coverage_lines,
    ),
    "outliers": Study(
        "A fifth of the rows displaced by 5 to 50 mm",
        points.outlier_cases,
        (200, 10),
        points.outliers,
        points.outlier_lines,
    ),
    "auto": Study("What `auto` picks", models.auto_cases, (50, 4), models.auto, models.auto_lines),
    "robots": Study(
        "Every robot of example-robot-data, without noise",
        models.robot_cases,
        (1, 1),
        models.robots,
        models.robot_lines,
    ),
    "compliance": Study(
        "Compliance of 1e-5 rad/Nm on each joint",
        models.compliance_cases,
        (600, 10),
        models.compliance,
        models.compliance_lines,
    ),
    "kinds": Study(
        "Each kind of measurement", models.kind_cases, (300, 10), models.kinds, models.kind_lines
    ),
}


def generator(study: str, case: str, number: int) -> np.random.Generator:
    """The random numbers of one run."""
    return np.random.default_rng([zlib.crc32(f"{study}/{case}".encode()), number])


def run_one(study: str, case: str, number: int) -> Found:
    """One run; what it raises names the run."""
    try:
        return STUDIES[study].one(case, generator(study, case, number))
    except Exception as error:
        message = f"study {study}, case {case}, run {number}: {error}"
        raise RuntimeError(message) from error


def run_study(
    name: str,
    runs: int,
    executor: Executor | None = None,
    cases: Sequence[str] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, list[Found]]:
    """All runs of some cases, in order."""
    chosen = STUDIES[name].cases() if cases is None else cases
    jobs = [(case, number) for case in chosen for number in range(runs)]
    found: dict[tuple[str, int], Found] = {}
    if executor is None:
        for case, number in jobs:
            found[case, number] = run_one(name, case, number)
    else:
        futures = {executor.submit(run_one, name, *job): job for job in jobs}
        for done, future in enumerate(as_completed(futures), start=1):
            found[futures[future]] = future.result()
            if progress is not None:
                progress(done, len(jobs))
    return {case: [found[case, number] for number in range(runs)] for case in chosen}


def markdown(title: str, runs: int, lines: Sequence[Line]) -> str:
    """A table."""
    head = f"### {title}\n\n{runs} runs of each.\n\n" if runs > 1 else f"### {title}\n\n"
    rows = [
        f"| {line.case} | {line.bar} | {line.found} | "
        f"{'' if line.met is None else 'yes' if line.met else '**no**'} |"
        for line in lines
    ]
    return head + "\n".join(["| case | bar | found | met |", "|---|---|---|---|", *rows]) + "\n"


def _tell(name: str, began: float, done: int, every: int) -> None:
    """A progress line."""
    if done % max(1, every // 100) == 0 or done == every:
        sys.stderr.write(f"\r{name}: {done} of {every} runs, {time.monotonic() - began:.0f} s ")
        sys.stderr.write("\n" if done == every else "")
        sys.stderr.flush()


def main() -> None:
    """Print the tables in Markdown."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--quick", action="store_true", help="few runs of each case")
    parser.add_argument("--only", action="append", choices=sorted(STUDIES), help="one study")
    parser.add_argument("--workers", type=int, default=os.cpu_count(), help="processes")
    arguments = parser.parse_args()
    # The matrices are small: threads of one worker would only stand in the way of the others.
    os.environ["OPENBLAS_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = "1"
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(arguments.workers, mp_context=context) as executor:
        for name in arguments.only or STUDIES:
            study = STUDIES[name]
            runs = study.runs[1 if arguments.quick else 0]
            tell = functools.partial(_tell, name, time.monotonic())
            found = run_study(name, runs, executor, progress=tell)
            print(markdown(study.title, runs, study.lines(found)), flush=True)


if __name__ == "__main__":
    main()
