"""Joint values at the targets of programs: those with which the poses were made, by Pinocchio's kinematics."""

from __future__ import annotations

import numpy as np
import pytest

from calib.errors import MeasurementError
from calib.robot.robot import Robot
from calib.verbs.compensate.programs.nominal_values import nominal_values
from tests.verbs.compensate.programs.plain import line_of, plain

ARM = Robot.load("ur5", base="base", tip="tool0")
Q = np.array([0.3, -1.2, 1.5, -1.0, -1.4, 0.4])


def test_joint_values_are_as_written():
    found = nominal_values(ARM, plain(line_of("J", Q)))
    np.testing.assert_allclose(found.q[0], Q, atol=1e-8)


def test_a_line_is_followed_from_joint_values():
    T = ARM.poses(Q)[0]
    ways = np.linspace(0.0, 0.25, 4)
    poses = np.tile(T, (4, 1, 1))
    poses[:, 2, 3] += ways
    text = line_of("J", Q) + "".join(line_of("L", pose) for pose in poses)
    found = nominal_values(ARM, plain(text))
    assert found.missing == (None,) * 5
    assert np.abs(np.diff(found.q[1:], axis=0)).max() < 0.5
    assert np.abs(found.q[1] - Q).max() < 1e-6
    np.testing.assert_allclose(ARM.poses(found.q[1:])[:, :3, 3], poses[:, :3, 3], atol=1e-7)


def test_the_first_pose_needs_a_start_or_configuration_data():
    text = line_of("P", ARM.poses(Q)[0])
    with pytest.raises(MeasurementError, match="--start"):
        nominal_values(ARM, plain(text))
    start = dict(zip(ARM.joint_names, Q + 0.2, strict=True))
    assert np.abs(nominal_values(ARM, plain(text), start).q[0] - Q).max() < 1e-6


def test_configuration_data_choose_branch_and_turn():
    turned = Q - np.array([0, 0, 0, 0, 0, 2 * np.pi])
    text = line_of("P", ARM.poses(Q)[0])

    def near(values: np.ndarray):
        return lambda _: lambda q: np.abs(q - values).max(axis=1) < 0.3

    found = nominal_values(ARM, plain(text, configuration=near(turned)))
    assert np.abs(found.q[0] - turned).max() < 1e-6
    found = nominal_values(ARM, plain(text, configuration=near(Q + 0.8)))
    assert found.missing == ("configuration",)


def test_what_follows_a_target_without_configuration_is_not_known_either():
    T = ARM.poses(Q)[0]
    near = T.copy()
    near[2, 3] += 0.01
    text = line_of("P", T) + line_of("L", near) + line_of("J", Q) + line_of("L", near)
    program = plain(
        text, configuration=lambda line: (lambda q: np.zeros(len(q), bool)) if line == 1 else None
    )
    assert nominal_values(ARM, program).missing == ("configuration", "configuration", None, None)


def test_a_pose_beyond_the_reach():
    T = ARM.poses(Q)[0].copy()
    T[0, 3] += 3.0
    text = line_of("J", Q) + line_of("L", T) + line_of("L", ARM.poses(Q)[0])
    assert nominal_values(ARM, plain(text)).missing == (None, "unreachable", None)


def test_seven_joints_stay_near_the_motion_before():
    panda = Robot.load("panda", tip="panda_link8")
    q = np.array([0.1, -0.5, 0.2, -2.0, 0.1, 1.6, 0.5])
    T = panda.poses(q)[0].copy()
    T[0, 3] -= 0.05
    found = nominal_values(panda, plain(line_of("J", q) + line_of("L", T)))
    assert np.abs(found.q[1] - q).max() < 0.3
    np.testing.assert_allclose(panda.poses(found.q[1:])[0], T, atol=1e-6)
