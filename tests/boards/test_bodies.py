"""Bodies of tags: how files have them, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from calib.boards.board import Board, unfolded
from calib.boards.board_file import board_toml, read_board
from calib.boards.bodies import tag_at, tag_of_corners
from calib.boards.drawing import black_rectangles
from calib.camera.camera import Camera
from calib.data.cell import Cell
from calib.errors import CalibError
from calib.instruments.camera import CameraInstrument
from calib.robot.robot import Robot
from calib.verbs.simulate.equipment import draw_equipment

FILE = """
name = "cube"
pattern = "body"
dictionary = "DICT_4X4_50"
sigma_corner_mm = 0.2
tags = [
  [3, [-20, -20, -30], [20, -20, -30], [20, 20, -30], [-20, 20, -30]],
  { id = 5, xyz_mm = [30, 0, 0], rpy_deg = [0, -90, 0], side_mm = 40 },
]
"""


def test_tags_by_their_corners_and_by_their_pose(tmp_path):
    path = tmp_path / "cube.toml"
    path.write_text(FILE)
    board = read_board(path)
    assert board.marker_ids.tolist() == [3, 5]
    assert (board.markers, board.sigma_corner, board.sigma_warp) == (2, pytest.approx(2e-4), 0.0)
    corners = 1e3 * board.corners.reshape(2, 4, 3)
    np.testing.assert_allclose(corners[0, 2], [20, 20, -30], atol=1e-9)
    # Turned by -90 deg about y: z, into the tag, is -x of the body, and x to the right is z of the body.
    expected = [[30, -20, -20], [30, -20, 20], [30, 20, 20], [30, 20, -20]]
    np.testing.assert_allclose(corners[1], expected, atol=1e-9)
    np.testing.assert_allclose(board.size, (0.05, 0.04))
    np.testing.assert_allclose(board.centre, [0.005, 0.0, -0.005], atol=1e-12)
    assert not board.looks_same_turned
    # What is written is read back, to a nanometre.
    path.write_text(board_toml(board))
    assert "columns" not in board_toml(board)
    np.testing.assert_allclose(read_board(path).corners, board.corners, atol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[3, [-20, -20, -30],", "[3, [-20, -20, -30, 1],", "entry 1 of 'tags'"),
        ("[3, ", "[-3, ", "entry 1 of 'tags'"),
        ("[20, 20, -30]", "[30, 20, -30]", "not those of a square"),
        ("[20, -20, -30], [20, 20, -30]", "[20, 20, -30], [20, -20, -30]", "clockwise"),
        ("side_mm = 40", "side_mm = -40", "entry 2 of 'tags'"),
        (", side_mm = 40", "", "entry 2 of 'tags'"),
        ("id = 5", "id = 3", "the tag 3 twice"),
        ("id = 5", "id = 50", "DICT_4X4_50 has 50"),
        ('dictionary = "DICT_4X4_50"', "", "lacks 'dictionary'"),
        ("tags = [", "unknown = [", "unknown"),
    ],
)
def test_a_mistake_in_a_file_is_said(tmp_path, old, new, words):
    text = FILE.replace(old, new)
    assert text != FILE
    path = tmp_path / "cube.toml"
    path.write_text(text)
    with pytest.raises(CalibError, match=words):
        read_board(path)


def test_a_tag_at_a_pose():
    number, corners = tag_at(4, np.array([0.1, 0.2, 0.3]), np.zeros(3), 0.04)
    assert number == 4
    expected = [[0.08, 0.18, 0.3], [0.12, 0.18, 0.3], [0.12, 0.22, 0.3], [0.08, 0.22, 0.3]]
    np.testing.assert_allclose(corners, expected)
    assert tag_of_corners(4, np.array(corners)) == (number, corners)


def test_a_body_is_not_drawn_on_a_page():
    tag = tag_at(4, np.zeros(3), np.zeros(3), 0.04)
    with pytest.raises(CalibError, match="not drawn"):
        black_rectangles(Board(pattern="body", dictionary="DICT_4X4_50", tags=(tag,)))


def test_a_body_needs_tags():
    with pytest.raises(CalibError, match="needs its tags"):
        Board(pattern="body", dictionary="DICT_4X4_50")


def test_tags_are_side_by_side_on_a_sheet(tmp_path):
    path = tmp_path / "cube.toml"
    path.write_text(FILE)
    board = read_board(path)
    places, R = unfolded(board)
    # The first two of a row, 1.4 sides apart; each with its corners clockwise from the top left.
    square = np.array([[0.0, 0.0], [0.04, 0.0], [0.04, 0.04], [0.0, 0.04]])
    second = square + np.array([0.056, 0.0])
    np.testing.assert_allclose(places, np.concatenate([square, second]), atol=1e-12)
    np.testing.assert_allclose(R[:4], np.tile(np.eye(3), (4, 1, 1)), atol=1e-12)
    # x of the second is z of the body, and z, into the tag, is -x.
    np.testing.assert_allclose(R[4], [[0, 0, -1], [0, 1, 0], [1, 0, 0]], atol=1e-12)


def test_a_flat_board_is_its_own_sheet():
    board = Board(pattern="chessboard", columns=4, rows=3, square=0.03)
    places, R = unfolded(board)
    np.testing.assert_array_equal(places, board.corners[:, :2])
    np.testing.assert_array_equal(R, np.tile(np.eye(3), (len(places), 1, 1)))


def test_a_body_is_neither_planned_for_nor_simulated():
    """Both would see its tags through it."""
    board = Board(
        pattern="body", dictionary="DICT_4X4_50", tags=(tag_at(4, np.zeros(3), np.zeros(3), 0.04),)
    )
    camera = Camera(width=1280, height=720)
    cell = Cell(
        kind="pixel",
        cameras={"": camera},
        boards={"": board},
        target=np.zeros(3),
        target_rotation=np.eye(3),
    )
    with pytest.raises(CalibError, match="body of tags"):
        CameraInstrument.of(cell)
    with pytest.raises(CalibError, match="body of tags"):
        draw_equipment(Robot.load("panda"), cell, 0)
