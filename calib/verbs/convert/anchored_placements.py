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
        # The motion along and about the axis that makes P G nearest to the nominal pose.
        G = _turn(axis, _least_turn(nominal[i, :3, :3].T @ P[:3, :3], axis))
        shift = P[:3, :3].T @ (nominal[i, :3, 3] - P[:3, 3])
        G[:3, 3] = axis * (axis @ shift)

        # The motion that then brings the next axis, or the tip, nearest to its nominal place in link i.
        next_placement = rigid_inverse(G) @ result[i + 1]
        next_nominal = nominal[i + 1]
        if i + 1 < len(axes):
            G = G @ _to_next_axis(next_placement, next_nominal, axis, axes[i + 1])
        else:
            turn = -_least_turn(next_placement[:3, :3] @ next_nominal[:3, :3].T, axis)
            to_tip = _turn(axis, turn)
            to_tip[:3, 3] = axis * (axis @ (next_placement[:3, 3] - next_nominal[:3, 3]))
            G = G @ to_tip
        result[i] = P @ G
        result[i + 1] = rigid_inverse(G) @ result[i + 1]
    return read_only(result)


def _to_next_axis(T: Array, nominal: Array, axis: Array, next_axis: Array) -> Array:
    """Return the motion, (4, 4) [m], along and about an axis that brings the next axis nearest to its nominal line.

    ``T`` and ``nominal`` are the next joint's poses in the frame of this one, (4, 4) [m]; ``next_axis`` is in the next
    joint's frame. If both axes nearly coincide, the motion is the identity.
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
    """Return the angle [rad] whose rotation R about a unit axis (3,) makes M R nearest to the identity, M (3, 3)."""
    x, y, z = axis
    sine = x * (M[1, 2] - M[2, 1]) + y * (M[2, 0] - M[0, 2]) + z * (M[0, 1] - M[1, 0])
    cosine = np.trace(M) - axis @ M @ axis
    return float(np.arctan2(sine, cosine))


def _angle_about(axis: Array, start: Array, end: Array) -> float:
    """Return the angle [rad] about a unit axis, (3,), from one vector (3,) to another, along the axis left out."""
    across = start - axis * (axis @ start)
    return float(np.arctan2(np.cross(axis, across) @ end, across @ end))


def _distance(axis: Array, point: Array) -> float:
    """Return the distance [m] of a point (3,) from the line through the origin along a unit axis (3,)."""
    return float(np.linalg.norm(point - axis * (axis @ point)))


def _foot(axis: Array, point: Array, direction: Array) -> float:
    """Return the position [m], along the axis through the origin, of its common normal with a line.

    The line runs through a point (3,) [m] along a unit direction (3,) that is not parallel to the unit axis (3,).
    """
    cosine = axis @ direction
    return float((axis @ point - cosine * (direction @ point)) / (1.0 - cosine**2))


def _turn(axis: Array, angle: float) -> Array:
    """Return a rotation by an angle [rad] about an axis through the origin, shape (4, 4)."""
    return np.asarray(pin.SE3(pin.exp3(axis * angle), np.zeros(3)).homogeneous)
