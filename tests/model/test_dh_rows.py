from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from calib.errors import ModelError
from calib.model.dh import dh_table
from calib.model.dh_conventions import CONVENTIONS, DHRows
from calib.model.dh_rows import dh_rows, near_parallel, taken_as_parallel
from calib.model.robot import Robot
from calib.model.urdf import Urdf

KEYS = ("theta", "d", "a", "alpha", "beta")


def column(rows: DHRows, key: str) -> list[float]:
    return [getattr(row, key) for row in rows.rows]


def pose_by_hand(rows: DHRows, values: np.ndarray) -> np.ndarray:
    """The conventions' equations, written down anew."""

    def turn(axis: str, angle: float) -> np.ndarray:
        T = np.eye(4)
        T[:3, :3] = Rotation.from_euler(axis, angle).as_matrix()
        return T

    def move(x: float, z: float) -> np.ndarray:
        T = np.eye(4)
        T[:3, 3] = x, 0.0, z
        return T

    T = rows.T_base_0
    for row, q in zip(rows.rows, values, strict=True):
        theta, d = (row.theta, row.d + q) if row.prismatic else (row.theta + q, row.d)
        if rows.convention == "modified":
            T = T @ turn("x", row.alpha) @ move(row.a, 0) @ turn("z", theta) @ move(0, d)
        else:
            T = T @ turn("z", theta) @ move(0, d) @ move(row.a, 0) @ turn("x", row.alpha)
            T = T @ turn("y", row.beta)
    return T @ rows.T_n_tip


def displaced(robot: Robot, seed: int = 1, size: float = 1.0) -> Robot:
    """A robot whose every placement is off by about a millimetre and two milliradians."""
    rng = np.random.default_rng(seed)
    placements = robot.placements.copy()
    for i, carrier in enumerate(robot.carriers):
        if carrier is not None:
            D = np.eye(4)
            D[:3, :3] = Rotation.from_rotvec(size * rng.normal(0, 2e-3, 3)).as_matrix()
            D[:3, 3] = size * rng.normal(0, 1e-3, 3)
            placements[i] = placements[i] @ D
    return robot.with_placements(placements)


def assert_same_poses(rows: DHRows, robot: Robot, tolerance: float = 1e-11) -> None:
    q = np.random.default_rng(3).uniform(-3, 3, (5, len(robot.joint_names)))
    values = robot.chain_values(q)
    found = rows.poses(values)
    np.testing.assert_allclose(found, robot.poses(q), rtol=0, atol=tolerance)
    np.testing.assert_allclose(pose_by_hand(rows, values[0]), found[0], rtol=0, atol=tolerance)


# The makers' tables


def test_the_paper_s_ur3_as_its_maker_prints_it(ur3):
    rows = dh_rows(ur3, "standard")
    golden = {
        "theta": [0] * 6,
        "d": [0.1519, 0, 0, 0.11235, 0.08535, 0.0819],
        "a": [0, -0.24365, -0.21325, 0, 0, 0],
        "alpha": np.radians([90, 0, 0, 90, -90, 0]),
        "beta": [0] * 6,
    }
    for key, values in golden.items():
        np.testing.assert_allclose(column(rows, key), values, atol=1e-9, err_msg=key)
    np.testing.assert_allclose(rows.T_base_0, np.eye(4), atol=1e-9)
    np.testing.assert_allclose(rows.T_n_tip, np.eye(4), atol=1e-9)


def test_the_panda_as_its_maker_prints_it(panda):
    # The maker has d7 = 0 and a flange 107 mm on: here that is the last row's own d, up to the tip.
    rows = dh_rows(panda, "modified")
    golden = {
        "a": [0, 0, 0, 0.0825, -0.0825, 0, 0.088],
        "d": [0.333, 0, 0.316, 0, 0.384, 0, 0.107],
        "alpha": np.radians([0, -90, 90, 90, -90, 90, 90]),
        "theta": [0] * 7,
    }
    for key, values in golden.items():
        np.testing.assert_allclose(column(rows, key), values, atol=1e-9, err_msg=key)
    np.testing.assert_allclose(rows.T_base_0, np.eye(4), atol=1e-9)
    np.testing.assert_allclose(rows.T_n_tip, np.eye(4), atol=1e-9)


def test_hayati_rows_are_those_of_the_error_model(ur3, panda):
    for robot in (ur3, panda, displaced(ur3)):
        rows, table = dh_rows(robot, "hayati"), dh_table(robot)
        for key in KEYS:
            wanted = [getattr(row, key) for row in table.rows]
            np.testing.assert_allclose(column(rows, key), wanted, rtol=0, atol=1e-12, err_msg=key)
        np.testing.assert_allclose(rows.T_base_0, table.T_base_0, atol=1e-12)
        np.testing.assert_allclose(rows.T_n_tip, table.T_n_tip, atol=1e-12)


def test_half_a_turn_is_said_as_180_deg(serial_urdf):
    flipped = serial_urdf(
        [
            ("revolute", (0, 0, 0.2), (0, 0, 0), (0, 0, 1)),
            ("revolute", (-0.3, 0, 0), (np.pi, 0, 0), (0, 0, 1)),
        ],
        tip=((0, 0, 0.1), (0, 0, -np.pi)),
    )
    rows = dh_rows(Robot.from_urdf(flipped), "standard")
    angles = [*column(rows, "theta"), *column(rows, "alpha")]
    assert any(abs(angle - np.pi) < 1e-9 for angle in angles)
    assert min(angles) > -3.0


# Before and after


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_the_columns_of_a_corrected_robot_compare(ur3, panda, convention):
    for robot in (ur3, panda):
        before, corrected = dh_rows(robot, convention), displaced(robot)
        after = dh_rows(corrected, convention, like=robot)
        assert_same_poses(after, corrected)
        far = {name for pair in near_parallel(corrected) for name in pair}
        for row, then in zip(before.rows, after.rows, strict=True):
            # A row between axes of the pure conventions that are nearly parallel may be anywhere.
            if convention == "hayati" or not ({row.joint} & far):
                change = [getattr(then, key) - getattr(row, key) for key in KEYS]
                assert np.abs(change).max() < 0.03, row.joint
        for name in ("T_base_0", "T_n_tip"):
            np.testing.assert_allclose(getattr(after, name), getattr(before, name), atol=0.03)


@pytest.mark.parametrize("theta", [np.pi / 2, -np.pi / 2, np.pi, -np.pi])
@pytest.mark.parametrize("convention", CONVENTIONS)
def test_quarter_and_half_turns_keep_their_signs(serial_urdf, theta, convention):
    # x_1 lies across x_0 or against it: what a nominal robot decides by rounding, its corrected one must not undo.
    robot = Robot.from_urdf(
        serial_urdf(
            [
                ("revolute", (0, 0, 0.2), (0, 0, 0), (0, 0, 1)),
                ("revolute", (0, 0, 0), (np.pi / 2, 0, theta), (0, 0, 1)),
                ("revolute", (0.2, 0, 0), (0, np.pi / 2, 0), (0, 0, 1)),
            ]
        )
    )
    before = dh_rows(robot, convention)
    for seed in range(4):
        after = dh_rows(displaced(robot, seed), convention, like=robot)
        for key in ("theta", "alpha"):
            change = np.subtract(column(after, key), column(before, key))
            assert np.abs(change).max() < 0.05, key


@pytest.mark.parametrize("nominal_deg", [2.95, 3.05])
def test_hayati_s_rows_stay_of_one_kind_at_the_limit(serial_urdf, nominal_deg):
    # A d that is 0 on one side of three degrees would be metres on the other.
    def arm(degrees: float) -> Robot:
        tilt = np.radians(degrees)
        first = ("revolute", (0, 0, 0.2), (0, 0, 0), (0, 0, 1))
        second = ("revolute", (0.3, 0.2, 0.1), (tilt, 0, 0), (0, 0, 1))
        return Robot.from_urdf(serial_urdf([first, second]))

    nominal, corrected = arm(nominal_deg), arm(6.0 - nominal_deg)
    before = dh_rows(nominal, "hayati").rows[0]
    after = dh_rows(corrected, "hayati", like=nominal).rows[0]
    assert (before.d == 0.0) == (after.d == 0.0) == (nominal_deg < 3.0)
    assert abs(after.theta - before.theta) < 0.03
    assert_same_poses(dh_rows(corrected, "hayati", like=nominal), corrected)


@pytest.mark.parametrize(
    ("convention", "turn", "key", "row"),
    [(convention, np.pi / 2, "theta", -1) for convention in CONVENTIONS]
    + [("hayati", np.pi, "alpha", 0)],
)
def test_no_angle_jumps_by_a_turn(serial_urdf, convention, turn, key, row):
    # Half a turn nominally: a little more would be said as -179.9 deg.
    urdf = serial_urdf(
        [
            ("revolute", (0, 0, 0.2), (0, 0, 0), (0, 0, 1)),
            ("revolute", (0.3, 0, 0), (turn, 0, 0), (0, 0, 1)),
        ],
        tip=((0, 0, 0.1), (0, 0, np.pi)),
    )
    robot = Robot.from_urdf(urdf)
    assert column(dh_rows(robot, convention), key)[row] == pytest.approx(np.pi)
    found = [
        column(dh_rows(displaced(robot, seed), convention, like=robot), key)[row]
        for seed in range(6)
    ]
    assert min(found) < np.pi < max(found)
    np.testing.assert_allclose(found, np.pi, atol=0.05)


def test_a_parallel_axis_beside_the_last_x_keeps_its_side(serial_urdf):
    # The offset to the next axis lies across x, so that either sign of x is as near.
    robot = Robot.from_urdf(
        serial_urdf(
            [
                ("revolute", (0, 0, 0.2), (0, 0, 0), (0, 0, 1)),
                ("revolute", (0, 0.3, 0), (0, 0, 0), (0, 0, 1)),
                ("revolute", (0.2, 0, 0), (np.pi / 2, 0, 0), (0, 0, 1)),
            ]
        )
    )
    before = dh_rows(robot, "hayati")
    for seed in range(6):
        after = dh_rows(displaced(robot, seed), "hayati", like=robot)
        for key in KEYS:
            change = np.subtract(column(after, key), column(before, key))
            assert np.abs(change).max() < 0.05, key


def test_a_tip_a_little_beside_the_last_axis_has_no_direction_of_its_own(ur3):
    placements = ur3.placements.copy()
    placements[-1, :3, 3] += [1e-4, 2e-4, 3e-4]
    corrected = ur3.with_placements(placements)
    for convention in ("standard", "modified"):
        rows = dh_rows(corrected, convention)
        assert abs(rows.rows[-1].theta) < 1e-6
        assert_same_poses(rows, corrected)
    placements[-1, :3, 3] *= 100.0
    assert abs(dh_rows(ur3.with_placements(placements)).rows[-1].theta) > 0.1


def test_a_first_axis_along_base_x_keeps_frame_0(serial_urdf):
    robot = Robot.from_urdf(
        serial_urdf(
            [
                ("revolute", (0.1, 0, 0.2), (0, 0, 0), (1, 0, 0)),
                ("revolute", (0, 0.3, 0), (0, 0, 0), (0, 1, 0)),
            ]
        )
    )
    before = dh_rows(robot, "standard")
    for seed in range(4):
        after = dh_rows(displaced(robot, seed), "standard", like=robot)
        np.testing.assert_allclose(after.T_base_0, before.T_base_0, atol=0.02)


def test_what_lies_behind_the_last_axis_is_the_tip_s_matter(ur3):
    # A tool flange that was moved by 0.1 mm would else turn theta_6 by up to half a turn.
    placements = ur3.placements.copy()
    placements[-1, :3, 3] += [1e-4, 2e-4, 3e-4]
    corrected = ur3.with_placements(placements)
    for convention in CONVENTIONS:
        before, after = dh_rows(ur3, convention), dh_rows(corrected, convention, like=ur3)
        assert abs(after.rows[-1].theta - before.rows[-1].theta) < 1e-12
        # The frame that carries the tip on this robot is turned: which of the three is along the axis does not matter.
        moved = np.append(after.T_n_tip[:3, 3], after.rows[-1].d - before.rows[-1].d)
        assert np.linalg.norm(moved) == pytest.approx(np.linalg.norm([1e-4, 2e-4, 3e-4]), abs=1e-9)
        assert_same_poses(after, corrected)


def test_pure_rows_of_nearly_parallel_axes_lie_far_away_and_hold(ur3):
    corrected = displaced(ur3, size=1e-2)
    pairs = near_parallel(corrected)
    assert set(pairs) == {
        ("shoulder_lift_joint", "elbow_joint"),
        ("elbow_joint", "wrist_1_joint"),
    }
    assert all(1e-6 < angle < 1e-3 for angle in pairs.values())
    for convention in ("standard", "modified"):
        rows = dh_rows(corrected, convention, like=ur3)
        assert np.abs(column(rows, "d")).max() > 0.3
        assert column(rows, "beta") == [0.0] * 6
        assert_same_poses(rows, corrected, 1e-10)
    assert np.abs(column(dh_rows(corrected, "hayati", like=ur3), "d")).max() < 0.2


@pytest.mark.parametrize("tilt", [1e-6, 1e-5, 1e-3])
def test_the_nearly_parallel_hold_1e_9_however_far(ur3, tilt):
    placements = ur3.placements.copy()
    placements[2, :3, :3] = placements[2, :3, :3] @ Rotation.from_rotvec([tilt, 0, 0]).as_matrix()
    corrected = ur3.with_placements(placements)
    for convention in ("standard", "modified"):
        assert_same_poses(dh_rows(corrected, convention, like=ur3), corrected, 1e-9)


def test_axes_that_are_parallel_but_for_rounding_are_taken_as_parallel(ur3):
    placements = ur3.placements.copy()
    placements[2, :3, :3] = placements[2, :3, :3] @ Rotation.from_rotvec([3e-8, 0, 0]).as_matrix()
    corrected = ur3.with_placements(placements)
    assert near_parallel(corrected) == {}
    assert taken_as_parallel(corrected) == pytest.approx(3e-8, rel=1e-3)
    assert taken_as_parallel(ur3) < 1e-10
    rows = dh_rows(corrected, "standard", like=ur3)
    assert np.abs(column(rows, "d")).max() < 0.2
    assert_same_poses(rows, corrected, 2 * 3e-8)
    assert_same_poses(dh_rows(corrected, "hayati", like=ur3), corrected, 1e-12)


@pytest.mark.parametrize("size", [1e-7, 1e-8, 1e-9])
def test_parallel_but_for_rounding_behind_axes_that_are_nearly_so(serial_urdf, size):
    # The common normal of the first two lies 300 km away: there 4e-7 rad are 0.1 m.
    turn = ("revolute", (0.3, 0, 0), (0, 0, 0), (0, 0, 1))
    tilts = [(0, 0, 0), (1e-6, 0, 0), (0, 4e-7, 0), (0, 6e-7, 0)]
    robot = Robot.from_urdf(serial_urdf([(*turn[:2], rpy, turn[3]) for rpy in tilts]))
    moved = displaced(robot, size=size / 1e-3)
    for convention in ("standard", "modified"):
        assert_same_poses(dh_rows(moved, convention, like=robot), moved, 1e-9)
    assert taken_as_parallel(moved) < 1e-9
    assert len(near_parallel(moved)) == 3


@pytest.mark.parametrize("tilt", [1e-2, 1e-3, 1e-5, 1e-6])
@pytest.mark.parametrize("small", [4e-7, 1e-8])
@pytest.mark.parametrize("first", [True, False])
def test_two_nearly_parallel_pairs_hold_what_is_said(ur3, tilt, small, first):
    placements = ur3.placements.copy()
    for i, angle in zip((2, 3), (tilt, small) if first else (small, tilt), strict=True):
        R = Rotation.from_rotvec([angle, 0.3 * angle, 0]).as_matrix()
        placements[i, :3, :3] = placements[i, :3, :3] @ R
        placements[i, :3, 3] += 1e-3
    robot = ur3.with_placements(placements)
    rows = dh_rows(robot, "standard", like=ur3)
    assert_same_poses(rows, robot, 5e-9 + 4.0 * taken_as_parallel(robot))


# Any chain


MIMIC = b"""<robot name="m"><link name="b"/><link name="l1"/><link name="l2"/><link name="l3"/><link name="t"/>
<joint name="lift" type="prismatic"><parent link="b"/><child link="l1"/><origin xyz="0.1 0 0.2" rpy="0.1 0 0"/>
<axis xyz="0 0 2"/><limit lower="0" upper="1" effort="1" velocity="1"/></joint>
<joint name="arm" type="revolute"><parent link="l1"/><child link="l2"/><origin xyz="0.3 0.1 0" rpy="0 0.3 0.2"/>
<axis xyz="0 1 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
<joint name="wrist" type="revolute"><parent link="l2"/><child link="l3"/><origin xyz="0.4 0 0" rpy="0 0 0"/>
<axis xyz="0 1 1"/><limit lower="-2" upper="2" effort="1" velocity="1"/>
<mimic joint="arm" multiplier="-2" offset="0.1"/></joint>
<joint name="j" type="fixed"><parent link="l3"/><child link="t"/><origin xyz="0.1 0.2 0.3" rpy="1 2 3"/></joint>
</robot>"""


@pytest.mark.parametrize("convention", CONVENTIONS)
@pytest.mark.parametrize(("base", "tip"), [("b", "t"), ("l1", "t"), ("t", "b")])
def test_sliding_and_mimicking_joints_and_chains_from_tip_to_base(convention, base, tip):
    robot = Robot.from_urdf(Urdf.from_bytes(MIMIC, "m.urdf"), base, tip)
    rows = dh_rows(robot, convention)
    assert [row.prismatic for row in rows.rows] == [j.type == "prismatic" for j in robot.joints]
    assert_same_poses(rows, robot)
    corrected = displaced(robot)
    assert_same_poses(dh_rows(corrected, convention, like=robot), corrected)


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_two_branches(convention):
    talos = Robot.load("talos_reduced", base="rgbd_rgb_optical_frame", tip="gripper_left_base_link")
    assert_same_poses(dh_rows(talos, convention), talos)
    corrected = displaced(talos)
    assert_same_poses(dh_rows(corrected, convention, like=talos), corrected)


directions = st.sampled_from(
    [(0, 0, 1), (0, 1, 0), (1, 0, 0), (0, 0, -1), (0.6, 0, 0.8), (1, 2, 3)]
)
angles = st.sampled_from([0.0, 0.0, np.pi / 2, -np.pi / 2, np.pi, 0.7])
lengths = st.sampled_from([0.0, 0.0, 0.1, -0.3, 0.45])
joints = st.lists(
    st.tuples(
        st.sampled_from(["revolute", "revolute", "prismatic"]),
        st.tuples(lengths, lengths, lengths),
        st.tuples(angles, angles, angles),
        directions,
    ),
    min_size=1,
    max_size=7,
)


@given(joints=joints, tip=st.tuples(lengths, lengths, angles), seed=st.integers(0, 99))
@settings(max_examples=40)
def test_random_chains(serial_urdf, joints, tip, seed):
    urdf = serial_urdf(joints, tip=((tip[0], 0.1, tip[1]), (0.0, tip[2], 0.0)))
    robot = Robot.from_urdf(urdf)
    corrected = displaced(robot, seed)
    for convention in CONVENTIONS:
        assert_same_poses(dh_rows(robot, convention), robot, 1e-10)
        assert_same_poses(dh_rows(corrected, convention, like=robot), corrected, 1e-9)


# What is refused


def test_there_are_three_conventions(ur3):
    with pytest.raises(ModelError, match="no DH convention 'denavit'; it is one of 'standard', 'm"):
        dh_rows(ur3, "denavit")


def test_other_joints_do_not_compare(ur3, panda):
    wanted = "other joints: 'panda_joint1'.*'shoulder_pan_joint'.*same base and tip"
    with pytest.raises(ModelError, match=wanted):
        dh_rows(panda, "standard", like=ur3)
