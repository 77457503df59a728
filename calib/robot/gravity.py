"""Loads of gravity on the joints of a chain and its payload, and lever arms of masses about the joints.

Gravity loads each joint by

    load_i(q) = - dU(q) / dq_i

with the potential energy U of all links and the payload: positive if gravity drives the joint towards larger values. A
joint of compliance c [rad/Nm or m/N] gives way by c load_i.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from calib.basics.arrays import Array, read_only
from calib.basics.records import key
from calib.basics.value_forms import POINT_MM, number
from calib.basics.values import Value
from calib.errors import ModelError, choices
from calib.robot import kernel
from calib.robot.full_model import full_configurations, full_model, joint_frames, link_frame
from calib.robot.robot import Robot

GRAVITY = (0.0, 0.0, -9.81)
"""The acceleration of gravity if the URDF's root link has z up, [m/s^2]."""

#: The least acceleration that is divided by [m/s^2]; without gravity all lever arms are then zero.
_TINY = float(np.finfo(np.float64).tiny)


@dataclass(frozen=True, slots=True, eq=False)
class Payload(Value):
    """A point mass that the tip carries and that the URDF does not hold."""

    #: [kg], 0 or more.
    mass: float = key("mass_kg", number("kg"), "Mass at the tip.", json="mass_kg")
    #: shape (3,), its centre of mass in the frame of the tip [m].
    com: Array = key(
        "com_mm",
        POINT_MM,
        "Its centre of mass in the tip.",
        default_factory=lambda: np.zeros(3),
        absent="0, 0, 0",
        json="com_m",
    )

    def __post_init__(self) -> None:
        """Copy the centre of mass and check the numbers; raises `ModelError`."""
        com = finite_vector(self.com, "centre of mass of a payload", "[m]")
        object.__setattr__(self, "com", com)
        if not (np.isfinite(self.mass) and self.mass >= 0):
            raise ModelError(
                f"The mass of a payload is {self.mass} kg; give a number of kg, 0 or more."
            )


def finite_vector(values: ArrayLike, name: str, unit: str) -> Array:
    """Return three finite numbers as a read-only array of shape (3,).

    Args:
        values: The numbers.
        name: Their name in the message, such as ``"acceleration of gravity"``.
        unit: Their unit in the message, such as ``"[m/s^2]"``.

    Raises:
        ModelError: They are not three, or not finite.
    """
    array = read_only(values)
    if array.shape != (3,) or not np.isfinite(array).all():
        raise ModelError(f"The {name} is {values!r}; give three finite numbers {unit}.")
    return array


def gravity_loads(
    robot: Robot,
    q: ArrayLike,
    payload: Payload | None = None,
    gravity: ArrayLike = GRAVITY,
) -> Array:
    """Return the load of gravity on each joint of the chains, and the lever arms of masses along them about it.

    The masses are those of all links of the URDF, also beside the chain, with their joints at `Robot.urdf_values`; a
    link without a mass is massless. A lever arm is the load of a mass over its weight.

    Args:
        robot: The robot, n joints in its chains (`Robot.all_joints`).
        q: Shape (N, m) or (m,), [rad] or [m], in the order of ``robot.joint_names``.
        payload: Mass at the tip besides those of the URDF; None for none.
        gravity: Shape (3,), acceleration in the URDF's root link [m/s^2], which stands still.

    Returns:
        Shape (N, n, n + 3). For each joint first its load, [Nm], or [N] if it slides; then the lever arms, [m], or 1 if
        it slides, of masses at the origins of the n joints, at the tip, and at a base that joints move, and then at
        each further link of `Robot.ends`. All are positive if gravity drives the joint towards larger values.

    Raises:
        ModelError: The values do not fit the chain, or gravity is not three finite numbers.
    """
    values = robot.urdf_values(q)
    acceleration = finite_vector(gravity, "acceleration of gravity", "[m/s^2]")
    down = acceleration / max(float(np.linalg.norm(acceleration)), _TINY)

    model = full_model(robot.urdf)
    model.gravity.linear = np.array(acceleration)
    model.gravity.angular = np.zeros(3)
    if payload is not None:
        tip = model.frames[link_frame(model, robot.tip)]
        mass = pin.Inertia(float(payload.mass), np.array(payload.com), np.zeros((3, 3)))
        model.appendBodyToJoint(tip.parentJoint, mass, tip.placement)
    data = model.createData()
    columns = [model.idx_vs[model.getJointId(joint.name)] for joint in robot.all_joints]

    count = len(next(iter(values.values())))
    of_one = _lever_arms(robot, model, {name: value[:1] for name, value in values.items()}, down)
    result = np.empty((count, len(columns), 1 + of_one.shape[2]))

    def work(block: slice) -> None:
        """Fill in what `gravity_loads` returns, for a block of B samples: (B, n, n + 3)."""
        block_values = {name: value[block] for name, value in values.items()}
        holding = [
            pin.computeGeneralizedGravity(model, data, configuration)
            for configuration in full_configurations(model, block_values)
        ]
        # Pinocchio's torques and forces hold the robot against gravity: the loads are opposite.
        loads = -np.array(holding).reshape(-1, model.nv)[:, columns, None]
        arms = _lever_arms(robot, model, block_values, down)
        result[block, :, :1] = loads
        result[block, :, 1:] = arms

    kernel.over_blocks(work, len(result))
    return result


def check_masses(robot: Robot, model: str) -> None:
    """Refuse a named model of errors by load for a robot from an MJCF whose masses only its geoms tell.

    Args:
        robot: The robot.
        model: The model's name, for the message.

    Raises:
        ModelError: The masses are not known.
    """
    mjcf = robot.urdf.mjcf
    if mjcf is not None and mjcf.mass_of_geoms:
        raise ModelError(
            f"The model '{model}' needs the robot's masses. In {robot.urdf.source} those of "
            f"{choices(mjcf.mass_of_geoms)} follow from geoms, which calib does not compute: give these bodies an "
            "<inertial>, as MuJoCo writes them into a saved model; or take 'gravity' in place of 'compliance', which "
            "needs no masses; or give torques in the table."
        )


def _lever_arms(robot: Robot, model: pin.Model, values: Mapping[str, Array], down: Array) -> Array:
    """Return how much deeper a unit of each joint moves each point, shape (N, n, points), [m] per rad or m.

    A turning joint at o with the axis a moves a point p by a x (p - o), which is (p - o) . (down x a) deeper; a sliding
    one by a, which is a . down deeper. The points are the origins of the n joints and the ends of chains; ``values``
    are those of N samples as of `Robot.urdf_values`, and ``down`` is a unit vector in the URDF's root, or zeros.
    """
    chain = robot.all_joints
    joints = [model.getJointId(joint.name) for joint in chain]
    ends = [model.frames[link_frame(model, link)] for link in robot.ends]
    carriers = [*joints, *(end.parentJoint for end in ends)]
    frames = joint_frames(model, robot.urdf, values, carriers)

    T_root_joint = np.stack([frames[number] for number in joints], axis=1)
    # As the URDF has them: those of the chain may be turned round.
    axes_in_joints = np.array([robot.urdf.joint(joint.name).axis for joint in chain])
    axes = np.asarray((T_root_joint[:, :, :3, :3] @ axes_in_joints[:, :, None])[..., 0])
    origins = T_root_joint[:, :, :3, 3]
    end_origins = []
    for end in ends:
        T_root_link = frames[end.parentJoint] @ end.placement.homogeneous
        end_origins.append(T_root_link[:, :3, 3])
    points = np.concatenate([origins, np.stack(end_origins, axis=1)], axis=1)

    slopes = np.cross(down, axes)
    slopes_at_origins = np.sum(slopes * origins, axis=2)
    depths: Array = slopes @ points.swapaxes(1, 2) - slopes_at_origins[:, :, None]
    slides = np.array([joint.type == "prismatic" for joint in chain])
    depths_of_sliding = axes[:, slides] @ down
    depths[:, slides] = depths_of_sliding[:, :, None]

    # A joint moves only the points that it carries.
    carries = np.zeros((len(joints), len(carriers)), dtype=np.bool_)
    for point, carrier in enumerate(carriers):
        supports = set(model.supports[carrier])
        carries[:, point] = [number in supports for number in joints]
    return np.asarray(depths * carries)
