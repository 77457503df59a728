"""Planes and circles through points in space, robust against outliers, with their uncertainty.

A point p lies off a circle (centre c, unit normal n, radius r) by two distances, in the circle's plane and across it:

    radial = |p - c - axial n| - r          axial = n . (p - c)

and the fit is the minimum of the weighted sum of their squares. Under equal noise in x, y, z that is the
maximum-likelihood fit, and its centre has no essential bias on short arcs either (A. Al-Sharadqah and N. Chernov,
Electronic Journal of Statistics 3, 2009). A plane is the total least-squares one. Uncertainties are covariances of
small displacements along the columns (u, v, normal) of the figure's basis, sigma^2 (J^T W J)^-1.

An outlier is a point whose own displacement explains more than chance does: with the point's k residuals e and
their block H of the hat matrix, giving the point its own displacement lowers the sum of squares by e^T (I - H)^-1 e,
which over the rest is F(k, dof - k). The largest of N points counts if N times its tail is below 0.001; then the
point is left out, the fit is repeated, and the next point is tested.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.special import chdtrc, fdtrc

from calib.basics.arrays import Array, Mask, read_only
from calib.basics.values import Value
from calib.errors import CalibError

#: Fewest points: as many as determine the figure, and one more from which the noise is estimated.
FEWEST = 4

#: Points that stay within this do not move, rms about their mean [m].
STILL_M = 1e-3

#: No instrument is better than this, and without noise there is no covariance [m].
FLOOR_M = 1e-9

#: Probability of a finding if there is nothing but noise.
LEVEL = 1e-3

#: At most this share of the points are outliers.
_SHARE = 0.1

#: A point is tested as an outlier if the least eigenvalue of its block of I - H is above this.
_TESTABLE = 1e-6

#: If the radius is not known to this share of itself, the centre is not known either.
_VAGUE = 0.25

#: Points are on a line if they spread along the second axis by less than this share of the first one ...
_THIN = 1e-9

#: ... or by less than this many times their spread along the third.
_IN_NOISE = 1.5

#: Message for points that do not determine a circle.
_TOO_SHORT = (
    "the arc is too short for its noise: different circles fit it equally well. Let the joint turn further, or fix the "
    "target further from its axis"
)


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
    #: The one that was given, root of the mean square over the points [m]; None if none was
    given: float | None
    #: Degrees of freedom of the noise in the covariance; infinite if it is the given one, which the residuals allow
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
        """Angle that the points used cover: a full turn less the largest gap between neighbours [rad]."""
        ordered = np.sort(self.angles[self.used])
        gaps = np.diff(ordered, append=ordered[0] + 2.0 * np.pi)
        return float(2.0 * np.pi - gaps.max())

    def turned(self) -> Circle:
        """Return the circle with the opposite normal, and its covariance, residuals and angles in the turned basis."""
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
        raise CalibError(_TOO_SHORT) from error
    if not 0.0 <= plane.covariance[5, 5] <= (_VAGUE * radius) ** 2:
        raise CalibError(_TOO_SHORT)
    common: dict[str, Any] = {f.name: getattr(plane, f.name) for f in fields(plane)}
    u, v, _ = ((points - plane.point) @ plane.basis).T
    return Circle(**common, radius=radius, angles=read_only(np.arctan2(v, u)))


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


def _fit_robustly(
    figure: Callable[[Array, Array, Mask], FittedFigure],
    points: Array,
    sigma: Array | None,
    *,
    robust: bool,
) -> tuple[Plane, float]:
    """Fit a figure to all points except outliers, and return it with its covariance, and its radius [m].

    ``figure`` fits it to points (N, 3) [m] with weights (N,), using those of a mask (N,); sigma is the standard
    deviation of a coordinate of each point, (N,) [m], None if it is to be estimated. Too few points raise `CalibError`.
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
        # Outliers are left out one by one, see the module's text.
        for _ in range(max(1, int(_SHARE * len(weights)))):
            residuals, jacobian, *_ = fit(used)
            root = np.sqrt(weights[used])
            whitened = root[:, None] * residuals[used]
            outlier = _find_outlier(whitened, root[:, None, None] * jacobian[used])
            if outlier is None:
                break
            used[np.flatnonzero(used)[outlier]] = False
    fitted = fit(used)

    # The noise of one coordinate: the given one unless the residuals are larger than it makes them.
    _, k, p = fitted.jacobian.shape
    w = np.repeat(weights[used], k)
    e = fitted.residuals[used].ravel()
    freedom = len(e) - p
    estimated = float(np.sqrt(w @ e**2 / freedom))
    std, dof = estimated, float(freedom)
    given = None if sigma is None else float(np.sqrt(np.mean(sigma**2)))
    if given is not None and chdtrc(freedom, freedom * (estimated / given) ** 2) >= LEVEL:
        std, dof = given, np.inf
    variance = max(std, FLOOR_M) ** 2

    # (J^T W J)^-1, with columns scaled because lengths stand beside angles.
    J = fitted.jacobian[used].reshape(-1, p)
    norm = np.sqrt(w @ J**2)
    scaled = J / norm
    normal_matrix = scaled.T @ (w[:, None] * scaled)
    inverse = np.linalg.inv(normal_matrix) / np.outer(norm, norm)

    used.setflags(write=False)
    plane = Plane(
        point=read_only(fitted.point),
        basis=read_only(fitted.basis),
        covariance=read_only(variance * inverse),
        residuals=read_only(fitted.residuals),
        used=used,
        noise=estimated,
        given=given,
        dof=dof,
    )
    return plane, fitted.radius


def _find_outlier(residuals: Array, jacobian: Array) -> int | None:
    """Return the index of the point whose omission lowers the sum of squares most; None if that may be chance.

    Chance is judged by an F test for the largest of N points. Residuals, (N, k), and their derivatives by the figure's
    p displacements, (N, k, p), are whitened.
    """
    count, k, p = jacobian.shape
    freedom = count * k - p - k
    if freedom < k + 1:
        return None
    # A point that alone determines a direction of the fit has no residual there: it lowers nothing.
    orthonormal, _ = np.linalg.qr(jacobian.reshape(-1, p))
    Q = orthonormal.reshape(count, k, p)
    free = np.eye(k) - Q @ np.swapaxes(Q, 1, 2)
    least = np.linalg.eigvalsh(free)[:, 0]
    testable = least > _TESTABLE
    e = residuals[testable]
    deleted = np.linalg.solve(free[testable], e[..., None])[..., 0]
    drops = np.zeros(count)
    drops[testable] = np.einsum("ni,ni->n", e, deleted)

    worst = int(np.argmax(drops))
    drop = drops[worst]
    if drop <= 0.0:
        return None
    total = float(np.sum(residuals**2))
    remaining = max(total - drop, np.finfo(np.float64).eps * total)
    F = drop / k / (remaining / freedom)
    # The largest of N points counts if N times its tail is small.
    if count * fdtrc(k, freedom, F) >= LEVEL:
        return None
    return worst


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
    fitted, w = points[used], weights[used]
    # The algebraic circle in the plane of the points: x^2 + y^2 = 2 a x + 2 b y + c.
    mean, axes = _principal_axes(fitted, w)
    xy = (fitted - mean) @ axes[:, :2]
    design = np.column_stack([2.0 * xy, np.ones(len(xy))])
    squares = (xy**2).sum(axis=1)
    a, b, c = np.linalg.lstsq(design, squares, rcond=None)[0]
    start_center = mean + axes @ [a, b, 0.0]
    start_basis = _basis_near(axes[:, 2], fitted[0] - start_center)
    start_radius = float(np.sqrt(a * a + b * b + c))
    root = np.sqrt(w / w.mean())[:, None]

    def displaced(x: Array) -> tuple[Array, Array, float]:
        """Return centre, basis and radius displaced by x (6,), tilts by the tangents of their angles."""
        normal = start_basis @ np.array([x[3], x[4], 1.0])
        basis = _basis_near(normal / np.linalg.norm(normal), start_basis[:, 0])
        return start_center + start_basis @ x[:3], basis, start_radius + float(x[5])

    def residuals(x: Array) -> Array:
        """Return the weighted distances of the points from the circle displaced by x, shape (2 N,)."""
        distances, _ = circle_residuals(fitted, *displaced(x))
        return np.ravel(root * distances)

    def jacobian(x: Array) -> Array:
        """Differentiate by displacements of the circle at x, which span what those of x do: the minimum is the same."""
        _, J = circle_residuals(fitted, *displaced(x))
        return np.reshape(root[..., None] * J, (-1, 6))

    tight = dict.fromkeys(("xtol", "ftol", "gtol"), float(np.finfo(np.float64).eps))
    solution = least_squares(residuals, np.zeros(6), jacobian, method="lm", **tight)
    if solution.status <= 0:
        raise CalibError(_TOO_SHORT)
    center, basis, radius = displaced(solution.x)
    distances, J = circle_residuals(points, center, basis, radius)
    return FittedFigure(distances, J, center, basis, radius)


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


def _principal_axes(points: Array, weights: Array) -> tuple[Array, Array]:
    """Return weighted mean (3,) and principal axes of points (N, 3); raises `CalibError` for points on a spot or line.

    The axes are the columns of a right-handed basis (3, 3), the longest first.
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


def _basis_near(normal: Array, near: Array) -> Array:
    """Return a right-handed basis (3, 3), columns u, v, unit normal, with u as near as possible to a direction (3,)."""
    u = near - normal * (normal @ near)
    u = u / np.linalg.norm(u)
    return np.column_stack([u, np.cross(normal, u), normal])
