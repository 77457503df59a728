"""Quaternions and rotation vectors of a table into rotation matrices."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

# A quaternion written with four digits has length one to half of this.
LENGTH_TOLERANCE = 1e-3
# A rotation matrix that was written with seven digits is orthonormal to this.
MATRIX_TOLERANCE = 1e-6


def to_matrices(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotation matrices, shape (N, 3, 3), of (x, y, z, w), shape (N, 4), or of vectors [rad], shape (N, 3).

    Quaternions are made unit length; q and -q are the same rotation. NaN rows stay NaN.
    """
    result = np.full((len(values), 3, 3), np.nan)
    there = np.isfinite(values).all(axis=1)
    if there.any():
        make = Rotation.from_quat if values.shape[1] == 4 else Rotation.from_rotvec
        result[there] = make(values[there]).as_matrix()
    return result


def to_quaternions(rotations: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit quaternions (x, y, z, w) with w >= 0, shape (N, 4), of matrices (N, 3, 3). NaN rows stay NaN."""
    result = np.full((len(rotations), 4), np.nan)
    there = np.isfinite(rotations).all(axis=(1, 2))
    if there.any():
        result[there] = Rotation.from_matrix(rotations[there]).as_quat(canonical=True)
    return result


def wrong_length(quaternions: NDArray[np.float64]) -> tuple[int, float] | None:
    """The first quaternion (N, 4) whose length is not one, and that length; None when all are. NaN rows pass."""
    with np.errstate(over="ignore"):  # what is infinite is too long as well
        length = np.linalg.norm(quaternions, axis=1)
    wrong = np.flatnonzero(np.abs(length - 1.0) > LENGTH_TOLERANCE)
    return (int(wrong[0]), float(length[wrong[0]])) if wrong.size else None


def no_rotation(matrices: NDArray[np.float64]) -> NDArray[np.bool_]:
    """True for matrices (N, 3, 3) that are not finite, orthonormal and right-handed, shape (N,)."""
    product = np.swapaxes(matrices, 1, 2) @ matrices
    error = np.abs(product - np.eye(3)).max(axis=(1, 2), initial=0.0)
    good = (error <= MATRIX_TOLERANCE) & (np.linalg.det(np.nan_to_num(matrices)) > 0.0)
    return np.asarray(~good, dtype=np.bool_)
