"""Uncertainty over the workspace: the target's place and its expanded uncertainty at poses over the joint limits.

What figures and the 3-D page share. Poses are always the same ones of a robot (`calib.robot.ranges.spread_poses`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.basics.arrays import Array, read_only
from calib.basics.values import Value
from calib.result.calibration import Calibration
from calib.robot.ranges import spread_poses

#: Share of the poses whose colour is not the last one: a few uncertain ones do not make all others alike.
_NEARLY_ALL = 0.98


@dataclass(frozen=True, slots=True, eq=False)
class UncertaintyMap(Value):
    """Uncertainty of the first target's position at N poses over the joint limits, by the corrected URDF."""

    #: Shape (N, m), the poses [rad or m]
    q: Array
    #: Shape (N, 3), the target in the base [m]
    places: Array
    #: Shape (N,), expanded uncertainty of its position [m]
    position: Array

    @property
    def scale(self) -> tuple[float, float]:
        """The uncertainties [m] that have the first and the last colour; larger ones have the last one too."""
        low = float(np.min(self.position))
        high = float(np.quantile(self.position, _NEARLY_ALL))
        return low, max(high, 1.01 * low + 1e-12)

    @property
    def shares(self) -> Array:
        """Place of each uncertainty on the scale of colours, shape (N,), from 0 to 1."""
        low, high = self.scale
        return read_only(np.clip((self.position - low) / (high - low), 0.0, 1.0))


def uncertainty_map(result: Calibration, count: int) -> UncertaintyMap:
    """Return the uncertainty of the first target over the joint limits.

    Args:
        result: The calibration, made here or read from its file.
        count: Number of poses.

    Returns:
        The map; of a robot of several chains that of its first one.
    """
    q = spread_poses(result.nominal, count)
    uncertainty = result.uncertainty(q, non_geometric=False)
    return UncertaintyMap(q, predicted_places(result, q), uncertainty.position)


def predicted_places(result: Calibration, q: Array) -> Array:
    """Return the corrected robot's positions of the first target in the base, [m].

    Args:
        result: The calibration.
        q: Shape (N, m), joint values in the robot's order, [rad] or [m].

    Returns:
        Shape (N, 3), read-only.
    """
    T_base_tip = result.robot.poses(q)
    return read_only(T_base_tip[:, :3, :3] @ result.target + T_base_tip[:, :3, 3])
