"""Matching: what of a wanted pose a robot is to reach, as an error and its derivative.

The error is along the tool's own axes, in the order of a twist, and a robot that moves by that twist is where it should
be, to first order:

    e = (R_now^T (p_wanted - p_now), log(R_now^T R_wanted))
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.errors import ModelError, choices

Array = NDArray[np.float64]

POSE, POSITION, AXIS, WEIGHTED = "pose", "position", "axis", "weighted"

MATCHES = (POSE, POSITION, AXIS, WEIGHTED)
"""What is matched: position and orientation; the position alone; position and direction of the tool's z axis; both as
well as can be, an angle counting as a length."""

_ROWS = {POSE: 6, POSITION: 3, AXIS: 5, WEIGHTED: 6}


@dataclass(frozen=True, slots=True)
class Matching:
    """What is matched, and what an angle counts.

    Attributes:
        name: One of `MATCHES`.
        lever: The length that an angle of one radian counts as [m].

    Raises:
        ModelError: No such name, or a lever that is not a positive length.
    """

    name: str
    lever: float

    def __post_init__(self) -> None:
        """Check both."""
        if self.name not in MATCHES:
            message = f"Poses cannot be matched by '{self.name}'; choose one of {choices(MATCHES)}."
            raise ModelError(message)
        if not (np.isfinite(self.lever) and self.lever > 0.0):
            message = f"The lever is {self.lever} m; it must be a length greater than 0."
            raise ModelError(message)

    @property
    def rows(self) -> int:
        """How many numbers are matched."""
        return _ROWS[self.name]

    def error(self, T_now: Array, T_wanted: Array) -> Array:
        """The error, angles times the lever, shape (N, rows), [m]; of poses of shape (N, 4, 4)."""
        turned = np.swapaxes(T_now[:, :3, :3], 1, 2)
        moved = (turned @ (T_wanted[:, :3, 3] - T_now[:, :3, 3])[:, :, None])[:, :, 0]
        if self.name == POSITION:
            return np.asarray(moved)
        relative = turned @ T_wanted[:, :3, :3]
        angles = _tilt(relative[:, :, 2]) if self.name == AXIS else _turn(relative)
        return np.concatenate([moved, self.lever * angles], axis=1)

    def jacobian(self, twists: Array) -> Array:
        """The same rows of the tool's twists of shape (N, 6, m), shape (N, rows, m), [m per rad or m]."""
        rows = twists[:, : self.rows].copy()
        rows[:, 3:] *= self.lever
        return np.asarray(rows)

    def misses(self, T_now: Array, T_wanted: Array) -> Array:
        """Distance [m] and angle [rad] between poses, shape (N, 2); the angle is NaN where it is not matched."""
        distance = np.linalg.norm(T_wanted[:, :3, 3] - T_now[:, :3, 3], axis=1)
        if self.name == POSITION:
            return np.stack([distance, np.full(len(distance), np.nan)], axis=1)
        relative = np.swapaxes(T_now[:, :3, :3], 1, 2) @ T_wanted[:, :3, :3]
        angles = _tilt(relative[:, :, 2]) if self.name == AXIS else _turn(relative)
        return np.stack([distance, np.linalg.norm(angles, axis=1)], axis=1)


def _turn(rotations: Array) -> Array:
    """Rotation vectors of matrices of shape (N, 3, 3), shape (N, 3), [rad]; NaN stays NaN."""
    result = np.full((len(rotations), 3), np.nan)
    there = np.isfinite(rotations).all(axis=(1, 2))
    if there.any():
        result[there] = Rotation.from_matrix(rotations[there]).as_rotvec()
    return result


def _tilt(z: Array) -> Array:
    """The smallest turn that brings the tool's z axis to a direction given in the tool, (N, 3) to (N, 2), [rad]."""
    sine = np.hypot(z[:, 0], z[:, 1])
    angle = np.arctan2(sine, z[:, 2])
    across = np.stack([-z[:, 1], z[:, 0]], axis=1)
    # A direction straight back may be reached by any turn; about x is one.
    across[sine == 0.0] = [1.0, 0.0]
    return np.asarray(across / np.where(sine == 0.0, 1.0, sine)[:, None] * angle[:, None])
