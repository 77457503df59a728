"""A robot's shapes, each where the robot's own forward kinematics put it."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib.model.chain import full_configurations, full_model, link_frame
from calib.model.robot import Robot, rigid_inverse
from calib.show.triangles import Triangles
from calib.show.visuals import Cylinder, Shape, Sphere, Visual

Array = NDArray[np.float64]

#: Radius of a stick figure's rods, as a part of the robot's size.
STICK = 0.018

#: The 26 directions to a cube's corners, edges and faces.
_DIRECTIONS = np.array([d for d in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(d)])


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A shape at a pose.

    Attributes:
        link: The link that it belongs to.
        shape: What is drawn.
        T_base_shape: shape (4, 4), [m].
    """

    link: str
    shape: Shape
    T_base_shape: Array

    def outline(self) -> Array:
        """Points of the shape in the base frame, the outermost among them, shape (K, 3), [m].

        A simple shape has the corners of its box instead.
        """
        if isinstance(self.shape, Triangles):
            vertices = self.shape.vertices.astype(np.float64)
            outermost = np.argmax(vertices @ (_DIRECTIONS @ self.T_base_shape[:3, :3]).T, axis=0)
            step = 1 + len(vertices) // 200
            points = np.concatenate([vertices[outermost], vertices[::step]])
        else:
            corners = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3), axis=-1).reshape(-1, 3)
            points = corners * _extent(self.shape)
        result: Array = points @ self.T_base_shape[:3, :3].T + self.T_base_shape[:3, 3]
        return result


def link_poses(robot: Robot, q: Array) -> dict[str, Array]:
    """T_base_link of every link of the URDF, each joint where `Robot.urdf_values` says.

    Args:
        robot: The robot.
        q: shape (m,), [rad] or [m], in the order of ``robot.joint_names``.

    Returns:
        By link, shape (4, 4), [m]; the tip's equals ``robot.poses(q)``.
    """
    T_root_link = root_poses(robot, q[None])
    T_base_root = rigid_inverse(T_root_link[robot.base][0])
    return {link: T_base_root @ T[0] for link, T in T_root_link.items()}


def root_poses(robot: Robot, q: Array) -> dict[str, Array]:
    """T_root_link of every link of the URDF at many poses.

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


def bodies(robot: Robot, q: Array, visuals: Sequence[Visual]) -> tuple[Body, ...]:
    """The robot's shapes at ``q``.

    A missing visual is drawn as rods from the link's origin to the joints that it carries. Where no visual can be
    drawn at all, every link is: a stick figure.
    """
    poses = link_poses(robot, q)
    sticks = {visual.link for visual in visuals if visual.shape is None}
    if not any(visual.shape for visual in visuals):
        sticks = set(robot.urdf.links)
    result = [
        Body(visual.link, visual.shape, poses[visual.link] @ visual.T_link_shape)
        for visual in visuals
        if visual.shape is not None and visual.link in poses
    ]
    radius = STICK * span(np.array([T[:3, 3] for T in poses.values()]))
    for link in robot.urdf.links:
        if link in sticks:
            result += _stick(robot, link, poses, radius)
    return tuple(result)


def _stick(robot: Robot, link: str, poses: dict[str, Array], radius: float) -> list[Body]:
    """A ball at the link's origin and a rod to the origin of each link that hangs on it."""
    ball = poses[link]
    parts = [Body(link, Sphere(1.6 * radius), ball)]
    for joint in robot.urdf.joints:
        if joint.parent != link:
            continue
        start, end = ball[:3, 3], poses[joint.child][:3, 3]
        length = float(np.linalg.norm(end - start))
        if length > 0.1 * radius:
            parts.append(Body(link, Cylinder(radius, length), rod_pose(start, end)))
    return parts


def rod_pose(start: Array, end: Array) -> Array:
    """A pose halfway between two points whose z axis points from one to the other, shape (4, 4)."""
    z = (end - start) / np.linalg.norm(end - start)
    x = np.cross(np.eye(3)[np.argmin(np.abs(z))], z)
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    T[:3, 3] = 0.5 * (start + end)
    return T


def span(points: Array) -> float:
    """The diagonal of the points' bounding box; 1 mm at least [m]."""
    return max(float(np.linalg.norm(np.ptp(points, axis=0))), 1e-3)


def _extent(shape: Shape) -> Array:
    """The edges of the box about a simple shape, shape (3,), [m]."""
    if isinstance(shape, Sphere):
        return np.full(3, 2.0 * shape.radius)
    if isinstance(shape, Cylinder):
        return np.array([2.0 * shape.radius, 2.0 * shape.radius, shape.length])
    return np.array(getattr(shape, "size", (0.0, 0.0, 0.0)), dtype=np.float64)
