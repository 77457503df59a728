"""Planes and circles through points in space, robust against outliers, with their uncertainty.

The fits are those of `calib.verbs.base_frame.orthogonal_distances`. Uncertainties are covariances of small
displacements along the columns (u, v, normal) of the figure's basis, sigma^2 (J^T W J)^-1.

An outlier is a point whose own displacement explains more than chance does: with the point's k residuals e and
their block H of the hat matrix, giving the point its own displacement lowers the sum of squares by e^T (I - H)^-1 e,
which over the rest is F(k, dof - k). The largest of N points counts where N times its tail is below 0.001; then the
point is left out, the fit made again, and the next one looked at.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.special import chdtrc, fdtrc

from calib.basics.arrays import Array, Mask, read_only
from calib.basics.values import Value
from calib.errors import CalibError
from calib.verbs.base_frame.orthogonal_distances import (
    TOO_SHORT,
    FittedFigure,
    nearest_circle,
    nearest_plane,
)

#: Fewest points: those that determine the figure and one more, or there is nothing to tell the noise from.
FEWEST = 4

#: No instrument is better than this, and without noise there is no covariance [m].
FLOOR_M = 1e-9

#: Chance of a finding where there is nothing but noise.
LEVEL = 1e-3

#: At most this share of the points are outliers.
_SHARE = 0.1

#: A point is tested as an outlier if the least eigenvalue of its block of I - H is above this.
_TESTABLE = 1e-6

#: Where the radius is not known to this share of itself, the centre is not known either.
_VAGUE = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class Plane(Value):
    """Plane through N points."""

    #: On the plane, the points' weighted mean, shape (3,) [m]
    point: Array
    #: Columns u, v, normal; shape (3, 3). The normal's sense means nothing
    basis: Array
    #: shape (3, 3), of the displacement along the normal at ``point`` [m] and of the normal's tilt towards u and v
    #: [rad]
    covariance: Array
    #: Signed distances of all points, shape (N, 1) [m]
    residuals: Array
    #: Points that the plane is fitted to, outliers rejected, shape (N,)
    used: Mask
    #: Standard deviation of one coordinate from the residuals [m]
    noise: float
    #: The one that was given, root of the mean square over the points [m]; None where none was
    given: float | None
    #: Degrees of freedom of the noise in the covariance; infinite where it is the given one, which the residuals allow
    dof: float

    @property
    def normal(self) -> Array:
        """Unit normal, shape (3,); a circle's positive angles turn about it."""
        return self.basis[:, 2]


@dataclass(frozen=True, slots=True, eq=False)
class Circle(Plane):
    """Circle through N points; positions along it are not part of the fit.

    Its ``point`` is the centre, u points from there to the first point used. Residuals are radial and axial, shape
    (N, 2) [m]; the covariance, shape (6, 6), is of the centre's displacement along u, v, normal [m], of the normal's
    tilt towards u and v [rad], and of the radius [m].
    """

    #: [m]
    radius: float
    #: Of the points about the normal, from u, in (-pi, pi], shape (N,) [rad]
    angles: Array

    @property
    def arc(self) -> float:
        """Angle that the points cover: a full turn less the largest gap between neighbours [rad]."""
        ordered = np.sort(self.angles[self.used])
        gaps = np.diff(ordered, append=ordered[0] + 2.0 * np.pi)
        return float(2.0 * np.pi - gaps.max())

    def turned(self) -> Circle:
        """Return the circle with the opposite normal."""
        # (u, v, n) -> (u, -v, -n): what is along v or n changes its sign; a tilt towards u does through n, and one
        # towards v through both.
        signs = np.array([1.0, -1.0, -1.0, -1.0, 1.0, 1.0])
        return replace(
            self,
            basis=read_only(self.basis * [1.0, -1.0, -1.0]),
            covariance=read_only(self.covariance * np.outer(signs, signs)),
            residuals=read_only(self.residuals * [1.0, -1.0]),
            angles=read_only(-self.angles),
        )


def fit_plane(points: Array, sigma: Array | None = None, *, robust: bool = True) -> Plane:
    """Fit the total least-squares plane.

    Args:
        points: shape (N, 3), [m].
        sigma: Standard deviation of a coordinate of each point, shape (N,) [m]; None: all alike, estimated from the
            residuals.
        robust: True to reject outliers.

    Returns:
        The plane.

    Raises:
        CalibError: Fewer than four points, or points on a line.
    """
    plane, _ = _fit_robustly(nearest_plane, points, sigma, robust=robust)
    return plane


def fit_circle(points: Array, sigma: Array | None = None, *, robust: bool = True) -> Circle:
    """Fit the circle of least orthogonal distances.

    Args:
        points: shape (N, 3), [m].
        sigma: Standard deviation of a coordinate of each point, shape (N,) [m]; None: all alike, estimated from the
            residuals.
        robust: True to reject outliers.

    Returns:
        The circle.

    Raises:
        CalibError: Fewer than four points, points on a line, or an arc too short for its noise.
    """
    try:
        plane, radius = _fit_robustly(nearest_circle, points, sigma, robust=robust)
    except ValueError as error:  # no size, or the radius has no effect that the centre has not
        raise CalibError(TOO_SHORT) from error
    if not 0.0 <= plane.covariance[5, 5] <= (_VAGUE * radius) ** 2:
        raise CalibError(TOO_SHORT)
    common: dict[str, Any] = {f.name: getattr(plane, f.name) for f in fields(plane)}
    u, v, _ = ((points - plane.point) @ plane.basis).T
    return Circle(**common, radius=radius, angles=read_only(np.arctan2(v, u)))


def _fit_robustly(
    figure: Callable[[Array, Array, Mask], FittedFigure],
    points: Array,
    sigma: Array | None,
    *,
    robust: bool,
) -> tuple[Plane, float]:
    """Fit a figure to all points but the outliers.

    Args:
        figure: Fits it to points (N, 3) [m] with weights (N,) of which some are used, (N,).
        points: shape (N, 3), [m].
        sigma: Standard deviation of a coordinate of each point, shape (N,) [m]; None: all alike, estimated from the
            residuals.
        robust: True to reject outliers.

    Returns:
        The figure with its covariance, and its radius [m], infinite for a plane.
    """
    if len(points) < FEWEST:
        raise CalibError(
            f"there are {len(points)} points; it takes {FEWEST} at least and should be 10 or more. Measure more"
        )
    # Their harmonic mean is 1: of the noise's variance, in its own unit.
    weights = np.ones(len(points)) if sigma is None else np.mean(sigma**2) / sigma**2
    fit = partial(figure, points, np.asarray(weights))
    used = np.ones(len(points), dtype=np.bool_)
    if robust:
        used = _without_outliers(fit, weights)
    fitted = fit(used)
    noise = _Noise.of(fitted, used, weights, sigma)
    inverse = _inverse_normal_matrix(fitted, used, weights)
    used.setflags(write=False)
    plane = Plane(
        point=read_only(fitted.point),
        basis=read_only(fitted.basis),
        covariance=read_only(noise.variance * inverse),
        residuals=read_only(fitted.residuals),
        used=used,
        noise=noise.estimated,
        given=noise.given,
        dof=noise.dof,
    )
    return plane, fitted.radius


@dataclass(frozen=True, slots=True)
class _Noise:
    """Standard deviation of one coordinate of the points, as given and as the residuals have it."""

    #: From the residuals [m]
    estimated: float
    #: Degrees of freedom of the residuals
    freedom: int
    #: As given, root of the mean square over the points [m]; None where none was
    given: float | None

    @classmethod
    def of(cls, fitted: FittedFigure, used: Mask, weights: Array, sigma: Array | None) -> _Noise:
        """Estimate the noise of a fit.

        Args:
            fitted: The figure, with the residuals of all N points.
            used: shape (N,), points that it was fitted to.
            weights: shape (N,), of the points.
            sigma: Standard deviation of a coordinate of each point as given, shape (N,) [m]; None: not given.
        """
        count, k, p = fitted.jacobian[used].shape
        freedom = count * k - p
        w = np.repeat(weights[used], k)
        e = fitted.residuals[used].ravel()
        estimated = float(np.sqrt(w @ e**2 / freedom))
        given = None if sigma is None else float(np.sqrt(np.mean(sigma**2)))
        return cls(estimated, freedom, given)

    @property
    def believed(self) -> bool:
        """True if the noise was given and the residuals are not larger than it makes them."""
        if self.given is None:
            return False
        chi_square = self.freedom * (self.estimated / self.given) ** 2
        return bool(chdtrc(self.freedom, chi_square) >= LEVEL)

    @property
    def variance(self) -> float:
        """Variance of one coordinate [m^2]: the given one if it is believed, else that of the residuals."""
        std = self.estimated
        if self.given is not None and self.believed:
            std = self.given
        return max(std, FLOOR_M) ** 2

    @property
    def dof(self) -> float:
        """Degrees of freedom of `variance`; infinite for the given one."""
        return np.inf if self.believed else float(self.freedom)


def _inverse_normal_matrix(fitted: FittedFigure, used: Mask, weights: Array) -> Array:
    """Compute (J^T W J)^-1, shape (p, p): the covariance of a figure's displacements for noise of variance 1.

    Args:
        fitted: The figure, with the Jacobian J of the residuals of all N points.
        used: shape (N,), points that it was fitted to.
        weights: shape (N,), of the points.
    """
    _, k, p = fitted.jacobian.shape
    J = fitted.jacobian[used].reshape(-1, p)
    w = np.repeat(weights[used], k)
    # Lengths beside angles: scaled before the inversion.
    norm = np.sqrt(w @ J**2)
    scaled = J / norm
    normal_matrix = scaled.T @ (w[:, None] * scaled)
    return np.asarray(np.linalg.inv(normal_matrix) / np.outer(norm, norm))


def _without_outliers(fit: Callable[[Mask], FittedFigure], weights: Array) -> Mask:
    """Return the points that are no outliers, shape (N,); see the module's text.

    Args:
        fit: Fits the figure to some of the points.
        weights: Of the points, shape (N,).
    """
    used = np.ones(len(weights), dtype=np.bool_)
    for _ in range(max(1, int(_SHARE * len(weights)))):
        residuals, jacobian, *_ = fit(used)
        root = np.sqrt(weights[used])
        whitened = root[:, None] * residuals[used]
        outlier = _outlier(whitened, root[:, None, None] * jacobian[used])
        if outlier is None:
            break
        used[np.flatnonzero(used)[outlier]] = False
    return used


def _outlier(residuals: Array, jacobian: Array) -> int | None:
    """Return the number of the point that is an outlier more than all others, from 0; None where none is one.

    Args:
        residuals: Whitened, of the N points that a figure was fitted to, shape (N, k).
        jacobian: Of these by the figure's p displacements, shape (N, k, p).
    """
    count, k, p = jacobian.shape
    freedom = count * k - p - k
    if freedom < k + 1:
        return None
    drops = _drop_by_point(residuals, jacobian)
    worst = int(np.argmax(drops))
    drop = drops[worst]
    if drop <= 0.0:
        return None
    total = float(np.sum(residuals**2))
    remaining = max(total - drop, np.finfo(np.float64).eps * total)
    F = drop / k / (remaining / freedom)
    # The largest of N points counts where N times its tail is small.
    if count * fdtrc(k, freedom, F) >= LEVEL:
        return None
    return worst


def _drop_by_point(residuals: Array, jacobian: Array) -> Array:
    """Compute by how much each point lowers the sum of squares if it gets a displacement of its own.

    It is e^T (I - H)^-1 e of the point's residuals e and their block H of the hat matrix; 0 for a point that alone
    determines a direction of the fit, where it has no residual.

    Args:
        residuals: Whitened, shape (N, k).
        jacobian: Of these, shape (N, k, p).

    Returns:
        shape (N,).
    """
    count, k, p = jacobian.shape
    orthonormal, _ = np.linalg.qr(jacobian.reshape(-1, p))
    Q = orthonormal.reshape(count, k, p)
    free = np.eye(k) - Q @ np.swapaxes(Q, 1, 2)
    least = np.linalg.eigvalsh(free)[:, 0]
    testable = least > _TESTABLE
    e = residuals[testable]
    deleted = np.linalg.solve(free[testable], e[..., None])[..., 0]
    drop = np.zeros(count)
    drop[testable] = np.einsum("ni,ni->n", e, deleted)
    return drop
