"""Kill processes in the middle of writing and look at what they leave: the old file or the new one, and no other.

    python scripts/kill_writes.py --count 200 --seed 0

A process writes a file again and again, each time another version of it, and is killed by SIGKILL at a random moment,
``--count`` times for every kind of file: URDF, JSON, HTML, CSV and PNG by calib's own functions, and bytes alone, where
the moment nearly always falls into the writing itself; these also with the way for systems that have no files without
names. Leftovers are temporary files that were left; "after" are those that another write of the same file did not take
away. Last come two processes that write the same file at the same time. The exit code is 1 if any file was neither
version.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import calib
from calib.measure.measurements import Measurements
from calib.model.files import write_atomically
from calib.model.robot import Robot
from calib.show.figure_base import rendered
from calib.show.figures import drawings

Writer = Callable[[Path, int], object]

_ROOT = Path(__file__).resolve().parents[1]


def writers() -> dict[str, Writer]:
    """Each kind of output: a function that writes version 0 or 1 of it, over what is there."""
    robot = Robot.load(str(_ROOT / "urdf" / "ur3.urdf"), "base", "tool0")
    table = Measurements.read(_ROOT / "calib" / "data" / "ur3_leica.csv", robot.joint_names)
    both = [calib.calibrate(robot, table, model=model) for model in ("dh", "zeros")]
    half = [table, table.select(table.estimation)]
    drawn = [rendered(drawing, "png") for drawing in drawings(both[0])[:2]]
    with tempfile.TemporaryDirectory() as folder:
        reports = [
            one.write_report(Path(folder) / f"{k}.html").read_bytes() for k, one in enumerate(both)
        ]
    large = [bytes([65 + k]) * 5_000_000 for k in range(2)]
    return {
        "urdf": lambda path, k: both[k].write_urdf(path, overwrite=True),
        "json": lambda path, k: both[k].write_json(path, overwrite=True),
        "html": lambda path, k: write_atomically(path, reports[k], overwrite=True),
        "csv": lambda path, k: half[k].write(path, overwrite=True),
        "png": lambda path, k: write_atomically(path, drawn[k], overwrite=True),
        "bytes": lambda path, k: write_atomically(path, large[k], overwrite=True),
        "bytes, named": lambda path, k: _named(path, large[k]),
    }


def _named(path: Path, data: bytes) -> None:
    """Write as on systems that have no files without names."""
    if hasattr(os, "O_TMPFILE"):
        del os.O_TMPFILE
    write_atomically(path, data, overwrite=True)


def _child(write: Writer, path: Path) -> int:
    """A process that writes one version after the other until it is killed; its id."""
    process = os.fork()
    if process:
        return process
    try:
        while True:
            for k in (1, 0):
                write(path, k)
    finally:
        os._exit(1)


def killed(
    name: str, write: Writer, count: int, rng: random.Random, processes: int = 1
) -> tuple[str, bool]:
    """Kill so many writers; what there is to say, and whether all files were whole."""
    path = Path(tempfile.mkdtemp(prefix="calib-kill-")) / f"file.{name.partition(',')[0]}"
    versions = set()
    start = time.perf_counter()
    for k in (1, 0):
        write(path, k)
        versions.add(hashlib.sha256(path.read_bytes()).hexdigest())
    takes = (time.perf_counter() - start) / 2
    broken = left = 0
    seen: set[str] = set()
    before: set[str] = set()
    for _ in range(count):
        children = [_child(write, path) for _ in range(processes)]
        time.sleep(rng.uniform(0.0, 3.0 * takes))
        for child in children:
            os.kill(child, signal.SIGKILL)
        for child in children:
            os.waitpid(child, 0)
        now = hashlib.sha256(path.read_bytes()).hexdigest()
        broken += now not in versions
        seen.add(now)
        here = {other.name for other in path.parent.iterdir()}
        left += len(here - before - {path.name})
        before = here
    write(path, 0)
    after = sum(other != path for other in path.parent.iterdir())
    shutil.rmtree(path.parent)
    text = f"{name:<14}{count:>7}{broken:>9}{left:>11}{after:>7}{len(seen & versions):>10}{takes * 1e3:>12.1f}"
    return text, broken == 0


def main() -> int:
    """Kill and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--count", type=int, default=200, help="kills for each kind of file")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    rng = random.Random(asked.seed)
    print(
        f"{'file':<14}{'kills':>7}{'broken':>9}{'leftovers':>11}{'after':>7}{'versions':>10}{'write [ms]':>12}"
    )
    good = True
    every = writers()
    for name, write in every.items():
        if name == "bytes, named":  # last, for it takes O_TMPFILE away
            continue
        text, whole = killed(name, write, asked.count, rng)
        print(text, flush=True)
        good &= whole
    text, whole = killed("bytes, two", every["bytes"], asked.count, rng, processes=2)
    print(text, flush=True)
    good &= whole
    text, whole = killed("bytes, named", every["bytes, named"], asked.count, rng)
    print(text, flush=True)
    return 0 if good and whole else 1


if __name__ == "__main__":
    sys.exit(main())
