"""The ends of boards that look the same from both, told by the robot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.basics.arrays import read_only
from calib.boards.board import Board
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.fit.registration.board_ends import numbered_from_one_end
from calib.robot.robot import Robot
from tests.pictures import STATED, of_pictures, pictures_of, two_cameras

#: Even by even: it looks the same after half a turn.
ALIKE = Board(pattern="chessboard", columns=8, rows=6, square=0.025)


def scrambled(table: Measurements, pictures: set[str]) -> Measurements:
    """Return a table in which the corners of some pictures are numbered from the other end."""
    count = len(ALIKE.corners)
    turned = np.isin(table.images, list(pictures))
    corners = [
        str(count - 1 - int(name)) if is_turned else name
        for name, is_turned in zip(table.corners, turned.tolist(), strict=True)
    ]
    points = ALIKE.corners[[int(name) for name in corners]]
    return replace(table, corners=tuple(corners), board_points=read_only(points))


@pytest.fixture(scope="module")
def seen() -> tuple[Robot, Measurements]:
    """Return an arm and pictures of the board."""
    cell, table = pictures_of(ALIKE, seed=3, count=12)
    return cell.truth.nominal, table


def test_pictures_from_the_other_end_are_renumbered(seen: tuple[Robot, Measurements]) -> None:
    """Those of a minority are turned back, and no others."""
    robot, table = seen
    names = list(dict.fromkeys(table.images))
    turned = {names[1], names[4], names[5], names[9]}
    cell = Cell(cameras={"": STATED}, boards={"": ALIKE})
    result = numbered_from_one_end(robot, scrambled(table, turned), cell)
    assert set(result.other_end) == turned
    assert result.corners == table.corners
    np.testing.assert_allclose(result.board_points, table.board_points, atol=1e-12)


def test_most_pictures_keep_their_end(seen: tuple[Robot, Measurements]) -> None:
    """If most are turned it is the others that are renumbered: the ends are a convention."""
    robot, table = seen
    names = list(dict.fromkeys(table.images))
    cell = Cell(cameras={"": STATED}, boards={"": ALIKE})
    result = numbered_from_one_end(robot, scrambled(table, set(names[3:])), cell)
    assert set(result.other_end) == set(names[:3])


@pytest.mark.slow
def test_all_cameras_have_one_end() -> None:
    """A camera all of whose pictures are turned is brought to the end of the other one."""
    cell, table = two_cameras(ALIKE, seed=3, count=10)
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
