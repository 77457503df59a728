"""The map from a board to its image without a calibrated camera: a homography, and one number for the lens.

A straight line stays straight under a homography H, but not under a lens. The lens is modelled as one that images equal
angles from its axis at equal distances, as fisheye lenses do (Devernay and Faugeras 2001, "Straight lines have to be
straight"), or as one that does the opposite. It has one parameter, and closed forms both ways:

    p_u = p_d tan(w r_d) / (w r_d),     r_d = |p_d|,  w = sqrt(-3 lambda)       lambda < 0, a barrel
    p_u = p_d tanh(w r_d) / (w r_d),                  w = sqrt(3 lambda)        lambda > 0, a pincushion
    p_u ~ H (x, y, 1)

with p = (pixel - image's middle) / (half of the image's diagonal); near the middle p_u = p_d (1 - lambda r_d^2). Given
lambda, H is linear least squares (direct linear transform), so the fit is a search over one number.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.basics.arrays import Array
from calib.basics.values import Value

#: Range of lambda: from the barrel of a fisheye lens to a strong pincushion.
_LAMBDA_RANGE = (-4.0, 0.4)

#: Smallest w r at which the distortion is computed; below, it is nil.
_TINY = 1e-9

#: Largest tanh that is inverted.
_FARTHEST = 1.0 - 1e-9

#: Largest angle from the lens's axis: at a right angle p_u is infinite [rad].
_WIDEST = 1.5

#: Prior standard deviation of lambda: most lenses bend little.
_SIGMA_LAMBDA = 0.3

#: Standard deviation of a point, against which the prior of lambda is weighed, as a share of half the diagonal.
_SIGMA_POINT = 3e-4


@dataclass(frozen=True, slots=True, eq=False)
class PlanarMap(Value):
    """A map from the plane of a board to pixels."""

    #: Homography from the board [m] to undistorted, normalised image coordinates, shape (3, 3).
    H: Array
    #: Distortion; negative for a barrel.
    distortion: float
    #: Middle of the image [px], shape (2,).
    middle: Array
    #: Half of the image's diagonal [px].
    half_diagonal: float

    def project(self, points: Array) -> Array:
        """Return the pixels of points (n, 2) [m] of the board, shape (n, 2); NaN for a point behind the camera."""
        homogeneous = np.column_stack([points, np.ones(len(points))]) @ self.H.T
        depth = np.where(homogeneous[:, 2] > 0.0, homogeneous[:, 2], np.nan)
        undistorted = homogeneous[:, :2] / depth[:, None]
        distorted = _distort(undistorted, self.distortion)
        return np.asarray(self.middle + self.half_diagonal * distorted)

    def jacobians(self, points: Array, step: float) -> Array:
        """Return the derivatives of the pixels by the position on the board.

        Args:
            points: x and y on the board, shape (n, 2) [m].
            step: Half the distance between the two points of a difference [m]: a small part of a square.

        Returns:
            d pixel / d (x, y), shape (n, 2, 2) [px/m]; NaN for a point behind the camera.
        """
        columns = []
        for offset in step * np.eye(2):
            ahead = self.project(points + offset)
            behind = self.project(points - offset)
            columns.append((ahead - behind) / (2.0 * step))
        return np.stack(columns, axis=-1)

    def unproject(self, pixels: Array) -> Array:
        """Return the points (n, 2) [m], x and y on the board, that are seen at pixels (n, 2)."""
        undistorted = _undistort((pixels - self.middle) / self.half_diagonal, self.distortion)
        homogeneous = np.column_stack([undistorted, np.ones(len(pixels))])
        on_board = np.linalg.solve(self.H, homogeneous.T).T
        return np.asarray(on_board[:, :2] / on_board[:, 2:])


def fit_planar_map(
    points: Array, pixels: Array, image_size: tuple[int, int], weights: Array | None = None
) -> PlanarMap:
    """Fit a map to points of a board and their pixels by least squares.

    Args:
        points: x and y on the board, four or more, not all on one line, shape (n, 2) [m].
        pixels: Their pixels, shape (n, 2).
        image_size: Width and height of the image [px].
        weights: Weight of each point, shape (n,); None: equal ones.

    Returns:
        The map.
    """
    from scipy.optimize import minimize_scalar  # imported late, as only pictures need it

    middle = (np.array(image_size, dtype=float) - 1.0) / 2.0
    half_diagonal = 0.5 * float(np.hypot(*image_size))
    distorted = (pixels - middle) / half_diagonal
    root = np.ones(len(points)) if weights is None else np.sqrt(weights)

    def cost(distortion: float) -> float:
        """Return the weighted squares of the points' errors in the image, with the best H, and that of the prior."""
        H = _homography(points, _undistort(distorted, distortion), root)
        residual = root[:, None] * (distorted - _distort(_apply(H, points), distortion))
        prior = (distortion * _SIGMA_POINT / _SIGMA_LAMBDA) ** 2
        return float(np.sum(residual**2)) + prior

    lowest, highest = _LAMBDA_RANGE
    farthest = float(np.max(np.sum(distorted**2, axis=1)))
    bounds = (max(lowest, -(_WIDEST**2) / (3.0 * farthest)), highest)
    best = minimize_scalar(cost, bounds=bounds, method="bounded", options={"xatol": 2e-4})
    distortion = float(best.x)
    H = _homography(points, _undistort(distorted, distortion), root)
    return PlanarMap(H, distortion, middle, half_diagonal)


def _apply(H: Array, points: Array) -> Array:
    """Return points (n, 2) mapped by a homography H (3, 3), shape (n, 2)."""
    homogeneous = np.column_stack([points, np.ones(len(points))]) @ H.T
    return np.asarray(homogeneous[:, :2] / homogeneous[:, 2:])


def _undistort(distorted: Array, distortion: float) -> Array:
    """Return normalised image points (n, 2) without the distortion lambda that ``distorted`` (n, 2) have."""
    angle = np.sqrt(3.0 * abs(distortion)) * np.linalg.norm(distorted, axis=1, keepdims=True)
    small = angle < _TINY
    safe = np.where(small, 1.0, angle)
    mapped = np.tan(np.minimum(safe, _WIDEST)) if distortion < 0.0 else np.tanh(safe)
    return np.asarray(distorted * np.where(small, 1.0, mapped / safe))


def _distort(undistorted: Array, distortion: float) -> Array:
    """Return normalised image points ``undistorted`` (n, 2) with a distortion lambda, shape (n, 2)."""
    length = np.sqrt(3.0 * abs(distortion)) * np.linalg.norm(undistorted, axis=1, keepdims=True)
    small = length < _TINY
    safe = np.where(small, 1.0, length)
    mapped = np.arctan(safe) if distortion < 0.0 else np.arctanh(np.minimum(safe, _FARTHEST))
    return np.asarray(undistorted * np.where(small, 1.0, mapped / safe))


def _homography(points: Array, image: Array, root_weights: Array) -> Array:
    """Return the homography H (3, 3) of least weighted algebraic error from points (n, 2) to images (n, 2).

    ``root_weights`` are the square roots of the points' weights, shape (n,). The sign of H gives the points' middle a
    positive depth. Both sides are first moved and scaled to mean 0 and size 1 (Hartley 1997, "In defense of the
    eight-point algorithm").
    """
    from_points = _normalisation(points)
    from_image = _normalisation(image)
    x, y = _apply(from_points, points).T
    u, v = _apply(from_image, image).T
    ones = np.ones_like(x)
    zeros = np.zeros_like(x)
    by_u = np.stack([x, y, ones, zeros, zeros, zeros, -u * x, -u * y, -u], axis=1)
    by_v = np.stack([zeros, zeros, zeros, x, y, ones, -v * x, -v * y, -v], axis=1)
    system = np.tile(root_weights, 2)[:, None] * np.concatenate([by_u, by_v])
    # The eigenvector of the smallest eigenvalue of the 9 x 9 normal matrix: the data are scaled to size 1.
    _, vectors = np.linalg.eigh(system.T @ system)
    normalised = vectors[:, 0].reshape(3, 3)
    H = np.linalg.solve(from_image, normalised @ from_points)
    depth = H[2] @ np.append(points.mean(axis=0), 1.0)
    return np.asarray(H / (np.sign(depth) * np.linalg.norm(H)))


def _normalisation(points: Array) -> Array:
    """Return the similarity, shape (3, 3), that moves points (n, 2) to mean 0 and scales them to size 1."""
    mean = points.mean(axis=0)
    scale = 1.0 / max(float(np.sqrt(np.mean((points - mean) ** 2))), 1e-12)
    return np.array(
        [[scale, 0.0, -scale * mean[0]], [0.0, scale, -scale * mean[1]], [0.0, 0.0, 1.0]]
    )
