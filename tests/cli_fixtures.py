"""The real program in a process of its own or in this one, and the examples of docs/command-line.md run once."""

from __future__ import annotations

import contextlib
import csv
import io
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.main import get_command

from calib.__main__ import main
from calib.example import paper_measurements, paper_urdf
from calib.program import app
from calib.robot.robot import Robot
from tests.places import ROOT
from tests.verbs.base_frame.virtual_sweeps import virtual_sweeps, write_sweeps
from tests.verbs.convert.ur_cases import CALIBRATIONS

DOCS = ROOT / "docs"

_INSTALLED = Path(sys.executable).with_name("calib")
PROGRAM = (
    [str(_INSTALLED)]
    if _INSTALLED.is_file()
    else [sys.executable, "-c", "from calib.__main__ import main; main()"]
)

Run = Callable[..., "Done"]


@dataclass(frozen=True)
class Done:
    """What a call of the program left: its exit code and what it printed."""

    code: int
    out: str
    err: str

    @property
    def lines(self) -> list[str]:
        return self.out.splitlines()


def calib(folder: Path, *words: str | Path) -> Done:
    """Run ``calib`` with these words in this folder."""
    done = subprocess.run(
        [*PROGRAM, *map(str, words)],
        cwd=folder,
        capture_output=True,
        encoding="utf-8",
        timeout=120,
        check=False,
    )
    return Done(done.returncode, done.stdout, done.stderr)


def calib_here(patch: pytest.MonkeyPatch, folder: Path, *words: str | Path) -> int:
    """The same within this process, which need not import everything anew; its exit code."""
    patch.chdir(folder)
    patch.setattr(sys, "argv", ["calib", *map(str, words)])
    patch.setattr("typer.main.get_command", lambda _: _command())
    with pytest.raises(SystemExit) as stopped:
        main()
    return int(stopped.value.code or 0)


@cache
def _command() -> Any:
    """The program's verbs and options: to build them takes longer than most calls."""
    return get_command(app)


def fill(folder: Path) -> Path:
    """The files that a user begins with: the paper's UR3, its table, and the first example of docs/cell.md."""
    shutil.copy(paper_urdf(), folder / "robot.urdf")
    shutil.copy(paper_measurements(), folder / "data.csv")
    text = (DOCS / "cell.md").read_text(encoding="utf-8")
    example = re.findall(r"```toml\n(.*?)```", text, re.DOTALL)[0]
    (folder / "cell.toml").write_text(example, encoding="utf-8")
    _split(folder)
    factory(folder)
    rows = "name,robot,data,target\nSN-1,robot.urdf,data.csv,\nSN-2,robot.urdf,data.csv,70 -70 22.5 mm\n"
    (folder / "manifest.csv").write_text(rows, encoding="utf-8")
    robot = Robot.load(paper_urdf(), base="base", tip="tool0")
    sweeps = virtual_sweeps(robot, np.eye(4), 3e-5, arcs=np.radians([270.0, 180.0]))
    write_sweeps(sweeps, folder / "sweeps.csv")
    return folder


def factory(folder: Path) -> None:
    """The calibration.conf of a UR3 as its factory wrote it."""
    delta = next(case for case in CALIBRATIONS if case["robot"] == "UR3")["delta"]
    lines = [f"delta_{key} = {delta[key]}" for key in ("theta", "a", "d", "alpha")]
    text = "\n".join(["[mounting]", *lines, ""])
    (folder / "calibration.conf").write_text(text, encoding="utf-8")


def _split(folder: Path) -> None:
    """The same measurements in two files: joints.csv, and tracker.txt as a laser tracker's program writes it."""
    with (folder / "data.csv").open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    places = [header.index(f"{name} [mm]") for name in "xyz"]
    joints = [[cell for i, cell in enumerate(row) if i not in places] for row in [header, *rows]]
    with (folder / "joints.csv").open("w", encoding="utf-8", newline="") as file:
        names = ["point", *(f"P{k}" for k in range(1, len(rows) + 1))]
        csv.writer(file).writerows([name, *row] for name, row in zip(names, joints, strict=True))
    points = [" ".join(row[i] for i in places) for row in rows]
    # Not in the order of the rows: the names say which is which.
    lines = [f"A::Main::P{k} {point}" for k, point in enumerate(points, 1)][::-1]
    text = "\n".join(["// Units: mm", *lines, ""])
    (folder / "tracker.txt").write_text(text, encoding="utf-8")


@pytest.fixture
def shop(tmp_path: Path) -> Path:
    """A folder of its own with robot.urdf, data.csv, the same as joints.csv and tracker.txt, and cell.toml."""
    return fill(tmp_path)


@dataclass(frozen=True)
class Examples:
    """The folder in which the examples ran, and what each of them left, by the call as it stands in the text."""

    folder: Path
    done: dict[str, Done]

    def starting(self, words: str) -> Done:
        """The first example that begins with these words."""
        return next(done for call, done in self.done.items() if call.startswith(words))


@pytest.fixture(scope="session")
def examples(tmp_path_factory: pytest.TempPathFactory) -> Examples:
    """Every example of docs/command-line.md, run in the order of the text in one folder."""
    folder = fill(tmp_path_factory.mktemp("examples"))
    text = (DOCS / "command-line.md").read_text(encoding="utf-8")
    calls = [
        line
        for block in re.findall(r"```sh\n(.*?)```", text, re.DOTALL)
        for line in block.splitlines()
    ]
    done = {}
    for call in calls:
        program, *words = shlex.split(call)
        assert program == "calib"
        with (
            pytest.MonkeyPatch.context() as patch,
            contextlib.redirect_stdout(io.StringIO()) as out,
            contextlib.redirect_stderr(io.StringIO()) as err,
        ):
            code = calib_here(patch, folder, *words)
        done[call] = Done(code, out.getvalue(), err.getvalue())
    return Examples(folder, done)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What asks for the examples waits half a minute for all of them: it is slow."""
    for item in items:
        if "examples" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.slow)


@pytest.fixture(scope="session")
def run() -> Run:
    """`calib`: a function of a folder and the words of a call."""
    return calib


@pytest.fixture(scope="session")
def program() -> list[str]:
    """How the program is started, for tests that start it themselves."""
    return PROGRAM


@pytest.fixture
def call(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """The same within this process: a tenth of the time, for the many calls that differ in one word."""

    def within(folder: Path, *words: str | Path) -> Done:
        capsys.readouterr()
        code = calib_here(monkeypatch, folder, *words)
        printed = capsys.readouterr()
        return Done(code, printed.out, printed.err)

    return within
