"""Inverse kinematics of a nominal robot, as plans of images need it: near is enough."""

from __future__ import annotations

import numpy as np

from calib.basics.arrays import Array
from calib.robot.robot import Robot
from calib.verbs.compensate.inverse import POSE, Matching, solve
from calib.verbs.compensate.nominal_actual import Arm

#: Length that one radian weighs as [m].
_RADIAN = 0.3

#: Steps at most.
_STEPS = 8


def reach(robot: Robot, ranges: Array, T_base_tip: Array, start: Array) -> Array:
    """Bring the tip of a robot as near to poses as a few steps lead.

    Args:
        robot: The robot.
        ranges: Lowest and highest value of each joint, shape (m, 2), [rad] or for sliding joints [m].
        T_base_tip: Wanted poses, shape (N, 4, 4), [m].
        start: Readings of the joints to start at, shape (N, m), [rad] or [m].

    Returns:
        Readings, shape (N, m), [rad] or [m]; those of an arm without redundant joints may be beyond their ranges.
    """
    arm = Arm.of(robot, np.eye(4))
    return solve(arm, T_base_tip, start, Matching(POSE, _RADIAN), ranges, steps=_STEPS).q
