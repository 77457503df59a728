from __future__ import annotations

import dataclasses

import numpy as np
import pinocchio as pin
import pytest

from calib.errors import UrdfError
from calib.robot.ranges import (
    _DIRECTIONS,
    column_ranges,
    random_joint_values,
    sobol,
    spread_between,
    spread_poses,
)
from calib.robot.readback import check_written
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf


def corrected(robot: Robot, size: float = 5e-3) -> Robot:
    rng = np.random.default_rng(2)
    moved = robot.placements.copy()
    for i, carrier in enumerate(robot.carriers):
        if carrier is not None:
            moved[i] = moved[i] @ pin.exp6(rng.normal(0, size, 6)).homogeneous
    return robot.with_placements(moved)


@pytest.mark.parametrize(
    ("name", "base", "tip", "held"),
    [
        ("tiago_no_hand", "xtion_rgb_optical_frame", "wrist_ft_tool_link", {}),
        ("tiago_no_hand", "xtion_rgb_optical_frame", "wrist_ft_tool_link", {"head_1_joint": 0.3}),
        ("tiago_no_hand", None, "wrist_ft_tool_link", {"torso_lift_joint": 0.2}),
        ("baxter", "right_gripper", "left_gripper", {}),
        ("ur3", "tool0", "base", {"elbow_joint": -1.0}),
        ("panda", "panda_link0", "panda_rightfinger", {}),
        ("panda", "panda_leftfinger", "panda_rightfinger", {}),
        ("panda", "panda_link0", "panda_rightfinger", {"panda_finger_joint1": 0.02}),
        ("pr2", "head_plate_frame", "r_gripper_l_finger_tip_link", {}),
        ("tiago_pro", "head_2_link", "gripper_right_fingertip_left_link", {}),
    ],
)
def test_columns_that_move_several_joints_and_a_base_that_moves_pass(name, base, tip, held):
    robot = Robot.load(name, base, tip, held=held)
    q = random_joint_values(robot)
    new = corrected(robot)
    check_written(new, new.poses(q), q)
    with pytest.raises(UrdfError, match=r"read back by Pinocchio, puts the tip .* It is not writt"):
        check_written(new, robot.poses(q), q)


@pytest.mark.parametrize("joint", ["shoulder_pan_joint", "wrist_3_link-tool0_fixed_joint"])
@pytest.mark.parametrize("twist", [(2e-9, 0, 0, 0, 0, 0), (0, 0, 0, 0, 2e-8, 0)])
def test_an_origin_that_was_tampered_with_is_refused(ur3, joint, twist):
    origin = ur3.urdf.joint(joint).T_parent_joint @ pin.exp6(np.array(twist)).homogeneous
    tampered = dataclasses.replace(ur3, urdf=ur3.urdf.with_origins({joint: origin}))
    q = random_joint_values(ur3)
    with pytest.raises(
        UrdfError, match=r"read back by Pinocchio, puts the tip .* rad away.*1e-09 is allowed"
    ):
        check_written(tampered, ur3.poses(q), q)


# Columns that move several joints


def mimic_pair(lower: float, upper: float, numbers: str) -> Robot:
    limit = '<limit lower="{}" upper="{}" effort="1" velocity="1"/>'
    text = (
        '<robot name="r"><link name="a"/><link name="b"/><link name="c"/>'
        '<joint name="1" type="revolute"><parent link="a"/><child link="b"/>'
        f"{limit.format(-1, 2)}</joint>"
        '<joint name="2" type="revolute"><parent link="b"/><child link="c"/>'
        f'{limit.format(lower, upper)}<mimic joint="1" {numbers}/></joint></robot>'
    )
    return Robot.from_urdf(Urdf.from_bytes(text.encode(), "r.urdf"), tip="c")


@pytest.mark.parametrize(
    ("lower", "upper", "numbers", "expected"),
    [
        (-3, 3, "", (-1, 2)),
        (-0.5, 3, "", (-0.5, 2)),
        (-0.5, 0.25, 'multiplier="0.5"', (-1, 0.5)),
        (-0.5, 1, 'multiplier="-1"', (-1, 0.5)),
        (-0.5, 1, 'offset="0.5"', (-1, 0.5)),
        (2.5, 3, "", (-1, 2)),  # the two cannot both be had: the column's own stay
    ],
)
def test_a_column_keeps_within_the_limits_of_its_followers(lower, upper, numbers, expected):
    robot = mimic_pair(lower, upper, numbers)
    np.testing.assert_allclose(column_ranges(robot), [expected])
    for q in (random_joint_values(robot), spread_poses(robot)):
        assert q.min() >= expected[0]
        assert q.max() <= expected[1]


# Spread joint values


def test_kept_direction_numbers_are_those_of_scipy():
    kept = np.load(_DIRECTIONS)
    bits, columns = kept.shape
    # A point whose number has one bit set differs from the one before by that bit's direction number.
    numbers = 2 ** np.arange(bits)
    x = (np.vstack([np.zeros(columns), sobol(2 ** (bits - 1), columns)]) * 2**bits).astype(
        np.uint16
    )
    np.testing.assert_array_equal(kept, x[numbers] ^ x[numbers - 1])


@pytest.mark.parametrize(("count", "columns"), [(1, 1), (200, 6), (256, 14), (4096, 7), (300, 33)])
def test_spread_rows_are_scipys_sequence(count, columns):
    low, high = -np.arange(1.0, columns + 1.0), np.full(columns, 3.0)
    q = spread_between(np.column_stack([low, high]), count)
    np.testing.assert_array_equal(q, low + sobol(count, columns) * (high - low))
    assert not q.flags.writeable
