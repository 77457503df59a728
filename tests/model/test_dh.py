from __future__ import annotations

import importlib.metadata
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.errors import CalibError, ModelError
from calib.model.dh import DHRow, DHTable, dh_frames, dh_placements, dh_table, zero_poses
from calib.model.robot import Robot
from calib.model.urdf import Urdf

PI = np.pi
FILES = sorted(
    Path(str(file.locate()))
    for file in importlib.metadata.files("example-robot-data") or []
    if file.suffix == ".urdf"
)
#: Files of example-robot-data without a chain: no joints, or propellers on fixed joints.
REFUSED = {"quadrotor_base.urdf", "ur3.urdf", "iris_simple.urdf"}

LENGTHS_MM = {  # the maker's d1, a2, a3, d4, d5, d6
    "ur3": (151.9, -243.65, -213.25, 112.35, 85.35, 81.9),
    "ur5": (89.159, -425.0, -392.25, 109.15, 94.65, 82.3),
    "ur10": (127.3, -612.0, -572.3, 163.941, 115.7, 92.2),
}


def reach(robot: Robot) -> float:
    return float(np.linalg.norm(robot.placements[:, :3, 3], axis=1).sum())


def columns(table: DHTable) -> dict[str, list[float]]:
    return {
        key: [getattr(row, key) for row in table.rows]
        for key in ("a", "alpha", "d", "theta", "beta")
    }


def assert_rows_equal_kinematics(robot: Robot, tolerance: float = 1e-12) -> DHTable:
    table = dh_table(robot)
    q = np.random.default_rng(11).uniform(-3, 3, (4, len(robot.joint_names)))
    for values, pose in zip(robot.chain_values(q), robot.poses(q), strict=True):
        np.testing.assert_allclose(table.pose(values), pose, rtol=0, atol=tolerance)
    rebuilt = dh_placements(table, robot)
    np.testing.assert_allclose(rebuilt, robot.placements, rtol=0, atol=tolerance)
    return table


# Golden tables


def test_the_paper_s_ur3(ur3):
    table = columns(dh_table(ur3))
    golden = {
        "a": [0, -0.24365, -0.21325, 0, 0, 0],
        "alpha": np.radians([90, 0, 0, 90, -90, 0]),
        "d": [0.1519, 0, 0, 0.11235, 0.08535, 0.0819],
        "theta": [0] * 6,
        "beta": [0] * 6,
    }
    for key, values in golden.items():
        np.testing.assert_allclose(table[key], values, rtol=0, atol=1e-9, err_msg=key)
    np.testing.assert_allclose(dh_table(ur3).T_base_0, np.eye(4), atol=1e-9)
    np.testing.assert_allclose(dh_table(ur3).T_n_tip, np.eye(4), atol=1e-9)


@pytest.mark.parametrize("name", LENGTHS_MM)
def test_universal_robots(name):
    table = columns(dh_table(Robot.load(name, base="base", tip="tool0")))
    d1, a2, a3, d4, d5, d6 = LENGTHS_MM[name]
    golden = {
        "a": np.array([0, a2, a3, 0, 0, 0]) / 1e3,
        "alpha": np.radians([90, 0, 0, 90, -90, 0]),
        "d": np.array([d1, 0, 0, d4, d5, d6]) / 1e3,
        "theta": [0] * 6,
        "beta": [0] * 6,
    }
    for key, values in golden.items():
        np.testing.assert_allclose(table[key], values, rtol=0, atol=1e-9, err_msg=key)


def test_panda(panda):
    # The maker prints the modified (proximal) form: alpha_(i-1), a_(i-1). In the standard form they move up a row.
    table = columns(dh_table(panda))
    golden = {
        "a": [0, 0, 0.0825, -0.0825, 0, 0.088, 0],
        "alpha": np.radians([-90, 90, 90, -90, 90, 90, 0]),
        "d": [0.333, 0, 0.316, 0, 0.384, 0, 0.107],
        "theta": [0] * 7,
    }
    for key, values in golden.items():
        np.testing.assert_allclose(table[key], values, rtol=0, atol=1e-9, err_msg=key)


def test_kinova():
    # j2s6s200: 275.5 mm to the shoulder, 410 mm the upper arm, 9.8 mm the elbow's offset; d4 and d6 span two links.
    table = columns(dh_table(Robot.load("kinova", tip="j2s6s200_end_effector")))
    golden = {
        "a": [0, 0.41, 0, 0, 0, 0],
        "alpha": np.radians([90, 180, 90, 90, 90, -90]),
        "d": [-0.2755, 0, -0.0098, -0.31105, 0, -0.26375],
        "theta": np.radians([90, 90, 90, 0, 0, -90]),
        "beta": [0] * 6,
    }
    for key, values in golden.items():
        np.testing.assert_allclose(table[key], values, rtol=0, atol=1e-8, err_msg=key)


@pytest.mark.parametrize(
    ("twist_deg", "alpha_deg", "a"),
    [(90, 90, 0.3), (-90, -90, 0.3), (30, 30, 0.3), (-30, -30, 0.3), (150, 150, 0.3)],
)
def test_the_sign_of_alpha(serial_urdf, twist_deg, alpha_deg, a):
    # The second axis is the first one turned about +x by the twist, a along +x.
    t = np.radians(twist_deg)
    urdf = serial_urdf(
        [
            ("revolute", (0, 0, 0.2), (0, 0, 0), (0, 0, 1)),
            ("revolute", (a, 0, 0), (t, 0, 0), (0, 0, 1)),
        ]
    )
    row = dh_table(Robot.from_urdf(urdf)).rows[0]
    np.testing.assert_allclose((row.a, row.alpha), (a, np.radians(alpha_deg)), atol=1e-12)
    # The first frame stands in the base's origin, so that the height of the joint is its row's d.
    np.testing.assert_allclose((row.d, row.theta), (0.2, 0), atol=1e-12)


@pytest.mark.parametrize(("y", "x"), [(0.01, 0.0), (0.0, 0.02), (0.01, -0.02), (-0.02, 0.01)])
def test_the_signs_of_hayati_s_alpha_and_beta(serial_urdf, x, y):
    # A small rotation about x is alpha, one about y is beta: z2 = Rx(alpha) Ry(beta) z1.
    R = pin.exp3(np.array([x, 0, 0])) @ pin.exp3(np.array([0, y, 0]))
    urdf = serial_urdf(
        [
            ("revolute", (0, 0, 0), (0, 0, 0), (0, 0, 1)),
            ("revolute", (0.3, 0, 0), (0, 0, 0), R[:, 2]),
        ]
    )
    row = dh_table(Robot.from_urdf(urdf)).rows[0]
    assert row.near_parallel
    np.testing.assert_allclose((row.alpha, row.beta, row.a), (x, y, 0.3), atol=1e-12)
    assert row.d == 0.0


def test_a_row_s_matrix_is_the_product_of_its_five_screws():
    row = DHRow("j", 0.3, 0.4, 0.5, 0.6, 0.02, prismatic=False, near_parallel=True)
    prismatic = DHRow("j", 0.3, 0.4, 0.5, 0.6, 0.0, prismatic=True, near_parallel=False)

    def product(a, alpha, d, theta, beta):
        z = pin.exp6(np.array([0, 0, d, 0, 0, theta]))
        x = pin.exp6(np.array([a, 0, 0, alpha, 0, 0]))
        return (z * x * pin.exp6(np.array([0, 0, 0, 0, beta, 0]))).homogeneous

    np.testing.assert_allclose(row.matrix(0.1), product(0.3, 0.4, 0.5, 0.7, 0.02), atol=1e-15)
    np.testing.assert_allclose(prismatic.matrix(0.1), product(0.3, 0.4, 0.6, 0.6, 0), atol=1e-15)


# Every chain


@pytest.mark.parametrize("path", FILES, ids=lambda p: f"{p.parents[1].name}/{p.name}")
def test_rows_equal_forward_kinematics(path):
    try:
        robot = Robot.load(path)
    except CalibError:
        assert path.name in REFUSED
        return
    assert path.name not in REFUSED
    table = assert_rows_equal_kinematics(robot)
    # Axes 3 deg apart have feet up to 1 / sin 3 deg = 19 offsets away; no robot here has such axes.
    assert max(max(abs(row.a), abs(row.d)) for row in table.rows) <= 2 * reach(robot)
    assert [row.joint for row in table.rows] == list(robot.joint_names)
    assert [row.prismatic for row in table.rows] == [j.type == "prismatic" for j in robot.joints]


# Whole micrometres and microradians: Pinocchio takes an axis 1e-13 off a coordinate axis for that axis.
directions = st.tuples(*[st.integers(-(10**6), 10**6).map(lambda k: k / 1e6)] * 3).filter(
    lambda v: np.linalg.norm(v) > 0.1
)
points = st.tuples(*[st.integers(-500_000, 500_000).map(lambda k: k / 1e6)] * 3)


@st.composite
def chains(draw, most_tilt=None):
    """Axes and points in the base at q = 0, each axis drawn freely or in relation to the one before."""
    axes = [np.array(draw(directions))]
    axes[0] /= np.linalg.norm(axes[0])
    through = [np.array(draw(points))]
    kinds = [draw(st.sampled_from(["revolute", "continuous", "prismatic"]))]
    relations = ["near"] if most_tilt else ["free", "parallel", "antiparallel", "near", "cardinal"]
    for _ in range(draw(st.integers(1, 6))):
        relation, last = draw(st.sampled_from(relations)), axes[-1]
        if relation == "free":
            axis = np.array(draw(directions))
        elif relation == "cardinal":
            axis = np.eye(3)[draw(st.integers(0, 2))]
        elif relation == "near":
            tilt = 10 ** draw(st.floats(-6, -2))
            across = np.cross(last, draw(directions))
            axis = last + tilt * across / max(np.linalg.norm(across), 1e-3)
        else:
            axis = last if relation == "parallel" else -last
        axes.append(axis / np.linalg.norm(axis))
        place = draw(st.sampled_from(["free", "same", "on axis", "close"]))
        step = {
            "free": np.array(draw(points)),
            "same": np.zeros(3),
            "on axis": last * draw(st.floats(-0.3, 0.3)),
            "close": 10 ** draw(st.floats(-9, -2)) * np.array(draw(directions)),
        }[place]
        through.append(through[-1] + step)
        kinds.append(draw(st.sampled_from(["revolute", "revolute", "continuous", "prismatic"])))
    return list(
        zip(kinds, np.diff(through, axis=0, prepend=0), [(0, 0, 0)] * 9, axes, strict=False)
    )


@settings(max_examples=150, deadline=None, derandomize=True)
@given(chains(), points, points)
def test_rows_equal_forward_kinematics_of_any_chain(serial_urdf, joints, xyz, rpy):
    robot = Robot.from_urdf(serial_urdf(joints, (xyz, rpy)))
    table = assert_rows_equal_kinematics(robot)
    bound = 20 * (1 + reach(robot))
    assert max(max(abs(row.a), abs(row.d)) for row in table.rows) <= bound


@settings(max_examples=100, deadline=None, derandomize=True)
@given(chains(most_tilt=1e-2), points)
def test_nearly_parallel_axes_put_nothing_far_away(serial_urdf, joints, xyz):
    robot = Robot.from_urdf(serial_urdf(joints, (xyz, (0, 0, 0))))
    table = assert_rows_equal_kinematics(robot)
    assert all(row.near_parallel and row.d == 0 for row in table.rows[:-1])
    assert max(abs(row.a) for row in table.rows[:-1]) <= 1.1 * reach(robot)


@pytest.mark.parametrize("offset", [0.0, 1e-14, 1e-12, 1e-10, 2e-9, 1e-6])
def test_axes_that_almost_coincide(serial_urdf, offset):
    axis = np.array([1.0, 2.0, 3.0]) / np.sqrt(14)
    across = np.cross(axis, [0.3, -0.8, 0.1])
    joints = [
        ("revolute", (0.1, 0.2, 0.3), (0, 0, 0), axis),
        ("revolute", 0.4 * axis + offset * across, (0, 0, 0), axis),
        ("prismatic", -0.7 * axis + offset * across, (0, 0, 0), axis),
        ("revolute", (0.3, 0, 0.1), (0, 0, 0), (0, 0, 1)),
    ]
    assert_rows_equal_kinematics(Robot.from_urdf(serial_urdf(joints)), 1e-12)


def test_the_standard_convention_would_have_gone_kilometres_away(serial_urdf):
    tilt = 1e-6
    urdf = serial_urdf(
        [
            ("revolute", (0, 0, 0), (0, 0, 0), (0, 0, 1)),
            ("revolute", (0.3, 0, 0), (0, 0, 0), (tilt, 0, 1)),
        ]
    )
    row = dh_table(Robot.from_urdf(urdf)).rows[0]
    # The axes meet 300 km below; Hayati's row stays where the arm is.
    assert 0.3 / tilt > 2e5
    np.testing.assert_allclose((row.d, row.a, row.beta), (0, 0.3, tilt), atol=1e-12)


# Two branches, mimic joints


@pytest.mark.parametrize(
    ("name", "base", "tip"),
    [
        ("tiago_no_hand", "xtion_rgb_optical_frame", "wrist_ft_tool_link"),
        ("pr2", "r_gripper_tool_frame", "l_gripper_tool_frame"),
        ("pr2", "head_plate_frame", "r_gripper_l_finger_tip_link"),
        ("baxter", "right_gripper", "left_gripper"),
        ("panda", "panda_link0", "panda_rightfinger"),
        ("ur3", "tool0", "base"),
        ("kinova", "j2s6s200_end_effector", "j2s6s200_link_base"),
    ],
)
def test_rows_of_two_branches_and_of_mimic_joints(name, base, tip):
    robot = Robot.load(name, base, tip)
    table = assert_rows_equal_kinematics(robot)
    assert [row.joint for row in table.rows] == [joint.name for joint in robot.joints]


def test_the_ur3_turned_round_has_the_same_lengths():
    there = columns(dh_table(Robot.load("ur3", base="base", tip="tool0")))
    back = columns(dh_table(Robot.load("ur3", base="tool0", tip="base")))
    lengths = [sorted(np.round(np.abs(table["a"] + table["d"]), 9)) for table in (there, back)]
    assert lengths[0] == lengths[1]


@pytest.mark.parametrize(
    "path",
    [path for path in FILES if path.name not in REFUSED],
    ids=lambda p: f"{p.parents[1].name}/{p.name}",
)
def test_rows_between_any_two_links(path):
    urdf = Urdf.read(path)
    pairs = np.random.default_rng(len(urdf.data)).choice(urdf.links, (4, 2))
    for base, tip in pairs:
        try:
            robot = Robot.from_urdf(urdf, str(base), str(tip))
        except CalibError:  # nothing moves between them; what is refused is tested in test_chain.py
            continue
        assert_rows_equal_kinematics(robot)


# Rows back into placements


def perturbed(table: DHTable, seed: int = 4) -> DHTable:
    rng = np.random.default_rng(seed)

    def moved(row: DHRow) -> DHRow:
        keys = ("a", "alpha", "d", "theta", "beta")
        return replace(row, **{key: getattr(row, key) + rng.normal(0, 5e-3) for key in keys})

    return replace(table, rows=tuple(moved(row) for row in table.rows))


@pytest.mark.parametrize(
    ("name", "base", "tip"),
    [
        ("ur3", "base", "tool0"),
        ("ur3", "tool0", "base"),
        ("panda", "panda_link0", "panda_link8"),
        ("kinova", None, "j2s6s200_end_effector"),
        ("tiago_no_hand", None, "wrist_ft_tool_link"),
        ("tiago_no_hand", "xtion_rgb_optical_frame", "wrist_ft_tool_link"),
    ],
)
def test_dh_offsets_become_a_urdf(name, base, tip):
    robot = Robot.load(name, base, tip)
    table = perturbed(dh_table(robot))
    new = robot.with_placements(dh_placements(table, robot))
    again = robot.rebuilt(Urdf.from_bytes(new.urdf.data, "again.urdf"))
    q = np.random.default_rng(1).uniform(-3, 3, (5, len(robot.joint_names)))
    for values, pose, moved in zip(q, again.poses(q), robot.poses(q), strict=True):
        np.testing.assert_allclose(table.pose(values), pose, rtol=0, atol=1e-12)
        assert np.abs(pose - moved).max() > 1e-4


def test_one_row_s_offset_changes_one_or_two_placements(ur3):
    table = dh_table(ur3)
    rows = list(table.rows)
    rows[2] = replace(rows[2], a=rows[2].a + 1e-3)
    moved = dh_placements(replace(table, rows=tuple(rows)), ur3) - ur3.placements
    assert [i for i in range(7) if np.abs(moved[i]).max() > 1e-12] == [3]
    np.testing.assert_allclose(np.linalg.norm(moved[3, :3, 3]), 1e-3, atol=1e-15)


def test_rows_of_a_corrected_robot_are_its_own(ur3, panda):
    """The corrected robot's rows, with its frames chosen anew, move the nominal robot to where it is."""
    for robot in (ur3, panda):
        moved = robot.with_placements(dh_placements(perturbed(dh_table(robot)), robot))
        other = robot.with_placements(dh_placements(dh_table(moved), robot))
        q = np.random.default_rng(1).uniform(-3, 3, (5, len(robot.joints)))
        np.testing.assert_allclose(other.poses(q), moved.poses(q), rtol=0, atol=1e-12)


def test_the_placements_are_read_only(ur3):
    with pytest.raises(ValueError, match="read-only"):
        dh_placements(dh_table(ur3), ur3)[0, 0, 0] = 0


@pytest.mark.parametrize("fault", ["joints", "count", "sliding"])
def test_rows_of_another_chain_are_refused(ur3, panda, fault):
    table = dh_table(ur3)
    rows = {
        "joints": dh_table(panda).rows,
        "count": table.rows[:-1],
        "sliding": (replace(table.rows[0], prismatic=True), *table.rows[1:]),
    }
    with pytest.raises(
        ModelError, match=r"rows are of the joints '.*robot 'ur3' from 'base' to 't"
    ):
        dh_placements(replace(table, rows=rows[fault]), ur3)


# The frames


def test_frames_stand_on_the_axes(panda, ur3):
    for robot in (panda, ur3):
        joint_poses, _ = zero_poses(robot)
        for frame, pose, joint in zip(
            dh_frames(dh_table(robot)), joint_poses[1:], robot.joints[1:], strict=False
        ):
            axis = pose[:3, :3] @ joint.axis
            np.testing.assert_allclose(frame[:3, 2], axis, atol=1e-12)
            offset = pose[:3, 3] - frame[:3, 3]
            np.testing.assert_allclose(np.cross(offset, axis), 0, atol=1e-12)


def test_zero_poses_are_the_poses_at_zero(panda):
    joint_poses, tip = zero_poses(panda)
    np.testing.assert_allclose(tip, panda.poses(np.zeros(7))[0], atol=1e-15)
    link = Robot.load("panda", base="panda_link0", tip="panda_link4")
    np.testing.assert_allclose(joint_poses[3], link.poses(np.zeros(4))[0], atol=1e-15)


def test_the_table_is_read_only(ur3):
    table = dh_table(ur3)
    with pytest.raises(ValueError, match="read-only"):
        table.T_base_0[0, 0] = 0


def test_the_number_of_joint_values_must_fit(ur3):
    with pytest.raises(ValueError, match="zip"):
        dh_table(ur3).pose(np.zeros(5))
