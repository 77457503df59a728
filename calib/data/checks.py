"""What must hold of numbers that were measured: lengths that fit into a cell, rotations that are some."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.errors import MeasurementError
from calib.units import UNITS, Unit

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# No instrument is better or worse than this [m or rad], and squares beyond it leave the range of numbers.
SIGMAS = (1e-15, 1e6)

# Beyond this [m or rad] doubles are further apart than what calib computes to, and no robot gets there.
FARTHEST = 1e6
REACH = (-FARTHEST, FARTHEST)

# The points of a robot cell lie between these distances from the origin of any frame in use [m].
FAR_M = 100.0
NEAR_M = 5e-3

# A quaternion written with four digits has length one to half of this; a matrix of seven digits is orthonormal to that.
_LENGTH_TOLERANCE = 1e-3
_MATRIX_TOLERANCE = 1e-6


def to_matrices(values: Array) -> Array:
    """Rotation matrices, shape (N, 3, 3), of (x, y, z, w), shape (N, 4), or of vectors [rad], shape (N, 3).

    Quaternions are made unit length; q and -q are the same rotation. NaN rows stay NaN.
    """
    result = np.full((len(values), 3, 3), np.nan)
    there = np.isfinite(values).all(axis=1)
    if there.any():
        make = Rotation.from_quat if values.shape[1] == 4 else Rotation.from_rotvec
        result[there] = make(values[there]).as_matrix()
    return result


def to_quaternions(rotations: Array) -> Array:
    """Unit quaternions (x, y, z, w) with w >= 0, shape (N, 4), of matrices (N, 3, 3). NaN rows stay NaN."""
    result = np.full((len(rotations), 4), np.nan)
    there = np.isfinite(rotations).all(axis=(1, 2))
    if there.any():
        result[there] = Rotation.from_matrix(rotations[there]).as_quat(canonical=True)
    return result


def wrong_length(quaternions: Array) -> tuple[int, float] | None:
    """The first quaternion (N, 4) whose length is not one, and that length; None when all are. NaN rows pass."""
    with np.errstate(over="ignore"):  # what is infinite is too long as well
        length = np.linalg.norm(quaternions, axis=1)
    wrong = np.flatnonzero(np.abs(length - 1.0) > _LENGTH_TOLERANCE)
    return (int(wrong[0]), float(length[wrong[0]])) if wrong.size else None


def no_rotation(matrices: Array) -> Mask:
    """True for matrices (N, 3, 3) that are not finite, orthonormal and right-handed, shape (N,)."""
    product = np.swapaxes(matrices, 1, 2) @ matrices
    error = np.abs(product - np.eye(3)).max(axis=(1, 2), initial=0.0)
    good = (error <= _MATRIX_TOLERANCE) & (np.linalg.det(np.nan_to_num(matrices)) > 0.0)
    return np.asarray(~good, dtype=np.bool_)


def implausible(metres: Array, unit: Unit, *, near: bool = True) -> tuple[int, str]:
    """The row of (N, k) [m] furthest from the origin, and why it cannot be there, or all so ``near``; "" if it can."""
    distance = np.hypot.reduce(metres, axis=1)  # does not square: a huge number stays one
    row = int(np.argmax(distance))
    if not distance[row] <= FAR_M:
        return row, f"further from the origin than {FAR_M:g} m"
    if near and distance[row] < NEAR_M and unit.symbol != "m":
        return row, f"and none is further from the origin than {NEAR_M * 1e3:g} mm"
    return row, ""


def better_unit(value: float, unit: Unit) -> str:
    """The unit of length in which a value would be a distance in a robot cell; "" for the same or none."""
    fits = [u for u in ("mm", "m", "um") if 0.01 <= abs(value) * UNITS[u].to_si <= 20.0]
    return fits[0] if fits and fits[0] != unit.symbol else ""


def check_signs(source: str, signs: Mapping[str, int]) -> None:
    """Refuse decimal points beside decimal commas, one of which may separate thousands; ``signs`` has a line of each.

    Raises:
        MeasurementError: There are both.
    """
    if len(signs) == 2:
        raise MeasurementError(
            f"{source}: numbers have a decimal point in line {signs['.']} and a decimal comma in line "
            f"{signs[',']}. Write all in one way, without a sign between thousands."
        )
