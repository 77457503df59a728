"""calib view: robots in the browser and as a page, from the real program."""

from __future__ import annotations

import http.client
import os
import re
import signal
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from tests.listening import listening

SMALL = """<robot name="small">
  <link name="floor"/><link name="arm"/><link name="hand"/>
  <joint name="turn" type="revolute"><parent link="floor"/><child link="arm"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <joint name="lift" type="prismatic"><parent link="arm"/><child link="hand"/><origin xyz="0.5 0 0"/>
    <axis xyz="0 0 1"/><limit lower="0" upper="1" effort="1" velocity="1"/></joint>
</robot>
"""


@pytest.fixture
def small(tmp_path: Path) -> Path:
    """A folder with the URDF of a robot without shapes, whose page is small."""
    (tmp_path / "small.urdf").write_text(SMALL)
    return tmp_path


@contextmanager
def running(program: list[str], folder: Path, *words: str, **environment: str) -> Iterator:
    """``calib view`` in a process of its own; it and the address that it prints."""
    surroundings = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    process = subprocess.Popen(
        [*program, "view", "small.urdf", *words],
        cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, encoding="utf-8",
        env={**surroundings, **environment},
    )  # fmt: skip
    try:
        yield process, process.stdout.readline()
    finally:
        process.kill()
        process.communicate()


def address(line: str) -> tuple[str, int]:
    """The address in what was printed, and its port."""
    url = re.search(r"http://127\.0\.0\.1:\d+/", line)[0]
    return url, urlsplit(url).port


def children(pid: int) -> list[str]:
    """The processes that a process has started."""
    return Path(f"/proc/{pid}/task/{pid}/children").read_text().split()


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="no /proc/net/tcp: not Linux")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_serves_this_computer_only_and_ends_at_once_with_nothing_left(program, small, number):
    with running(program, small, "--no-browser") as (process, line):
        url, port = address(line)
        assert line == f"The picture is at {url} on this computer. Ctrl-C stops it.\n"
        assert listening(process.pid) == [("127.0.0.1", port)]
        assert children(process.pid) == []
        connection = http.client.HTTPConnection("127.0.0.1", port)  # stays connected
        connection.request("GET", "/")
        answer = connection.getresponse()
        assert answer.status == 200
        assert b"data-live" in answer.read()
        start = time.monotonic()
        process.send_signal(number)
        out, err = process.communicate(timeout=10)
        assert time.monotonic() - start < 2.0
        connection.close()
    assert (process.returncode, out, err) == (0, "Stopped.\n", "")
    with socket.create_server(("127.0.0.1", port)):
        pass


def test_the_examples_write_pages(examples):
    one = examples.starting("calib view robot.urdf --base base -o")
    assert (one.code, one.out, one.err) == (0, "Written: robot.html\n", "")
    both = examples.starting("calib view robot.urdf --calibration result.json")
    assert (both.code, both.out) == (0, "Written: both.html\n")
    text = (examples.folder / "both.html").read_text(encoding="utf-8")
    assert "joint origins of result.json" in text
    assert "data-live" not in text
    assert "Verdict: use." in text
