"""Assumptions of plans and inspections without measurements: a table of poses, a generic target and anchor."""

from __future__ import annotations

import numpy as np

import calib.data.kinds as registry
from calib.basics.arrays import Array
from calib.data.measurements import Measurements
from calib.errors import ModelError
from calib.robot.robot import Robot

#: Place in the tip of a target that was not given: off every axis of the tip [m].
GENERIC_TARGET = (0.05, 0.07, 0.03)


#: Place in the base of an anchor that was not given: off the first axis, which its distances would not observe [m].
GENERIC_ANCHOR = (0.7, -0.5, 0.3)


def table_of_poses(robot: Robot, name: str, joints: Array) -> Measurements:
    """Make a table of poses, whose measured values do not matter.

    Args:
        robot: The nominal robot.
        name: Kind of the rows, such as ``"point"``.
        joints: Joint values, shape (N, m), [rad] or [m].

    Returns:
        A table of N rows of this kind.

    Raises:
        ModelError: A kind of pairs, or one that needs the target at a certain place, such as a socket.
    """
    kind = registry.get(name)
    if kind.paired or kind.measure is None:
        raise ModelError(f"Poses alone say nothing of kind '{name}'. Give a table of such rows.")
    T_frame_target = np.tile(np.eye(4), (len(joints), 1, 1))
    T_frame_target[:, :3, 3] = 1.0
    sliding = tuple(joint.name for joint in robot.inputs if joint.type == "prismatic")
    return Measurements(
        joint_names=robot.joint_names,
        joints=joints,
        kinds=(name,) * len(joints),
        **Measurements.columns_of(kind, kind.measure(T_frame_target)),
        prismatic=sliding,
    )
