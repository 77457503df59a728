"""Feed the readers of calib with real files that were spoilt: each is read, or refused with a `CalibError`.

    python scripts/fuzz.py --count 1000
    python scripts/fuzz.py --reader table --seed 1

The exit code is 1 if anything else came of a file; the file's seed and number are printed.
"""

from __future__ import annotations

import argparse
import random
import re
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path

import calib
from calib.compensation.program import read_program
from calib.data.points_file import read_points
from calib.design.region import RegionFile
from calib.design.solids import read_solids
from calib.errors import CalibError
from calib.example import paper_measurements
from calib.formats.sources import Asked, read_source

ROOT = Path(__file__).resolve().parents[1]
ARM, DATA = str(ROOT / "urdf" / "ur3.urdf"), paper_measurements()
UR3 = calib.Robot.load(ARM, "base", "tool0")

#: What files are spoilt with.
WORDS = b'nan|1e999|-||0|null|{}|[]|"|<|>|\0|\xff|\r\n|,|;|[mm]|[deg]|x|set|mimic|*a'.split(b"|")


def read_robot(path: Path) -> None:
    """A URDF's chain and shapes, and a correction of it."""
    robot = calib.Robot.load(path)
    placements = robot.placements.copy()
    placements[[carrier is not None for carrier in robot.carriers], 0, 3] += 1e-4
    robot.with_placements(placements)
    read_solids(robot.urdf)


def convert(path: Path) -> object:
    """What ``calib convert`` reads."""
    return read_source(str(path), Asked(robot=ARM, base="base", tip="tool0"))


def cells() -> list[bytes]:
    """The cell files of docs/cell.md."""
    text = (ROOT / "docs" / "cell.md").read_text(encoding="utf-8")
    return [block.encode() for block in re.findall(r"```toml\n(.*?)```", text, re.DOTALL)]


def made(words: str) -> list[bytes]:
    """What a command of calib writes into the last file that it names."""
    program = [str(Path(sys.executable).with_name("calib")), *words.split()]
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(program, check=True, cwd=folder, stdout=subprocess.DEVNULL)
        return [(Path(folder) / program[-1]).read_bytes()]


FIT = f"fit {ARM} {DATA} --base base --tip tool0 --model dh --json r.json"
WORKSPACE = f"workspace {ARM} --base base --tip tool0 --samples 5000 -o w.json"
LIST = b"# Units: mm\nP1 100.5 200 300\nP2 -1 2e2 3.5\nP3 7 8 9\n"

#: Name of a file, what reads it, and what makes files that can be read.
READERS: dict[str, tuple[str, Callable[[Path], object], Callable[[], Sequence[bytes]]]] = {
    "urdf": ("r.urdf", read_robot, lambda: [Path(ARM).read_bytes()]),
    "table": ("t.csv", calib.Measurements.read, lambda: [DATA.read_bytes()]),
    "program": ("p.csv", lambda path: read_program(path, UR3), lambda: [DATA.read_bytes()]),
    "points": ("p.txt", lambda path: read_points(path, None), lambda: [LIST]),
    "cell": ("c.toml", calib.Cell.read, cells),
    "result": ("r.json", convert, lambda: made(FIT)),
    "origins": ("o.yaml", convert, lambda: [p.read_bytes() for p in ROOT.glob("urdf/*.yaml")]),
    "region": ("w.json", RegionFile.read, lambda: made(WORKSPACE)),
}


def spoilt(data: bytes, rng: random.Random) -> bytes:
    """A file with one to four faults: words put in, pieces taken out or doubled, numbers and bytes replaced."""
    for _ in range(rng.randint(1, 4)):
        start = rng.randrange(len(data) + 1)
        end = min(len(data), start + rng.choice((0, 1, 3, 20, 200)))
        numbers = [found.span() for found in re.finditer(rb"[\w.+-]+", data[start : start + 400])]
        kind = rng.randrange(5)
        if kind == 0 and numbers:  # a whole word
            first, last = rng.choice(numbers)
            data = data[: start + first] + rng.choice(WORDS) + data[start + last :]
        elif kind == 1:
            data = data[:start] + rng.choice(WORDS) + data[start:]
        elif kind == 2:
            data = data[:end] + data[start:]
        elif kind == 3:
            data = data[:start] + bytes(rng.randrange(256) for _ in range(end - start)) + data[end:]
        else:
            data = data[:start] + data[end:]
    return data


def findings(reader: str, count: int, seed: int = 0) -> list[str]:
    """What came of spoilt files but a value or a `CalibError`: number and trace of each."""
    name, read, make = READERS[reader]
    samples = make()
    found = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        for index in range(count):
            rng = random.Random(f"{seed} {index}")
            path.write_bytes(spoilt(rng.choice(samples), rng))
            try:
                read(path)
            except CalibError as error:
                if not str(error):
                    found.append(f"{index}: refused without a word")
            except Exception:  # noqa: BLE001  any other is a finding
                found.append(f"{index}: {traceback.format_exc()}")
    return found


def main() -> int:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--reader", action="append", choices=sorted(READERS), help="default all")
    parser.add_argument("--count", type=int, default=1000, help="files for each reader")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    failed = 0
    for name in asked.reader or READERS:
        found = findings(name, asked.count, asked.seed)
        failed += len(found)
        print(
            f"{name}: {asked.count} files, {len(found)} findings", *found[:5], sep="\n", flush=True
        )
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
