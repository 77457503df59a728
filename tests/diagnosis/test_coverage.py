"""What a result rests on: rows outside of the measured poses, and corners of workspaces."""

from __future__ import annotations

import numpy as np
import pytest

from calib.data.measurements import Measurements
from calib.diagnosis.coverage import outside, spread_of
from calib.example import paper_measurements
from calib.robot.robot import Robot

TYPES = ("revolute",) * 6


def drawn(robot: Robot, count: int, seed: int) -> np.ndarray:
    """Joint values all over the limits."""
    return np.random.default_rng(seed).uniform(*limits(robot).T, (count, len(robot.joint_names)))


def limits(robot: Robot) -> np.ndarray:
    return np.array([(max(j.lower, -np.pi), min(j.upper, np.pi)) for j in robot.joints])


def tips(robot: Robot, q: np.ndarray) -> np.ndarray:
    return robot.poses(q)[:, :3, 3]


def spread(robot: Robot, q: np.ndarray) -> float:
    return spread_of(tips(robot, q), tips(robot, drawn(robot, 2000, 0)))


@pytest.fixture(scope="module")
def paper_joints(ur3):
    table = Measurements.read(paper_measurements(), ur3.joint_names, ur3.joint_types)
    return table.joints_for(ur3.joint_names)


def test_the_paper_s_last_rows_lie_outside(ur3, paper_joints):
    """Rows 34 and 35 ask for joint values far from those of rows 1 to 30."""
    found = outside(paper_joints[:30], paper_joints[30:], ur3.joint_names, TYPES)
    numbers = np.arange(31, 36)
    rows = [int(numbers[row.index]) for row in found]
    assert {34, 35} <= set(rows)
    for row in found:
        asked = paper_joints[30 + row.index]
        for b in row.beyond:
            j = ur3.joint_names.index(b.joint)
            low, high = paper_joints[:30, j].min(), paper_joints[:30, j].max()
            assert b.by == pytest.approx(max(low - asked[j], asked[j] - high))
            assert b.by > 0.05 * (high - low)


def test_a_margin_of_a_twentieth_is_allowed():
    measured = np.array([[0.0, 0.0], [1.0, 2.0]])
    asked = np.array([[1.049, 2.09], [1.051, -0.09], [0.5, 2.11], [-0.2, -0.3]])
    found = outside(measured, asked, ("a", "b"), ("revolute", "prismatic"))
    assert [row.index for row in found] == [1, 2, 3]
    assert found[0].beyond[0].by == pytest.approx(0.051)
    # The worst in shares of its range comes first.
    assert [b.joint for b in found[2].beyond] == ["a", "b"]


def test_continuous_joints_are_measured_on_a_circle():
    measured = np.radians([[170.0], [-175.0], [150.0], [-160.0]])
    asked = np.radians([[185.0], [-180.0], [540.0], [140.0], [-100.0], [260.0]])
    found = outside(measured, asked, ("a",), ("continuous",))
    assert [row.index for row in found] == [3, 4, 5]
    np.testing.assert_allclose([np.degrees(r.beyond[0].by) for r in found], [10, 60, 60])
    # The same values of a joint with limits are far apart.
    assert [row.index for row in outside(measured, asked[:3], ("a",), ("revolute",))] == [2]


def test_the_paper_s_poses_are_no_corner(ur3, paper_joints):
    assert 0.38 < spread(ur3, paper_joints[:30]) < 0.5
