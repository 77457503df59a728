"""Planes and circles through points in space by least squares of the orthogonal distances, with their uncertainty.

A point p lies off a circle (centre c, unit normal n, radius r) by two distances, across the circle's plane and in it:

    axial  = n . (p - c)          radial = |p - c - axial n| - r

and the fit is the minimum of the weighted sum of their squares, found by Levenberg-Marquardt from Taubin's circle.
Under equal noise in x, y, z that is the maximum-likelihood fit (the points' places along the circle drop out). Its
centre has no essential bias (A. Al-Sharadqah and N. Chernov, 2009), not on short arcs either: on 30 deg of a radius of
0.3 m it is below a twentieth of the Kasa fit's, with noise from 0.03 to 1 mm (scripts/base_frame_study.py). Its radius
is sigma^2 / 2 r too large, some nanometres, and on short arcs by what a wrong tilt of its plane adds: 0.4 um of a
standard deviation of 0.5 mm on 30 deg with noise of 33 um.

A plane is the total least-squares one. Uncertainties are covariances of small displacements along the columns
(u, v, normal) of the figure's own basis.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from calib.errors import CalibError
from calib.measure.algebraic_circles import Ring, algebraic_circle, principal_axes
from calib.measure.scatter import (
    Scatter,
    check_count,
    check_spread,
    inverse_normal,
    keep_all_but_gross,
    scatter_of,
    weights_of,
)
from calib.model.robot import read_only

Array = NDArray[np.float64]

# Of a radius that is not known to this share of itself neither is the centre.
_VAGUE = 0.25

_TOO_SHORT = (
    "the arc is too short for its noise: no circle can be told from others. Let the joint turn further, or fix the "
    "target further from its axis"
)

_ITERATIONS = 200
_CONVERGED = 1e-13


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """A plane through N points.

    Attributes:
        point: On the plane, the points' weighted mean, shape (3,) [m].
        basis: Columns u, v, normal; shape (3, 3).
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
    used: NDArray[np.bool_]
    scatter: Scatter

    @property
    def normal(self) -> Array:
        """Unit normal, shape (3,); its sense means nothing."""
        return self.basis[:, 2]

    def turned(self) -> Plane:
        """The same plane with the opposite normal."""
        # (u, v, n) -> (v, u, -n): offset and tilts change their signs, and the tilts their places.
        swap = np.array([[-1.0, 0, 0], [0, 0, -1.0], [0, -1.0, 0]])
        return Plane(
            self.point,
            read_only(self.basis[:, [1, 0, 2]] * [1.0, 1.0, -1.0]),
            read_only(swap @ self.covariance @ swap.T),
            read_only(-self.residuals),
            self.used,
            self.scatter,
        )


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
    used: NDArray[np.bool_]
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
        return Circle(
            self.center,
            read_only(self.basis * [1.0, -1.0, -1.0]),
            self.radius,
            read_only(self.covariance * np.outer(signs, signs)),
            read_only(self.residuals * [1.0, -1.0]),
            read_only(-self.angles),
            self.used,
            self.scatter,
        )


def fit_plane(points: Array, sigma: Array | None = None, *, robust: bool = True) -> Plane:
    """The total least-squares plane.

    Args:
        points: shape (N, 3), [m].
        sigma: Standard deviation of a coordinate of each point, shape (N,) [m]; None: alike, found from the residuals.
        robust: Whether gross points are left out; see `calib.measure.scatter`.

    Raises:
        CalibError: Fewer than four points, or points on a line.
    """
    check_count(points, "a plane")
    used = keep_all_but_gross(partial(_plane_problem, points, sigma), len(points), robust=robust)
    residuals, jacobian, weights, (point, basis) = _plane_problem(points, sigma, used)
    scatter = scatter_of(residuals[used], jacobian[used], weights[used], sigma)
    return Plane(
        read_only(point),
        read_only(basis),
        read_only(scatter.sigma**2 * inverse_normal(jacobian[used], weights[used])),
        read_only(residuals),
        used,
        scatter,
    )


def fit_circle(points: Array, sigma: Array | None = None, *, robust: bool = True) -> Circle:
    """The circle of least orthogonal distances.

    Args:
        points: shape (N, 3), [m].
        sigma: Standard deviation of a coordinate of each point, shape (N,) [m]; None: alike, found from the residuals.
        robust: Whether gross points are left out; see `calib.measure.scatter`.

    Raises:
        CalibError: Fewer than four points, points on a line, or an arc too short for its noise.
    """
    check_count(points, "a circle")
    used = keep_all_but_gross(partial(_circle_problem, points, sigma), len(points), robust=robust)
    residuals, jacobian, weights, ring = _circle_problem(points, sigma, used)
    scatter = scatter_of(residuals[used], jacobian[used], weights[used], sigma)
    basis = circle_basis(points[used], ring)
    try:
        covariance = scatter.sigma**2 * inverse_normal(jacobian[used], weights[used])
    except np.linalg.LinAlgError as error:  # the radius has no effect that the centre has not
        raise CalibError(_TOO_SHORT) from error
    if not 0.0 <= covariance[5, 5] <= (_VAGUE * ring.radius) ** 2:
        raise CalibError(_TOO_SHORT)
    return Circle(
        read_only(ring.center),
        read_only(basis),
        ring.radius,
        read_only(covariance),
        read_only(residuals),
        read_only(_angles(points, ring.center, basis)),
        used,
        scatter,
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


def _frame(normal: Array, near: Array) -> Array:
    """A right-handed basis, columns u, v, normal, with u as near as possible to a direction; shape (3, 3)."""
    n = normal / np.linalg.norm(normal)
    u = near - n * (n @ near)
    length = np.linalg.norm(u)
    if length < 1e-12 * max(
        1.0, float(np.linalg.norm(near))
    ):  # along the normal: any other will do
        u = np.eye(3)[int(np.argmin(np.abs(n)))]
        u = u - n * (n @ u)
        length = np.linalg.norm(u)
    u = u / length
    # Written out: `numpy.cross` takes longer than the rest of this function.
    v = (n[1] * u[2] - n[2] * u[1], n[2] * u[0] - n[0] * u[2], n[0] * u[1] - n[1] * u[0])
    return np.column_stack([u, v, n])


def _angles(points: Array, center: Array, basis: Array) -> Array:
    """Angles of points about the normal, from u, shape (N,) [rad]."""
    local = (points - center) @ basis
    return np.asarray(np.arctan2(local[:, 1], local[:, 0]))


def _plane_problem(
    points: Array, sigma: Array | None, used: NDArray[np.bool_]
) -> tuple[Array, Array, Array, tuple[Array, Array]]:
    """Residuals (N, 1), Jacobian (N, 1, 3), weights (N,), and the plane's point and basis, of the points used."""
    weights = weights_of(sigma, len(points))
    point, basis, spread = principal_axes(points[used], weights[used])
    check_spread(
        spread,
        "no plane lies through them alone. Touch it at places that are well apart, not in a row",
    )
    local = (points - point) @ basis
    J = np.concatenate([-np.ones((len(points), 1)), local[:, :2]], axis=1)[:, None, :]
    return local[:, 2:], J, weights, (point, basis)


def _circle_problem(
    points: Array, sigma: Array | None, used: NDArray[np.bool_]
) -> tuple[Array, Array, Array, Ring]:
    """Residuals (N, 2), Jacobian (N, 2, 6), weights (N,), and the circle of the points used."""
    weights = weights_of(sigma, len(points))
    check_spread(
        principal_axes(points[used], weights[used])[2],
        "no circle lies through them. Let the joint turn further, or fix the target further from its axis",
    )
    ring = _solve(points[used], weights[used])
    basis = circle_basis(points[used], ring)
    residuals, J = circle_residuals(points, ring, basis)
    return residuals, J, weights, ring


def _solve(points: Array, weights: Array) -> Ring:
    """Levenberg-Marquardt from Taubin's circle, in units of the start's radius."""
    start = algebraic_circle(points, "taubin", weights)
    scale, origin = start.radius, points.mean(axis=0)
    scaled = (points - origin) / scale
    ring = Ring((start.center - origin) / scale, start.normal, 1.0)
    root = np.sqrt(weights / weights.mean())[:, None]
    basis = circle_basis(scaled, ring)
    residuals, J = circle_residuals(scaled, ring, basis)
    cost = float(np.sum((root * residuals) ** 2))
    damping = 1e-6
    for _ in range(_ITERATIONS):
        A = (root[..., None] * J).reshape(-1, 6)
        N, gradient = A.T @ A, A.T @ (root * residuals).ravel()
        step = -np.linalg.solve(N + damping * np.diag(np.diag(N)), gradient)
        moved = Ring(
            ring.center + basis @ step[:3],
            basis @ np.array([step[3], step[4], 1.0]) / np.sqrt(1.0 + step[3] ** 2 + step[4] ** 2),
            ring.radius + float(step[5]),
        )
        new_basis = _frame(moved.normal, basis[:, 0])
        new_residuals, new_J = circle_residuals(scaled, moved, new_basis)
        new_cost = float(np.sum((root * new_residuals) ** 2))
        small = float(np.abs(step).max()) < _CONVERGED * max(1.0, ring.radius)
        if new_cost <= cost:
            gained = cost - new_cost
            ring, basis, residuals, J, cost = moved, new_basis, new_residuals, new_J, new_cost
            damping = max(0.1 * damping, 1e-15)
            # Near the minimum the cost changes by the square of the step: a tiny gain alone does not say it is there.
            if small or (gained <= 1e-16 * cost and np.abs(step).max() < 1e-9 * ring.radius):
                break
        elif small or damping > 1e12:
            break
        else:
            damping *= 10.0
    else:
        raise CalibError(_TOO_SHORT)
    return Ring(origin + scale * ring.center, ring.normal, scale * ring.radius)
