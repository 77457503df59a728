"""Planes and circles through points in space by least squares of the orthogonal distances, with their uncertainty.

A point p lies off a circle (centre c, unit normal n, radius r) by two distances, in the circle's plane and across it:

    radial = |p - c - axial n| - r          axial = n . (p - c)

and the fit is the minimum of the weighted sum of their squares, found by Levenberg-Marquardt from Taubin's algebraic
circle (G. Taubin, 1991). Under equal noise in x, y, z that is the maximum-likelihood fit, and its centre has no
essential bias on short arcs either (A. Al-Sharadqah and N. Chernov, Electronic Journal of Statistics 3, 2009). A plane
is the total least-squares one. Uncertainties are covariances of small displacements along the columns (u, v, normal)
of the figure's own basis.

"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from calib.base_frame.scatter import Fit, Mask, Scatter, judged
from calib.errors import CalibError
from calib.model.robot import read_only

Array = NDArray[np.float64]

#: Fewest points: those that determine the figure and one more, or there is nothing to tell the noise from.
FEWEST = 4

# Lines and spots: spread along the second axis, in that along the first one or in the noise.
_THIN = 1e-9
_IN_NOISE = 1.5

# Of a radius that is not known to this share of itself neither is the centre.
_VAGUE = 0.25

_TOO_SHORT = (
    "the arc is too short for its noise: no circle can be told from others. Let the joint turn further, or fix the "
    "target further from its axis"
)


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """A plane through N points.

    Attributes:
        point: On the plane, the points' weighted mean, shape (3,) [m].
        basis: Columns u, v, normal; shape (3, 3). The normal's sense means nothing.
        covariance: shape (3, 3), of the displacement along the normal at ``point`` [m] and of the normal's tilt towards
            u and v [rad].
        residuals: Signed distances of all points, shape (N, 1) [m].
        used: Which points the plane is fitted to, shape (N,); the others are gross.
        scatter: What is known of the noise.
    """

    point: Array
    basis: Array
    covariance: Array
    residuals: Array
    used: Mask
    scatter: Scatter

    @property
    def normal(self) -> Array:
        """Unit normal, shape (3,); its sense means nothing."""
        return self.basis[:, 2]


@dataclass(frozen=True, slots=True, eq=False)
class Circle:
    """A circle through N points; what the points do along it is not part of the fit.

    Attributes:
        center: shape (3,) [m].
        basis: Columns u, v, normal; shape (3, 3). u points from the centre to the middle of the arc.
        radius: [m].
        covariance: shape (6, 6), of the centre's displacement along u, v, normal [m], of the normal's tilt towards u
            and v [rad], and of the radius [m].
        residuals: Radial and axial distances of all points, shape (N, 2) [m].
        angles: Of the points about the normal, from u, in (-pi, pi], shape (N,) [rad].
        used: Which points the circle is fitted to, shape (N,); the others are gross.
        scatter: What is known of the noise.
    """

    center: Array
    basis: Array
    radius: float
    covariance: Array
    residuals: Array
    angles: Array
    used: Mask
    scatter: Scatter

    @property
    def normal(self) -> Array:
        """Unit normal, shape (3,): positive angles turn about it."""
        return self.basis[:, 2]

    @property
    def arc(self) -> float:
        """The angle that the points cover: a full turn less the largest gap between neighbours [rad]."""
        angles = np.sort(self.angles[self.used])
        gaps = np.diff(angles, append=angles[0] + 2.0 * np.pi)
        return float(2.0 * np.pi - gaps.max())

    def turned(self) -> Circle:
        """The same circle with the opposite normal."""
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


class Ring(NamedTuple):
    """A circle without its uncertainty: centre (3,) [m], unit normal (3,), radius [m]."""

    center: Array
    normal: Array
    radius: float


def fit_plane(points: Array, sigma: Array | None = None, *, robust: bool = True) -> Plane:
    """The total least-squares plane.

    Args:
        points: shape (N, 3), [m].
        sigma: Standard deviation of a coordinate of each point, shape (N,) [m]; None: alike, found from the residuals.
        robust: Whether gross points are left out; see `calib.base_frame.scatter`.

    Raises:
        CalibError: Fewer than four points, or points on a line.
    """
    _check_count(points, "a plane")
    found = judged(partial(_plane_fit, points), sigma, len(points), robust=robust)
    point, basis = found.figure
    return Plane(
        read_only(point),
        read_only(basis),
        found.covariance,
        found.residuals,
        found.used,
        found.scatter,
    )


def fit_circle(points: Array, sigma: Array | None = None, *, robust: bool = True) -> Circle:
    """The circle of least orthogonal distances.

    Args:
        points: shape (N, 3), [m].
        sigma: Standard deviation of a coordinate of each point, shape (N,) [m]; None: alike, found from the residuals.
        robust: Whether gross points are left out; see `calib.base_frame.scatter`.

    Raises:
        CalibError: Fewer than four points, points on a line, or an arc too short for its noise.
    """
    _check_count(points, "a circle")
    try:
        found = judged(partial(_circle_fit, points), sigma, len(points), robust=robust)
    except np.linalg.LinAlgError as error:  # the radius has no effect that the centre has not
        raise CalibError(_TOO_SHORT) from error
    ring = found.figure
    if not 0.0 <= found.covariance[5, 5] <= (_VAGUE * ring.radius) ** 2:
        raise CalibError(_TOO_SHORT)
    basis = circle_basis(points[found.used], ring)
    return Circle(
        read_only(ring.center),
        read_only(basis),
        ring.radius,
        found.covariance,
        found.residuals,
        read_only(_angles(points, ring.center, basis)),
        found.used,
        found.scatter,
    )


def circle_residuals(points: Array, ring: Ring, basis: Array) -> tuple[Array, Array]:
    """Radial and axial distances, and their Jacobian.

    Args:
        points: shape (N, 3), [m].
        ring: The circle.
        basis: Columns u, v, normal; shape (3, 3).

    Returns:
        shape (N, 2) [m], and shape (N, 2, 6): by the centre's displacement along u, v, normal, the normal's tilt
        towards u and v, and the radius.
    """
    local = (points - ring.center) @ basis
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
    return np.stack([across - ring.radius, axial], axis=1), J


def circle_basis(points: Array, ring: Ring) -> Array:
    """Columns u, v, normal of a circle; u from its centre towards the middle of an arc, for a whole one anywhere."""
    across = _frame(ring.normal, points[0] - ring.center)
    angles = np.sort(_angles(points, ring.center, across))
    gaps = np.diff(angles, append=angles[0] + 2.0 * np.pi)
    last = int(np.argmax(gaps))  # the arc begins behind the largest gap
    middle = angles[last] + gaps[last] + 0.5 * (2.0 * np.pi - gaps[last])
    return _frame(ring.normal, across @ np.array([np.cos(middle), np.sin(middle), 0.0]))


def taubin_circle(points: Array, weights: Array) -> Ring:
    """Taubin's algebraic circle in the points' least-squares plane, where the fit begins.

    A (x^2 + y^2) + B x + C y + D = 0 by least squares of its left side, its mean squared gradient being 1.

    Args:
        points: shape (N, 3), [m].
        weights: shape (N,).
    """
    mean, basis, spread = _principal_axes(points, weights)
    scale = float(np.hypot(spread[0], spread[1]))
    xy = (points - mean) @ basis[:, :2] / scale
    square = (xy**2).sum(axis=1)
    height = float(weights @ square / weights.sum())
    design = np.column_stack([(square - height) / (2.0 * np.sqrt(height)), xy])
    a, b, c = np.linalg.svd(np.sqrt(weights)[:, None] * design, full_matrices=False)[2][2]
    a /= 2.0 * np.sqrt(height)
    if abs(a) < 1e-12:  # a straight line
        raise CalibError(_TOO_SHORT)
    center = -np.array([b, c]) / (2.0 * a)
    radius = float(np.sqrt((b * b + c * c) / (4.0 * a * a) + height))
    return Ring(mean + scale * basis[:, :2] @ center, basis[:, 2], scale * radius)


# The fits


def _plane_fit(points: Array, weights: Array, used: Mask) -> Fit[tuple[Array, Array]]:
    """The plane of the points used: a point and the basis."""
    point, basis, spread = _principal_axes(points[used], weights[used])
    _check_spread(
        spread,
        "no plane lies through them alone. Touch it at places that are well apart, not in a row",
    )
    local = (points - point) @ basis
    J = np.concatenate([-np.ones((len(points), 1)), local[:, :2]], axis=1)[:, None, :]
    return Fit(local[:, 2:], J, (point, basis))


def _circle_fit(points: Array, weights: Array, used: Mask) -> Fit[Ring]:
    """The circle of the points used."""
    _check_spread(
        _principal_axes(points[used], weights[used])[2],
        "no circle lies through them. Let the joint turn further, or fix the target further from its axis",
    )
    ring = _solve(points[used], weights[used])
    residuals, J = circle_residuals(points, ring, circle_basis(points[used], ring))
    return Fit(residuals, J, ring)


def _solve(points: Array, weights: Array) -> Ring:
    """Levenberg-Marquardt from Taubin's circle, in units of its radius and about its centre."""
    start = taubin_circle(points, weights)
    local = (points - start.center) / start.radius
    B = circle_basis(points, start)
    root = np.sqrt(weights / weights.mean())[:, None]

    def at(x: Array) -> tuple[Ring, Array]:
        """The circle displaced by x, and its basis."""
        n = B @ np.array([x[3], x[4], 1.0])
        ring = Ring(B @ x[:3], n / np.linalg.norm(n), 1.0 + float(x[5]))
        return ring, _frame(ring.normal, B[:, 0])

    def residuals(x: Array) -> Array:
        return np.asarray((root * circle_residuals(local, *at(x))[0]).ravel())

    def jacobian(x: Array) -> Array:
        """By x, from that by small displacements of the displaced circle."""
        ring, basis = at(x)
        J = circle_residuals(local, ring, basis)[1]
        moved = np.zeros((6, 6))
        moved[:3, :3] = basis.T @ B
        moved[3:5, 3:5] = basis[:, :2].T @ B[:, :2] / np.sqrt(1.0 + x[3] ** 2 + x[4] ** 2)
        moved[5, 5] = 1.0
        return np.asarray((root[..., None] * (J @ moved)).reshape(-1, 6))

    eps = np.finfo(np.float64).eps
    try:
        found = least_squares(
            residuals, np.zeros(6), jacobian, method="lm", xtol=eps, ftol=eps, gtol=eps
        )
    except (ValueError, np.linalg.LinAlgError) as error:  # on its way to a circle of no size
        raise CalibError(_TOO_SHORT) from error
    if found.status <= 0:
        raise CalibError(_TOO_SHORT)
    ring, _ = at(found.x)
    return Ring(start.center + start.radius * ring.center, ring.normal, start.radius * ring.radius)


def _check_count(points: Array, what: str) -> None:
    """Refuse too few points."""
    if len(points) < FEWEST:
        raise CalibError(
            f"there are {len(points)} points, {what} with its uncertainty needs {FEWEST} at least and "
            "should have 10 or more. Measure more"
        )


def _check_spread(spread: Array, consequence: str) -> None:
    """Refuse points on a spot or on a line, as far as their noise tells."""
    if spread[1] <= max(_THIN * spread[0], _IN_NOISE * spread[2]):
        raise CalibError(
            f"the points lie on a line (they spread over {1e3 * spread[0]:.3g} mm along it and {1e3 * spread[1]:.3g} "
            f"mm across): {consequence}"
        )


def _principal_axes(points: Array, weights: Array) -> tuple[Array, Array, Array]:
    """Weighted mean (3,) [m], principal axes (3, 3), the longest first, and standard deviations along them (3,) [m]."""
    mean: Array = weights @ points / weights.sum()
    share = np.sqrt(weights / weights.sum())
    _, spread, rows = np.linalg.svd(share[:, None] * (points - mean), full_matrices=False)
    basis = rows.T.copy()
    if np.linalg.det(basis) < 0.0:
        basis[:, 2] *= -1.0
    return mean, basis, spread


def _frame(normal: Array, near: Array) -> Array:
    """A right-handed basis, columns u, v, normal, with u as near as possible to a direction; shape (3, 3)."""
    n = normal / np.linalg.norm(normal)
    u = near - n * (n @ near)
    if np.linalg.norm(u) < 1e-12 * max(1.0, float(np.linalg.norm(near))):  # any other will do
        u = np.eye(3)[int(np.argmin(np.abs(n)))]
        u = u - n * (n @ u)
    u = u / np.linalg.norm(u)
    return np.column_stack([u, np.cross(n, u), n])


def _angles(points: Array, center: Array, basis: Array) -> Array:
    """Angles of points about the normal, from u, shape (N,) [rad]."""
    local = (points - center) @ basis
    return np.asarray(np.arctan2(local[:, 1], local[:, 0]))
