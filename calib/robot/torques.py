"""What gravity makes of a robot's joints: the load on each, from the masses in the URDF and a payload.

    load_i(q) = - dU(q) / dq_i

with the potential energy U of all links and the payload. A joint of compliance c [rad/Nm or m/N] gives way by c load_i.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from calib.errors import ModelError
from calib.robot.chain import full_configurations, full_model, link_frame
from calib.robot.robot import Robot, read_only

Array = NDArray[np.float64]

GRAVITY = (0.0, 0.0, -9.81)
"""The acceleration of gravity where the URDF's root link has z up, [m/s^2]."""


@dataclass(frozen=True, slots=True, eq=False)
class Payload:
    """A mass that the tip carries and that the URDF does not hold."""

    mass: float  #: [kg].
    #: shape (3,), its centre of mass in the tip [m].
    com: Array = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        """Copy the centre of mass and check the numbers."""
        object.__setattr__(self, "com", _three(self.com, "centre of mass of a payload", "[m]"))
        if not (np.isfinite(self.mass) and self.mass >= 0):
            raise ModelError(
                f"The mass of a payload is {self.mass} kg; give a number of kg, 0 or more."
            )


def gravity_load(
    robot: Robot, q: ArrayLike, payload: Payload | None = None, gravity: ArrayLike = GRAVITY
) -> Array:
    """The generalised force that gravity exerts on each joint of the chain, shape (N, n), [Nm] or [N].

    Positive where gravity drives the joint towards larger values. All links of the URDF count, those beside the chain
    too, with their joints where `Robot.urdf_values` says; a link without a mass is massless.

    Args:
        robot: The robot.
        q: shape (N, m) or (m,), [rad] or [m], in the order of ``robot.joint_names``.
        payload: What the tip carries besides.
        gravity: shape (3,), acceleration in the URDF's root link [m/s^2], which stands still.
    """
    values = robot.urdf_values(q)
    model = full_model(robot.urdf)
    model.gravity.linear = np.array(_three(gravity, "acceleration of gravity", "[m/s^2]"))
    model.gravity.angular = np.zeros(3)
    if payload is not None:
        tip = model.frames[link_frame(model, robot.tip)]
        mass = pin.Inertia(float(payload.mass), np.array(payload.com), np.zeros((3, 3)))
        model.appendBodyToJoint(tip.parentJoint, mass, tip.placement)
    data = model.createData()
    columns = [model.idx_vs[model.getJointId(joint.name)] for joint in robot.joints]
    configurations = full_configurations(model, values)
    load = np.empty((len(configurations), len(columns)))
    for row, configuration in zip(load, configurations, strict=True):
        row[:] = -pin.computeGeneralizedGravity(model, data, configuration)[columns]
    return load


def _three(values: ArrayLike, what: str, unit: str) -> Array:
    """Three finite numbers, read-only; refused otherwise."""
    array = read_only(values)
    if array.shape != (3,) or not np.isfinite(array).all():
        raise ModelError(f"The {what} is {values!r}; give three finite numbers {unit}.")
    return array
