"""What cells, regions, sweeps and virtual cells refuse, in full: what was given, what is allowed, the fix."""

from __future__ import annotations

import re

import numpy as np
import pytest

from calib.errors import CalibError
from calib.measure.ranges import joint_ranges
from calib.units import parse_joint_value


def refused(kind: type[CalibError], text: str):
    """The whole message, as it is printed."""
    return pytest.raises(kind, match=f"^{re.escape(text)}$")


def arc(angles: np.ndarray, radius: float = 1.0) -> np.ndarray:
    return radius * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(len(angles))])


def test_ranges_of_joints(ur3):
    with refused(
        CalibError,
        "The range given for the joint 'elbow_joint' is a length, and the joint turns; give an "
        'angle, such as "30 deg".',
    ):
        joint_ranges(ur3, {"elbow_joint": (parse_joint_value("1 mm", ""), 2.0)})
    with refused(
        CalibError,
        "The range of 'elbow_joint' is -229.183 to 114.592 deg; its limits in the URDF are -180 to "
        "180 deg. Give a range inside.",
    ):
        joint_ranges(ur3, {"elbow_joint": (-4.0, 2.0)})
