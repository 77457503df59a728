"""Saddle points of an image, where four squares of a board meet: to a fraction of a pixel, with their uncertainty.

At a corner q every gradient of the image is either zero or at right angles to the line from q to its pixel, because all
edges run through q (Foerstner and Guelch 1987). So q solves

    sum_i w_i g_i (g_i . (p_i - q)) = 0,      A = sum_i w_i g_i g_i^T

with the central differences g_i at the pixels p_i, which are not interpolated.

The weights are w = (1 - (r / R)^2)^4 of the distance r from q. R is a number of windows in the image, narrow where the
board is seen at a steep angle: with a and b the lengths of the window along the board's x and y, and phi the angle on
the board, 1 / R^2 goes as cos^2(phi) / a^2 + sin^2(phi) / b^2. So, to first order, the weights are even across the
edges that meet in q: what a blur spreads to both sides of an edge cancels, under perspective too. With weights that
fall off on the board it would not.

Noise n of the image moves q, to first order, by

    delta q = M^-1 sum_i w_i (g_i d_i^T + (g_i . d_i) I) (D n)_i = M^-1 sum_k c_k n_k,      d_i = p_i - q
    M = A - sum_i g_i (g_i . d_i) (d w_i / d q)^T

with D n the central differences of the noise, in which neighbours share its pixels k, and with a second term in M
because the window moves with q: it matters if the blur is as wide as the window. With white noise of standard
deviation s the covariance is

    s^2 M^-1 (sum_k c_k c_k^T) M^-T

and the standard deviation given is the root of the mean of its eigenvalues. s is measured beside each corner: the
picture of four squares is the same after half a turn about q, and what is not is noise, dirt, or a blemish.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.basics.arrays import Array, Integers, Mask
from calib.basics.values import Value

#: Distance at which the weights reach 0, in windows; up to there they are much like exp(-r^2 / 2).
_REACH = 2.8

#: Smallest width of a window in any direction [px]: central differences need some pixels.
_NARROWEST = 1.3

#: Largest width of a window along an edge [px]: farther off, a lens bends the edges.
_WIDEST = 4.0

#: Maximum number of iterations.
_MAX_STEPS = 30

#: Convergence tolerance [px].
_STILL = 1e-3

#: Maximum distance of a corner from where it was expected, in windows.
_FURTHEST = 2.5

#: Smallest determinant of A, relative to the largest that its trace allows: below it there is one edge, or none.
_LEAST_DETERMINANT = 1e-3

#: Angles on the board at which the grey levels around a corner are compared [rad]: none close to an edge.
_ANGLES = np.radians(
    np.concatenate([start + np.array([20.0, 45.0, 70.0]) for start in (0, 90, 180, 270)])
)

#: Distance at which they are compared, in windows.
_RADIUS = 1.8

#: Smallest correlation of the grey levels around a saddle with those of a board.
_LEAST_CORRELATION = 0.8

#: Smallest difference of black and white [grey values of 255].
_LEAST_CONTRAST = 8.0

#: Half of the difference by which the weights are differentiated [px].
_MOVE = 0.01

#: Standard deviation of rounding to whole grey values, and the smallest of the noise.
_ROUNDING = 1.0 / np.sqrt(12.0)

#: Uncertainty without any noise: pixels have a width, and edges of a print are not straight [px].
FLOOR = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class Saddles(Value):
    """Refined corners, in the order of those that were sought."""

    #: Their pixels, shape (n, 2); NaN if there is no saddle.
    pixels: Array
    #: Standard deviation along u and along v, shape (n,) [px]; NaN if there is no saddle.
    sigma: Array

    @property
    def exist(self) -> Mask:
        """Mask of the places with a saddle, shape (n,)."""
        return np.isfinite(self.sigma)

    def among(self, count: int, places: Integers | Mask) -> Saddles:
        """Return saddles of ``count`` corners: these at places, indices (n,) or a mask, and none at others."""
        pixels = np.full((count, 2), np.nan)
        sigma = np.full(count, np.nan)
        pixels[places] = self.pixels
        sigma[places] = self.sigma
        return Saddles(pixels, sigma)


@dataclass(frozen=True, slots=True, eq=False)
class Patch(Value):
    """The h x w pixels of a window around a corner q."""

    #: Offsets d from q to the pixels, shape (h, w, 2) [px].
    offsets: Array
    #: Weights w, 0 outside the window, shape (h, w).
    weights: Array
    #: Central differences g along u and v, shape (h, w, 2).
    gradients: Array

    @property
    def normal_matrix(self) -> Array:
        """A = sum_i w_i g_i g_i^T, shape (2, 2)."""
        g = self.gradients
        return np.asarray(np.einsum("ij,ijk,ijl->kl", self.weights, g, g))

    @property
    def pulls(self) -> Array:
        """Pull of each pixel on q, g (g . d), shape (h, w, 2)."""
        along = np.sum(self.gradients * self.offsets, axis=-1, keepdims=True)
        return np.asarray(self.gradients * along)


def find_saddles(image: Array, expected: Array, windows: Array, signs: Array) -> Saddles:
    """Refine corners of chessboards: find the saddle of the grey values next to each expected place.

    Args:
        image: Grey values, shape (height, width).
        expected: The places, shape (n, 2) [px].
        windows: F of each, whose columns are the window along the board's x and y, shape (n, 2, 2) [px].
        signs: 1 if the square towards +x, +y is white, -1 if it is black, shape (n,).

    Returns:
        n saddles, each near the place expected and surrounded by the colours of four squares; NaN if there is none.
    """
    pixels = np.full((len(expected), 2), np.nan)
    sigma = np.full(len(expected), np.nan)
    for k in range(len(expected)):
        if not np.isfinite(windows[k]).all():
            continue
        # A window that is not too wide along either edge, and nowhere too narrow.
        lengths = np.sqrt(np.sum(windows[k] ** 2, axis=0))
        U, singular, Vt = np.linalg.svd(windows[k] * np.minimum(1.0, _WIDEST / lengths))
        window = U @ np.diag(np.maximum(singular, _NARROWEST)) @ Vt

        q = _converge(image, expected[k], window)
        if q is None or not _alternates(image, q, window, float(signs[k])):
            continue
        pixels[k] = q
        sigma[k] = uncertainty(image, q, window)
    return Saddles(pixels, sigma)


def _converge(image: Array, expected: Array, window: Array) -> Array | None:
    """Return the corner (2,) [px] near ``expected`` (2,) where edges in a window (2, 2) [px] meet; None if none do."""
    q = expected
    inverse = np.linalg.inv(window)
    for _ in range(_MAX_STEPS):
        patch = patch_at(image, q, window)
        if patch is None:
            return None
        A = patch.normal_matrix
        if np.linalg.det(A) <= _LEAST_DETERMINANT * np.trace(A) ** 2 / 4.0:
            return None
        step = np.linalg.solve(A, np.einsum("ij,ijk->k", patch.weights, patch.pulls))
        q = q + step
        if np.linalg.norm(inverse @ (q - expected)) > _FURTHEST:
            return None
        if np.hypot(*step) < _STILL:
            return q
    return None


def _alternates(image: Array, q: Array, window: Array, sign: float) -> bool:
    """Return True if greys around q (2,) [px] alternate as four squares do; sign 1: the one to +x, +y is white.

    The columns of ``window`` (2, 2) [px] are the window along the board's x and y. False at the image's edges.
    """
    directions = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1)
    places = q + _RADIUS * directions @ window.T
    inside = (places >= 1.0) & (places <= np.array(image.shape[::-1]) - 3.0)
    if not inside.all():
        return False
    values = interpolate(image, places)[0]
    pattern = sign * np.sign(np.sin(2.0 * _ANGLES))
    contrast = 2.0 * float(np.mean(values * pattern))
    spread = float(np.std(values))
    return contrast >= _LEAST_CONTRAST and contrast >= 2.0 * _LEAST_CORRELATION * spread


def patch_at(image: Array, q: Array, window: Array) -> Patch | None:
    """Return the pixels in a window around a corner, with their weights and gradients.

    Args:
        image: Grey values, shape (height, width).
        q: The corner, shape (2,) [px].
        window: Its columns are the window along the board's x and y, shape (2, 2) [px].

    Returns:
        The pixels; None if the window leaves the image, or q is NaN.
    """
    if not np.isfinite(q).all():
        return None
    half = _REACH * np.sqrt(np.sum(window**2, axis=1))
    low = np.ceil(q - half).astype(int)
    high = np.floor(q + half).astype(int)
    height, width = image.shape
    if (low < 1).any() or high[0] > width - 2 or high[1] > height - 2:
        return None
    around = image[low[1] - 1 : high[1] + 2, low[0] - 1 : high[0] + 2]
    du = 0.5 * (around[1:-1, 2:] - around[1:-1, :-2])
    dv = 0.5 * (around[2:, 1:-1] - around[:-2, 1:-1])
    offsets = np.empty((*du.shape, 2))
    offsets[..., 0] = np.arange(low[0], high[0] + 1) - q[0]
    offsets[..., 1] = (np.arange(low[1], high[1] + 1) - q[1])[:, None]
    return Patch(offsets, window_weights(offsets, window), np.stack([du, dv], axis=-1))


def window_weights(offsets: Array, window: Array) -> Array:
    """Return the weights w of pixels.

    Args:
        offsets: From the corner to the pixels, shape (h, w, 2) [px].
        window: Its columns are the window along the board's x and y, shape (2, 2) [px].

    Returns:
        Weights from 0 to 1, shape (h, w).
    """
    on_board = (offsets @ np.linalg.inv(window).T) ** 2
    share_y = on_board[..., 1] / np.maximum(on_board[..., 0] + on_board[..., 1], 1e-12)
    by_x, by_y = 1.0 / np.sum((_REACH * window) ** 2, axis=0)
    inverse = by_x + (by_y - by_x) * share_y
    square = (offsets[..., 0] ** 2 + offsets[..., 1] ** 2) * inverse
    return np.asarray(np.square(np.square(np.maximum(1.0 - square, 0.0))))


def interpolate(image: Array, places: Array) -> tuple[Array, Array]:
    """Interpolate an image by cubic convolution (Keys 1981).

    Args:
        image: Grey values, shape (height, width).
        places: Pixels, at least 1 from the first and 2 from the last of each axis, shape (n, 2).

    Returns:
        Grey values, shape (n,); and the factor by which the variance of white noise changes, shape (n,).
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
    """Return the weights of the four pixels around a place that is t (0 to 1) after the second one, shape (n, 4)."""
    return 0.5 * np.stack(
        [
            -t + 2.0 * t**2 - t**3,
            2.0 - 5.0 * t**2 + 3.0 * t**3,
            t + 4.0 * t**2 - 3.0 * t**3,
            -(t**2) + t**3,
        ],
        axis=1,
    )


def uncertainty(image: Array, q: Array, window: Array) -> float:
    """Return the standard deviation of a corner, the mean of all directions.

    Args:
        image: Grey values, shape (height, width).
        q: The corner, shape (2,) [px].
        window: The window that it was found with, shape (2, 2) [px].

    Returns:
        The standard deviation [px]; infinite if the window leaves the image.
    """
    patch = patch_at(image, q, window)
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

    # The second term of M: how much more the gradients pull for each pixel that the window moves along u and v.
    pulls = patch.pulls
    columns = []
    for axis in np.eye(2):
        ahead = window_weights(patch.offsets - _MOVE * axis, window)
        back = window_weights(patch.offsets + _MOVE * axis, window)
        columns.append(np.einsum("ij,ijk->k", (ahead - back) / (2.0 * _MOVE), pulls))
    M = patch.normal_matrix - np.stack(columns, axis=-1)

    inverse = np.linalg.inv(M)
    covariance = inverse @ np.einsum("ijk,ijl->kl", c, c) @ inverse.T
    variance = _noise(image, q, patch) ** 2 * float(np.trace(covariance)) / 2.0
    return float(np.sqrt(variance + FLOOR**2))


def _noise(image: Array, q: Array, patch: Patch) -> float:
    """Return the noise s of grey values in a patch about q (2,) [px], from its difference to its half turn."""
    used = patch.weights > 0.0
    offsets = patch.offsets[used]
    turned = q - offsets
    size = np.array(image.shape[::-1])
    kept = ((turned >= 1.0) & (turned <= size - 3.0)).all(axis=1)
    at_pixels = np.rint(q + offsets[kept]).astype(int)
    values, gain = interpolate(image, turned[kept])
    difference = image[at_pixels[:, 1], at_pixels[:, 0]] - values

    # Interpolation averages noise: its variance becomes gain times that of a pixel.
    weights = patch.weights[used][kept]
    root = np.sqrt(weights / (1.0 + gain))
    # Noise also moved q off the middle of the symmetry: what a shift of the picture explains is not noise.
    gradients = root[:, None] * patch.gradients[used][kept]
    difference = root * difference
    shift = np.linalg.lstsq(gradients, difference, rcond=None)[0]
    residual = difference - gradients @ shift
    return float(max(np.sqrt(np.sum(residual**2) / np.sum(weights)), _ROUNDING))
