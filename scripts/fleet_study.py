"""200 virtual arms with errors of their own, some odd, calibrated serially and on a Dask cluster that is shot at.

    python scripts/fleet_study.py --out fleet-study --arms 200

The arms are UR3s with drawn errors, measured at 30 random poses with the noise of a laser tracker. Three are odd: one
was measured with five times the noise, one has an elbow whose zero is off by 3 degrees, and the table of one is
spoilt. They are calibrated one after the other, in worker processes, and by two Dask workers of which one is killed
(kill -9) when a third of the robots is done; another one then takes its place. All files are compared byte by byte.
The figures are in docs/fleet.md.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import replace
from pathlib import Path

import calib.data
from calib.cli.fleet_text import print_fleet
from calib.identify.dask_executor import dask_executor
from calib.identify.fleet import Fleet, FleetOptions, FleetRobot, fleet
from calib.identify.processes import process_executor
from calib.measure.cell import Cell
from calib.measure.noise import TrackerNoise
from calib.measure.scenario import Scenario
from calib.model.robot import Robot, read_only

#: Which arms are odd.
NOISY, OFFSET, SPOILT = 20, 21, 22

_CELL = Cell(base="base", tip="tool0", target=read_only([-0.07, 0.07, 0.0225]))
_POSES = 30


def main() -> None:
    """Make the arms, calibrate them in each way, compare."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("fleet-study"))
    parser.add_argument("--arms", type=int, default=200)
    parser.add_argument("--workers", type=int, default=3, help="worker processes of the second run")
    parser.add_argument("--reports", action="store_true", help="with a report for each arm")
    asked = parser.parse_args()
    shutil.rmtree(asked.out, ignore_errors=True)
    asked.out.mkdir(parents=True)
    robots = make_arms(asked.out, asked.arms)
    options = FleetOptions(reports=asked.reports, date="one date for all runs")
    serial = timed("one after the other", robots, asked.out / "serial", options)
    with process_executor(asked.workers) as executor:
        timed(f"{asked.workers} processes", robots, asked.out / "processes", options, executor)
    on_dask(robots, asked.out / "dask", options)
    print_fleet(serial)
    sums = {name: hashes(asked.out / name) for name in ("serial", "processes", "dask")}
    for name in ("processes", "dask"):
        same = sum(sums["serial"][path] == sums[name].get(path) for path in sums["serial"])
        print(
            f"{name}: {same} of {len(sums['serial'])} files are those of the serial run to the bit."
        )
    if not sums["serial"] == sums["processes"] == sums["dask"]:
        sys.exit("The files differ.")


def make_arms(folder: Path, count: int) -> list[FleetRobot]:
    """The arms' tables and one URDF, on the disk.

    Args:
        folder: Where to.
        count: How many.
    """
    shutil.copy(calib.data.paper_urdf(), folder / "robot.urdf")
    robot = Robot.load(folder / "robot.urdf", "base", "tool0")
    usual = Scenario(robot, cell=_CELL, model="dh")
    noisy = replace(usual, noise=TrackerNoise(5 * 15e-6, 5 * 6e-6, 5 * 20e-6))
    made = []
    for k in range(count):
        scenario = noisy if k == NOISY else usual
        if k == OFFSET:
            scenario = replace(usual, errors=(("theta3", 0.0524),))
        path = folder / f"arm-{k:03}.csv"
        scenario.draw(k).measure(usual.random_poses(_POSES, k), k).measurements.write(path)
        if k == SPOILT:
            path.write_bytes(path.read_bytes()[:700] + b"\xff" + path.read_bytes()[701:])
        made.append(FleetRobot.of_files(f"arm-{k:03}", folder / "robot.urdf", path, _CELL))
    return made


def timed(
    label: str,
    robots: list[FleetRobot],
    out: Path,
    options: FleetOptions,
    executor: Executor | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Fleet:
    """A run, and how long it took."""
    began = time.perf_counter()
    found = fleet(robots, out, options, executor=executor, progress=progress)
    seconds = time.perf_counter() - began
    print(f"{label}: {len(found.rows)} robots in {seconds:.1f} s", flush=True)
    return found


def on_dask(robots: list[FleetRobot], out: Path, options: FleetOptions) -> None:
    """The same on a scheduler with two workers; one is killed midway, and another one takes its place."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    started = [start("scheduler", "--host", "127.0.0.1", "--port", address.rpartition(":")[2])]
    words = ("worker", address, "--no-nanny", "--nthreads", "1")
    started += [start(*words), start(*words)]
    third = max(1, len(robots) // 3)

    def shoot(done: int, _: int) -> None:
        if done == third:
            started[1].kill()
            print(f"  kill -9 of a worker after {done} robots", flush=True)
            started.append(start(*words))

    try:
        with dask_executor(address) as executor:
            timed("two Dask workers, one killed", robots, out, options, executor, shoot)
    finally:
        for process in started:
            process.kill()
            process.wait()


def start(kind: str, *words: str) -> subprocess.Popen[bytes]:
    """`dask scheduler` or `dask worker`."""
    program = f"from distributed.cli.dask_{kind} import main; main()"
    return subprocess.Popen(
        [sys.executable, "-c", program, *words, "--no-dashboard"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(path or "." for path in sys.path)},
    )


def hashes(folder: Path) -> dict[str, str]:
    """The SHA-256 of each file."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


if __name__ == "__main__":
    main()
