"""Pictures from a scenario: sets, poses, camera and board of the cell, the table, outliers, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.camera.lenses import LENSES
from calib.camera.optics import across
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.errors import CalibError, ModelError
from calib.robot.robot import Robot
from calib.verbs.simulate.camera.simulate import board_of, camera_of, simulate_pictures
from calib.verbs.simulate.disturbances import MovedTarget, Outliers
from calib.verbs.simulate.scenario import Scenario, simulate
from tests.verbs.simulate.camera.cells import BOARD, CAMERA


@pytest.fixture(scope="module")
def scenario():
    cell = Cell(kind="pixel", cameras={"": CAMERA}, boards={"": BOARD})
    return Scenario(Robot.load("ur5", base="tool0", tip="base_link"), cell, sigma={"px": 0.2})


@pytest.fixture(scope="module")
def pictures(scenario):
    return simulate_pictures(scenario, 6, 2, seed=3)


def test_pictures_are_to_estimate_from_and_to_validate_with(pictures):
    assert pictures.sets == ("estimate",) * 6 + ("validate",) * 2
    assert pictures.cell.printed.board is BOARD
    assert pictures.cell.stated is CAMERA
    assert pictures.sigma == 0.2


def test_the_table_has_a_row_for_each_corner(pictures, tmp_path):
    pictures.measurements.write(tmp_path / "corners.csv")
    robot = pictures.cell.truth.nominal
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


def test_the_fits_lenses_predict_the_same_pixels(pictures):
    """The fit's own equations, with the true numbers: OpenCV projected the corners here."""
    printed, camera = pictures.cell.printed, pictures.cell.camera
    points = BOARD.corners[pictures.corner].copy()
    xi_eta = across(points, BOARD.centre, BOARD.size)
    points[:, 2] += (1.0 - xi_eta**2) @ printed.warp
    points[:, :2] = points[:, :2] * printed.scale + printed.offsets[pictures.corner, :2]
    T = pictures.T_camera_board[pictures.picture]
    in_camera = (T[:, :3, :3] @ points[:, :, None])[:, :, 0] + T[:, :3, 3]
    expected = LENSES[camera.lens].project(in_camera, camera.values)
    np.testing.assert_allclose(pictures.true_pixels, expected, atol=1e-8)


def test_poses_that_are_given_are_taken(scenario, pictures):
    q = pictures.readings[:3]
    sets = ("estimate", "validate", "estimate")
    given = simulate_pictures(scenario, 6, 0, seed=3, poses=q, sets=sets)
    assert given.sets == sets
    np.testing.assert_array_equal(given.readings, q)
    with pytest.raises(ModelError, match="sets"):
        simulate_pictures(scenario, 6, 0, seed=3, poses=q, sets=sets[:2])


def test_without_a_camera_and_a_board_usual_ones_are_taken(scenario):
    bare = replace(scenario, cell=Cell(kind="pixel"))
    assert camera_of(bare).width == 1280
    assert board_of(bare).square == pytest.approx(0.036, abs=0.004)
    several = replace(scenario, cell=Cell(kind="pixel", cameras={"left": CAMERA, "right": CAMERA}))
    with pytest.raises(CalibError, match="left"):
        camera_of(several)


def test_outliers_are_far_off_their_corners(scenario, pictures):
    disturbed = simulate_pictures(replace(scenario, outliers=Outliers(count=4)), 6, 2, seed=3)
    assert len(disturbed.outlier_rows) == 4
    rows = np.array(disturbed.outlier_rows) - 1
    assert (disturbed.picture[rows] < 6).all()
    moved = disturbed.pixels - pictures.pixels
    np.testing.assert_allclose(np.linalg.norm(moved[rows], axis=1), 5.0)
    np.testing.assert_allclose(np.delete(moved, rows, axis=0), 0.0, atol=1e-12)


def test_what_pictures_do_not_have_is_refused(scenario):
    with pytest.raises(CalibError, match="moved_row"):
        simulate_pictures(replace(scenario, moved=MovedTarget(3, [0.0, 0.0, 1e-3])))
    with pytest.raises(CalibError, match="visits"):
        simulate_pictures(replace(scenario, visits=2))
    with pytest.raises(CalibError, match="point"):
        simulate_pictures(replace(scenario, cell=Cell()))
    with pytest.raises(CalibError, match="simulate_pictures"):
        simulate(scenario)
