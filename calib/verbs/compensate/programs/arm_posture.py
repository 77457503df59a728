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

from calib.basics.arrays import Array, Mask
from calib.basics.values import Value
from calib.robot.robot import Robot

#: Less than this at zero has no sign: front or back as a distance [m], the elbow as an area [m^2].
_NO_SIGN = 1e-3

#: So close to where the sign changes both postures are possible [m], [m^2].
_CLOSE = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class ArmPosture(Value):
    """An arm whose postures follow from its joint values."""

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
        if np.linalg.norm(_cross(axes[0, 1], axes[0, 2])) > 1e-6:
            return None
        front, elbow = (float(value[0]) for value in _measures(origins, axes))
        return cls(
            robot,
            (
                front if abs(front) > _NO_SIGN else 0.0,
                elbow if abs(elbow) > _NO_SIGN else 0.0,
            ),
        )

    def agrees(self, q: Array, *, front: bool | None = None, up: bool | None = None) -> Mask:
        """Return which joint values are of a posture.

        Args:
            q: Joint values, shape (K, 6) [rad].
            front: Whether the wrist is in front of axis 1, or behind it; None: anywhere.
            up: Whether the elbow is up, or down; None: anywhere.

        Returns:
            Shape (K,); True for both sides of what has no sign at zero.
        """
        mask = np.ones(len(q), dtype=bool)
        for measure, at_zero, side in zip(self.signed(q), self.at_zero, (front, up), strict=True):
            if side is not None:
                value = measure * np.sign(at_zero)
                mask &= value > -_CLOSE if side else value < _CLOSE
        return mask

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
    R = np.tile(np.eye(3), (len(values), 1, 1))
    point = np.zeros((len(values), 3))
    origins, axes = np.zeros((2, len(values), 6, 3))
    for j, joint in enumerate(robot.joints):
        placement = robot.placements[j]
        point = point + R @ placement[:3, 3]
        R = R @ placement[:3, :3]
        origins[:, j] = point
        axes[:, j] = R @ joint.axis
        # Rodrigues: exp(t K) = 1 + sin(t) K + (1 - cos(t)) K^2
        K = _cross(np.asarray(joint.axis), np.eye(3)).T
        angle = values[:, j, None, None]
        R = R @ (np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * (K @ K))
    return origins, axes


def _cross(a: Array, b: Array) -> Array:
    """Return the cross products of vectors along the last axis; several times as fast as NumPy's for few."""
    x, y, z = a[..., 0], a[..., 1], a[..., 2]
    u, v, w = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=-1)


def _measures(origins: Array, axes: Array) -> tuple[Array, Array]:
    """Return how far the wrist is in front of axis 1 [m], and the area at the elbow [m^2], both (K,) without signs."""
    wrist = _nearest_point(origins[:, 4], axes[:, 4], origins[:, 3], axes[:, 3])
    forward = _cross(axes[:, 0], axes[:, 1])
    length = np.linalg.norm(forward, axis=1, keepdims=True)
    forward = forward / np.where(length > 0.0, length, 1.0)
    front = np.einsum("ki,ki->k", forward, wrist - origins[:, 0])
    arms = _cross(origins[:, 2] - origins[:, 1], wrist - origins[:, 2])
    return front, np.einsum("ki,ki->k", axes[:, 1], arms)


def _nearest_point(p: Array, a: Array, q: Array, b: Array) -> Array:
    """Return the points of lines p + s a that are nearest to lines q + t b, (K, 3) each; p where they are parallel."""
    normal = _cross(a, b)
    square = np.einsum("ki,ki->k", normal, normal)
    s = np.einsum("ki,ki->k", _cross(q - p, b), normal)
    s = np.where(square > 1e-9, s / np.where(square > 1e-9, square, 1.0), 0.0)
    return np.asarray(p + s[:, None] * a)
