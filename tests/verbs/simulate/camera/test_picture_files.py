"""Folders of pictures: OpenCV finds the corners where the truth has them, and other readers read the files."""

from __future__ import annotations

import csv
import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
import yaml

from calib.boards.board_file import read_board
from calib.camera.camera import Camera
from calib.camera.camera_file import read_camera
from calib.data.cell import Cell
from calib.errors import FileError
from calib.result.calibrate import calibrate
from calib.robot.robot import Robot
from calib.verbs.simulate.camera.cell import draw_camera_cell
from calib.verbs.simulate.camera.equipment import usual_camera
from calib.verbs.simulate.camera.picture_files import picture_paths, write_pictures
from calib.verbs.simulate.camera.pictures import take_pictures
from calib.verbs.simulate.camera.simulate import simulate_pictures
from calib.verbs.simulate.camera.truth_file import write_camera_truth
from calib.verbs.simulate.scenario import Scenario
from tests.boards.test_render import charuco_corners
from tests.verbs.simulate.camera.cells import BOARD


@pytest.fixture(scope="module")
def pictures():
    robot = Robot.load("ur5", base="tool0", tip="base_link")
    cell = draw_camera_cell(Scenario(robot), usual_camera(), BOARD, seed=7)
    return take_pictures(cell, cell.views(3, seed=1), sets=["estimate", "estimate", "validate"])


@pytest.fixture(scope="module")
def folder(pictures, tmp_path_factory):
    folder = tmp_path_factory.mktemp("cell") / "pictures"
    written = write_pictures(pictures, folder)
    assert sorted(folder.iterdir()) == sorted(written)
    return folder


def test_pictures_show_the_corners_where_they_are(pictures, folder):
    for k, name in enumerate(pictures.images):
        image = cv2.imread(str(folder / name), cv2.IMREAD_UNCHANGED)
        corners, ids = charuco_corners(image, BOARD)
        is_here = pictures.picture == k
        true = dict(zip(pictures.corner[is_here], pictures.true_pixels[is_here], strict=True))
        errors = np.array([corner - true[i] for corner, i in zip(corners, ids, strict=True)])
        assert len(ids) > 15
        assert np.sqrt(np.mean(errors**2)) < 0.08


def test_joint_values_are_beside_the_names_of_the_pictures(pictures, folder):
    with (folder / "joints.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["image"] for row in rows] == list(pictures.images)
    assert [row["set"] for row in rows] == ["estimate", "estimate", "validate"]
    read = [
        [float(row[f"{name} [rad]"]) for name in pictures.cell.truth.nominal.joint_names]
        for row in rows
    ]
    np.testing.assert_array_equal(read, pictures.readings)


def test_board_and_camera_are_those_that_a_person_knows(pictures, folder):
    assert read_board(folder / "board.toml").square == BOARD.square
    info = yaml.safe_load((folder / "camera.yaml").read_text())
    stated = pictures.cell.stated.values
    assert info["image_width"] == 1280
    assert info["distortion_model"] == "plumb_bob"
    K = np.reshape(info["camera_matrix"]["data"], (3, 3))
    np.testing.assert_array_equal([K[0, 0], K[1, 1], K[0, 2], K[1, 2]], stated[:4])
    assert info["distortion_coefficients"]["data"] == stated[4:].tolist()
    np.testing.assert_array_equal(read_camera(folder / "camera.yaml").values, stated)


def test_files_that_exist_are_kept(pictures, folder):
    with pytest.raises(FileError):
        write_pictures(pictures, folder)


def test_a_camera_of_which_nothing_is_stated_has_no_file(pictures, tmp_path):
    robot = pictures.cell.truth.nominal
    cell = draw_camera_cell(Scenario(robot), Camera(width=640, height=480), BOARD, seed=1)
    few = take_pictures(cell, cell.views(2, seed=1))
    names = [path.name for path in picture_paths(few, tmp_path)]
    assert names == ["picture_01.png", "picture_02.png", "joints.csv", "board.toml"]


def test_the_truth_has_robot_camera_board_and_pictures(pictures, tmp_path):
    path = write_camera_truth(pictures, tmp_path / "truth.json")
    truth = json.loads(path.read_text())
    cell = pictures.cell
    errors = {entry["name"]: entry["value"] for entry in truth["parameters"]}
    assert errors["fx"] == cell.camera.values[0] - cell.stated.values[0]
    assert errors["board_scale_y"] == pytest.approx(cell.printed.scale[1] - 1.0)
    assert errors["board_sag_x"] == cell.printed.warp[0]
    assert errors["corner_5_y"] == cell.printed.offsets[5, 1]
    assert errors["elbow_joint.z"] == cell.truth.value("elbow_joint.z")
    assert truth["cameras"][0]["values"]["cy"] == cell.camera.values[3]
    assert truth["cameras"][0]["said_values"]["cy"] == 359.5
    np.testing.assert_allclose(truth["boards"][0]["corners_m"], cell.printed.corners)
    np.testing.assert_allclose(
        truth["set_ups"][0]["frame_base_xyz_m"], cell.truth.T_frame_base[0, :3, 3]
    )
    second = truth["pictures"][1]
    assert second["image"] == "picture_02.png"
    np.testing.assert_allclose(second["joints"], pictures.q[1])
    is_here = pictures.picture == 1
    np.testing.assert_allclose(second["pixels"], pictures.true_pixels[is_here])
    assert second["corners"] == pictures.corner[is_here].tolist()


@pytest.mark.slow
def test_from_drawn_pictures_the_robot_and_the_camera_are_found(tmp_path):
    """The whole way, with OpenCV's own detection: the errors of the joints' zeros and of the camera come out."""
    robot = Robot.load("ur5", base="tool0", tip="base_link")
    cell = Cell(kind="pixel", model="zeros", cameras={"": usual_camera()}, boards={"": BOARD})
    made = simulate_pictures(Scenario(robot, cell, model="zeros"), 14, 0, seed=5)
    write_pictures(made, tmp_path)
    rows = []
    for k, name in enumerate(made.images):
        image = cv2.imread(str(tmp_path / name), cv2.IMREAD_UNCHANGED)
        corners, ids = charuco_corners(image, BOARD)
        rows += [(k, int(i), *corner) for corner, i in zip(corners, ids, strict=True)]
    picture, corner = (np.array([row[column] for row in rows]) for column in range(2))
    found = replace(made, picture=picture, corner=corner, pixels=np.array(rows)[:, 2:])
    fitted = calibrate(robot, found.measurements, cell=cell, validate=False)
    true = {name: made.cell.truth.value(name) for name in made.cell.truth.model.names}
    estimates = {estimate.name: estimate for estimate in fitted.parameters}
    # Zeros of the joints at the camera and at the board are those of the mounts too.
    for name in list(true)[1:-1]:
        assert estimates[name].delta == pytest.approx(true[name], abs=3e-4)
    error = made.cell.camera.values[:2] - usual_camera().values[:2]
    found_error = [estimates["fx"].delta, estimates["fy"].delta]
    np.testing.assert_allclose(found_error, error, atol=1.0)
    assert estimates["board_sag_x"].delta == pytest.approx(made.cell.printed.warp[0], abs=1e-4)
