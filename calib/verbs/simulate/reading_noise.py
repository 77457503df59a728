"""Noise of what an instrument reads: added to positions, orientations and single readings of a kind of measurement."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from calib.basics.arrays import Array
from calib.basics.channels import VECTOR
from calib.data.kinds import Kind


def with_pose_noise(kind: Kind, readings: Array, R: Array, noise: Mapping[str, Array]) -> Array:
    """Add noise to the position and the orientation that a kind measures, if it measures them.

    Args:
        kind: The kind of all N rows.
        readings: Of a perfect instrument, shape (N, k), as `Kind` has them.
        R: True orientations of the targets in the frames, shape (N, 3, 3).
        noise: Of ``"length"`` [m] and ``"angle"`` [rad], shape (N, 3) or more; the first three columns are taken, the
            latter as a rotation vector along the axes of the frame.

    Returns:
        shape (N, k).
    """
    result = readings.copy()
    if kind.position:
        result[:, :VECTOR] += noise["length"][:, :VECTOR]
    if kind.orientation:
        turns = Rotation.from_rotvec(noise["angle"][:, :VECTOR])
        R_noisy = turns.as_matrix() @ R
        result[:, VECTOR : VECTOR + 9] = R_noisy.reshape(-1, 9)
    return np.asarray(result)


def with_reading_noise(kind: Kind, readings: Array, noise: Mapping[str, Array]) -> Array:
    """Add noise to the single readings of a kind, such as a distance.

    Args:
        kind: The kind of all N rows.
        readings: shape (N, k), as `Kind` has them.
        noise: Of each quantity, shape (N, n), a column for each reading of it in their order; a position and an
            orientation have the first three columns.

    Returns:
        shape (N, k); a positive reading that noise would make negative is its absolute value.
    """
    result = readings.copy()
    first = kind.size - len(kind.readings)
    next_column = {"length": VECTOR * kind.position, "angle": VECTOR * kind.orientation}
    for k, reading in enumerate(kind.readings, start=first):
        column = next_column.get(reading.quantity, 0)
        next_column[reading.quantity] = column + 1
        result[:, k] += noise[reading.quantity][:, column]
        if reading.positive:
            result[:, k] = np.abs(result[:, k])
    return np.asarray(result)
