"""The linearised problem of many rows: what `calib.identify.linear.Linear` answers, without its derivative.

Every answer is a pass through the rows (`calib.identify.passes`), which puts the derivative together again, block by
block. With J the derivative of the prediction at x and r the residual there, both in units of each scalar's sigma,
A = J and y = r + J x.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.identify.linear import SMALLEST_SIGMA, Linear
from calib.identify.passes import Passes
from calib.identify.problem import Problem
from calib.identify.robust import as_of_a_point
from calib.identify.statistics import Mask
from calib.identify.variance import Known, Linearised
from calib.model.batch import CHUNK

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Streamed:
    """The problem linearised at one x: y = A x + noise, in units of each scalar's sigma.

    Attributes:
        passes: The rows.
        x: shape (p,), where it is linearised.
        smallest: Smallest noise believed of each instrument, in units of its sigma.
        C: shape (K, p), of the known distances, whitened.
        z: shape (K,), likewise.
    """

    passes: Passes
    x: Array
    smallest: tuple[float, ...]
    C: Array
    z: Array

    @classmethod
    def at(cls, problem: Problem, x: Array) -> Streamed:
        """At the parameters x; the problem's own scales are those that were given.

        Args:
            problem: With `Problem.passes`.
            x: shape (p,).
        """
        assert problem.passes is not None
        r, C = problem.constraints(x)
        smallest = tuple(SMALLEST_SIGMA / sigma for sigma in problem.passes.typical)
        return cls(problem.passes, x, smallest, C, r + C @ x)

    @property
    def used(self) -> Mask:
        """Which scalars there are, shape (N, D)."""
        return self.passes.rows.used

    @property
    def instruments(self) -> NDArray[np.int8]:
        """Which noise each scalar has, shape (N, D)."""
        return self.passes.rows.instruments[0]

    def known(self, precision: Array, centre: Array) -> Known:
        """Priors of given precision and mean, and the known distances."""
        return Known.of(precision, centre, self.C, self.z)

    def noise_of(self, noise: tuple[float, ...]) -> Array:
        """The noise of each scalar, shape (N, D); 1 where there is none."""
        return np.append(np.array(noise), 1.0)[self.instruments]

    def looked_at(self, x: Array) -> Array:
        """What `scores` and `norms` take for x, as `fit` gives it: here x itself."""
        return x

    def scalars(self, looked_at: Array) -> Array:
        """The residual of what `fit` or `looked_at` gave, shape (N, D)."""
        return self.residual(looked_at)

    def residual(self, x: Array) -> Array:
        """What x leaves over, y - A x, shape (N, D)."""
        rows, moved = self.passes.rows, x - self.x
        result = np.zeros((len(rows), rows.width))
        for own, J in self.passes.derivatives(self.x, np.ones(len(rows))):
            result[own] = J[:, :, -1] - J[:, :, :-1] @ moved
        return result

    def data(self, weights: Array) -> Linearised:
        """The normal equations with these weights."""
        both, x = self.passes.normal(self.x, weights), self.x
        p = len(x)
        H, Jr, rr = both[:, :p, :p], both[:, :p, p], both[:, p, p]
        Hx = H @ x
        count = np.zeros(len(both))
        for stream in self.passes.streams:
            alive = float(np.sum(stream.own(weights)))
            count[stream.lengths] = min(stream.width, 3) * alive
            if stream.angles >= 0:
                count[stream.angles] = 3.0 * alive
        return Linearised(H, Jr + Hx, rr + 2.0 * Jr @ x + Hx @ x, count)

    def fit(
        self,
        weights: Array,
        noise: tuple[float, ...],
        precision: Array,
        centre: Array,
        data: Linearised | None = None,
    ) -> tuple[Array, Array, float]:
        """The linear fit with these weights, noise and priors; see `calib.identify.linear.Linear.fit`."""
        data = self.data(weights) if data is None else data
        x, covariance = data.posterior(noise, self.known(precision, centre))
        paid = np.sum(data.H * covariance, axis=(1, 2)) / np.square(noise)
        return x, covariance, float(np.sum(data.count - paid))

    def scores(
        self, x: Array, covariance: Array, weights: Array, noise: tuple[float, ...]
    ) -> Array:
        """How far each row lies from what the others predict, looked at x, shape (N,)."""
        norms = self.passes.norms(self.x, x - self.x, covariance, weights, noise)
        return as_of_a_point(norms, np.sum(self.used, axis=1))

    def norms(
        self, x: Array, covariance: Array, weights: Array, noise: float, instrument: int
    ) -> Array:
        """`deleted_norms` of one instrument's scalars in units of the sigma given, shape (N,)."""
        ones = (1.0,) * self.passes.instruments
        moved, of_sigma = x - self.x, covariance / noise**2
        return self.passes.norms(self.x, moved, of_sigma, weights, ones, instrument)


def linearised(problem: Problem, x: Array) -> Linear | Streamed:
    """The problem linearised at the parameters x, in the form that suits the number of its rows."""
    return Linear.at(problem, x) if problem.passes is None else Streamed.at(problem, x)


def whole_groups(
    problem: Problem, linear: Linear | Streamed, x: Array, groups: NDArray[np.int_]
) -> Iterator[tuple[NDArray[np.int_], Linear]]:
    """The linearised problem in parts that hold their derivative, each of whole groups of rows.

    Args:
        problem: The problem.
        linear: It linearised at x.
        x: shape (p,).
        groups: shape (N,), the group of each row, numbered from 0; of pairs both rows are in one.

    Yields:
        Numbers of M rows, and their problem.
    """
    if isinstance(linear, Linear):
        yield np.arange(len(problem.rows)), linear
        return
    order = np.argsort(groups, kind="stable")
    ends = np.flatnonzero(np.diff(groups[order], append=-1)) + 1
    first = 0
    while first < len(order):
        last = int(ends[np.searchsorted(ends, min(first + CHUNK, len(order)))])
        chosen = np.sort(order[first:last])
        mask = np.zeros(len(order), dtype=bool)
        mask[chosen] = True
        yield chosen, Linear.of_part(problem, x, mask)
        first = last
