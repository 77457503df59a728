"""``calib measure``: typed, piped, with a tracker's program, interrupted, and what a newcomer does wrong."""

from __future__ import annotations

import json
import re
import shlex
import socket
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.result.calibration import Calibration
from calib.robot.robot import Robot
from calib.verbs.measure.session import Session
from tests.cli_fixtures import PROGRAM, calib
from tests.verbs.measure.rehearsal import (
    WORDS,
    Terminal,
    Tracker,
    session_of,
    tracker_program,
)

START = ("measure", "s", "robot.urdf", *WORDS)

#: The answer to a stop.
ANSWER = r"^Stop \d+: (taken|good|NOT GOOD).*$"


@pytest.fixture
def arm(shop: Path) -> Robot:
    """The robot of the shop."""
    return Robot.load(shop / "robot.urdf", base="base", tip="tool0")


def piped(folder: Path, text: str, *words: str | Path) -> subprocess.CompletedProcess[str]:
    """Run the program with a text at its standard input."""
    return subprocess.run(
        [*PROGRAM, *map(str, words)],
        cwd=folder,
        input=text,
        capture_output=True,
        encoding="utf-8",
        timeout=120,
        check=False,
    )


def rows_of(arm: Robot, folder: Path, count: int) -> list[str]:
    """What is typed at the first poses of a session of the same seed."""
    tracker = Tracker(arm)
    rows = []
    with session_of(arm, folder) as session:
        for _ in range(count):
            q = session.next().joints
            rows.append(tracker.line(q))
            x, y, z = map(float, rows[-1].split())
            session.add({"x [mm]": x, "y [mm]": y, "z [mm]": z})
    return rows


@pytest.mark.slow
def test_rows_that_are_piped_and_the_calibration(shop: Path, arm):
    rows = rows_of(arm, shop / "other", 10)
    commands = [rows[0], "note the fan is on", "1 2", *rows[1:], "state"]
    out = ("-o", "new.urdf", "--json", "new.json")
    done = piped(shop, "\n".join(commands), *START, "--aim", "0.1 mm", *out)
    assert done.returncode == 0, done.stderr
    taken = re.findall(r"^Stop (\d+): (?:taken|good|NOT GOOD)", done.stdout, re.MULTILINE)
    assert [*map(int, taken)] == [*range(1, 11)]
    assert "'1 2' is not a row of the columns" in done.stdout
    assert " of 10 stops count" in done.stdout
    assert "Verdict:" in done.stdout
    assert "Written: new.urdf" in done.stdout
    with Session.open(shop / "s") as session:
        assert "the fan is on" in session.notes
        assert len(session.stops) == 10
        again = session.calibrate()
        command = session.robot_file
    # What the session calibrates, and its table and cell file do, is the same robot.
    result = Calibration.read_json(shop / "new.json")
    q = np.array([[0.3, -1.0, 0.5, 0.2, -0.4, 0.1]])
    assert result.predict_poses(q) == pytest.approx(again.predict_poses(q), abs=1e-9)
    assert command == str((shop / "robot.urdf").resolve())


@pytest.mark.slow
def test_the_command_at_the_end_calibrates_the_same_table(shop: Path, arm):
    rows = rows_of(arm, shop / "other", 10)
    done = piped(shop, "\n".join([*rows, "done", "7 8 9"]), *START, "--aim", "0.1 mm")
    assert done.returncode == 0
    assert "of 10 stops count. They are in s/measurements.csv, their cell in" in done.stdout
    words = shlex.split(done.stdout.splitlines()[-1])
    assert words[:2] == ["calib", "calibrate"]
    assert calib(shop, *words[1 : words.index("--report")]).code == 0
    assert json.loads((shop / "result.json").read_text())["model"]["set"] == "zeros"
    assert Cell.read(shop / "s" / "cell.toml").estimate_frame
    assert len(Measurements.read(shop / "s" / "measurements.csv")) >= 9


@pytest.mark.slow
def test_a_verdict_that_withholds_the_robot_is_the_exit_status(shop: Path, arm):
    rows = rows_of(arm, shop / "other", 6)
    bad = [f"{1.3 * float(x):.3f} {y} {z}" for x, y, z in (row.split() for row in rows)]
    text = "\n".join(bad)
    done = piped(shop, text, *START, "--aim", "0.1 mm", "-o", "new.urdf")
    assert done.returncode == 3
    assert not (shop / "new.urdf").exists()


@pytest.mark.slow
def test_a_person_types_in_a_terminal_leaves_by_ctrl_c_and_goes_on(shop: Path, arm):
    tracker = Tracker(arm)
    with Terminal(shop, *START, "--aim", "0.1 mm") as terminal:
        first = terminal.pose()
        terminal.type("help")
        terminal.until("take the last stop back")
        for typed, said in {
            "hello": "'hello' is neither a command nor a row of numbers",
            "0.8 0.1 0.2": "--unit m",
            "at 10 20": "is not where the robot stands",
            "note": "Write the remark after the word",
            "undo": "There is no stop to take back yet",
        }.items():
            terminal.pose()
            terminal.type(typed)
            terminal.until(said)
        terminal.pose()
        terminal.type("skip the table is in the way")
        q = terminal.pose()
        assert np.abs(q - first).max() > 0.01
        for _ in range(3):
            terminal.type(tracker.line(q))
            terminal.until(ANSWER)
            q = terminal.pose()
        terminal.type("undo")
        terminal.until("Stop 3 is taken back")
        q = terminal.pose()
        terminal.type(tracker.line(q))
        terminal.until(ANSWER)
        terminal.pose()
        began = time.monotonic()
        terminal.interrupt()
        assert terminal.ended() == 130
        assert time.monotonic() - began < 2.0
        end = terminal.text.splitlines()[-1]
    assert end.endswith("All 3 stops are kept in 's'. Go on with: calib measure s")
    with Terminal(shop, "measure", "s") as terminal:
        terminal.until("goes on with 3 stops")
        q = terminal.pose()
        for _ in range(12):
            terminal.type(tracker.line(q))
            if "aim is reached" in terminal.until(r"^Stop \d+[: ].*drive|aim is reached"):
                break
            q = terminal.pose()
        terminal.type("again")
        terminal.until("once more: drive the robot to the same pose")
        terminal.pose()
        terminal.type("quit")
        assert terminal.ended() == 0
    with Session.open(shop / "s") as session:
        assert "the table is in the way" in session.notes


@pytest.mark.slow
@pytest.mark.parametrize("how", ["file", "tcp"])
def test_a_session_of_twenty_poses_with_a_tracker_s_program(shop: Path, how: str):
    joints = shop / "joints.txt"
    joints.touch()
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    reader, where = f"file:{shop / 'points.txt'}", str(shop / "points.txt")
    if how == "tcp":
        reader, where = f"tcp:listen={port}", str(port)
    # So small an aim is never reached: the session ends when it is said.
    with Terminal(shop, *START, "--aim", "0.001 mm", "--reader", reader) as terminal:
        q = terminal.pose()
        with tracker_program(shop / "robot.urdf", joints, where) as tracker:
            began = 0.0
            for k in range(20):
                with joints.open("a", encoding="utf-8") as file:
                    file.write(" ".join(map(repr, q.tolist())) + "\n")
                answer = terminal.until(ANSWER)
                began = began or time.monotonic()  # the tracker's program has started by now
                assert "NOT GOOD" not in answer
                assert answer.startswith(f"Stop {k + 1}:")
                q = terminal.pose()
            assert time.monotonic() - began < 20.0
            with joints.open("a", encoding="utf-8") as file:
                file.write("over\n")
            tracker.wait(10)
        terminal.type("done")
        assert terminal.ended() == 0
    assert len(Measurements.read(shop / "s" / "measurements.csv")) == 20


@pytest.mark.slow
def test_a_rehearsal_ends_by_itself_where_nobody_can_type(shop: Path):
    done = piped(shop, "", *START, "--aim", "0.1 mm", "--reader", "virtual:3")
    assert done.returncode == 0
    assert "The aim is reached." in done.stdout
    assert "\x1b" not in done.stdout
    assert max(map(len, done.stdout.splitlines()[:-1])) <= 120
    done = piped(shop, "", "measure", "s", "--reader", "virtual:3")
    assert "goes on with" in done.stdout


# What a newcomer does wrong


def test_a_folder_is_needed(call, shop: Path):
    done = call(shop, "measure")
    assert done.code == 2
    assert "Missing argument 'FOLDER'" in done.err


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (
            ["s"],
            "There is no session in 's'. Name the robot to start one: calib measure s robot.urdf",
        ),
        (["s", "nothing.urdf"], "nothing.urdf"),
        ([*START[1:], "--aim", "0.15"], "--aim was given as"),
        ([*START[1:], "--aim", "2 deg"], "--aim was given as"),
        ([*START[1:], "--aim", "0.1 mm", "--as-good-as", "30"], "give one of them"),
        ([*START[1:], "--reader", "traker:1"], "traker"),
        ([*START[1:], "--reader", "watch:nowhere"], "needs a folder that exists"),
        ([*START[1:], "--controller", "abb"], "abb"),
        ([*START[1:], "--unit", "deg"], "not one of length"),
        ([*START[1:], "--region", "none.json"], "none.json"),
        ([*START[1:], "--start", "elbow=3 deg"], "elbow"),
        ([*START[1:], "-o", "data.csv"], "data.csv"),
    ],
)
def test_one_line_says_what_is_wrong(call, shop: Path, words, says):
    done = call(shop, "measure", *words)
    assert done.code == 1
    assert says in done.err
    assert len(done.err.splitlines()) == 1
    assert done.err.startswith("calib: ")
    assert not (shop / "s").exists() or "go on with: calib measure s" in done.err


def test_a_folder_with_a_session_goes_on_without_the_robot(call, shop: Path, arm):
    session_of(arm, shop / "s").close()
    done = call(shop, *START, "--reader", "virtual:3")
    assert done.code == 1
    assert (
        "'s' has a session already. Go on with it: calib measure s --reader virtual:3" in done.err
    )
    done = call(shop, "measure", "s", "--tip", "flange", "--aim", "0.2 mm", "--no-collisions")
    assert done.code == 1
    assert "--tip, --aim, --no-collisions belongs to the start" in done.err


def test_a_session_that_is_open_elsewhere_is_left_alone(call, shop: Path, arm):
    with session_of(arm, shop / "s"):
        done = call(shop, "measure", "s")
    assert done.code == 1
    assert len(done.err.splitlines()) == 1
