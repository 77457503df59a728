"""Cells with a camera: what is drawn, and pixels by the equations written out, with noise, encoder and outliers."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from calib.boards.project import corner_pixels
from calib.camera.lenses import LENSES
from calib.camera.optics import across
from calib.data.cell import Cell, TrackerNoise
from calib.data.measurements import Measurements
from calib.errors import CalibError, ModelError
from calib.instruments.instrument import Sightline
from calib.robot.robot import Robot
from calib.verbs.simulate.disturbances import Encoder, MovedTarget, Outliers
from calib.verbs.simulate.equipment import usual_camera
from calib.verbs.simulate.scenario import Scenario, simulate
from calib.verbs.simulate.views import CameraScene, is_framed
from tests.verbs.simulate.cells import BOARD, CAMERA, changed

CELL = Cell(kind="pixel", cameras={"": CAMERA}, boards={"": BOARD})


def ur5() -> Robot:
    """The camera is on the flange, and the board in front of the foot."""
    return Robot.load("ur5", base="tool0", tip="base_link")


@pytest.fixture(scope="module")
def exact():
    """A cell in which all is exact but robot, camera and print."""
    cell = replace(CELL, cameras={"": usual_camera()})
    return Scenario(ur5(), cell, noise=None).draw(7)


@pytest.fixture(scope="module")
def views(exact):
    return exact.poses(12, seed=1)


@pytest.fixture(scope="module")
def plain(exact, views):
    return exact.measure(views)


@pytest.fixture(scope="module")
def scenario():
    return Scenario(ur5(), CELL, sigma={"px": 0.2})


@pytest.fixture(scope="module")
def simulated(scenario):
    return simulate(scenario, 6, 2, seed=3)


# Cells


def test_camera_print_and_robot_have_errors(exact):
    equipment, truth = exact.equipment, exact.truth
    assert np.abs(equipment.camera.values - equipment.stated.values).max() > 1.0
    assert 1e-4 < abs(equipment.printed.scale[1] - 1.0) < 0.02
    assert equipment.printed.offsets is not None
    assert np.abs(truth.x).max() > 1e-4
    assert truth.targets == ("board",)


def test_views_are_those_of_the_nominal_robot(exact):
    truth = exact.truth
    q = exact.poses(3, seed=1)
    sightline = Sightline(truth.nominal, truth.T_frame_base[0], truth.T_tip_target[0])
    nominal = sightline.target_poses(q)
    scene = CameraScene(sightline, exact.equipment.camera, exact.equipment.printed)
    assert is_framed(scene, nominal).all()
    distances = np.linalg.norm(truth.poses(q)[:, :3, 3] - nominal[:, :3, 3], axis=1)
    assert distances.min() > 1e-4
    assert distances.max() < 0.05


def test_views_to_validate_with_are_others(exact):
    truth = exact.truth
    q = exact.poses(4, seed=1)
    np.testing.assert_array_equal(q, exact.poses(4, seed=1))
    other = exact.poses(4, seed=1, validation=True)
    assert np.abs(q - other).min() > 1e-6
    sightline = Sightline(truth.nominal, truth.T_frame_base[0], truth.T_tip_target[0])
    scene = CameraScene(sightline, exact.equipment.camera, exact.equipment.printed)
    assert is_framed(scene, sightline.target_poses(other)).all()
    assert exact.poses(0, seed=1).shape == (0, 6)


def test_mounts_of_a_cell_file_are_taken(exact):
    T_camera_base, T_tip_board = exact.truth.T_frame_base[0], exact.truth.T_tip_target[0]
    stated = replace(
        exact.scenario.cell,
        T_frame_base=T_camera_base,
        target=T_tip_board[:3, 3],
        target_rotation=T_tip_board[:3, :3],
    )
    other = replace(exact.scenario, cell=stated).draw(11)
    np.testing.assert_allclose(other.truth.T_frame_base[0], T_camera_base)
    np.testing.assert_allclose(other.truth.T_tip_target[0], T_tip_board)
    with pytest.raises(CalibError, match="target_rpy_deg"):
        replace(exact.scenario, cell=replace(CELL, target=T_tip_board[:3, 3])).draw(11)


def test_the_cell_of_another_seed_is_another(exact):
    other, again = exact.scenario.draw(8), exact.scenario.draw(7)
    np.testing.assert_array_equal(again.truth.T_tip_target, exact.truth.T_tip_target)
    np.testing.assert_array_equal(again.equipment.camera.values, exact.equipment.camera.values)
    assert np.abs(other.truth.T_tip_target - exact.truth.T_tip_target).max() > 1e-3
    assert np.abs(other.equipment.camera.values - exact.equipment.camera.values).max() > 0.1


def test_without_a_camera_and_a_board_usual_ones_are_taken(scenario):
    equipment = replace(scenario, cell=Cell(kind="pixel")).draw(3).equipment
    np.testing.assert_array_equal(equipment.stated.values, usual_camera().values)
    assert equipment.printed.board.square == pytest.approx(0.036, abs=0.004)


def test_two_cameras_on_one_link_both_take_a_picture_of_the_board_at_each_pose(scenario):
    several = Cell(kind="pixel", cameras={"left": CAMERA, "right": CAMERA})
    made = simulate(replace(scenario, cell=several), 4, 0, seed=3)
    table, (left, right) = made.measurements, made.pictures.equipment.cameras
    assert made.truth.groups == ("left", "right")
    assert np.abs(left.values - right.values).max() > 0.1
    assert set(zip(table.groups, table.images, strict=True)) >= {
        ("left", "left_01.png"),
        ("right", "right_02.png"),  # each has its share of the poses
    }
    for group, camera in (("left", left), ("right", right)):
        rows = np.flatnonzero(np.array(table.groups) == group)
        pixels = np.column_stack([table.readings["u"], table.readings["v"]])[rows]
        corners = made.pictures.equipment.printed.corners[[int(table.corners[k]) for k in rows]]
        expected = []
        for T, corner in zip(made.T_frame_target[rows], corners, strict=True):
            drawn, _ = corner_pixels(camera, corner[None], T[None])
            expected.append(drawn[0, 0])
        assert np.abs(pixels - expected).max() < 5.0 * 0.3 + 0.5  # noise, repeatability


def test_what_pictures_do_not_have_is_refused(scenario):
    with pytest.raises(CalibError, match="moved_row"):
        simulate(replace(scenario, moved=MovedTarget(3, [0.0, 0.0, 1e-3])))
    with pytest.raises(CalibError, match="visits"):
        simulate(replace(scenario, visits=2))
    with pytest.raises(CalibError, match="drift_mm"):
        simulate(replace(scenario, drift=[0.0, 0.0, 1e-3]))


# Pictures


def test_pixels_follow_from_robot_mounts_print_and_lens(exact, views, plain):
    pictures, equipment = plain.pictures, exact.equipment
    np.testing.assert_array_equal(pictures.readings, views)
    k, row = 5, np.flatnonzero(pictures.picture == 5)[3]
    T_camera_base = exact.truth.T_frame_base[0]
    T_base_tip = exact.truth.robot.poses(views[k])[0]
    T = T_camera_base @ T_base_tip @ exact.truth.T_tip_target[0]
    board = BOARD.corners[pictures.corner[row]]
    xi, eta = 2.0 * board[:2] / BOARD.size - 1.0
    printed = equipment.printed
    corner = board * [*printed.scale, 0.0] + printed.offsets[pictures.corner[row]]
    corner[2] += printed.warp[0] * (1 - xi**2) + printed.warp[1] * (1 - eta**2)
    fx, fy, cx, cy, *distortion = equipment.camera.values
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    expected, _ = cv2.projectPoints(
        corner, cv2.Rodrigues(T[:3, :3])[0], T[:3, 3], K, np.array(distortion)
    )
    np.testing.assert_allclose(pictures.true_pixels[row], expected.ravel(), atol=1e-6)
    np.testing.assert_array_equal(pictures.pixels, pictures.true_pixels)


def test_the_fits_lenses_predict_the_same_pixels(simulated):
    """The fit's own equations, with the true numbers: OpenCV projected the corners here."""
    pictures = simulated.pictures
    printed, camera = pictures.equipment.printed, pictures.equipment.camera
    points = BOARD.corners[pictures.corner].copy()
    xi_eta = across(points, BOARD.centre, BOARD.size)
    points[:, 2] += (1.0 - xi_eta**2) @ printed.warp
    points[:, :2] = points[:, :2] * printed.scale + printed.offsets[pictures.corner, :2]
    T = pictures.T_camera_board[pictures.picture]
    in_camera = (T[:, :3, :3] @ points[:, :, None])[:, :, 0] + T[:, :3, 3]
    expected = LENSES[camera.lens].project(in_camera, camera.values)
    np.testing.assert_allclose(pictures.true_pixels, expected, atol=1e-8)


def test_noise_is_as_large_as_it_is_stated(exact, views):
    noisy = changed(exact, sigma={"px": 0.3})
    pictures = noisy.measure(views, seed=2).pictures
    assert pictures.sigma == 0.3
    assert (pictures.pixels - pictures.true_pixels).std() == pytest.approx(0.3, rel=0.1)
    again = noisy.measure(views, seed=2).pictures
    np.testing.assert_array_equal(again.pixels, pictures.pixels)


def test_encoders_and_repeatability_show(exact, views, plain):
    step = 1e-3
    coarse = changed(exact, encoder=Encoder(angle=step)).measure(views).pictures
    assert 0.2 * step < np.abs(coarse.readings - coarse.q).max() <= 0.5 * step + 1e-12
    np.testing.assert_allclose(np.round(coarse.readings / step) * step, coarse.readings)
    noise = TrackerNoise(0.0, 0.0, repeatability=1e-4)
    moved = changed(exact, noise=noise).measure(views).pictures
    shift = moved.T_camera_board[:, :3, 3] - plain.pictures.T_camera_board[:, :3, 3]
    assert shift.std() == pytest.approx(1e-4, rel=0.4)


def test_pictures_have_names_and_sets(exact, views):
    sets = ["estimate"] * 11 + ["validate"]
    pictures = exact.measure(views, sets=sets).pictures
    assert pictures.images[0] == "picture_01.png"
    assert pictures.images[-1] == "picture_12.png"
    assert pictures.sets[-1] == "validate"
    assert set(pictures.picture) == set(range(12))
    assert pictures.corner.max() == 23


def test_poses_from_which_nothing_is_seen_are_refused(exact):
    turned_away = np.add(exact.poses(1, seed=1), [np.pi, np.pi / 2, np.pi, 0, 0, 0])
    with pytest.raises(CalibError, match="1 poses"):
        exact.measure(turned_away)


def test_outliers_are_far_off_their_corners(scenario, simulated):
    disturbed = simulate(replace(scenario, outliers=Outliers(count=4)), 6, 2, seed=3)
    assert len(disturbed.outlier_rows) == 4
    rows = np.array(disturbed.outlier_rows) - 1
    assert (disturbed.pictures.picture[rows] < 6).all()
    moved = disturbed.pictures.pixels - simulated.pictures.pixels
    np.testing.assert_allclose(np.linalg.norm(moved[rows], axis=1), 5.0)
    np.testing.assert_allclose(np.delete(moved, rows, axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose(disturbed.outliers, moved, atol=1e-12)


# Simulations


def test_pictures_are_to_estimate_from_and_to_validate_with(simulated):
    pictures = simulated.pictures
    assert pictures.sets == ("estimate",) * 6 + ("validate",) * 2
    assert pictures.equipment.printed.board is BOARD
    assert pictures.equipment.stated is CAMERA
    assert pictures.sigma == 0.2


def test_the_table_has_a_row_for_each_corner(simulated, tmp_path):
    simulated.measurements.write(tmp_path / "corners.csv")
    pictures, robot = simulated.pictures, simulated.truth.nominal
    table = Measurements.read(tmp_path / "corners.csv", robot.joint_names)
    assert set(table.kinds) == {"pixel"}
    assert len(table) == len(pictures.picture)
    assert table.images[0] == "picture_01.png"
    assert table.corners[:3] == ("0", "1", "2")
    assert table.validation.sum() == (pictures.picture >= 6).sum()
    np.testing.assert_allclose(table.joints, pictures.readings[pictures.picture], atol=1e-12)
    np.testing.assert_allclose(table.board_points, BOARD.corners[pictures.corner], atol=1e-15)
    pixels = np.column_stack([table.reading("u"), table.reading("v")])
    np.testing.assert_allclose(pixels, pictures.pixels, atol=1e-12)
    np.testing.assert_allclose(table.sigma["px"], 0.2)


def test_rows_have_the_truth_of_their_pictures(simulated):
    pictures = simulated.pictures
    np.testing.assert_array_equal(simulated.q, pictures.q[pictures.picture])
    true = simulated.truth.poses(pictures.q)
    np.testing.assert_array_equal(simulated.T_frame_target, true[pictures.picture])
    assert (simulated.sigma == 0.2).all()
    assert not simulated.moved.any()


def test_poses_that_are_given_are_taken(scenario, simulated):
    q = simulated.pictures.readings[:3]
    sets = ("estimate", "validate", "estimate")
    given = simulate(scenario, 6, 0, seed=3, poses=q, sets=sets).pictures
    assert given.sets == sets
    np.testing.assert_array_equal(given.readings, q)
    with pytest.raises(ModelError, match="sets"):
        simulate(scenario, 6, 0, seed=3, poses=q, sets=sets[:2])
