"""How fast calib is at every size: the tables of docs/performance.md.

    python scripts/benchmark.py                        # all of it, some minutes
    python scripts/benchmark.py --quick                # small sizes only, for a look
    python scripts/benchmark.py --limit ./limit        # beside a hand-written pass; it takes N and prints "... S s ..."
    python scripts/benchmark.py --write                # puts the tables into docs/performance.md

Everything is measured in this run, each size in a process of its own (for its memory), the best of several times. The
robot is the paper's UR3 with DH errors of a usual size, the tracker's noise 0.05 mm, one row in a hundred is off.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from scipy.optimize import least_squares

from calib.calibration import calibrate
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.design.plan import plan
from calib.estimate.fitting import fit
from calib.estimate.problem import Problem
from calib.estimate.task import Task
from calib.model.error_model import error_model
from calib.model.kinematics import Kinematics
from calib.registration.rows import Rows
from calib.registration.table_rows import rows_and_setup
from calib.robot.chain import pinocchio_chain
from calib.robot.robot import Robot
from calib.simulation.scenario import Scenario
from calib.simulation.study import study
from calib.simulation.trial import Trials

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "performance.md"
TARGET = np.array([0.05, 0.05, 0.05])
SIZES = (30, 300, 3_000, 30_000, 300_000, 1_000_000)
Array = NDArray[np.float64]

#: Where the progress is shown; tables go to stdout, each as soon as it is there.
BARS = Console(stderr=True)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--quick", action="store_true", help="small sizes only")
    parser.add_argument("--limit", metavar="PROGRAM", help="a hand-written pass to compare with")
    parser.add_argument("--write", action="store_true", help="put the tables into the docs")
    parser.add_argument("--one", nargs=2, metavar=("WHAT", "N"), help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.one:
        print(json.dumps(ONE[asked.one[0]](int(asked.one[1]))))
        return
    sizes = SIZES[:4] if asked.quick else SIZES
    tables: dict[str, Callable[[], list[str]]] = {
        "pass": lambda: of_passes(sizes[-1], asked.limit),
        "fit": lambda: of_fits(sizes),
        "whole": lambda: of_whole(sizes),
        "studies": lambda: of_studies(100 if asked.quick else 1000),
        "start": lambda: of_starts(3 if asked.quick else 7),
    }
    print(
        f"{platform.processor() or platform.machine()}, {cores()} cores, Python {platform.python_version()}\n"
    )
    for name, table in tables.items():
        lines = table()
        print("\n".join(lines), end="\n\n", flush=True)
        if asked.write:
            write(name, lines)


def cores() -> int:
    """The cores that this process may use."""
    return len(os.sched_getaffinity(0))


def best(work: Callable[[], object], times: int) -> float:
    """The shortest of some times of a call, after one that does not count [s]."""
    work()
    found = []
    for _ in range(times):
        began = time.perf_counter()
        work()
        found.append(time.perf_counter() - began)
    return min(found)


def simulated(count: int, seed: int = 0) -> tuple[Robot, Measurements]:
    """The robot, and a table of points."""
    rng = np.random.default_rng(seed)
    robot = Robot.load(ROOT / "urdf" / "ur3.urdf", base="base", tip="tool0")
    model = error_model(robot, "dh", target=True)
    T_tip_target = np.eye(4)
    T_tip_target[:3, 3] = TARGET
    x = rng.normal(size=len(model)) * np.where(np.array(model.units) == "m", 3e-4, 3e-3)
    q = rng.uniform(-2.8, 2.8, (count, 6))
    points = Kinematics(robot, model, np.eye(4), T_tip_target).points(x, q)
    points += rng.normal(0.0, 5e-5, (count, 3))
    off = rng.uniform(size=count) < 0.01
    points[off] += rng.normal(0.0, 5e-3, (int(off.sum()), 3))
    return robot, Measurements(joint_names=robot.joint_names, joints=q, points=points)


def task_of(count: int) -> tuple[Task, Rows]:
    """What the fit itself starts from."""
    robot, table = simulated(count)
    cell = Cell(model="dh")
    rows, setup = rows_and_setup(robot, table, cell)
    return Task(robot, cell, setup, "dh"), rows


def megabytes() -> float:
    """The most memory that this process has taken."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def one_pass(count: int) -> dict[str, float]:
    """Residual, 27 columns and normal matrix of all rows [s]."""
    task, rows = task_of(count)
    robot = task.robot
    kinematics = Kinematics(robot, error_model(robot, "dh", target=True), np.eye(4), np.eye(4))
    assert len(kinematics.model) == 27
    x, weights = np.zeros(27), np.ones(len(rows))

    def again() -> None:
        problem = Problem.initial(kinematics, rows)
        problem.linear(x).normal_equations(weights[None], problem.rho)

    return {"seconds": best(again, 5)}


def one_fit(count: int) -> dict[str, float]:
    """The fit alone, and the calibration with all it says but cross-validation [s], [MB]."""
    task, rows = task_of(count)
    times = 200 if count <= 300 else 20 if count <= 30_000 else 3
    seconds = best(lambda: fit(task, rows), times)
    return {"seconds": seconds, "megabytes": megabytes()}


def one_calibration(count: int) -> dict[str, float]:
    """calibrate() with a given model, the same with cross-validation, and with the model to be chosen [s], [MB]."""
    robot, table = simulated(count)
    times = 20 if count <= 300 else 3 if count <= 30_000 else 1
    given = best(lambda: calibrate(robot, table, model="dh", validate=False), times)
    memory = megabytes()
    checked = best(lambda: calibrate(robot, table, model="dh"), times)
    chosen = best(lambda: calibrate(robot, table), times)
    return {"given": given, "checked": checked, "chosen": chosen, "megabytes": memory}


def one_plain(count: int) -> dict[str, float]:
    """Plain least squares on the same rows, pose by pose through Pinocchio, SciPy's solver [s].

    Once with finite differences, as most scripts do it, and once with the derivative from Pinocchio's regressor.
    """
    task, rows = task_of(count)
    robot, model = task.robot, error_model(task.robot, "dh", target=True)
    n, T_tip_target = len(robot.joints), pin.SE3(np.eye(3), TARGET)
    q = robot.chain_values(rows.joints)

    def each(x: Array, *, columns: bool) -> tuple[Array, Array]:
        D, S = model.displacements(x)  # of the frame, the joints, the tip and the target
        T = [pin.SE3(one) for one in (robot.placements @ D[1 : n + 2])]
        chain = pinocchio_chain(robot.joints, np.array([one.homogeneous for one in T]))
        data, T_last_target = chain.createData(), T[-1] * T_tip_target * pin.SE3(D[-1])
        of_target = pin.SE3(T_tip_target.homogeneous @ D[-1]).toActionMatrixInverse() @ S[-12:-6]
        of_target += S[-6:]
        points, J = np.empty((count, 3)), np.empty((count if columns else 0, 3, len(x)))
        for i in range(count):
            pin.forwardKinematics(chain, data, q[i])
            pose = data.oMi[n] * T_last_target
            points[i] = pose.translation
            if columns:
                found = pin.computeJointKinematicRegressor(
                    chain, data, n, pin.LOCAL_WORLD_ALIGNED, T_last_target
                )
                J[i] = found[:3] @ S[6 : 6 * n + 6] + pose.rotation @ of_target[:3]
        return points, J

    def residual(x: Array) -> Array:
        return np.asarray((rows.measured[:, :3] - each(x, columns=False)[0]).ravel() / 5e-5)

    def derivative(x: Array) -> Array:
        return np.asarray(-each(x, columns=True)[1].reshape(-1, len(model)) / 5e-5)

    start = np.zeros(len(model))

    def solve(jacobian: str | Callable[[Array], Array]) -> float:
        began = time.perf_counter()
        least_squares(residual, start, jac=jacobian, x_scale=1e-3)
        return time.perf_counter() - began

    return {"differences": solve("2-point"), "regressor": solve(derivative)}


ONE = {"pass": one_pass, "fit": one_fit, "calibration": one_calibration, "plain": one_plain}


def alone(what: str, count: int) -> dict[str, float]:
    """One of these in a process of its own, with one thread."""
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
    ran = subprocess.run(
        [sys.executable, __file__, "--one", what, str(count)],
        env=environment,
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return dict(json.loads(ran.stdout))


def of_passes(count: int, limit: str | None) -> list[str]:
    """One pass of many rows by one thread, beside a hand-written one."""
    own = alone("pass", count)["seconds"]
    lines = [
        f"| one pass over {count:,} rows: residual, 27 columns, normal matrix | 1 thread |",
        "|---|---|",
        f"| calib | {1e3 * own:.0f} ms |",
    ]
    return lines + ([f"| C++ by hand | {1e3 * by_hand(limit, count):.0f} ms |"] if limit else [])


def by_hand(program: str, count: int) -> float:
    """The best time that a program prints for a pass [s]."""
    printed = subprocess.run(
        [program, str(count)],
        env=os.environ | {"OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    return min(float(seconds) for seconds in re.findall(r"([0-9.]+) s\b", printed))


def of_fits(sizes: Sequence[int]) -> list[str]:
    """The fit alone: robust weights, sizes of noise and errors, uncertainty; and plain least squares without those."""
    lines = [
        "| rows | fit | memory | SciPy, Pinocchio's regressor in a loop | SciPy, finite differences |",
        "|---|---|---|---|---|",
    ]
    for count in track(sizes, "fits", console=BARS, transient=True):
        own = alone("fit", count)
        plain = alone("plain", count) if count <= 3000 else {}
        others = [f"{plain[k]:.2f} s" if plain else "–" for k in ("regressor", "differences")]
        lines.append(
            f"| {count:,} | {amount(own['seconds'])} | {own['megabytes']:.0f} MB | {others[0]} | {others[1]} |"
        )
    return lines


def of_whole(sizes: Sequence[int]) -> list[str]:
    """calibrate(): all that a result says."""
    lines = [
        "| rows | `calibrate`, model given, not validated | cross-validated | `auto`, cross-validated | memory |",
        "|---|---|---|---|---|",
    ]
    for count in track(sizes, "whole calibrations", console=BARS, transient=True):
        one = alone("calibration", count)
        times = " | ".join(amount(one[k]) for k in ("given", "checked", "chosen"))
        lines.append(f"| {count:,} | {times} | {one['megabytes']:.0f} MB |")
    return lines


def of_studies(count: int) -> list[str]:
    """Studies of simulated robots, by one process and by several; and a plan."""
    robot = Robot.load(ROOT / "urdf" / "ur3.urdf", base="base", tip="tool0")
    lines = [
        f"| {count:,} simulated robots, 30 poses each | 1 process | {cores()} processes |",
        "|---|---|---|",
    ]
    kinds = (("dh", False), ("dh", True), ("auto", True))
    for model, validate in track(kinds, "studies", console=BARS, transient=True):
        cell = Cell(model=model)
        trials = Trials(Scenario(robot), cell, count=30, validate=validate)
        fewer = count if model == "dh" else max(count // 10, 20)
        began = time.perf_counter()
        study(trials, fewer)
        serial = time.perf_counter() - began
        with ProcessPoolExecutor(cores()) as executor:
            study(trials, 2 * cores(), executor=executor)  # processes started, modules loaded
            began = time.perf_counter()
            study(trials, fewer, executor=executor)
            together = time.perf_counter() - began
        scale = count / fewer
        lines.append(
            f"| model {model}{', cross-validated' if validate else ''} | {scale * serial:.1f} s | "
            f"{scale * together:.1f} s |"
        )
    began = time.perf_counter()
    plan(robot, Cell(model="hayati", target=TARGET), collisions=None)
    lines.append(f"| a plan of 30 poses | {time.perf_counter() - began:.1f} s | |")
    return lines


def of_starts(times: int) -> list[str]:
    """Whole processes, from nothing to the end."""
    calib = str(Path(sys.executable).with_name("calib"))
    with tempfile.TemporaryDirectory() as folder:
        table = ROOT / "calib" / "example" / "ur3_leica.csv"
        fitting = [
            "calibrate",
            str(ROOT / "urdf" / "ur3.urdf"),
            str(table),
            "--base",
            "base",
            "--tip",
            "tool0",
        ]
        written = ["-o", str(Path(folder) / "corrected.urdf"), "--force", "--quiet"]
        report = ["--report", str(Path(folder) / "report.html")]
        plan = ["plan", "ur3", "--base", "base", "--tip", "tool0", "--target", "70 -70 22.5 mm"]
        demo = ["demo", "--out", str(Path(folder) / "demo"), "--force", "--quiet"]
        commands = {
            '`python -c "import calib"`': [sys.executable, "-c", "import calib"],
            "`calib --help`": [calib, "--help"],
            "`calib calibrate` on the paper's 35 rows": [calib, *fitting, *written],
            "the same with `--report`": [calib, *fitting, *report, *written],
            "`calib demo`": [calib, *demo],
            "`calib plan`, 30 poses of 20,000": [calib, *plan, *written],
        }
        lines = ["| a whole process | time |", "|---|---|"]
        for name, command in track(commands.items(), "starts", console=BARS, transient=True):
            seconds = best(partial(subprocess.run, command, stdout=subprocess.DEVNULL), times)
            lines.append(f"| {name} | {seconds:.2f} s |")
    return lines


def amount(seconds: float) -> str:
    """A time in the unit that suits it."""
    return f"{1e3 * seconds:.3g} ms" if seconds < 1.0 else f"{seconds:.2f} s"


def write(name: str, lines: Sequence[str]) -> None:
    """Put a table between its marks in the docs."""
    text = PAGE.read_text(encoding="utf-8")
    begin, end = f"<!-- {name} -->", f"<!-- end of {name} -->"
    head, rest = text.split(begin)
    _, tail = rest.split(end)
    table = "\n".join(lines)
    PAGE.write_text(f"{head}{begin}\n\n{table}\n\n{end}{tail}", encoding="utf-8")


if __name__ == "__main__":
    main()
