"""Placements of a chain whose frames are as near as possible to those of the nominal robot.

A joint's frame may slide along and turn about the joint's axis without changing any pose: that motion G_i commutes
with the joint's own, so that P_i' = P_i G_i, P_(i+1)' = G_i^-1 P_(i+1) are the placements of the same robot. DH rows
leave that choice to the common normals. `anchored_placements` chooses frame i so that the next axis, or the tip, is as
near as possible to its nominal place in link i; what this leaves open is chosen nearest to the nominal pose of frame i
in link i - 1.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from calib.basics.arrays import Array, read_only, rigid_inverse

#: Two axes of a link that are closer to parallel than this do not determine how far along them a frame is [rad].
PARALLEL_RAD = np.radians(30.0)

#: A distance between two axes below this gives no direction [m].
_COINCIDENT = 1e-3


def anchored_placements(placements: Array, nominal: Array, axes: Sequence[Array]) -> Array:
    """Return the placements of the same chain with frames near the nominal ones.

    Args:
        placements: Placements of n joints and the tip, each in the frame before it, shape
            (n + 1, 4, 4) [m].
        nominal: Those of the nominal robot, shape (n + 1, 4, 4) [m].
        axes: Unit axis of each joint in its own frame, shape (3,) each; all joints turn.

    Returns:
        Placements with the same poses of the tip, shape (n + 1, 4, 4) [m], read-only.
    """
    result = np.array(placements, dtype=np.float64)
    for i, axis in enumerate(axes):
        P = result[i]
        G = _to_nominal_pose(P, nominal[i], axis)
        next_placement = rigid_inverse(G) @ result[i + 1]
        if i + 1 == len(axes):
            G = G @ _to_tip(next_placement, nominal[i + 1], axis)
        else:
            G = G @ _to_next_axis(next_placement, nominal[i + 1], axis, axes[i + 1])
        result[i] = P @ G
        result[i + 1] = rigid_inverse(G) @ result[i + 1]
    return read_only(result)


def _to_nominal_pose(P: Array, nominal: Array, axis: Array) -> Array:
    """Return the motion G along and about an axis that makes P G nearest to the nominal pose.

    All poses are shape (4, 4) [m]; the axis is in the frame of P.
    """
    G = _turn(axis, _least_turn(nominal[:3, :3].T @ P[:3, :3], axis))
    shift = P[:3, :3].T @ (nominal[:3, 3] - P[:3, 3])
    G[:3, 3] = axis * (axis @ shift)
    return G


def _to_tip(T: Array, nominal: Array, axis: Array) -> Array:
    """Return the motion of the last frame that brings the tip nearest to its nominal pose.

    ``T`` and ``nominal`` are the tip's poses in that frame, shape (4, 4) [m].
    """
    G = _turn(axis, -_least_turn(T[:3, :3] @ nominal[:3, :3].T, axis))
    G[:3, 3] = axis * (axis @ (T[:3, 3] - nominal[:3, 3]))
    return G


def _to_next_axis(T: Array, nominal: Array, axis: Array, next_axis: Array) -> Array:
    """Return the motion, (4, 4) [m], along and about an axis that brings the next axis nearest to its nominal line.

    ``T`` and ``nominal`` are the next joint's poses in the frame, ``next_axis`` is in the next joint's frame.
    """
    direction = T[:3, :3] @ next_axis
    point = T[:3, 3]
    nominal_direction = nominal[:3, :3] @ next_axis
    nominal_point = nominal[:3, 3]
    if abs(axis @ nominal_direction) <= np.cos(PARALLEL_RAD):
        G = _turn(axis, _angle_about(axis, nominal_direction, direction))
        R_T = G[:3, :3].T
        foot = _foot(axis, R_T @ point, R_T @ direction)
        G[:3, 3] = axis * (foot - _foot(axis, nominal_point, nominal_direction))
        return G
    # The point where the next axis passes at the height of its nominal joint.
    height = (nominal_point - point) @ axis
    passes = point + direction * (height / (direction @ axis))
    nearest = min(_distance(axis, nominal_point), _distance(axis, passes))
    if nearest > _COINCIDENT:
        return _turn(axis, _angle_about(axis, nominal_point, passes))
    return np.eye(4)


def _least_turn(M: Array, axis: Array) -> float:
    """Return the angle [rad] whose rotation R about the axis makes M R nearest to the identity."""
    x, y, z = axis
    sine = x * (M[1, 2] - M[2, 1]) + y * (M[2, 0] - M[0, 2]) + z * (M[0, 1] - M[1, 0])
    cosine = np.trace(M) - axis @ M @ axis
    return float(np.arctan2(sine, cosine))


def _angle_about(axis: Array, start: Array, end: Array) -> float:
    """Return the angle [rad] about an axis from one vector to another."""
    across = start - axis * (axis @ start)
    return float(np.arctan2(np.cross(axis, across) @ end, across @ end))


def _distance(axis: Array, point: Array) -> float:
    """Return the distance [m] of a point from the axis through the origin."""
    return float(np.linalg.norm(point - axis * (axis @ point)))


def _foot(axis: Array, point: Array, direction: Array) -> float:
    """Return the position [m], along the axis through the origin, of the common normal with a line."""
    cosine = axis @ direction
    return float((axis @ point - cosine * (direction @ point)) / (1.0 - cosine**2))


def _turn(axis: Array, angle: float) -> Array:
    """Return a rotation by an angle [rad] about an axis through the origin, shape (4, 4)."""
    return np.asarray(pin.SE3(pin.exp3(axis * angle), np.zeros(3)).homogeneous)
