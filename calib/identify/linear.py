"""The problem of an estimation linearised at one x: what its stages are found on.

Stages ask for normal equations, residuals and scores by the methods here, not for the derivative itself, so that a
problem of many rows need not hold it.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from calib.identify.problem import Problem
from calib.identify.robust import deleted_norms, median, scores
from calib.identify.statistics import Mask
from calib.identify.variance import Known, Linearised, Scalars, scalars_of

Array = NDArray[np.float64]

#: Below this the noise is no instrument's but rounding [m, rad].
SMALLEST_SIGMA = 1e-8


@dataclass(frozen=True, slots=True, eq=False)
class Linear:
    """The problem linearised at one x: y = A x + noise, in units of each scalar's sigma.

    Attributes:
        A: shape (N, D, p).
        y: shape (N, D).
        used: shape (N, D), which scalars there are.
        instruments: shape (N, D), which noise each has.
        smallest: Smallest noise believed of each instrument, in units of its sigma.
        C: shape (K, p), of the known distances, whitened.
        z: shape (K,), likewise.
    """

    A: Array
    y: Array
    used: NDArray[np.bool_]
    instruments: NDArray[np.int8]
    smallest: tuple[float, ...]
    C: Array
    z: Array
    _scalars: Scalars = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Put the scalars of each instrument below each other, once for all weights."""
        found = scalars_of(self.A, self.y, self.instruments, len(self.smallest))
        object.__setattr__(self, "_scalars", found)

    @classmethod
    def at(cls, problem: Problem, x: Array) -> Linear:
        """At the parameters x; the problem's own scales are those that were given."""
        residual, jacobian = problem.residual_and_jacobian(x)
        scales = problem.rows.scales
        A = jacobian / scales[:, :, None]
        r, C = problem.constraints(x)
        instruments, _ = problem.rows.instruments
        count = int(instruments.max()) + 1
        smallest = [SMALLEST_SIGMA / median(scales[instruments == c]) for c in range(count)]
        return cls(
            A,
            residual / scales + A @ x,
            problem.rows.used,
            instruments,
            tuple(smallest),
            C,
            r + C @ x,
        )

    @classmethod
    def of_part(cls, problem: Problem, x: Array, mask: Mask) -> Linear:
        """At the parameters x, of some of the rows of a problem, with all of its instruments."""
        rows = problem.rows.select(mask)
        poses, twists = problem.kinematics.twists(x, rows.samples)
        # As wide as all rows are: those chosen may lack a kind.
        shape = (len(rows), problem.rows.width)
        residual, jacobian = np.zeros(shape), np.zeros((*shape, len(x)))
        residual[:, : rows.width] = rows.residual(poses)
        jacobian[:, : rows.width] = rows.derivative(poses, twists)
        scales = problem.rows.scales[mask]
        A = jacobian / scales[:, :, None]
        r, C = problem.constraints(x)
        instruments, _ = problem.rows.instruments
        count = int(instruments.max()) + 1
        return cls(
            A,
            residual / scales + A @ x,
            problem.rows.used[mask],
            instruments[mask],
            (0.0,) * count,
            C,
            r + C @ x,
        )

    def known(self, precision: Array, centre: Array) -> Known:
        """Priors of given precision and mean, and the known distances."""
        return Known.of(precision, centre, self.C, self.z)

    def noise_of(self, noise: tuple[float, ...]) -> Array:
        """The noise of each scalar, shape (N, D); 1 where there is none."""
        return np.append(np.array(noise), 1.0)[self.instruments]

    def residual(self, x: Array) -> Array:
        """What x leaves over, y - A x, shape (N, D)."""
        N, D, p = self.A.shape
        return np.asarray(self.y - (self.A.reshape(N * D, p) @ x).reshape(N, D))

    def looked_at(self, x: Array) -> Array:
        """What `scores` and `norms` take for x, as `fit` gives it: here the residual itself."""
        return self.residual(x)

    def scalars(self, looked_at: Array) -> Array:
        """The residual of what `fit` or `looked_at` gave, shape (N, D)."""
        return looked_at

    def select(self, mask: Mask) -> Linear:
        """The problem of some of the rows; known distances stay."""
        return replace(
            self,
            A=self.A[mask],
            y=self.y[mask],
            used=self.used[mask],
            instruments=self.instruments[mask],
        )

    def data(self, weights: Array) -> Linearised:
        """The normal equations with these weights."""
        return Linearised.of_scalars(self._scalars, weights)

    def fit(
        self,
        weights: Array,
        noise: tuple[float, ...],
        precision: Array,
        centre: Array,
        data: Linearised | None = None,
    ) -> tuple[Array, Array, float]:
        """The linear fit with these weights, noise and priors; ``data`` are the normal equations, if at hand.

        Returns:
            The residual, shape (N, D), in units of each scalar's sigma; the covariance of x, shape (p, p); and the
            degrees of freedom: scalars, by weight, minus the parameters that they have to pay for.
        """
        data = self.data(weights) if data is None else data
        x, covariance = data.posterior(noise, self.known(precision, centre))
        paid = np.sum(data.H * covariance, axis=(1, 2)) / np.square(noise)
        return self.residual(x), covariance, float(np.sum(data.count - paid))

    def scores(
        self, residual: Array, covariance: Array, weights: Array, noise: tuple[float, ...]
    ) -> Array:
        """How far each row lies from what the others predict, shape (N,)."""
        scale = self.noise_of(noise)
        return scores(residual / scale, self.A / scale[:, :, None], covariance, weights, self.used)

    def norms(
        self, residual: Array, covariance: Array, weights: Array, noise: float, instrument: int
    ) -> Array:
        """`deleted_norms` of one instrument's scalars in units of the sigma given, shape (N,)."""
        own = self.instruments == instrument
        A, r = (self.A, residual) if own.all() else (self.A * own[:, :, None], residual * own)
        return deleted_norms(r, A, covariance / noise**2, weights)
