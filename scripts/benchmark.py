"""Speed and memory of calib: every command that people wait for, and other programs. Tables of docs/performance.md.

    python scripts/benchmark.py                                  all of it, a quarter of an hour
    python scripts/benchmark.py --only commands,wrong            these parts; --row "pictures|60" these commands
    python scripts/benchmark.py --write                          puts the tables into docs/performance.md
    python scripts/benchmark.py --limit ./limit                  beside a pass that is written by hand; it takes N and
                                                                 prints "... S s ..."
    python scripts/benchmark.py --peers other/bin/python         beside programs that need an environment of their own

Everything is measured in this run, from inputs that are simulated here. Commands are whole processes
(benchmark_commands.py), and tell themselves where their time goes (benchmark_stages.py). Fits alone are measured each
size in a process of its own (benchmark_one.py), the best of several times. Other programs: benchmark_peers.py. Ratios
for `make verify`: benchmark_ratios.py.
"""

from __future__ import annotations

import json
import os
import platform
import re
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from benchmark_beside_peers import picture_rows, point_rows
from benchmark_commands import COMMANDS, WRONG_BOARDS
from benchmark_one import TARGET
from benchmark_page import write_table
from benchmark_ratios import measured_ratios
from studies import print_table, show_progress, study_parser
from trials import Task, run_trials
from wrong_inputs import write_wrong_inputs

from calib.basics.jobs import core_count
from calib.data.cell import Cell
from calib.example import paper_urdf
from calib.robot.robot import Robot
from calib.verbs.plan.plan import plan
from calib.verbs.simulate.scenario import Scenario

#: Numbers of rows of fits alone, and of `calibrate` without reading a table.
SIZES = (30, 300, 3_000, 30_000, 300_000, 1_000_000)
WHOLE = (30, 300, 3_000)

#: Largest number of rows for SciPy with Pinocchio's regressor, and with finite differences: some ten seconds each.
SCIPY_SIZE, DIFFERENCES_SIZE = 3_000, 300

#: A command that takes longer is stopped [s].
PATIENCE = 240.0

#: Memory that a command may take [bytes]: one that needs more must not take it from what else runs.
MEMORY = 8 * 2**30

#: A command that takes less is run three times, and the best counts [s].
SHORT = 4.0

#: Smallest share of a command's time that is printed for a stage.
LEAST_SHARE = 0.1


# Whole commands


@dataclass(frozen=True)
class Run:
    """One run of a command."""

    #: Time from start to end [s], and largest memory [MB]
    seconds: float
    megabytes: float
    #: Seconds of its stages; empty if it was stopped
    stages: Mapping[str, float]
    #: What it printed
    printed: str

    def texts(self) -> list[str]:
        """Return time, memory and where the time goes, as a table has them."""
        if not self.stages:
            return [f"> {self.seconds:.0f} s", f"{self.megabytes:.0f} MB", ""]
        if "MemoryError" in self.printed:
            return ["–", f"> {MEMORY / 2**20:.0f} MB", ""]
        shares = {name: seconds / self.seconds for name, seconds in self.stages.items()}
        shares["start of Python"] = 1.0 - sum(shares.values())
        largest = sorted(shares.items(), key=lambda item: -item[1])
        goes = [f"{name} {share:.0%}" for name, share in largest if share >= LEAST_SHARE]
        return [time_text(self.seconds), f"{self.megabytes:.0f} MB", ", ".join(goes)]


def run_once(arguments: Sequence[str], folder: Path) -> Run:
    """Run a calib command in a folder, with its stages."""
    output = folder / "stages.json"
    output.unlink(missing_ok=True)
    script = Path(__file__).with_name("benchmark_stages.py")
    began = time.perf_counter()
    with (folder / "printed.txt").open("w+", encoding="utf-8") as printed:
        process = subprocess.Popen(
            [sys.executable, script, output, *arguments],
            cwd=folder,
            stdout=printed,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY)),
        )
        while True:
            ended, _, used = os.wait4(process.pid, os.WNOHANG)
            seconds = time.perf_counter() - began
            if ended:
                break
            if seconds > PATIENCE:
                os.killpg(process.pid, 9)
                _, _, used = os.wait4(process.pid, 0)
                break
            time.sleep(0.002)
        printed.seek(0)
        text = printed.read()
    figures = json.loads(output.read_text(encoding="utf-8")) if output.exists() else {}
    stages = figures.get("stages", {}) if seconds <= PATIENCE else {}
    return Run(seconds, figures.get("megabytes", used.ru_maxrss / 1e3), stages, text)


def best_run(arguments: Sequence[str], folder: Path) -> Run:
    """Run a command, three times if it is short; return the shortest run."""
    runs = [run_once(arguments, folder)]
    while len(runs) < 3 and runs[0].seconds < SHORT:
        runs.append(run_once(arguments, folder))
    return min(runs, key=lambda run: run.seconds)


def command_rows(chosen: re.Pattern[str]) -> Iterator[list[str]]:
    """Yield the rows of the commands whose titles fit a pattern."""
    if chosen.search("import calib"):
        command = [sys.executable, "-c", "import calib"]
        seconds = min(wall(command) for _ in range(7))
        yield ['`python -c "import calib"`', time_text(seconds), "", ""]
    names = [name for name in COMMANDS if chosen.search(name)]
    for name in show_progress(names, "commands"):
        with tempfile.TemporaryDirectory() as folder:
            arguments = COMMANDS[name](Path(folder))
            yield [name, *best_run(arguments, Path(folder)).texts()]


def wall(command: Sequence[str]) -> float:
    """Return the time of a process from start to end [s]."""
    began = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - began


def wrong_rows(chosen: re.Pattern[str]) -> Iterator[list[str]]:
    """Yield the rows of wrong inputs whose names fit a pattern: time, and whether the cause is named."""
    with tempfile.TemporaryDirectory() as folder:
        inputs = list(write_wrong_inputs(Path(folder), lambda name: bool(chosen.search(name))))
        for wrong in show_progress(inputs, "wrong inputs"):
            run = run_once(wrong.arguments, wrong.folder)
            time_, memory, goes = run.texts()
            yield [wrong.name, time_, memory, "yes" if wrong.is_named(run.printed) else "no", goes]
    for name, (prepare, words) in WRONG_BOARDS.items():
        if chosen.search(name):
            with tempfile.TemporaryDirectory() as folder:
                run = run_once(prepare(Path(folder)), Path(folder))
                time_, memory, goes = run.texts()
                # Lines are broken where they are long.
                named = words in " ".join(run.printed.split())
                yield [name, time_, memory, "yes" if named else "no", goes]


# Fits alone


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


def pass_rows(count: int, limit: str | None) -> Iterator[list[str]]:
    """Yield the rows of one pass over so many rows, beside that of a program."""
    yield ["calib, on two cores", f"{1e3 * measure('pass', count)['seconds']:.0f} ms"]
    if limit is not None:
        yield ["C++ by hand, on one core", f"{1e3 * by_hand(limit, count):.0f} ms"]


def by_hand(program: str, count: int) -> float:
    """Return the best time that a program prints for a pass over so many rows [s]."""
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    command = [program, str(count)]
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return min(float(seconds) for seconds in re.findall(r"([0-9.]+) s\b", ran.stdout))


def fit_rows() -> Iterator[list[str]]:
    """Yield the rows of fits alone, beside plain least squares."""
    for count in show_progress(SIZES, "fits"):
        figures = measure("fit", count)
        row = [f"{count:,}", time_text(figures["seconds"]), f"{figures['megabytes']:.0f} MB"]
        for measurement, largest in (("regressor", SCIPY_SIZE), ("differences", DIFFERENCES_SIZE)):
            seconds = measure(measurement, count)["seconds"] if count <= largest else np.nan
            row.append(time_text(seconds) if count <= largest else "–")
        yield row


def whole_rows() -> Iterator[list[str]]:
    """Yield the rows of `calibrate`, with all that a result has."""
    for count in show_progress(WHOLE, "calibrations"):
        figures = measure("calibration", count)
        times = [time_text(figures[name]) for name in ("given", "validated", "auto")]
        yield [f"{count:,}", *times, f"{figures['megabytes']:.0f} MB"]


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


def study_rows(count: int) -> Iterator[list[str]]:
    """Yield the rows of studies of so many simulated robots, and of a plan."""
    robot = Robot.load(paper_urdf(), base="base", tip="tool0")
    kinds = (("dh", False), ("dh", True), ("auto", True))
    for model, validate in show_progress(kinds, "studies"):
        task = Task(Scenario(robot), Cell(model=model), count=30, validate=validate)
        fewer = count if model == "dh" else max(count // 5, 20)
        title = f"model {model}, cross-validated" if validate else f"model {model}"
        times = study_times(task, fewer)
        yield [title, *(f"{count / fewer * seconds:.1f} s" for seconds in times)]
    began = time.perf_counter()
    plan(robot, Cell(model="hayati", target=TARGET), collisions=None)
    yield ["a plan of 30 poses", f"{time.perf_counter() - began:.1f} s", ""]


@dataclass(frozen=True)
class Part:
    """A table of the page."""

    #: Titles of its columns
    titles: Sequence[str]
    #: Yields its rows
    rows: Callable[[], Iterator[list[str]]]


def parts_of(arguments: Any) -> dict[str, Part]:  # noqa: ANN401  argparse's
    """Return the parts by name, with what the command line says of them."""
    chosen = re.compile(arguments.row)
    cores = core_count()
    pass_title = f"one pass over {SIZES[-1]:,} rows: residual, 27 columns, normal matrix"
    goes = "where the time goes"
    scipy = ["SciPy, Pinocchio's regressor in a loop", "SciPy, finite differences"]
    calibrate = ["`calibrate`, model given, not validated", "cross-validated"]
    studies = "100 simulated robots, 30 poses each"
    found = ["camera on the hand", "focal length", "board at fresh poses"]
    return {
        "ratios": Part(
            ["part", "times the reference loop"],
            lambda: ([name, f"{value:.2f}"] for name, value in measured_ratios({}).items()),
        ),
        "commands": Part(["command", "time", "memory", goes], lambda: command_rows(chosen)),
        "wrong": Part(["input", "time", "memory", "cause named", goes], lambda: wrong_rows(chosen)),
        "pictures": Part(
            ["24 pictures of 24 corners", "time", *found], lambda: picture_rows(arguments.peers)
        ),
        "points": Part(
            ["60 points", "time", "points at fresh poses"], lambda: point_rows(arguments.peers)
        ),
        "pass": Part([pass_title, "time"], lambda: pass_rows(SIZES[-1], arguments.limit)),
        "fit": Part(["rows", "fit", "memory", *scipy], fit_rows),
        "whole": Part(["rows", *calibrate, "`auto`, cross-validated", "memory"], whole_rows),
        "studies": Part(
            [studies, "1 process", f"{cores} processes"],
            lambda: study_rows(100),
        ),
    }


def main() -> None:
    """Measure and print."""
    parser = study_parser(__doc__)
    parser.add_argument("--only", metavar="PARTS", help="parts by commas; default: all")
    parser.add_argument("--row", metavar="PATTERN", default="", help="commands and wrong inputs")
    parser.add_argument("--limit", metavar="PROGRAM", help="a hand-written pass to compare with")
    parser.add_argument(
        "--peers", metavar="PYTHON", default=sys.executable, help="one that has other programs"
    )
    parser.add_argument("--write", action="store_true", help="put the tables into the docs")
    arguments = parser.parse_args()
    parts = parts_of(arguments)
    chosen = arguments.only.split(",") if arguments.only else list(parts)
    unknown = sorted(set(chosen) - set(parts))
    if unknown:
        parser.error(f"--only {','.join(unknown)}: the parts are {', '.join(parts)}.")
    processor = platform.processor() or platform.machine()
    print(f"{processor}, {core_count()} cores, Python {platform.python_version()}\n")
    for name in chosen:
        began = time.perf_counter()
        rows = list(parts[name].rows())
        print_table(parts[name].titles, rows)
        print(f"({name}: {time.perf_counter() - began:.0f} s)\n", flush=True)
        if arguments.write and rows:
            # Other programs need not be there each time.
            keep = bool(arguments.row) or name in ("pass", "pictures", "points")
            write_table(name, parts[name].titles, rows, keep=keep)


if __name__ == "__main__":
    main()
