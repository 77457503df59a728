"""Usual mistakes in joint values, each undone: zeros, the order of columns, coupled readings, units."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np

from calib.basics.arrays import Array
from calib.diagnosis.reasons import Why
from calib.robot.robot import Robot

#: Factors where angles are in one unit and their header says another.
_ANGLES = {("rad", "deg"): np.degrees(1.0), ("deg", "rad"): np.radians(1.0)}

#: Offsets of joint zeros between conventions [deg].
_TURNS_DEG = (90.0, -90.0, 180.0)

#: Factors by which the reading of a joint counts that of the one before it: it is shown against the horizontal.
_COUPLINGS = (1.0, -1.0)


def joint_trials(robot: Robot, q: Array) -> Iterator[tuple[Array, Why, dict[str, Any]]]:
    """Shift zeros of joints, swap their columns, couple their readings, and scale them from another unit.

    Args:
        robot: The robot.
        q: Joint values of the rows, shape (N, m) [rad] or [m].

    Yields:
        The joint values, the code of the mistake, and the values of its reason.
    """
    names, count = robot.joint_names, len(robot.inputs)
    turns = np.array([joint.type != "prismatic" for joint in robot.inputs])
    for i in np.flatnonzero(turns).tolist():
        yield from shifted_zeros(names[i], i, q)
    for i, j in itertools.combinations(range(count), 2):
        order = list(range(count))
        order[i], order[j] = j, i
        yield q[:, order], Why.COLUMNS_SWAPPED, {"first": names[i], "second": names[j]}
    yield q[:, ::-1], Why.COLUMNS_REVERSED, {}
    for i in np.flatnonzero(turns[:-1] & turns[1:]).tolist():
        yield from _coupled_readings(robot, i, q)
    for (unit, header), factor in _ANGLES.items():
        values = {"what": "joints", "unit": unit, "header": header}
        yield np.where(turns, factor, 1.0) * q, Why.WRONG_UNIT, values


def shifted_zeros(name: str, joint: int, q: Array) -> Iterator[tuple[Array, Why, dict[str, Any]]]:
    """Shift the zero of a joint by a quarter turn either way, and by half a turn.

    Args:
        name: The joint's name.
        joint: Its number, from 0.
        q: Joint values of the rows, shape (N, m) [rad] or [m].

    Yields:
        The joint values, the code of the mistake, and the values of its reason.
    """
    for turn in np.radians(_TURNS_DEG):
        offsets = turn * np.eye(q.shape[1])[joint]
        yield q + offsets, Why.JOINT_ZERO, {"add_rad": float(turn), "joint": name}


def _coupled_readings(
    robot: Robot, joint: int, q: Array
) -> Iterator[tuple[Array, Why, dict[str, Any]]]:
    """Add the reading of a joint to that of the next one, or subtract it; leave out a coupling that the cell states.

    Args:
        robot: The robot.
        joint: Number of the first of the two joints, from 0.
        q: Readings of the rows, shape (N, m) [rad] or [m].

    Yields:
        The readings, the code of the mistake, and the values of its reason.
    """
    names = {"joint": robot.joint_names[joint + 1], "reading": robot.joint_names[joint]}
    stated = float(robot.reading_matrix[joint + 1, joint])
    for factor in (*_COUPLINGS, 0.0):
        if factor == stated:
            continue
        values = robot.input_values(q).copy()
        values[:, joint + 1] += (factor - stated) * q[:, joint]
        if factor:
            yield robot.readings(values), Why.READINGS_COUPLED, {**names, "factor": factor}
        else:
            yield robot.readings(values), Why.READINGS_NOT_COUPLED, names
