"""The same kinematics with every joint's frame near its nominal place on the joint's own axis.

A joint's frame may slide along and turn about the joint's axis without any pose changing: that motion G_i commutes
with the joint's own, so that

    P_i' = P_i G_i,   P_(i+1)' = G_i^-1 P_(i+1)

are the placements of the same robot. DH rows leave that choice to the common normals, and those of nearly parallel
axes lie hundreds of metres away. Here frame i is where the next axis, or the tip, lies in link i as near as it can to
where the nominal robot has it; what that leaves open brings the frame nearest to its nominal pose in link i - 1.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib.errors import ModelError, choices
from calib.robot.robot import Robot, read_only, rigid_inverse
from calib.robot.urdf import UrdfJoint

Array = NDArray[np.float64]

#: Where two axes of a link lie closer to parallel than this, they do not say how far along them a frame stands [rad].
PARALLEL_RAD = np.radians(30.0)

#: A distance of two axes below this gives no direction [m].
_COINCIDENT = 1e-3


def anchored_placements(
    placements: Array,
    nominal: Array,
    joints: Sequence[UrdfJoint],
) -> Array:
    """Other placements of the same chain, near the nominal ones, all (n + 1, 4, 4), [m]; see the module's text."""
    result = np.array(placements, dtype=np.float64)
    axes = [(np.asarray(joint.axis), joint.type == "prismatic") for joint in joints]
    for i, (axis, sliding) in enumerate(axes):
        G = _nearest_own(result[i], nominal[i], axis, sliding=sliding)
        behind = rigid_inverse(G) @ result[i + 1]
        if i + 1 == len(axes):
            G = G @ _to_tip(behind, nominal[i + 1], axis, sliding=sliding)
        else:
            G = G @ _to_next_axis(behind, nominal[i + 1], axes[i], axes[i + 1])
        result[i] = result[i] @ G
        result[i + 1] = rigid_inverse(G) @ result[i + 1]
    return read_only(result)


def check_same_joints(robot: Robot, nominal: Robot) -> None:
    """Refuse two robots whose joints differ in name, type or axis."""
    ours, theirs = (
        [f"{joint.name} ({joint.type}, axis {joint.axis + 0.0})" for joint in one.joints]
        for one in (robot, nominal)
    )
    if ours != theirs:
        raise ModelError(
            f"The robot '{robot.name}' has the joints {choices(ours)}, its nominal robot '{nominal.name}' "
            f"{choices(theirs)}. Give the nominal URDF that the robot was corrected from, with the same base and tip."
        )


def _nearest_own(P: Array, nominal: Array, axis: Array, *, sliding: bool) -> Array:
    """The motion along and about the axis that brings a joint's frame nearest to its nominal pose."""
    turn = _turn(axis, _least_turn(nominal[:3, :3].T @ P[:3, :3], axis))
    missing = P[:3, :3].T @ (nominal[:3, 3] - P[:3, 3])
    # A joint that slides moves the same wherever its axis lies.
    turn[:3, 3] = missing if sliding else axis * (axis @ missing)
    return turn


def _to_tip(T: Array, nominal: Array, axis: Array, *, sliding: bool) -> Array:
    """The motion of the last frame that brings the tip, now at T in it, nearest to its nominal pose."""
    G = _turn(axis, -_least_turn(T[:3, :3] @ nominal[:3, :3].T, axis))
    missing = G[:3, :3].T @ T[:3, 3] - nominal[:3, 3]
    G[:3, 3] = G[:3, :3] @ (missing if sliding else axis * (axis @ missing))
    return G


def _to_next_axis(
    T: Array, nominal: Array, own: tuple[Array, bool], following: tuple[Array, bool]
) -> Array:
    """The motion of a frame that brings the next joint's axis, now at T, nearest to where the nominal link has it.

    ``own`` and ``following`` are the joint's and the next one's axis, and whether it slides.
    """
    axis, sliding = own
    direction, point = T[:3, :3] @ following[0], T[:3, 3]
    wanted, wanted_point = nominal[:3, :3] @ following[0], nominal[:3, 3]
    parallel = abs(axis @ wanted) > np.cos(PARALLEL_RAD)
    angle = 0.0
    if not parallel:
        angle = _angle_about(axis, wanted, direction)
    elif not (sliding or following[1]):
        # Where the next axis passes at the height of its nominal joint.
        height = (wanted_point - point) @ axis / (direction @ axis)
        passes = point + direction * height
        if min(_distance(axis, wanted_point), _distance(axis, passes)) > _COINCIDENT:
            angle = _angle_about(axis, wanted_point, passes)
    G = _turn(axis, angle)
    if following[1]:  # that axis lies nowhere
        return G
    back = G[:3, :3].T
    direction, point = back @ direction, back @ point
    if sliding:
        missing = point - wanted_point
        shift = missing - direction * (direction @ missing)
    elif parallel:
        return G
    else:
        shift = axis * (_foot(axis, point, direction) - _foot(axis, wanted_point, wanted))
    G[:3, 3] = G[:3, :3] @ shift
    return G


def _least_turn(M: Array, axis: Array) -> float:
    """The angle about the axis whose rotation R makes M R nearest to no rotation [rad]."""
    x, y, z = axis
    sine = x * (M[1, 2] - M[2, 1]) + y * (M[2, 0] - M[0, 2]) + z * (M[0, 1] - M[1, 0])
    return float(np.arctan2(sine, np.trace(M) - axis @ M @ axis))


def _angle_about(axis: Array, start: Array, end: Array) -> float:
    """The angle from one vector to another about an axis [rad]."""
    across = start - axis * (axis @ start)
    return float(np.arctan2(np.cross(axis, across) @ end, across @ end))


def _distance(axis: Array, point: Array) -> float:
    """How far a point lies from the axis through the origin [m]."""
    return float(np.linalg.norm(point - axis * (axis @ point)))


def _foot(axis: Array, point: Array, direction: Array) -> float:
    """Where, along the axis through the origin, the common normal with a line stands [m]."""
    cosine = axis @ direction
    return float((axis @ point - cosine * (direction @ point)) / (1.0 - cosine**2))


def _turn(axis: Array, angle: float) -> Array:
    """A rotation about an axis, shape (4, 4)."""
    return np.asarray(pin.SE3(pin.exp3(axis * angle), np.zeros(3)).homogeneous)
