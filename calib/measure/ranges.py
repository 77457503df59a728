"""Between which values joints are moved: limits, what is given, or what a table shows."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.errors import CalibError, choices
from calib.model.readback import column_ranges
from calib.model.robot import Robot, read_only
from calib.units import unit_fault

Array = NDArray[np.float64]

#: A range may pass a limit by this, for rounding: 360 deg is not quite 6.28318 rad [rad or m].
_ROUNDING = 1e-4


def ranges_of(joints: ArrayLike, margin: float | Array = 0.0, limits: Array | None = None) -> Array:
    """The ranges that measured joint values span.

    Args:
        joints: shape (N, m), [rad] or [m].
        margin: What is added at both ends [rad or m]; one number, or one for each joint.
        limits: shape (m, 2): the margin ends there; a value that was measured beyond stays in.

    Returns:
        shape (m, 2), lowest and highest value of each joint, read-only.

    Raises:
        CalibError: No rows, or a margin below zero.
    """
    values = np.atleast_2d(np.asarray(joints, dtype=np.float64))
    if not values.size:
        raise CalibError("No rows were given to take the ranges of joints from; give one at least.")
    if not np.all(np.asarray(margin) >= 0.0):
        raise CalibError(f"The margin is {margin}; it must not be below zero.")
    least, most = values.min(axis=0), values.max(axis=0)
    low, high = least - margin, most + margin
    if limits is not None:
        low = np.minimum(least, np.maximum(low, limits[:, 0]))
        high = np.maximum(most, np.minimum(high, limits[:, 1]))
    return read_only(np.stack([low, high], axis=1))


@lru_cache(maxsize=16)
def column_limits(robot: Robot) -> Array:
    """The limits of each column of q, shape (m, 2), [rad] or [m]; infinite where there are none.

    Joints of the chain that mimic a column's joint must stay inside their limits too.
    """
    limits = np.array([_limits(joint.lower, joint.upper) for joint in robot.inputs])
    offset = robot.chain_values(np.zeros(len(limits)))[0]
    for row, joint, at_zero in zip(robot.coupling, robot.joints, offset, strict=True):
        for column in np.flatnonzero(row):
            ends = (np.array(_limits(joint.lower, joint.upper)) - at_zero) / row[column]
            low, high = max(limits[column, 0], ends.min()), min(limits[column, 1], ends.max())
            if low < high:
                limits[column] = low, high
    return read_only(limits)


@lru_cache(maxsize=16)
def full_ranges(robot: Robot) -> Array:
    """Values that take each joint everywhere it can go, shape (m, 2), [rad] or [m].

    The limits; of a joint that may turn further one whole turn inside of them, the one nearest to zero; 1 m to both
    sides of zero where a sliding joint has no limits.
    """
    ranges = np.array(column_ranges(robot))
    turn = 2.0 * np.pi
    for column, (joint, (low, high)) in enumerate(
        zip(robot.inputs, column_limits(robot), strict=True)
    ):
        if np.isfinite([low, high]).all() and (joint.type == "prismatic" or high - low <= turn):
            ranges[column] = low, high
        elif joint.type != "prismatic":
            start = min(max(-np.pi, low), high - turn)
            ranges[column] = start, start + turn
    return read_only(ranges)


def joint_ranges(
    robot: Robot,
    given: Mapping[str, tuple[float, float]] | None = None,
    like: ArrayLike | None = None,
    margin: float | Array = 0.0,
) -> Array:
    """Between which values each joint is moved.

    Args:
        robot: The robot; what is not narrowed is as in `full_ranges`.
        given: Lowest and highest value by the joint's name [rad or m]; they win over ``like``.
        like: shape (N, m), joint values that were measured, in the order of ``robot.joint_names``.
        margin: What is added at both ends of ``like`` [rad or m]; one number, or one for each joint.

    Returns:
        shape (m, 2), [rad] or [m], read-only.

    Raises:
        CalibError: A joint that the chain does not have, a range that is empty, leaves the limits, or has
            a unit that is not the joint's.
    """
    limits = column_limits(robot)
    ranges = np.array(full_ranges(robot) if like is None else ranges_of(like, margin, limits))
    for name, (low, high) in (given or {}).items():
        if name not in robot.joint_names:
            raise CalibError(
                f"A range is given for the joint '{name}', which does not move the chain '{robot.base}' to "
                f"'{robot.tip}'. Its joints are {choices(robot.joint_names, limit=30)}."
            )
        fault = unit_fault(low, slides=robot.joint_types[name] == "prismatic")
        if fault is not None:
            raise CalibError(f"The range given for the joint '{name}' {fault}.")
        column = robot.joint_names.index(name)
        said = _text(robot, name, low, high)
        if not (np.isfinite(low) and np.isfinite(high) and low < high):
            raise CalibError(
                f"The range of '{name}' is {said}, which is empty; give the lower end first. A joint that stands "
                "still is held at its value (--hold)."
            )
        if low < limits[column, 0] - _ROUNDING or high > limits[column, 1] + _ROUNDING:
            raise CalibError(
                f"The range of '{name}' is {said}; its limits in the URDF are {_text(robot, name, *limits[column])}. "
                "Give a range inside."
            )
        ranges[column] = max(low, limits[column, 0]), min(high, limits[column, 1])
    return read_only(ranges)


def range_text(robot: Robot, name: str, ends: Array) -> str:
    """A joint's range in words, such as ``-90 to 90 deg`` or ``0 to 300 mm``."""
    return _text(robot, name, float(ends[0]), float(ends[1]))


def _text(robot: Robot, name: str, low: float, high: float) -> str:
    """Two values of a joint with their unit."""
    scale, unit = (1e3, "mm") if robot.joint_types[name] == "prismatic" else (180.0 / np.pi, "deg")
    return f"{scale * low:.6g} to {scale * high:.6g} {unit}"


def _limits(lower: float | None, upper: float | None) -> tuple[float, float]:
    """A joint's limits, infinite where there are none."""
    return -np.inf if lower is None else lower, np.inf if upper is None else upper
