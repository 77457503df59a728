"""The arithmetic against Pinocchio: forward kinematics and placement regressor, one sample after the other."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from calib.basics.arrays import rigid_inverse
from calib.model.joint_errors import axis_twists, joint_displacements
from calib.model.kinematics import Kinematics, Samples
from calib.model.parameter_sets import error_model
from calib.robot import kernel
from calib.robot.chain import pinocchio_chain
from calib.robot.robot import Robot
from tests.model.test_kinematics import CHAINS, pose, robots  # noqa: F401

Array = np.ndarray
FAMILIES = "+gain+eccentricity+compliance"
NAMES = ("ur3", "panda", "prismatic", "mimic", "tiago_held", *CHAINS)


def seen(robot: Robot, model: str, seed: int, count: int = 150) -> tuple[Kinematics, Samples]:
    """Two frames and two targets, each with an orientation, at random joint values."""
    rng = np.random.default_rng(seed)
    directions = ("x", "y", "z", "rx", "ry", "rz")
    own = error_model(
        robot,
        model,
        frame={"a": directions, "b": directions[1:4]},
        target=("left", "right"),
        targets=("left", "right"),
        rotation=True,
    )
    kinematics = Kinematics(
        robot, own, np.array([pose(1), pose(2)]), np.array([pose(3, 0.2), pose(4, 0.2)])
    )
    samples = Samples(
        rng.uniform(-3.0, 3.0, (count, len(robot.joint_names))),
        rng.integers(0, 2, count),
        rng.integers(0, 2, count),
        rng.normal(0.0, 20.0, (count, len(robot.joints), len(robot.joints) + 3)),
    )
    return kinematics, samples


def by_pinocchio(kinematics: Kinematics, x: Array, samples: Samples) -> tuple[Array, Array]:
    """T_frame_target and the target's twists, by Pinocchio's regressor and the action matrices of poses."""
    robot, model = kinematics.robot, kinematics.model
    D, S = model.displacements(x)
    S = S.reshape(len(D), 6, -1)
    frames, n = len(kinematics.T_frame_base), len(robot.joints)
    chain = pinocchio_chain(robot.joints, robot.placements[:n] @ D[frames : frames + n])
    data = chain.createData()
    terms = [model.terms[t] for t in model.joint_terms]
    moved = joint_displacements(robot, terms, samples.q, samples.load)
    moved = moved @ model.mixing[list(model.joint_terms)]
    configurations = robot.chain_values(samples.q) + moved @ x
    T_last_tip = robot.placements[n] @ D[frames + n]
    poses = np.empty((len(samples), 4, 4))
    twists = np.empty((len(samples), 6, len(model)))
    for i, (f, t) in enumerate(zip(samples.frame, samples.target, strict=True)):
        T_frame_base = kinematics.T_frame_base[f] @ D[f]
        T_tip_target = kinematics.T_tip_target[t] @ D[frames + n + 1 + t]
        pin.forwardKinematics(chain, data, configurations[i])
        regressor = pin.computeJointKinematicRegressor(
            chain, data, n, pin.LOCAL, pin.SE3(T_last_tip @ T_tip_target)
        ).reshape(6, n, 6)
        T_root_last = data.oMi[n].homogeneous
        T_base_tip = rigid_inverse(robot.T_root_base) @ T_root_last @ T_last_tip
        poses[i] = T_frame_base @ T_base_tip @ T_tip_target
        in_target = np.einsum("dns,nsp->dp", regressor, S[frames : frames + n])
        along = np.einsum("dns,ns->dn", regressor, axis_twists(robot))
        in_target += along @ moved[i]
        for T, local in (
            (T_base_tip @ T_tip_target, S[f]),
            (T_tip_target, S[frames + n]),
            (np.eye(4), S[frames + n + 1 + t]),
        ):
            in_target += pin.SE3(T).toActionMatrixInverse() @ local
        R = poses[i, :3, :3]
        twists[i] = np.concatenate([R @ in_target[:3], R @ in_target[3:]])
    return poses, twists


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("model", ["hayati", "placement"])
def test_it_says_what_pinocchio_says(robots, name, model):  # noqa: F811
    kinematics, samples = seen(robots[name], model + FAMILIES, len(name))
    x = np.random.default_rng(5).normal(0.0, 1e-3, len(kinematics.model))
    expected_poses, expected_twists = by_pinocchio(kinematics, x, samples)
    poses, twists = kinematics.twists(x, samples)
    np.testing.assert_allclose(poses, expected_poses, atol=2e-14)
    np.testing.assert_allclose(twists, expected_twists, rtol=1e-12, atol=2e-12)
    np.testing.assert_array_equal(kinematics.poses(x, samples), poses)
    _, linear = kinematics.twists(x, samples, rotation=False)
    np.testing.assert_array_equal(linear, twists[:, :3])


def test_blocks_are_the_same_as_one(ur3, monkeypatch):
    kinematics, samples = seen(ur3, "dh+gain", 0, 95)
    x = np.full(len(kinematics.model), 1e-3)
    poses, twists = kinematics.twists(x, samples)
    monkeypatch.setattr(kernel, "BLOCK", 20)
    again = kinematics.twists(x, samples)
    np.testing.assert_allclose(again[0], poses, rtol=1e-14, atol=1e-15)
    np.testing.assert_allclose(again[1], twists, rtol=1e-13, atol=1e-15)


@pytest.mark.parametrize("count", [0, 15, 95, 400])
def test_sums_over_blocks_are_added_in_order(count, monkeypatch):
    # 400 samples are 20 blocks, for which threads are used
    monkeypatch.setattr(kernel, "BLOCK", 20)
    values = np.random.default_rng(3).normal(size=(2, 3, count)) * 10.0 ** np.arange(3)[:, None]

    def of_block(block):
        return np.sum(values[:, :, block], axis=2)

    stacked = np.array(kernel.over_blocks(of_block, count))
    total = kernel.sum_over_blocks(of_block, count)
    np.testing.assert_array_equal(total, np.sum(stacked, axis=0))
    in_order = 0.0
    for k in range(len(stacked)):
        in_order = in_order + stacked[k]
    np.testing.assert_array_equal(total, in_order)


def test_sums_over_blocks_leave_what_a_block_returns(monkeypatch):
    monkeypatch.setattr(kernel, "BLOCK", 20)
    ones = np.ones(3)
    np.testing.assert_array_equal(kernel.sum_over_blocks(lambda _: ones, 60), 3.0)
    np.testing.assert_array_equal(ones, 1.0)


def test_turns_take_z_to_any_axis():
    axes = np.random.default_rng(0).normal(size=(50, 3))
    axes = np.concatenate([axes, np.eye(3), -np.eye(3), [[1e-9, 0.0, -1.0]]])
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    turns = kernel.turns_to(axes)
    np.testing.assert_allclose(
        turns @ turns.transpose(0, 2, 1), np.tile(np.eye(3), (57, 1, 1)), atol=1e-14
    )
    np.testing.assert_allclose(turns[:, :, 2], axes, atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(turns), 1.0, atol=1e-14)
