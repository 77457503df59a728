"""Evidence: the figures that a verdict rests on, and the tests of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.special import stdtr

from calib.basics.arrays import Array, Integers, Mask
from calib.diagnosis.reasons import Group, Reason
from calib.numerics.errors import CrossValidation, Errors

#: A nominal robot is at its noise if its error is below so many standard deviations, rms over all scalars.
_AT_THE_NOISE = 1.45

#: A gain whose p-value is above this may be chance.
_CHANCE = 0.03

#: Relative differences below this are rounding.
_ROUNDING = 1e-6

#: Errors of flagged rows are alike for the nominal and the calibrated robot within this factor.
_ALIKE = 1.1

#: Scalar measurements per parameter below which a fit relies on its priors.
_FEW = 2.0

#: Number of scalars of a pose, which is all that the corners of one image say about the robot.
_OF_POSE = 6

#: With fewer poses, cross-validation can look good by chance.
_HANDFUL = 8

#: A larger share of flagged rows is not a few accidents.
_MANY_OUTLIERS = 0.15

#: A gain is worth having if errors of held-out rows, and of validation rows, fall below this share.
_FALLS = 0.9

#: A gain is proven if no more than this share of the nominal error remains, on held-out rows, noise subtracted, and in
#: what is expected over the joint limits.
REMAINS = 0.4

#: An expected error of more than so many times the nominal one is not a robot's.
_FAR_MORE = 3.0

#: A standard error or an error below this is taken as this, so that ratios stay finite.
_TINY = 1e-30


@dataclass(frozen=True, slots=True)
class ValidationErrors:
    """Errors on the validation rows, a few that do not fit set aside."""

    #: Of the nominal robot
    before: Errors
    #: Of the calibrated one
    after: Errors
    #: Number of rows that were set aside as outliers
    aside: int
    #: Of the calibrated robot on all validation rows, with those set aside
    whole: Errors

    @property
    def exist(self) -> bool:
        """True if there are validation rows."""
        return bool(self.after.leading.n)

    @property
    def fall(self) -> bool:
        """True if the error falls at all."""
        return self.after.leading.rms < (1.0 - _ROUNDING) * self.before.leading.rms

    @property
    def fall_little(self) -> bool:
        """True if the error falls, but by next to nothing."""
        return self.fall and self.after.leading.rms > _FALLS * self.before.leading.rms

    @property
    def show_a_gain(self) -> bool:
        """True if there are validation rows and the error falls on them by more than next to nothing."""
        return self.exist and self.fall and not self.fall_little

    @property
    def values(self) -> dict[str, Any]:
        """Values of a reason that compares the errors of both robots on validation rows.

        ``rows`` is the number of those not set aside, ``aside`` of those that are, ``whole`` the error of the
        calibrated robot on both.
        """
        return {
            "rows": self.after.leading.n,
            "aside": self.aside,
            "before": self.before,
            "after": self.after,
            "whole": self.whole,
        }


@dataclass(frozen=True, eq=False)
class Evidence:
    """Figures of the corrected URDF, or of the non-geometric model, that a verdict rests on.

    They are of N rows of up to D scalars. The nominal robot is cross-validated with frame and target fitted as for the
    calibrated one.
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
    #: Of nominal and calibrated robot
    validation: ValidationErrors
    #: Number of parameters of the model, except those of cameras and boards, which the many corners of images determine
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
    #: The part of ``expected`` that a scale error of the instrument adds [m]
    by_scale: float = 0.0
    #: That scale error, rms, a share
    scale: float = 0.0
    #: Number of parameters of a full geometry, if `auto` may have chosen a smaller one; else 0
    full_model_parameters: int = 0
    #: Findings besides errors
    doubts: tuple[Reason, ...] = ()
    #: Stated last, and decide nothing
    notes: tuple[Reason, ...] = ()
    #: (N,), which rows are corners in images; None: none
    images: Mask | None = None
    #: Of the URDF: name and held-out errors of the non-geometric model, if there is one
    non_geometric: tuple[str, Errors] | None = None

    @property
    def before(self) -> Errors:
        """Errors of the nominal robot on held-out rows, outliers aside."""
        return self.nominal.errors_without_outliers

    @property
    def after(self) -> Errors:
        """Errors of the calibrated robot on held-out rows, outliers aside."""
        return self.calibrated.errors_without_outliers

    # The gain

    @property
    def gain(self) -> float:
        """Mean fall of the squared error on held-out rows, outliers aside, over its standard error."""
        return self._fall_without_outliers[0]

    @property
    def unproven(self) -> bool:
        """True if the gain may be chance."""
        gain, p = self._fall_without_outliers
        return gain <= 0.0 or p > _CHANCE

    @cached_property
    def _fall_without_outliers(self) -> tuple[float, float]:
        """The gain and its p-value on held-out rows, outliers aside; see `_test_fall`."""
        return self._test_fall(with_outliers=False)

    def _test_fall(self, *, with_outliers: bool) -> tuple[float, float]:
        """Test the fall of the error on held-out rows from the nominal to the calibrated robot by Student's t.

        Returned are the mean fall over its standard error, and the one-sided p-value: the probability of such a fall if
        the error does not fall. They are 0 and 1 if no parameter changed or the fall is rounding, the sign of the fall
        and 1 with a single pose. Errors are over the noise (no unit), averaged by pose, and paired by pose. Without
        outliers their squares are tested. With outliers the errors themselves are: a gross outlier then adds no more
        than its correction.
        """
        before = self._by_pose(self.nominal, with_outliers=with_outliers)
        fall = before - self._by_pose(self.calibrated, with_outliers=with_outliers)
        mean = float(np.mean(fall)) if len(fall) else 0.0
        if not self.changes or abs(mean) < _ROUNDING * float(np.mean(before)):
            return 0.0, 1.0
        if len(fall) < 2:
            return float(np.sign(mean)), 1.0
        standard_error = float(np.std(fall, ddof=1)) / float(np.sqrt(len(fall)))
        gain = mean / max(standard_error, _TINY)
        return gain, float(stdtr(len(fall) - 1, -gain))

    def _by_pose(self, validation: CrossValidation, *, with_outliers: bool) -> Array:
        """Average over the repeats of each of K poses, shape (K,): norms of all errors, or squares without outliers.

        Errors are those of a cross-validation, over the noise (no unit); rows without a measured scalar do not count.
        """
        rows = (with_outliers | ~self.outliers) & np.any(self.used, axis=1)
        _, poses = np.unique(validation.poses[rows], return_inverse=True)
        counts = np.maximum(np.bincount(poses), 1)
        errors = self._whitened(validation)[rows]
        if with_outliers:
            errors = np.sqrt(errors)
        return np.asarray(np.bincount(poses, errors) / counts)

    def _whitened(self, validation: CrossValidation) -> Array:
        """Squared error of each row over its noise (``scales``), summed over its measured scalars, shape (N,)."""
        scalars = np.where(self.used, validation.residual / self.scales, 0.0)
        return np.asarray(np.sum(scalars**2, axis=1))

    # What remains

    @property
    def at_noise_level(self) -> bool:
        """True if the nominal robot's error is about the noise that the best model leaves, outliers aside."""
        return self._mean_square(self.nominal) < _AT_THE_NOISE**2 * self._noise_square

    @cached_property
    def remains_held_out(self) -> float:
        """Share of the nominal robot's rms error on held-out rows that remains, noise subtracted from both squares.

        Outliers do not count. The mean of M squared scalars of noise is uncertain by sqrt(2 / M), which is subtracted
        from the calibrated robot's too. Above 1 only if the error grows.
        """
        before, after = self._mean_square(self.nominal), self._mean_square(self.calibrated)
        noise = self._noise_square
        remaining = after - noise * (1.0 + np.sqrt(2.0 / self._scalars))
        return float(np.sqrt(max(remaining, 0.0) / max(before - noise, _TINY)))

    @property
    def free_of_noise(self) -> tuple[float, float]:
        """Rms errors on held-out rows before and after in the first unit, with the noise of all scalars subtracted.

        Their ratio is ``remains_held_out``.
        """
        square = self._mean_square(self.nominal)
        share = max(square - self._noise_square, 0.0) / max(square, _TINY)
        before = self.before.leading.rms * float(np.sqrt(share))
        return before, self.remains_held_out * before

    @property
    def remains_everywhere(self) -> float:
        """Share of the nominal robot's error over the joint limits that is expected to remain, 0 to 1."""
        return self.expected / max(self.expected_of_nominal, self.expected, _TINY)

    @property
    def unpredictable(self) -> bool:
        """True if the error expected over the joint limits, without the scale's, is several times the nominal one."""
        return self._expected_without_scale > _FAR_MORE * self.before.leading.rms

    @property
    def _expected_without_scale(self) -> float:
        """The error expected over the joint limits if the instrument has no scale error [m]."""
        return float(np.sqrt(max(self.expected**2 - self.by_scale**2, 0.0)))

    @property
    def _scalars(self) -> int:
        """Number of measured scalars, outliers aside; at least 1."""
        return max(int(np.sum(self.used[~self.outliers])), 1)

    def _mean_square(self, validation: CrossValidation) -> float:
        """Mean whitened squared error of a scalar by either robot, outliers aside."""
        return float(np.sum(self._whitened(validation)[~self.outliers]) / self._scalars)

    @property
    def _noise_square(self) -> float:
        """The part of the mean whitened squared error that is noise (``floor``)."""
        floor = np.where(self.used, self.floor, 0.0)
        return float(np.sum(floor[~self.outliers] ** 2) / self._scalars)

    # Whether the gain is proven

    @property
    def proven_where_measured(self) -> bool:
        """True if held-out rows prove a gain that is worth having at poses like those measured."""
        falls = self.after.leading.rms < _FALLS * self.before.leading.rms
        little_remains = self.remains_held_out <= REMAINS
        return falls and little_remains and not self.unproven and not self.validation.fall_little

    @property
    def proven(self) -> bool:
        """True if the gain is proven at poses like those measured, and expected over the joint limits."""
        expected = self.remains_everywhere <= REMAINS
        return self.proven_where_measured and expected and not self.handful

    @property
    def scale_decides(self) -> bool:
        """True if the gain is not proven, but would be if the instrument had no scale error."""
        exact = replace(self, expected=self._expected_without_scale, by_scale=0.0)
        return exact.proven and not self.proven

    # Flagged rows

    @property
    def flagged(self) -> int:
        """Number of flagged rows."""
        return int(np.sum(self.outliers))

    @property
    def many_flagged(self) -> bool:
        """True if more rows are flagged than a few accidents."""
        return self.flagged > _MANY_OUTLIERS * len(self.outliers)

    @cached_property
    def accidents(self) -> bool:
        """True if many rows are flagged, hardly farther off than before, and the error of all rows falls.

        Errors are those on held-out rows, before: by the nominal robot. The fall is beyond chance, outliers included.
        """
        if not self.many_flagged:
            return False
        before = np.sum(self._whitened(self.nominal)[self.outliers])
        after = np.sum(self._whitened(self.calibrated)[self.outliers])
        _, p = self._test_fall(with_outliers=True)
        return bool(after < _ALIKE**2 * before) and p < _CHANCE

    @property
    def worse_with_outliers(self) -> bool:
        """True if the error on held-out rows rises when the flagged ones count."""
        before, after = self.nominal.errors.leading.rms, self.calibrated.errors.leading.rms
        return bool(self.flagged) and after > _ALIKE * before

    @property
    def noise_is_plausible(self) -> bool:
        """True if the noise may be the instrument's: no model leaves far less, and few rows are flagged."""
        not_noise = any(doubt.why.group is Group.NOT_NOISE for doubt in self.doubts)
        return not self.many_flagged and not not_noise

    # Numbers of measurements

    @cached_property
    def counts(self) -> dict[str, int]:
        """Numbers of different ``poses``, ``pairs`` of poses, ``images`` if any, and scalars of all (``numbers``).

        Repeats of a measurement count once; the corners of an image count as one pose, and as no more scalars than the
        board's pose has.
        """
        single = np.any(self.used, axis=1) & ~self.pairs
        images = np.zeros(len(self.repeats), dtype=bool) if self.images is None else self.images

        _, first, measurement = np.unique(self.repeats, return_index=True, return_inverse=True)
        of_first = np.sum(self.used[first], axis=1)
        with_outliers = np.bincount(measurement, np.sum(self.used, axis=1))
        of_image = np.minimum(with_outliers, _OF_POSE)

        counts = {
            "poses": len(np.unique(self.repeats[single])),
            "pairs": len(np.unique(self.repeats[self.pairs])),
            "numbers": int(np.sum(np.where(images[first], of_image, of_first))),
        }
        if np.any(images):
            counts["images"] = len(np.unique(self.repeats[images]))
        return counts

    @property
    def most_parameters(self) -> int:
        """Number of parameters of the model, or of a full geometry if that has more."""
        return max(self.parameters, self.full_model_parameters)

    @property
    def handful(self) -> bool:
        """True if there are so few poses that held-out rows prove nothing."""
        return self.counts["poses"] + self.counts["pairs"] < _HANDFUL

    @property
    def few(self) -> bool:
        """True if there are too few scalars for this model."""
        return self.counts["numbers"] < _FEW * self.parameters

    @property
    def few_for_full_model(self) -> bool:
        """True if there are too few scalars for a full geometry."""
        return self.counts["numbers"] < _FEW * self.most_parameters
