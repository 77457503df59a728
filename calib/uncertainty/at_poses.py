"""Uncertainty of the pose that a calibrated robot reaches, at each of some poses, by its sources.

The error of a predicted pose at joint values q is the sum of independent parts, each with a covariance of the six
displacements [m, rad] along and about the axes of the frame in which the pose is predicted:

    V(q) = sum over sources of V_s(q)

Its expanded uncertainty is the length that the error of the position, or the angle that the error of the orientation,
stays below with the probability that k = 2 stands for (`calib.uncertainty.coverage`), with the effective degrees of
freedom of Welch and Satterthwaite (JCGM 100, G.4).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from calib.basics.arrays import Array, read_only
from calib.basics.values import Value
from calib.model.kinematics import Samples
from calib.numerics.errors import rms
from calib.result.calibration import Calibration
from calib.uncertainty.coverage import covered_length


class Source(Enum):
    """A source of uncertainty, a line of the budget."""

    INSTRUMENT = "instrument"
    SCALE = "scale"
    FRAME = "frame"
    TARGET = "target"
    REPEATABILITY = "repeatability"
    LOST_MOTION = "lost_motion"
    DRIFT = "drift"
    MODEL = "model"
    UNDETERMINED = "undetermined"
    RESOLUTION = "resolution"
    TEMPERATURE = "temperature"


class Distribution(Enum):
    """The distribution of a part of the error."""

    NORMAL = "normal"
    STUDENT = "t"
    UNIFORM = "uniform"


@dataclass(frozen=True, slots=True, eq=False)
class Contribution(Value):
    """What one source adds to the uncertainty at each of N poses."""

    source: Source
    #: Shape (N, 6, 6), covariance of displacement [m] and rotation [rad]
    covariance: Array
    distribution: Distribution
    #: Degrees of freedom of its standard uncertainty; infinite if it is known
    freedom: float


@dataclass(frozen=True, slots=True, eq=False)
class PoseUncertainty(Value):
    """Uncertainty of N predicted poses, and of what it is made."""

    #: Shape (N, 4, 4), the predicted poses [m]
    poses: Array
    #: The parts, independent of each other
    contributions: tuple[Contribution, ...]

    @property
    def covariance(self) -> Array:
        """Sum of the parts, shape (N, 6, 6) [m, rad]."""
        return np.asarray(sum(part.covariance for part in self.contributions))

    @property
    def position_std(self) -> Array:
        """Combined standard uncertainty of the position, the root of the sum over three axes, shape (N,) [m]."""
        return _std(self.covariance, slice(0, 3))

    @property
    def orientation_std(self) -> Array:
        """Combined standard uncertainty of the orientation, shape (N,) [rad]."""
        return _std(self.covariance, slice(3, 6))

    @property
    def position_freedom(self) -> Array:
        """Effective degrees of freedom of the position, shape (N,)."""
        return self._freedom(slice(0, 3))

    @property
    def orientation_freedom(self) -> Array:
        """Effective degrees of freedom of the orientation, shape (N,)."""
        return self._freedom(slice(3, 6))

    @property
    def position(self) -> Array:
        """Expanded uncertainty of the position: the distance that its error stays below, shape (N,) [m]."""
        return covered_length(self.covariance[:, :3, :3], self.position_freedom)

    @property
    def orientation(self) -> Array:
        """Expanded uncertainty of the orientation: the angle that its error stays below, shape (N,) [rad]."""
        return covered_length(self.covariance[:, 3:, 3:], self.orientation_freedom)

    def _freedom(self, part: slice) -> Array:
        """Return the effective degrees of freedom of positions or orientations, by Welch and Satterthwaite."""
        total = np.zeros(len(self.poses))
        shares = np.zeros(len(self.poses))
        for one in self.contributions:
            variance = _std(one.covariance, part) ** 2
            total = total + variance
            shares = shares + variance**2 / one.freedom
        with np.errstate(divide="ignore", invalid="ignore"):
            return read_only(np.where(shares > 0.0, total**2 / shares, np.inf))


def _std(covariance: Array, part: slice) -> Array:
    """Return the root of the trace of each covariance's block of positions or of orientations."""
    return np.asarray(np.sqrt(np.trace(covariance[:, part, part], axis1=1, axis2=2)))


def uncertainty_at(
    result: Calibration, samples: Samples, *, non_geometric: bool = True, in_base: bool = False
) -> PoseUncertainty:
    """Return the uncertainty of the poses that a result predicts.

    Args:
        result: The calibration, made here or read from its file.
        samples: N joint values, with the frame, the target, the loads and the last moves of each.
        non_geometric: Whether the non-geometric model predicts, if there is one; else the geometry.
        in_base: Whether the poses are those in the base; else in each sample's measurement frame.

    Returns:
        The uncertainty of each pose.
    """
    part = result.part(non_geometric=non_geometric)
    poses, twists = part.twists(samples, in_base=in_base)
    by_rows = twists @ part.covariance @ twists.transpose(0, 2, 1)
    grown = (twists @ part.change_by_scale)[:, :, None]
    lacking = np.zeros((6, 6))
    validation = part.cross_validation
    if validation is not None and validation.errors_without_outliers["m"].n:
        left = validation.errors_without_outliers["m"].rms ** 2 - part.noise_measured**2
        lacking[:3, :3] = max(left, 0.0) / 3.0 * np.eye(3)
    freedom = result.noise.freedom
    parts = (
        Contribution(Source.INSTRUMENT, read_only(by_rows), Distribution.NORMAL, freedom),
        Contribution(
            Source.SCALE, read_only(grown @ grown.transpose(0, 2, 1)), Distribution.NORMAL, np.inf
        ),
        Contribution(
            Source.MODEL,
            read_only(np.broadcast_to(lacking, by_rows.shape)),
            Distribution.NORMAL,
            freedom,
        ),
    )
    return PoseUncertainty(read_only(poses), parts)


def rms_over_poses(uncertainty: PoseUncertainty) -> tuple[float, float]:
    """Return the combined standard uncertainties of position [m] and orientation [rad], rms over the poses."""
    return rms(uncertainty.position_std), rms(uncertainty.orientation_std)
