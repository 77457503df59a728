"""The problem of an estimation linearised at one x: what its stages are found on."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from calib.identify.robust import as_of_a_point, deleted_norms
from calib.identify.statistics import Mask
from calib.identify.variance import Known, Linearised
from calib.model.threads import over_blocks

Array = NDArray[np.float64]

#: Normal equations that are kept.
_KEPT = 3


@dataclass(frozen=True, slots=True, eq=False)
class Linear:
    """The problem linearised at x: the residual at x + s is r - A s, in units of each scalar's sigma as given.

    Attributes:
        x: shape (p,).
        columns: shape (p + 1, D, N), A and behind it r; samples last, as `calib.model.kernel` has them.
        used: shape (N, D), which scalars there are.
        instruments: shape (N, D), which noise each has; -1 for none.
        smallest: Smallest noise believed of each instrument, in units of its sigma.
        C: shape (K, p), of the known distances, whitened.
        z: shape (K,), what C x should be.
    """

    x: Array
    columns: Array
    used: Mask
    instruments: NDArray[np.int8]
    smallest: tuple[float, ...]
    C: Array
    z: Array
    _parts: tuple[tuple[slice, Array | None], ...] = field(init=False, repr=False)
    _told: list[tuple[Array, Linearised]] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Find the columns of each instrument's scalars, and where not all rows have them, which do, shape (d, N)."""
        parts = []
        for c in range(len(self.smallest)):
            own = np.equal(self.instruments.T, c)
            there = np.flatnonzero(own.any(axis=1))
            at = slice(int(there[0]), int(there[-1]) + 1) if len(there) else slice(0, 0)
            parts.append((at, None if own[at].all() else own[at].astype(np.float64)))
        object.__setattr__(self, "_parts", tuple(parts))
        object.__setattr__(self, "_told", [])

    def __len__(self) -> int:
        """Number of rows."""
        return int(self.columns.shape[2])

    @property
    def A(self) -> Array:
        """The derivative of the prediction, shape (N, D, p)."""
        return np.asarray(self.columns[:-1].transpose(2, 1, 0))

    def known(self, precision: Array, centre: Array) -> Known:
        """Priors of given precision and mean, and the known distances."""
        return Known.of(precision, centre, self.C, self.z)

    def noise_of(self, noise: tuple[float, ...]) -> Array:
        """The noise of each scalar, shape (N, D); 1 where there is none."""
        return np.append(np.array(noise), 1.0)[self.instruments]

    def residual(self, x: Array) -> Array:
        """What x leaves over, shape (N, D)."""
        count, D, N = self.columns.shape
        flat = self.columns.reshape(count, D * N)
        return np.asarray((flat[-1] - (x - self.x) @ flat[:-1]).reshape(D, N).T)

    def select(self, mask: Mask) -> Linear:
        """The problem of some of the rows; known distances stay."""
        return replace(
            self,
            columns=self.columns[:, :, mask],
            used=self.used[mask],
            instruments=self.instruments[mask],
        )

    def data(self, weights: Array) -> Linearised:
        """The normal equations with these weights, shape (N,); the last ones are kept, for stages ask again."""
        for known, told in self._told:
            if np.array_equal(known, weights):
                return told
        told = self._data(weights)
        self._told[:] = [(weights.copy(), told), *self._told[: _KEPT - 1]]
        return told

    def _data(self, weights: Array) -> Linearised:
        """The normal equations."""
        p = len(self.x)
        both = np.zeros((len(self._parts), p + 1, p + 1))
        count = np.zeros(len(self._parts))
        root = np.sqrt(weights)
        for c, (at, there) in enumerate(self._parts):
            factor = root if there is None else there * root

            def product(own: slice, at: slice = at, factor: Array = factor) -> Array:
                part = (self.columns[:, at, own] * factor[..., own]).reshape(p + 1, -1)
                return np.asarray(part @ part.T)

            both[c] = np.sum(over_blocks(product, len(self)), axis=0)
            alive = (
                weights.sum() * (at.stop - at.start) if there is None else (there @ weights).sum()
            )
            count[c] = alive
        # [A r] are at hand; what is asked for is [A y] with y = r + A x.
        H, g, rr = both[:, :p, :p], both[:, :p, p], both[:, p, p]
        Hx = H @ self.x
        return Linearised(H, g + Hx, rr + (2.0 * g + Hx) @ self.x, count)

    def fit(
        self,
        weights: Array,
        noise: tuple[float, ...],
        known: Known,
        data: Linearised | None = None,
    ) -> tuple[Array, Array, float]:
        """The linear fit with these weights, noise and priors; ``data`` are the normal equations, if at hand.

        Returns:
            The residual, shape (N, D), in units of each scalar's sigma; the covariance of x, shape (p, p); and the
            degrees of freedom: scalars, by weight, minus the parameters that they have to pay for.
        """
        data = self.data(weights) if data is None else data
        x, covariance = data.posterior(noise, known)
        paid = np.sum(data.H * covariance, axis=(1, 2)) / np.square(noise)
        return self.residual(x), covariance, float(np.sum(data.count - paid))

    def scores(
        self, residual: Array, covariance: Array, weights: Array, noise: tuple[float, ...]
    ) -> Array:
        """How far each row lies from what the others predict, shape (N,)."""
        found = deleted_norms(residual, self.A, covariance, weights, 1.0 / self.noise_of(noise))
        return as_of_a_point(found, np.sum(self.used, axis=1))

    def norms(self, residual: Array, covariance: Array, weights: Array, instrument: int) -> Array:
        """`deleted_norms` of one instrument's scalars in units of the sigma given, shape (N,)."""
        own = (self.instruments == instrument).astype(np.float64)
        return deleted_norms(residual, self.A, covariance, weights, own)
