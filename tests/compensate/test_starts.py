from __future__ import annotations

import numpy as np
import pytest

from calib.compensate.inverse import Matching, solve
from calib.compensate.nominal_actual import Arm
from calib.compensate.starts import following, start_values
from calib.errors import ModelError
from calib.measure.ranges import column_limits
from calib.model.robot import Robot
from tests.compensate.arms import turned

POSE = Matching("pose", 0.01)

START = np.radians([-20.0, -80.0, 60.0, -70.0, -90.0, 10.0])


@pytest.fixture(scope="module")
def arm() -> Arm:
    robot = Robot.load("ur3", base="base", tip="tool0")
    return Arm.of(robot, turned(4, 0.1))


def path(arm: Arm, count: int) -> np.ndarray:
    """A straight line of 190 mm, orientation kept."""
    poses = np.tile(arm.poses(START[None])[0], (count, 1, 1))
    poses[:, :3, 3] += np.linspace(0.0, 1.0, count)[:, None] * [0.1, 0.15, -0.05]
    return poses


def test_near_is_the_solution_next_to_what_is_given(arm):
    wanted = path(arm, 5)
    found = solve(arm, wanted, np.tile(START, (5, 1)), POSE, column_limits(arm.robot))
    assert found.T_base_tool == pytest.approx(wanted, abs=1e-12)
    assert np.abs(found.q - START).max() < 0.7


def test_a_path_is_followed_in_one_branch(arm):
    wanted = path(arm, 700)
    told: list[tuple[int, int]] = []
    found = following(arm, wanted, START, POSE, lambda done, count: told.append((done, count)))
    assert told[-1] == (700, 700)
    assert sorted(told) == told
    assert found.T_base_tool == pytest.approx(wanted, abs=1e-9)
    assert found.q[0] == pytest.approx(START, abs=1e-9)
    steps = np.abs(np.diff(found.q, axis=0)).max(axis=1)
    assert steps.max() < 3.0 * np.median(steps)
    # Row by row, as a simple loop would.
    q = START[None]
    for T in wanted[::100]:
        q = solve(arm, T[None], q, POSE, column_limits(arm.robot)).q
    assert found.q[600] == pytest.approx(q[0], abs=1e-9)


def test_poses_far_from_each_other_are_found_all_the_same(arm):
    q = np.radians(
        [[20, -60, 70, -40, 60, 0], [150, -120, -70, 30, -60, 90], [-90, -20, 90, 0, 120, -100.0]]
    )
    found = following(arm, arm.poses(q), START, POSE)
    assert found.T_base_tool == pytest.approx(arm.poses(q), abs=1e-8)
    limits = column_limits(arm.robot)
    assert ((found.q >= limits[:, 0]) & (found.q <= limits[:, 1])).all()


def test_the_first_is_the_solution_nearest_to_the_start(arm):
    wanted = arm.poses(START[None])
    other = START + np.radians([0, 0, 0, 0, 0, -360.0])
    assert following(arm, wanted, other, POSE).q[0] == pytest.approx(other, abs=1e-9)
    # The wrist turned over is another way to hold the same pose.
    flipped = following(arm, wanted, START * [1, 1, 1, 1, -1, 1] + [0, 0, 0, 0, 0, np.pi], POSE).q[
        0
    ]
    assert arm.poses(flipped[None]) == pytest.approx(wanted[0][None], abs=1e-8)
    assert np.abs(flipped - START).max() > 1.0
    assert following(arm, wanted, flipped + 0.05, POSE).q[0] == pytest.approx(flipped, abs=1e-8)


def test_what_cannot_be_reached_is_as_near_as_was_found(arm):
    wanted = path(arm, 3)
    wanted[1, :3, 3] += 5.0
    found = following(arm, wanted, START, POSE)
    misses = POSE.misses(found.T_base_tool, wanted)[:, 0]
    assert misses[1] > 1.0
    assert misses[[0, 2]].max() < 1e-8


def test_the_start_is_named_or_in_the_middle(arm):
    values = start_values(arm.robot, {"elbow_joint": 0.3})
    assert values[2] == 0.3
    assert values[[0, 1, 3, 4, 5]] == pytest.approx(0.0)
    assert start_values(Robot.load("panda", tip="panda_link8"), None)[3] == pytest.approx(
        -1.5708, abs=0.1
    )


def test_a_start_of_a_joint_that_is_not_there_is_refused(arm):
    with pytest.raises(
        ModelError, match=r"no joints 'elbow' to start at; it has 'shoulder_pan_joint'"
    ):
        start_values(arm.robot, {"elbow": 0.3})
