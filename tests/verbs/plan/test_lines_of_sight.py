"""Lines of sight: a ball in the way to a hair, and a UR3 against rays and FCL."""

from functools import cache

import fcl
import numpy as np
import trimesh

from calib import example
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf
from calib.verbs.plan.collision import BEAM, NEST, CollisionCheck, CollisionModel
from tests.verbs.plan.fcl_scene import objects, placed, touch

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
