"""Choice of the geometry: the candidate of the highest evidence, unless errors on held-out poses contradict.

Two candidates are compared by a paired test: whether one predicts held-out poses better than the other beyond chance.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import stdtr

from calib.basics.arrays import Array, Mask
from calib.fit.selection.candidates import CLEARLY, Candidate
from calib.numerics.errors import CrossValidation

#: Strong evidence: odds of 20 to 1, in log-likelihood.
_STRONG = float(np.log(20.0))

#: Held-out errors contradict the evidence if the p-value of their improvement is below this.
_P_VALUE = 0.1

#: The same against strong evidence.
_P_VALUE_IF_STRONG = 0.01

#: With fewer poses evidence alone decides: held-out errors of non-geometric models are too small, because prior
#: standard deviations are estimated from all poses.
_FEWEST_POSES = 16


def preferred_geometry(candidates: Sequence[Candidate], errors: Sequence[Array]) -> str:
    """Return the name of the candidate with the highest evidence that held-out poses do not contradict.

    They do if the mean error of another one is smaller by `CLEARLY`, and that beyond chance, for which strong evidence
    against the other one asks for a smaller p-value.

    Args:
        candidates: One or more models of the same rows.
        errors: Of each candidate the held-out error of each pose, shape (poses,), see `pose_errors`.
    """

    def contradicts(other: int, best: int) -> bool:
        """True if held-out poses prefer another candidate to the best so far, clearly and beyond chance."""
        if not np.mean(errors[other]) < (1.0 - CLEARLY) * np.mean(errors[best]):
            return False
        strong = candidates[best].evidence - candidates[other].evidence > _STRONG
        limit = _P_VALUE_IF_STRONG if strong else _P_VALUE
        return p_value_of_improvement(errors[best] - errors[other]) < limit

    best = max(range(len(candidates)), key=lambda k: candidates[k].evidence)
    while len(errors[best]) >= _FEWEST_POSES:
        better = [k for k in range(len(candidates)) if contradicts(k, best)]
        if not better:
            break
        best = min(better, key=lambda k: float(np.mean(errors[k])))
    return candidates[best].name


def pose_errors(validation: CrossValidation, scales: Array, kept: Mask) -> Array:
    """Return the held-out error of each pose: root mean square over its rows of |residual / scale|.

    Rows that cross-validation held out together (`CrossValidation.poses`) count as one pose.

    Args:
        validation: Held-out residuals of N rows.
        scales: Standard deviation of each scalar, shape (N, D), in the units of the rows' channels.
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
