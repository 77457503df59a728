"""Pictures: OpenCV finds the corners where OpenCV projects them, and pixels are where they should be."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from calib.boards.board import CHESSBOARD, Board
from calib.boards.printed import Print
from calib.boards.project import corner_pixels
from calib.boards.render import Scene, render, write_png
from calib.camera.camera import Camera
from calib.errors import FileError
from tests.boards.boards import (
    CHARUCO_BOARD,
    CHESS_BOARD,
    FISHEYE,
    OLD_BOARD,
    PINHOLE,
    TAG_BOARD,
    facing,
)
from tests.boards.test_drawing import opencv_charuco, opencv_dictionary

WARPED = Print(CHARUCO_BOARD, scale=(1.01, 0.99), warp=(2e-3, -3e-3))


def true_pixels(printed, camera, T):
    pixels, _ = corner_pixels(camera, printed.corners, T[None])
    return pixels[0]


def charuco_corners(image, board):
    """Pixels of the corners that OpenCV finds and refines, and their ids."""
    corners, ids, *_ = cv2.aruco.CharucoDetector(opencv_charuco(board)).detectBoard(image)
    if ids is None:
        return np.empty((0, 2)), np.empty(0, dtype=int)
    return refined(image, np.reshape(corners, (-1, 1, 2))), np.ravel(ids)


def refined(image, corners):
    end = (cv2.TERM_CRITERIA_MAX_ITER | cv2.TERM_CRITERIA_EPS, 50, 1e-5)
    start = np.asarray(corners, dtype=np.float32).reshape(-1, 1, 2).copy()
    return cv2.cornerSubPix(image, start, (4, 4), (-1, -1), end).reshape(-1, 2)


@pytest.mark.parametrize(
    ("camera", "distance", "tilt", "printed"),
    [
        (PINHOLE, 0.45, 0.0, Print(CHARUCO_BOARD)),
        (PINHOLE, 0.45, 30.0, Print(CHARUCO_BOARD)),
        (PINHOLE, 0.45, 60.0, Print(CHARUCO_BOARD)),
        (PINHOLE, 0.45, 40.0, WARPED),
        (FISHEYE, 0.28, 30.0, Print(CHARUCO_BOARD)),
        (FISHEYE, 0.28, 40.0, WARPED),
    ],
)
def test_corners_are_found_where_they_are_projected(camera, distance, tilt, printed):
    T = facing(CHARUCO_BOARD, distance, tilt, middle=(0.02, -0.01))
    image = render(printed, camera, T, noise=0.5, seed=1)
    assert image.shape == (720, 1280)
    assert image.dtype == np.uint8
    corners, ids = charuco_corners(image, CHARUCO_BOARD)
    assert len(ids) == 24
    error = corners - true_pixels(printed, camera, T)[ids]
    assert np.sqrt(np.mean(error**2)) < 0.05
    assert np.abs(error.mean(axis=0)).max() < 0.015


def test_a_warp_shows():
    """Without the warp in the truth the same picture is pixels off."""
    T = facing(CHARUCO_BOARD, 0.45, 40.0)
    corners, ids = charuco_corners(render(WARPED, PINHOLE, T), CHARUCO_BOARD)
    flat = true_pixels(replace(WARPED, warp=(0.0, 0.0)), PINHOLE, T)[ids]
    assert np.sqrt(np.mean((corners - flat) ** 2)) > 1.0


@pytest.mark.parametrize("board", [CHARUCO_BOARD, TAG_BOARD], ids=["squares", "tags"])
def test_single_corners_are_displaced(board):
    """Of a print whose corners are tenths of a millimetre off, corners are found where these are."""
    offsets = np.zeros((len(board.corners), 3))
    offsets[:, :2] = np.random.default_rng(3).normal(scale=2e-4, size=(len(offsets), 2))
    printed = Print(board, offsets=offsets)
    T = facing(board, 0.45, 20.0)
    truth = true_pixels(printed, PINHOLE, T)
    assert np.abs(truth - true_pixels(Print(board), PINHOLE, T)).max() > 0.6
    error = refined(render(printed, PINHOLE, T, blur=0.7), truth) - truth
    assert np.sqrt(np.mean(error**2)) < (0.06 if board is CHARUCO_BOARD else 0.3)


def test_the_centre_of_a_black_square_is_where_it_is_projected():
    """Half a pixel would show: the square's centroid of grey values is exact to a hundredth."""
    board = Board(pattern=CHESSBOARD, columns=3, rows=3, square=0.05)
    camera = Camera(
        width=320, height=240, values=np.array([300.0, 300, 160.3, 119.8, 0, 0, 0, 0, 0])
    )
    T = facing(board, 0.4, roll=0.0, middle=(0.0013, -0.0007))
    scene = Scene(shade=0.0, clouds=0.0)
    image = render(Print(board), camera, T, scene=scene, noise=0.0).astype(float)
    u, v = camera.values[2:4] + 300.0 * (T[:2, 3] + 0.075) / 0.4
    # From the middle square's middle, 19 px to its edges, 25 px to every side, into the white squares beside it.
    columns = np.arange(int(u) - 25, int(u) + 27)
    rows = np.arange(int(v) - 25, int(v) + 27)
    black = scene.white - image[np.ix_(rows, columns)]
    along_u = black[20:32].sum(axis=0)
    along_v = black[:, 20:32].sum(axis=1)
    assert along_u @ columns / along_u.sum() == pytest.approx(u, abs=0.01)
    assert along_v @ rows / along_v.sum() == pytest.approx(v, abs=0.01)


def test_grey_values_are_those_of_paper_ink_and_background():
    scene = Scene(white=200.0, black=40.0, background=90.0, clouds=0.0, shade=0.0)
    T = facing(CHESS_BOARD, 0.4, roll=0.0)
    image = render(Print(CHESS_BOARD), PINHOLE, T, scene=scene, noise=0.0)
    assert image[5, 5] == 90
    # The middles of the first square, black, and of the second.
    squares = np.array([[0.015, 0.015, 0.0], [0.045, 0.015, 0.0]])
    pixels, _ = corner_pixels(PINHOLE, squares, T[None])
    black, white = np.rint(pixels[0]).astype(int)
    assert image[black[1], black[0]] == 40
    assert image[white[1], white[0]] == 200


def test_old_layouts_are_found_as_old_ones_only():
    T = facing(OLD_BOARD, 0.45, 25.0)
    image = render(Print(OLD_BOARD), PINHOLE, T)
    corners, ids = charuco_corners(image, OLD_BOARD)
    assert len(ids) == 20
    error = corners - true_pixels(Print(OLD_BOARD), PINHOLE, T)[ids]
    assert np.sqrt(np.mean(error**2)) < 0.05
    _, as_new = charuco_corners(image, replace(OLD_BOARD, legacy=False))
    assert len(as_new) == 0


def test_chessboards_are_found():
    T = facing(CHESS_BOARD, 0.4, 30.0)
    image = render(Print(CHESS_BOARD), PINHOLE, T)
    is_found, corners = cv2.findChessboardCorners(image, (7, 5))
    assert is_found
    truth = true_pixels(Print(CHESS_BOARD), PINHOLE, T)
    corners = refined(image, corners)
    if np.linalg.norm(corners[0] - truth[0]) > 10.0:
        corners = corners[::-1]
    assert np.sqrt(np.mean((corners - truth) ** 2)) < 0.05


def test_tags_are_found_with_their_corners_and_ids():
    T = facing(TAG_BOARD, 0.4, 30.0)
    image = render(Print(TAG_BOARD), PINHOLE, T)
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    found, ids, _ = cv2.aruco.ArucoDetector(opencv_dictionary(TAG_BOARD), parameters).detectMarkers(
        image
    )
    assert sorted(np.ravel(ids)) == list(range(10, 22))
    truth = true_pixels(Print(TAG_BOARD), PINHOLE, T).reshape(-1, 4, 2)
    error = np.reshape(found, (-1, 4, 2)) - truth[np.ravel(ids) - 10]
    assert np.sqrt(np.mean(error**2)) < 0.3


def test_nothing_is_found_on_a_mirrored_print_or_from_behind():
    T = facing(CHARUCO_BOARD, 0.45, 20.0)
    mirrored = render(Print(CHARUCO_BOARD, mirrored=True), PINHOLE, T)
    assert len(charuco_corners(mirrored, CHARUCO_BOARD)[1]) == 0
    assert len(charuco_corners(mirrored[:, ::-1].copy(), CHARUCO_BOARD)[1]) > 10


def test_a_board_behind_the_camera_is_not_in_the_picture():
    T = facing(CHARUCO_BOARD, -0.45)
    scene = Scene(clouds=0.0, shade=0.0)
    image = render(Print(CHARUCO_BOARD), PINHOLE, T, scene=scene, noise=0.0)
    assert np.unique(image).tolist() == [110]


def test_a_board_that_leaves_the_image_is_drawn_as_far_as_it_is_in():
    T = facing(CHARUCO_BOARD, 0.4, 20.0, middle=(0.2, 0.1))
    image = render(Print(CHARUCO_BOARD), PINHOLE, T)
    corners, ids = charuco_corners(image, CHARUCO_BOARD)
    assert 4 < len(ids) < 24
    error = corners - true_pixels(Print(CHARUCO_BOARD), PINHOLE, T)[ids]
    assert np.sqrt(np.mean(error**2)) < 0.06


def test_noise_and_blur_are_as_large_as_they_are_stated():
    small = replace(PINHOLE, width=320, height=240)
    nowhere = facing(CHARUCO_BOARD, -1.0)
    scene = Scene(clouds=0.0, shade=0.0)
    image = render(Print(CHARUCO_BOARD), small, nowhere, scene=scene, noise=4.0, seed=5)
    assert image.std() == pytest.approx(np.hypot(4.0, np.sqrt(1 / 12)), rel=0.02)
    T = facing(CHESS_BOARD, 0.3)
    sharp = render(Print(CHESS_BOARD), small, T, noise=0.0)
    blurred = render(Print(CHESS_BOARD), small, T, noise=0.0, blur=2.0)
    steps = [np.abs(np.diff(image.astype(int), axis=1)).max() for image in (sharp, blurred)]
    # The steepest step of an edge of height h, blurred by s, is h / (s sqrt(2 pi)).
    assert steps[1] / steps[0] == pytest.approx(1.0 / (2.0 * np.sqrt(2.0 * np.pi)), abs=0.08)


def test_the_same_seed_draws_the_same_picture():
    small = replace(PINHOLE, width=320, height=240)
    T = facing(CHESS_BOARD, 0.3)
    first, again, other = (render(Print(CHESS_BOARD), small, T, seed=seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert (first != other).mean() > 0.5


def test_pictures_are_read_back_as_they_were_written(tmp_path):
    image = np.arange(256, dtype=np.uint8).reshape(8, 32)
    path = write_png(image, tmp_path / "picture.png")
    np.testing.assert_array_equal(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), image)
    with pytest.raises(FileError):
        write_png(image, path)
    assert write_png(image[:4], path, overwrite=True) == path
