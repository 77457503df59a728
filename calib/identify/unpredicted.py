"""Set-ups that the others do not predict.

A set-up is predicted by a fit to all the others, its own nuisance (measurement frame, target) registered anew. With C
the covariance of the parameters of that fit and A their regressors in the set-up, its whitened residual r has the
covariance I + A C A^T when nothing is wrong, and

    F = (r^T W r / freedom) / noise,   W = (I + A C A^T)^-1, less what the nuisance takes up,

follows Fisher's distribution with the degrees of freedom of both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from calib.identify.significance import CUT, norms_of, range_of

Array = NDArray[np.float64]

#: The probability that set-ups which are alike give any finding.
_FALSE_ALARM = 0.01

#: A set-up is named when its errors are this much larger than the noise: less does not matter.
_MATTERS = 1.5


@dataclass(frozen=True, slots=True)
class UnpredictedSetup:
    """A set-up that the others do not predict.

    Attributes:
        name: The set-up.
        F: Fisher's ratio.
        p: Probability of such a ratio or a larger one by chance.
        ratio: Its errors over those expected, root mean square.
    """

    name: str
    F: float
    p: float
    ratio: float

    def sentence(self) -> str:
        """The finding in plain words."""
        return (
            f"The other set-ups do not predict set-up '{self.name}': a fit without it leaves errors there "
            f"{self.ratio:.1f} times those expected. Did the arm, its tool or the instrument change in between?"
        )


def unpredicted_setup(
    names: Sequence[str],
    squares: Array,
    freedoms: Array,
    noise_squares: Array,
    noise_freedoms: Array,
) -> tuple[UnpredictedSetup, ...]:
    """The set-ups whose errors are larger than the noise, beyond chance and by a factor that matters.

    Args:
        names: G set-ups.
        squares: shape (G,), sum of whitened squares under the fit to the others, see `prediction_square`.
        freedoms: shape (G,), its degrees of freedom: scalars less the set-up's own nuisance parameters.
        noise_squares: shape (G,) or (), estimated variance of a whitened scalar, best from the fit to the others: one
            that saw the set-up is larger for its errors.
        noise_freedoms: shape (G,) or (), its degrees of freedom.

    Returns:
        The findings, the surest first; with all set-ups alike there is any with a probability below 1 %.
    """
    count = len(names)
    noise = np.broadcast_to(noise_squares, (count,))
    noise_freedom = np.broadcast_to(noise_freedoms, (count,))
    testable = (freedoms > 0.0) & (noise_freedom > 0.0) & (noise > 0.0)
    found = []
    for i, name in enumerate(names):
        if not testable[i]:
            continue
        F = float(squares[i] / freedoms[i] / noise[i])
        p = float(fdtrc(freedoms[i], noise_freedom[i], F))
        if p < _FALSE_ALARM / int(testable.sum()) and F > _MATTERS**2:
            found.append(UnpredictedSetup(name, F, p, float(np.sqrt(F))))
    return tuple(sorted(found, key=lambda s: (s.p, -s.F)))


def prediction_square(r: Array, A: Array, covariance: Array, nuisance: Array) -> tuple[float, int]:
    """Sum of squares of a set-up's residual, in units of its prediction's own uncertainty, and its degrees of freedom.

    Args:
        r: shape (M,), whitened residual of the set-up under the fit to the others.
        A: shape (M, p), whitened regressors of the parameters that the others know.
        covariance: shape (p, p), of these parameters in that fit, for whitened scalars of variance 1.
        nuisance: shape (M, k), whitened regressors of what the set-up has to itself, of any rank; the residual may be
            taken at any value of it near enough to be linear.

    Returns:
        The sum and M less the rank of the nuisance.
    """
    whitened = _whitened(A, covariance, np.column_stack([r, nuisance]))
    base = range_of(whitened[:, 1:], norms_of(whitened[:, 1:]), CUT)
    rest = whitened[:, 0] - base @ (base.T @ whitened[:, 0])
    return float(rest @ rest), len(r) - base.shape[1]


def _whitened(A: Array, covariance: Array, values: Array) -> Array:
    """Values times a symmetric root of (I + A C A^T)^-1, whose other directions than A's own stay as they are.

    With A C^(1/2) = U S V^T that is I + U ((1 + S^2)^(-1/2) - 1) U^T: no matrix of all scalars by all is made.

    Args:
        A: shape (M, p).
        covariance: shape (p, p), C.
        values: shape (M, k).
    """
    sizes, vectors = np.linalg.eigh(covariance)
    moved = A @ (vectors * np.sqrt(np.maximum(sizes, 0.0)))
    U, S, _ = np.linalg.svd(moved, full_matrices=False)
    shrunk = 1.0 / np.sqrt(1.0 + S**2) - 1.0
    return np.asarray(values + U @ (shrunk[:, None] * (U.T @ values)))
