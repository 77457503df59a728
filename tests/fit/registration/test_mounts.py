"""Where a second robot stands, found from points on both hands and from a camera on one and a board on the other."""

import numpy as np
import pinocchio as pin
import pytest

from calib.basics.arrays import Array
from calib.boards.board import Board
from calib.camera.camera import Camera
from calib.data.cell import Cell, FurtherRobot
from calib.data.cell_chains import robot_of_cell
from calib.data.measurements import Measurements
from calib.fit.registration.mounts import with_mounts_found
from calib.fit.registration.table_rows import rows_and_setup
from calib.numerics.geometry import pose_of
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.robot.urdf import read_urdf
from calib.verbs.simulate.scenario import Scenario, simulate

PLACE = pose_of(xyz=[1.1, 0.2, 0.05], rotation=pin.exp3(np.array([0.05, -0.02, 2.8])))

FRAME = pose_of(xyz=[1.0, 2.0, 0.3], rotation=pin.exp3(np.array([1.0, -0.7, 0.4])))

TARGET = pose_of(xyz=[0.06, 0.03, 0.05], rotation=pin.exp3(np.array([0.3, 0.2, -0.5])))


def placed(robot: Robot) -> Robot:
    """The robot with its mount where it stands."""
    return robot.with_limbs([limb.placements for limb in robot.limbs], {"right/mount": PLACE})


def found(robot: Robot, table: Measurements, cell: Cell) -> Array:
    rows, setup = rows_and_setup(robot, table, cell)
    return np.asarray(
        with_mounts_found(robot, setup, rows).urdf.joint("right/mount").T_parent_joint
    )


def test_points_on_both_hands():
    cell = Cell(
        robots={"right": FurtherRobot("panda")},
        tips={"a": "panda_link8", "b": "right/panda_link8"},
        estimate_frame=True,
    )
    robot = robot_of_cell(read_urdf("panda"), cell, sights=[("", "a"), ("", "b")])
    q = random_joint_values(robot, 30)
    chain = np.arange(30) % 2
    points = (FRAME @ placed(robot).poses(q, chain) @ TARGET)[:, :3, 3]
    table = Measurements(robot.joint_names, q, points, targets=tuple("ab"[k] for k in chain))
    assert np.allclose(found(robot, table, cell), PLACE, rtol=0.0, atol=1e-6)


@pytest.mark.slow
def test_poses_of_one_hand_seen_from_the_other():
    cell = Cell(
        robots={"right": FurtherRobot("panda")},
        bases={"camera": "panda_link8"},
        tips={"board": "right/panda_link8"},
        estimate_frame=True,
    )
    robot = robot_of_cell(read_urdf("panda"), cell, sights=[("camera", "board")])
    assert not robot.branches
    q = random_joint_values(robot, 30)
    T = FRAME @ placed(robot).poses(q) @ TARGET
    table = Measurements(
        robot.joint_names,
        q,
        T[:, :3, 3],
        rotations=T[:, :3, :3],
        kinds=("pose",) * 30,
        groups=("camera",) * 30,
        targets=("board",) * 30,
    )
    mount = found(robot, table, cell)
    assert np.allclose(mount, PLACE, rtol=0.0, atol=1e-6)


@pytest.mark.slow
def test_images_by_one_hand_of_a_board_on_the_other_at_any_postures():
    """From most starts the camera looks away from the board, and corners alone would lead nowhere."""
    cell = Cell(
        kind="pixel",
        robots={"right": FurtherRobot("panda")},
        bases={"camera": "panda_link8"},
        tips={"board": "right/panda_link8"},
        cameras={"camera": Camera(width=1280, height=720)},
        boards={"board": Board(pattern="chessboard", columns=5, rows=4, square=0.04)},
    )
    made = simulate(Scenario("panda", cell), 80, 0, seed=1)
    robot = robot_of_cell(read_urdf("panda"), cell, sights=[("camera", "board")])
    mount = found(robot, made.measurements, cell)
    true = made.truth.robot.urdf.joint("right/mount").T_parent_joint
    # The nominal arms are off by millimetres.
    assert np.linalg.norm(mount[:3, 3] - true[:3, 3]) < 0.03
    assert np.linalg.norm(pin.log3(mount[:3, :3].T @ true[:3, :3])) < 0.03
