"""Lens models: the image of a point in the camera's frame, its derivatives, and the ray of a pixel.

With x = X / Z and y = Y / Z of a point (X, Y, Z), the image is u = fx x' + cx, v = fy y' + cy with the distorted

    pinhole   x' = x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2),      r^2 = x^2 + y^2
              y' = y (1 + k1 r^2 + k2 r^4 + k3 r^6) + p1 (r^2 + 2 y^2) + 2 p2 x y
    fisheye   (x', y') = (x, y) s / r,      s = a (1 + k1 a^2 + k2 a^4 + k3 a^6 + k4 a^8),      a = atan(r)
    rational  as pinhole, with the factor (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6)
    tilted    as rational, and x' + s1 r^2 + s2 r^4, y' + s3 r^2 + s4 r^4 (a thin prism) on a sensor that is tilted:
              x'' = c w_x / w_z + sin(ty) cos(tx),  y'' = c w_y / w_z - sin(tx),  c = cos(tx) cos(ty),
              w = R_y(ty) R_x(tx) (x', y', 1)

as OpenCV and ROS define them ("plumb_bob", "equidistant", "rational_polynomial"; of 5, 4, 8 and 14 coefficients), with
OpenCV's R_x(t) = [1 0 0; 0 cos t, sin t; 0, -sin t, cos t] and R_y(t) = [cos t, 0, -sin t; 0 1 0; sin t, 0, cos t];
sources: D. C. Brown, Close-range camera calibration, 1971;
J. Kannala, S. Brandt, A generic camera model, 2006. A new lens is one row of `LENSES`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from calib.basics.arrays import Array
from calib.basics.values import ReadOnlyMapping

#: Distorted coordinates (2, n) of normalised ones (2, n) by the distortion's coefficients (d, n).
_Distort = Callable[[Array, Array], Array]

#: Derivatives of distorted coordinates: by normalised ones, (2, 2, n), and by the coefficients, (2, d, n).
_Slopes = Callable[[Array, Array], tuple[Array, Array]]

#: Focal lengths and centre, the intrinsics of a lens without distortion.
_LINEAR = ("fx", "fy", "cx", "cy")

#: Smaller depths are taken as this [m]: a point beside or behind a camera then has an image, far out.
_NEAREST = 1e-3

#: Relative standard deviation of focal lengths, and that of the centre over the image's width, if they are given
#: without one. A maker's intrinsics of a type of camera are about that accurate; a calibration is better.
_FOCAL = 0.01
_CENTRE = 0.005

#: Standard deviation of radial and of tangential coefficients of distortion, if they are given without one.
_RADIAL = 0.02
_TANGENTIAL = 0.002

#: Standard deviation of the tilt of a sensor that is given without one: half a degree [rad].
_TILT = 0.01

#: Maximum number of Newton iterations when undistorting, and the step below which they stop.
_ITERATIONS = 50
_CONVERGED = 1e-13

#: Lengths and determinants are kept this far from zero, to be divided by.
_TINY = 1e-9


@dataclass(frozen=True, slots=True)
class Lens:
    """A lens model with m intrinsics: fx, fy, cx, cy [px], then coefficients of distortion."""

    #: Name of the model: ``"pinhole"``.
    name: str
    #: Names of the coefficients of distortion.
    distortion: tuple[str, ...]
    #: Distorted coordinates of normalised ones.
    distort: _Distort
    #: Their derivatives.
    slopes: _Slopes

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the m intrinsics."""
        return (*_LINEAR, *self.distortion)

    @property
    def units(self) -> tuple[str, ...]:
        """Symbols of the units of the m intrinsics: ``"px"``, and ``"1"`` of coefficients."""
        return ("px",) * len(_LINEAR) + ("1",) * len(self.distortion)

    def project(self, points: Array, values: Array) -> Array:
        """Return the images of points.

        Args:
            points: shape (n, 3), in the camera's frame [m]. A point that is not in front of it has an image far out.
            values: shape (m,) or (n, m), the intrinsics.

        Returns:
            shape (n, 2) [px].
        """
        fx, fy, cx, cy, *coefficients = np.broadcast_to(values, (len(points), len(self.names))).T
        x, y = self.distort(_normalised(points), np.array(coefficients))
        return np.column_stack([fx * x + cx, fy * y + cy])

    def derivatives(self, points: Array, values: Array) -> tuple[Array, Array]:
        """Return the derivatives of images by the points and by the intrinsics.

        Args:
            points: shape (n, 3), in the camera's frame [m].
            values: shape (m,) or (n, m), the intrinsics.

        Returns:
            shape (n, 2, 3) [px/m], and shape (n, 2, m), [px] per unit of each intrinsic.
        """
        numbers = np.broadcast_to(values, (len(points), len(self.names))).T
        focal = numbers[:2]
        coefficients = numbers[4:]
        normalised = _normalised(points)
        depth = np.maximum(points[:, 2], _NEAREST)
        normalised_by_point = np.zeros((2, 3, len(points)))
        normalised_by_point[0, 0] = normalised_by_point[1, 1] = 1.0 / depth
        is_in_front = points[:, 2] > _NEAREST
        normalised_by_point[:, 2] = np.where(is_in_front, -normalised / depth, 0.0)

        distorted = self.distort(normalised, coefficients)
        by_normalised, by_coefficients = self.slopes(normalised, coefficients)
        by_point = np.einsum("abn,bcn->acn", by_normalised, normalised_by_point)
        by_values = np.zeros((2, len(self.names), len(points)))
        for axis in range(2):
            by_values[axis, axis] = distorted[axis]
            by_values[axis, 2 + axis] = 1.0
        by_values[:, 4:] = focal[:, None] * by_coefficients
        return (focal[:, None] * by_point).transpose(2, 0, 1), by_values.transpose(2, 0, 1)

    def undistort(self, pixels: Array, values: Array) -> Array:
        """Undistort pixels by Newton's method: return the ray (x, y, 1) of each in the camera's frame.

        Args:
            pixels: shape (n, 2) [px].
            values: shape (m,) or (n, m), the intrinsics.

        Returns:
            shape (n, 3), points at a depth of 1. For a pixel that the lens images nothing to, the last iteration's.
        """
        fx, fy, cx, cy, *coefficients = np.broadcast_to(values, (len(pixels), len(self.names))).T
        wanted = np.array([(pixels[:, 0] - cx) / fx, (pixels[:, 1] - cy) / fy])
        normalised = wanted.copy()
        numbers = np.array(coefficients).reshape(len(self.distortion), -1)
        for _ in range(_ITERATIONS):
            missing = wanted - self.distort(normalised, numbers)
            slopes, _ = self.slopes(normalised, numbers)
            # By Cramer's rule.
            (a, b), (c, d) = slopes
            determinant = a * d - b * c
            determinant = np.where(np.abs(determinant) < _TINY, _TINY, determinant)
            along_x = (d * missing[0] - b * missing[1]) / determinant
            along_y = (a * missing[1] - c * missing[0]) / determinant
            step = np.array([along_x, along_y])
            # Steps are limited, because Newton's method jumps where the distortion folds.
            length = np.maximum(np.linalg.norm(step, axis=0), _TINY)
            longest = 0.5 * (1.0 + np.linalg.norm(normalised, axis=0))
            normalised = normalised + step * np.minimum(1.0, longest / length)
            if np.abs(step).max(initial=0.0) < _CONVERGED:
                break
        return np.column_stack([*normalised, np.ones(len(pixels))])

    def default_sigma(self, values: Array, width: int) -> Array:
        """Return standard deviations of intrinsics that were given without any.

        Args:
            values: shape (m,), the intrinsics.
            width: Columns of the image [px].

        Returns:
            shape (m,), in the unit of each: 1 % of the focal lengths, 0.5 % of the width for the centre, 0.02 for
            radial coefficients, 0.002 for tangential ones and those of a prism, 0.01 rad for a tilt.
        """
        sigma = np.full(len(self.names), _RADIAL)
        sigma[:2] = _FOCAL * np.abs(values[:2])
        sigma[2:4] = _CENTRE * width
        tangential = [name.startswith(("p", "s")) for name in self.names]
        sigma[tangential] = _TANGENTIAL
        sigma[[name.startswith("tau") for name in self.names]] = _TILT
        return sigma


def _normalised(points: Array) -> Array:
    """Return X / Z and Y / Z, shape (2, n), of points (n, 3) [m] in the camera; depths are at least 1 mm."""
    depth = np.maximum(points[:, 2], _NEAREST)
    return np.array([points[:, 0] / depth, points[:, 1] / depth])


# Pinhole


def _distort_pinhole(normalised: Array, coefficients: Array) -> Array:
    """Return normalised coordinates X / Z, Y / Z, shape (2, n), distorted by k1, k2, p1, p2, k3, shape (5, n)."""
    x, y = normalised
    k1, k2, p1, p2, k3 = coefficients
    rr = x**2 + y**2
    radial = 1.0 + rr * (k1 + rr * (k2 + rr * k3))
    return np.array(
        [
            x * radial + 2.0 * p1 * x * y + p2 * (rr + 2.0 * x**2),
            y * radial + p1 * (rr + 2.0 * y**2) + 2.0 * p2 * x * y,
        ]
    )


def _pinhole_slopes(normalised: Array, coefficients: Array) -> tuple[Array, Array]:
    """Return the derivatives of the distorted coordinates by the given ones, (2, 2, n), and by k1 to k3, (2, 5, n)."""
    x, y = normalised
    k1, k2, p1, p2, k3 = coefficients
    rr = x**2 + y**2
    radial = 1.0 + rr * (k1 + rr * (k2 + rr * k3))
    slope = 2.0 * (k1 + rr * (2.0 * k2 + rr * 3.0 * k3))  # of the radial factor, over x or y
    mixed = x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y
    by_normalised = np.array(
        [
            [radial + x**2 * slope + 2.0 * p1 * y + 6.0 * p2 * x, mixed],
            [mixed, radial + y**2 * slope + 6.0 * p1 * y + 2.0 * p2 * x],
        ]
    )
    along_x = [x * rr, x * rr**2, 2.0 * x * y, rr + 2.0 * x**2, x * rr**3]
    along_y = [y * rr, y * rr**2, rr + 2.0 * y**2, 2.0 * x * y, y * rr**3]
    return by_normalised, np.array([along_x, along_y])


# Fisheye


def _distort_fisheye(normalised: Array, coefficients: Array) -> Array:
    """Return normalised coordinates X / Z, Y / Z, shape (2, n), distorted by k1 to k4, shape (4, n)."""
    ratio, _, _ = _fisheye_ratio(normalised, coefficients)
    return normalised * ratio


def _fisheye_slopes(normalised: Array, coefficients: Array) -> tuple[Array, Array]:
    """Return the derivatives of the distorted coordinates by the given ones, (2, 2, n), and by k1 to k4, (2, 4, n)."""
    ratio, slope, angle = _fisheye_ratio(normalised, coefficients)
    r = np.maximum(np.hypot(*normalised), _TINY)
    outer = normalised[:, None] * normalised[None] / r**2
    by_normalised = ratio * np.eye(2)[:, :, None] + (slope - ratio) * outer
    powers = np.array([angle**3, angle**5, angle**7, angle**9])
    return by_normalised, normalised[:, None] * (powers / r)[None]


def _fisheye_ratio(normalised: Array, coefficients: Array) -> tuple[Array, Array, Array]:
    """Return s / r, ds / dr and the angle a = atan(r) [rad], each of shape (n,), of coordinates (2, n)."""
    k1, k2, k3, k4 = coefficients
    r = np.hypot(*normalised)
    angle = np.arctan(r)
    aa = angle**2
    s = angle * (1.0 + aa * (k1 + aa * (k2 + aa * (k3 + aa * k4))))
    by_angle = 1.0 + aa * (3.0 * k1 + aa * (5.0 * k2 + aa * (7.0 * k3 + aa * 9.0 * k4)))
    ratio = np.where(r > _TINY, s / np.maximum(r, _TINY), 1.0)
    return ratio, by_angle / (1.0 + r**2), angle


# Rational, with a thin prism and a tilt

#: Number of coefficients of the lens with all of them, of which others have the first.
_ALL = 14


def _distort_tilted(normalised: Array, coefficients: Array) -> Array:
    """Return normalised coordinates X / Z, Y / Z, shape (2, n), distorted by the first d of 14 coefficients (d, n)."""
    numbers = _all(coefficients)
    return _tilt(_in_plane(normalised, numbers), *numbers[12:])[0]


def _in_plane(normalised: Array, numbers: Array) -> Array:
    """Return normalised coordinates (2, n) distorted by all coefficients (14, n) but the tilt, shape (2, n)."""
    p1, p2 = numbers[2:4]
    s1, s2, s3, s4 = numbers[8:12]
    x, y = normalised
    rr = x**2 + y**2
    numerator, denominator = _rational(rr, numbers)
    factor = numerator / denominator
    return np.array(
        [
            x * factor + 2.0 * p1 * x * y + p2 * (rr + 2.0 * x**2) + rr * (s1 + rr * s2),
            y * factor + p1 * (rr + 2.0 * y**2) + 2.0 * p2 * x * y + rr * (s3 + rr * s4),
        ]
    )


def _tilted_slopes(normalised: Array, coefficients: Array) -> tuple[Array, Array]:
    """Return the derivatives of the distorted coordinates by the given ones, (2, 2, n), and by d coefficients."""
    numbers = _all(coefficients)
    p1, p2 = numbers[2:4]
    s1, s2, s3, s4 = numbers[8:12]
    x, y = normalised
    rr = x**2 + y**2
    k1, k2, k3, k4, k5, k6 = numbers[[0, 1, 4, 5, 6, 7]]
    numerator, denominator = _rational(rr, numbers)
    factor = numerator / denominator
    # Of the factor and of the prism, by r^2.
    slope = k1 + rr * (2.0 * k2 + rr * 3.0 * k3) - factor * (k4 + rr * (2.0 * k5 + rr * 3.0 * k6))
    slope = slope / denominator
    prism_x, prism_y = s1 + 2.0 * rr * s2, s3 + 2.0 * rr * s4
    mixed = 2.0 * (x * y * slope + p1 * x + p2 * y)
    by_normalised = np.array(
        [
            [
                factor + 2.0 * x**2 * slope + 2.0 * p1 * y + 6.0 * p2 * x + 2.0 * x * prism_x,
                mixed + 2.0 * y * prism_x,
            ],
            [
                mixed + 2.0 * x * prism_y,
                factor + 2.0 * y**2 * slope + 6.0 * p1 * y + 2.0 * p2 * x + 2.0 * y * prism_y,
            ],
        ]
    )
    powers = np.array([rr, rr**2, rr**3])
    zeros = np.zeros((2, len(rr)))
    above = normalised[:, None] * powers / denominator
    below = -normalised[:, None] * powers * factor / denominator
    tangential = np.array([[2.0 * x * y, rr + 2.0 * x**2], [rr + 2.0 * y**2, 2.0 * x * y]])
    prism = np.array([[rr, rr**2, *zeros], [*zeros, rr, rr**2]])
    by_numbers = np.concatenate([above[:, :2], tangential, above[:, 2:], below, prism], axis=1)

    _, by_plane, by_tilt = _tilt(_in_plane(normalised, numbers), *numbers[12:])
    by_coefficients = np.einsum("abn,bcn->acn", by_plane, by_numbers)
    by_all = np.concatenate([by_coefficients, by_tilt], axis=1)
    return np.einsum("abn,bcn->acn", by_plane, by_normalised), by_all[:, : len(coefficients)]


def _all(coefficients: Array) -> Array:
    """Return all coefficients, shape (14, n), of which the first (d, n) are given; the others are zero."""
    return np.pad(coefficients, ((0, _ALL - len(coefficients)), (0, 0)))


def _rational(rr: Array, numbers: Array) -> tuple[Array, Array]:
    """Return numerator and denominator of the radial factor at squares of radii (n,), by all coefficients (14, n)."""
    k1, k2, _, _, k3, k4, k5, k6 = numbers[:8]
    return 1.0 + rr * (k1 + rr * (k2 + rr * k3)), 1.0 + rr * (k4 + rr * (k5 + rr * k6))


def _tilt(points: Array, tau_x: Array, tau_y: Array) -> tuple[Array, Array, Array]:
    """Return points (2, n) on a sensor tilted by angles (n,) [rad], and their derivatives by the points and the angles.

    The derivatives have the shapes (2, 2, n) and (2, 2, n).
    """
    x, y = points
    cx, sx, cy, sy = np.cos(tau_x), np.sin(tau_x), np.cos(tau_y), np.sin(tau_y)
    zero = np.zeros_like(x)
    w = np.array([cy * x + sy * sx * y - sy * cx, cx * y + sx, sy * x - cy * sx * y + cy * cx])
    c = cy * cx
    ratio = w[:2] / w[2]
    tilted = c * ratio + np.array([sy * cx, -sx])

    # Derivatives of w by x, y, tau_x and tau_y, of c, and of what is added.
    w_by = np.array(
        [
            [cy, sy * sx, sy * cx * y + sy * sx, -sy * x + cy * sx * y - cy * cx],
            [zero, cx, -sx * y + cx, zero],
            [sy, -cy * sx, -cy * cx * y - cy * sx, cy * x + sy * sx * y - sy * cx],
        ]
    )
    c_by = np.array([zero, zero, -cy * sx, -sy * cx])
    added_by = np.array([[zero, zero, -sy * sx, cy * cx], [zero, zero, -cx, zero]])
    ratio_by = (w_by[:2] - ratio[:, None] * w_by[2]) / w[2]
    by = c * ratio_by + ratio[:, None] * c_by + added_by
    return tilted, by[:, :2], by[:, 2:]


_RATIONAL = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_TILTED = (*_RATIONAL, "s1", "s2", "s3", "s4", "tau_x", "tau_y")

_ROWS = (
    Lens("pinhole", ("k1", "k2", "p1", "p2", "k3"), _distort_pinhole, _pinhole_slopes),
    Lens("fisheye", ("k1", "k2", "k3", "k4"), _distort_fisheye, _fisheye_slopes),
    Lens("rational", _RATIONAL, _distort_tilted, _tilted_slopes),
    Lens("tilted", _TILTED, _distort_tilted, _tilted_slopes),
)

#: Lens models by name.
LENSES: Mapping[str, Lens] = ReadOnlyMapping({lens.name: lens for lens in _ROWS})
