"""What several tests share: real robots, the paper's table, and small URDFs written on the spot."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator, Sequence

import hypothesis
import numpy as np
import pytest

import calib.example
from calib.data.measurements import Measurements
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf
from tests.browser import CHROMIUM, NEEDED, Browser
from tests.kept import FOLDER

# How long an example takes says nothing of what it checks, and on a busy machine 0.2 s are soon over. The same examples
# each time: a change is not refused for what it did not touch. HYPOTHESIS_SEED=random draws others.
hypothesis.settings.register_profile(
    "calib", deadline=None, derandomize=os.environ.get("HYPOTHESIS_SEED") != "random"
)
hypothesis.settings.load_profile("calib")

#: A plugin: a search for doctests would import it, and register its kinds for all tests of this process.
collect_ignore = ["many_units.py"]

#: Fixtures of calibrations, tables and virtual cells.
pytest_plugins = ["tests.fits", "tests.tracked", "tests.view_fixtures", "tests.cli_fixtures"]

JointSpec = tuple[str, Sequence[float], Sequence[float], Sequence[float]]


def pytest_configure() -> None:
    """Let Ctrl-C be heard: what a shell starts in the background ignores it, and so would the programs under test."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session", autouse=True)
def _folder_of_all_workers(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Where workers leave for each other what is expensive; pytest removes it after some runs."""
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = tmp_path_factory.getbasetemp().parent / "kept"
        folder.mkdir(exist_ok=True)
        FOLDER.append(folder)


@pytest.fixture(scope="session")
def ur3() -> Robot:
    """The paper's UR3, `base` to `tool0`."""
    return Robot.load(calib.example.paper_urdf(), base="base", tip="tool0")


@pytest.fixture(scope="session")
def panda() -> Robot:
    """The arm of the Panda, seven revolute joints."""
    return Robot.load("panda", base="panda_link0", tip="panda_link8")


@pytest.fixture(scope="session")
def paper_table() -> Measurements:
    """The paper's Table 2."""
    return Measurements.read(calib.example.paper_measurements())


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """Chromium, started once; ``with browser.open(url) as tab``."""
    if CHROMIUM is None:
        pytest.skip(NEEDED)
    browser = Browser()
    yield browser
    browser.close()


@pytest.fixture(scope="session")
def serial_urdf() -> Callable[..., Urdf]:
    """A function that writes the URDF of a serial chain, links ``l0`` to ``ln`` and, if wanted, ``tip``."""
    return _serial_urdf


def _serial_urdf(
    joints: Sequence[JointSpec],
    tip: tuple[Sequence[float], Sequence[float]] | None = ((0.1, 0.02, 0.05), (0.1, 0.2, 0.3)),
    extra: str = "",
) -> Urdf:
    """Joints ``j1`` to ``jn`` as (type, xyz, rpy, axis), then a fixed joint to the tip."""
    lines = ['<robot name="serial">', '<link name="l0"/>']
    for i, (kind, xyz, rpy, axis) in enumerate(joints, start=1):
        lines += [
            f'<link name="l{i}"/>',
            f'<joint name="j{i}" type="{kind}"><parent link="l{i - 1}"/><child link="l{i}"/>',
            f'<origin xyz="{_text(xyz)}" rpy="{_text(rpy)}"/><axis xyz="{_text(axis)}"/>',
            '<limit lower="-3" upper="3" effort="1" velocity="1"/></joint>',
        ]
    if tip is not None:
        lines += [
            '<link name="tip"/>',
            f'<joint name="jtip" type="fixed"><parent link="l{len(joints)}"/><child link="tip"/>',
            f'<origin xyz="{_text(tip[0])}" rpy="{_text(tip[1])}"/></joint>',
        ]
    return Urdf.from_bytes("\n".join([*lines, extra, "</robot>", ""]).encode(), "serial.urdf")


def _text(values: Sequence[float]) -> str:
    return " ".join(repr(float(v)) for v in np.asarray(values))
