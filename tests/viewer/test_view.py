"""What a view holds, and what it refuses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.calibration import calibrate
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.errors import FileError, ModelError
from calib.example import PAPER_TARGET, paper_measurements, paper_urdf
from calib.result.uncertainty import workspace_uncertainty
from calib.robot.readback import column_ranges, random_joint_values
from calib.robot.robot import Robot
from calib.viewer.page import write_page
from calib.viewer.view import (
    EVERYWHERE,
    MEASURED,
    View,
    cloud_of,
    translated,
    view_of,
    view_of_robots,
)
from tests.hard_cases import made, with_rows


def test_what_is_left_out_is_filled_in(ur3, disturb):
    q = np.linspace(-1, 1, 18).reshape(3, 6)
    view = View(ur3, disturb(ur3), q)
    assert view.labels == ("pose 1", "pose 2", "pose 3")
    assert view.kinds == ("pose",) * 3
    assert not view.measures
    assert np.isnan(view.distances).all()
    np.testing.assert_allclose(view.predicted[0], ur3.poses(q)[:, :3, 3])
    assert list(view.robots) == ["nominal", "calibrated"]
    assert list(View(ur3, None, q).robots) == ["nominal"]


def test_predictions_are_those_of_the_robots_in_one_base(ur3, disturb):
    q = np.linspace(-1, 1, 12).reshape(2, 6)
    shift, target = translated([0.001, 0, 0]), translated([0.0, 0.02, 0.1])
    view = View(
        ur3, disturb(ur3), q, T_base_nominal=shift, nominal_target=target, calibrated_target=target
    )
    nominal = (ur3.poses(q) @ target)[:, :3, 3] + [0.001, 0, 0]
    np.testing.assert_allclose(view.predicted[0], nominal, atol=1e-15)
    measured = view.predicted[1] + [0, 0, 0.002]
    seen = replace(view, measured=measured)
    np.testing.assert_allclose(seen.distances[1], 0.002)
    np.testing.assert_allclose(seen.distances[0], np.linalg.norm(measured - nominal, axis=1))


def test_some_of_the_poses(ur3_view):
    chosen = [4, 30, 34]
    part = ur3_view.select(chosen, 1)
    assert part.labels == ("row 5", "row 31", "row 35")
    assert (part.start, part.rows) == (1, 35)
    np.testing.assert_array_equal(part.measured, ur3_view.measured[chosen])
    np.testing.assert_array_equal(part.errors, ur3_view.errors[:, chosen])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"q": np.zeros((35, 5))}, r"q has shape \(35, 5\); finite numbers of shape \(35, 6\)"),
        ({"q": np.full((35, 6), np.nan)}, "q has shape"),
        ({"q": np.zeros((0, 6))}, r"q has shape \(0, 6\)"),
        ({"q": np.zeros(6)}, r"q has shape \(6,\)"),
        ({"nominal_target": np.zeros(2)}, r"nominal_target has shape \(2,\)"),
        ({"T_base_nominal": np.full((4, 4), np.nan)}, "T_base_nominal has shape"),
        ({"measured": np.zeros((4, 3))}, r"measured has shape \(4, 3\); .* shape \(35, 3\)"),
        ({"errors": np.zeros((35, 2))}, r"errors has shape \(35, 2\); .* shape \(2, 35\)"),
        ({"instruments": np.zeros((35, 3))}, "instruments has shape"),
    ],
)
def test_what_does_not_fit_is_refused(ur3_view, change, message):
    with pytest.raises(ModelError, match=message):
        replace(ur3_view, **change)


def test_two_different_robots_are_refused(ur3, gantry):
    with pytest.raises(ModelError, match=r"'shoulder_pan_joint'.*'x', 'y', 'c'.*the same chain"):
        View(ur3, gantry, np.zeros((1, 6)))


def test_the_arrays_of_a_view_are_copies_that_cannot_be_written_to(ur3):
    q = np.zeros((1, 6))
    view = View(ur3, ur3, q)
    q[0] = 1
    assert view.q[0, 0] == 0
    for array in (view.q, view.measured, view.nominal_target):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1


@pytest.fixture(scope="module")
def result():
    return made("paper")


def test_every_row_is_a_pose_and_the_worst_one_held_back_is_shown_first(result):
    view = view_of(result)
    assert view.labels == tuple(f"row {row}" for row in range(1, 36))
    assert view.labels[view.start] == "row 35"
    assert [view.labels[n] for n in range(35) if view.kinds[n] == "flagged"] == ["row 11", "row 14"]
    assert view.kinds[30:] == ("validation",) * 5
    np.testing.assert_array_equal(view.q, result.measurements.joints)
    np.testing.assert_allclose(view.nominal_target[:, :3, 3], np.tile(PAPER_TARGET, (35, 1)))
    np.testing.assert_array_equal(view.calibrated_target[3, :3, 3], result.target)
    assert view.verdict == "use"
    assert view.note == str(result.verdict.reasons[0])


def test_the_distances_in_the_picture_are_the_errors_of_the_tables(result):
    view = view_of(result, cloud=False)
    np.testing.assert_allclose(view.distances, view.errors, atol=1e-12)
    for k, who in enumerate(("nominal", "calibrated")):
        for name, mask in (("estimation", slice(0, 30)), ("validation", slice(30, 35))):
            rms = np.sqrt(np.mean(view.distances[k, mask] ** 2))
            assert rms == pytest.approx(result.errors[who][name].rms, abs=1e-12)
    assert np.isnan(view.instruments).all()  # measured in the base itself
    assert view.cloud is None


def test_without_validation_rows_an_outlier_is_not_shown_first(result):
    every = replace(result.measurements, sets=("estimate",) * 35)
    worst = np.array(result.residual_nominal)
    worst[10] *= 100.0  # row 11, the outlier
    view = view_of(with_rows(replace(result, residual_nominal=worst), every), cloud=False)
    assert view.kinds[view.start] == "estimation"


def test_measured_points_are_shown_in_the_base_frame_and_the_tracker_where_it_stands(result):
    T = np.eye(4)
    T[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    T[:3, 3] = [2.0, -1.0, 0.4]
    moved = replace(result.measurements, points=result.measurements.points @ T[:3, :3].T + T[:3, 3])
    setup = result.setup.placed(T[None], result.setup.T_tip_target)
    view = view_of(with_rows(replace(result, setup=setup), moved), cloud=False)
    np.testing.assert_allclose(view.measured, result.measurements.points, atol=1e-12)
    np.testing.assert_allclose(view.instruments, np.tile(np.linalg.inv(T), (35, 1, 1)), atol=1e-12)


def test_the_page_is_a_file(result, tmp_path):
    path = write_page(result, tmp_path / "view.html")
    text = path.read_text(encoding="utf-8")
    assert "row 35" in text
    assert "Verdict: use." in text
    with pytest.raises(FileError, match="exists already"):
        write_page(result, path)


def test_one_robot_moves_one_joint_after_the_other(gantry):
    view = view_of_robots(gantry)
    moved = np.abs(view.q - view.q[0]) > 1e-12
    assert moved.sum(axis=1).max() == 1
    assert view.labels[0].startswith("all joints at zero")
    ranges = column_ranges(gantry)
    np.testing.assert_allclose(np.stack([view.q.min(axis=0), view.q.max(axis=0)], axis=1), ranges)
    assert f"x at {1e3 * ranges[0, 0]:.4g} mm" in view.labels
    assert f"c at {np.degrees(ranges[2, 1]):.4g} deg" in view.labels


def test_two_robots_and_a_table_show_what_evaluate_says(result):
    cell = result.cell
    found = [
        calib.evaluate(robot, result.measurements, cell) for robot in (result.nominal, result.robot)
    ]
    view = view_of_robots(
        result.nominal, result.robot, evaluations=tuple(found), flagged=frozenset({11})
    )
    for k, one in enumerate(found):
        np.testing.assert_allclose(
            view.distances[k], np.linalg.norm(one.residual, axis=1), atol=1e-12
        )
    assert view.kinds.count("flagged") == 1
    assert view.labels[view.start] == "row 35"


def test_errors_in_the_picture_are_those_of_the_tables_when_the_frame_is_found():
    robot = Robot.load(paper_urdf(), base="base", tip="tool0")
    table = Measurements.read(paper_measurements(), robot.joint_names, robot.joint_types)
    found = calibrate(robot, table, cell=Cell(estimate_frame=True), validate=False)
    view = view_of(found, cloud=False)
    off = np.linalg.norm(found.residual_nominal, axis=1)
    np.testing.assert_allclose(view.distances[0], off, atol=1e-12)
    # Each of the two finds the tracker elsewhere: without that, the number would be another.
    elsewhere = replace(view, T_base_nominal=np.eye(4)).distances[0]
    assert np.abs(elsewhere - off).max() > 1e-4
    assert np.isfinite(view.instruments).all()


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
    assert not view.measures
    np.testing.assert_array_equal(view.q, table.joints)
    # What each robot leaves over of a distance is told beside the picture.
    np.testing.assert_allclose(view.errors[0], np.abs(found.residual_nominal[:, 0]))
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
    for row in (0, 1, 40):
        t = found.setup.targets.index(table.targets[row])
        np.testing.assert_array_equal(view.calibrated_target[row], found.setup.T_tip_target[t])
    assert np.isfinite(view.instruments[:, 0, 0]).tolist() == far.tolist()
    assert write_page(found, tmp_path / "view.html").is_file()


def test_the_cloud_is_the_uncertainty_over_the_workspace(result):
    cloud = cloud_of(result)
    assert cloud.points.shape == (EVERYWHERE + MEASURED, 3)
    same = workspace_uncertainty(result, EVERYWHERE)
    np.testing.assert_allclose(cloud.std[:EVERYWHERE], same.std, rtol=1e-12)
    np.testing.assert_allclose(cloud.points[:EVERYWHERE], result.predict(same.q), atol=1e-12)
    # Where joints were measured positions are known better.
    assert cloud.measured[EVERYWHERE:].all()
    assert not cloud.measured[:EVERYWHERE].all()
    assert np.median(cloud.std[cloud.measured]) < np.median(cloud.std[~cloud.measured])
