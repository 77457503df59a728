"""Paired test of two models: does one predict held-out poses better than the other, beyond chance?"""

from __future__ import annotations

import numpy as np
from scipy.special import stdtr

from calib.basics.arrays import Array, Mask
from calib.numerics.errors import CrossValidation


def pose_errors(validation: CrossValidation, scales: Array, kept: Mask) -> Array:
    """Return the held-out error of each pose: root mean square over its rows of |residual / scale|.

    Rows that cross-validation held out together (`CrossValidation.poses`) count as one pose.

    Args:
        validation: Held-out residuals of N rows.
        scales: Standard deviation of each scalar, shape (N, D), [m] and [rad].
        kept: True for the rows that count, shape (N,).

    Returns:
        Errors in standard deviations, shape (poses,), in the order of the poses' numbers.
    """
    whitened = validation.residual / scales
    squares = np.sum(whitened[kept] ** 2, axis=1)
    _, pose = np.unique(validation.poses[kept], return_inverse=True)
    return np.sqrt(np.bincount(pose, squares) / np.bincount(pose))


def p_value_of_improvement(improvements: Array) -> float:
    """Return the p-value of a mean improvement over poses: Student's paired t-test, one-sided.

    Args:
        improvements: Error of each pose by the first model minus that by the second, shape (poses,), in any unit;
            above 0 where the second is better.

    Returns:
        Probability of so large a mean, or a larger one, if neither model is better; 1 for fewer than two poses.
    """
    count = len(improvements)
    if count < 2:
        return 1.0
    mean = float(np.mean(improvements))
    std = float(np.std(improvements, ddof=1))
    if not std > 0.0:
        return float(mean <= 0.0)
    t = mean / std * np.sqrt(count)
    return float(stdtr(count - 1, -t))
