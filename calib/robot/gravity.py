"""Loads of gravity on the joints of a chain, and lever arms of masses about them.

Gravity loads each joint by

    load_i(q) = - dU(q) / dq_i

with the potential energy U of all links and the payload: positive where gravity drives the joint towards larger values.
A joint of compliance c [rad/Nm or m/N] gives way by c load_i.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from calib.basics.arrays import Array, Mask
from calib.robot import kernel
from calib.robot.full_model import full_configurations, full_model, joint_frames, link_frame
from calib.robot.payload import Payload, finite_vector
from calib.robot.robot import Robot

GRAVITY = (0.0, 0.0, -9.81)
"""The acceleration of gravity where the URDF's root link has z up, [m/s^2]."""

#: The least acceleration that is divided by [m/s^2]; without gravity all lever arms are then zero.
_TINY = float(np.finfo(np.float64).tiny)


def gravity_loads(
    robot: Robot,
    q: ArrayLike,
    payload: Payload | None = None,
    gravity: ArrayLike = GRAVITY,
) -> Array:
    """Return the load of gravity on each joint of the chain, and the lever arms of masses along the chain about it.

    The masses are those of all links of the URDF, also beside the chain, where their joints are as
    `Robot.urdf_values` says; a link without a mass is massless. A lever arm is the load of a mass over its weight.

    Args:
        robot: The robot, n joints in its chain.
        q: Shape (N, m) or (m,), [rad] or [m], in the order of ``robot.joint_names``.
        payload: Mass at the tip besides those of the URDF; None for none.
        gravity: Shape (3,), acceleration in the URDF's root link [m/s^2], which stands still.

    Returns:
        Shape (N, n, n + 3). Of each joint first its load, [Nm] or [N] where it slides; then the lever arms, [m] or 1
        where it slides, of masses at the origins of the n joints, at the tip, and at a base that joints move. All
        are positive where gravity drives the joint towards larger values.

    Raises:
        ModelError: The values do not fit the chain, or gravity is not three finite numbers.
    """
    values = robot.urdf_values(q)
    acceleration = finite_vector(gravity, "acceleration of gravity", "[m/s^2]")
    down = acceleration / max(float(np.linalg.norm(acceleration)), _TINY)
    model = _loaded_model(robot, payload, acceleration)
    data = model.createData()
    columns = [model.idx_vs[number] for number in _joint_numbers(robot, model)]

    def work(block: slice) -> Array:
        """Return the loads and lever arms of a block of samples, (B, n, n + 3)."""
        block_values = {name: value[block] for name, value in values.items()}
        holding = [
            pin.computeGeneralizedGravity(model, data, configuration)
            for configuration in full_configurations(model, block_values)
        ]
        # Pinocchio's torques and forces hold the robot against gravity: the loads are opposite.
        loads = -np.array(holding).reshape(-1, model.nv)[:, columns, None]
        arms = _lever_arms(robot, model, block_values, down)
        return np.concatenate([loads, arms], axis=2)

    first_joint = next(iter(values.values()))
    return np.concatenate(kernel.over_blocks(work, len(first_joint)))


def _loaded_model(robot: Robot, payload: Payload | None, gravity: Array) -> pin.Model:
    """Return the model of the whole URDF with a payload at the tip, in a field of gravity.

    Args:
        robot: The robot, its URDF and tip.
        payload: Mass [kg] and its centre in the tip [m]; None for none.
        gravity: Shape (3,), acceleration in the URDF's root link [m/s^2].
    """
    model = full_model(robot.urdf)
    model.gravity.linear = np.array(gravity)
    model.gravity.angular = np.zeros(3)
    if payload is not None:
        tip = model.frames[link_frame(model, robot.tip)]
        mass = pin.Inertia(float(payload.mass), np.array(payload.com), np.zeros((3, 3)))
        model.appendBodyToJoint(tip.parentJoint, mass, tip.placement)
    return model


def _lever_arms(robot: Robot, model: pin.Model, values: Mapping[str, Array], down: Array) -> Array:
    """Return the lever arms of `gravity_loads`: how much deeper a unit of each joint moves each point.

    A turning joint at o with the axis a moves a point p by a x (p - o), which is (p - o) . (down x a) deeper; a sliding
    one by a, which is a . down deeper.

    Args:
        robot: The robot.
        model: The model of its whole URDF.
        values: Joint values of N samples as of `Robot.urdf_values`.
        down: Shape (3,), unit vector of gravity in the URDF's root, or zeros.

    Returns:
        Shape (N, n, n + 2), [m] per rad or m: at the origins of the n joints, the tip and the base.
    """
    numbers = _joint_numbers(robot, model)
    ends = _end_frames(robot, model)
    carriers = [*numbers, *(end.parentJoint for end in ends)]
    frames = joint_frames(model, robot.urdf, values, carriers)
    T_root_joint = np.stack([frames[number] for number in numbers], axis=1)
    axes = _axes_in_root(robot, T_root_joint)
    origins = T_root_joint[:, :, :3, 3]
    points = np.concatenate([origins, _end_origins(ends, frames)], axis=1)
    depths = _depths_per_unit(robot, axes, origins, points, down)
    return np.asarray(depths * _bearing(model, numbers, carriers))


def _end_frames(robot: Robot, model: pin.Model) -> list[pin.Frame]:
    """Return Pinocchio's frames of the tip and of the base, in this order, in the model of the whole URDF."""
    return [model.frames[link_frame(model, link)] for link in (robot.tip, robot.base)]


def _end_origins(ends: Sequence[pin.Frame], frames: Mapping[int, Array]) -> Array:
    """Return the origins of links in the URDF's root.

    Args:
        ends: Pinocchio's frames of k links: the joint that carries each, and the link's pose in the joint.
        frames: Poses (N, 4, 4) [m] of these joints in the root, by Pinocchio's numbers.

    Returns:
        Shape (N, k, 3), [m].
    """
    origins = []
    for end in ends:
        T_root_link = frames[end.parentJoint] @ end.placement.homogeneous
        origins.append(T_root_link[:, :3, 3])
    return np.stack(origins, axis=1)


def _joint_numbers(robot: Robot, model: pin.Model) -> list[int]:
    """Return Pinocchio's numbers of the chain's n joints in the model of the whole URDF."""
    return [model.getJointId(joint.name) for joint in robot.joints]


def _bearing(model: pin.Model, numbers: list[int], carriers: list[int]) -> Mask:
    """Return True where a joint bears a point: the point comes behind it in the URDF.

    Args:
        model: The model of the whole URDF.
        numbers: Pinocchio's numbers of n joints.
        carriers: Of the joint that carries each of k points.

    Returns:
        Shape (n, k).
    """
    bears = np.zeros((len(numbers), len(carriers)), dtype=np.bool_)
    for point, carrier in enumerate(carriers):
        supports = set(model.supports[carrier])
        bears[:, point] = [number in supports for number in numbers]
    return bears


def _depths_per_unit(
    robot: Robot,
    axes: Array,
    origins: Array,
    points: Array,
    down: Array,
) -> Array:
    """Return how much deeper a unit of each joint would move each point if it carried it.

    Args:
        robot: The robot.
        axes: Shape (N, n, 3), of the joints in the URDF's root.
        origins: Shape (N, n, 3), of the joints in the URDF's root [m].
        points: Shape (N, k, 3), in the URDF's root [m].
        down: Shape (3,), unit vector of gravity in the URDF's root, or zeros.

    Returns:
        Shape (N, n, k), [m] per rad or m.
    """
    slopes = np.cross(down, axes)
    slopes_at_origins = np.sum(slopes * origins, axis=2)
    depths: Array = slopes @ points.swapaxes(1, 2) - slopes_at_origins[:, :, None]
    slides = np.array([joint.type == "prismatic" for joint in robot.joints])
    depths_of_sliding = axes[:, slides] @ down
    depths[:, slides] = depths_of_sliding[:, :, None]
    return depths


def _axes_in_root(robot: Robot, T_root_joint: Array) -> Array:
    """Return the axes of the chain's n joints in the URDF's root, none turned round, shape (N, n, 3).

    Args:
        robot: The robot, whose URDF has the axes in the frames of the joints.
        T_root_joint: Shape (N, n, 4, 4), the frames of the joints [m].
    """
    axes = np.array([robot.urdf.joint(joint.name).axis for joint in robot.joints])
    return np.asarray((T_root_joint[:, :, :3, :3] @ axes[:, :, None])[..., 0])
