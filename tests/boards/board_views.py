"""Pictures of boards with known corners: every pixel is the mean of the board seen through its parts."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter

from calib.basics.arrays import Array
from calib.boards.board import APRILGRID, APRILTAG, CHESSBOARD, TAGS, Board, white_squares

#: Parts of a pixel along u and v.
PARTS = 3

#: Cells of the print in a metre.
PER_METRE = 6000.0

CHARUCO_BOARD = Board(
    pattern="charuco", columns=7, rows=5, square=0.03, marker=0.022, dictionary="DICT_5X5_100"
)
CHESS_BOARD = Board(pattern="chessboard", columns=8, rows=5, square=0.03)
TAG_BOARD = Board(
    pattern="apriltag",
    columns=4,
    rows=3,
    square=0.05,
    marker=0.035,
    dictionary="DICT_APRILTAG_36h11",
)
KALIBR_BOARD = Board(
    pattern="aprilgrid",
    columns=4,
    rows=3,
    square=0.052,
    marker=0.04,
    dictionary="DICT_APRILTAG_36h11",
    first_marker=5,
)
SINGLE_TAG = Board(
    pattern="apriltag",
    columns=1,
    rows=1,
    square=0.1,
    marker=0.08,
    dictionary="DICT_5X5_30_SEED_7",
    first_marker=21,
)


@dataclass(frozen=True)
class View:
    """A camera before a board, and what its picture suffers."""

    #: Turns about the board's x and y, and about the line of sight [deg].
    tilt: tuple[float, float, float] = (0.0, 0.0, 0.0)
    #: Middle of the board in the camera [m].
    middle: tuple[float, float, float] = (0.0, 0.0, 0.35)
    size: tuple[int, int] = (640, 480)
    focal: float = 700.0
    #: k1 and k2 of OpenCV's lens.
    distortion: tuple[float, float] = (0.0, 0.0)
    #: Standard deviation of the blur [px].
    blur: float = 0.6
    #: Standard deviation of the noise [grey values].
    noise: float = 2.0
    #: Black and white [grey values].
    levels: tuple[float, float] = (40.0, 200.0)
    seed: int = 0
    #: Whether the print is a mirror image.
    mirrored: bool = False

    def T_camera_board(self, board: Board) -> Array:
        """The pose of the board in the camera."""
        about_x, about_y, about_z = np.radians(self.tilt)
        R = (
            cv2.Rodrigues(np.array([0, 0, about_z]))[0]
            @ cv2.Rodrigues(np.array([0, about_y, 0]))[0]
            @ cv2.Rodrigues(np.array([about_x, 0, 0]))[0]
        )
        T = np.eye(4)
        T[:3, :3] = R
        T[:3, 3] = np.array(self.middle) - R @ board.centre
        return T

    def corners(self, board: Board) -> Array:
        """The true pixels of all corners, shape (n, 2)."""
        T = self.T_camera_board(board)
        points = board.corners @ T[:3, :3].T + T[:3, 3]
        xy = points[:, :2] / points[:, 2:]
        r2 = np.sum(xy**2, axis=1, keepdims=True)
        k1, k2 = self.distortion
        xy = xy * (1 + k1 * r2 + k2 * r2**2)
        return self.focal * xy + self.principal

    @property
    def principal(self) -> Array:
        return (np.array(self.size) - 1.0) / 2.0 + np.array([3.3, -2.7])


def _white_squares(board: Board) -> list[tuple[int, int]]:
    """Column and row of the white squares, in rows along x."""
    rows, columns = np.nonzero(white_squares(board))
    return list(zip(columns.tolist(), rows.tolist(), strict=True))


def pattern(board: Board, per_metre: float) -> Array:
    """The print between 0 and 1 with a white margin of one square, shape (h, w); black is 0."""
    cells = round(board.square * per_metre)
    height = (board.rows + 2) * cells
    width = (board.columns + 2) * cells
    picture = np.ones((height, width))
    if board.pattern not in TAGS:
        whites = _white_squares(board)
        for column in range(board.columns):
            for row in range(board.rows):
                if (column, row) not in whites:
                    picture[
                        (row + 1) * cells : (row + 2) * cells,
                        (column + 1) * cells : (column + 2) * cells,
                    ] = 0
    if board.pattern == CHESSBOARD:
        return picture
    if board is SINGLE_TAG:
        dictionary = cv2.aruco.extendDictionary(30, 5, cv2.aruco.Dictionary(), 7)
    else:
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    side = round(board.marker * per_metre)
    if board.pattern == APRILGRID:
        gap = cells - side
        for column in range(1, board.columns + 2):
            for row in range(1, board.rows + 2):
                picture[row * cells - gap : row * cells, column * cells - gap : column * cells] = 0
        for k in range(board.markers):
            # Ids from the lower left, and each tag turned by half a turn.
            row, column = board.rows - k // board.columns, 1 + k % board.columns
            marker = cv2.aruco.generateImageMarker(
                dictionary, board.first_marker + k, side, borderBits=2
            )
            v, u = row * cells, column * cells
            picture[v : v + side, u : u + side] = marker[::-1, ::-1] / 255.0
        return picture
    if board.pattern == APRILTAG:
        places = [(c, r) for r in range(board.rows) for c in range(board.columns)]
        margin = 0
    else:
        places = _white_squares(board)
        margin = round((board.square - board.marker) / 2 * per_metre)
    for k, (column, row) in enumerate(places):
        marker = cv2.aruco.generateImageMarker(dictionary, board.first_marker + k, side) / 255.0
        u, v = (column + 1) * cells + margin, (row + 1) * cells + margin
        picture[v : v + side, u : u + side] = marker
    return picture


@cache
def render(board: Board, view: View) -> Any:
    """The picture, 8 bits; read-only, since it is the same for all who ask."""
    image = _seen(board, view)
    noise = view.noise * np.random.default_rng(view.seed).normal(size=image.shape)
    picture = np.clip(np.rint(image + noise), 0, 255).astype(np.uint8)
    picture.setflags(write=False)
    return picture


@cache
def _seen(board: Board, view: View) -> Array:
    """The picture without noise."""
    width, height = view.size
    fine = (np.arange(PARTS) - (PARTS - 1) / 2) / PARTS
    u = (np.arange(width)[:, None] + fine).reshape(-1)
    v = (np.arange(height)[:, None] + fine).reshape(-1)
    uv = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    distorted = (uv - view.principal) / view.focal
    xy = distorted
    k1, k2 = view.distortion
    for _ in range(12 if k1 or k2 else 0):
        r2 = np.sum(xy**2, axis=1, keepdims=True)
        xy = distorted / (1 + k1 * r2 + k2 * r2**2)
    H = np.linalg.inv(view.T_camera_board(board)[:3, [0, 1, 3]])
    on_board = xy @ H[:, :2].T + H[:, 2]
    on_board = on_board[:, :2] / on_board[:, 2:]
    picture = pattern(board, PER_METRE)
    picture = picture[:, ::-1] if view.mirrored else picture
    # Edges a part of a pixel wide: remap takes single values.
    picture = gaussian_filter(picture, 1.0).astype(np.float32)
    places = ((on_board + board.square) * PER_METRE - 0.5).astype(np.float32)
    u_map, v_map = (np.ascontiguousarray(column.reshape(len(v), len(u))) for column in places.T)
    seen = cv2.remap(picture, u_map, v_map, cv2.INTER_LINEAR, borderValue=0.6)
    grey = seen.reshape(height, PARTS, width, PARTS).mean(axis=(1, 3))
    black, white = view.levels
    return gaussian_filter(black + (white - black) * grey.astype(float), view.blur)
