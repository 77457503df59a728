"""The shortest way through the solutions of all poses."""

from __future__ import annotations

import numpy as np
import pytest

from calib.robot.robot import Robot
from calib.verbs.joints.branches import detours, unwound, ways


@pytest.fixture(scope="module")
def robot() -> Robot:
    return Robot.load("ur5", base="base", tip="tool0")


def row(value: float) -> list[float]:
    return [0.0, 0.0, 0.0, 0.0, 0.0, value]


def test_each_solution_of_the_pose_with_the_fewest_has_a_way(robot: Robot):
    # Two branches, the second one a radian away; the last pose shows one of them alone.
    solutions = [np.array([row(1.0 + t), row(t)]) for t in (0.0, 0.1, 0.3)] + [np.array([row(1.2)])]
    (way,) = ways(robot, solutions)
    np.testing.assert_array_equal(way, [0, 0, 0, 0])
    # In the middle it would go there and back: 0.9 + 1.2 in place of 0.1 + 0.2.
    np.testing.assert_allclose(detours(robot, solutions, way), [1.0, 1.8, 1.4, np.inf])

    both = ways(robot, solutions[:3])
    assert [list(way) for way in both] == [[0, 0, 0], [1, 1, 1]]
    wrong = np.array([0, 1, 0])
    assert detours(robot, solutions[:3], wrong)[1] < 0.0


def test_a_way_goes_across_whole_turns_where_the_joint_may(robot: Robot):
    solutions = [np.array([row(3.1)]), np.array([row(-3.1), row(2.0)])]
    (way,) = ways(robot, solutions)
    assert list(way) == [0, 0]
    q, _ = unwound(robot, np.array([row(3.1), row(-3.1)]))
    # Of both turns that the limits allow the one nearer to zero.
    np.testing.assert_allclose(q[:, 5], [3.1 - 2.0 * np.pi, -3.1])


def test_turns_that_the_limits_leave_open_are_named(robot: Robot):
    q, names = unwound(robot, np.array([row(0.1), row(0.2)]))
    np.testing.assert_allclose(q[:, 5], [0.1, 0.2])
    # There are two turns between the limits of each joint but the elbow's.
    assert {*names} == {*robot.joint_names} - {"elbow_joint"}
    far = np.array([row(value) for value in np.linspace(-5.0, 5.0, 9)])
    assert "wrist_3_joint" not in unwound(robot, far)[1]
    panda = Robot.load("panda", tip="panda_link8", held={"panda_joint3": 0.1})
    assert unwound(panda, np.zeros((2, 6)))[1] == ()
