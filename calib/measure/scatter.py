"""What fits of planes and circles share: weights, what the residuals say of the noise, and which points are gross.

A gross point is one whose own displacement explains so much that chance does not: with the point's k residuals e and
their block H of the hat matrix, giving the point its own displacement lowers the sum of squares by e^T (I - H)^-1 e,
which over the rest is F(k, dof - k). The largest of N points counts where N times its tail is below 0.001; then the
point is left out, the fit made again, and the next one looked at.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, fdtrc

from calib.errors import CalibError

Array = NDArray[np.float64]

#: Fewest points: those that determine the figure and one more, or there is nothing to tell the noise from.
FEWEST = 4

# Lines and spots: spread along the second axis, in that along the first one or in the noise.
_THIN = 1e-9
_IN_NOISE = 1.5

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
        ratio = self.freedom * (self.estimate / self.given) ** 2
        return bool(chdtrc(self.freedom, ratio) < LEVEL)

    @property
    def sigma(self) -> float:
        """What the covariance is made with: the noise as given, if it was and the residuals allow it [m]."""
        sigma = self.estimate if self.given is None or self.contradicted else self.given
        return max(sigma, FLOOR_M)

    @property
    def dof(self) -> float:
        """Degrees of freedom of ``sigma``; infinite where it was given."""
        return float(self.freedom) if self.given is None or self.contradicted else np.inf


def scatter_of(residuals: Array, jacobian: Array, weights: Array, sigma: Array | None) -> Scatter:
    """The noise of the points used.

    Args:
        residuals: shape (N, k) [m].
        jacobian: shape (N, k, p).
        weights: shape (N,).
        sigma: As given, shape (all points,) [m]; or None.
    """
    freedom = residuals.size - jacobian.shape[-1]
    square = float(np.sum(weights[:, None] * residuals**2))
    given = None if sigma is None else float(np.sqrt(np.mean(sigma**2)))
    return Scatter(float(np.sqrt(square / freedom)), freedom, given)


def weights_of(sigma: Array | None, count: int) -> Array:
    """Weights of the points with the harmonic mean 1: of the noise's variance, in its own unit."""
    if sigma is None:
        return np.ones(count)
    return np.asarray(np.mean(sigma**2) / sigma**2)


def inverse_normal(jacobian: Array, weights: Array) -> Array:
    """(J^T W J)^-1, shape (p, p)."""
    J = jacobian.reshape(-1, jacobian.shape[-1])
    w = np.repeat(weights, jacobian.shape[1])
    # Lengths beside angles: scaled before the inversion.
    norm = np.sqrt(np.einsum("ij,ij,i->j", J, J, w))
    N = (J / norm).T @ (w[:, None] * (J / norm))
    return np.asarray(np.linalg.inv(N) / np.outer(norm, norm))


def check_count(points: Array, what: str) -> None:
    """Refuse too few points."""
    if len(points) < FEWEST:
        message = (
            f"there are {len(points)} points, {what} with its uncertainty needs {FEWEST} at least and "
            "should have 10 or more. Measure more"
        )
        raise CalibError(message)


def check_spread(spread: Array, consequence: str) -> None:
    """Refuse points on a spot or on a line, as far as their noise tells."""
    if spread[1] <= max(_THIN * spread[0], _IN_NOISE * spread[2]):
        message = (
            f"the points lie on a line (they spread over {1e3 * spread[0]:.3g} mm along it and {1e3 * spread[1]:.3g} "
            f"mm across): {consequence}"
        )
        raise CalibError(message)


Problem = Callable[[NDArray[np.bool_]], tuple[Array, Array, Array, Any]]


def keep_all_but_gross(problem: Problem, count: int, *, robust: bool) -> NDArray[np.bool_]:
    """Which of N points to fit to, shape (N,), read-only.

    Args:
        problem: From the points used to residuals (N, k), Jacobian (N, k, p) and weights (N,) of the fit to these.
        count: N.
        robust: Whether any is left out.
    """
    used = np.ones(count, dtype=np.bool_)
    for _ in range(max(1, int(_SHARE * count)) if robust else 0):
        residuals, jacobian, weights, _ = problem(used)
        worst = _gross(residuals[used], jacobian[used], weights[used])
        if worst is None:
            break
        used[np.flatnonzero(used)[worst]] = False
    used.setflags(write=False)
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
