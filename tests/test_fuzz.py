"""Spoilt files: each reader reads them or refuses them with a `CalibError`, nothing else."""

from __future__ import annotations

import contextlib
import json
import random
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.data.points_file import read_points
from calib.errors import CalibError
from calib.example import paper_measurements, paper_urdf
from calib.verbs.compensate.program_table import read_program
from calib.verbs.compensate.programs.dialects import read_program_file
from calib.verbs.compensate.programs.program_file import Stated
from calib.verbs.convert.convert import KINDS, source_kind
from calib.verbs.convert.format import Options
from calib.verbs.plan.solids import read_solids
from calib.verbs.workspace.region_file import read_region
from tests.parts import of_an_earlier_version
from tests.places import ROOT

ARM, DATA = str(paper_urdf()), paper_measurements()

#: What files are spoilt with.
WORDS = b'nan|1e999|-||0|null|{}|[]|"|<|>|\0|\xff|\r\n|,|;|[mm]|[deg]|x|set|mimic|*a'.split(b"|")


def read_robot(path: Path) -> None:
    robot = calib.Robot.load(path)
    placements = robot.placements.copy()
    placements[[carrier is not None for carrier in robot.carriers], 0, 3] += 1e-4
    robot.with_placements(placements)
    read_solids(robot.urdf)


def convert(path: Path) -> object:
    return KINDS[source_kind(str(path))].read(
        str(path), Options(robot=ARM, base="base", tip="tool0")
    )


def program(path: Path) -> object:
    return read_program(path, calib.Robot.load(ARM, "base", "tool0"))


def robot_program(path: Path) -> object:
    """A program in its maker's language, also beside a whole data list."""
    robot = calib.Robot.load(ARM, "base", "tool0")
    pose = {"": np.eye(4)}
    with contextlib.suppress(CalibError):
        read_program_file(path, Stated(robot.joint_names))
    stated = Stated(robot.joint_names, pose, pose, pulses=(1e5,) * 6, robot=robot)
    return read_program_file(path, stated)


def programs_of(pattern: str):
    """The programs of the tests of a dialect, by a pattern of their paths."""
    folder = ROOT / "tests" / "verbs" / "compensate" / "programs" / "data"
    return lambda _: [path.read_bytes() for path in sorted(folder.glob(pattern))]


def cells(_: Path) -> list[bytes]:
    text = (ROOT / "docs" / "cell.md").read_text(encoding="utf-8")
    return [block.encode() for block in re.findall(r"```toml\n(.*?)```", text, re.DOTALL)]


def made(words: str):
    """What a command of calib writes into the last file that it names."""

    def make(folder: Path) -> list[bytes]:
        command = [str(Path(sys.executable).with_name("calib")), *words.split()]
        subprocess.run(command, check=True, cwd=folder, stdout=subprocess.DEVNULL)
        return [(folder / command[-1]).read_bytes()]

    return make


def results(folder: Path) -> list[bytes]:
    """A result, and that of an earlier version, which no checksum keeps from its reader."""
    (result,) = made(CALIBRATE)(folder)
    return [result, json.dumps(of_an_earlier_version(json.loads(result))).encode()]


CALIBRATE = f"calibrate {ARM} {DATA} --base base --tip tool0 --model dh --json r.json"
WORKSPACE = f"workspace {ARM} --base base --tip tool0 --samples 5000 -o w.json"
LIST = b"# Units: mm\nP1 100.5 200 300\nP2 -1 2e2 3.5\nP3 7 8 9\n"

#: Name of a file, what reads it, and what makes files that can be read.
READERS = [
    ("r.urdf", read_robot, lambda _: [Path(ARM).read_bytes()]),
    ("t.csv", calib.Measurements.read, lambda _: [DATA.read_bytes()]),
    ("p.csv", program, lambda _: [DATA.read_bytes()]),
    ("p.txt", lambda path: read_points(path, None), lambda _: [LIST]),
    ("c.toml", calib.Cell.read, cells),
    ("r.json", convert, results),
    ("o.yaml", convert, lambda _: [p.read_bytes() for p in ROOT.glob("urdf/*.yaml")]),
    ("w.json", read_region, made(WORKSPACE)),
    ("k.src", robot_program, programs_of("kuka/*.src")),
    ("k.SRC", robot_program, programs_of("kuka/*.dat")),
    ("p.ls", robot_program, programs_of("fanuc/*.ls")),
    ("p.jbi", robot_program, programs_of("yaskawa/*.jbi")),
]


def spoilt(data: bytes, rng: random.Random) -> bytes:
    """A file with one to four faults: words put in, pieces taken out or doubled, numbers and bytes replaced."""
    for _ in range(rng.randint(1, 4)):
        start = rng.randrange(len(data) + 1)
        end = min(len(data), start + rng.choice((0, 1, 3, 20, 200)))
        numbers = [found.span() for found in re.finditer(rb"[\w.+-]+", data[start : start + 400])]
        first, last = rng.choice(numbers or [(0, 0)])
        noise = bytes(rng.randrange(256) for _ in range(end - start))
        word = rng.choice(WORDS)
        data = rng.choice(
            [
                data[: start + first] + word + data[start + last :],
                data[:start] + word + data[start:],
                data[:end] + data[start:],
                data[:start] + noise + data[end:],
                data[:start] + data[end:],
            ]
        )
    return data


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "read", "make"), READERS, ids=lambda x: x if isinstance(x, str) else ""
)
def test_spoilt_files_are_read_or_refused(name, read, make, tmp_path, request):
    samples = make(tmp_path)
    for index in range(200):
        rng = random.Random(f"{request.node.name} {index}")
        (tmp_path / name).write_bytes(spoilt(rng.choice(samples), rng))
        with contextlib.suppress(CalibError):
            read(tmp_path / name)
