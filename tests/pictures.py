"""Pictures of virtual cells for tests: an arm with typical errors, a camera beside it, a board in its hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.basics.arrays import Array, Integers, read_only
from calib.boards.board import Board
from calib.camera.camera import Camera
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.robot.robot import Robot
from calib.verbs.simulate.scenario import Scenario, VirtualCell

STATED = Camera(
    width=1280,
    height=720,
    values=read_only(np.array([900.0, 900.0, 639.5, 359.5, -0.05, 0.05, 0.0, 0.0, 0.0])),
)

BOARD = Board(
    pattern="charuco", columns=5, rows=4, square=0.04, marker=0.03, dictionary="DICT_5X5_100"
)


def cell_of(board: Board, seed: int) -> VirtualCell:
    """Draw a UR5 with a board on its flange and a camera beside it."""
    robot = Robot.load("ur5", base="base_link", tip="tool0")
    cell = Cell(kind="pixel", cameras={"": STATED}, boards={"": board})
    return Scenario(robot, cell, model="dh", noise=None, sigma={"px": 0.3}).draw(seed)


def pictures_of(board: Board, seed: int, count: int) -> tuple[VirtualCell, Measurements]:
    """Draw a cell, and return it with the corners in some pictures, the first one named ``"0"``."""
    cell = cell_of(board, seed)
    return cell, named(cell.measure(cell.poses(count, seed), seed).measurements)


def two_cameras(
    board: Board, seed: int, count: int, T_right_left: Array | None = None
) -> tuple[VirtualCell, Measurements]:
    """Draw a cell, and return it with pictures of two cameras, ``"left_0"`` and ``"right_0"``, at the same poses."""
    cell, left = pictures_of(board, seed, count)
    if T_right_left is None:
        aside = np.eye(4)
        aside[:3, :3] = [[0.98, 0.0, 0.199], [0.0, 1.0, 0.0], [-0.199, 0.0, 0.98]]
        aside[:3, 3] = 0.05, 0.02, 0.1
        U, _, V = np.linalg.svd(aside[:3, :3])
        aside[:3, :3] = U @ V
    else:
        aside = T_right_left
    truth = replace(cell.truth, T_frame_base=read_only(aside @ cell.truth.T_frame_base))
    other = replace(cell, truth=truth)
    right = named(other.measure(cell.poses(count, seed), seed).measurements)
    parts = ((left, "left"), (right, "right"))
    return cell, joined(
        *(
            replace(
                table,
                images=tuple(f"{name}_{image}" for image in table.images),
                groups=(name,) * len(table),
            )
            for table, name in parts
        )
    )


def named(table: Measurements) -> Measurements:
    """Return a table whose pictures are named by their numbers, by joint values."""
    rows: dict[bytes, str] = {}
    names = tuple(rows.setdefault(q.tobytes(), str(len(rows))) for q in table.joints)
    return replace(table, images=names)


def joined(first: Measurements, second: Measurements) -> Measurements:
    """Return the rows of two tables of corners, one after the other."""
    assert first.board_points is not None
    assert second.board_points is not None
    return Measurements(
        joint_names=first.joint_names,
        joints=np.concatenate([first.joints, second.joints]),
        points=np.concatenate([first.points, second.points]),
        board_points=np.concatenate([first.board_points, second.board_points]),
        kinds=first.kinds + second.kinds,
        groups=first.groups + second.groups,
        images=first.images + second.images,
        corners=first.corners + second.corners,
        readings={
            name: np.concatenate([first.readings[name], second.readings[name]]) for name in "uv"
        },
    )


def of_pictures(table: Measurements) -> Integers:
    """Return the number of each row's picture in their order, shape (N,)."""
    number = {name: k for k, name in enumerate(dict.fromkeys(table.images))}
    return np.array([number[name] for name in table.images])


def with_joints(table: Measurements, q: Array) -> Measurements:
    """Return a table in which the pictures have other joint values, (n, m) [rad]."""
    return replace(table, joints=q[of_pictures(table)], moves=None)


def joints_of(table: Measurements) -> Array:
    """Return the joint values of the pictures, (n, m) [rad]."""
    number = of_pictures(table)
    return table.joints[[int(np.argmax(number == k)) for k in range(number.max() + 1)]]
