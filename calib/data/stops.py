"""Joints at their stops: what a row of the kind ``stop`` says, and the chain that it is seen through.

A stop is a place where a joint cannot turn further. If its true angle is stated, from a drawing or measured once, a row
with the joint's reading there measures the joint's zero, without any instrument. The chain of such a row is the joint
alone, from the link before it to the one after it; frame and target are known, and turned so that z is the joint's
axis:

    T_frame_target = A^-1 O^-1  O' Rot(axis, q + dq)  A,        A z = axis

with the nominal <origin> O, the corrected one O', and the joint's own errors dq. What is measured is the angle about z.
"""

from __future__ import annotations

import numpy as np

from calib.basics.arrays import Array, rigid_inverse
from calib.errors import UrdfError, choices
from calib.robot import kernel
from calib.robot.urdf import Urdf

#: Types of joints that have stops which are angles.
_TURNING = ("revolute", "continuous")

_TURN = 2.0 * np.pi


def stop_angle(T_frame_target: Array) -> Array:
    """Return the angle of a target about z of its frame, shape (n, 1) [rad], of poses (n, 4, 4) [m]."""
    return np.arctan2(T_frame_target[:, 1, 0], T_frame_target[:, 0, 0])[:, None]


def stop_residual(measured: Array, T_frame_target: Array) -> Array:
    """Return stated minus predicted angle at the stop, by whole turns nearest to zero, shape (n, 1) [rad]."""
    difference = measured - stop_angle(T_frame_target)
    return np.asarray(difference - _TURN * np.round(difference / _TURN))


def stop_derivative(measured: Array, T_frame_target: Array, twists: Array) -> Array:  # noqa: ARG001
    """Differentiate `stop_angle` by p parameters: from twists (n, 6, p) to shape (n, 1, p), [rad] per unit."""
    R = T_frame_target[:, :3, 0]
    x, y, z = (R[:, k, None] for k in range(3))
    turns = twists[:, 3:]
    # The first column of R turns by omega x R.
    dx = turns[:, 1] * z - turns[:, 2] * y
    dy = turns[:, 2] * x - turns[:, 0] * z
    return np.asarray(((x * dy - y * dx) / (x**2 + y**2))[:, None])


def is_stop(urdf: Urdf, group: str, target: str) -> bool:
    """Return True if a station and a target are those of a joint at its stop: both have the joint's name."""
    return group == target and any(joint.name == target for joint in urdf.joints)


def stop_links(urdf: Urdf, name: str) -> tuple[str, str]:
    """Return the links before and after a joint at its stop.

    Args:
        urdf: The robot.
        name: The joint's name.

    Raises:
        UrdfError: There is no such joint, or it does not turn.
    """
    joint = urdf.joint(name)
    if joint.type not in _TURNING:
        turning = [joint.name for joint in urdf.joints if joint.type in _TURNING]
        raise UrdfError(
            f"A row of the kind 'stop' names the joint '{name}', which is {joint.type}; joints that turn have stops "
            f"that are angles: {choices(turning)}."
        )
    return joint.parent, joint.child


def stop_poses(urdf: Urdf, name: str) -> tuple[Array, Array]:
    """Return T_frame_base and T_tip_target of a joint at its stop, each of shape (4, 4) [m].

    Args:
        urdf: The nominal robot.
        name: The joint's name.
    """
    joint = urdf.joint(name)
    A = np.eye(4)
    A[:3, :3] = kernel.turns_to(np.array([joint.axis]))[0]
    return rigid_inverse(joint.T_parent_joint @ A), A
