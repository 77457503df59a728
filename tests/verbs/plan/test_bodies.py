"""Camera and board as bodies, and lines of sight: a ball in the way to a hair, and a UR3 against rays and FCL."""

from __future__ import annotations

from functools import cache

import fcl
import numpy as np
import pytest
import trimesh

from calib import example
from calib.data.cell import Box, Cell
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf
from calib.verbs.plan.bodies import collision_model, free_lines_of_sight
from calib.verbs.plan.collision import BEAM, NEST, CollisionCheck, CollisionModel
from calib.verbs.plan.sensitivity import Sensitivity
from tests.instruments.scenes import BOARD, CAMERA, at_places, pose
from tests.verbs.plan.fcl_scene import objects, placed, touch

#: A slide along z on a foot, with a ball of 50 mm beside it, and on it a hand.
SLIDE = """<robot name="s"><link name="foot"/>
  <link name="hand"><collision><origin xyz="0 0 -0.3"/><geometry><sphere radius="0.05"/></geometry></collision></link>
  <joint name="j" type="prismatic"><parent link="foot"/><child link="hand"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="2" effort="1" velocity="1"/></joint></robot>"""

NO_FLOOR = CollisionCheck(floor=False)


def slide(base: str, tip: str) -> Robot:
    return Robot.from_urdf(Urdf.from_bytes(SLIDE.encode(), "s.urdf"), base, tip)


def board_ahead(x: float = 0.0) -> np.ndarray:
    """The board's centre on the z axis of its link, x beside it, its print towards -z."""
    return pose((x - BOARD.centre[0], -BOARD.centre[1], 0.0))


class Bodies:
    """The robot with a camera and the board, from the camera's link to the board's."""

    def __init__(self, robot: Robot, T_camera_base, T_tip_board, boxes=()):
        cell = Cell(cameras={"": CAMERA}, boards={"": BOARD}, boxes=tuple(boxes), model="zeros")
        self.sensitivity = Sensitivity.of(robot, at_places(cell, T_camera_base, T_tip_board))
        self.model: CollisionModel = collision_model(
            self.sensitivity.instrument, self.sensitivity, NO_FLOOR
        )

    def view_free(self, q: np.ndarray) -> np.ndarray:
        conditions = list(free_lines_of_sight(self.sensitivity, self.model))
        assert [condition.reason for condition in conditions] == ["beam"] * 5
        return np.all([condition.passes(q) for condition in conditions], axis=0)


def held_by_foot(T_tip_board: np.ndarray, boxes=()) -> Bodies:
    """The camera in the hand looks down along -z at the board on the foot, face up."""
    # In the hand z is up: the camera is turned about x.
    return Bodies(
        slide("hand", "foot"), pose((0.0, 0.0, 0.0), (np.pi, 0.0, 0.0)), T_tip_board, boxes
    )


#: Face up: turned about the x axis through its middle.
FACE_UP = pose((-BOARD.centre[0], BOARD.centre[1], 0.0), (np.pi, 0.0, 0.0))


def test_the_ball_below_the_hand_hides_the_board_and_hits_it():
    bodies = held_by_foot(FACE_UP)
    # The ball's middle is 300 mm below the hand: in the line of sight from 350 mm on, 50 mm above the board.
    q = np.array([[1.0], [0.6]])
    assert bodies.view_free(q).tolist() == [False, False]
    # At 300 mm it is in the board; 10 mm below the print the board ends.
    heights = np.array([[0.4], [0.351], [0.349], [0.3], [0.241], [0.239]])
    assert bodies.model.free(heights).tolist() == [True, True, False, False, False, True]


def test_a_board_aside_is_seen_past_the_ball():
    aside = FACE_UP.copy()
    aside[0, 3] += 0.5
    bodies = held_by_foot(aside)
    assert bodies.view_free(np.array([[1.0]])).tolist() == [True]
    # One of its corners is behind the ball.
    near = FACE_UP.copy()
    near[0, 3] += 0.5 * BOARD.size[0]
    near[1, 3] -= 0.5 * BOARD.size[1]
    assert held_by_foot(near).view_free(np.array([[1.0]])).tolist() == [False]


def test_boxes_stand_with_the_board_where_the_camera_is_in_the_hand():
    aside = FACE_UP.copy()
    aside[0, 3] += 0.5
    box = Box("block", (0.2, 0.2, 0.2), pose((0.0, 0.0, 0.5)))
    bodies = held_by_foot(aside, [box])
    heights = np.array([[0.75], [0.96]])
    # The ball is at 0.45 m, in the block, whose top is at 0.6 m, then above it.
    assert bodies.model.free(heights).tolist() == [False, True]
    names = bodies.model.notes[0]
    assert names.code == "images_checked"
    assert "block" in names.values


def test_a_camera_that_stands_is_not_touched():
    robot = slide("foot", "hand")
    T_base_camera = pose((0.0, 0.0, 0.7))
    T_tip_board = board_ahead() + 0.0
    T_tip_board[2, 3] = 1.0
    bodies = Bodies(robot, np.linalg.inv(T_base_camera), T_tip_board)
    # The ball, 300 mm below the hand, has a radius of 50 mm and the camera one of 35 mm.
    heights = np.array([[0.914], [0.916], [1.0], [1.084], [1.086]])
    assert bodies.model.free(heights).tolist() == [True, False, False, False, True]


@pytest.mark.parametrize("length", [0.05, 0.2])
def test_the_camera_in_the_hand_is_a_rod_from_its_link(length):
    T_tip_board = FACE_UP.copy()
    robot = slide("hand", "foot")
    T_base_camera = pose((0.0, 0.0, -length), (np.pi, 0.0, 0.0))
    bodies = Bodies(robot, np.linalg.inv(T_base_camera), T_tip_board)
    (sightline,) = bodies.sensitivity.sightlines
    assert sightline.eye == pytest.approx([0.0, 0.0, -length])
    # Its end is a half ball of 20 mm; the ball of the hand touches the board before, unless the hand is below.
    heights = np.array([[length + 0.02 + 1e-3], [length + 0.02 - 1e-3]])
    free = bodies.model.free(heights)
    assert free.tolist() == [True, False] if length == 0.05 else not free[1]


# Lines of sight


#: A post that turns about z, and on it a ball of 50 mm, 1 m away and beside the tip that is 1.5 m away.
TURNTABLE = """<robot name="t"><link name="base"/>
  <link name="arm"><collision><origin xyz="1 {y} 0"/><geometry><sphere radius="0.05"/></geometry></collision></link>
  <link name="tip"/>
  <joint name="j" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
    <limit lower="-3.1" upper="3.1" effort="1" velocity="1"/></joint>
  <joint name="f" type="fixed"><parent link="arm"/><child link="tip"/><origin xyz="1.5 0 0"/></joint></robot>"""


@cache
def turntable(y: float = 0.0) -> Robot:
    urdf = Urdf.from_bytes(TURNTABLE.format(y=y).encode(), "t.urdf")
    return Robot.from_urdf(urdf, "base", "tip")


def model_of(robot: Robot, boxes=()) -> CollisionModel:
    return CollisionModel.of(robot, boxes, check=CollisionCheck(floor=False))


ORIGIN = np.eye(4)
ZERO = np.zeros((1, 1))


def beam(y: float, tracker=(-2.0, 0.0, 0.0)) -> bool:
    """Whether the beam is free, of a tracker that looks along x at the tip with the ball beside the line."""
    model = model_of(turntable(y))
    return bool(model.beam_free(ORIGIN, np.array(tracker), ZERO)[0])


def test_a_ball_beside_the_beam():
    # The beam is 10 mm thick: it misses a ball of 50 mm radius from 55 mm on.
    assert [beam(y) for y in (0.0, 0.05, 0.0549, 0.0551, 0.2)] == [False, False, False, True, True]
    # Seen from the other side the ball is behind the target.
    assert beam(0.0, tracker=(4.0, 0.0, 0.0))


# --- A real robot, against rays and FCL ----------------------------------------------------------------------------

TARGET = np.array(example.PAPER_TARGET)
TRACKER = np.array([1.2, 0.3, 0.4])


@cache
def ur3() -> Robot:
    return Robot.load(example.paper_urdf(), base="base", tip="tool0")


@cache
def ur3_sight() -> tuple[np.ndarray, np.ndarray]:
    q = np.random.default_rng(8).uniform(-np.pi, np.pi, (150, 6))
    model = model_of(ur3())
    q = q[model.free(q)][:100]
    T = np.eye(4)
    T[:3, 3] = TARGET
    return q, model.beam_free(T, TRACKER, q)


def test_the_ur3_s_beam_against_fcl():
    q, free = ur3_sight()
    way = (ur3().poses(q) @ [*TARGET, 1.0])[:, :3] - TRACKER
    reach = np.linalg.norm(way, axis=1) - NEST
    expected = []
    for row, along, length in zip(q, way, reach, strict=True):
        T = trimesh.geometry.align_vectors([0, 0, 1], along)
        T[:3, 3] = TRACKER + 0.5 * length * along / np.linalg.norm(along)
        rod = placed(fcl.Capsule(0.5 * BEAM, length - BEAM), T)
        expected.append(not any(touch(rod, one) for one in objects(ur3(), row).values()))
    np.testing.assert_array_equal(free, expected)
