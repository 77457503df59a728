"""Evidence: the figures that a verdict rests on, and the tests of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtr

from calib.basics.arrays import Array, Integers, Mask
from calib.diagnosis.reasons import Reason
from calib.numerics.errors import CrossValidation, Errors

#: A nominal robot is at its noise where its error is below so many standard deviations, rms over all scalars.
_AT_THE_NOISE = 1.45

#: A gain whose p-value is above this may be chance.
CHANCE = 0.03

#: Relative differences below this are rounding.
ROUNDING = 1e-6

#: Errors of flagged rows are alike for the nominal and the calibrated robot within this factor.
ALIKE = 1.1

#: A standard error or an error below this is taken as this, so that ratios stay finite.
_TINY = 1e-30


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """Figures that a verdict is based on; N rows of up to D scalars.

    The nominal robot is cross-validated with frame and target fitted as for the calibrated one.
    """

    #: Of the nominal robot
    nominal: CrossValidation
    #: Of the calibrated one
    calibrated: CrossValidation
    #: (N, D), the noise of each scalar, in its unit
    scales: Array
    #: (N, D), which scalars were measured
    used: Mask
    #: (N, D), the least noise of each scalar by any model tried, over ``scales``; what exceeds it is lack of model
    floor: Array
    #: (N,), rows of one number are repeats of one measurement
    repeats: Integers
    #: (N,), which rows hold the distance between two poses
    pairs: Mask
    #: (N,), flagged by the fit to all of them
    outliers: Mask
    #: Errors of nominal and calibrated robot on validation rows, and how many further rows were set aside as outliers
    validation: tuple[Errors, Errors, int]
    #: Errors of the calibrated robot on all validation rows, with those that were set aside
    validation_with_suspects: Errors
    #: Number of parameters of the model, but for those of cameras and boards, which the many corners of images tell
    parameters: int
    #: Whether any parameter of the robot has changed
    changes: bool
    #: Largest change of a parameter of the robot [m or rad]
    largest: float
    #: Standard deviation of the noise of one scalar, by the units that were measured
    noise: Mapping[str, float]
    #: Expected error of predictions over the joint limits, rms [m]
    expected: float
    #: That of the nominal robot's predictions [m]
    expected_of_nominal: float
    #: Number of parameters of a full geometry, where `auto` may have chosen a smaller one; else 0
    full_model_parameters: int = 0
    #: Findings besides errors
    doubts: tuple[Reason, ...] = ()
    #: Stated last, and decide nothing
    notes: tuple[Reason, ...] = ()
    #: (N,), which rows are corners in images; None: none
    images: Mask | None = None
    #: Of the URDF: name and held-out errors of the non-geometric model, if there is one
    non_geometric: tuple[str, Errors] | None = None

    def whitened(self, v: CrossValidation) -> Array:
        """Squared error of each row in units of the noise (``scales``), summed over its measured scalars, shape (N,).

        Args:
            v: Held-out residuals of the N rows, by either robot.
        """
        scalars = np.where(self.used, v.residual / self.scales, 0.0)
        return np.asarray(np.sum(scalars**2, axis=1))

    def gain(self, *, of_all: bool = False) -> tuple[float, float]:
        """Test the fall of the error on held-out rows from the nominal to the calibrated robot.

        Errors are paired by poses, of which repeats are averaged. Of all rows the error is tested, not its square: an
        accident then changes the fall by no more than the correction there.

        Args:
            of_all: Whether flagged rows count too.

        Returns:
            The mean fall of the squared error in standard errors, 0 where nothing changes; and the p-value of no fall,
            by Student's t.
        """
        before = self._by_pose(self.nominal, of_all=of_all)
        fall = before - self._by_pose(self.calibrated, of_all=of_all)
        mean = float(np.mean(fall)) if len(fall) else 0.0
        if not self.changes or abs(mean) < ROUNDING * float(np.mean(before)):
            return 0.0, 1.0
        if len(fall) < 2:
            return float(np.sign(mean)), 1.0
        standard_error = float(np.std(fall, ddof=1)) / float(np.sqrt(len(fall)))
        gain = mean / max(standard_error, _TINY)
        return gain, float(stdtr(len(fall) - 1, -gain))

    def _by_pose(self, v: CrossValidation, *, of_all: bool) -> Array:
        """Average the whitened errors over the repeats of each pose.

        Args:
            v: Held-out residuals of the N rows, by either robot.
            of_all: False: squared errors of the rows that are not flagged are averaged; True: errors of all rows.

        Returns:
            The mean of each of K poses, in units of the noise or its square, shape (K,).
        """
        rows = (of_all | ~self.outliers) & np.any(self.used, axis=1)
        _, poses = np.unique(v.poses[rows], return_inverse=True)
        counts = np.maximum(np.bincount(poses), 1)
        errors = self.whitened(v)[rows]
        if of_all:
            errors = np.sqrt(errors)
        return np.asarray(np.bincount(poses, errors) / counts)

    @property
    def at_noise_level(self) -> bool:
        """True if the nominal robot's error is about the noise that the best model leaves, outliers aside."""
        square, noise = self._squares(self.nominal)
        return bool(square < _AT_THE_NOISE**2 * noise)

    def _squares(self, v: CrossValidation) -> tuple[float, float]:
        """Mean whitened squared error of a scalar, outliers aside, and the part of it that is noise (``floor``).

        Args:
            v: Held-out residuals of the N rows, by either robot.
        """
        good = ~self.outliers
        count = max(int(np.sum(self.used[good])), 1)
        floor = np.where(self.used, self.floor, 0.0)
        noise = np.sum(floor[good] ** 2)
        return float(np.sum(self.whitened(v)[good]) / count), float(noise / count)

    @property
    def accidental(self) -> bool:
        """True if flagged rows are no further off than with the nominal robot, and the error of all rows falls."""
        before = np.sum(self.whitened(self.nominal)[self.outliers])
        after = np.sum(self.whitened(self.calibrated)[self.outliers])
        if not after < ALIKE**2 * before:
            return False
        _, chance = self.gain(of_all=True)
        return chance < CHANCE

    def remains_everywhere(self) -> float:
        """Share of the nominal robot's error over the joint limits that is expected to remain, 0 to 1."""
        return self.expected / max(self.expected_of_nominal, self.expected, _TINY)

    def remains_held_out(self) -> float:
        """Share of the nominal robot's error on held-out rows that remains, noise subtracted from both.

        The mean of M squared scalars of noise is uncertain by sqrt(2 / M), which is subtracted too.
        """
        before, noise = self._squares(self.nominal)
        after, _ = self._squares(self.calibrated)
        count = max(int(np.sum(self.used[~self.outliers])), 1)
        remaining = after - noise * (1.0 + np.sqrt(2.0 / count))
        return float(np.sqrt(max(remaining, 0.0) / max(before - noise, _TINY)))
