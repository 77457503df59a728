"""Covariances of measured poses: which rows may have one, their checks, columns, and standard deviations."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import ArrayLike

from calib.basics.arguments import numbers
from calib.basics.arrays import Array, Mask, read_only
from calib.data.checks import RowLabels, checked_numbers
from calib.data.columns import COVARIANCE
from calib.data.kinds import SIGMAS, Kind
from calib.errors import MeasurementError
from calib.numerics.correlated_noise import POSE, POSE_UNITS

#: Least and largest entry [m^2, m rad, rad^2].
_ENTRIES = (-(SIGMAS[1] ** 2), SIGMAS[1] ** 2)

#: Difference of a correlation from that of the same two numbers, in digits that a table may have.
_SYMMETRIC = 1e-4

#: The order and the units of the entries, for messages.
_ENTRIES_ARE = "It has x, y, z [m] and the rotations about x, y, z [rad], row by row."


def may_have_covariance(kind: Kind) -> bool:
    """Return True for kinds that measure a position and an orientation, and nothing else."""
    return kind.orientation and kind.units == POSE_UNITS


def checked_covariances(labels: RowLabels, values: ArrayLike | None, poses: Mask) -> Array | None:
    """Return a checked, read-only copy of the covariances of measured poses.

    Args:
        labels: The N rows, for messages.
        values: shape (N, 6, 6) [m^2, m rad, rad^2], NaN in rows without one; None: not given.
        poses: Which rows may have one, shape (N,).

    Returns:
        The covariances, symmetric to the last bit, NaN in other rows; None if no row has one.

    Raises:
        MeasurementError: Another shape, or a matrix that is not symmetric or not positive definite, that lacks some of
            its numbers, or has a standard deviation that no instrument has.
    """
    if values is None:
        return None
    given = numbers("covariances", values, "of shape (N, 6, 6)")
    shape = (len(labels.rows), POSE, POSE)
    if given.shape != shape:
        raise MeasurementError(
            f"{labels.name}: 'covariances' has shape {given.shape} and should have {shape}"
        )
    with_one = ~np.isnan(given).all(axis=(1, 2)) & poses
    checked = checked_numbers(labels, "covariances", given, (POSE, POSE), with_one, _ENTRIES)
    if checked is None:
        return None

    for i in np.flatnonzero(with_one).tolist():
        C = checked[i]
        if not np.any(C):
            labels.fail(i, "the covariance is zero; leave out the columns if it is not known")
        std = np.sqrt(np.maximum(np.diagonal(C), 0.0))
        if not np.all((std >= SIGMAS[0]) & (std <= SIGMAS[1])):
            allowed = f"{SIGMAS[0]:g} to {SIGMAS[1]:g}, in SI units"
            labels.fail(
                i,
                f"a standard deviation of the covariance is not from {allowed}. {_ENTRIES_ARE} Write numbers with an "
                "exponent, 1.234567e-08.",
            )
        correlation = C / np.outer(std, std)
        if np.max(np.abs(correlation - correlation.T)) > _SYMMETRIC:
            labels.fail(i, f"the covariance is not symmetric. {_ENTRIES_ARE}")
        if np.linalg.eigvalsh(0.5 * (correlation + correlation.T))[0] <= 0.0:
            labels.fail(
                i,
                f"the covariance is not positive definite. {_ENTRIES_ARE} Are all entries in this order, and written "
                "with six digits or more?",
            )
    return read_only(0.5 * (checked + checked.transpose(0, 2, 1)))


def sigma_with_covariances(
    sigma: Mapping[str, Array], covariances: Array | None
) -> dict[str, Array]:
    """Return standard deviations by unit, shape (N,): rms over the axes in rows that have a covariance.

    Args:
        sigma: Standard deviations by unit ``"m"``, ``"rad"``, shape (N,) each; kept for rows without a covariance.
        covariances: shape (N, 6, 6) [m^2, m rad, rad^2], NaN in rows without one; None: no row has one.
    """
    result = dict(sigma)
    if covariances is None:
        return result
    variances = np.diagonal(covariances, axis1=1, axis2=2)
    for symbol, of_unit in (("m", variances[:, :3]), ("rad", variances[:, 3:])):
        std = np.sqrt(np.mean(of_unit, axis=1))
        of_others = sigma.get(symbol, np.full(len(std), np.nan))
        result[symbol] = read_only(np.where(np.isfinite(std), std, of_others))
    return result


def covariance_columns(covariances: Array | None) -> Iterator[tuple[str, None, Array]]:
    """Yield name, no unit, and values of the columns of covariances, shape (N, 6, 6); none if there are none."""
    if covariances is not None:
        by_column = covariances.reshape(len(covariances), len(COVARIANCE))
        for name, values in zip(COVARIANCE, by_column.T, strict=True):
            yield name, None, values
