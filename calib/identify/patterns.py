"""Residuals that are not noise: patterns against joint values, drift with time.

What the fit could still reach with its own regressors is left out of every test, see `significance`. Scalars of weight
0 are no measurements and are left out before. Repeats of a pose share what the model lacks there: their mean is one
measurement, not many. Components that an instrument measures less well than others are brought to one size first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from calib.identify.significance import (
    CUT,
    Explained,
    even_factors,
    explained,
    f_test,
    levelled,
    norms_of,
    range_of,
    sums_by,
)

Array = NDArray[np.float64]
Integers = NDArray[np.int_]

#: The probability that a table with nothing but noise gives any finding.
FALSE_ALARM = 0.003

#: The same for what repeats of a pose change in the regressors: joint values repeat to `1e-3` only.
_CUT_WITHIN = 1e-2


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
        of = "position" if self.prismatic else "angle"
        return f"What the model leaves over is not noise: the {of} of '{self.joint}' explains {self.test}."


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
            f"{self.test}. Did the arm or the instrument warm up, or something move?"
        )


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
        r: shape (M,), whitened residual, the rows' scalars in a stack; the weights of repeats are part of whitening.
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
    if not len(stack.r):
        return ()
    cells = np.arange(len(stack.r)) if poses is None else stack.cells(poses)
    A, r = _sums_over(cells, np.column_stack([stack.A, stack.ones])), _sums_over(cells, stack.r)
    even = even_factors(A, r, _first_of(cells, stack.component_of))
    base = range_of(A * even[:, None], norms_of(A * even[:, None]), CUT)
    found = []
    for i, (name, slides) in enumerate(zip(joint_names, prismatic, strict=True)):
        functions = _functions(joints[:, i], slides, gain=directions is not None)
        Z = stack.times(functions, None if directions is None else directions[i])
        Z = even[:, None] * _sums_over(cells, Z)
        test = f_test(base, even * r, Z, norms_of(Z), lost=0)
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
    if not len(stack.r):
        return None
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
        return product.reshape(len(self.r), functions.shape[1] * along.shape[1])

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


def _between(cells: Integers, stack: _Stack, Z: Array) -> Explained:
    """The test on the means of repeats."""
    A, r = _sums_over(cells, np.column_stack([stack.A, stack.ones])), _sums_over(cells, stack.r)
    even = even_factors(A, r, _first_of(cells, stack.component_of))
    return explained(A * even[:, None], r * even, _sums_over(cells, Z) * even[:, None])


def _within(cells: Integers, stack: _Stack, Z: Array) -> Explained:
    """The test on what differs between repeats; without repeats there is nothing to test."""
    r, Z_within = _centred(cells, stack.r), _centred(cells, Z)
    # Every cell loses one degree of freedom: its mean.
    counts = np.bincount(cells)[cells]
    components = stack.ones.shape[1]
    squares = sums_by(stack.component_of, r**2, components)
    freedom = sums_by(stack.component_of, 1.0 - 1.0 / counts, components)
    even = levelled(squares, freedom)[stack.component_of]
    A = stack.A * even[:, None]
    base = range_of(_centred(cells, A), norms_of(A), _CUT_WITHIN)
    Z = Z * even[:, None]
    lost = int(cells.max(initial=-1)) + 1
    return f_test(base, even * r, even[:, None] * Z_within, norms_of(Z), lost)


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
