"""Saddle points of an image, where four squares of a board meet: refined to a fraction of a pixel, with uncertainty.

At a corner q every gradient of the image is either zero or at right angles to the line from q to its pixel, because
all edges run through q (Foerstner and Guelch 1987). So q is sought with

    sum_i w_i g_i (g_i . (p_i - q)) = 0,      A q = sum_i w_i g_i g_i^T p_i,      A = sum_i w_i g_i g_i^T

with the central differences g_i at the pixels p_i, which are not interpolated, and weights w_i = (1 - (r / R)^2)^4 of
the distance r = |p_i - q|. R is a number of windows in the image, so that a board seen at a steep angle has a narrow one:
with a and b the lengths of the window along the board's x and y, and phi the angle on the board, 1 / R^2 goes as
cos^2(phi) / a^2 + sin^2(phi) / b^2. Across an edge the weights are even then, to first order: what a blur spreads to
both sides of the edge cancels, under perspective too. It would not with weights that fall off on the board.

Noise n of the image moves q, to first order, by

    delta q = M^-1 sum_i w_i (g_i d_i^T + (g_i . d_i) I) (D n)_i = M^-1 sum_k c_k n_k,      d_i = p_i - q
    M = A - sum_i g_i (g_i . d_i) (d w_i / d q)^T

with D n the central differences of the noise, which its pixels k share, and with a second term in M because the window moves with q: the wider the blur, the more
it counts. With white noise of standard deviation s the covariance is s^2 M^-1 (sum_k c_k c_k^T) M^-T, and
`Saddles.sigma` the root of its mean eigenvalue. s is measured beside each corner: the picture of four
squares is the same after half a turn about q, and what is not is noise, blemishes of the print, or dirt.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.units import Array, Mask
from calib.values.pickling import Value

#: The distance at which the weights are 0, in windows: they are much like exp(-r^2 / 2).
_REACH = 2.8

#: A window is nowhere narrower than this [px]: central differences need some pixels.
_NARROWEST = 1.3

#: Steps until a corner stands still.
_MAX_STEPS = 30

#: A corner that moves less than this stands still [px].
_STILL = 1e-3

#: A corner moves no further from where it was expected than this, in units of the window.
_FURTHEST = 2.5

#: Half of the difference by which the weights are differentiated [px].
_MOVE = 0.01

#: Where the determinant of A is less than this part of the largest it could be, there are no two edges.
_LEAST_DETERMINANT = 1e-3

#: A window is nowhere wider than this along an edge [px]: edges are straight no further where a lens bends them.
_WIDEST = 4.0

#: Angles on the board at which the colours around a corner are compared [rad]: none close to an edge.
_ANGLES = np.radians(np.concatenate([start + np.array([20.0, 45.0, 70.0]) for start in (0, 90, 180, 270)]))

#: Distance at which they are compared, in units of the window.
_RADIUS = 1.8

#: Smallest correlation of the colours around a saddle with those of a board.
_LEAST_CORRELATION = 0.8

#: Smallest difference of black and white [grey values of 255].
_LEAST_CONTRAST = 8.0

#: Rounding to whole grey values: the standard deviation of the noise is not below it.
_ROUNDING = 1.0 / np.sqrt(12.0)

#: What remains without noise: pixels have a width, and edges of a print are not straight [px].
FLOOR = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class Saddles(Value):
    """Refined corners, in the order of those that were sought."""

    #: Their pixels, shape (n, 2); NaN where there is no saddle.
    pixels: Array
    #: Standard deviation along u and along v, shape (n,) [px]; NaN where there is no saddle.
    sigma: Array

    @property
    def exist(self) -> Mask:
        """Where there is a saddle, shape (n,)."""
        return np.isfinite(self.sigma)


def find_saddles(image: Array, expected: Array, windows: Array, signs: Array) -> Saddles:
    """Find the saddle next to each of several places.

    Args:
        image: Grey values, shape (height, width).
        expected: The places, shape (n, 2) [px].
        windows: F of each, whose columns are the window along the board's x and y, shape (n, 2, 2) [px].
        signs: 1 where the square towards +x and +y is white, -1 where it is black, shape (n,).

    Returns:
        The saddles: those that stand still near the place expected, with the colours of four squares around.
    """
    pixels = np.full((len(expected), 2), np.nan)
    sigma = np.full(len(expected), np.nan)
    for k in range(len(expected)):
        window = _bounded(windows[k])
        found = _stationary(image, expected[k], window)
        if found is None or not _has_colours(image, found, window, float(signs[k])):
            continue
        pixels[k] = found
        sigma[k] = _uncertainty(image, found, window)
    return Saddles(pixels, sigma)


@dataclass(frozen=True, slots=True, eq=False)
class _Patch:
    """The pixels of a window around a place, one row of arrays a pixel: shape (m, ...)."""

    #: Offsets from the place, shape (h, w, 2) [px].
    offsets: Array
    #: Weights, 0 outside the window, shape (h, w).
    weights: Array
    #: Central differences along u and v, shape (h, w, 2).
    gradients: Array


def _bounded(window: Array) -> Array:
    """Return a window that is not too wide along either edge, and nowhere too narrow, shape (2, 2)."""
    lengths = np.sqrt(np.sum(window**2, axis=0))
    left, singular, right = np.linalg.svd(window * np.minimum(1.0, _WIDEST / lengths))
    return np.asarray(left @ np.diag(np.maximum(singular, _NARROWEST)) @ right)


def _stationary(image: Array, expected: Array, window: Array) -> Array | None:
    """Return the corner that the gradients point at, shape (2,); None if there is none near the place expected."""
    q = expected
    inverse = np.linalg.inv(window)
    for _ in range(_MAX_STEPS):
        patch = _patch(image, q, window)
        if patch is None:
            return None
        A = _normal_matrix(patch)
        if np.linalg.det(A) <= _LEAST_DETERMINANT * np.trace(A) ** 2 / 4.0:  # one edge, or nothing
            return None
        pull = _pull(patch.offsets, patch.gradients)
        step = np.linalg.solve(A, np.einsum("ij,ijk->k", patch.weights, pull))
        q = q + step
        if np.linalg.norm(inverse @ (q - expected)) > _FURTHEST:
            return None
        if np.hypot(*step) < _STILL:
            return q
    return None


def _normal_matrix(patch: _Patch) -> Array:
    """Return A, shape (2, 2)."""
    g = patch.gradients
    return np.asarray(np.einsum("ij,ijk,ijl->kl", patch.weights, g, g))


def _pull(offsets: Array, gradients: Array) -> Array:
    """Return g (g . (p - q)) of each pixel, shape (h, w, 2)."""
    along = np.sum(gradients * offsets, axis=-1, keepdims=True)
    return np.asarray(gradients * along)


def _patch(image: Array, q: Array, window: Array) -> _Patch | None:
    """Return the pixels of the window at q; None where it leaves the image."""
    half = _REACH * np.sqrt(np.sum(window**2, axis=1))
    low = np.ceil(q - half).astype(int)
    high = np.floor(q + half).astype(int)
    height, width = image.shape
    if not np.isfinite(q).all() or (low < 1).any() or high[0] > width - 2 or high[1] > height - 2:
        return None
    around = image[low[1] - 1 : high[1] + 2, low[0] - 1 : high[0] + 2]
    du = 0.5 * (around[1:-1, 2:] - around[1:-1, :-2])
    dv = 0.5 * (around[2:, 1:-1] - around[:-2, 1:-1])
    u, v = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
    offsets = np.stack([u - q[0], v - q[1]], axis=-1)
    weights = _weights(offsets, window)
    return _Patch(offsets, weights, np.stack([du, dv], axis=-1))


def _weights(offsets: Array, window: Array) -> Array:
    """Return the weights w of pixels at offsets from a corner, shape (h, w)."""
    on_board = offsets @ np.linalg.inv(window).T
    along_x, along_y = np.moveaxis(on_board**2, -1, 0)
    share_y = along_y / np.maximum(along_x + along_y, 1e-12)
    radius_x, radius_y = np.sum(window**2, axis=0)
    inverse = (1.0 - share_y) / radius_x + share_y / radius_y
    square = np.sum(offsets**2, axis=-1) * inverse / _REACH**2
    return np.asarray(np.maximum(1.0 - square, 0.0) ** 4)


def _has_colours(image: Array, q: Array, window: Array, sign: float) -> bool:
    """Test whether the colours around a corner alternate as those of four squares do, with the right one first."""
    directions = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1)
    places = q + _RADIUS * directions @ window.T
    inside = (places >= 1.0) & (places <= np.array(image.shape[::-1]) - 3.0)
    if not inside.all():
        return False
    values = _interpolated(image, places)[0]
    pattern = sign * np.sign(np.sin(2.0 * _ANGLES))
    contrast = 2.0 * float(np.mean(values * pattern))
    spread = float(np.std(values))
    return contrast >= _LEAST_CONTRAST and contrast >= 2.0 * _LEAST_CORRELATION * spread


def _uncertainty(image: Array, q: Array, window: Array) -> float:
    """Return the standard deviation of a corner, the mean of all directions [px]; infinite at the image's edge."""
    patch = _patch(image, q, window)
    if patch is None:
        return np.inf
    g = patch.gradients
    # moments[i, j, k, l] multiplies the l-th difference of the noise at pixel (i, j).
    moments = g[..., :, None] * patch.offsets[..., None, :]
    moments = moments + np.sum(g * patch.offsets, axis=-1)[..., None, None] * np.eye(2)
    moments = patch.weights[..., None, None] * moments
    padded = np.pad(moments, ((2, 2), (2, 2), (0, 0), (0, 0)))
    by_u = 0.5 * (padded[1:-1, :-2, :, 0] - padded[1:-1, 2:, :, 0])
    by_v = 0.5 * (padded[:-2, 1:-1, :, 1] - padded[2:, 1:-1, :, 1])
    c = by_u + by_v
    M = _normal_matrix(patch) - _pull_of_moved_window(patch, window)
    inverse = np.linalg.inv(M)
    covariance = inverse @ np.einsum("ijk,ijl->kl", c, c) @ inverse.T
    noise = _noise(image, q, patch)
    variance = noise**2 * float(np.trace(covariance)) / 2.0
    return float(np.sqrt(variance + FLOOR**2))


def _pull_of_moved_window(patch: _Patch, window: Array) -> Array:
    """Return B, shape (2, 2): what the gradients pull at q more for each pixel that the window moves along u, v."""
    pull = _pull(patch.offsets, patch.gradients)
    columns = []
    for axis in np.eye(2):
        ahead = _weights(patch.offsets - _MOVE * axis, window)
        behind = _weights(patch.offsets + _MOVE * axis, window)
        columns.append(np.einsum("ij,ijk->k", (ahead - behind) / (2.0 * _MOVE), pull))
    return np.stack(columns, axis=-1)


def _noise(image: Array, q: Array, patch: _Patch) -> float:
    """Return the standard deviation of the grey values: the difference to the picture after half a turn about q.

    A corner that noise has moved is not quite the middle of the symmetry: what moving it explains is no noise.
    """
    offsets = patch.offsets[patch.weights > 0.0]
    height, width = image.shape
    turned = q - offsets
    kept = ((turned >= 1.0) & (turned <= np.array([width, height]) - 3.0)).all(axis=1)
    at_pixels = np.rint(q + offsets[kept]).astype(int)
    values, gain = _interpolated(image, turned[kept])
    difference = image[at_pixels[:, 1], at_pixels[:, 0]] - values
    # Interpolation averages noise: its variance becomes gain times that of a pixel.
    root = np.sqrt(patch.weights[patch.weights > 0.0][kept] / (1.0 + gain))
    moved = root[:, None] * patch.gradients[patch.weights > 0.0][kept]
    residual = root * difference
    coefficients = np.linalg.lstsq(moved, residual, rcond=None)[0]
    residual = residual - moved @ coefficients
    variance = np.sum(residual**2) / np.sum(patch.weights[patch.weights > 0.0][kept])
    return float(max(np.sqrt(variance), _ROUNDING))


def _interpolated(image: Array, places: Array) -> tuple[Array, Array]:
    """Interpolate an image by cubic convolution (Keys 1981).

    Args:
        image: Grey values, shape (height, width).
        places: Pixels, at least 1 from the first and 2 from the last of each axis, shape (n, 2).

    Returns:
        Grey values, shape (n,); and what the variance of white noise is multiplied by, shape (n,).
    """
    whole = np.floor(places).astype(int)
    by_u = _keys_weights(places[:, 0] - whole[:, 0])
    by_v = _keys_weights(places[:, 1] - whole[:, 1])
    steps = np.arange(-1, 3)
    columns = whole[:, 0, None, None] + steps[None, None, :]
    rows = whole[:, 1, None, None] + steps[None, :, None]
    values = np.einsum("nij,ni,nj->n", image[rows, columns], by_v, by_u)
    gain = np.sum(by_u**2, axis=1) * np.sum(by_v**2, axis=1)
    return values, gain


def _keys_weights(t: Array) -> Array:
    """Return the weights of the four pixels around a place that is t behind the second, shape (n, 4)."""
    return 0.5 * np.stack(
        [
            -t + 2.0 * t**2 - t**3,
            2.0 - 5.0 * t**2 + 3.0 * t**3,
            t + 4.0 * t**2 - 3.0 * t**3,
            -(t**2) + t**3,
        ],
        axis=1,
    )
