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
class Patches(Value):
    """The pixels in windows around n corners q, h x w each: as many as the largest window has."""

    #: Offsets d from q to the pixels along u, shape (n, 1, w), and along v, shape (n, h, 1) [px].
    d_u: Array
    d_v: Array
    #: Weights w, 0 outside the window, shape (n, h, w).
    weights: Array
    #: Central differences g along u and along v, 0 outside the window, shape (n, h, w) each.
    g_u: Array
    g_v: Array
    #: True for the windows that are inside the image, shape (n,); the weights of others are 0.
    are_inside: Mask

    @property
    def along(self) -> Array:
        """The products g . d of each pixel, shape (n, h, w)."""
        return np.asarray(self.g_u * self.d_u + self.g_v * self.d_v)

    def normal_matrices(self) -> Array:
        """Return A = sum_i w_i g_i g_i^T, shape (n, 2, 2)."""
        by_u, by_v = self.weights * self.g_u, self.weights * self.g_v
        across = _sums(by_u, self.g_v)
        entries = [_sums(by_u, self.g_u), across, across, _sums(by_v, self.g_v)]
        return np.stack(entries, axis=-1).reshape(-1, 2, 2)

    def pulls(self, weights: Array) -> Array:
        """Return how weighted pixels pull on q, sum_i w_i g_i (g_i . d_i) with weights (n, h, w), shape (n, 2)."""
        weighted = weights * self.along
        return np.stack([_sums(weighted, self.g_u), _sums(weighted, self.g_v)], axis=-1)


def _sums(first: Array, second: Array) -> Array:
    """Return the sums over the pixels of the product of two arrays (n, h, w), shape (n,)."""
    return np.asarray(np.einsum("nij,nij->n", first, second))


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
    places, colours = saddle_colours(image, expected, windows)
    agree = colours == signs
    sigma = uncertainties(image, places[agree], _limited(windows[agree]))
    return Saddles(places[agree], sigma).among(len(expected), agree)


def saddle_colours(image: Array, expected: Array, windows: Array) -> tuple[Array, Array]:
    """Find the saddle of the grey values next to each expected place, whatever its colours.

    Args:
        image: Grey values, shape (height, width).
        expected: The places, shape (n, 2) [px].
        windows: The windows around them, shape (n, 2, 2) [px], as of `find_saddles`; NaN for a place that is not known.

    Returns:
        Its pixel, shape (n, 2), and 1 if the square towards +x, +y is white, -1 if it is black, 0 if the place is not
        surrounded by four squares, shape (n,).
    """
    places = np.full((len(expected), 2), np.nan)
    colours = np.zeros(len(expected))
    known = np.isfinite(windows).all(axis=(1, 2)) & np.isfinite(expected).all(axis=1)
    limited = _limited(windows[known])
    places[known] = _meeting_points(image, expected[known], limited)
    colours[known] = _colours(image, places[known], limited)
    return places, colours


def _limited(windows: Array) -> Array:
    """Return windows (n, 2, 2) [px] that are not too wide along either edge, and nowhere too narrow."""
    lengths = np.sqrt(np.sum(windows**2, axis=1, keepdims=True))
    U, singular, Vt = np.linalg.svd(windows * np.minimum(1.0, _WIDEST / lengths))
    return np.asarray((U * np.maximum(singular, _NARROWEST)[:, None, :]) @ Vt)


def _meeting_points(image: Array, expected: Array, windows: Array) -> Array:
    """Return where edges in windows (n, 2, 2) [px] near ``expected`` (n, 2) meet, (n, 2) [px]; NaN where none do."""
    q = expected.copy()
    found = np.full(q.shape, np.nan)
    inverse = np.linalg.inv(windows)
    moving = np.arange(len(q))
    for _ in range(_MAX_STEPS):
        patches = patches_at(image, q[moving], windows[moving])
        A = patches.normal_matrices()
        traces = np.trace(A, axis1=1, axis2=2)
        meet = np.linalg.det(A) > _LEAST_DETERMINANT * traces**2 / 4.0
        moving = moving[meet]
        if not len(moving):
            break
        pulls = patches.pulls(patches.weights)[meet]
        steps = np.linalg.solve(A[meet], pulls[..., None])[..., 0]
        q[moving] += steps
        away = np.einsum("nij,nj->ni", inverse[moving], q[moving] - expected[moving])
        is_near = np.linalg.norm(away, axis=1) <= _FURTHEST
        is_still = np.linalg.norm(steps, axis=1) < _STILL
        ended = moving[is_near & is_still]
        found[ended] = q[ended]
        moving = moving[is_near & ~is_still]
    return found


def _colours(image: Array, q: Array, windows: Array) -> Array:
    """Return 1 or -1, shape (n,), where greys around q (n, 2) [px] alternate as four squares do, otherwise 0.

    It is 1 if the square towards +x, +y is white; the columns of ``windows`` (n, 2, 2) [px] are the window along the
    board's x and y. It is 0 at the image's edges, and where q is NaN.
    """
    result = np.zeros(len(q))
    directions = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)])
    places = q[:, None, :] + _RADIUS * np.swapaxes(windows @ directions, 1, 2)
    highest = np.array(image.shape[::-1]) - 3.0
    inside = ((places >= 1.0) & (places <= highest)).all(axis=(1, 2))
    if not inside.any():
        return result
    values = interpolate(image, places[inside])[0]
    contrast = 2.0 * np.mean(values * np.sign(np.sin(2.0 * _ANGLES)), axis=1)
    least = np.maximum(_LEAST_CONTRAST, 2.0 * _LEAST_CORRELATION * np.std(values, axis=1))
    result[inside] = np.where(np.abs(contrast) >= least, np.sign(contrast), 0.0)
    return result


def patches_at(image: Array, q: Array, windows: Array) -> Patches:
    """Return the pixels in windows around corners, with their weights and gradients.

    Args:
        image: Grey values, shape (height, width).
        q: The corners, shape (n, 2) [px].
        windows: Their columns are the window along the board's x and y, shape (n, 2, 2) [px].
    """
    half = _REACH * np.sqrt(np.sum(windows**2, axis=2))
    known = np.where(np.isfinite(q), q, -np.inf)
    low = np.ceil(known - half)
    high = np.floor(known + half)
    limit = np.array(image.shape[::-1]) - 2
    are_inside = ((low >= 1) & (high <= limit)).all(axis=1)
    middle = np.where(are_inside[:, None], q, 0.0)
    low = np.where(are_inside[:, None], low, 1).astype(int)
    high = np.where(are_inside[:, None], high, 0).astype(int)

    # All windows get as many pixels as the largest; those beyond a window's own have no weight.
    width, height = (high - low).max(axis=0, initial=0) + 1
    columns = low[:, :1] + np.arange(width)
    rows = low[:, 1:] + np.arange(height)
    d_u = (columns - middle[:, :1])[:, None, :]
    d_v = (rows - middle[:, 1:])[:, :, None]
    is_own = (rows <= high[:, 1:])[:, :, None] & (columns <= high[:, :1])[:, None, :]
    around_u = np.minimum(low[:, :1] - 1 + np.arange(width + 2), image.shape[1] - 1)
    around_v = np.minimum(low[:, 1:] - 1 + np.arange(height + 2), image.shape[0] - 1)
    around = image[around_v[:, :, None], around_u[:, None, :]]
    g_u = 0.5 * (around[:, 1:-1, 2:] - around[:, 1:-1, :-2])
    g_v = 0.5 * (around[:, 2:, 1:-1] - around[:, :-2, 1:-1])
    weights = window_weights(d_u, d_v, windows)
    return Patches(d_u, d_v, is_own * weights, is_own * g_u, is_own * g_v, are_inside)


def window_weights(d_u: Array, d_v: Array, windows: Array) -> Array:
    """Return the weights w of pixels.

    Args:
        d_u: From the corners to the pixels along u, shape (n, 1, w) [px].
        d_v: Along v, shape (n, h, 1) [px].
        windows: Their columns are the window along the board's x and y, shape (n, 2, 2) [px].

    Returns:
        Weights from 0 to 1, shape (n, h, w).
    """
    inverse = np.linalg.inv(windows)[:, :, :, None, None]
    by_x, by_y = 1.0 / np.sum((_REACH * windows) ** 2, axis=1).T[:, :, None, None]
    x2 = (inverse[:, 0, 0] * d_u + inverse[:, 0, 1] * d_v) ** 2
    y2 = (inverse[:, 1, 0] * d_u + inverse[:, 1, 1] * d_v) ** 2
    share_y = y2 / np.maximum(x2 + y2, 1e-12)
    square = (d_u**2 + d_v**2) * (by_x + (by_y - by_x) * share_y)
    return np.asarray(np.square(np.square(np.maximum(1.0 - square, 0.0))))


def interpolate(image: Array, places: Array) -> tuple[Array, Array]:
    """Interpolate an image by cubic convolution (Keys 1981).

    Args:
        image: Grey values, shape (height, width).
        places: Pixels, at least 1 from the first and 2 from the last of each axis, shape (..., 2).

    Returns:
        Grey values, shape (...); and the factor by which the variance of white noise changes, shape (...).
    """
    whole = np.floor(places).astype(int)
    by_u = _keys_weights(places[..., 0] - whole[..., 0])
    by_v = _keys_weights(places[..., 1] - whole[..., 1])
    steps = np.arange(-1, 3)
    columns = whole[..., 0, None, None] + steps[None, :]
    rows = whole[..., 1, None, None] + steps[:, None]
    values = np.einsum("...ij,...i,...j->...", image[rows, columns], by_v, by_u)
    gain = np.sum(by_u**2, axis=-1) * np.sum(by_v**2, axis=-1)
    return values, gain


def _keys_weights(t: Array) -> Array:
    """Return the weights of the four pixels around places t (...) (0 to 1) after the second one, shape (..., 4)."""
    return 0.5 * np.stack(
        [
            -t + 2.0 * t**2 - t**3,
            2.0 - 5.0 * t**2 + 3.0 * t**3,
            t + 4.0 * t**2 - 3.0 * t**3,
            -(t**2) + t**3,
        ],
        axis=-1,
    )


def uncertainties(image: Array, q: Array, windows: Array) -> Array:
    """Return the standard deviations of corners, the mean of all directions.

    Args:
        image: Grey values, shape (height, width).
        q: The corners, shape (n, 2) [px].
        windows: The windows that they were found with, shape (n, 2, 2) [px].

    Returns:
        The standard deviations, shape (n,) [px]; infinite if the window leaves the image.
    """
    patches = patches_at(image, q, windows)
    n, h, w = patches.weights.shape

    # c of each pixel: those around the window count too.
    along = patches.along
    c = np.zeros((n, 2, h + 2, w + 2))
    for k, g in enumerate((patches.g_u, patches.g_v)):
        # Half of what multiplies the differences of the noise along u and along v.
        by_u = 0.5 * patches.weights * (g * patches.d_u + (k == 0) * along)
        by_v = 0.5 * patches.weights * (g * patches.d_v + (k == 1) * along)
        c[:, k, 1:-1, 2:] += by_u
        c[:, k, 1:-1, :-2] -= by_u
        c[:, k, 2:, 1:-1] += by_v
        c[:, k, :-2, 1:-1] -= by_v

    # The second term of M: how much more the gradients pull for each pixel that the window moves along u and v.
    columns = []
    for move_u, move_v in _MOVE * np.eye(2):
        ahead = window_weights(patches.d_u - move_u, patches.d_v - move_v, windows)
        back = window_weights(patches.d_u + move_u, patches.d_v + move_v, windows)
        columns.append(patches.pulls((ahead - back) / (2.0 * _MOVE)))
    M = patches.normal_matrices() - np.stack(columns, axis=-1)

    M[~patches.are_inside] = np.eye(2)
    inverse = np.linalg.inv(M)
    covariance = inverse @ np.einsum("nkij,nlij->nkl", c, c) @ np.swapaxes(inverse, 1, 2)
    variance = _noise(image, q, patches) ** 2 * np.trace(covariance, axis1=1, axis2=2) / 2.0
    return np.where(patches.are_inside, np.sqrt(variance + FLOOR**2), np.inf)


def _noise(image: Array, q: Array, patches: Patches) -> Array:
    """Return the noise s of grey values in patches about q (n, 2) [px], from their difference to their half turn."""
    offsets = np.stack(np.broadcast_arrays(patches.d_u, patches.d_v), axis=-1)
    middle = np.where(patches.are_inside[:, None], q, 0.0)[:, None, None, :]
    highest = np.array(image.shape[::-1]) - 3.0
    turned = middle - offsets
    kept = ((turned >= 1.0) & (turned <= highest)).all(axis=-1)
    at_pixels = np.rint(middle + offsets).astype(int)
    grey = image[
        np.clip(at_pixels[..., 1], 0, image.shape[0] - 1),
        np.clip(at_pixels[..., 0], 0, image.shape[1] - 1),
    ]
    values, gain = interpolate(image, np.clip(turned, 1.0, highest))

    # Interpolation averages noise: its variance becomes gain times that of a pixel.
    weights = np.where(kept, patches.weights, 0.0)
    scaled = weights / (1.0 + gain)
    difference = grey - values
    # Noise also moved q off the middle of the symmetry: what a shift of the picture explains is not noise.
    by_u, by_v = scaled * patches.g_u, scaled * patches.g_v
    across = _sums(by_u, patches.g_v)
    A = np.stack([_sums(by_u, patches.g_u), across, across, _sums(by_v, patches.g_v)], axis=-1)
    b = np.stack([_sums(by_u, difference), _sums(by_v, difference)], axis=-1)
    shift = (np.linalg.pinv(A.reshape(-1, 2, 2), hermitian=True) @ b[..., None])[:, :, 0, None]
    residual = difference - shift[:, 0, :, None] * patches.g_u - shift[:, 1, :, None] * patches.g_v
    mean = _sums(scaled, residual**2) / np.maximum(np.sum(weights, axis=(1, 2)), 1e-12)
    return np.asarray(np.maximum(np.sqrt(mean), _ROUNDING))
