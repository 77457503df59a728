"""Folders of pictures: OpenCV finds the corners where the truth has them, and other readers read the files."""

from __future__ import annotations

import csv

import cv2
import numpy as np
import pytest
import yaml

import calib.data.kinds as registry
from calib.boards.board_file import read_board
from calib.camera.camera import Camera
from calib.camera.camera_file import read_camera
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.errors import FileError
from calib.result.calibrate import calibrate
from calib.robot.robot import Robot
from calib.verbs.simulate.equipment import usual_camera
from calib.verbs.simulate.picture_files import write_pictures
from calib.verbs.simulate.scenario import Scenario, simulate
from tests.boards.test_render import charuco_corners
from tests.cli_fixtures import calib_here
from tests.verbs.simulate.cells import BOARD


@pytest.fixture(scope="module")
def simulated():
    robot = Robot.load("ur5", base="tool0", tip="base_link")
    stated = Cell(kind="pixel", cameras={"": usual_camera()}, boards={"": BOARD})
    cell = Scenario(robot, stated).draw(7)
    return cell.measure(cell.poses(3, seed=1), sets=["estimate", "estimate", "validate"])


@pytest.fixture
def pictures(simulated):
    return simulated.pictures


@pytest.fixture(scope="module")
def folder(simulated, tmp_path_factory):
    folder = tmp_path_factory.mktemp("cell") / "pictures"
    written = write_pictures(simulated, folder)
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


def test_joint_values_are_beside_the_names_of_the_pictures(simulated, pictures, folder):
    with (folder / "joints.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["image"] for row in rows] == list(pictures.images)
    assert [row["set"] for row in rows] == ["estimate", "estimate", "validate"]
    read = [
        [float(row[f"{name} [rad]"]) for name in simulated.truth.nominal.joint_names]
        for row in rows
    ]
    np.testing.assert_array_equal(read, pictures.readings)


def test_moves_before_the_pictures_are_beside_their_joint_values(monkeypatch, tmp_path):
    """As `calib detect` copies them, and the fit reads them."""
    robot = Robot.load("ur5", base="tool0", tip="base_link")
    stated = Cell(kind="pixel", cameras={"": usual_camera()}, boards={"": BOARD})
    cell = Scenario(robot, stated).draw(7)
    moves = np.array([[0.1] * 6, [-0.1] * 6])
    made = cell.measure(cell.poses(2, seed=1), moves=moves)
    folder = tmp_path / "pictures"
    write_pictures(made, folder)
    boards = ("--board", str(folder / "board.toml"))
    joints = ("--joints", str(folder / "joints.csv"))
    words = ("detect", str(folder), *boards, *joints, "-o", "corners.csv")
    assert calib_here(monkeypatch, tmp_path, *words) == 0
    table = Measurements.read(tmp_path / "corners.csv", robot.joint_names, robot.joint_types)
    of_first = np.array(table.images) == made.pictures.images[0]
    assert 0 < of_first.sum() < len(table)
    np.testing.assert_allclose(table.moves_for(robot.joint_names)[of_first], 0.1)
    np.testing.assert_allclose(table.moves_for(robot.joint_names)[~of_first], -0.1)


def test_board_and_camera_are_those_that_a_person_knows(pictures, folder):
    assert read_board(folder / "board.toml").square == BOARD.square
    info = yaml.safe_load((folder / "camera.yaml").read_text())
    stated = pictures.equipment.stated.values
    assert info["image_width"] == 1280
    assert info["distortion_model"] == "plumb_bob"
    K = np.reshape(info["camera_matrix"]["data"], (3, 3))
    np.testing.assert_array_equal([K[0, 0], K[1, 1], K[0, 2], K[1, 2]], stated[:4])
    assert info["distortion_coefficients"]["data"] == stated[4:].tolist()
    np.testing.assert_array_equal(read_camera(folder / "camera.yaml").values, stated)


def test_files_that_exist_are_kept(simulated, folder):
    with pytest.raises(FileError):
        write_pictures(simulated, folder)


def test_a_camera_of_which_nothing_is_stated_has_no_file(simulated, tmp_path):
    unknown = Camera(width=640, height=480)
    stated = Cell(kind="pixel", cameras={"": unknown}, boards={"": BOARD})
    cell = Scenario(simulated.truth.nominal, stated).draw(1)
    few = cell.measure(cell.poses(2, seed=1))
    names = [path.name for path in write_pictures(few, tmp_path)]
    assert names == ["picture_01.png", "picture_02.png", "joints.csv", "board.toml"]


@pytest.mark.slow
def test_from_drawn_pictures_the_robot_and_the_camera_are_found(tmp_path):
    """The whole way, with OpenCV's own detection: the errors of the joints' zeros and of the camera come out."""
    robot = Robot.load("ur5", base="tool0", tip="base_link")
    cell = Cell(kind="pixel", model="zeros", cameras={"": usual_camera()}, boards={"": BOARD})
    made = simulate(Scenario(robot, cell, model="zeros"), 14, 0, seed=5)
    write_pictures(made, tmp_path)
    rows = []
    for k, name in enumerate(made.pictures.images):
        image = cv2.imread(str(tmp_path / name), cv2.IMREAD_UNCHANGED)
        corners, ids = charuco_corners(image, BOARD)
        rows += [(k, int(i), *corner) for corner, i in zip(corners, ids, strict=True)]
    found = np.array(rows)
    picture, corner = found[:, :2].astype(int).T
    table = Measurements(
        joint_names=robot.joint_names,
        joints=made.pictures.readings[picture],
        kinds=("pixel",) * len(rows),
        images=tuple(made.pictures.images[k] for k in picture),
        corners=tuple(map(str, corner)),
        board_points=BOARD.corners[corner],
        **Measurements.columns_of(registry.get("pixel"), found[:, 2:]),
    )
    fitted = calibrate(robot, table, cell=cell, validate=False)
    true = {name: made.truth.value(name) for name in made.truth.model.names}
    estimates = {estimate.name: estimate for estimate in fitted.parameters}
    # Zeros of the joints at the camera and at the board are those of the mounts too.
    for name in list(true)[1:-1]:
        assert estimates[name].delta == pytest.approx(true[name], abs=3e-4)
    error = made.pictures.equipment.camera.values[:2] - usual_camera().values[:2]
    found_error = [estimates["fx"].delta, estimates["fy"].delta]
    np.testing.assert_allclose(found_error, error, atol=1.0)
    assert estimates["board_sag_x"].delta == pytest.approx(
        made.pictures.equipment.printed.warp[0], abs=1e-4
    )
