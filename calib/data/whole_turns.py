"""Readings that are whole turns outside of a joint's limits: 300 deg of a joint that turns by 143 deg to both sides.

Some interfaces give angles from 0 to 360 deg whatever the joint's range. The pose is the same, but not the place on the
gear, whose errors grow with the angle.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.basics.arrays import read_only
from calib.data.measurements import Measurements
from calib.robot.ranges import column_limits
from calib.robot.robot import Robot

#: One turn [rad].
_TURN = 2.0 * np.pi

#: Readings may exceed a limit, and a column one turn, by this [rad]: digits that were not written.
_ROUNDING = 1e-3


def brought_back(robot: Robot, table: Measurements) -> Measurements:
    """Return a table whose readings are brought back by whole turns into the limits of their joints.

        q' = q - 2 pi k,    lower <= q' <= upper

    A column is changed only if it may be angles modulo a turn: its readings span one turn at most, and there is one
    such k for each of them, as the limits leave less than a turn. Readings that count others (coupled ones) stay.

    Args:
        robot: The robot, which knows the limits [rad].
        table: Its measurements; columns of other joints stay.

    Returns:
        The table; ``turned`` has the names of the joints whose readings were changed, after those it had.
    """
    q = table.joints.copy()
    turned = []
    limits = dict(zip(robot.joint_names, column_limits(robot), strict=True))
    for column, name in enumerate(table.joint_names):
        if name not in limits or name in table.prismatic or robot.reading_coupling:
            continue
        low, high = limits[name] + np.array([-_ROUNDING, _ROUNDING])
        readings = q[:, column]
        inside = readings - _TURN * np.ceil((readings - high) / _TURN)
        one_turn = high - low < _TURN and np.ptp(readings) <= _TURN + _ROUNDING
        if not one_turn or np.any(inside < low) or np.array_equal(inside, readings):
            continue
        q[:, column] = inside
        turned.append(name)
    if not turned:
        return table
    return replace(table, joints=read_only(q), turned=(*table.turned, *turned))
