"""What tests measure: a virtual robot whose joint zeros are wrong, and the terminal that a person sits at."""

from __future__ import annotations

import contextlib
import fcntl
import os
import pty
import re
import select
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from calib.basics.arrays import Array
from calib.data.cell import Cell
from calib.robot.robot import Robot
from calib.verbs.measure.aim import Aim
from calib.verbs.measure.devices.readers import open_reader
from calib.verbs.measure.devices.reading import Context
from calib.verbs.measure.session import Session
from tests.cli_fixtures import PROGRAM
from tests.places import ROOT

#: Few stops tell the zeros.
CELL = Cell(base="base", tip="tool0", estimate_frame=True, model="zeros")

#: The same on the command line, without a look at collisions.
WORDS = (
    *("--base", "base", "--tip", "tool0", "--frame", "estimate"),
    *("--model", "zeros", "--no-collisions"),
)

#: Control sequences of a terminal.
_ESCAPES = re.compile(r"\x1b\[[0-9;?]*[a-zA-Z]")

#: A joint value as it is shown.
_SHOWN = re.compile(r"^  (\S+) +(-?\d+\.\d{3}) deg$", re.MULTILINE)


def session_of(robot: Robot, folder: Path, cell: Cell = CELL, aim: float = 1e-4) -> Session:
    """A session that begins at once: collisions are not looked at."""
    return Session.start(folder, robot, cell, Aim(error=aim), collisions=False)


class Tracker:
    """What a tracker reads of the virtual robot of a seed, in the order of the targets."""

    def __init__(self, robot: Robot, cell: Cell = CELL, seed: int = 3) -> None:
        self._instrument: Any = open_reader(
            f"virtual:{seed}",
            Context(robot.joint_names, robot.joint_types, robot=robot, cell=cell),
        )

    def points(self, q: Array) -> list[tuple[float, float, float]]:
        """The points at joint values (m,) [rad], in mm."""
        self._instrument.propose(q)
        rows = self._instrument.read(1.0).rows
        return [tuple(float(row[f"{axis} [mm]"]) for axis in "xyz") for row in rows]  # type: ignore[misc]

    def line(self, q: Array) -> str:
        """The point of the first target as a person types it."""
        return " ".join(f"{value:.4f}" for value in self.points(q)[0])


class Terminal:
    """The program in a terminal of 100 columns, in a process of its own."""

    def __init__(self, folder: Path, *words: str | Path) -> None:
        self._end, theirs = pty.openpty()
        fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 40, 100, 0, 0))
        self.process = subprocess.Popen(
            [*PROGRAM, *map(str, words)],
            cwd=folder,
            stdin=theirs,
            stdout=theirs,
            stderr=theirs,
            start_new_session=True,
            preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),  # for Ctrl-C
            env={**os.environ, "TERM": "xterm-256color", "PYTHONPATH": str(ROOT)},
        )
        os.close(theirs)
        self._raw = b""
        self._read = 0

    def __enter__(self) -> Terminal:
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait(10)
        os.close(self._end)

    @property
    def text(self) -> str:
        """All that was shown, without control sequences."""
        return _ESCAPES.sub("", self._raw.decode("utf-8", "replace")).replace("\r", "")

    def until(self, pattern: str, seconds: float = 60.0) -> str:
        """Wait until something is shown after what was waited for before, and return it."""
        ends = time.monotonic() + seconds
        while True:
            found = re.compile(pattern, re.MULTILINE).search(self.text, self._read)
            if found is not None:
                self._read = found.end()
                return found[0]
            if time.monotonic() > ends or not self._take(0.1):
                raise AssertionError(f"{pattern!r} was not shown in\n{self.text[self._read :]}")

    def pose(self) -> Array:
        """Wait until a pose is shown and asked for, and return its joint values [rad]."""
        self.until(r"\]> $|waiting for|Press Enter")
        return np.radians([float(value) for _, value in _SHOWN.findall(self.text)[-6:]])

    def type(self, line: str) -> None:
        os.write(self._end, f"{line}\n".encode())

    def interrupt(self) -> None:
        """Type Ctrl-C."""
        os.write(self._end, b"\x03")

    def ended(self, seconds: float = 60.0) -> int:
        """Wait for the end of the program, and return its exit status."""
        ends = time.monotonic() + seconds
        while self._take(0.1):
            assert time.monotonic() < ends, self.text
        return self.process.wait(10)

    def _take(self, seconds: float) -> bool:
        """Take what is shown; False at the end."""
        if select.select([self._end], [], [], seconds)[0]:
            piece = b""
            with contextlib.suppress(OSError):  # the other side has closed
                piece = os.read(self._end, 65536)
            self._raw += piece
            return bool(piece)
        return self.process.poll() is None


def tracker_program(robot: Path, joints: Path, where: str) -> subprocess.Popen[bytes]:
    """Start a tracker's program: it measures where the robot stands, which a file says, and passes the points on.

    Args:
        robot: The URDF.
        joints: File to which the test appends a line of joint values [rad] when the robot stands at a pose.
        where: File to which points are appended, or port to which they are sent.
    """
    words = [sys.executable, "-m", "tests.verbs.measure.rehearsal", robot, joints, where]
    return subprocess.Popen(words, cwd=ROOT)


def _measure(words: Sequence[str]) -> None:
    """Be the tracker's program, until the file of joint values says that it is over."""
    import socket

    robot, joints, where = words
    tracker = Tracker(Robot.load(robot, base="base", tip="tool0"))
    connection = None
    if where.isdigit():
        connection = socket.create_connection(("127.0.0.1", int(where)))
    measured = 0
    while True:
        lines = Path(joints).read_text(encoding="utf-8").splitlines(keepends=True)
        lines = [line for line in lines if line.endswith("\n")]
        for line in lines[measured:]:
            if line == "over\n":
                return
            row = tracker.line(np.array([float(word) for word in line.split()])) + "\n"
            if connection is not None:
                connection.sendall(row.encode())
            else:
                with Path(where).open("a", encoding="utf-8") as file:
                    file.write(row)
        measured = len(lines)
        time.sleep(0.02)


if __name__ == "__main__":
    _measure(sys.argv[1:])
