"""Residuals that are not noise: what else explains them, beyond the regressors of the fit.

The residual r of a fit with regressors A is looked at in the space that A cannot reach. With Q an orthonormal basis of
A's range and r' = r - Q Q^T r, further regressors Z, less what Q reaches of them, explain the square S of r':

    F = (S / rank Z') / ((|r'|^2 - S) / (M - rank A - rank Z'))

r' does not depend on where in A's range the fit stopped, so that priors on the parameters do not matter, and F follows
Fisher's distribution exactly when the rest is normal noise. Scalars of weight 0 are no measurements and are left out
before. Repeats of a pose share what the model lacks there: their mean is one measurement, not many.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, fdtrc

Array = NDArray[np.float64]
Integers = NDArray[np.int_]

#: The probability that a table with nothing but noise gives any finding.
FALSE_ALARM = 0.01

#: Directions whose singular value is below this, columns of norm 1, are not in the range of a matrix.
_CUT = 1e-6

#: The same for what repeats of a pose change in the regressors: joint values repeat to `1e-3` only.
_CUT_WITHIN = 1e-2

#: Rounds in which the components' noise is found.
_ROUNDS = 4

#: In each round a component's noise is taken as at least this share of the largest.
_UNEVEN = 0.01

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


@dataclass(frozen=True, slots=True)
class JointPattern:
    """Residuals that follow the value of a joint.

    Attributes:
        joint: Its name.
        prismatic: Whether it slides.
        test: How much of the residual the pattern explains.
    """

    joint: str
    prismatic: bool
    test: Explained

    def sentence(self) -> str:
        """The finding in plain words."""
        of = "its value and its square" if self.prismatic else "its sine and cosine"
        return (
            f"What the model leaves over is not noise: it follows '{self.joint}', {of} explain "
            f"{_percent(self.test)}."
        )


@dataclass(frozen=True, slots=True)
class Drift:
    """Residuals that change steadily from the first row to the last.

    Attributes:
        p: Probability of such a drift or a stronger one by chance.
        test: How much of the residual it explains: between poses, or within repeats where that shows it better.
    """

    p: float
    test: Explained

    def sentence(self) -> str:
        """The finding in plain words."""
        return (
            "What the model leaves over is not noise: it drifts in the order of the rows, which explains "
            f"{_percent(self.test)}. Did the arm or the instrument warm up, or something move?"
        )


def explained(A: Array, r: Array, Z: Array, *, cut: float = _CUT) -> Explained:
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
    return _test(_range(A, _norms(A), cut), r, Z, _norms(Z), lost=0)


def joint_patterns(
    A: Array,
    r: Array,
    row_of: Integers,
    component_of: Integers,
    joints: Array,
    joint_names: Sequence[str],
    prismatic: Sequence[bool],
    *,
    directions: Sequence[Array] | None = None,
    poses: Integers | None = None,
    scale: Array | None = None,
) -> tuple[JointPattern, ...]:
    """The joints whose value the residuals follow, beyond a constant of each component.

    For each joint the regressors are functions of its value times directions. The functions are sin q and cos q; q and
    q^2 where it slides. The directions are the components; better those in which the joint moves the point, since
    an error that turns with the arm averages out along fixed axes. A table with nothing but noise gives any finding
    with a probability of 1 % or less.

    Args:
        A: shape (M, p), regressors of the fit, whitened.
        r: shape (M,), whitened residual, the rows' scalars in a stack.
        row_of: shape (M,), the row of each scalar.
        component_of: shape (M,), which coordinate it is.
        joints: shape (N, m), joint values of the rows [rad or m].
        joint_names: m names.
        prismatic: Whether each of the m joints slides.
        directions: For each joint shape (M, k), what displacements of it do to the scalars, whitened: its regressors of
            A, the one about its axis alone or more; q itself is then one more function where it turns. None: the
            components.
        poses: shape (N,), the pose of each row; repeats of one count as one. None: each row is a pose of its own.
        scale: shape (M,), what each scalar was multiplied by to whiten it, 0 where it does not count; None: the same
            for all.

    Returns:
        The findings, the surest first.
    """
    stack = _Stack.of(A, r, row_of, component_of, scale)
    cells = np.arange(len(stack.r)) if poses is None else stack.cells(poses)
    A, r = _sums_over(cells, np.column_stack([stack.A, stack.ones])), _sums_over(cells, stack.r)
    even = _even(A, r, _first_of(cells, stack.component_of))
    base = _range(A * even[:, None], _norms(A * even[:, None]), _CUT)
    found = []
    for i, (name, slides) in enumerate(zip(joint_names, prismatic, strict=True)):
        functions = _functions(joints[:, i], slides, gain=directions is not None)
        Z = stack.times(functions, None if directions is None else directions[i])
        Z = even[:, None] * _sums_over(cells, Z)
        test = _test(base, even * r, Z, _norms(Z), lost=0)
        if test.p < FALSE_ALARM / len(joint_names):
            found.append(JointPattern(name, bool(slides), test))
    return tuple(sorted(found, key=lambda f: (f.test.p, -f.test.F)))


def drift(
    A: Array,
    r: Array,
    row_of: Integers,
    component_of: Integers,
    order: Array,
    *,
    poses: Integers | None = None,
    scale: Array | None = None,
) -> Drift | None:
    """Whether the residuals drift in the order of the rows, beyond a constant of each component.

    Where poses were repeated the drift between poses and that within the repeats of a pose are tested apart, and their
    probabilities combined by Fisher's method: that holds however much of the residual the repeats share.

    Args:
        A: shape (M, p), regressors of the fit, whitened.
        r: shape (M,), whitened residual, the rows' scalars in a stack.
        row_of: shape (M,), the row of each scalar.
        component_of: shape (M,), which coordinate it is.
        order: shape (N,), when each row was measured, say 0 to 1.
        poses: As for `joint_patterns`.
        scale: As for `joint_patterns`.

    Returns:
        The drift, or None where there is none that chance would not give in 1 % of the tables.
    """
    stack = _Stack.of(A, r, row_of, component_of, scale)
    Z = stack.times(order[:, None] - np.mean(order))
    cells = np.arange(len(stack.r)) if poses is None else stack.cells(poses)
    tests = [_between(cells, stack, Z), _within(cells, stack, Z)]
    tests = [test for test in tests if test.columns]
    if not tests:
        return None
    logarithms = [-2.0 * np.log(max(test.p, np.finfo(float).tiny)) for test in tests]
    p = tests[0].p if len(tests) == 1 else float(chdtrc(2.0 * len(tests), sum(logarithms)))
    return Drift(p, min(tests, key=lambda test: test.p)) if p < FALSE_ALARM else None


@dataclass(frozen=True, slots=True, eq=False)
class _Stack:
    """The scalars that count: regressors, residual, row, component, and what each was multiplied by."""

    A: Array
    r: Array
    row_of: Integers
    component_of: Integers
    keep: NDArray[np.bool_]
    ones: Array

    @classmethod
    def of(
        cls, A: Array, r: Array, row_of: Integers, component_of: Integers, scale: Array | None
    ) -> _Stack:
        """Without the scalars of scale 0."""
        scale = np.ones(len(r)) if scale is None else scale
        keep = scale > 0.0
        _, component = np.unique(component_of[keep], return_inverse=True)
        indicators = np.eye(int(component.max(initial=-1)) + 1)[component]
        ones = indicators * scale[keep, None]
        return cls(A[keep], r[keep], row_of[keep], component, keep, ones)

    def times(self, functions: Array, directions: Array | None = None) -> Array:
        """Functions of the row (N, f), each times each direction, by default the components: (M, f k)."""
        along = self.ones if directions is None else directions[self.keep]
        product = functions[self.row_of][:, :, None] * along[:, None, :]
        return product.reshape(len(self.r), -1)

    def cells(self, poses: Integers) -> Integers:
        """A number for each pair of pose and component, shape (M,)."""
        pairs = np.column_stack([poses[self.row_of], self.component_of])
        _, cells = np.unique(pairs, axis=0, return_inverse=True)
        return np.asarray(cells).reshape(-1)


def _functions(q: Array, slides: bool, gain: bool) -> Array:
    """The functions of a joint's value that residuals may follow, shape (N, 2) or (N, 3)."""
    # Centred and of size 1, so that q and q^2 do not look alike.
    middle = q - np.mean(q)
    middle = middle / max(float(np.max(np.abs(middle), initial=0.0)), np.finfo(float).tiny)
    if slides:
        return np.column_stack([middle, middle**2])
    return np.column_stack([np.sin(q), np.cos(q), *([middle] if gain else [])])


def _even(A: Array, r: Array, component_of: Integers) -> Array:
    """What makes the residual of each component equally large, shape (M,).

    An instrument that sees depth worse than the rest would otherwise raise many false alarms. With the factors right,
    the expected square of each scalar is what the regressors leave of its freedom, 1 - h.
    """
    count = int(component_of.max(initial=-1)) + 1
    factors = np.ones(len(r))
    for _ in range(_ROUNDS if count > 1 else 0):
        weighted = A * factors[:, None]
        base = _range(weighted, _norms(weighted), _CUT)
        rest = factors * r - base @ (base.T @ (factors * r))
        squares = np.bincount(component_of, rest**2, count)
        freedom = np.bincount(component_of, 1.0 - np.sum(base**2, axis=1), count)
        variances = squares / np.maximum(freedom, _ROUNDING)
        largest = float(variances.max())
        if not largest > 0.0:
            break
        factors = factors / np.sqrt(np.maximum(variances, _UNEVEN**2 * largest))[component_of]
    return factors


def _between(cells: Integers, stack: _Stack, Z: Array) -> Explained:
    """The test on the means of repeats."""
    A, r = _sums_over(cells, np.column_stack([stack.A, stack.ones])), _sums_over(cells, stack.r)
    even = _even(A, r, _first_of(cells, stack.component_of))
    return explained(A * even[:, None], r * even, _sums_over(cells, Z) * even[:, None])


def _within(cells: Integers, stack: _Stack, Z: Array) -> Explained:
    """The test on what differs between repeats."""
    r, Z_within = _centred(cells, stack.r), _centred(cells, Z)
    # Every cell loses one degree of freedom: its mean.
    counts = np.bincount(cells)[cells]
    squares = np.bincount(stack.component_of, r**2)
    freedom = np.bincount(stack.component_of, 1.0 - 1.0 / counts)
    variances = squares / np.maximum(freedom, _ROUNDING)
    largest = float(variances.max(initial=0.0))
    if not largest > 0.0:
        return Explained(0.0, 1.0, 0.0, 0.0, 0, 0)
    even = 1.0 / np.sqrt(np.maximum(variances, _UNEVEN**2 * largest))[stack.component_of]
    A = stack.A * even[:, None]
    base = _range(_centred(cells, A), _norms(A), _CUT_WITHIN)
    Z = Z * even[:, None]
    lost = int(cells.max(initial=-1)) + 1
    return _test(base, even * r, even[:, None] * Z_within, _norms(Z), lost)


def _first_of(cells: Integers, labels: Integers) -> Integers:
    """The label of each cell, which its members share."""
    _, first = np.unique(cells, return_index=True)
    return labels[first]


def _sums_over(cells: Integers, values: Array) -> Array:
    """Sums over each cell over the root of its count: means, whitened like their rows when those are independent."""
    if not len(cells):
        return values
    counts = np.bincount(cells)
    order, starts = np.argsort(cells, kind="stable"), np.cumsum(counts) - counts
    sums = np.add.reduceat(values[order], starts, axis=0)
    result: Array = (sums.T / np.sqrt(counts)).T
    return result


def _centred(cells: Integers, values: Array) -> Array:
    """Values less the mean of their cell."""
    means = (_sums_over(cells, values).T / np.sqrt(np.bincount(cells))).T
    result: Array = values - means[cells]
    return result


def _norms(A: Array) -> Array:
    """The norm of each column, 1 where it is 0."""
    norms = np.linalg.norm(A, axis=0)
    return np.where(norms > 0.0, norms, 1.0)


def _range(A: Array, sizes: Array, cut: float) -> Array:
    """Orthonormal basis of the numerical range of A / sizes, shape (M, rank)."""
    if 0 in A.shape:
        return np.zeros((len(A), 0))
    vectors, values, _ = np.linalg.svd(A / sizes, full_matrices=False)
    result: Array = vectors[:, values > cut]
    return result


def _test(base: Array, r: Array, Z: Array, sizes: Array, lost: int) -> Explained:
    """The F test beyond an orthonormal base, where `lost` degrees of freedom were taken before."""
    rest = r - base @ (base.T @ r)
    # Twice is enough to be orthogonal to rounding, where Z almost lies in the range of the base.
    Z = Z - base @ (base.T @ Z)
    further = _range(Z - base @ (base.T @ Z), sizes, _CUT)
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


def _percent(test: Explained) -> str:
    """The share explained, beside what chance explains."""
    return f"{100 * test.share:.0f} % of it (chance: {100 * test.chance:.0f} %, p = {test.p:.1g})"
