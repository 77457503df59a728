"""Planes and circles nearest to points in space: weighted least squares of the orthogonal distances.

A point p lies off a circle (centre c, unit normal n, radius r) by two distances, in the circle's plane and across it:

    radial = |p - c - axial n| - r          axial = n . (p - c)

and the fit is the minimum of the weighted sum of their squares. Under equal noise in x, y, z that is the
maximum-likelihood fit, and its centre has no essential bias on short arcs either (A. Al-Sharadqah and N. Chernov,
Electronic Journal of Statistics 3, 2009). A plane is the total least-squares one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from calib.basics.arrays import Array, Mask
from calib.errors import CalibError

#: Points that stay within this do not move, rms about their mean [m].
STILL_M = 1e-3

#: Points are on a line if they spread along the second axis by less than this share of the first one ...
_THIN = 1e-9

#: ... or by less than this many times their spread along the third.
_IN_NOISE = 1.5

#: Message for points that do not determine a circle.
TOO_SHORT = (
    "the arc is too short for its noise: no circle can be told from others. Let the joint turn further, or fix the "
    "target further from its axis"
)


class FittedFigure(NamedTuple):
    """Plane or circle fitted to some of N points; residuals and Jacobian are those of all of them."""

    #: (N, k), signed distances of the points: k = 1 from a plane, radial and axial from a circle [m]
    residuals: Array
    #: (N, k, p), derivative of the residuals by small displacements of the figure: along the normal [m] and the
    #: normal's tilt towards u and v [rad] for a plane, p = 3; as in `circle_residuals` for a circle, p = 6
    jacobian: Array
    #: (3,), on the plane, or the centre [m]
    point: Array
    #: (3, 3), columns u, v, normal
    basis: Array
    #: Of a circle [m]; infinite for a plane
    radius: float = np.inf


def nearest_plane(points: Array, weights: Array, used: Mask) -> FittedFigure:
    """Fit the plane of least weighted squared distances.

    Args:
        points: shape (N, 3), [m].
        weights: shape (N,), of the points.
        used: shape (N,), points that the plane is fitted to.

    Returns:
        The plane, with the residuals of all N points.

    Raises:
        CalibError: The points used are on a spot or a line.
    """
    point, basis = _principal_axes(points[used], weights[used])
    local = (points - point) @ basis
    by_shift = -np.ones((len(points), 1))
    J = np.concatenate([by_shift, local[:, :2]], axis=1)
    return FittedFigure(local[:, 2:], J[:, None, :], point, basis)


def nearest_circle(points: Array, weights: Array, used: Mask) -> FittedFigure:
    """Fit the circle of least weighted squared distances: Levenberg-Marquardt from the algebraic circle.

    Args:
        points: shape (N, 3), [m].
        weights: shape (N,), of the points.
        used: shape (N,), points that the circle is fitted to.

    Returns:
        The circle, u towards the first point used, with the residuals of all N points.

    Raises:
        CalibError: The points used are on a spot or a line, or the refinement does not converge.
        ValueError: No circle is determined: its size is not finite.
    """
    start = _algebraic_circle(points[used], weights[used])
    circle = _refined_circle(start, points[used], weights[used])
    residuals, J = circle_residuals(points, *circle)
    return FittedFigure(residuals, J, circle.center, circle.basis, circle.radius)


def circle_residuals(
    points: Array,
    center: Array,
    basis: Array,
    radius: float,
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


def _refined_circle(start: _PlacedCircle, points: Array, weights: Array) -> _PlacedCircle:
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
        raise CalibError(TOO_SHORT)
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
