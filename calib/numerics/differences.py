"""Comparison of derivatives that a user gives with central differences of the function, at generic samples."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from calib.basics.arrays import Array

#: Relative difference that is allowed: approximate derivatives are this accurate, and wrong ones are off by a term.
_RELATIVE = 1e-3

#: Difference that is allowed if the derivative is zero, in units of the function.
_ABSOLUTE = 1e-6

#: The least share of samples that must agree: kinks, limits and places without a value are not faults, whereas a
#: derivative with a wrong sign or without a term is wrong nearly everywhere.
_SHARE = 0.25


class Disagreement(NamedTuple):
    """The scalar and the parameter at which a derivative differs most, at a typical sample."""

    #: Index of the function's scalar
    scalar: int
    #: Index of the parameter
    parameter: int
    #: The derivative as given
    given: float
    #: The derivative by central differences
    expected: float


def disagreement(given: Array, expected: Array) -> Disagreement | None:
    """Compare a derivative with central differences, at the samples where these are finite.

    Args:
        given: The derivative of s scalars by p parameters at n samples, shape (n, s, p).
        expected: The same by central differences; NaN where the function has no value.

    Returns:
        Where they disagree; None if they agree at a quarter of the samples or more, or if there is nothing to compare.
    """
    has_value = np.isfinite(expected).all(axis=(1, 2))
    given, expected = given[has_value], expected[has_value]
    with np.errstate(invalid="ignore", over="ignore"):
        largest = np.maximum(np.abs(given), np.abs(expected)).max(axis=2, keepdims=True)
        ratio = np.abs(given - expected) / (_RELATIVE * largest + _ABSOLUTE)
    ratio = np.where(np.isfinite(ratio), ratio, np.inf)
    agrees = np.count_nonzero((ratio <= 1.0).all(axis=(1, 2)))
    if agrees >= _SHARE * len(ratio):
        return None
    typical = np.sort(ratio, axis=0)[len(ratio) // 2]
    s, p = (int(i) for i in np.unravel_index(np.argmax(typical), typical.shape))
    sample = np.argsort(ratio[:, s, p])[len(ratio) // 2]
    return Disagreement(s, p, float(given[sample, s, p]), float(expected[sample, s, p]))


def mostly_without_value(values: Array) -> bool:
    """Return True if fewer than a quarter of the samples, shape (n,), have a finite value."""
    return bool(np.mean(np.isfinite(values)) < _SHARE)
