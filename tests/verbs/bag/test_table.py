"""Rows of stops and of a moving arm, read back as a table of measurements."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calib.data.measurements import Measurements
from calib.robot.robot import Robot
from calib.verbs.bag.stops import find_stops
from calib.verbs.bag.streams import JointStream, PointStream
from calib.verbs.bag.table import (
    Settings,
    moving_rows,
    stop_rows,
    table_bytes,
    used_spans,
)
from tests.verbs.bag.motions import stop_and_go, streams, wandering

NAMES = ("a", "b")


def constant(seconds: float = 4.0) -> tuple[JointStream, PointStream]:
    """An arm that stands, and a point with noise of 0.1 mm, of which neighbours in tens are one value."""
    rng = np.random.default_rng(0)
    t = np.arange(0.0, seconds, 0.01)
    q = np.tile([0.5, -0.25], (len(t), 1))
    noise = np.repeat(rng.standard_normal((len(t) // 10, 3)), 10, axis=0)
    p = np.array([1.0, 2.0, 3.0]) + 1e-4 * noise
    return JointStream(NAMES, t, q, q * np.nan), PointStream("/p", "", "", t, p, p[:, [0] * 4] * np.nan)  # fmt: skip


def test_what_is_left_of_stops():
    stops = np.array([[0.0, 0.5], [2.0, 2.95], [5.0, 9.0]])
    spans, skipped = used_spans(stops, Settings())
    np.testing.assert_allclose(spans, [[2.5, 2.85], [5.5, 8.9]])
    assert [(each.code, each.begin, each.length) for each in skipped] == [("short", 0.0, 0.5)]


def test_a_stop_is_the_mean_of_its_samples_and_its_sigma_that_of_the_mean():
    joints, points = constant(100.0)
    spans = np.array([[10.0 * k + 0.5, 10.0 * k + 9.5] for k in range(10)])
    rows, skipped = stop_rows(joints, [points], {"/p": 0.0}, spans)
    assert not skipped
    assert [row.samples for row in rows] == pytest.approx([900] * 10, abs=1)
    errors = np.array([row.position - [1.0, 2.0, 3.0] for row in rows])
    # 90 independent values, not 900 samples: 0.1 mm / sqrt(90).
    wanted = 1e-4 / np.sqrt(90)
    assert np.sqrt(np.mean([row.sigma**2 for row in rows])) == pytest.approx(wanted, rel=0.3)
    assert errors.std() == pytest.approx(wanted, rel=0.4)


def test_the_lag_is_taken_out_and_a_missing_point_is_said(tmp_path: Path):
    joints, points = constant(10.0)
    q = np.array(joints.q)
    q[joints.times >= 5.0] = [0.7, 0.1]
    moved = JointStream(NAMES, joints.times, q, joints.speeds)
    p = np.where(points.times[:, None] < 5.0 + 2.0, 1.0, 4.0) * np.ones(3)
    late = PointStream("/p", "", "", points.times, p, points.quaternions)
    gone = PointStream("/g", "", "t", points.times[:300], p[:300], points.quaternions[:300])
    spans = np.array([[1.0, 4.5], [5.5, 7.5]])
    rows, skipped = stop_rows(moved, [late, gone], {"/p": 2.0, "/g": 0.0}, spans)
    assert [(row.target, row.position[0], round(row.q[0], 9)) for row in rows] == [
        ("", 1.0, 0.5),
        ("t", 1.0, 0.5),
        ("", 4.0, 0.7),
    ]
    assert [(each.code, each.topic, each.begin) for each in skipped] == [("no_point", "/g", 5.5)]
    # A stop without any point is a pose that the arm drove through.
    rows, _ = stop_rows(moved, [gone], {"/g": 0.0}, spans)
    assert [row.samples > 0 for row in rows] == [True, False]
    text = table_bytes(NAMES, (), rows).decode().splitlines()
    assert text[0].startswith("order,a [deg],b [deg],set,target,x [mm],y [mm],z [mm]")
    assert [line.split(",")[3] for line in text[1:]] == ["estimate", "via"]
    path = tmp_path / "table.csv"
    path.write_bytes(table_bytes(NAMES, (), rows))
    table = Measurements.read(path, NAMES)
    assert len(table.points) == 1


def test_the_table_is_one_of_calib(tmp_path: Path):
    rng = np.random.default_rng(1)
    robot = Robot.load("ur5", base="base_link", tip="tool0")
    motion = stop_and_go(rng, stops=8)
    joints, points = streams(motion, robot, rng, 0.0)
    spans, _ = used_spans(find_stops(joints), Settings())
    rows, _ = stop_rows(joints, [points], {"/tracker": 0.0}, spans)
    path = tmp_path / "table.csv"
    path.write_bytes(table_bytes(joints.names, ["elbow_joint"], rows))
    text = path.read_text().replace("elbow_joint [mm]", "elbow_joint [mrad]")
    path.write_text(text)
    table = Measurements.read(path, robot.joint_names)
    true = motion.at(spans.mean(axis=1))
    np.testing.assert_allclose(table.joints, true, atol=2e-5)
    np.testing.assert_allclose(table.points, [row.position for row in rows], atol=1e-12)
    assert set(table.kinds) == {"point"}


def test_rows_of_a_moving_arm_have_the_joints_at_the_points_times():
    rng = np.random.default_rng(2)
    robot = Robot.load("ur5", base="base_link", tip="tool0")
    motion = wandering(rng, duration=10.0)
    joints, points = streams(motion, robot, rng, 0.75, jitter=0.0, joint_noise=0.0)
    rows = moving_rows(joints, [points], {"/tracker": 0.75})
    times = np.array([row.time for row in rows])
    assert (np.diff(times) > 0.0).all()
    assert len(rows) > 0.9 * len(points.times)
    np.testing.assert_allclose([row.q for row in rows], motion.at(times), atol=2e-4)
    # Where joint values are missing, there is no row.
    kept = (joints.times < 3.0) | (joints.times > 5.0)
    gap = JointStream(joints.names, joints.times[kept], joints.q[kept], joints.speeds[kept])
    between = [row.time for row in moving_rows(gap, [points], {"/tracker": 0.75})]
    assert not any(3.0 < time < 5.0 for time in between)


def test_poses_have_the_mean_orientation_and_kinds_are_told_apart(tmp_path: Path):
    joints, points = constant()
    half = np.array([0.0, 0.0, np.sin(0.1), np.cos(0.1)])
    turns = np.tile(half, (len(points.times), 1))
    turns[::2] *= -1.0  # the same orientations
    poses = PointStream("/q", "", "tool", points.times, points.positions, turns)
    spans = np.array([[0.5, 3.5]])
    rows, _ = stop_rows(joints, [points, poses], {"/p": 0.0, "/q": 0.0}, spans)
    np.testing.assert_allclose(np.abs(rows[1].quaternion), half, atol=1e-12)
    assert rows[1].sigma_angle == pytest.approx(0.0, abs=1e-12)
    path = tmp_path / "table.csv"
    path.write_bytes(table_bytes(NAMES, (), rows))
    table = Measurements.read(path, NAMES)
    assert tuple(table.kinds) == ("point", "pose")
    assert tuple(table.targets)[1] == "tool"
