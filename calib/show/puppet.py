"""A robot that can be posed: its shapes, each fixed to what moves it, and where that is at each of many poses.

Everything that moves is a mover: the links that show something, and the frames of base, tip and target. The rods of a
stick figure reach from one mover to another, for a sliding joint changes their length.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.model.robot import Robot, read_only, rigid_inverse
from calib.show.bodies import STICK, Body, root_poses, span
from calib.show.view import View
from calib.show.visuals import Cylinder, Shape, Sphere, Visual

Array = NDArray[np.float64]

#: The movers beside the links, in this order, last.
FRAMES = ("base", "tip", "target")

#: At most so many poses are looked at for what the shapes reach; the origins of links are at all of them.
_REACHED = 60


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


@dataclass(frozen=True, slots=True, eq=False)
class Puppet:
    """What of one robot is drawn, and where it is.

    Attributes:
        links: The links that are movers; the frames of `FRAMES` come after them.
        parts: The shapes.
        rods: Pairs of movers with a rod from the origin of one to that of the other.
        radius: Of a rod [m].
        poses: shape (N, L, 4, 4), of each mover at each pose, on the stage [m].
    """

    links: tuple[str, ...]
    parts: tuple[Part, ...]
    rods: tuple[tuple[int, int], ...]
    radius: float
    poses: Array

    @property
    def targets(self) -> Array:
        """Where the target is, shape (N, 3), [m]."""
        return np.asarray(self.poses[:, -1, :3, 3])

    def reach(self) -> Array:
        """Points that hold the robot at all its poses, shape (K, 3), [m].

        The origins of all movers at every pose, and the corners of the boxes about what moves with each at some poses.
        """
        origins = self.poses[:, :, :3, 3].reshape(-1, 3)
        count = min(len(self.poses), _REACHED)
        some = self.poses[np.linspace(0, len(self.poses) - 1, count).round().astype(int)]
        corners = [
            (some[:, mover, :3, :3] @ box.T).swapaxes(1, 2) + some[:, mover, None, :3, 3]
            for mover, box in _boxes(self.parts).items()
        ]
        return np.concatenate([origins, *(points.reshape(-1, 3) for points in corners)])

    def bodies(self, n: int) -> list[Body]:
        """The shapes at one pose, rods included."""
        at = self.poses[n]
        result = [Body("", p.shape, at[p.mover] @ p.T_mover_shape) for p in self.parts]
        for start, end in self.rods:
            T, length = rod_between(at[start, :3, 3], at[end, :3, 3])
            result.append(Body("", Cylinder(self.radius, max(length, 1e-9)), T))
        return result


def puppets(view: View, visuals: Mapping[str, Sequence[Visual]]) -> dict[str, Puppet]:
    """The robots of a view by ``"nominal"`` and ``"calibrated"``, upright on the stage.

    The stage is the calibrated robot's base; where joints move the base itself, as they do a camera's, it is the root.

    Args:
        view: The view.
        visuals: What each robot looks like.

    Raises:
        UrdfError: Pinocchio cannot build a model of a URDF.
    """
    T_stage_base = stage_poses(view)
    shown = {
        "nominal": (T_stage_base @ view.T_base_nominal, view.nominal_target),
        "calibrated": (T_stage_base, view.calibrated_target),
    }
    return {
        who: _puppet(robot, view.q, visuals[who], *shown[who]) for who, robot in view.robots.items()
    }


def stage_poses(view: View) -> Array:
    """Where the base stands on the stage at each pose, shape (N, 4, 4), [m]."""
    if not view.nominal.base_moves:
        return np.broadcast_to(np.eye(4), (len(view.q), 4, 4))
    return root_poses(view.nominal, view.q)[view.nominal.base]


def packed(poses: Array) -> NDArray[np.float32]:
    """Poses as position and quaternion (x, y, z, w), shape (..., 7), [m].

    Args:
        poses: shape (..., 4, 4), [m].
    """
    flat = poses.reshape(-1, 4, 4)
    # A copy: SciPy before 1.14 takes no matrix that is read-only.
    turned = Rotation.from_matrix(flat[:, :3, :3].copy()).as_quat()
    both = np.concatenate([flat[:, :3, 3], turned], axis=1).astype(np.float32)
    return both.reshape(*poses.shape[:-2], 7)


def rod_between(start: Array, end: Array) -> tuple[Array, float]:
    """The pose of a rod between two points, z along it, and its length [m].

    Args:
        start: shape (3,), [m].
        end: shape (3,), [m].
    """
    length = float(np.linalg.norm(end - start))
    T = np.eye(4)
    T[:3, 3] = 0.5 * (start + end)
    if length > 0:
        turn, _ = Rotation.align_vectors([(end - start) / length], [[0.0, 0.0, 1.0]])
        T[:3, :3] = turn.as_matrix()
    return T, length


def _boxes(parts: Sequence[Part]) -> dict[int, Array]:
    """The corners of the box about all shapes of each mover, in the mover, shape (8, 3), [m]."""
    outlines: dict[int, list[Array]] = {}
    for part in parts:
        outlines.setdefault(part.mover, []).append(
            Body("", part.shape, part.T_mover_shape).outline()
        )
    unit = np.stack(np.meshgrid(*[[0.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
    result = {}
    for mover, outline in outlines.items():
        points = np.concatenate(outline)
        low, high = points.min(axis=0), points.max(axis=0)
        result[mover] = low + unit * (high - low)
    return result


def _puppet(
    robot: Robot, q: Array, visuals: Sequence[Visual], T_stage_base: Array, T_tip_target: Array
) -> Puppet:
    """One robot."""
    in_root = root_poses(robot, q)
    T_stage_root = T_stage_base @ rigid_inverse(in_root[robot.base])
    drawn = [visual for visual in visuals if visual.shape is not None and visual.link in in_root]
    missing = {visual.link for visual in visuals if visual.shape is None}
    sticks = missing if drawn else set(robot.urdf.links)
    ends = {joint.child for joint in robot.urdf.joints if joint.parent in sticks}
    needed = {visual.link for visual in drawn} | sticks | ends
    links = tuple(link for link in robot.urdf.links if link in needed)
    number = {link: k for k, link in enumerate(links)}
    # The robot's own forward kinematics put tip and target: those are the points that the tables speak of.
    T_tip = T_stage_base @ robot.poses(q)
    frames = np.stack([T_stage_base, T_tip, T_tip @ T_tip_target], axis=1)
    moved = [T_stage_root @ in_root[link] for link in links]
    poses = np.concatenate([np.stack(moved, axis=1), frames], axis=1) if moved else frames
    radius = STICK * span(poses[0, :, :3, 3])
    parts = [
        Part(number[visual.link], visual.shape, visual.T_link_shape)
        for visual in drawn
        if visual.shape is not None
    ]
    parts += [
        Part(number[link], Sphere(1.6 * radius), np.eye(4)) for link in links if link in sticks
    ]
    rods = tuple(
        (number[joint.parent], number[joint.child])
        for joint in robot.urdf.joints
        if joint.parent in sticks
    )
    return Puppet(links, tuple(parts), rods, radius, read_only(poses))
