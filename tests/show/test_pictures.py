"""Which pose of a calibration is shown, and where the page goes."""

from __future__ import annotations

import webbrowser
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.data import PAPER_TARGET, paper_measurements, paper_urdf
from calib.identify.calibration import calibrate
from calib.measure.cell import Cell
from calib.measure.measurements import Measurements
from calib.model.readback import random_joint_values
from calib.model.robot import Robot, read_only
from calib.show.pictures import view_of, write_page


@pytest.fixture(scope="module")
def result():
    robot = Robot.load(paper_urdf(), base="base", tip="tool0")
    table = Measurements.read(paper_measurements(), robot.joint_names, robot.joint_types)
    return calibrate(robot, table, cell=Cell(target=read_only(PAPER_TARGET)), validate=False)


def test_the_pose_is_the_validation_row_where_the_nominal_robot_is_furthest_off(result):
    view = view_of(result)
    assert view.pose_name == "row 35 (validation)"
    np.testing.assert_array_equal(view.q, result.measurements.joints[34])
    np.testing.assert_allclose(view.nominal_target, PAPER_TARGET)
    np.testing.assert_array_equal(view.calibrated_target, result.target)


def test_without_validation_rows_an_outlier_is_not_shown(result):
    every = replace(result.measurements, sets=("estimate",) * 35)
    worst = np.array(result.residual_nominal)
    worst[10] *= 100.0  # row 11, the outlier
    view = view_of(replace(result, measurements=every, residual_nominal=worst))
    assert view.pose_name.endswith("(estimation)")
    assert view.index != 10


def test_measured_points_are_shown_in_the_base_frame(result):
    T = np.eye(4)
    T[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    T[:3, 3] = [2.0, -1.0, 0.4]
    moved = replace(result.measurements, points=result.measurements.points @ T[:3, :3].T + T[:3, 3])
    setup = result.setup.placed(T[None], result.setup.T_tip_target)
    view = view_of(replace(result, measurements=moved, setup=setup))
    np.testing.assert_allclose(view.measured, result.measurements.points, atol=1e-12)


def test_the_page_names_the_row_and_both_errors(result, tmp_path):
    text = write_page(result, tmp_path / "view.html").read_text(encoding="utf-8")
    assert "row 35 (validation)" in text
    assert "3.61" in text
    assert "0.27" in text


def test_show_opens_the_page_in_the_browser(result, monkeypatch):
    opened = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    page = calib.show(result)
    assert opened == [Path(page).as_uri()]
    assert page.is_file()


def test_errors_in_the_picture_are_those_of_the_tables_when_the_frame_is_found(tmp_path):
    robot = Robot.load(paper_urdf(), base="base", tip="tool0")
    table = Measurements.read(paper_measurements(), robot.joint_names, robot.joint_types)
    found = calibrate(robot, table, cell=Cell(estimate_frame=True), validate=False)
    view = view_of(found)
    row = view.index
    tip = view.T_base_nominal @ view.nominal.poses(view.q)[0]
    nominal = tip[:3, :3] @ view.nominal_target + tip[:3, 3]
    off = float(np.linalg.norm(found.residual_nominal[row]))
    assert np.linalg.norm(view.measured[row] - nominal) == pytest.approx(off, abs=1e-12)
    # Each of the two finds the tracker elsewhere: without that, the number would be another.
    elsewhere = robot.poses(view.q)[0] @ np.array([*view.nominal_target, 1.0])
    assert abs(np.linalg.norm(view.measured[row] - elsewhere[:3]) - off) > 1e-4
    text = write_page(found, tmp_path / "view.html").read_text(encoding="utf-8")
    assert f"nominal <b>{1e3 * off:.2f} mm</b>" in text


def arm_and_joints(count: int):
    robot = Robot.load(paper_urdf(), base="base", tip="tool0")
    q = random_joint_values(robot, count, 3)
    T = robot.poses(q)
    return robot, q, T[:, :3, :3] @ PAPER_TARGET + T[:, :3, 3]


def test_tables_without_positions_have_a_picture(tmp_path):
    """Distances to anchors: both robots stand there, without a measured point."""
    robot, q, points = arm_and_joints(60)
    anchors = np.array([[0.6, 0.1, 0.2], [-0.5, 0.6, 0.1], [0.1, -0.7, 0.5]])
    which = np.arange(60) % 3
    table = Measurements(
        joint_names=robot.joint_names,
        joints=q,
        points=np.full((60, 3), np.nan),
        kinds=("distance",) * 60,
        distances=np.linalg.norm(points - anchors[which], axis=1),
        groups=tuple(f"a{k}" for k in which),
    )
    found = calibrate(robot, table, model="zeros", validate=False)
    view = view_of(found)
    assert view.measured.shape == (0, 3)
    assert view.index is None
    assert np.any(np.all(view.q == table.joints, axis=1))
    assert write_page(found, tmp_path / "view.html").is_file()


def test_the_target_and_set_up_of_the_row_are_shown(tmp_path):
    robot, q, points = arm_and_joints(60)
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    far = np.arange(60) >= 30
    seen = np.where(far[:, None], points @ turn.T + [2.0, 1.0, 0.5], points)
    seen[40, :] += 0.004 * np.array([0.6, 0.0, 0.8])
    table = Measurements(
        joint_names=robot.joint_names,
        joints=q,
        points=seen,
        sets=tuple("validate" if k == 40 else "estimate" for k in range(60)),
        groups=tuple("far" if f else "near" for f in far),
        targets=tuple("one" if k % 2 else "two" for k in range(60)),
    )
    frames = {"near": np.eye(4), "far": np.eye(4)}
    frames["far"][:3, :3], frames["far"][:3, 3] = turn, [2.0, 1.0, 0.5]
    found = calibrate(robot, table, cell=Cell(frames=frames, model="zeros"), validate=False)
    view = view_of(found)
    # Points of both set-ups stand in the base, where the robot is.
    kept = np.arange(60) != 40
    np.testing.assert_allclose(view.measured[kept], points[kept], atol=1e-9)
    t = found.setup.targets.index(table.targets[view.index])
    np.testing.assert_array_equal(view.calibrated_target, found.setup.T_tip_target[t, :3, 3])
    assert write_page(found, tmp_path / "view.html").is_file()
