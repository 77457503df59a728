"""Speed and memory of calib at every size: the tables of docs/performance.md.

    python scripts/benchmark.py                        all of it, some minutes
    python scripts/benchmark.py --quick                small sizes only
    python scripts/benchmark.py --limit ./limit        beside a hand-written pass; it takes N and prints "... S s ..."
    python scripts/benchmark.py --write                puts the tables into docs/performance.md

Everything is measured in this run, each size in a process of its own (benchmark_one.py), the best of several times.
"""

from __future__ import annotations

import json
import os
import platform
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

from benchmark_one import TARGET, best_time
from studies import core_count, show_progress, study_parser, table_lines
from trials import Task, run_trials

from calib.data.cell import Cell
from calib.example import paper_measurements, paper_urdf
from calib.robot.robot import Robot
from calib.verbs.plan.plan import plan
from calib.verbs.simulate.scenario import Scenario

DOCS = Path(__file__).resolve().parents[1] / "docs"
PAGE = DOCS / "performance.md"

#: Numbers of rows.
SIZES = (30, 300, 3_000, 30_000, 300_000, 1_000_000)

#: Largest number of rows for SciPy, which takes a minute for so many.
SCIPY_SIZE = 3_000


def measure(measurement: str, count: int) -> dict[str, float]:
    """Run a measurement of benchmark_one.py with so many rows in a process of its own, with one thread."""
    script = Path(__file__).with_name("benchmark_one.py")
    ran = subprocess.run(
        [sys.executable, script, measurement, str(count)],
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return dict(json.loads(ran.stdout))


def time_text(seconds: float) -> str:
    """Return a time in ms, or in s from 1 s on."""
    return f"{1e3 * seconds:.3g} ms" if seconds < 1.0 else f"{seconds:.2f} s"


def pass_table(count: int, limit: str | None) -> Iterator[str]:
    """Yield the lines of the table of one pass over so many rows, beside that of a program."""
    titles = [f"one pass over {count:,} rows: residual, 27 columns, normal matrix", "1 thread"]
    rows = [["calib", f"{1e3 * measure('pass', count)['seconds']:.0f} ms"]]
    if limit is not None:
        rows.append(["C++ by hand", f"{1e3 * by_hand(limit, count):.0f} ms"])
    yield from table_lines(titles, rows)


def by_hand(program: str, count: int) -> float:
    """Return the best time that a program prints for a pass over so many rows [s]."""
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    command = [program, str(count)]
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return min(float(seconds) for seconds in re.findall(r"([0-9.]+) s\b", ran.stdout))


def fit_table(sizes: Sequence[int]) -> Iterator[str]:
    """Yield the lines of the table of fits alone, beside plain least squares."""
    titles = ["rows", "fit", "memory"]
    titles += ["SciPy, Pinocchio's regressor in a loop", "SciPy, finite differences"]
    rows = []
    for count in show_progress(sizes, "fits"):
        figures = measure("fit", count)
        row = [f"{count:,}", time_text(figures["seconds"]), f"{figures['megabytes']:.0f} MB"]
        if count <= SCIPY_SIZE:
            plain = measure("plain", count)
            row += [f"{plain['regressor']:.2f} s", f"{plain['differences']:.2f} s"]
        else:
            row += ["–", "–"]
        rows.append(row)
    yield from table_lines(titles, rows)


def calibration_table(sizes: Sequence[int]) -> Iterator[str]:
    """Yield the lines of the table of `calibrate`, with all that a result has."""
    titles = ["rows", "`calibrate`, model given, not validated"]
    titles += ["cross-validated", "`auto`, cross-validated", "memory"]
    rows = []
    for count in show_progress(sizes, "calibrations"):
        figures = measure("calibration", count)
        times = [time_text(figures[name]) for name in ("given", "validated", "auto")]
        rows.append([f"{count:,}", *times, f"{figures['megabytes']:.0f} MB"])
    yield from table_lines(titles, rows)


def study_times(task: Task, count: int) -> tuple[float, float]:
    """Return the times of a study of so many robots, by one process and by one for each core [s]."""
    began = time.perf_counter()
    run_trials(task, count)
    serial = time.perf_counter() - began
    with ProcessPoolExecutor(core_count()) as executor:
        run_trials(task, 2 * core_count(), executor=executor)  # processes started, modules loaded
        began = time.perf_counter()
        run_trials(task, count, executor=executor)
        parallel = time.perf_counter() - began
    return serial, parallel


def study_table(count: int) -> Iterator[str]:
    """Yield the lines of the table of studies of so many simulated robots, and of a plan."""
    robot = Robot.load(paper_urdf(), base="base", tip="tool0")
    titles = [f"{count:,} simulated robots, 30 poses each", "1 process"]
    titles.append(f"{core_count()} processes")
    rows = []
    kinds = (("dh", False), ("dh", True), ("auto", True))
    for model, validate in show_progress(kinds, "studies"):
        task = Task(Scenario(robot), Cell(model=model), count=30, validate=validate)
        fewer = count if model == "dh" else max(count // 10, 20)
        title = f"model {model}, cross-validated" if validate else f"model {model}"
        times = study_times(task, fewer)
        rows.append([title, *(f"{count / fewer * seconds:.1f} s" for seconds in times)])
    began = time.perf_counter()
    plan(robot, Cell(model="hayati", target=TARGET), collisions=None)
    rows.append(["a plan of 30 poses", f"{time.perf_counter() - began:.1f} s", ""])
    yield from table_lines(titles, rows)


def command_table(times: int) -> Iterator[str]:
    """Yield the lines of the table of whole processes, from nothing to the end."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        commands = whole_commands(Path(folder))
        for name, command in show_progress(list(commands.items()), "commands"):
            run = partial(subprocess.run, command, stdout=subprocess.DEVNULL)
            rows.append([name, f"{best_time(run, times):.2f} s"])
    yield from table_lines(["a whole process", "time"], rows)


def whole_commands(folder: Path) -> dict[str, list[str]]:
    """Return the commands that are measured, by their title; they write into a folder."""
    calib = str(Path(sys.executable).with_name("calib"))
    chain = ["--base", "base", "--tip", "tool0"]
    calibrate = [calib, "calibrate", str(paper_urdf()), str(paper_measurements()), *chain]
    calibrate += ["-o", str(folder / "corrected.urdf"), "--force", "--quiet"]
    plan_command = [calib, "plan", "ur3", *chain, "--target", "70 -70 22.5 mm"]
    plan_command += ["-o", str(folder / "corrected.urdf"), "--force", "--quiet"]
    return {
        '`python -c "import calib"`': [sys.executable, "-c", "import calib"],
        "`calib --help`": [calib, "--help"],
        "`calib calibrate` on the paper's 35 rows": calibrate,
        "the same with `--report`": [*calibrate, "--report", str(folder / "report.html")],
        "`calib demo`": [calib, "demo", "--out", str(folder / "demo"), "--force", "--quiet"],
        "`calib plan`, 30 poses of 20,000": plan_command,
    }


def write_table(name: str, lines: Sequence[str]) -> None:
    """Put a table between its marks in the docs."""
    text = PAGE.read_text(encoding="utf-8")
    begin, end = f"<!-- {name} -->", f"<!-- end of {name} -->"
    head, rest = text.split(begin)
    _, tail = rest.split(end)
    table = "\n".join(lines)
    PAGE.write_text(f"{head}{begin}\n\n{table}\n\n{end}{tail}", encoding="utf-8")


def main() -> None:
    """Measure and print."""
    parser = study_parser(__doc__)
    parser.add_argument("--quick", action="store_true", help="small sizes only")
    parser.add_argument("--limit", metavar="PROGRAM", help="a hand-written pass to compare with")
    parser.add_argument("--write", action="store_true", help="put the tables into the docs")
    arguments = parser.parse_args()
    sizes: Sequence[int] = SIZES
    robots, times = 1000, 7
    if arguments.quick:
        sizes = SIZES[:4]
        robots, times = 100, 3
    tables: dict[str, Callable[[], Iterator[str]]] = {
        "pass": lambda: pass_table(sizes[-1], arguments.limit),
        "fit": lambda: fit_table(sizes),
        "whole": lambda: calibration_table(sizes),
        "studies": lambda: study_table(robots),
        "start": lambda: command_table(times),
    }
    processor = platform.processor() or platform.machine()
    print(f"{processor}, {core_count()} cores, Python {platform.python_version()}\n")
    for name, table in tables.items():
        lines = list(table())
        print("\n".join(lines), end="\n\n", flush=True)
        if arguments.write:
            write_table(name, lines)


if __name__ == "__main__":
    main()
