"""Choice of the geometry: the candidate of the highest evidence, unless errors on held-out poses contradict."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.basics.arrays import Array
from calib.fit.selection.candidates import CLEARLY, Candidate
from calib.fit.selection.pose_errors import p_value_of_improvement

#: Strong evidence: odds of 20 to 1, in log-likelihood.
_STRONG = float(np.log(20.0))

#: Held-out errors contradict the evidence where the p-value of their improvement is below this.
_P_VALUE = 0.1

#: The same against strong evidence.
_P_VALUE_IF_STRONG = 0.01

#: With fewer poses evidence alone decides: held-out errors of non-geometric models are too small, because prior
#: standard deviations are estimated from all poses.
_FEWEST_POSES = 16


def preferred_geometry(candidates: Sequence[Candidate], errors: Sequence[Array]) -> str:
    """Return the name of the candidate with the highest evidence that held-out poses do not contradict.

    They do where the mean error of another one is smaller by `CLEARLY`, and that beyond chance: with a p-value of
    less than `_P_VALUE`, or than `_P_VALUE_IF_STRONG` where there is strong evidence against the other one.

    Args:
        candidates: One or more models of the same rows.
        errors: Of each candidate the held-out error of each pose, shape (poses,), see `pose_errors`.
    """
    best = max(range(len(candidates)), key=lambda k: candidates[k].evidence)
    while len(errors[best]) >= _FEWEST_POSES:
        better = [k for k in range(len(candidates)) if _contradicts(candidates, errors, best, k)]
        if not better:
            break
        best = min(better, key=lambda k: float(np.mean(errors[k])))
    return candidates[best].name


def _contradicts(
    candidates: Sequence[Candidate],
    errors: Sequence[Array],
    best: int,
    other: int,
) -> bool:
    """Tell if held-out poses prefer another candidate, clearly and beyond chance.

    Args:
        candidates: All candidates.
        errors: Of each the held-out error of each pose, shape (poses,).
        best: Index of the candidate that is preferred so far.
        other: Index of the other one.
    """
    smaller = np.mean(errors[other]) < (1.0 - CLEARLY) * np.mean(errors[best])
    if not smaller:
        return False
    strong = candidates[best].evidence - candidates[other].evidence > _STRONG
    limit = _P_VALUE_IF_STRONG if strong else _P_VALUE
    return p_value_of_improvement(errors[best] - errors[other]) < limit
