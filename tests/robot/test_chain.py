from __future__ import annotations

import zlib

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import event, given, settings, strategies as st

from calib.data.cell_chains import robot_of_cell
from calib.errors import CalibError, UrdfError
from calib.model.dh_table import dh_table
from calib.robot.gravity import Payload, gravity_loads
from calib.robot.readback import check_written
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf, read_urdf
from tests.robot.shared import (
    LIMIT,
    SOME_AND_SLOWLY_ALL,
    by_pinocchio,
    displaced,
    random_q,
    urdf_of,
)
from tests.two_handed import CELL

#: Two arms, arm and head, tip at the fork or above the base, and the columns that they have.
TWO_BRANCHES = {
    "tiago head to arm": ("tiago_no_hand", "xtion_rgb_optical_frame", "wrist_ft_tool_link", 9),
    "tiago arm to head": ("tiago_no_hand", "wrist_ft_tool_link", "xtion_rgb_optical_frame", 9),
    "pr2 head to arm": ("pr2", "head_plate_frame", "l_gripper_tool_frame", 9),
    "pr2 two arms": ("pr2", "r_gripper_tool_frame", "l_gripper_tool_frame", 14),
    "baxter two arms": ("baxter", "right_gripper", "left_gripper", 14),
    "talos head to arm": ("talos_full_v2", "rgbd_optical_frame", "wrist_left_ft_tool_link", 9),
    "ur3 turned round": ("ur3", "tool0", "base", 6),
    "panda turned round, tip on the way": ("panda", "panda_link8", "panda_link3", 4),
    "kinova turned round": ("kinova", "j2s6s200_end_effector", "j2s6s200_link_base", 6),
    "quadruped's legs": ("a1", "FL_foot", "RR_foot", 6),
}


def assert_serial(robot: Robot, q: np.ndarray) -> None:
    """The chain's text: T_root_base^-1 P_1 J_1 ... P_tip, with the joints' axes as they are listed."""
    for values, pose in zip(robot.chain_values(q), robot.poses(q), strict=True):
        T = np.linalg.inv(robot.T_root_base)
        for placement, item, value in zip(robot.placements, robot.joints, values, strict=False):
            twist = np.zeros(6)
            twist[slice(0, 3) if item.type == "prismatic" else slice(3, 6)] = value * item.axis
            T = T @ placement @ pin.exp6(twist).homogeneous
        np.testing.assert_allclose(T @ robot.placements[-1], pose, rtol=0, atol=1e-12)


def assert_round_trip(robot: Robot, q: np.ndarray, *, yourdf: bool = False) -> None:
    """A corrected URDF says what the corrected robot says, and nothing but its origins differs."""
    new = displaced(robot)
    expected = new.poses(q)
    again = robot.rebuilt(Urdf.from_bytes(new.urdf.data, "again.urdf"))
    np.testing.assert_allclose(again.poses(q), expected, rtol=0, atol=1e-12)
    np.testing.assert_allclose(again.placements, new.placements, rtol=0, atol=1e-12)
    np.testing.assert_allclose(by_pinocchio(new, q), expected, rtol=0, atol=1e-12)
    if yourdf:
        check_written(new, expected, q)
    if any(robot.carriers):
        assert np.abs(expected - robot.poses(q)).max() > 1e-4
    changed = {
        name.name
        for name, was in zip(new.urdf.joints, robot.urdf.joints, strict=True)
        if not np.array_equal(name.T_parent_joint, was.T_parent_joint)
    }
    assert changed == {carrier for carrier in robot.carriers if carrier is not None}


# Two branches


@pytest.mark.parametrize("case", TWO_BRANCHES)
def test_chains_of_two_branches(case):
    name, base, tip, columns = TWO_BRANCHES[case]
    robot = Robot.load(name, base, tip)
    q = random_q(robot)
    assert robot.base_moves
    assert len(robot.joint_names) == columns
    np.testing.assert_allclose(robot.poses(q), by_pinocchio(robot, q), rtol=0, atol=1e-12)
    np.testing.assert_array_equal(robot.T_root_base, np.eye(4))
    assert_serial(robot, q)
    assert_round_trip(robot, q, yourdf=True)


# Every robot


def random_pairs(urdf: Urdf, count: int) -> list[tuple[str, str]]:
    rng = np.random.default_rng(zlib.crc32(urdf.source.encode()))
    return [(str(a), str(b)) for a, b in rng.choice(urdf.links, (count, 2))]


@pytest.mark.parametrize("path", SOME_AND_SLOWLY_ALL)
def test_any_two_links_of_every_robot(path):
    urdf = Urdf.read(path)
    found = 0
    for base, tip in random_pairs(urdf, 8):
        try:
            robot = Robot.from_urdf(urdf, base, tip)
        except CalibError as error:
            assert "no joint moves between" in str(error) or "does not exist" in str(error)  # noqa: PT017
            continue
        found += 1
        q = random_q(robot, 2)
        np.testing.assert_allclose(robot.poses(q), by_pinocchio(robot, q), rtol=0, atol=1e-12)
        assert_serial(robot, q)
        assert_round_trip(robot, q)
    assert found > 0


# Any tree

numbers = st.integers(-1000, 1000).map(lambda k: k / 1000)
triples = st.tuples(numbers, numbers, numbers)
kinds = st.sampled_from(["revolute", "continuous", "prismatic", "fixed", "mimic"])


@st.composite
def trees(draw):
    """A URDF of any shape, its joints of any type and axis, some mimicking an earlier one; and two of its links."""
    count = draw(st.integers(2, 9))
    links = [f"l{i}" for i in range(count)]
    joints, drivers = [], []
    for i in range(1, count):
        parent, kind = links[draw(st.integers(0, i - 1))], draw(kinds)
        mimic = ""
        if kind == "mimic":
            kind = draw(st.sampled_from(["revolute", "prismatic"]))
            if drivers:
                driver, factor, offset = (
                    draw(st.sampled_from(drivers)),
                    draw(numbers),
                    draw(numbers),
                )
                mimic = f'<mimic joint="{driver}" multiplier="{factor}" offset="{offset}"/>'
        if kind != "fixed":
            drivers.append(f"j{i}")
        axis = draw(triples.filter(lambda v: np.linalg.norm(v) > 0.1))
        joints.append(
            f'<joint name="j{i}" type="{kind}"><parent link="{parent}"/><child link="l{i}"/>'
            f'<origin xyz="{_text(draw(triples))}" rpy="{_text(draw(triples))}"/>'
            f'<axis xyz="{_text(axis)}"/>{LIMIT}{mimic}</joint>'
        )
    base, tip = draw(st.permutations(links))[:2]
    return urdf_of(" ".join(links), *joints), base, tip


def _text(values) -> str:
    return " ".join(repr(value) for value in values)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(trees())
def test_any_tree_between_any_two_links(case):
    urdf, base, tip = case
    try:
        robot = Robot.from_urdf(urdf, base, tip)
    except UrdfError as error:
        event(str(error).split(";")[0].split("'")[0])
        assert "no joint moves between" in str(error) or "left to move" in str(error)  # noqa: PT017
        return
    event(f"base moves: {robot.base_moves}; followers: {len(robot.joints) > len(robot.inputs)}")
    q = random_q(robot, 3)
    np.testing.assert_allclose(robot.poses(q), by_pinocchio(robot, q), rtol=0, atol=1e-12)
    assert_serial(robot, q)
    table = dh_table(robot)
    np.testing.assert_allclose(
        table.poses(robot.chain_values(q)), robot.poses(q), rtol=0, atol=1e-11
    )
    new = displaced(robot)
    check_written(new, new.poses(q), q)
    again = robot.rebuilt(Urdf.from_bytes(new.urdf.data, "again.urdf"))
    np.testing.assert_allclose(again.poses(q), new.poses(q), rtol=0, atol=1e-12)
    np.testing.assert_allclose(again.placements, new.placements, rtol=0, atol=1e-12)
    load = gravity_loads(robot, q, Payload(2.0, (0.1, 0.2, 0.3)))[..., 0]
    assert load.shape == (3, len(robot.joints))


def test_a_chain_over_the_mount_of_another_robot_is_a_limb_with_the_columns_of_the_tree():
    tree = robot_of_cell(read_urdf("panda"), CELL)
    q = np.random.default_rng(1).uniform(-1.0, 1.0, (3, 14))
    assert repr(tree).endswith("1 more chain, 14 joints)")
    for number, (chain, columns) in enumerate(zip(tree.chains, (q[:, :7], q[:, 7:]), strict=True)):
        (limb,) = chain.limbs
        assert [joint.name for joint in chain.all_joints] == [joint.name for joint in chain.joints]
        assert repr(chain).endswith(f"{chain.tip}, 7 joints)")
        np.testing.assert_array_equal(limb.chain_values(q), columns)
        np.testing.assert_allclose(limb.poses(q), tree.poses(q, np.full(3, number)), atol=1e-14)
