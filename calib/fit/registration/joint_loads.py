"""Loads on the joints, which bend them: of gravity and payload, or as the drives measured them."""

from __future__ import annotations

import numpy as np

from calib.basics.arrays import Array
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.robot.gravity import gravity_loads
from calib.robot.robot import Robot


def joint_loads(robot: Robot, measurements: Measurements, cell: Cell, q: Array) -> Array:
    """Return the load on each joint: measured torques where there are, else gravity and payload.

    Args:
        robot: The nominal robot, with n joints.
        measurements: Table of N rows; its torques [Nm] are those of the drives, which hold against the load.
        cell: Payload and gravity.
        q: shape (N, m), joint values of the rows in the robot's order [rad] or [m].

    Returns:
        shape (N, n, n + 3), [Nm] or [N]; see `calib.robot.gravity.gravity_loads`.
    """
    load = gravity_loads(robot, q, cell.payload, cell.gravity)
    if measurements.torques is None:
        return load
    for name, torque in zip(measurements.joint_names, measurements.torques.T, strict=False):
        for k, joint in enumerate(robot.joints):
            if joint.name == name:
                load[:, k, 0] = np.where(np.isfinite(torque), -torque, load[:, k, 0])
    return load
