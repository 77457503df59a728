"""Whether residuals are noise: F tests of patterns in them, and of set-ups that do not agree.

Let r' and Z' be the residual and further regressors Z, projected on what is orthogonal to the fit's regressors A, and S
the sum of squares of r' that Z' explain. Then

    F = (S / rank Z') / ((|r'|^2 - S) / (M - rank A - rank Z'))

Repeats of a pose share what the model lacks there: their mean is one measurement. A set-up is predicted by a fit to the
others: if nothing is wrong, its residual r has the covariance I + A C A^T, apart from what its own frame and target
absorb.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, fdtrc

from calib.units import Array, Integers

#: The probability that a table of pure noise gives any pattern or drift.
FALSE_ALARM = 0.003

#: Directions whose singular value is below this, for columns of norm 1, are not in the range of a matrix.
_CUT = 1e-6

#: The same for differences of regressors between repeats of a pose: joint values repeat to `1e-3` only.
_CUT_WITHIN = 1e-2

#: Rounds in which the noise of the components is found.
_ROUNDS = 4

#: The noise of a component is taken as at least this share of the largest.
_UNEVEN = 0.01

#: The fewest rows before and after a step.
_SIDE = 3

#: About how many rows are tried for a step, before all around the best.
_TRIED = 60

#: Degrees of freedom below this are rounding.
_SOME_FREEDOM = 1e-6

#: A projected residual below this share of the whole one is rounding.
_ROUNDING = 1e-12


@dataclass(frozen=True, slots=True)
class Explained:
    """What further regressors explain of a residual; F is 0 and p is 1 where there is nothing to test."""

    F: float
    p: float
    share: float  # of the sum of squares of the projected residual
    chance: float  # the share that as many random regressors explain on average
    columns: int  # independent further regressors
    freedom: int  # degrees of freedom that remain

    @property
    def values(self) -> dict[str, float]:
        """The values of a reason that reports it."""
        return {"share": self.share, "chance": self.chance, "p": self.p}


@dataclass(frozen=True, slots=True, eq=False)
class Stack:
    """The whitened scalars of a fit."""

    A: Array  # (M, p), its regressors
    r: Array  # (M,), its residual
    row_of: Integers  # (M,), the row of each scalar
    component_of: Integers  # (M,), which coordinate it is
    ones: Array  # (M, components), a constant of each component
    poses: Integers  # (N,), the pose of each row

    @property
    def cells(self) -> Integers:
        """A number for each pair of pose and component, shape (M,)."""
        pairs = np.column_stack([self.poses[self.row_of], self.component_of])
        return np.asarray(np.unique(pairs, axis=0, return_inverse=True)[1]).reshape(-1)

    def beyond(self, *Z: Array) -> Stack:
        """The same, with further regressors (M, k) of the fit."""
        return replace(self, A=np.column_stack([self.A, *Z]))

    def times(self, functions: Array, directions: Array) -> Array:
        """Functions of the row (N, f), each times each direction (M, k): shape (M, f k)."""
        product = functions[self.row_of][:, :, None] * directions[:, None, :]
        return np.asarray(product.reshape(len(self.r), -1))


def joint_patterns(
    stack: Stack, joints: Array, prismatic: Sequence[bool], directions: Sequence[Array]
) -> list[tuple[int, Explained, Array]]:
    """Find the joints on whose values (N, m) the residuals depend, beyond a constant of each component; surest first.

    The regressors are sin q, cos q and q, or q and q^2 where a joint slides, times the directions (M, k) of what
    displacements of it do to the scalars. A table of pure noise gives any with the probability `FALSE_ALARM`.
    """
    if not len(stack.r):
        return []
    test, found = _between(stack), []
    for i, (q, slides, along) in enumerate(zip(joints.T, prismatic, directions, strict=True)):
        explained = test(Z := stack.times(functions_of_joint(q, slides=slides), along))
        if explained.p < FALSE_ALARM / len(prismatic):
            found.append((i, explained, Z))
    return sorted(found, key=lambda one: (one[1].p, -one[1].F))


def functions_of_joint(q: Array, *, slides: bool) -> Array:
    """The functions of a joint's value, (N,) [rad] or [m], of which its errors are combinations, shape (N, 3 or 2)."""
    # Centred and of size 1, so that q and q^2 do not look alike.
    middle = q - np.mean(q)
    middle = middle / max(float(np.max(np.abs(middle), initial=0.0)), np.finfo(float).tiny)
    return np.column_stack([middle, middle**2] if slides else [np.sin(q), np.cos(q), middle])


def drift(stack: Stack, order: Array) -> Explained | None:
    """Test for a drift of the residuals in the order of the rows, (N,); None where it may be chance."""
    if not len(stack.r):
        return None
    found = _combined(stack)(stack.times(order[:, None] - np.mean(order), stack.ones))
    return found if found.p < FALSE_ALARM else None


def lag(stack: Stack, moves: Array) -> tuple[Array, Explained] | None:
    """Estimate the share of its last move that each joint misses, (k,), from regressors of a whole move, (M, k).

    None where it may be chance.
    """
    if not len(stack.r):
        return None
    explained = _combined(stack)(moves)
    if explained.p >= FALSE_ALARM:
        return None
    fitted = np.linalg.lstsq(np.column_stack([stack.A, moves]), stack.r, rcond=None)[0]
    return np.asarray(-fitted[-moves.shape[1] :]), explained


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """A step in the residuals: from some row on they are displaced."""

    row: int  # The first displaced one
    size: float  # By how much, in the unit of the directions
    test: Explained  # Its p is corrected for the number of rows tried
    Z: Array  # (M, k), its regressors


def step(stack: Stack, rows: Integers, along: Array) -> Step | None:
    """Find the row among (K,), in their order, from which residuals step along directions (M, k); None if chance."""
    most = len(rows) - _SIDE
    if most < _SIDE:
        return None
    test, number = _combined(stack), np.arange(len(stack.poses))[:, None]
    stride = max((most - _SIDE) // _TRIED, 1)
    tried: dict[int, Explained] = {}

    def best_of(some: Iterable[int]) -> int:
        tried.update({k: test(stack.times(1.0 * (number >= rows[k]), along)) for k in some})
        return min(tried, key=lambda k: (tried[k].p, -tried[k].F))

    best = best_of(range(_SIDE, most + 1, stride))
    best = best_of(range(max(best - stride + 1, _SIDE), min(best + stride, most + 1)))
    found = replace(tried[best], p=min(tried[best].p * (most - _SIDE + 1), 1.0))
    if found.p >= FALSE_ALARM:
        return None
    Z = stack.times(1.0 * (number >= rows[best]), along)
    fitted = np.linalg.lstsq(np.column_stack([stack.A, Z]), stack.r, rcond=None)[0]
    return Step(int(rows[best]), float(np.linalg.norm(fitted[-Z.shape[1] :])), found, Z)


def _combined(stack: Stack) -> Callable[[Array], Explained]:
    """The tests between poses and within repeats, their p-values combined by Fisher's method."""
    between, within = _between(stack), _within(stack)

    def test(Z: Array) -> Explained:
        tests = between(Z), within(Z)
        valid = [one for one in tests if one.columns] or [tests[0]]
        surest = min(valid, key=lambda one: one.p)
        if len(valid) == 1:
            return surest
        logs = [np.log(max(one.p, np.finfo(float).tiny)) for one in valid]
        return replace(surest, p=float(chdtrc(4.0, -2.0 * sum(logs))))

    return test


def _between(stack: Stack) -> Callable[[Array], Explained]:
    """The test on the means of repeats, of any further regressors (M, k)."""
    cells = stack.cells
    A, r = _means(cells, np.column_stack([stack.A, stack.ones])), _means(cells, stack.r)
    even = even_factors(A, r, stack.component_of[np.unique(cells, return_index=True)[1]])
    base = range_of(A * even[:, None])

    def test(Z: Array) -> Explained:
        Z = _means(cells, Z) * even[:, None]
        return f_test(base, r * even, Z, norms_of(Z))

    return test


def _within(stack: Stack) -> Callable[[Array], Explained]:
    """The test on differences between repeats; without repeats there is nothing to test."""
    cells, (found, component) = stack.cells, np.unique(stack.component_of, return_inverse=True)
    counts = np.bincount(cells)
    if counts.max() == 1:
        return lambda _: Explained(0.0, 1.0, 0.0, 0.0, 0, 0)

    def centred(values: Array) -> Array:
        means = (_means(cells, values).T / np.sqrt(counts)).T
        return np.asarray(values - means[cells])

    r, count = centred(stack.r), len(found)
    # Every cell loses one degree of freedom: its mean.
    freedom = np.bincount(component, 1.0 - 1.0 / counts[cells], count)
    even = _levelled(np.bincount(component, r**2, count), freedom)[component]
    A = stack.A * even[:, None]
    base = range_of(centred(A), norms_of(A), _CUT_WITHIN)

    def test(Z: Array) -> Explained:
        Z = Z * even[:, None]
        return f_test(base, even * r, centred(Z), norms_of(Z), int(cells.max()) + 1)

    return test


def f_test(base: Array, r: Array, Z: Array, sizes: Array, lost: int = 0) -> Explained:
    """The F test of further regressors Z (M, k) beyond an orthonormal base (M, rank A).

    A column of Z below `_CUT` times its size is ignored; ``lost`` degrees of freedom were used before.
    """
    rest = r - base @ (base.T @ r)
    # Twice is enough to be orthogonal to rounding, where Z almost lies in the range of the base.
    Z = Z - base @ (base.T @ Z)
    further = range_of(Z - base @ (base.T @ Z), sizes)
    square, before = float(rest @ rest), len(r) - base.shape[1] - lost
    columns, freedom = further.shape[1], before - further.shape[1]
    if columns == 0 or freedom < 1 or square <= _ROUNDING**2 * float(r @ r):
        return Explained(0.0, 1.0, 0.0, 0.0, 0, max(before, 0))
    share = min(float(np.sum((further.T @ rest) ** 2)) / square, 1.0)
    # An exact fit leaves nothing to compare with.
    F = share / columns / max((1.0 - share) / freedom, np.finfo(float).tiny)
    p = float(fdtrc(columns, freedom, F))
    return Explained(F, p, share, columns / before, columns, freedom)


def even_factors(A: Array, r: Array, component_of: Integers) -> Array:
    """Factors that give the components equal residual variance, (M,): an instrument may measure depth less well."""
    found, component = np.unique(component_of, return_inverse=True)
    factors, count = np.ones(len(r)), len(found)
    for _ in range(_ROUNDS if count > 1 else 0):
        base = range_of(A * factors[:, None])
        rest = factors * r - base @ (base.T @ (factors * r))
        freedom = np.bincount(component, 1.0 - np.sum(base**2, axis=1), count)
        factors = factors * _levelled(np.bincount(component, rest**2, count), freedom)[component]
    return factors


def _levelled(squares: NDArray[Any], freedom: NDArray[Any]) -> Array:
    """Factors that bring sums of squares to one variance a degree of freedom; 1 for all where none has any."""
    known = freedom > _SOME_FREEDOM
    variances = np.where(known, squares / np.where(known, freedom, 1.0), 0.0)
    largest = float(variances.max(initial=0.0))
    if not largest > 0.0:
        return np.ones(len(squares))
    # A component without degrees of freedom is taken for one like the largest.
    variances = np.where(known, np.maximum(variances, _UNEVEN**2 * largest), largest)
    return np.asarray(1.0 / np.sqrt(variances))


def norms_of(A: Array) -> Array:
    """The norm of each column, 1 where it is 0."""
    norms = np.linalg.norm(A, axis=0)
    return np.where(norms > 0.0, norms, 1.0)


def range_of(A: Array, sizes: Array | None = None, cut: float = _CUT) -> Array:
    """Orthonormal basis of the numerical range of A / sizes, by default its columns' norms, shape (M, rank)."""
    if 0 in A.shape:
        return np.zeros((len(A), 0))
    scaled = A / (norms_of(A) if sizes is None else sizes)
    vectors, values, _ = np.linalg.svd(scaled, full_matrices=False)
    return np.asarray(vectors[:, values > cut])


def _means(cells: Integers, values: Array) -> Array:
    """Means over each cell times the root of its count, so that they are whitened as their independent rows are."""
    counts = np.bincount(cells)
    order, starts = np.argsort(cells, kind="stable"), np.cumsum(counts) - counts
    sums = np.add.reduceat(values[order], starts, axis=0)
    return np.asarray((sums.T / np.sqrt(counts)).T)
