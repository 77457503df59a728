"""Loads of gravity on the joints of a chain, and lever arms of masses about them.

Gravity loads each joint by load_i(q) = - dU(q) / dq_i, with the potential energy U of all links and the payload. A
joint of compliance c [rad/Nm or m/N] gives way by c load_i.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from calib.robot import kernel
from calib.robot.full_model import full_configurations, full_model, joint_frames, link_frame
from calib.robot.payload import Payload, finite_vector
from calib.robot.robot import Robot
from calib.units import Array

GRAVITY = (0.0, 0.0, -9.81)
"""The acceleration of gravity where the URDF's root link has z up, [m/s^2]."""


#: The least length that is divided by.
_TINY = float(np.finfo(np.float64).tiny)


def gravity_loads(
    robot: Robot, q: ArrayLike, payload: Payload | None = None, gravity: ArrayLike = GRAVITY
) -> Array:
    """What gravity can load each of the chain's n joints with, shape (N, n, n + 3).

    First the load itself [Nm] or [N], by the masses of all links of the URDF, also beside the chain, where their joints
    are as `Robot.urdf_values` says; a link without a mass is massless. Then the lever arms [m] of a mass at the origin
    of each joint of the chain, at the tip, and at a base that joints move: its load over its weight. All are positive
    where gravity drives the joint towards larger values.

    Args:
        robot: The robot.
        q: shape (N, m) or (m,), [rad] or [m], in the order of ``robot.joint_names``.
        payload: What the tip carries besides.
        gravity: shape (3,), acceleration in the URDF's root link [m/s^2], which stands still.
    """
    values = robot.urdf_values(q)
    down = finite_vector(gravity, "acceleration of gravity", "[m/s^2]")
    model = _loaded_model(robot, payload, down)
    data = model.createData()
    columns = [model.idx_vs[model.getJointId(joint.name)] for joint in robot.joints]
    towards = down / max(float(np.linalg.norm(down)), _TINY)

    def work(block: slice) -> Array:
        """The loads of a block of samples."""
        joints = {name: value[block] for name, value in values.items()}
        torques = [
            pin.computeGeneralizedGravity(model, data, configuration)
            for configuration in full_configurations(model, joints)
        ]
        drives = -np.array(torques).reshape(-1, model.nv)[:, columns, None]
        return np.concatenate([drives, _lever_arms(robot, model, joints, towards)], axis=2)

    return np.concatenate(kernel.over_blocks(work, len(next(iter(values.values())))))


def _loaded_model(robot: Robot, payload: Payload | None, gravity: Array) -> pin.Model:
    """The model of the whole URDF with a payload at the tip, in this gravity, (3,) [m/s^2]."""
    model = full_model(robot.urdf)
    model.gravity.linear = np.array(gravity)
    model.gravity.angular = np.zeros(3)
    if payload is not None:
        tip = model.frames[link_frame(model, robot.tip)]
        mass = pin.Inertia(float(payload.mass), np.array(payload.com), np.zeros((3, 3)))
        model.appendBodyToJoint(tip.parentJoint, mass, tip.placement)
    return model


def _lever_arms(robot: Robot, model: pin.Model, values: Mapping[str, Array], down: Array) -> Array:
    """The lever arms of `gravity_loads`: how much deeper a unit of each joint moves each point.

    A turning joint at o with the axis a moves a point p by a x (p - o), which is (p - o) . (down x a) deeper; a sliding
    one by a, which is a . down deeper.

    Args:
        robot: The robot.
        model: The model of its whole URDF.
        values: What `Robot.urdf_values` says of N samples.
        down: shape (3,), the direction of gravity in the URDF's root.

    Returns:
        shape (N, n, n + 2), [m] per rad or m: at the origins of the n joints, the tip and the base.
    """
    numbers = [model.getJointId(joint.name) for joint in robot.joints]
    ends = [model.frames[link_frame(model, link)] for link in (robot.tip, robot.base)]
    carriers = [*numbers, *(end.parentJoint for end in ends)]
    frames = joint_frames(model, robot.urdf, values, carriers)
    T = np.stack([frames[number] for number in numbers], axis=1)
    axes, origins = (T[:, :, :3, :3] @ _urdf_axes(robot)[:, :, None])[..., 0], T[:, :, :3, 3]
    T_ends = [frames[end.parentJoint] @ end.placement.homogeneous for end in ends]
    points = np.concatenate([origins, *(T[:, None, :3, 3] for T in T_ends)], axis=1)
    slopes = np.cross(down, axes)
    arms = slopes @ points.swapaxes(1, 2) - np.sum(slopes * origins, axis=2)[:, :, None]
    slides = np.array([joint.type == "prismatic" for joint in robot.joints])
    arms[:, slides] = (axes[:, slides] @ down)[:, :, None]
    # A joint bears what comes behind it in the URDF.
    bears = [[number in model.supports[carrier] for carrier in carriers] for number in numbers]
    return np.asarray(arms * np.array(bears))


def _urdf_axes(robot: Robot) -> Array:
    """The axes of the chain's joints as the URDF has them, none turned round, shape (n, 3)."""
    return np.array([robot.urdf.joint(joint.name).axis for joint in robot.joints])
