"""The paper's UR3."""

from __future__ import annotations

import pytest

from calib.example import paper_urdf
from calib.robot.robot import Robot


@pytest.fixture(scope="session")
def ur3() -> Robot:
    return Robot.load(paper_urdf(), base="base", tip="tool0")
