"""F tests of patterns in residuals: additional regressors explain no more of noise than by chance.

Let r' and Z' be the residual and additional regressors Z, projected on what is orthogonal to the fit's regressors A,
and S the sum of squares of r' that Z' explain. Then

    F = (S / rank Z') / ((|r'|^2 - S) / (M - rank A - rank Z'))

Repeats of a pose share what the model lacks there: their mean is one measurement.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, fdtrc

from calib.basics.arrays import Array, Integers

#: The probability that a table of pure noise gives any pattern or drift; a few of a thousand tables do.
FALSE_ALARM = 0.003

#: Directions whose singular value is below this, for columns of norm 1, are not in the range of a matrix.
_CUT = 1e-6

#: Columns of norm 1 of whose product the eigenvalues are above this are as well made orthogonal by these.
_WELL_CONDITIONED = 1e-3

#: A column of which more than this share of the square is in a range loses digits when that is taken out.
_NEARLY_ALONG = 0.99

#: The same limit for differences of regressors between repeats of a pose: joint values repeat to `1e-3` only.
_CUT_WITHIN = 1e-2

#: Rounds in which the noise of the components is estimated; it changes by less than a percent after these.
_ROUNDS = 4

#: The noise of a component is taken as at least this share of the largest.
_UNEVEN = 0.01

#: The fewest rows before and after a step.
_SIDE = 3

#: About how many rows are tried for a step, before all around the best.
_TRIED = 60

#: Then it is looked for so many times closer about the best of these, until it is found to the row.
_CLOSER = 20

#: Degrees of freedom below this are rounding.
_SOME_FREEDOM = 1e-6

#: A projected residual below this share of the residual is rounding.
_ROUNDING = 1e-12


@dataclass(frozen=True, slots=True)
class Explained:
    """Result of an F test of additional regressors; F is 0 and p is 1 if there is nothing to test."""

    #: The statistic
    F: float
    #: Its p-value if the residual is noise
    p: float
    #: Share of the sum of squares of the projected residual that they explain, 0 to 1
    share: float
    #: Share that as many random regressors explain on average
    chance: float
    #: Number of independent additional regressors
    columns: int
    #: Degrees of freedom that remain
    freedom: int

    @property
    def values(self) -> dict[str, float]:
        """The values ``share``, ``chance`` and ``p`` of a reason that reports the test."""
        return {"share": self.share, "chance": self.chance, "p": self.p}


@dataclass(frozen=True, slots=True, eq=False)
class Stack:
    """M whitened scalars of a fit to N rows, of variance 1 if the model is complete."""

    #: (M, p), whitened regressors of the fit
    A: Array
    #: (M,), whitened residual, measured minus predicted
    r: Array
    #: (M,), the row of each scalar, from 0
    row_of: Integers
    #: (M,), the column of each scalar among the D of its row, from 0
    component_of: Integers
    #: (M, components), whitened, a constant of each component
    ones: Array
    #: (N,), the pose of each row: rows of one number are repeats
    poses: Integers

    @property
    def cells(self) -> Integers:
        """A number for each pair of pose and component, shape (M,)."""
        pairs = np.column_stack([self.poses[self.row_of], self.component_of])
        _, cell_of = np.unique(pairs, axis=0, return_inverse=True)
        return np.asarray(cell_of).reshape(-1)

    def beyond(self, *Z: Array) -> Stack:
        """Copy with additional whitened regressors Z, (M, k) each, of the fit."""
        return replace(self, A=np.column_stack([self.A, *Z]))

    def times(self, functions: Array, directions: Array) -> Array:
        """Multiply functions of the row with directions of the scalars.

        Args:
            functions: Values of f functions at the rows, shape (N, f).
            directions: Whitened derivatives of the scalars, shape (M, k).

        Returns:
            Regressors: each function times each direction, shape (M, f k).
        """
        product = functions[self.row_of][:, :, None] * directions[:, None, :]
        return np.asarray(product.reshape(len(self.r), -1))


def joint_patterns(
    stack: Stack,
    joints: Array,
    prismatic: Sequence[bool],
    directions: Sequence[Array],
) -> list[tuple[int, Explained, Array]]:
    """Find the joints on whose values the residuals depend, beyond a constant of each component.

    The regressors are sin q, cos q and q, or q and q^2 if a joint slides, times the directions. A table of pure
    noise gives any with the probability `FALSE_ALARM`.

    Args:
        stack: The whitened scalars.
        joints: Values of m joints at the rows, shape (N, m) [rad] or [m].
        prismatic: Whether each joint slides.
        directions: Whitened derivatives of the scalars by displacements of each joint, shape (M, k) each.

    Returns:
        Number, from 0, test and regressors (M, f k) of each such joint, the surest first; empty if there is none. The
        test is of the means of repeats of each pose.
    """
    if not len(stack.r):
        return []
    test = _between(stack)
    of_joints = zip(joints.T, prismatic, directions, strict=True)
    patterns = []
    for i, (q, slides, along) in enumerate(of_joints):
        functions = functions_of_joint(q, slides=slides)
        Z = stack.times(functions, along)
        explained = test(Z)
        if explained.p < FALSE_ALARM / len(prismatic):
            patterns.append((i, explained, Z))
    return sorted(patterns, key=lambda pattern: (pattern[1].p, -pattern[1].F))


def functions_of_joint(q: Array, *, slides: bool) -> Array:
    """Functions of a joint's value of which its errors are combinations.

    Args:
        q: Its value at the rows, shape (N,) [rad] or [m].
        slides: Whether it is prismatic.

    Returns:
        sin q, cos q and s, shape (N, 3), or s and s^2, shape (N, 2), with s = q less its mean, divided by its largest
        magnitude.
    """
    # Centred and of size 1, so that q and q^2 do not look alike.
    centred = q - np.mean(q)
    largest = float(np.max(np.abs(centred), initial=0.0))
    scaled = centred / max(largest, np.finfo(float).tiny)
    if slides:
        return np.column_stack([scaled, scaled**2])
    return np.column_stack([np.sin(q), np.cos(q), scaled])


def drift(stack: Stack, order: Array) -> Explained | None:
    """Test for a drift of the residuals in the order of the rows.

    Args:
        stack: The whitened scalars.
        order: Time or place of each row in the order, in any unit, shape (N,).

    Returns:
        The test of a drift of each component that is proportional to the order; None if it may be chance.
    """
    if not len(stack.r):
        return None
    Z = stack.times(order[:, None] - np.mean(order), stack.ones)
    explained = _combined(stack)(Z)
    if explained.p < FALSE_ALARM:
        return explained
    return None


def lag(stack: Stack, moves: Array) -> tuple[Array, Explained] | None:
    """Estimate the share of its last move that each joint misses.

    Args:
        stack: The whitened scalars.
        moves: Whitened effect on the scalars of the last move of each of k joints, shape (M, k).

    Returns:
        The share of its move that each joint misses, shape (k,), positive if it stops short; and the test of all
        together. None if the lag may be chance.
    """
    if not len(stack.r):
        return None
    explained = _combined(stack)(moves)
    if explained.p >= FALSE_ALARM:
        return None
    shares = -_fit_beside(stack, moves)
    return shares, explained


def _fit_beside(stack: Stack, Z: Array) -> Array:
    """Return the coefficients (k,) of additional whitened regressors (M, k), by least squares with the stack's."""
    coefficients, *_ = np.linalg.lstsq(np.column_stack([stack.A, Z]), stack.r, rcond=None)
    return np.asarray(coefficients[-Z.shape[1] :])


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """A step in the residuals: from some row on they are displaced."""

    #: The first displaced row, from 0
    row: int
    #: (k,), the displacement, in the units of the directions
    by: Array
    #: The p-value is corrected for the number of rows tried
    test: Explained
    #: (M, k), its regressors
    Z: Array

    @property
    def size(self) -> float:
        """Norm of the displacement."""
        return float(np.linalg.norm(self.by))


def step(stack: Stack, rows: Integers, along: Array) -> Step | None:
    """Find the row from which on the residuals are displaced.

    Args:
        stack: The M whitened scalars of N rows.
        rows: Numbers, from 0 to N - 1, of the rows among which to look, ascending, shape (K,).
        along: Whitened derivatives of the scalars by the displacement, shape (M, k).

    Returns:
        The step; None if it may be chance, or if there are too few rows for some on either side.
    """
    most = len(rows) - _SIDE
    if most < _SIDE:
        return None
    test = _combined(stack)
    number = np.arange(len(stack.poses))[:, None]
    tried: dict[int, Explained] = {}

    def regressors(k: int) -> Array:
        """Regressors (M, k) of a step from row ``rows[k]`` on."""
        is_later = 1.0 * (number >= rows[k])
        return stack.times(is_later, along)

    def best_of(places: Iterable[int]) -> int:
        """Try these places in ``rows`` too, and return the best of all that were tried."""
        for k in places:
            tried[k] = test(regressors(k))
        return min(tried, key=lambda k: (tried[k].p, -tried[k].F))

    stride = max((most - _SIDE) // _TRIED, 1)
    best = best_of(range(_SIDE, most + 1, stride))
    # Closer and closer about the best: the residuals fall off to both sides of a step.
    while stride > 1:
        first, last = max(best - stride + 1, _SIDE), min(best + stride - 1, most)
        stride = max(stride // _CLOSER, 1)
        best = best_of(range(first, last + 1, stride))
    corrected = min(tried[best].p * (most - _SIDE + 1), 1.0)
    if corrected >= FALSE_ALARM:
        return None
    Z = regressors(best)
    return Step(
        row=int(rows[best]),
        by=_fit_beside(stack, Z),
        test=replace(tried[best], p=corrected),
        Z=Z,
    )


def _combined(stack: Stack) -> Callable[[Array], Explained]:
    """Return the test of additional regressors (M, k) between poses and within repeats, combined by Fisher's method.

    Its p is the combined one, its other figures are those of the surer of the two tests.
    """
    between, within = _between(stack), _within(stack)

    def test(Z: Array) -> Explained:
        """Test whitened regressors (M, k) by F between poses and within repeats, and combine the p-values."""
        tests = between(Z), within(Z)
        valid = [explained for explained in tests if explained.columns]
        if not valid:
            return tests[0]
        surest = min(valid, key=lambda explained: explained.p)
        if len(valid) == 1:
            return surest
        logs = [np.log(max(explained.p, np.finfo(float).tiny)) for explained in valid]
        chi_square = -2.0 * sum(logs)
        return replace(surest, p=float(chdtrc(4.0, chi_square)))

    return test


def _between(stack: Stack) -> Callable[[Array], Explained]:
    """Return the F test of any additional regressors (M, k) on the means of repeats of a pose.

    The regressors of the fit and a constant of each component are there already. Components are made equally noisy.
    """
    cells = stack.cells
    A = _means(cells, np.column_stack([stack.A, stack.ones]))
    r = _means(cells, stack.r)
    _, first_of_cell = np.unique(cells, return_index=True)
    even = even_factors(A, r, stack.component_of[first_of_cell])
    base = range_of(A * even[:, None])

    def test(Z: Array) -> Explained:
        """Test whitened regressors (M, k) by F, on the means of repeats of each pose and component."""
        Z = _means(cells, Z) * even[:, None]
        return f_test(base, r * even, Z, norms_of(Z))

    return test


def _within(stack: Stack) -> Callable[[Array], Explained]:
    """Return the F test of any additional regressors (M, k) on the differences between repeats of a pose.

    Without repeats there is nothing to test: F is 0 and p is 1.
    """
    cells = stack.cells
    components, component = np.unique(stack.component_of, return_inverse=True)
    counts = np.bincount(cells)
    if counts.max() == 1:
        return lambda _: Explained(0.0, 1.0, 0.0, 0.0, 0, 0)

    def centred(values: Array) -> Array:
        """Values (M,) or (M, k) less the mean of their cell."""
        means = (_means(cells, values).T / np.sqrt(counts)).T
        return np.asarray(values - means[cells])

    r, count = centred(stack.r), len(components)
    # Every cell loses one degree of freedom: its mean.
    freedom = np.bincount(component, 1.0 - 1.0 / counts[cells], count)
    even = _level(np.bincount(component, r**2, count), freedom)[component]
    A = stack.A * even[:, None]
    base = range_of(centred(A), norms_of(A), _CUT_WITHIN)

    def test(Z: Array) -> Explained:
        """Test whitened regressors (M, k) by F, on the differences from the mean of repeats."""
        Z = Z * even[:, None]
        return f_test(base, even * r, centred(Z), norms_of(Z), int(cells.max()) + 1)

    return test


def f_test(base: Array, r: Array, Z: Array, sizes: Array, used: int = 0) -> Explained:
    """Test additional regressors by F.

    Args:
        base: Orthonormal basis of the whitened regressors A of the fit, shape (M, rank A).
        r: Whitened residual, shape (M,).
        Z: Additional whitened regressors, shape (M, k).
        sizes: Their sizes, shape (k,). A column is ignored if less than `_CUT` times its size is orthogonal to the
            base.
        used: Degrees of freedom that were used besides those of the base.

    Returns:
        The test; its p is the probability of an F as large if the residual is noise. F is 0 and p is 1 if no column, no
        degree of freedom or no residual is left.
    """
    remaining = r - base @ (base.T @ r)
    along = base.T @ Z
    if np.any(np.sum(along**2, axis=0) > _NEARLY_ALONG * np.sum(Z**2, axis=0)):
        # Twice is enough to be orthogonal to rounding, if Z almost lies in the range of the base.
        Z = Z - base @ along
        along = base.T @ Z
    additional = range_of(Z - base @ along, sizes)
    square = float(remaining @ remaining)
    before = len(r) - base.shape[1] - used
    columns = additional.shape[1]
    freedom = before - columns
    if columns == 0 or freedom < 1 or square <= _ROUNDING**2 * float(r @ r):
        return Explained(0.0, 1.0, 0.0, 0.0, 0, max(before, 0))
    square_explained = float(np.sum((additional.T @ remaining) ** 2))
    share = min(square_explained / square, 1.0)
    # An exact fit leaves nothing to compare with.
    unexplained = max((1.0 - share) / freedom, np.finfo(float).tiny)
    F = share / columns / unexplained
    p = float(fdtrc(columns, freedom, F))
    return Explained(F, p, share, columns / before, columns, freedom)


def even_factors(A: Array, r: Array, component_of: Integers) -> Array:
    """Make factors that give the components equal residual variance: an instrument may measure depth less well.

    Args:
        A: Whitened regressors of the fit, shape (M, p).
        r: Whitened residual, shape (M,).
        component_of: The component of each scalar: its column, from 0, among the D of its row; shape (M,).

    Returns:
        A factor for each scalar's residual and regressors, shape (M,); 1 if there is one component only.
    """
    components, component = np.unique(component_of, return_inverse=True)
    factors, count = np.ones(len(r)), len(components)
    for _ in range(_ROUNDS if count > 1 else 0):
        base = range_of(A * factors[:, None])
        remaining = factors * r - base @ (base.T @ (factors * r))
        freedom = np.bincount(component, 1.0 - np.sum(base**2, axis=1), count)
        squares = np.bincount(component, remaining**2, count)
        factors = factors * _level(squares, freedom)[component]
    return factors


def _level(squares: NDArray[Any], freedom: NDArray[Any]) -> Array:
    """Return factors (C,) of scalars that bring sums of squares (C,), of these degrees of freedom, to one variance.

    They are 1 if there is no variance.
    """
    known = freedom > _SOME_FREEDOM
    variances = np.where(known, squares / np.where(known, freedom, 1.0), 0.0)
    largest = float(variances.max(initial=0.0))
    if not largest > 0.0:
        return np.ones(len(squares))
    # A component without degrees of freedom is taken for one like the largest.
    variances = np.where(known, np.maximum(variances, _UNEVEN**2 * largest), largest)
    return np.asarray(1.0 / np.sqrt(variances))


def norms_of(A: Array) -> Array:
    """Norm of each column of A (M, k), 1 where it is 0, shape (k,)."""
    norms = np.linalg.norm(A, axis=0)
    return np.where(norms > 0.0, norms, 1.0)


def range_of(A: Array, sizes: Array | None = None, cut: float = _CUT) -> Array:
    """Find an orthonormal basis of the numerical range of A / sizes.

    Args:
        A: Matrix, shape (M, k).
        sizes: Sizes by which its columns are divided, shape (k,); None for their norms.
        cut: Directions whose singular value, of A / sizes, is not above this are not in the range.

    Returns:
        The basis, shape (M, rank); rank 0 if the matrix is empty or zero.
    """
    if 0 in A.shape:
        return np.zeros((len(A), 0))
    if sizes is None:
        sizes = norms_of(A)
    scaled = A / sizes
    squares, directions = np.linalg.eigh(scaled.T @ scaled)
    kept = squares > _WELL_CONDITIONED
    if np.all(
        kept | (squares < 0.1 * cut**2)
    ):  # no square is near the cut, where it has few digits
        return np.asarray(scaled @ (directions[:, kept] / np.sqrt(squares[kept])))
    vectors, values, _ = np.linalg.svd(scaled, full_matrices=False)
    return np.asarray(vectors[:, values > cut])


def _means(cells: Integers, values: Array) -> Array:
    """Average values (M,) or (M, k) over each of K cells, times the root of its count: as white as independent rows.

    ``cells`` has the number, from 0, of each scalar's cell.
    """
    counts = np.bincount(cells)
    order = np.argsort(cells, kind="stable")
    if len(counts) == len(cells):  # nothing is repeated
        return np.asarray(values[order])
    starts = np.cumsum(counts) - counts
    sums = np.add.reduceat(values[order], starts, axis=0)
    return np.asarray((sums.T / np.sqrt(counts)).T)
