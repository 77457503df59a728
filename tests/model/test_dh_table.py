from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.spatial.transform import Rotation

from calib.model.dh_table import dh_table, near_parallel, taken_as_parallel
from calib.robot.dh_rows import CONVENTIONS, DHRobot, DHRow, DHTable, screw
from calib.robot.robot import Robot
from calib.robot.urdf import urdf_of_dh
from tests.robot.shared import SOME_AND_SLOWLY_ALL

LENGTHS_MM = {  # the maker's d1, a2, a3, d4, d5, d6
    "ur3": (151.9, -243.65, -213.25, 112.35, 85.35, 81.9),
    "ur5": (89.159, -425.0, -392.25, 109.15, 94.65, 82.3),
    "ur10": (127.3, -612.0, -572.3, 163.941, 115.7, 92.2),
}


def reach(robot: Robot) -> float:
    return float(np.linalg.norm(robot.placements[:, :3, 3], axis=1).sum())


def assert_rows_equal_kinematics(robot: Robot, tolerance: float = 1e-12) -> DHTable:
    table = dh_table(robot)
    q = np.random.default_rng(11).uniform(-3, 3, (4, len(robot.joint_names)))
    np.testing.assert_allclose(
        table.poses(robot.chain_values(q)), robot.poses(q), rtol=0, atol=tolerance
    )
    return table


KEYS = ("theta", "d", "a", "alpha", "beta")


def column(rows: DHTable, key: str) -> list[float]:
    return [getattr(row, key) for row in rows.rows]


def pose_by_hand(rows: DHTable, values: np.ndarray) -> np.ndarray:
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


def assert_same_poses(rows: DHTable, robot: Robot, tolerance: float = 1e-11) -> None:
    q = np.random.default_rng(3).uniform(-3, 3, (5, len(robot.joint_names)))
    values = robot.chain_values(q)
    found = rows.poses(values)
    np.testing.assert_allclose(found, robot.poses(q), rtol=0, atol=tolerance)
    np.testing.assert_allclose(pose_by_hand(rows, values[0]), found[0], rtol=0, atol=tolerance)


# Golden tables


@pytest.mark.parametrize("name", LENGTHS_MM)
def test_universal_robots(name):
    table = dh_table(Robot.load(name, base="base", tip="tool0"))
    d1, a2, a3, d4, d5, d6 = LENGTHS_MM[name]
    golden = {
        "a": np.array([0, a2, a3, 0, 0, 0]) / 1e3,
        "alpha": np.radians([90, 0, 0, 90, -90, 0]),
        "d": np.array([d1, 0, 0, d4, d5, d6]) / 1e3,
        "theta": [0] * 6,
        "beta": [0] * 6,
    }
    for key, values in golden.items():
        np.testing.assert_allclose(column(table, key), values, rtol=0, atol=1e-9, err_msg=key)


# Every chain


@pytest.mark.parametrize("path", SOME_AND_SLOWLY_ALL)
def test_rows_equal_forward_kinematics(path):
    robot = Robot.load(path)
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


@settings(max_examples=40, deadline=None, derandomize=True)
@given(chains(), points, points)
def test_rows_equal_forward_kinematics_of_any_chain(serial_urdf, joints, xyz, rpy):
    robot = Robot.from_urdf(serial_urdf(joints, (xyz, rpy)))
    table = assert_rows_equal_kinematics(robot)
    bound = 20 * (1 + reach(robot))
    assert max(max(abs(row.a), abs(row.d)) for row in table.rows) <= bound


# Before and after


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_the_columns_of_a_corrected_robot_compare(ur3, panda, convention):
    for robot in (ur3, panda):
        before, corrected = dh_table(robot, convention), displaced(robot)
        after = dh_table(corrected, convention, like=robot)
        assert_same_poses(after, corrected)
        far = {name for pair in near_parallel(corrected) for name in pair}
        for row, then in zip(before.rows, after.rows, strict=True):
            # A row between axes of the pure conventions that are nearly parallel may be anywhere.
            if convention == "hayati" or not ({row.joint} & far):
                change = [getattr(then, key) - getattr(row, key) for key in KEYS]
                assert np.abs(change).max() < 0.03, row.joint
        for name in ("T_base_0", "T_n_tip"):
            np.testing.assert_allclose(getattr(after, name), getattr(before, name), atol=0.03)


def test_pure_rows_of_nearly_parallel_axes_lie_far_away_and_hold(ur3):
    corrected = displaced(ur3, size=1e-2)
    pairs = near_parallel(corrected)
    assert set(pairs) == {
        ("shoulder_lift_joint", "elbow_joint"),
        ("elbow_joint", "wrist_1_joint"),
    }
    assert all(1e-6 < angle < 1e-3 for angle in pairs.values())
    for convention in ("standard", "modified"):
        rows = dh_table(corrected, convention, like=ur3)
        assert np.abs(column(rows, "d")).max() > 0.3
        assert column(rows, "beta") == [0.0] * 6
        assert_same_poses(rows, corrected, 1e-10)
    assert np.abs(column(dh_table(corrected, "hayati", like=ur3), "d")).max() < 0.2


def test_axes_that_are_parallel_but_for_rounding_are_taken_as_parallel(ur3):
    placements = ur3.placements.copy()
    placements[2, :3, :3] = placements[2, :3, :3] @ Rotation.from_rotvec([3e-8, 0, 0]).as_matrix()
    corrected = ur3.with_placements(placements)
    assert near_parallel(corrected) == {}
    assert taken_as_parallel(corrected) == pytest.approx(3e-8, rel=1e-3)
    assert taken_as_parallel(ur3) < 1e-10
    rows = dh_table(corrected, "standard", like=ur3)
    assert np.abs(column(rows, "d")).max() < 0.2
    assert_same_poses(rows, corrected, 2 * 3e-8)
    assert_same_poses(dh_table(corrected, "hayati", like=ur3), corrected, 1e-12)


# In the form of rows that a controller has


def sheet_of(seed: int, convention: str) -> DHTable:
    """Rows as data sheets have them: square, parallel and coincident axes, directions, offsets, sliding joints."""
    rng = np.random.default_rng(seed)
    angles = (0.0, np.pi / 2, -np.pi / 2, np.pi, 0.3)
    rows = []
    for i in range(6):
        slides = bool(rng.random() < 0.3)
        rows.append(
            DHRow(
                joint=f"j{i}",
                prismatic=slides,
                theta=float(rng.choice(angles[:3])),
                d=float(rng.choice((0.0, 0.2, -0.35))),
                a=float(rng.choice((0.0, 0.4, -0.05))),
                alpha=float(rng.choice(angles)),
                direction=int(rng.choice((1, -1))),
                offset=float(rng.choice((0.0, 0.1))),
                lower=-0.5,
                upper=1.0,
            )
        )
    shift = screw(0, 0.3, 0.1) @ screw(2, -0.4, 0.2)
    return DHTable(tuple(rows), shift, shift @ screw(1, np.pi / 2, 0.3), convention)


@pytest.mark.parametrize("convention", CONVENTIONS)
@pytest.mark.parametrize("seed", range(8))
def test_a_robot_of_rows_has_these_rows(seed, convention):
    sheet = sheet_of(seed, convention)
    robot = Robot.from_urdf(urdf_of_dh(DHRobot(sheet), "sheet.csv"))
    table = dh_table(robot, convention, sheet=sheet)
    assert table.convention == convention
    for row, wanted in zip(table.rows, sheet.rows, strict=True):
        # To the last digit: what differs by rounding alone is the sheet's.
        for key in (*KEYS, "direction", "offset", "joint", "prismatic", "lower", "upper"):
            assert getattr(row, key) == getattr(wanted, key), row.joint
    np.testing.assert_array_equal(table.T_base_0, sheet.T_base_0)
    np.testing.assert_array_equal(table.T_n_tip, sheet.T_n_tip)
    corrected = displaced(robot)
    after = dh_table(corrected, convention, sheet=sheet)
    q = np.random.default_rng(3).uniform(-3, 3, (5, 6))
    np.testing.assert_allclose(after.poses(q), corrected.poses(q), rtol=0, atol=1e-9)
