"""What is said of commands: each code in words."""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest

from calib.compensation.commands import Code, Finding
from calib.robot.robot import Robot
from calib.text.compensation import _TEXTS, finding_text


@pytest.mark.parametrize(
    ("finding", "said"),
    [
        (Finding("unreachable", (1e-3, np.radians(2))), "cannot reach it: 1.0000 mm, 2.0000 deg would be left"),
        (Finding("unreachable", (1e-3, np.nan)), "cannot reach it: 1.0000 mm would be left"),
        (Finding("beyond limit", (np.radians(370), np.radians(360)), "elbow_joint"),
         "'elbow_joint' would have to be at 370.0000 deg, beyond its limit 360.0000"),
        (Finding("jump", (np.radians(20),), "elbow_joint", "row 4"), "a jump: from row 4 'elbow_joint' moves 20.0 deg"),
    ],
)  # fmt: skip
def test_codes_in_words(ur3: Robot, finding: Finding, said: str):
    assert said in finding_text(finding, ur3)


def test_every_code_has_words():
    assert tuple(_TEXTS) == get_args(Code)
