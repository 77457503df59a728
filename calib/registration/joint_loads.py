"""Loads on the joints."""

from __future__ import annotations

import numpy as np

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.robot.gravity import gravity_loads
from calib.robot.robot import Robot
from calib.units import Array


def joint_loads(robot: Robot, m: Measurements, cell: Cell, q: Array) -> Array:
    """What loads each joint: gravity and payload, or what was measured where there are torques.

    Args:
        robot: The robot.
        m: The measurements, N of them.
        cell: Payload and gravity.
        q: shape (N, m), their joint values in the robot's order.

    Returns:
        shape (N, n, n + 3), see `calib.robot.gravity.gravity_loads`.
    """
    load = gravity_loads(robot, q, cell.payload, cell.gravity)
    torques = np.empty((0, 0)) if m.torques is None else m.torques.T
    for name, measured in zip(m.joint_names, torques, strict=False):
        for k, joint in enumerate(robot.joints):
            if joint.name == name:  # the load is what the drive holds against
                load[:, k, 0] = np.where(np.isfinite(measured), -measured, load[:, k, 0])
    return load
