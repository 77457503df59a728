from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st

from calib.basics.arrays import rigid_inverse
from calib.robot.robot import Robot
from calib.verbs.convert.anchored_placements import anchored_placements

Z, Y = (0, 0, 1), (0, 1, 0)


def motion(axis, angle: float, shift) -> np.ndarray:
    """A turn about an axis and a shift."""
    T = np.eye(4)
    T[:3, :3] = pin.exp3(np.asarray(axis, dtype=float) * angle)
    T[:3, 3] = shift
    return T


def axes_of(robot: Robot) -> list[np.ndarray]:
    return [np.asarray(joint.axis) for joint in robot.joints]


def anchored(robot: Robot, nominal: Robot) -> Robot:
    return robot.with_placements(
        anchored_placements(robot.placements, nominal.placements, axes_of(nominal))
    )


def slid_and_turned(robot: Robot, angles, slides) -> np.ndarray:
    """Placements of the same robot, each joint's frame moved along and about its axis."""
    placements = np.array(robot.placements)
    for i, (joint, angle, slide) in enumerate(zip(robot.joints, angles, slides, strict=True)):
        G = motion(joint.axis, angle, joint.axis * slide)
        placements[i] = placements[i] @ G
        placements[i + 1] = rigid_inverse(G) @ placements[i + 1]
    return placements


def displaced(robot: Robot, size: float, seed: int = 5) -> Robot:
    """Every placement displaced a little."""
    twists = np.random.default_rng(seed).normal(size=(len(robot.placements), 6)) * size
    return robot.with_placements(
        np.array(
            [P @ pin.exp6(t).homogeneous for P, t in zip(robot.placements, twists, strict=True)]
        )
    )


def joint_values(robot: Robot, count: int = 5) -> np.ndarray:
    return np.random.default_rng(2).uniform(-2, 2, (count, len(robot.joint_names)))


@pytest.mark.parametrize("name", ["ur3", "panda"])
def test_wild_frames_come_back_to_where_they_were(name, request):
    robot = request.getfixturevalue(name)
    rng = np.random.default_rng(3)
    n = len(robot.joints)
    wild = slid_and_turned(robot, rng.uniform(-3, 3, n), rng.uniform(-400, 400, n))
    assert np.abs(wild[:, :3, 3] - robot.placements[:, :3, 3]).max() > 100
    back = anchored_placements(wild, robot.placements, axes_of(robot))
    np.testing.assert_allclose(back, robot.placements, rtol=0, atol=1e-10)


@settings(max_examples=25)
@given(
    named=st.lists(st.sampled_from(["z", "y", "odd"]), min_size=1, max_size=5),
    seed=st.integers(0, 1000),
)
def test_any_chain_keeps_its_poses(serial_urdf, named, seed):
    rng = np.random.default_rng(seed)
    axes = {"z": Z, "y": Y, "odd": (0.3, -0.5, 0.8)}
    joints = [
        (
            "revolute",
            rng.uniform(-0.4, 0.4, 3),
            rng.uniform(-1.5, 1.5, 3) * (rng.random() < 0.7),
            axes[name],
        )
        for name in named
    ]
    nominal = Robot.from_urdf(serial_urdf(joints))
    robot = displaced(nominal, 2e-3, seed)
    n = len(named)
    wild = slid_and_turned(robot, rng.uniform(-2, 2, n), rng.uniform(-4, 4, n))
    moved = robot.with_placements(wild)
    back = anchored(moved, nominal)
    q = joint_values(robot)
    np.testing.assert_allclose(back.poses(q), robot.poses(q), rtol=0, atol=1e-12)
    # Whatever frames the same robot came with, the result is one, and it is near.
    np.testing.assert_allclose(
        back.placements, anchored(robot, nominal).placements, rtol=0, atol=1e-11
    )
    assert np.abs(back.placements - nominal.placements).max() < 0.1
    np.testing.assert_allclose(anchored(back, nominal).placements, back.placements, atol=1e-12)


def test_a_joint_s_zero_stays_that_joint_s(ur3):
    angles = [0.01, -0.05, 0.08, -0.03, 0.02, 0.04]
    placements = np.array(ur3.placements)
    for i, (joint, angle) in enumerate(zip(ur3.joints, angles, strict=True)):
        placements[i] = placements[i] @ motion(joint.axis, angle, (0, 0, 0))
    robot = ur3.with_placements(placements)
    wild = slid_and_turned(robot, [1.0, 1.6, -1.7, 0.1, 2.0, -1.0], [0, 400, -390, -10, 0, 0])
    back = anchored(robot.with_placements(wild), ur3)
    np.testing.assert_allclose(back.placements, robot.placements, rtol=0, atol=1e-10)
