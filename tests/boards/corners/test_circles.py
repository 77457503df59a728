"""Circles: their centres under perspective, blur and noise, and the order that the board has them in."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from calib.basics.arrays import Array
from calib.boards.board import Board
from calib.boards.corners.circles import find_circles, refine_circles
from tests.boards.board_views import View

GRID = Board(pattern="circles", columns=7, rows=5, square=0.03, marker=0.018)
UNIQUE = Board(pattern="asymmetric_circles", columns=4, rows=9, square=0.02, marker=0.016)

#: Pixels of the drawing in a metre, and the margin around it [m].
PER_METRE = 6000.0
MARGIN = 0.03


def seen(board: Board, view: View, hidden: tuple[int, ...] = ()) -> Array:
    """The picture of a grid of circles, drawn by distances and warped by OpenCV at four by four points of a pixel."""
    shape = np.array(board.size[::-1]) + 2.0 * MARGIN
    y, x = (np.indices(np.ceil(shape * PER_METRE).astype(int)) + 0.5) / PER_METRE - MARGIN
    paper = np.full(x.shape, view.levels[1], np.float32)
    for k, (u, v, _) in enumerate(board.corners):
        if k not in hidden:
            paper[np.hypot(x - u, y - v) < board.marker / 2.0] = view.levels[0]
    T = view.T_camera_board(board)
    K = np.array(
        [[view.focal, 0, view.principal[0]], [0, view.focal, view.principal[1]], [0, 0, 1]]
    )
    step = 1.0 / PER_METRE
    place = np.array([[step, 0, step / 2 - MARGIN], [0, step, step / 2 - MARGIN], [0, 0, 1]])
    fine = np.array([[4, 0, 1.5], [0, 4, 1.5], [0, 0, 1]])
    size = (4 * view.size[0], 4 * view.size[1])
    H = fine @ K @ T[:, [0, 1, 3]][:3] @ place
    image = cv2.warpPerspective(paper, H, size, borderValue=view.levels[1])
    image = cv2.resize(image, view.size, interpolation=cv2.INTER_AREA)
    image = cv2.GaussianBlur(image, (0, 0), view.blur)
    noise = view.noise * np.random.default_rng(view.seed).standard_normal(image.shape)
    return np.clip(np.rint(image + noise), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("board", [GRID, UNIQUE], ids=lambda b: b.pattern)
@pytest.mark.parametrize("tilt", [(0, 0, 0), (50, 10, 15), (10, -55, -20)], ids=str)
def test_centres_under_perspective(board: Board, tilt: tuple[float, float, float]):
    view = View(tilt=tilt, blur=1.0, middle=(0.0, 0.0, 0.42))
    image = seen(board, view)
    found = find_circles(image, board)
    assert found is not None
    saddles, planar_map = refine_circles(np.asarray(image, dtype=float), board, found)
    assert saddles.exist.all()
    error = saddles.pixels - view.corners(board)
    # Without the correction of perspective, the middles of steep circles are 0.2 px off.
    assert np.sqrt(np.mean(error**2)) < 0.03
    assert 0.5 < np.sqrt(np.mean(error**2)) / np.sqrt(np.mean(saddles.sigma**2)) < 2.0
    assert np.abs(planar_map.project(board.corners[:, :2]) - view.corners(board)).max() < 0.1


@pytest.mark.parametrize("roll", [0, 80, 170, -100])
def test_an_odd_asymmetric_grid_shows_its_first_end(roll: float):
    assert not UNIQUE.looks_same_turned
    view = View(tilt=(20, 10, roll))
    found = find_circles(seen(UNIQUE, view), UNIQUE)
    assert found is not None
    assert np.abs(found.pixels - view.corners(UNIQUE)).max() < 1.5


@pytest.mark.parametrize(
    ("board", "orders"),
    [(GRID, 2), (replace(GRID, rows=7), 4), (replace(UNIQUE, rows=8), 2), (UNIQUE, 1)],
)
def test_grids_that_look_the_same_turned(board: Board, orders: int):
    assert len(board.orders_alike) == orders
    points = (board.corners - board.corners.mean(axis=0))[:, :2]
    for order in board.orders_alike:
        R = np.linalg.lstsq(points, points[order], rcond=None)[0]
        np.testing.assert_allclose(points @ R, points[order], atol=1e-12)
        assert np.linalg.det(R) == pytest.approx(1.0)


@pytest.mark.parametrize("roll", [20, 160])
def test_a_grid_that_looks_the_same_has_its_x_axis_to_the_right(roll: float):
    view = View(tilt=(10, 10, roll))
    found = find_circles(seen(GRID, view), GRID)
    assert found is not None
    true = view.corners(GRID) if roll == 20 else view.corners(GRID)[::-1]
    assert np.abs(found.pixels - true).max() < 1.5


def test_a_hidden_circle_hides_the_grid():
    assert find_circles(seen(GRID, View(), hidden=(8,)), GRID) is None


def test_a_smudged_circle_is_left_out():
    view = View(tilt=(20, 10, 0))
    image = seen(GRID, view)
    found = find_circles(image, GRID)
    assert found is not None
    u, v = np.rint(view.corners(GRID)[9]).astype(int)
    smudged = np.array(image, dtype=float)
    smudged[v - 4 : v + 20, u : u + 20] = view.levels[1]
    saddles, _ = refine_circles(smudged, GRID, found)
    assert np.flatnonzero(~saddles.exist).tolist() == [9]


def test_circles_are_where_opencv_has_them():
    # Their asymmetric grid, (2 j + i % 2, i) times the distance, begins at the first circle.
    expected = [[(2 * j + i % 2) * 0.02, i * 0.02] for i in range(9) for j in range(4)]
    np.testing.assert_allclose(UNIQUE.corners[:, :2] - 0.008, expected)
    np.testing.assert_allclose(UNIQUE.size, (0.14 + 0.016, 0.16 + 0.016))
    # The second row ends farthest to the right.
    low, high = UNIQUE.corners.min(axis=0), UNIQUE.corners.max(axis=0)
    np.testing.assert_allclose(UNIQUE.centre, (low + high) / 2.0)
