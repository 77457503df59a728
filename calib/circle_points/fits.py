"""Planes and circles through points in space by least squares of the orthogonal distances, with their uncertainty.

A point p lies off a circle (centre c, unit normal n, radius r) by two distances, in the circle's plane and across it:

    radial = |p - c - axial n| - r          axial = n . (p - c)

and the fit is the minimum of the weighted sum of their squares. Under equal noise in x, y, z that is the
maximum-likelihood fit, and its centre has no essential bias on short arcs either (A. Al-Sharadqah and N. Chernov,
Electronic Journal of Statistics 3, 2009). A plane is the total least-squares one. Uncertainties are covariances of
small displacements along the columns (u, v, normal) of the figure's own basis, sigma^2 (J^T W J)^-1.

An outlier is a point whose own displacement explains more than chance does: with the point's k residuals e and
their block H of the hat matrix, giving the point its own displacement lowers the sum of squares by e^T (I - H)^-1 e,
which over the rest is F(k, dof - k). The largest of N points counts where N times its tail is below 0.001; then the
point is left out, the fit made again, and the next one looked at.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.special import chdtrc, fdtrc

from calib.errors import CalibError
from calib.robot.robot import read_only
from calib.units import Array, Mask

#: Fewest points: those that determine the figure and one more, or there is nothing to tell the noise from.
FEWEST = 4

#: Points that stay within this do not move, rms about their mean [m].
STILL_M = 1e-3

#: No instrument is better than this, and without noise there is no covariance [m].
FLOOR_M = 1e-9

#: Chance of a finding where there is nothing but noise.
LEVEL = 1e-3

#: At most this share of the points are outliers.
_SHARE = 0.1

#: Points are on a line if they spread along the second axis by less than this share of the first one ...
_THIN = 1e-9

#: ... or by less than this many times their spread along the third.
_IN_NOISE = 1.5

#: A point is tested as an outlier if the least eigenvalue of its block of I - H is above this.
_TESTABLE = 1e-6

#: Where the radius is not known to this share of itself, the centre is not known either.
_VAGUE = 0.25

_TOO_SHORT = (
    "the arc is too short for its noise: no circle can be told from others. Let the joint turn further, or fix the "
    "target further from its axis"
)


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
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


class _Fit(NamedTuple):
    """Plane or circle fitted to some of N points; residuals and Jacobian are those of all of them."""

    #: (N, k) [m]
    residuals: Array
    #: (N, k, p), of the residuals by the displacements of the figure
    jacobian: Array
    #: (3,), on the plane, or the centre [m]
    point: Array
    #: (3, 3), columns u, v, normal
    basis: Array
    #: [m]
    radius: float = np.inf


def fit_plane(points: Array, sigma: Array | None = None, *, robust: bool = True) -> Plane:
    """Fit the total least-squares plane.

    Args:
        points: shape (N, 3), [m].
        sigma: Standard deviation of a coordinate of each point, shape (N,) [m]; None: all alike, estimated from the
            residuals.
        robust: Whether outliers are rejected.

    Returns:
        The plane.

    Raises:
        CalibError: Fewer than four points, or points on a line.
    """
    plane, _ = _fit_robustly(_plane_fit, points, sigma, robust=robust)
    return plane


def fit_circle(points: Array, sigma: Array | None = None, *, robust: bool = True) -> Circle:
    """Fit the circle of least orthogonal distances.

    Args:
        points: See `fit_plane`.
        sigma: See `fit_plane`.
        robust: See `fit_plane`.

    Returns:
        The circle.

    Raises:
        CalibError: Fewer than four points, points on a line, or an arc too short for its noise.
    """
    try:
        plane, radius = _fit_robustly(_circle_fit, points, sigma, robust=robust)
    except ValueError as error:  # no size, or the radius has no effect that the centre has not
        raise CalibError(_TOO_SHORT) from error
    if not 0.0 <= plane.covariance[5, 5] <= (_VAGUE * radius) ** 2:
        raise CalibError(_TOO_SHORT)
    common: dict[str, Any] = {f.name: getattr(plane, f.name) for f in fields(plane)}
    u, v, _ = ((points - plane.point) @ plane.basis).T
    return Circle(**common, radius=radius, angles=read_only(np.arctan2(v, u)))


def circle_residuals(
    points: Array, center: Array, basis: Array, radius: float
) -> tuple[Array, Array]:
    """Compute radial and axial distances of points from a circle, and their derivatives.

    Args:
        points: shape (N, 3), [m].
        center: shape (3,), [m].
        basis: Columns u, v, normal, shape (3, 3).
        radius: [m].

    Returns:
        Distances, shape (N, 2) [m], and their Jacobian, shape (N, 2, 6): by the centre's displacement along u, v,
        normal [m], the normal's tilt towards u and v [rad], and the radius [m].
    """
    local = (points - center) @ basis
    axial = local[:, 2]
    across = np.hypot(local[:, 0], local[:, 1])
    # A point on the axis has no direction in the plane; any will do.
    e = local[:, :2] / np.where(across > 0.0, across, 1.0)[:, None]
    J = np.zeros((len(points), 2, 6))
    J[:, 0, :2] = -e
    J[:, 0, 3:5] = -axial[:, None] * e
    J[:, 0, 5] = -1.0
    J[:, 1, 2] = -1.0
    J[:, 1, 3:5] = local[:, :2]
    return np.stack([across - radius, axial], axis=1), J


def _fit_robustly(
    figure: Callable[[Array, Array, Mask], _Fit],
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
        robust: Whether outliers are rejected.

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
    def of(cls, fitted: _Fit, used: Mask, weights: Array, sigma: Array | None) -> _Noise:
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


def _inverse_normal_matrix(fitted: _Fit, used: Mask, weights: Array) -> Array:
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


def _without_outliers(fit: Callable[[Mask], _Fit], weights: Array) -> Mask:
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


def _plane_fit(points: Array, weights: Array, used: Mask) -> _Fit:
    """Fit the plane of least weighted squared distances.

    Args:
        points: shape (N, 3), [m].
        weights: shape (N,), of the points.
        used: shape (N,), points that the plane is fitted to.
    """
    point, basis = _principal_axes(points[used], weights[used])
    local = (points - point) @ basis
    by_shift = -np.ones((len(points), 1))
    J = np.concatenate([by_shift, local[:, :2]], axis=1)
    return _Fit(local[:, 2:], J[:, None, :], point, basis)


def _circle_fit(points: Array, weights: Array, used: Mask) -> _Fit:
    """Fit the circle of least weighted squared distances: Levenberg-Marquardt from the algebraic circle.

    Args:
        points: shape (N, 3), [m].
        weights: shape (N,), of the points.
        used: shape (N,), points that the circle is fitted to.
    """
    start = _algebraic_circle(points[used], weights[used])
    circle = _nearest_circle(start, points[used], weights[used])
    residuals, J = circle_residuals(points, *circle)
    return _Fit(residuals, J, circle.center, circle.basis, circle.radius)


class _PlacedCircle(NamedTuple):
    """A circle in space."""

    #: (3,), [m]
    center: Array
    #: (3, 3), columns u, v, normal
    basis: Array
    #: [m]
    radius: float

    def displaced(self, x: Array) -> _PlacedCircle:
        """Return the circle displaced.

        Args:
            x: shape (6,), displacement of the centre along u, v, normal [m], tilt of the normal towards u and v as the
                tangent of its angle, and growth of the radius [m].
        """
        normal = self.basis @ np.array([x[3], x[4], 1.0])
        basis = _frame(normal / np.linalg.norm(normal), self.basis[:, 0])
        center = self.center + self.basis @ x[:3]
        return _PlacedCircle(center, basis, self.radius + float(x[5]))


def _algebraic_circle(points: Array, weights: Array) -> _PlacedCircle:
    """Fit a circle in the plane of the points, by the linear equation x^2 + y^2 = 2 a x + 2 b y + c.

    Args:
        points: shape (N, 3), [m].
        weights: shape (N,), of the points.
    """
    mean, axes = _principal_axes(points, weights)
    xy = (points - mean) @ axes[:, :2]
    design = np.column_stack([2.0 * xy, np.ones(len(xy))])
    squares = (xy**2).sum(axis=1)
    a, b, c = np.linalg.lstsq(design, squares, rcond=None)[0]
    center = mean + axes @ [a, b, 0.0]
    radius = float(np.sqrt(a * a + b * b + c))
    return _PlacedCircle(center, _frame(axes[:, 2], points[0] - center), radius)


def _nearest_circle(start: _PlacedCircle, points: Array, weights: Array) -> _PlacedCircle:
    """Refine a circle to least weighted squared radial and axial distances, by Levenberg-Marquardt.

    Args:
        start: A circle near to the points.
        points: shape (N, 3), [m].
        weights: shape (N,), of the points.

    Raises:
        CalibError: It does not converge.
    """
    root = np.sqrt(weights / weights.mean())[:, None]

    def residuals(x: Array) -> Array:
        """Return the weighted distances of the points from the circle displaced by x, shape (2 N,)."""
        distances, _ = circle_residuals(points, *start.displaced(x))
        return np.ravel(root * distances)

    def jacobian(x: Array) -> Array:
        """Differentiate by displacements of the circle at x, which span what those of x do: the minimum is the same."""
        _, J = circle_residuals(points, *start.displaced(x))
        return np.reshape(root[..., None] * J, (-1, 6))

    tight = dict.fromkeys(("xtol", "ftol", "gtol"), float(np.finfo(np.float64).eps))
    solution = least_squares(residuals, np.zeros(6), jacobian, method="lm", **tight)
    if solution.status <= 0:
        raise CalibError(_TOO_SHORT)
    return start.displaced(solution.x)


def _principal_axes(points: Array, weights: Array) -> tuple[Array, Array]:
    """Return weighted mean and principal axes of points.

    Args:
        points: shape (N, 3), [m].
        weights: shape (N,), of the points.

    Returns:
        The mean, shape (3,) [m], and the axes, columns of a right-handed basis of shape (3, 3), the longest first.

    Raises:
        CalibError: The points are on a spot or a line.
    """
    mean: Array = weights @ points / weights.sum()
    share = np.sqrt(weights / weights.sum())
    _, spread, rows = np.linalg.svd(share[:, None] * (points - mean), full_matrices=False)
    is_spot = np.linalg.norm(spread) < STILL_M
    if is_spot or spread[1] <= max(_THIN * spread[0], _IN_NOISE * spread[2]):
        raise CalibError(
            f"the points are on a spot or a line (they spread over {1e3 * spread[0]:.3g} mm along it and "
            f"{1e3 * spread[1]:.3g} mm across). Touch a plane at places well apart, and let a joint turn further"
        )
    basis = rows.T.copy()
    basis[:, 2] *= np.sign(np.linalg.det(basis))
    return mean, basis


def _frame(normal: Array, near: Array) -> Array:
    """Return a right-handed basis, columns u, v, normal, shape (3, 3), with u as near as possible to a direction.

    Args:
        normal: shape (3,), unit vector.
        near: shape (3,), direction, of any length but not along the normal.
    """
    u = near - normal * (normal @ near)
    u = u / np.linalg.norm(u)
    return np.column_stack([u, np.cross(normal, u), normal])
