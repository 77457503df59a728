"""What the tracker sees: edges of range and cone to a hair, walls in the way, and a UR3 against rays and FCL."""

import re
from functools import cache

import fcl
import numpy as np
import pytest
import trimesh
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from calib import data
from calib.design.collision import CollisionModel
from calib.design.line_of_sight import BEAM, NEST, in_sight
from calib.errors import CalibError, ModelError
from calib.measure.surroundings import Box, Reflector, Tracker
from calib.model.meshes import find_mesh, link_shapes, mesh_folders
from calib.model.readback import spread_poses
from calib.model.robot import Robot
from calib.model.urdf import Urdf
from calib.show.puppet import root_poses

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


ORIGIN = (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("nearest", "farthest", "seen"),
    [(1.0, 2.0, True), (1.0 + 1e-6, 2.0, False), (0.5, 1.0, True), (0.5, 1.0 - 1e-6, False)],
)
def test_the_range(nearest, farthest, seen):
    sight = in_sight(turntable(), [0.0], ORIGIN, Tracker((2.5, 0, 0), nearest, farthest))
    assert (sight.range.tolist(), sight.cone.tolist(), sight.beam.tolist()) == (
        [seen],
        [True],
        [True],
    )
    assert sight.all.tolist() == [seen]


@pytest.mark.parametrize(
    ("angle", "seen"), [(29.9, True), (30.1, False), (-29.9, True), (-30.1, False)]
)
def test_the_edge_of_the_cone(angle, seen):
    # The tip stands at 1.5 m on the x axis and the tracker in line with it: the reflector turns with the joint.
    robot, half = turntable(), np.radians(30.0)
    towards = [np.cos(np.radians(angle)), 0.0, np.sin(np.radians(angle))]
    sight = in_sight(robot, [0.0], ORIGIN, Tracker((4.0, 0, 0)), Reflector(towards, half))
    assert sight.cone.tolist() == [seen]
    assert sight.all.tolist() == [seen]


@given(q=st.floats(-3.1, 3.1), half=st.floats(0.05, 3.1))
@settings(deadline=None)
def test_the_cone_in_closed_form(q, half):
    # The target in the base is at (1.5 cos q, 1.5 sin q), the normal along the arm.
    point, normal = 1.5 * np.array([np.cos(q), np.sin(q)]), np.array([np.cos(q), np.sin(q)])
    way = np.array([3.0, 1.0]) - point
    angle = np.arccos(np.clip(way @ normal / np.linalg.norm(way), -1.0, 1.0))
    assume(abs(angle - half) > 1e-6)
    sight = in_sight(turntable(), [q], ORIGIN, Tracker((3.0, 1.0, 0.0)), Reflector((1, 0, 0), half))
    assert sight.cone.tolist() == [angle <= half]


def beam(y: float, target=ORIGIN, tracker=(-2.0, 0.0, 0.0), q=0.0, boxes=()) -> bool:
    """Whether the beam is free, of a tracker that looks along x at the tip with the ball beside the line."""
    collision = CollisionModel.of(turntable(y), boxes)
    sight = in_sight(turntable(y), [q], target, Tracker(tracker), None, collision)
    return bool(sight.beam[0])


def test_a_ball_beside_the_beam():
    # The beam is 10 mm thick: it misses a ball of 50 mm radius from 55 mm on.
    assert [beam(y) for y in (0.0, 0.05, 0.0549, 0.0551, 0.2)] == [False, False, False, True, True]
    # Seen from the other side the ball is behind the target.
    assert beam(0.0, tracker=(4.0, 0.0, 0.0))


def test_the_nest_does_not_count():
    # The ball's surface is at 1.05 m; the beam ends 30 mm before the target.
    edge = 1.05 + NEST - 1.5
    assert beam(0.0, target=(edge + 1e-4, 0.0, 0.0), tracker=(4.0, 0.0, 0.0))
    assert beam(0.0, target=(edge - 1e-4, 0.0, 0.0), tracker=(4.0, 0.0, 0.0))
    front = 0.95 + NEST - 1.5
    assert beam(0.0, target=(front - 1e-4, 0.0, 0.0))
    assert not beam(0.0, target=(front + 1e-4, 0.0, 0.0))


def test_a_target_closer_than_its_nest_has_no_beam():
    assert beam(0.0, target=(-0.5, 0.0, 0.0), tracker=(0.98, 0.0, 0.0))


def wall(x: float, thick: float = 0.01) -> Box:
    T = np.eye(4)
    T[0, 3] = x
    return Box("wall", (thick, 4.0, 4.0), T)


def test_a_wall_between_and_a_wall_behind():
    free = {x: beam(0.2, tracker=(4.0, 0, 0), boxes=(wall(x),)) for x in (2.0, 3.9, 4.1)}
    assert free == {2.0: False, 3.9: False, 4.1: True}


@cache
def turntable_alone() -> CollisionModel:
    return CollisionModel.of(turntable(0.2))


def test_the_beam_is_not_looked_at_where_range_or_cone_refuse():
    collision = CollisionModel.of(turntable(0.2), [wall(2.0)])
    q = [[0.0], [3.0]]
    far = in_sight(turntable(0.2), q, ORIGIN, Tracker((4.0, 0, 0), 0.0, 1.0), None, collision)
    assert far.beam.tolist() == [True, True]
    assert far.all.tolist() == [False, False]
    cone = in_sight(
        turntable(0.2), q, ORIGIN, Tracker((4.0, 0, 0)), Reflector((1, 0, 0), 0.3), collision
    )
    assert cone.cone.tolist() == [True, False]
    assert cone.beam.tolist() == [False, True]


def test_a_target_is_a_pose_or_a_position():
    T = np.eye(4)
    T[:3, 3] = 0.1, 0.2, 0.3
    tracker = Tracker((4.0, 0, 0), 0.0, 4.0)
    q = spread_poses(turntable(), 50)
    one, other = (in_sight(turntable(), q, t, tracker) for t in (T, T[:3, 3]))
    np.testing.assert_array_equal(one.range, other.range)
    assert 0 < np.count_nonzero(one.range) < 50


@pytest.mark.parametrize(
    ("target", "said"),
    [
        ((0.0, 1.0), "The target's position in the tip must be three finite numbers x, y, z [m]; (0.0, 1.0)"),
        (2.0 * np.eye(4), "The pose of the target must be a 4 x 4 pose with a right-handed rotation"),
    ],
)  # fmt: skip
def test_a_target_that_is_none(target, said):
    with pytest.raises(CalibError, match=re.escape(said)):
        in_sight(turntable(), [0.0], target, Tracker((4, 0, 0)))


def test_joint_values_and_robots_that_do_not_fit():
    with pytest.raises(ModelError):
        in_sight(turntable(), [[0.0, 1.0]], ORIGIN, Tracker((4, 0, 0)))
    with pytest.raises(
        CalibError, match=r"^The collision model is of Robot\('t', base to tip, 1 jo"
    ):
        in_sight(turntable(0.1), [0.0], ORIGIN, Tracker((4, 0, 0)), None, turntable_alone())


# --- A real robot, against rays and FCL ----------------------------------------------------------------------------

TARGET = np.array(data.PAPER_TARGET)
TRACKER = np.array([1.2, 0.3, 0.4])


@cache
def ur3() -> Robot:
    return Robot.load(data.paper_urdf(), base="base", tip="tool0")


def link_poses(q):
    """T_base_link of every link, by the model of pictures, which shares no code with that of collisions."""
    at = root_poses(ur3(), q[None])
    return {link: np.linalg.inv(at[ur3().base][0]) @ T[0] for link, T in at.items()}


@cache
def ur3_meshes() -> dict[str, tuple[np.ndarray, trimesh.Trimesh]]:
    """For each link the pose of its shape there, and the shape as trimesh reads it."""
    result = {}
    for shape in link_shapes(ur3().urdf, "collision"):
        if shape.mesh is None:
            mesh = trimesh.creation.box(shape.sizes)
        else:
            mesh = trimesh.load(find_mesh(shape.mesh[0], mesh_folders(ur3().urdf)), force="mesh")
        result[shape.link] = shape.T_link_shape, mesh
    return result


def beams(q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Start (the tracker), direction and length of the beams to the target, shapes (3,), (N, 3), (N,)."""
    T = ur3().poses(q)
    way = T[:, :3, :3] @ TARGET + T[:, :3, 3] - TRACKER
    distance = np.linalg.norm(way, axis=1)
    return TRACKER, way / distance[:, None], distance - NEST


@cache
def ur3_sight() -> tuple[np.ndarray, np.ndarray]:
    q = np.random.default_rng(8).uniform(-np.pi, np.pi, (150, 6))
    model = CollisionModel.of(ur3())
    q = q[model.free(q)][:100]
    return q, in_sight(ur3(), q, TARGET, Tracker(TRACKER), None, model).beam


def test_the_ur3_s_beam_against_fcl():
    q, free = ur3_sight()
    start, along, length = beams(q)
    solids = {}
    for link, (T_link_shape, mesh) in ur3_meshes().items():
        solid = fcl.BVHModel()
        solid.beginModel(len(mesh.vertices), len(mesh.faces))
        solid.addSubModel(np.array(mesh.vertices), np.array(mesh.faces))
        solid.endModel()
        solids[link] = T_link_shape, solid
    expected = []
    for row, way, reach in zip(q, along, length, strict=True):
        R = trimesh.geometry.align_vectors([0, 0, 1], way)[:3, :3]
        rod = fcl.CollisionObject(
            fcl.Capsule(0.5 * BEAM, reach - BEAM), fcl.Transform(R, start + 0.5 * reach * way)
        )
        poses = link_poses(row)
        blocked = False
        for link, (T_link_shape, solid) in solids.items():
            T = poses[link] @ T_link_shape
            placed = fcl.CollisionObject(solid, fcl.Transform(T[:3, :3], T[:3, 3]))
            request, result = fcl.CollisionRequest(), fcl.CollisionResult()
            blocked = blocked or bool(fcl.collide(rod, placed, request, result))
        expected.append(not blocked)
    np.testing.assert_array_equal(free, expected)
