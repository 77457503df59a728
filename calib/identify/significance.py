"""What further regressors explain of a residual, beyond the regressors of the fit.

The residual r of a fit with regressors A is looked at in the space that A cannot reach. With Q an orthonormal basis of
A's range and r' = r - Q Q^T r, further regressors Z, less what Q reaches of them, explain the square S of r':

    F = (S / rank Z') / ((|r'|^2 - S) / (M - rank A - rank Z'))

r' does not depend on where in A's range the fit stopped, so that priors on the parameters do not matter, and F follows
Fisher's distribution exactly when the rest is normal noise of one variance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

Array = NDArray[np.float64]
Integers = NDArray[np.int_]

#: Directions whose singular value is below this, columns of norm 1, are not in the range of a matrix.
CUT = 1e-6

#: Rounds in which the components' noise is found.
_ROUNDS = 4

#: In each round a component's noise is taken as at least this share of the largest.
_UNEVEN = 0.01

#: Degrees of freedom below this are rounding.
_SOME_FREEDOM = 1e-6

#: A residual below this share of what was there before is rounding.
_ROUNDING = 1e-12


@dataclass(frozen=True, slots=True)
class Explained:
    """What further regressors explain of a residual.

    Attributes:
        F: Fisher's ratio; 0 where there is nothing to test.
        p: Probability of such a ratio or a larger one by chance; 1 where there is nothing to test.
        share: Part of the residual's square that they explain, 0 to 1, beyond the range of the fit's regressors.
        chance: The part that as many random regressors explain on average.
        columns: Number of independent further regressors.
        freedom: Degrees of freedom of what is left after them.
    """

    F: float
    p: float
    share: float
    chance: float
    columns: int
    freedom: int

    def __str__(self) -> str:
        """The share explained, beside what chance explains."""
        p = "p < 1e-6" if self.p < 1e-6 else f"p = {self.p:.1g}"
        return f"{100 * self.share:.0f} % of it (chance: {100 * self.chance:.0f} %, {p})"


def explained(A: Array, r: Array, Z: Array, *, cut: float = CUT) -> Explained:
    """Whether further regressors explain more of a residual than chance; the module's text has the equation.

    Args:
        A: shape (M, p), regressors of the fit, whitened like r; of any rank.
        r: shape (M,), whitened residual: independent, of one variance.
        Z: shape (M, k), further regressors, whitened like r; of any rank.
        cut: Singular values below it count as zero, the columns scaled to norm 1.

    Example:
        >>> t = np.linspace(-1.0, 1.0, 50)
        >>> noise = np.random.default_rng(0).normal(size=50)
        >>> explained(np.ones((50, 1)), noise + 2.0 * t, t[:, None]).p < 1e-6
        True
    """
    return f_test(range_of(A, norms_of(A), cut), r, Z, norms_of(Z), lost=0)


def even_factors(A: Array, r: Array, component_of: Integers) -> Array:
    """What makes the residual of each component equally large, shape (M,).

    An instrument that sees depth worse than the rest would otherwise raise many false alarms. With the factors right,
    the expected square of each scalar is what the regressors leave of its freedom, 1 - h.
    """
    count = int(component_of.max(initial=-1)) + 1
    factors = np.ones(len(r))
    for _ in range(_ROUNDS if count > 1 else 0):
        weighted = A * factors[:, None]
        base = range_of(weighted, norms_of(weighted), CUT)
        rest = factors * r - base @ (base.T @ (factors * r))
        squares = sums_by(component_of, rest**2, count)
        freedom = sums_by(component_of, 1.0 - np.sum(base**2, axis=1), count)
        factors = factors * levelled(squares, freedom)[component_of]
    return factors


def levelled(squares: Array, freedom: Array) -> Array:
    """Factors that bring sums of squares to one variance a degree of freedom, shape (components,).

    1 for all where none has any; a component without degrees of freedom is taken for one like the largest.
    """
    known = freedom > _SOME_FREEDOM
    variances = np.where(known, squares / np.where(known, freedom, 1.0), 0.0)
    largest = float(variances.max(initial=0.0))
    if not largest > 0.0:
        return np.ones(len(squares))
    variances = np.where(known, np.maximum(variances, _UNEVEN**2 * largest), largest)
    result: Array = 1.0 / np.sqrt(variances)
    return result


def sums_by(labels: Integers, values: Array, count: int) -> Array:
    """Sums of values over each of a number of labels, shape (count,)."""
    return np.bincount(labels, values, count).astype(np.float64)


def norms_of(A: Array) -> Array:
    """The norm of each column, 1 where it is 0."""
    norms = np.linalg.norm(A, axis=0)
    return np.where(norms > 0.0, norms, 1.0)


def range_of(A: Array, sizes: Array, cut: float) -> Array:
    """Orthonormal basis of the numerical range of A / sizes, shape (M, rank)."""
    if 0 in A.shape:
        return np.zeros((len(A), 0))
    vectors, values, _ = np.linalg.svd(A / sizes, full_matrices=False)
    result: Array = vectors[:, values > cut]
    return result


def f_test(base: Array, r: Array, Z: Array, sizes: Array, lost: int) -> Explained:
    """The F test beyond an orthonormal base, where `lost` degrees of freedom were taken before."""
    rest = r - base @ (base.T @ r)
    # Twice is enough to be orthogonal to rounding, where Z almost lies in the range of the base.
    Z = Z - base @ (base.T @ Z)
    further = range_of(Z - base @ (base.T @ Z), sizes, CUT)
    square = float(rest @ rest)
    before = len(r) - base.shape[1] - lost
    columns, freedom = further.shape[1], before - further.shape[1]
    if columns == 0 or freedom < 1 or square <= _ROUNDING**2 * float(r @ r):
        return Explained(0.0, 1.0, 0.0, 0.0, 0, max(before, 0))
    share = min(float(np.sum((further.T @ rest) ** 2)) / square, 1.0)
    # An exact fit leaves nothing to compare with.
    F = share / columns / max((1.0 - share) / freedom, np.finfo(float).tiny)
    p = float(fdtrc(columns, freedom, F))
    return Explained(F, p, share, columns / before, columns, freedom)
