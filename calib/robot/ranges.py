"""Joint values: their limits and ranges, and values drawn or spread between them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.errors import CalibError, choices
from calib.robot.robot import Robot, read_only
from calib.robot.urdf import UrdfJoint
from calib.units import Array, unit_fault

SPREAD = 200  #: Joint values spread over the limits.


_POSES, _SEED = 20, 20170401  #: Sets of joint values compared, and the seed they are drawn with.


#: Direction numbers of a Sobol sequence, shape (bits, columns); the test of this module says how they are made.
_DIRECTIONS = Path(__file__).with_name("sobol.npy")


_ROUNDING = 1e-4  #: A range may pass a limit by this: 360 deg is not quite 6.28318 rad [rad or m].


def random_joint_values(robot: Robot, count: int = _POSES, seed: int = _SEED) -> Array:
    """Joint values inside the limits (within one turn, or one metre, where they are wider or missing), (count, m)."""
    low, high = column_ranges(robot).T
    share: Array = np.random.default_rng(seed).uniform(size=(count, len(low)))
    return np.asarray(low + (high - low) * share)


@lru_cache(maxsize=16)
def spread_poses(robot: Robot, count: int = SPREAD) -> NDArray[np.float64]:
    """Joint values spread evenly over `column_ranges`, shape (count, m)."""
    return spread_between(column_ranges(robot), count)


def spread_between(ranges: Array, count: int) -> Array:
    """Rows of SciPy's unscrambled Sobol sequence between bounds, without its first point, where all are lowest.

        x_n = x_(n - 1) xor v_c,    c the lowest bit that is set in n

    The direction numbers v are SciPy's too, and kept in a file: its sequence stands behind its distributions, which
    take as long to import as a calibration takes.

    Args:
        ranges: shape (m, 2), the lower and the upper bound of each column.
        count: The number of rows.

    Returns:
        shape (count, m), read-only.
    """
    low, high = ranges.T
    directions = np.load(_DIRECTIONS, allow_pickle=False)
    bits, columns = directions.shape
    if count < 2**bits and len(low) <= columns:
        n = np.arange(1, count + 1)
        lowest = np.frexp(n & -n)[1] - 1
        x = np.bitwise_xor.accumulate(directions[lowest, : len(low)], axis=0)
        share = x / 2.0**bits
    else:
        share = sobol(count, len(low))
    return read_only(low + share * (high - low))


def sobol(count: int, columns: int) -> Array:
    """The points of SciPy's unscrambled Sobol sequence behind the first one, shape (count, columns), 0 to 1."""
    from scipy.stats import qmc

    sequence = qmc.Sobol(columns, scramble=False)
    sequence.fast_forward(1)
    return np.asarray(sequence.random(count))


def _ends_of_columns(robot: Robot, ends_of: Callable[[UrdfJoint], tuple[float, float]]) -> Array:
    """Each column's ends, (m, 2), narrowed so that joints that mimic it stay inside theirs, where both can be had."""
    found = np.array([ends_of(joint) for joint in robot.inputs])
    offset = robot.chain_values(np.zeros(len(found)))[0]
    for row, joint, at_zero in zip(robot.coupling, robot.joints, offset, strict=True):
        for column in np.flatnonzero(row):
            ends = (np.array(ends_of(joint)) - at_zero) / row[column]
            low, high = max(found[column, 0], ends.min()), min(found[column, 1], ends.max())
            if low < high:
                found[column] = low, high
    return read_only(found)


def _limits_of(joint: UrdfJoint) -> tuple[float, float]:
    """A joint's limits, infinite where there are none."""
    low, high = joint.lower, joint.upper
    return -np.inf if low is None else low, np.inf if high is None else high


def _range_of(joint: UrdfJoint) -> tuple[float, float]:
    """The part of a joint's limits within one turn or metre of zero, or their end that is nearer to zero."""
    bound = 1.0 if joint.type == "prismatic" else np.pi
    lower, upper = _limits_of(joint)
    low, high = min(max(-bound, lower), upper), max(min(bound, upper), lower)
    return low, max(low, high)


@lru_cache(maxsize=16)
def column_limits(robot: Robot) -> Array:
    """The limits of each column of q, shape (m, 2), [rad] or [m]; infinite where there are none."""
    return _ends_of_columns(robot, _limits_of)


def column_ranges(robot: Robot) -> Array:
    """The part of `column_limits` within one turn or metre of zero, shape (m, 2), [rad] or [m]."""
    return _ends_of_columns(robot, _range_of)


@lru_cache(maxsize=16)
def full_ranges(robot: Robot) -> Array:
    """Values that take each joint everywhere it can go, shape (m, 2), [rad] or [m].

    The limits; of a joint that may turn further one whole turn inside of them, the one nearest to zero; 1 m to both
    sides of zero where a sliding joint has no limits.
    """
    ranges, turn = np.array(column_ranges(robot)), 2.0 * np.pi
    for column, (low, high) in enumerate(column_limits(robot)):
        slides = robot.inputs[column].type == "prismatic"
        if np.isfinite([low, high]).all() and (slides or high - low <= turn):
            ranges[column] = low, high
        elif not slides:
            start = min(max(-np.pi, low), high - turn)
            ranges[column] = start, start + turn
    return read_only(ranges)


def joint_ranges(
    robot: Robot,
    given: Mapping[str, tuple[float, float]] | None = None,
    like: ArrayLike | None = None,
    margin: float | Array = 0.0,
) -> Array:
    """Between which values each joint is moved, shape (m, 2), [rad] or [m], read-only.

    Args:
        robot: The robot; what is not narrowed is as in `full_ranges`.
        given: Lowest and highest value by the joint's name [rad or m]; they win over ``like``.
        like: shape (N, m), joint values that were measured, in the order of ``robot.joint_names``.
        margin: What is added at both ends of ``like`` [rad or m]; one number, or one for each joint.

    Raises:
        CalibError: A joint that the chain does not have, a range that is empty or leaves the limits, the wrong unit.
    """
    limits, ranges = column_limits(robot), np.array(full_ranges(robot))
    if like is not None:
        values = np.atleast_2d(np.asarray(like, dtype=np.float64))
        if not values.size:
            raise CalibError("There are no rows to take the ranges of joints from; give one.")
        least, most = values.min(axis=0), values.max(axis=0)
        # The margin ends at a limit; a value that was measured beyond it stays in.
        ranges[:, 0] = np.minimum(least, np.maximum(least - margin, limits[:, 0]))
        ranges[:, 1] = np.maximum(most, np.minimum(most + margin, limits[:, 1]))
    for name, (low, high) in (given or {}).items():
        if name not in robot.joint_names:
            raise CalibError(
                f"A range is given for '{name}', which is no joint of the chain '{robot.base}' to '{robot.tip}'; its "
                f"joints are {choices(robot.joint_names, limit=30)}."
            )
        fault = unit_fault(low, slides=robot.joint_types[name] == "prismatic")
        if fault is not None:
            raise CalibError(f"The range given for the joint '{name}' {fault}.")
        column = robot.joint_names.index(name)
        least, most = limits[column]
        if not (low < high and low >= least - _ROUNDING and high <= most + _ROUNDING):
            raise CalibError(
                f"The range of '{name}' is {range_text(robot, name, (low, high))}; the lower end comes first, both "
                f"within the URDF's {range_text(robot, name, (least, most))}. To hold a joint still: --hold."
            )
        ranges[column] = max(low, least), min(high, most)
    return read_only(ranges)


def range_text(robot: Robot, name: str, ends: Array | tuple[float, float]) -> str:
    """A joint's range in words, such as ``-90 to 90 deg`` or ``0 to 300 mm``."""
    scale, unit = (1e3, "mm") if robot.joint_types[name] == "prismatic" else (180.0 / np.pi, "deg")
    return f"{scale * ends[0]:.6g} to {scale * ends[1]:.6g} {unit}"
