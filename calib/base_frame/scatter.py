"""What fits of planes and circles share: what the residuals say of the noise, and which points are gross.

A gross point is one whose own displacement explains so much that chance does not: with the point's k residuals e and
their block H of the hat matrix, giving the point its own displacement lowers the sum of squares by e^T (I - H)^-1 e,
which over the rest is F(k, dof - k). The largest of N points counts where N times its tail is below 0.001; then the
point is left out, the fit made again, and the next one looked at.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, fdtrc

from calib.model.robot import read_only

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
_Figure = TypeVar("_Figure")

#: No instrument is better than this, and without noise there is no covariance [m].
FLOOR_M = 1e-9

#: Chance of a finding where there is nothing but noise.
LEVEL = 1e-3

#: At most this share of the points is gross; more of them are no outliers.
_SHARE = 0.1


@dataclass(frozen=True, slots=True)
class Scatter:
    """The noise of a fit's points.

    Attributes:
        estimate: Standard deviation of one coordinate from the residuals [m].
        freedom: The degrees of freedom it is estimated with.
        given: The one that was given, root of the mean square over the points [m]; None where none was.
    """

    estimate: float
    freedom: int
    given: float | None

    @property
    def contradicted(self) -> bool:
        """Whether the residuals are larger than the given noise makes them, at `LEVEL`."""
        if self.given is None:
            return False
        return bool(chdtrc(self.freedom, self.freedom * (self.estimate / self.given) ** 2) < LEVEL)

    @property
    def sigma(self) -> float:
        """What the covariance is made with: the noise as given, if it was and the residuals allow it [m]."""
        sigma = self.estimate if self.given is None or self.contradicted else self.given
        return max(sigma, FLOOR_M)

    @property
    def dof(self) -> float:
        """Degrees of freedom of ``sigma``; infinite where it was given."""
        return float(self.freedom) if self.given is None or self.contradicted else np.inf


class Fit(NamedTuple, Generic[_Figure]):
    """A fit to some of the points: residuals (N, k) [m] and Jacobian (N, k, p) of all of them, and the figure."""

    residuals: Array
    jacobian: Array
    figure: _Figure


@dataclass(frozen=True, slots=True)
class Judged(Generic[_Figure]):
    """A fit with its uncertainty.

    Attributes:
        figure: What was fitted.
        residuals: Of all points, shape (N, k) [m].
        covariance: Of the figure's p displacements, shape (p, p).
        used: Which points it is fitted to, shape (N,); the others are gross.
        scatter: What is known of the noise.
    """

    figure: _Figure
    residuals: Array
    covariance: Array
    used: Mask
    scatter: Scatter


def judged(
    fit: Callable[[Array, Mask], Fit[_Figure]], sigma: Array | None, count: int, *, robust: bool
) -> Judged[_Figure]:
    """A figure with its uncertainty sigma^2 (J^T W J)^-1.

    Args:
        fit: From the weights and which points are used to the fit.
        sigma: Standard deviation of a coordinate of each point, shape (N,) [m]; None: alike, found from the residuals.
        count: N.
        robust: Whether gross points are left out.

    Raises:
        numpy.linalg.LinAlgError: The points do not determine the figure.
    """
    # Their harmonic mean is 1: of the noise's variance, in its own unit.
    weights = np.ones(count) if sigma is None else np.asarray(np.mean(sigma**2) / sigma**2)
    used = np.ones(count, dtype=np.bool_)
    if robust:
        used = all_but_gross(lambda some: fit(weights, some), weights)
    used.setflags(write=False)
    found = fit(weights, used)
    J = found.jacobian[used].reshape(-1, found.jacobian.shape[-1])
    w = np.repeat(weights[used], found.residuals.shape[1])
    e = found.residuals[used].ravel()
    given = None if sigma is None else float(np.sqrt(np.mean(sigma**2)))
    freedom = len(e) - J.shape[1]
    scatter = Scatter(float(np.sqrt(w @ e**2 / freedom)), freedom, given)
    # Lengths beside angles: scaled before the inversion.
    norm = np.sqrt(w @ J**2)
    inverse = np.linalg.inv((J / norm).T @ (w[:, None] * (J / norm))) / np.outer(norm, norm)
    covariance = read_only(scatter.sigma**2 * inverse)
    return Judged(found.figure, read_only(found.residuals), covariance, used, scatter)


def all_but_gross(fit: Callable[[Mask], Fit[_Figure]], weights: Array) -> Mask:
    """Which points are not gross, shape (N,).

    Args:
        fit: The fit to the points used.
        weights: Of all points, shape (N,).
    """
    used = np.ones(len(weights), dtype=np.bool_)
    for _ in range(max(1, int(_SHARE * len(weights)))):
        found = fit(used)
        worst = _gross(found.residuals[used], found.jacobian[used], weights[used])
        if worst is None:
            break
        used[np.flatnonzero(used)[worst]] = False
    return used


def _gross(residuals: Array, jacobian: Array, weights: Array) -> int | None:
    """The point that is gross, if there is one."""
    count, k, p = jacobian.shape
    rest = count * k - p - k
    if rest < k + 1:
        return None
    root = np.sqrt(weights)
    e = root[:, None] * residuals
    Q = np.linalg.qr((root[:, None, None] * jacobian).reshape(-1, p))[0].reshape(count, k, p)
    free = np.eye(k) - Q @ np.swapaxes(Q, 1, 2)
    # A point that alone holds a direction of the fit has no residual there to judge it by.
    judged = np.linalg.eigvalsh(free)[:, 0] > 1e-6
    drop = np.zeros(count)
    drop[judged] = np.einsum(
        "ni,ni->n", e[judged], np.linalg.solve(free[judged], e[judged][..., None])[..., 0]
    )
    worst = int(np.argmax(drop))
    left = float(np.sum(e**2) - drop[worst])
    floor = np.finfo(np.float64).eps * float(np.sum(e**2))
    ratio = (drop[worst] / k) / (max(left, floor) / rest) if drop[worst] > 0.0 else 0.0
    return worst if count * fdtrc(k, rest, ratio) < LEVEL else None
