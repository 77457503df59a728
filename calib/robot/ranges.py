"""Limits and ranges of joint values, and readings drawn or spread between them.

Limits and ranges are those of the URDF's joints, the values theta = C q of the columns' joints, also if the readings q
are coupled (`calib.robot.coupled_readings`); the readings within them are then not a box.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.basics.arrays import Array, Integers, read_only
from calib.basics.units import unit_fault
from calib.errors import CalibError, choices
from calib.robot.robot import Robot
from calib.robot.urdf_tree import UrdfJoint

#: Number of joint values that `spread_poses` spreads over the ranges, unless another is given.
SPREAD = 200

#: Number of joint values at which a written URDF is compared with the model, unless another is given.
_RANDOM = 20

#: Seed of the random joint values, so that a robot is always compared at the same ones.
_SEED = 20170401

#: Direction numbers of a Sobol sequence, shape (bits, columns); the tests of this module show how they are made.
_DIRECTIONS = Path(__file__).with_name("sobol.npy")

#: A range may exceed a limit by this [rad or m]: 360 deg is slightly more than 6.28318 rad.
_ROUNDING = 1e-4

#: Margin to the limits of a sliding joint [m]; that of the others, an angle, is given.
_SLIDING_MARGIN = 5e-3

#: A sliding joint's limit beyond this is none [m]: no rail is as long, and exporters write 1000 for "no limit".
_NO_LIMIT = 500.0

#: A sliding joint without limits moves this far to both sides of zero [m].
_UNLIMITED_SLIDE = 1.0


def random_joint_values(robot: Robot, count: int = _RANDOM, seed: int = _SEED) -> Array:
    """Return readings at uniformly random joint values within `column_ranges`.

    Args:
        robot: The robot, with m columns of q.
        count: Number of sets of values.
        seed: Seed of the random numbers.

    Returns:
        Shape (count, m), [rad] or [m].
    """
    low, high = column_ranges(robot).T
    share: Array = np.random.default_rng(seed).uniform(size=(count, len(low)))
    return robot.readings(low + (high - low) * share)


@lru_cache(maxsize=16)
def spread_poses(robot: Robot, count: int = SPREAD) -> Array:
    """Return readings at joint values spread evenly over `column_ranges`, always the same ones.

    Args:
        robot: The robot, with m columns of q.
        count: Number of sets of values.

    Returns:
        Shape (count, m), [rad] or [m], read-only.
    """
    return read_only(robot.readings(spread_between(column_ranges(robot), count)))


def spread_between(ranges: Array, count: int) -> Array:
    """Return rows of SciPy's unscrambled Sobol sequence between bounds, without the first, which is the lower bounds.

        x_n = x_(n - 1) xor v_c,    c the lowest bit that is set in n

    Args:
        ranges: Shape (m, 2), the lower and the upper bound of each column.
        count: The number of rows.

    Returns:
        Shape (count, m), read-only.
    """
    low, high = ranges.T
    directions = _directions()
    bits, columns = directions.shape
    if len(low) <= columns:
        steps = directions[_lowest_bit(np.arange(1, count + 1)), : len(low)]
        share = np.bitwise_xor.accumulate(steps, axis=0) / 2.0**bits
    else:
        share = sobol(count, len(low))
    return read_only(low + share * (high - low))


def sobol(count: int, columns: int) -> Array:
    """Return points of SciPy's unscrambled Sobol sequence after the first one.

    Args:
        count: The number of points.
        columns: The number of their coordinates.

    Returns:
        Shape (count, columns), from 0 to 1.
    """
    from scipy.stats import qmc

    sequence = qmc.Sobol(columns, scramble=False)
    sequence.fast_forward(1)
    return np.asarray(sequence.random(count))


def scrambled_sobol(columns: int, size: int, seed: int | np.random.SeedSequence) -> Iterator[Array]:
    """Yield blocks, without end, of points of SciPy's scrambled Sobol sequence.

    The digits of each direction number, base 2, are multiplied by a random lower triangular matrix whose diagonal is 1,
    and the sequence begins at a random point (J. Matousek, "On the L2-discrepancy for anchored boxes", 1998).

    Args:
        columns: The number of coordinates.
        size: The number of points of a block, a power of two.
        seed: Seed of the random numbers; the same one gives the same sequence.

    Yields:
        Shape (size, columns), from 0 to 1.
    """
    directions = _directions()
    bits, most = directions.shape
    if columns > most:
        from scipy.stats import qmc

        sequence = qmc.Sobol(columns, scramble=True, seed=np.random.default_rng(seed))
        while True:
            yield np.asarray(sequence.random(size))
    rng = np.random.default_rng(seed)
    places = np.arange(bits, dtype=np.uint32)
    point = rng.integers(2, size=(columns, bits), dtype=np.uint32) @ (1 << places)
    matrices = np.tril(rng.integers(2, size=(columns, bits, bits), dtype=np.uint32))
    matrices[:, places, places] = 1
    falling = places[::-1]  # the highest digit comes first
    digits = (directions[:, :columns, None] >> falling) & 1
    scrambled = np.einsum("dpk,jdk->jdp", matrices, digits) & 1
    own_directions = scrambled @ (1 << falling)
    for first in itertools.count(1, size):
        steps = own_directions[_lowest_bit(np.arange(first, first + size))]
        following = np.bitwise_xor.accumulate(np.vstack([point, steps]), axis=0)
        yield following[:-1] / 2.0**bits
        point = following[-1]


@lru_cache(maxsize=1)
def _directions() -> NDArray[np.uint32]:
    """Return the direction numbers of SciPy's Sobol sequence, uint32 (bits, columns), times 2^bits.

    They are kept in a file, because importing SciPy's Sobol sequence pulls in scipy.stats, which takes as long as a
    calibration.
    """
    directions: NDArray[np.uint32] = np.load(_DIRECTIONS, allow_pickle=False)
    return directions


def _lowest_bit(numbers: Integers) -> Integers:
    """Return the place, from 0, of the lowest bit that is set in whole numbers > 0."""
    return np.asarray(np.frexp(numbers & -numbers)[1] - 1)


def _column_bounds(robot: Robot, bounds_of: Callable[[UrdfJoint], tuple[float, float]]) -> Array:
    """Return bounds (m, 2), [rad] or [m], of ``robot.inputs``, which also keep joints that mimic them within theirs.

    ``bounds_of`` gives the lower and the upper bound of one joint.
    A joint whose bounds would leave nothing is not considered.
    """
    bounds = np.array([bounds_of(joint) for joint in robot.inputs])
    for chain in robot.chains:
        values_at_zero = chain.chain_values(np.zeros(len(bounds)))[0]
        for row, joint, at_zero in zip(
            chain.mimic_matrix, chain.joints, values_at_zero, strict=True
        ):
            for column in np.flatnonzero(row):
                # The column's values at which this joint, row[column] q + at_zero, is at its bounds.
                ends = (np.array(bounds_of(joint)) - at_zero) / row[column]
                low = max(bounds[column, 0], ends.min())
                high = min(bounds[column, 1], ends.max())
                if low < high:
                    bounds[column] = low, high
    return read_only(bounds)


def _limits_of(joint: UrdfJoint) -> tuple[float, float]:
    """Return a joint's limits [rad or m], infinite if there are none, or none that a sliding joint can reach."""
    low = -np.inf if joint.lower is None else joint.lower
    high = np.inf if joint.upper is None else joint.upper
    if joint.type == "prismatic":
        low = -np.inf if low < -_NO_LIMIT else low
        high = np.inf if high > _NO_LIMIT else high
    return low, high


def _range_of(joint: UrdfJoint) -> tuple[float, float]:
    """Return the part of a joint's limits within half a turn [rad] or a metre [m] of zero, low and high.

    If there is no such part, both are the limit that is nearer to zero.
    """
    bound = _UNLIMITED_SLIDE if joint.type == "prismatic" else np.pi
    lower, upper = _limits_of(joint)
    low = min(max(-bound, lower), upper)
    high = max(min(bound, upper), lower)
    return low, max(low, high)


@lru_cache(maxsize=16)
def column_limits(robot: Robot) -> Array:
    """Return the URDF's limits of ``robot.inputs``, shape (m, 2), [rad] or [m]; infinite if there are none."""
    return _column_bounds(robot, _limits_of)


def column_ranges(robot: Robot) -> Array:
    """Return the part of `column_limits` within half a turn or 1 m of zero, shape (m, 2), [rad] or [m]."""
    return _column_bounds(robot, _range_of)


@lru_cache(maxsize=16)
def full_ranges(robot: Robot) -> Array:
    """Return values that take each joint everywhere it can go, shape (m, 2), [rad] or [m].

    The limits; for a joint that may turn further, the one whole turn within them that is nearest to zero; for a sliding
    joint without limits, 1 m to both sides of zero.
    """
    ranges = np.array(column_ranges(robot))
    turn = 2.0 * np.pi
    for column, (low, high) in enumerate(column_limits(robot)):
        slides = robot.inputs[column].type == "prismatic"
        limited = np.isfinite([low, high]).all()
        if limited and (slides or high - low <= turn):
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
    """Return the values between which each joint is moved.

    Args:
        robot: The robot, with m columns of q.
        given: Lowest and highest value by the joint's name [rad or m]; they win over ``like``.
        like: Shape (N, m), readings that were measured, in the order of ``robot.joint_names``; the least and the
            greatest value of each joint there are the range. None: the ranges are those of `full_ranges`.
        margin: Added at both ends of ``like`` [rad or m], not beyond a limit; one number, or one for each joint.

    Returns:
        Least and largest value of each of ``robot.inputs``, not of its reading, shape (m, 2), [rad] or [m], read-only.

    Raises:
        CalibError: The chain has no such joint, or the range is empty, exceeds the limits, or has the wrong unit.
    """
    limits = column_limits(robot)
    ranges = np.array(full_ranges(robot))
    if like is not None:
        readings = np.atleast_2d(np.asarray(like, dtype=np.float64))
        if not readings.size:
            raise CalibError("There are no rows to take the ranges of joints from; give one.")
        values = robot.input_values(readings)
        least = values.min(axis=0)
        most = values.max(axis=0)
        # The margin ends at a limit, but a value that was measured beyond the limit is kept.
        ranges[:, 0] = np.minimum(least, np.maximum(least - margin, limits[:, 0]))
        ranges[:, 1] = np.maximum(most, np.minimum(most + margin, limits[:, 1]))
    for name, (low, high) in (given or {}).items():
        if name not in robot.joint_names:
            raise CalibError(
                f"A range is given for '{name}', which is not a joint of the chain '{robot.base}' to '{robot.tip}'; "
                f"its joints are {choices(robot.joint_names, limit=30)}."
            )
        fault = unit_fault(low, slides=robot.joint_types[name] == "prismatic")
        if fault is not None:
            raise CalibError(f"The range given for the joint '{name}' {fault}.")
        column = robot.joint_names.index(name)
        lower, upper = limits[column]
        if not (low < high and low >= lower - _ROUNDING and high <= upper + _ROUNDING):
            raise CalibError(
                f"The range of '{name}' is {range_text(robot, name, (low, high))}; the lower end comes first, both "
                f"within the URDF's {range_text(robot, name, (lower, upper))}. To hold a joint still: --hold."
            )
        ranges[column] = max(low, lower), min(high, upper)
    return read_only(ranges)


def range_text(robot: Robot, name: str, ends: Array | tuple[float, float]) -> str:
    """Return a joint's range for a message, such as ``-90 to 90 deg`` or ``0 to 300 mm``.

    Args:
        robot: The robot.
        name: The joint's name.
        ends: Its lowest and highest value [rad or m].
    """
    if robot.joint_types[name] == "prismatic":
        scale = 1e3
        unit = "mm"
    else:
        scale = 180.0 / np.pi
        unit = "deg"
    return f"{scale * ends[0]:.6g} to {scale * ends[1]:.6g} {unit}"


def margins_by_joint(robot: Robot, margin: float) -> Array:
    """Return the distance that planned values keep from both limits of each measured joint.

    Args:
        robot: The robot, with m measured joints.
        margin: Distance for joints that turn [rad]; 0: sliding joints keep none either.

    Returns:
        Shape (m,), in the order of ``robot.joint_names``: ``margin`` [rad] for joints that turn, 5 mm (or 0) [m] for
        sliding ones.
    """
    slides = [joint.type == "prismatic" for joint in robot.inputs]
    return np.where(slides, _SLIDING_MARGIN * bool(margin), margin)
