"""calib view: robots in the browser and as a page, from the real program."""

from __future__ import annotations

import http.client
import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest

from calib.cli.options import TableOptions
from calib.cli.verbs.view import FOUND, asked_view
from calib.data.cell import Cell
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


@pytest.mark.slow
def test_two_at_once_and_a_port_in_use(program, call, small):
    with running(program, small, "--no-browser") as (_, line):
        _, port = address(line)
        with running(program, small, "--no-browser") as (_, other):
            assert address(other)[1] != port
        done = call(small, "view", "small.urdf", "--port", str(port), "--no-browser")
    assert (done.code, done.out) == (1, "")
    assert done.err.startswith(f"calib: Port {port} of 127.0.0.1 cannot be used")


@pytest.mark.slow
def test_the_browser_is_opened_if_there_is_one(program, small):
    opener = small / "browser.py"
    opener.write_text("import sys; open('opened.txt', 'w').write(sys.argv[1])")
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    words = ("--port", str(port))
    with running(program, small, *words, BROWSER=f"{sys.executable} {opener} %s") as (
        process,
        line,
    ):
        assert address(line)[1] == port
        end = time.monotonic() + 10
        while not (small / "opened.txt").exists() and time.monotonic() < end:
            time.sleep(0.01)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=10)
    assert (small / "opened.txt").read_text() == f"http://127.0.0.1:{port}/"
    assert (process.returncode, out, err) == (0, "Stopped.\n", "")


@pytest.mark.slow
@pytest.mark.skipif(sys.platform in ("win32", "darwin"), reason="there is always a browser here")
def test_without_a_display_it_says_what_to_do(program, small):
    with running(program, small, BROWSER="") as (process, line):
        port = address(line)[1]
        said = process.stdout.readline()
        process.send_signal(signal.SIGINT)
        process.wait(10)
    assert said.startswith("No browser was found; open that address.")
    assert f"ssh -L {port}:127.0.0.1:{port} " in said


@pytest.mark.slow
def test_the_browser_sees_the_served_page(program, browser, small):
    with (
        running(program, small, "--no-browser") as (process, line),
        browser.open(address(line)[0], (640, 400)) as tab,
    ):
        assert tab.evaluate("document.querySelector('h1').textContent") == "small"
        first = tab.screenshot()
        tab.click("#forward")
        assert np.any(tab.screenshot() != first)
        assert tab.console == []
        assert tab.elsewhere == []
        process.send_signal(signal.SIGINT)
        assert process.wait(10) == 0
        tab.wait_for("document.body.textContent.includes('The server has stopped')")
        assert tab.console == []


def test_the_examples_write_pages(examples):
    one = examples.starting("calib view robot.urdf --base base -o")
    assert (one.code, one.out, one.err) == (0, "Written: robot.html\n", "")
    both = examples.starting("calib view robot.urdf --calibration result.json")
    assert (both.code, both.out) == (0, "Written: both.html\n")
    text = (examples.folder / "both.html").read_text(encoding="utf-8")
    assert "joint origins of result.json" in text
    assert "data-live" not in text
    assert "Verdict: use." in text


def asked_for(folder: Path, robot: str, cell: Cell | None = None, **sources):
    paths = {k: folder / v for k, v in sources.items() if k in ("data", "calibration")}
    other = str(folder / sources["other"]) if "other" in sources else None
    files = (str(folder / robot), other, paths.get("data"), paths.get("calibration"))
    found = ("frame",) if sources.get("target_given") else FOUND
    own = cell or Cell(base="base", tip="tool0")
    return asked_view(*files, own, TableOptions(), found=found)


def test_errors_are_those_of_the_result_and_its_flagged_rows_are_marked(examples, tmp_path):
    folder = examples.folder
    shown = asked_for(folder, "robot.urdf", calibration="result.json", data="data.csv")
    result = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    chosen = np.array(shown.kinds) == "validation"
    for k, who in enumerate(("nominal", "calibrated")):
        rms = np.sqrt(np.mean(shown.errors[k, chosen] ** 2))
        assert rms == pytest.approx(result["errors"][who]["validation"]["rms_m"], abs=1e-9)
    np.testing.assert_allclose(shown.distances, shown.errors, atol=1e-9)
    flagged = {one["row"] for one in (*result["outliers"], *result["suspects"])}
    marked = {f"row {row}" for row in flagged}
    assert marked
    assert {n for n, k in zip(shown.labels, shown.kinds, strict=True) if k == "flagged"} == marked
    # Row numbers of another table mean other rows.
    (tmp_path / "other.csv").write_bytes((folder / "data.csv").read_bytes() + b"\n")
    other = asked_for(folder, "robot.urdf", calibration="result.json", data=tmp_path / "other.csv")
    assert set(other.kinds) == {"estimation", "validation"}


def test_the_corrected_urdf_shows_the_same_two_robots(examples):
    folder = examples.folder
    one = asked_for(folder, "robot.urdf", calibration="result.json", data="data.csv")
    other = asked_for(folder, "corrected.urdf", calibration="result.json", data="data.csv")
    np.testing.assert_allclose(one.predicted, other.predicted, atol=1e-9)
    two = asked_for(folder, "robot.urdf", other="corrected.urdf")
    np.testing.assert_allclose(two.nominal.placements, one.nominal.placements, atol=1e-12)
    np.testing.assert_allclose(two.calibrated.placements, one.calibrated.placements, atol=1e-12)
    assert two.names == (("Nominal", "robot.urdf"), ("Calibrated", "corrected.urdf"))
    assert not two.measures
    alone = asked_for(folder, "robot.urdf", data="data.csv")
    assert (alone.title, alone.calibrated, alone.measures) == ("ur3", None, True)


def test_targets_are_the_result_s_or_the_line_s_or_the_urdf_s(examples):
    folder = examples.folder
    result = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    of_result = asked_for(folder, "robot.urdf", calibration="result.json")
    found = result["frames"]["target_m"]
    np.testing.assert_allclose(of_result.calibrated_target[0, :3, 3], found, atol=1e-12)
    own = Cell(base="base", tip="tool0").with_target([0.1, 0.2, 0.3])
    given = asked_for(folder, "robot.urdf", own, calibration="result.json", target_given=True)
    np.testing.assert_allclose(given.nominal_target[0, :3, 3], [0.1, 0.2, 0.3])
    alone = asked_for(folder, "target.urdf")
    assert alone.calibrated is None
    assert np.linalg.norm(alone.nominal_target[0, :3, 3]) == pytest.approx(0.1, abs=0.01)
    assert not asked_for(folder, "robot.urdf").nominal_target[0, :3, 3].any()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--port", "1", "-o", "x.html"), "--port is where the page is served, and -o writes it"),
        (("--points", "p.txt"), "--points says how a table is read; name the table with --data."),
        (("--columns", "a=b"), "--columns says how a table is read; name the table with --data."),
        (("--frame", "estimate"), "--frame says how a table is read; name the table with --data."),
        (("-o", "small.urdf"), "small.urdf is also an input of this command; choose another name."),
        (("-o", "there.html"), "there.html exists already; add --force or choose another name."),
        (("--port", "70000"), "The port was given as 70000; give a number from 1024 to 65535"),
        (("none.urdf",), "none.urdf"),
        (("--calibration", "none.json"), "none.json"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_refused(call, small, words, said):
    (small / "there.html").write_text("mine")
    done = call(small, "view", "small.urdf", *words)
    assert (done.code, done.out) == (1, "")
    assert done.err.startswith("calib: ")
    assert said in done.err
    assert (small / "there.html").read_text() == "mine"


def test_two_robots_with_other_joints_are_refused(call, small):
    (small / "other.urdf").write_text(SMALL.replace('"lift"', '"raise"'))
    done = call(small, "view", "small.urdf", "other.urdf", "-o", "x.html")
    assert (done.code, done.out) == (1, "")
    assert "'turn', 'lift'" in done.err
    assert "'turn', 'raise'" in done.err
    assert not (small / "x.html").exists()


def test_a_shape_that_cannot_be_drawn_is_named(call, small):
    visual = '<visual><geometry><mesh filename="none.stl"/></geometry></visual>'
    text = SMALL.replace('<link name="arm"/>', f'<link name="arm">{visual}</link>')
    (small / "small.urdf").write_text(text)
    done = call(small, "view", "small.urdf", "-o", "x.html")
    assert (done.code, done.err) == (0, "")
    assert done.out.startswith("Not drawn as in the URDF: link 'arm': the mesh 'none.stl' ")
    assert done.lines[-1] == "Written: x.html"
    many = "".join(visual.replace("none", f"none{i}") for i in range(5))
    (small / "small.urdf").write_text(text.replace(visual, many))
    done = call(small, "view", "small.urdf", "-o", "x.html", "--force")
    assert done.out.count("Not drawn as in the URDF:") == 3
    assert done.lines[-2:] == ["2 more are named on the page.", "Written: x.html"]
    assert call(small, "view", "small.urdf", "-o", "x.html", "--force", "--quiet").out == ""
