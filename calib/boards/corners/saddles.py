"""Saddle points of an image, where four squares of a board meet, to a fraction of a pixel.

At a corner q every gradient of the image is either zero or at right angles to the line from q to its pixel, because all
edges run through q (Foerstner and Guelch 1987). So q is sought with

    sum_i w_i g_i (g_i . (p_i - q)) = 0,      A = sum_i w_i g_i g_i^T

with the central differences g_i at the pixels p_i, which are not interpolated, and the weights w_i of
`calib.boards.corners.patches`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.basics.arrays import Array, Mask
from calib.basics.values import Value
from calib.boards.corners.patches import interpolated, normal_matrix, patch_at, pull
from calib.boards.corners.uncertainty import uncertainty

#: A window is nowhere narrower than this [px]: central differences need some pixels.
_NARROWEST = 1.3

#: Steps until a corner stands still.
_MAX_STEPS = 30

#: A corner that moves less than this stands still [px].
_STILL = 1e-3

#: A corner moves no further from where it was expected than this, in units of the window.
_FURTHEST = 2.5

#: Where the determinant of A is less than this part of the largest it could be, there are no two edges.
_LEAST_DETERMINANT = 1e-3

#: A window is nowhere wider than this along an edge [px]: edges are straight no further where a lens bends them.
_WIDEST = 4.0

#: Angles on the board at which the colours around a corner are compared [rad]: none close to an edge.
_ANGLES = np.radians(
    np.concatenate([start + np.array([20.0, 45.0, 70.0]) for start in (0, 90, 180, 270)])
)

#: Distance at which they are compared, in units of the window.
_RADIUS = 1.8

#: Smallest correlation of the colours around a saddle with those of a board.
_LEAST_CORRELATION = 0.8

#: Smallest difference of black and white [grey values of 255].
_LEAST_CONTRAST = 8.0


@dataclass(frozen=True, slots=True, eq=False)
class Saddles(Value):
    """Refined corners, in the order of those that were sought."""

    #: Their pixels, shape (n, 2); NaN where there is no saddle.
    pixels: Array
    #: Standard deviation along u and along v, shape (n,) [px]; NaN where there is no saddle.
    sigma: Array

    @property
    def exist(self) -> Mask:
        """Mask of the places with a saddle, shape (n,)."""
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
        q = _stationary(image, expected[k], window)
        if q is None or not _has_colours(image, q, window, float(signs[k])):
            continue
        pixels[k] = q
        sigma[k] = uncertainty(image, q, window)
    return Saddles(pixels, sigma)


def _bounded(window: Array) -> Array:
    """Return a window that is not too wide along either edge, and nowhere too narrow, shape (2, 2)."""
    lengths = np.sqrt(np.sum(window**2, axis=0))
    U, singular, Vt = np.linalg.svd(window * np.minimum(1.0, _WIDEST / lengths))
    return np.asarray(U @ np.diag(np.maximum(singular, _NARROWEST)) @ Vt)


def _stationary(image: Array, expected: Array, window: Array) -> Array | None:
    """Return the corner that the gradients point at, shape (2,); None if there is none near the place expected."""
    q = expected
    inverse = np.linalg.inv(window)
    for _ in range(_MAX_STEPS):
        patch = patch_at(image, q, window)
        if patch is None:
            return None
        A = normal_matrix(patch)
        if np.linalg.det(A) <= _LEAST_DETERMINANT * np.trace(A) ** 2 / 4.0:  # one edge, or nothing
            return None
        pulls = pull(patch.offsets, patch.gradients)
        step = np.linalg.solve(A, np.einsum("ij,ijk->k", patch.weights, pulls))
        q = q + step
        if np.linalg.norm(inverse @ (q - expected)) > _FURTHEST:
            return None
        if np.hypot(*step) < _STILL:
            return q
    return None


def _has_colours(image: Array, q: Array, window: Array, sign: float) -> bool:
    """Test whether the colours around a corner alternate as those of four squares do, with the right one first."""
    directions = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1)
    places = q + _RADIUS * directions @ window.T
    inside = (places >= 1.0) & (places <= np.array(image.shape[::-1]) - 3.0)
    if not inside.all():
        return False
    values = interpolated(image, places)[0]
    pattern = sign * np.sign(np.sin(2.0 * _ANGLES))
    contrast = 2.0 * float(np.mean(values * pattern))
    spread = float(np.std(values))
    return contrast >= _LEAST_CONTRAST and contrast >= 2.0 * _LEAST_CORRELATION * spread
