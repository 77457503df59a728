"""The ends of boards that look the same from both, told by the robot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.basics.arrays import Array, read_only
from calib.boards.board import Board
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.fit.registration.board_ends import numbered_from_one_end
from calib.robot.robot import Robot
from tests.pictures import STATED, of_pictures, pictures_of, two_cameras

#: Even by even: it looks the same after half a turn.
ALIKE = Board(pattern="chessboard", columns=8, rows=6, square=0.025)


#: A square of odd squares: after a quarter, too.
SQUARE = Board(pattern="chessboard", columns=7, rows=7, square=0.025)

#: Pose of a camera in another one that is turned by half about their common line of sight.
UPSIDE_DOWN = np.diag([-1.0, -1.0, 1.0, 1.0])


def scrambled(table: Measurements, pictures: set[str]) -> Measurements:
    """Return a table in which the corners of some pictures are numbered from the other end."""
    return turned(table, ALIKE, dict.fromkeys(pictures, 1))


def turned(table: Measurements, board: Board, turns: dict[str, int]) -> Measurements:
    """Return a table with the corners of pictures in other orders that look the same, by the orders' numbers."""
    orders = [board.orders_alike[turns.get(image, 0)] for image in table.images]
    corners = [int(order[int(name)]) for order, name in zip(orders, table.corners, strict=True)]
    points = read_only(board.corners[corners])
    return replace(table, corners=tuple(map(str, corners)), board_points=points)


@pytest.fixture(scope="module")
def seen() -> tuple[Robot, Measurements]:
    """Return an arm and pictures of the board."""
    cell, table = pictures_of(ALIKE, seed=3, count=12)
    return cell.truth.nominal, table


def test_pictures_from_the_other_end_are_renumbered(seen: tuple[Robot, Measurements]) -> None:
    """Those of a minority are turned back, and no others."""
    robot, table = seen
    names = list(dict.fromkeys(table.images))
    pictures = {names[1], names[4], names[5], names[9]}
    cell = Cell(cameras={"": STATED}, boards={"": ALIKE})
    result = numbered_from_one_end(robot, scrambled(table, pictures), cell)
    assert set(result.other_end) == pictures
    assert result.corners == table.corners
    np.testing.assert_allclose(result.board_points, table.board_points, atol=1e-12)


def test_most_pictures_keep_their_end(seen: tuple[Robot, Measurements]) -> None:
    """If most are turned it is the others that are renumbered: the ends are a convention."""
    robot, table = seen
    names = list(dict.fromkeys(table.images))
    cell = Cell(cameras={"": STATED}, boards={"": ALIKE})
    result = numbered_from_one_end(robot, scrambled(table, set(names[3:])), cell)
    assert set(result.other_end) == set(names[:3])


def test_a_board_at_a_known_place_in_the_hand_has_its_own_end() -> None:
    """A square one, of which most pictures are turned: by a half, or by a quarter to either side."""
    virtual, table = pictures_of(SQUARE, seed=3, count=7)
    T_tip_target = virtual.truth.T_tip_target[0]
    cell = Cell(
        cameras={"": STATED},
        boards={"": SQUARE},
        target=T_tip_target[:3, 3],
        target_rotation=T_tip_target[:3, :3],
    )
    turns = {name: k % 4 for k, name in enumerate(dict.fromkeys(table.images))}
    mixed = turned(table, SQUARE, turns)
    result = numbered_from_one_end(virtual.truth.nominal, mixed, cell)
    assert set(result.other_end) == {name for name, turn in turns.items() if turn}
    assert result.corners == table.corners
    np.testing.assert_allclose(result.board_points, table.board_points, atol=1e-12)


@pytest.mark.parametrize("name", ["0", "1", "2"])
def test_three_pictures_tell_which_of_them_is_turned(name: str) -> None:
    """Whichever it is, although one of the three motions has, by chance, its angle after half a turn as well."""
    virtual, table = pictures_of(SQUARE, seed=3, count=3)
    cell = Cell(cameras={"": STATED}, boards={"": SQUARE})
    mixed = turned(table, SQUARE, {name: 1})
    result = numbered_from_one_end(virtual.truth.nominal, mixed, cell)
    assert result.other_end == (name,)
    assert result.corners == table.corners


@pytest.mark.parametrize(
    ("count", "T_right_left"),
    [pytest.param(10, None, marks=pytest.mark.slow), (3, UPSIDE_DOWN)],
    ids=["aside", "upside_down"],
)
def test_all_cameras_have_one_end(count: int, T_right_left: Array | None) -> None:
    """A camera all of whose pictures are turned is brought to the end of the other one."""
    cell, table = two_cameras(ALIKE, 3, count, T_right_left)
    left = [name for name in dict.fromkeys(table.images) if name.startswith("left")]
    known = Cell(cameras={"": STATED}, boards={"": ALIKE})
    mixed = {*left, "right_0"}
    result = numbered_from_one_end(cell.truth.nominal, scrambled(table, mixed), known)
    numbers = {name: result.corners[i] == table.corners[i] for i, name in enumerate(table.images)}
    assert len(set(numbers.values())) == 1


def test_corners_that_are_numbered_otherwise_stay(seen: tuple[Robot, Measurements]) -> None:
    """Corners counted from one are not those of the board: the last number alone shows it."""
    robot, table = seen
    mixed = scrambled(table, {table.images[0]})
    from_one = replace(mixed, corners=tuple(str(int(name) + 1) for name in mixed.corners))
    cell = Cell(cameras={"": STATED}, boards={"": ALIKE})
    assert numbered_from_one_end(robot, mixed, cell) is not mixed
    assert numbered_from_one_end(robot, from_one, cell) is from_one


def test_other_boards_stay(seen: tuple[Robot, Measurements]) -> None:
    """A board that does not look the same turned has its corners as they were found."""
    robot, table = seen
    other = replace(ALIKE, columns=9)
    cell = Cell(cameras={"": STATED}, boards={"": other})
    assert numbered_from_one_end(robot, table, cell) is table
    assert len(of_pictures(table)) == len(table)
