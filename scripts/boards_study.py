"""Boards in pictures that calib did not draw: how many are found, and how far off their corners are.

    python scripts/boards_study.py --pictures 40
    python scripts/boards_study.py --pictures 40 --board aprilgrid --tilt 60

Each board is drawn by NumPy and OpenCV alone, and seen by OpenCV's `warpPerspective` on three by three points of a
pixel: tilted by up to 60 deg to any side and rolled by any angle, filling a third to nine tenths of the picture's
height, with a blur of 0.5 to 1.5 px and a noise of 2 to 5 grey values. A cube of tags is turned in any way, its side
0.15 to 0.45 of the height, and tags seen at more than 60 deg do not count. Nothing of `calib.boards.drawing` or
`calib.boards.render` is used. A board that looks the same turned may be numbered from another end.

Printed for each board: the share of pictures in which it is used, and of its corners that are found in them; the errors
of corners (2-D, rms and 95th percentile); and their size over the standard deviations that calib states.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from studies import print_table

from calib.basics.arrays import Array, Mask
from calib.boards.board import Board
from calib.boards.detection.copies import as_it_is
from calib.boards.detection.picture import Search, search_image
from calib.boards.opencv import opencv

cv2 = opencv()

#: Width and height of the pictures, and focal length [px].
SIZE = (1280, 960)
FOCAL = 1150.0

#: Points along a side of a pixel.
FINE = 3

#: Pixels of a drawing in a metre, and the white margin around it [m].
PER_METRE = 12000.0
MARGIN = 0.02

#: Grey values of ink and paper, and of the background.
INK, PAPER, BACKGROUND = 35.0, 210.0, 120.0


def marker_image(
    dictionary: Any,  # noqa: ANN401  OpenCV's
    number: int,
    bits: int,
    side: int,
    border: int,
) -> Array:
    """Draw a marker of whole pixels in a bit, enlarged to a side [px]; 0 is black, 1 is white."""
    image = cv2.aruco.generateImageMarker(dictionary, number, bits, borderBits=border)
    larger = cv2.resize(image, (side, side), interpolation=cv2.INTER_NEAREST)
    return np.asarray(larger / 255.0)


def empty(board: Board) -> Array:
    """Return white paper for a board, with its margin."""
    width, height = (round((length + 2 * MARGIN) * PER_METRE) for length in board.size)
    return np.ones((height, width))


def px(length: float) -> int:
    """Return a length on the board [m] as a place in the drawing [px]."""
    return round((length + MARGIN) * PER_METRE)


def draw_aprilgrid(board: Board) -> Array:
    """Draw tags with borders of two bits, ids from the lower left, and small squares at all corners.

    Kalibr prints tags as OpenCV has them turned by half a turn.
    """
    paper = empty(board)
    tags = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    gap = board.square - board.marker
    side = round(board.marker * PER_METRE)
    for row in range(board.rows):
        for column in range(board.columns):
            number = board.first_marker + (board.rows - 1 - row) * board.columns + column
            y, x = px(row * board.square), px(column * board.square)
            upright = marker_image(tags, number, 10, side, 2)
            paper[y : y + side, x : x + side] = upright[::-1, ::-1]
    for row in range(board.rows + 1):
        for column in range(board.columns + 1):
            y, x = px(row * board.square - gap), px(column * board.square - gap)
            end_y, end_x = px(row * board.square), px(column * board.square)
            paper[y:end_y, x:end_x] = 0.0
    return paper


def draw_circles(board: Board) -> Array:
    """Draw circles by the distance of each pixel from the nearest centre."""
    paper = empty(board)
    y, x = np.indices(paper.shape)
    x, y = ((index + 0.5) / PER_METRE - MARGIN for index in (x, y))
    row = np.clip(np.round((y - board.marker / 2) / board.square), 0, board.rows - 1)
    step, shift = board.square, np.zeros_like(row)
    if board.pattern == "asymmetric_circles":
        step, shift = 2 * board.square, board.square * (row % 2)
    column = np.clip(np.round((x - board.marker / 2 - shift) / step), 0, board.columns - 1)
    for away in (-1, 0, 1):
        near = np.clip(row + away, 0, board.rows - 1)
        shift = board.square * (near % 2) if board.pattern == "asymmetric_circles" else 0.0
        column = np.clip(np.round((x - board.marker / 2 - shift) / step), 0, board.columns - 1)
        centre_x = board.marker / 2 + shift + step * column
        centre_y = board.marker / 2 + board.square * near
        paper[np.hypot(x - centre_x, y - centre_y) <= board.marker / 2] = 0.0
    return paper


def own_dictionary() -> Any:  # noqa: ANN401  OpenCV's
    """Return OpenCV's dictionary of 40 markers of 5 x 5 bits by the seed 11."""
    return cv2.aruco.extendDictionary(40, 5, cv2.aruco.Dictionary(), 11)


def draw_charuco(board: Board) -> Array:
    """Draw a ChArUco board as OpenCV draws it, of markers of a dictionary of its own."""
    size = (board.columns, board.rows)
    theirs = cv2.aruco.CharucoBoard(size, board.square, board.marker, own_dictionary())
    paper = empty(board)
    width, height = (round(length * PER_METRE) for length in board.size)
    image = theirs.generateImage((width, height))
    paper[px(0) : px(0) + height, px(0) : px(0) + width] = image / 255.0
    return paper


def draw_tag(board: Board) -> Array:
    """Draw a single ArUco marker."""
    paper = empty(board)
    side = round(board.marker * PER_METRE)
    markers = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    tag = marker_image(markers, board.first_marker, 6, side, 1)
    paper[px(0) : px(0) + side, px(0) : px(0) + side] = tag
    return paper


def draw_face(number: int, side: float, paper_side: float) -> Array:
    """Draw the face of a cube with a tag in its middle."""
    size, tag_px = round(paper_side * PER_METRE), round(side * PER_METRE)
    tags = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    paper = np.ones((size, size))
    begin = (size - tag_px) // 2
    end = begin + tag_px
    paper[begin:end, begin:end] = marker_image(tags, number, 8, tag_px, 1)
    return paper


#: Tags of 60 mm on the faces of a cube of 80 mm: axes x to the right and y down on each face, seen from outside.
CUBE_SIDE, TAG_SIDE = 0.080, 0.060
CUBE_FACES = {
    10: ((1, 0, 0), (0, 0, -1)),
    11: ((0, 1, 0), (0, 0, -1)),
    12: ((-1, 0, 0), (0, 0, -1)),
    13: ((0, -1, 0), (0, 0, -1)),
    14: ((1, 0, 0), (0, -1, 0)),
    15: ((1, 0, 0), (0, 1, 0)),
}


def face_pose(number: int) -> Array:
    """Return the pose (3, 4) of a face of the cube in its frame: origin at the face's upper left corner, z inwards."""
    x, y = (np.array(axis, dtype=float) for axis in CUBE_FACES[number])
    z = np.cross(x, y)
    origin = -0.5 * CUBE_SIDE * (x + y + z)
    return np.column_stack([x, y, z, origin])


def cube() -> Board:
    """Describe the cube by the corners of its tags."""
    edge = (CUBE_SIDE - TAG_SIDE) / 2
    flat = TAG_SIDE * np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    flat = flat + np.array([edge, edge, 0])
    tags = []
    for number in CUBE_FACES:
        T = face_pose(number)
        tags.append((number, tuple(map(tuple, flat @ T[:, :3].T + T[:, 3]))))
    return Board(pattern="body", dictionary="DICT_APRILTAG_36h11", tags=tuple(tags))


@dataclass(frozen=True, eq=False)
class Kind:
    """A board of the study, and who draws it."""

    board: Board
    draw: Callable[[Board], Array]


KINDS = {
    "aprilgrid": Kind(
        Board(
            pattern="aprilgrid",
            columns=6,
            rows=5,
            square=0.039,
            marker=0.03,
            dictionary="DICT_APRILTAG_36h11",
        ),
        draw_aprilgrid,
    ),
    "circles": Kind(
        Board(pattern="circles", columns=9, rows=7, square=0.025, marker=0.0125), draw_circles
    ),
    "asymmetric circles": Kind(
        Board(pattern="asymmetric_circles", columns=4, rows=11, square=0.018, marker=0.014),
        draw_circles,
    ),
    "own dictionary": Kind(
        Board(
            pattern="charuco",
            columns=8,
            rows=7,
            square=0.03,
            marker=0.022,
            dictionary="DICT_5X5_40_SEED_11",
        ),
        draw_charuco,
    ),
    "single tag": Kind(
        Board(
            pattern="apriltag",
            columns=1,
            rows=1,
            square=0.14,
            marker=0.12,
            dictionary="DICT_4X4_50",
            first_marker=7,
        ),
        draw_tag,
    ),
    "cube of tags": Kind(cube(), empty),
}


def pose(board: Board, tilt: float, rng: np.random.Generator) -> Array:
    """Draw the pose of a board in the camera, (3, 4), at an angle [rad] to the line of sight, wholly in the picture."""
    while True:
        side = rng.uniform(0, 2 * np.pi)
        R = cv2.Rodrigues(tilt * np.array([np.cos(side), np.sin(side), 0.0]))[0]
        R = R @ cv2.Rodrigues(np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)]))[0]
        distance = FOCAL * np.hypot(*board.size) / (rng.uniform(0.35, 0.95) * SIZE[1])
        away = rng.uniform(-0.15, 0.15, 2) * distance
        t = np.array([*away, distance]) - R @ board.centre
        T = np.column_stack([R, t])
        margin = 0.012
        width, height = board.size
        corners = np.array(
            [[x, y, 0] for x in (-margin, width + margin) for y in (-margin, height + margin)]
        )
        pixels = project(T, corners)
        if (pixels > 5).all() and (pixels < np.array(SIZE) - 6).all():
            return T


def project(T: Array, points: Array) -> Array:
    """Return the pixels (n, 2) of points (n, 3) [m] of a board at a pose (3, 4)."""
    K = np.array([[FOCAL, 0, SIZE[0] / 2], [0, FOCAL, SIZE[1] / 2], [0, 0, 1]])
    seen = (points @ T[:, :3].T + T[:, 3]) @ K.T
    return np.asarray(seen[:, :2] / seen[:, 2:])


def see(paper: Array, T: Array, picture: Array, margin: float = MARGIN) -> Array:
    """Return a fine picture with a drawing in front of it, at a pose (3, 4) of the board in the camera.

    The drawing has a margin [m] around what is described.
    """
    K = np.array([[FOCAL, 0, SIZE[0] / 2], [0, FOCAL, SIZE[1] / 2], [0, 0, 1]])
    H = K @ T[:, [0, 1, 3]]
    # A pixel of the drawing, by its index, is on the board at (index + 0.5) / PER_METRE - margin.
    to_board = np.array(
        [
            [1 / PER_METRE, 0, 0.5 / PER_METRE - margin],
            [0, 1 / PER_METRE, 0.5 / PER_METRE - margin],
            [0, 0, 1],
        ]
    )
    to_fine = np.array([[FINE, 0, (FINE - 1) / 2], [0, FINE, (FINE - 1) / 2], [0, 0, 1]])
    size = (FINE * SIZE[0], FINE * SIZE[1])
    levels = (INK + (PAPER - INK) * paper).astype(np.float32)
    seen = cv2.warpPerspective(
        levels, to_fine @ H @ to_board, size, flags=cv2.INTER_LINEAR, borderValue=-1.0
    )
    return np.where(seen >= 0.0, seen, picture)


def photograph(fine: Array, rng: np.random.Generator) -> Array:
    """Return the picture of 8 bits of a fine one, blurred and with noise."""
    seen = cv2.resize(fine.astype(np.float32), SIZE, interpolation=cv2.INTER_AREA)
    seen = cv2.GaussianBlur(seen, (0, 0), rng.uniform(0.5, 1.5))
    seen = seen + rng.uniform(2, 5) * rng.standard_normal(seen.shape)
    return np.asarray(np.clip(np.rint(seen), 0, 255).astype(np.uint8))


def shoot(kind: Kind, tilt: float, rng: np.random.Generator) -> tuple[Array, Array, Mask]:
    """Photograph a board at an angle [rad]: the picture, the true pixels of its corners, and which are in view."""
    fine = np.full((FINE * SIZE[1], FINE * SIZE[0]), BACKGROUND)
    if kind.board.pattern != "body":
        T = pose(kind.board, tilt, rng)
        fine = see(drawing(kind), T, fine)
        every = np.ones(len(kind.board.corners), dtype=bool)
        return photograph(fine, rng), project(T, kind.board.corners), every

    # A cube at any angle; tags that are seen at more than 60 deg need not be found.
    R = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    R[:, 0] *= np.sign(np.linalg.det(R))
    distance = FOCAL * CUBE_SIDE / (rng.uniform(0.15, 0.45) * SIZE[1])
    T = np.column_stack([R, [*rng.uniform(-0.15, 0.15, 2) * distance, distance]])
    in_view: list[bool] = []
    for number in CUBE_FACES:
        of_face = face_pose(number)
        T_face = R @ of_face
        T_face[:, 3] += T[:, 3]
        middle = T_face @ [CUBE_SIDE / 2, CUBE_SIDE / 2, 0, 1]
        cosine = T_face[:, 2] @ middle / np.linalg.norm(middle)
        if cosine > 0.0:
            fine = see(draw_face(number, TAG_SIDE, CUBE_SIDE), T_face, fine, 0.0)
        in_view += 4 * [bool(cosine > 0.5)]
    return photograph(fine, rng), project(T, kind.board.corners), np.array(in_view)


@cache
def drawing(kind: Kind) -> Array:
    """Return the drawing of a board."""
    return kind.draw(kind.board)


def main() -> None:
    """Photograph each board, search it, and print what was found."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pictures", type=int, default=40, help="pictures of each board")
    parser.add_argument("--board", choices=KINDS, help="one board only")
    parser.add_argument("--tilt", type=float, help="this tilt only [deg]; default: 0 to 60")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    rows = []
    for name, kind in KINDS.items():
        if given.board not in (None, name):
            continue
        board = kind.board
        rng = np.random.default_rng([given.seed, len(name)])
        used, found, shown, errors, sigmas = 0, 0, 0, [], []
        for _ in range(given.pictures):
            tilt = rng.uniform(0, 60) if given.tilt is None else given.tilt
            image, true, in_view = shoot(kind, np.radians(tilt), rng)
            _, (view,) = search_image(Search((board,), 12), as_it_is(image))
            if not view.is_used:
                continue
            used += 1
            found += int(in_view[view.ids].sum())
            shown += int(in_view.sum())
            misses = [view.pixels - true[order[view.ids]] for order in board.orders_alike]
            errors.append(min(misses, key=lambda miss: np.sum(miss**2)))
            sigmas.append(view.sigma)
        error = np.concatenate(errors) if errors else np.full((1, 2), np.nan)
        sigma = np.concatenate(sigmas) if sigmas else np.full(1, np.nan)
        size = np.linalg.norm(error, axis=1)
        rows.append(
            [
                name,
                f"{100 * used / given.pictures:.0f} %",
                f"{100 * found / max(shown, 1):.1f} %",
                f"{np.sqrt(np.mean(size**2)):.3f}",
                f"{np.quantile(size, 0.95):.3f}",
                f"{np.sqrt(np.median(np.sum(error**2, axis=1) / (2 * sigma**2)) / np.log(2)):.2f}",
            ]
        )
    print_table(
        ["board", "used", "corners", "rms [px]", "95 % [px]", "over sigma"],
        rows,
    )


if __name__ == "__main__":
    main()
