"""A robot that can be posed: its shapes, each fixed to what moves it, and where that is at each of many poses.

Everything that moves is a mover: the links that show something, and the frames of base, tip and target. A link without
a visual that can be drawn is a ball with rods to the links that hang on it; where none can be drawn, the robot is a
stick figure. Rods reach from one mover to another, for a sliding joint changes their length.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.model.chain import full_configurations, full_model, link_frame
from calib.model.robot import Robot, read_only, rigid_inverse
from calib.show.shapes import Cylinder, Shape, Sphere, Triangles, Visual

Array = NDArray[np.float64]

#: Radius of a stick figure's rods, as a part of the robot's size.
STICK = 0.018

#: The movers beside the links, in this order, last.
FRAMES = ("base", "tip", "target")

#: At most so many poses are looked at for what the shapes reach; the origins of links are at all of them.
_REACHED = 60

#: The 26 directions to a cube's corners, edges and faces.
_DIRECTIONS = np.array([d for d in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(d)])

#: The corners of a cube about the origin.
_CORNERS = np.array(list(itertools.product((-0.5, 0.5), repeat=3)))


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """A shape that is fixed to a mover.

    Attributes:
        mover: The mover's number.
        shape: What is drawn.
        T_mover_shape: shape (4, 4), [m].
    """

    mover: int
    shape: Shape
    T_mover_shape: Array

    def corners(self) -> Array:
        """Points in the mover that hold the shape: its outermost, or the corners of its box, shape (K, 3), [m]."""
        shape, T = self.shape, self.T_mover_shape
        if isinstance(shape, Triangles):
            vertices = shape.vertices.astype(np.float64)
            points = vertices[np.argmax(vertices @ (_DIRECTIONS @ T[:3, :3]).T, axis=0)]
        elif isinstance(shape, Sphere):
            points = 2.0 * shape.radius * _CORNERS
        elif isinstance(shape, Cylinder):
            points = _CORNERS * [2.0 * shape.radius, 2.0 * shape.radius, shape.length]
        else:
            points = _CORNERS * shape.size
        return np.asarray(points @ T[:3, :3].T + T[:3, 3])


@dataclass(frozen=True, slots=True, eq=False)
class Puppet:
    """What of one robot is drawn, and where it is.

    Attributes:
        links: The links that are movers; the frames of `FRAMES` come after them.
        parts: The shapes.
        rods: Pairs of movers with a rod from the origin of one to that of the other.
        radius: Of a rod [m].
        poses: shape (N, L, 4, 4), of each mover at each pose, on the stage [m].
        origins: shape (N, K, 3), of all links of the URDF [m].
    """

    links: tuple[str, ...]
    parts: tuple[Part, ...]
    rods: tuple[tuple[int, int], ...]
    radius: float
    poses: Array
    origins: Array

    @classmethod
    def of(
        cls,
        robot: Robot,
        q: Array,
        visuals: Sequence[Visual],
        T_stage_base: Array,
        T_tip_target: Array,
    ) -> Puppet:
        """A robot at many poses.

        Args:
            robot: The robot.
            q: shape (N, m), [rad] or [m], in the order of ``robot.joint_names``.
            visuals: What it looks like.
            T_stage_base: shape (N, 4, 4), where it stands [m].
            T_tip_target: shape (N, 4, 4) or (4, 4), [m].

        Raises:
            UrdfError: Pinocchio cannot build a model of the URDF.
        """
        in_root = root_poses(robot, q)
        T_stage_root = T_stage_base @ rigid_inverse(in_root[robot.base])
        shown = {v.link for v in visuals if v.shape is not None} & set(in_root)
        missing = {v.link for v in visuals if v.shape is None}
        sticks = missing if shown else set(robot.urdf.links)
        joints = [joint for joint in robot.urdf.joints if joint.parent in sticks]
        needed = shown | sticks | {joint.child for joint in joints}
        links = tuple(link for link in robot.urdf.links if link in needed)
        number = {link: k for k, link in enumerate(links)}
        # The robot's own forward kinematics put tip and target: those are the points that the tables speak of.
        T_tip = T_stage_base @ robot.poses(q)
        moved = [T_stage_root @ in_root[link] for link in links]
        poses = np.stack([*moved, T_stage_base, T_tip, T_tip @ T_tip_target], axis=1)
        origins = np.stack([(T_stage_root @ T)[:, :3, 3] for T in in_root.values()], axis=1)
        radius = STICK * span(origins[0])
        parts = [
            Part(number[v.link], v.shape, v.T_link_shape)
            for v in visuals
            if v.shape is not None and v.link in shown
        ]
        ball = Sphere(1.6 * radius)
        parts += [Part(number[link], ball, np.eye(4)) for link in links if link in sticks]
        rods = tuple((number[joint.parent], number[joint.child]) for joint in joints)
        return cls(links, tuple(parts), rods, radius, read_only(poses), read_only(origins))

    @property
    def targets(self) -> Array:
        """Where the target is, shape (N, 3), [m]."""
        return np.asarray(self.poses[:, -1, :3, 3])

    def outline(self, n: int) -> Array:
        """Points that hold the robot at a pose, shape (K, 3), [m]."""
        at = self.poses[n]
        corners = [p.corners() @ at[p.mover, :3, :3].T + at[p.mover, :3, 3] for p in self.parts]
        return np.concatenate([self.origins[n], *corners])

    def reach(self) -> Array:
        """Points that hold the robot at all its poses, shape (K, 3), [m].

        The origins of all movers at every pose, and the corners of the boxes about what moves with each at some poses.
        """
        count = min(len(self.poses), _REACHED)
        some = self.poses[np.linspace(0, len(self.poses) - 1, count).round().astype(int)]
        points = [self.poses[:, :, :3, 3].reshape(-1, 3)]
        for mover in {part.mover for part in self.parts}:
            held = np.concatenate([part.corners() for part in self.parts if part.mover == mover])
            low, high = held.min(axis=0), held.max(axis=0)
            box = 0.5 * (low + high) + _CORNERS * (high - low)
            at = some[:, mover]
            points.append((box @ at[:, :3, :3].swapaxes(1, 2) + at[:, None, :3, 3]).reshape(-1, 3))
        return np.concatenate(points)


def root_poses(robot: Robot, q: Array) -> dict[str, Array]:
    """T_root_link of every link of the URDF at many poses, each joint where `Robot.urdf_values` says.

    Args:
        robot: The robot.
        q: shape (N, m), [rad] or [m], in the order of ``robot.joint_names``.

    Returns:
        By link, shape (N, 4, 4), [m].
    """
    model = full_model(robot.urdf)
    data = model.createData()
    frames = [link_frame(model, link) for link in robot.urdf.links]
    poses = np.empty((len(q), len(frames), 4, 4))
    for n, configuration in enumerate(full_configurations(model, robot.urdf_values(q))):
        pin.framesForwardKinematics(model, data, configuration)
        for k, frame in enumerate(frames):
            poses[n, k] = data.oMf[frame].homogeneous
    return {link: poses[:, k] for k, link in enumerate(robot.urdf.links)}


def stage_poses(robot: Robot, q: Array) -> Array:
    """Where the base stands on the stage at each pose, shape (N, 4, 4), [m].

    The stage is the robot's base; where joints move the base itself, as they do a camera's, it is the root of the URDF.
    """
    if not robot.base_moves:
        return np.broadcast_to(np.eye(4), (len(q), 4, 4))
    return root_poses(robot, q)[robot.base]


def packed(poses: Array) -> NDArray[np.float32]:
    """Poses as position and quaternion (x, y, z, w), shape (..., 7), of poses of shape (..., 4, 4), [m]."""
    flat = poses.reshape(-1, 4, 4)
    # A copy: SciPy before 1.14 takes no matrix that is read-only.
    turned = Rotation.from_matrix(flat[:, :3, :3].copy()).as_quat()
    both = np.concatenate([flat[:, :3, 3], turned], axis=1).astype(np.float32)
    return both.reshape(*poses.shape[:-2], 7)


def rod_between(start: Array, end: Array) -> tuple[Array, float]:
    """The pose of a rod between two points, z along it, and its length [m]."""
    length = float(np.linalg.norm(end - start))
    T = np.eye(4)
    T[:3, 3] = 0.5 * (start + end)
    if length > 0:
        turn, _ = Rotation.align_vectors([(end - start) / length], [[0.0, 0.0, 1.0]])
        T[:3, :3] = turn.as_matrix()
    return T, length


def span(points: Array) -> float:
    """The diagonal of the points' bounding box; 1 mm at least [m]."""
    return max(float(np.linalg.norm(np.ptp(points, axis=0))), 1e-3)
