"""Corrected programs on disk, by the command as a user runs it."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from calib.errors import CalibError
from calib.robot.robot import Robot
from calib.verbs.compensate.command import parse_pulses
from calib.verbs.compensate.programs.program_file import ProgramFile, ProgramText
from calib.verbs.compensate.programs.program_output import output_paths
from tests.places import ROOT

PROGRAM = """\
DEF line ( )
$TOOL={X 0,Y 0,Z 150,A 0,B 0,C 0}
BAS (#BASE,4)
PTP {A1 -40,A2 -85,A3 75,A4 -120,A5 -45,A6 0}
LIN XP1 ; here
LIN_REL {Z 10}
END
"""


@pytest.fixture
def folder(examples, tmp_path: Path) -> Path:
    """What a user has: robot, result, a program and its data list."""
    for name in ("robot.urdf", "result.json"):
        shutil.copy(examples.folder / name, tmp_path)
    robot = Robot.load(tmp_path / "robot.urdf", base="base", tip="tool0")
    T = robot.poses(np.radians([-42, -86, 76, -118, -44, 1]))[0]
    x, y, z = 1e3 * (T[:3, 3] + 0.15 * T[:3, 2])
    turn = np.arctan2(T[1, 0], T[0, 0]), -np.arcsin(T[2, 0]), np.arctan2(T[2, 1], T[2, 2])
    a, b, c = np.degrees(turn)
    pose = f"X {x:.3f},Y {y:.3f},Z {z:.3f},A {a:.3f},B {b:.3f},C {c:.3f}"
    (tmp_path / "line.src").write_text(PROGRAM)
    (tmp_path / "LINE.dat").write_text(f"DEFDAT LINE\nDECL E6POS XP1={{{pose}}}\nENDDAT\n")
    return tmp_path


ARGUMENTS = ("compensate", "robot.urdf", "line.src", "--calibration", "result.json")
FRAME = ("--frame", "4=0 0 0 mm 0 0 0 deg")


def test_a_program_and_its_data_list_are_written(call, folder: Path):
    (folder / "out").mkdir()
    done = call(folder, *ARGUMENTS, *FRAME, "-o", "out/new.src")
    assert (done.code, done.err) == (0, "")
    said = " ".join(done.out.split())
    assert "Corrected: 2 targets of 2 motions" in said
    assert "line.src: lines 4" in said
    assert "line 6 of line.src: LIN_REL" in said
    assert "Written: out/new.src" in said
    assert "Written: out/new.dat" in said
    old, new = PROGRAM.splitlines(), (folder / "out" / "new.src").read_text().splitlines()
    assert [k for k, (a, b) in enumerate(zip(old, new, strict=True)) if a != b] == [3]
    pattern = r"[-+]?\d+\.\d+"
    before, after = (
        [float(word) for word in re.findall(pattern, (folder / name).read_text())]
        for name in ("LINE.dat", "out/new.dat")
    )
    moved = np.linalg.norm(np.subtract(before, after)[:3])
    assert 0.5 < moved < 10.0


def test_what_is_missing_or_in_the_way_is_said(call, folder: Path):
    done = call(folder, *ARGUMENTS)
    assert done.code != 0
    assert '--frame "4=' in done.err
    done = call(folder, *ARGUMENTS, *FRAME, "-o", "line.src")
    assert done.code != 0
    assert (folder / "line.src").read_text() == PROGRAM
    done = call(folder, *ARGUMENTS, *FRAME, "-o", "new.csv")
    assert ".src" in done.err
    for words in (("--send", "joints"), ("--poses-in", "measured"), ("--columns", "x=-")):
        done = call(folder, *ARGUMENTS, *FRAME, *words)
        assert done.code != 0
        assert words[0] in done.err


def test_the_same_in_python(folder: Path, monkeypatch, capsys):
    text = (ROOT / "docs" / "programs.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    (folder / "prog.src").write_text(PROGRAM.replace("BAS (#BASE,4)", "$BASE=$WORLD"))
    shutil.copy(folder / "LINE.dat", folder / "prog.dat")
    monkeypatch.chdir(folder)
    exec(code, {})
    printed = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert [line[0] for line in printed] == ["4", "5"]
    assert all(float(line[1]) > 5e-4 and line[3] == "None" for line in printed)
    assert (folder / "corrected.dat").read_bytes() != (folder / "prog.dat").read_bytes()


def test_files_of_one_name_stay_together(tmp_path: Path):
    names = ("a/prog.src", "a/PROG.dat", "sys/$config.dat")
    program = ProgramFile(tuple(ProgramText(Path(name), "") for name in names), (), ())
    paths = output_paths(program, tmp_path / "new.SRC")
    assert [path.name for path in paths] == ["new.SRC", "new.dat", "$config.dat"]
    assert {path.parent for path in paths} == {tmp_path}


def test_pulses():
    names = [f"joint_{k}" for k in range(6)]
    found = parse_pulses([f"{axis}=1000 per deg" for axis in "SLURBT"], names)
    np.testing.assert_allclose(found, 6 * [1000 / np.radians(1)])
    assert parse_pulses([], names) == ()
    for wrong in (["S=1000 per deg"], ["S=1000"], ["S=x per deg"]):
        with pytest.raises(CalibError, match="--pulses"):
            parse_pulses(wrong, names)
