"""The postures in which an arm of six turning joints reaches a pose: front or back, and elbow up or down.

Axes 2 and 3 are parallel and carry the wrist, where the last three axes meet, or nearly so. With directions a_i of the
axes, points s, e of axes 2, 3, and the centre w of the wrist, the point of axis 5 that is nearest to axis 4,

    front:     f . (w - o) > 0,                      f = a_1 x a_2 up to its sign, o a point of axis 1
    elbow up:  a_2 . ((e - s) x (w - e))             up to its sign

Both signs are those of the arm at zero, where controllers say that it is in front of its first axis with the elbow up.
Each changes only where the arm is singular, so that makers' words for solutions, which differ, come down to these.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from calib.basics.arrays import Array, Mask
from calib.basics.values import Value
from calib.robot.robot import Robot

#: Less than this at zero has no sign: front or back as a distance [m], the elbow as an area [m^2].
_NO_SIGN = 1e-3

#: So close to where the sign changes both postures are possible [m], [m^2].
_CLOSE = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class ArmPosture(Value):
    """How the postures of an arm are told from its joint values."""

    robot: Robot
    #: Distance of the wrist in front of axis 1 [m] and area at the elbow [m^2] with all joints at zero; 0: no sign.
    at_zero: tuple[float, float]

    @classmethod
    def of(cls, robot: Robot | None) -> ArmPosture | None:
        """Return the postures of a robot; None if it does not have six turning joints, axes 2 and 3 parallel."""
        if robot is None or len(robot.joints) != 6 or len(robot.joint_names) != 6:
            return None
        if any(joint.type == "prismatic" for joint in robot.joints):
            return None
        origins, axes = _axes_at(robot, np.zeros((1, 6)))
        if np.linalg.norm(np.cross(axes[0, 1], axes[0, 2])) > 1e-6:
            return None
        front, elbow = (float(value[0]) for value in _measures(origins, axes))
        return cls(
            robot,
            (
                front if abs(front) > _NO_SIGN else 0.0,
                elbow if abs(elbow) > _NO_SIGN else 0.0,
            ),
        )

    def is_front(self, q: Array, *, front: bool) -> Mask:
        """Return whether the wrist is in front of axis 1, or behind it, at joint values (K, 6) [rad], shape (K,)."""
        value = _measures(*_axes_at(self.robot, q))[0] * np.sign(self.at_zero[0])
        return np.asarray(value > -_CLOSE if front else value < _CLOSE)

    def is_elbow_up(self, q: Array, *, up: bool) -> Mask:
        """Return whether the elbow is up, or down, at joint values (K, 6) [rad], shape (K,)."""
        value = _measures(*_axes_at(self.robot, q))[1] * np.sign(self.at_zero[1])
        return np.asarray(value > -_CLOSE if up else value < _CLOSE)

    def signed(self, q: Array) -> tuple[Array, Array]:
        """Return both measures of the module's text with the signs of the axes themselves.

        Args:
            q: Joint values, shape (K, 6) [rad].

        Returns:
            How far the wrist is in the direction of a_1 x a_2 from axis 1 [m], and the area at the elbow about a_2
            [m^2], shape (K,) each.
        """
        return _measures(*_axes_at(self.robot, q))


def _axes_at(robot: Robot, q: Array) -> tuple[Array, Array]:
    """Return points and directions of the six axes, both (K, 6, 3) [m], at joint values (K, 6) [rad]."""
    values = robot.chain_values(q)
    T = np.tile(np.eye(4), (len(values), 1, 1))
    origins, axes = np.zeros((2, len(values), 6, 3))
    for j, joint in enumerate(robot.joints):
        T = T @ robot.placements[j]
        origins[:, j] = T[:, :3, 3]
        axes[:, j] = T[:, :3, :3] @ joint.axis
        turn = Rotation.from_rotvec(values[:, j, None] * joint.axis).as_matrix()
        T[:, :3, :3] = T[:, :3, :3] @ turn
    return origins, axes


def _measures(origins: Array, axes: Array) -> tuple[Array, Array]:
    """Return how far the wrist is in front of axis 1 [m], and the area at the elbow [m^2], both (K,) without signs."""
    wrist = _nearest_point(origins[:, 4], axes[:, 4], origins[:, 3], axes[:, 3])
    forward = np.cross(axes[:, 0], axes[:, 1])
    length = np.linalg.norm(forward, axis=1, keepdims=True)
    forward = forward / np.where(length > 0.0, length, 1.0)
    front = np.einsum("ki,ki->k", forward, wrist - origins[:, 0])
    arms = np.cross(origins[:, 2] - origins[:, 1], wrist - origins[:, 2])
    return front, np.einsum("ki,ki->k", axes[:, 1], arms)


def _nearest_point(p: Array, a: Array, q: Array, b: Array) -> Array:
    """Return the points of lines p + s a that are nearest to lines q + t b, (K, 3) each; p where they are parallel."""
    normal = np.cross(a, b)
    square = np.einsum("ki,ki->k", normal, normal)
    s = np.einsum("ki,ki->k", np.cross(q - p, b), normal)
    s = np.where(square > 1e-9, s / np.where(square > 1e-9, square, 1.0), 0.0)
    return np.asarray(p + s[:, None] * a)
