"""The pixels around a place of an image: central differences, weights, interpolated values.

Weights are w = (1 - (r / R)^2)^4 of the distance r from the place. R is a number of windows in the image, narrow where
a board is seen at a steep angle: with a and b the lengths of the window along the board's x and y, and phi the angle on
the board, 1 / R^2 goes as cos^2(phi) / a^2 + sin^2(phi) / b^2. Across the edges of squares that meet in the place the
weights are even then, to first order: what a blur spreads to both sides of an edge cancels, under perspective too. It
would not with weights that fall off on the board.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.basics.arrays import Array
from calib.basics.values import Value

#: The distance at which the weights are 0, in windows: they are much like exp(-r^2 / 2).
_REACH = 2.8


@dataclass(frozen=True, slots=True, eq=False)
class Patch(Value):
    """The pixels of a window around a place, one row of arrays a pixel: shape (m, ...)."""

    #: Offsets from the place, shape (h, w, 2) [px].
    offsets: Array
    #: Weights, 0 outside the window, shape (h, w).
    weights: Array
    #: Central differences along u and v, shape (h, w, 2).
    gradients: Array


def patch_at(image: Array, q: Array, window: Array) -> Patch | None:
    """Cut out the pixels of a window.

    Args:
        image: Grey values, shape (height, width).
        q: The place, shape (2,) [px].
        window: Its columns are the window along the board's x and y, shape (2, 2) [px].

    Returns:
        The pixels; None where the window leaves the image, or q is no number.
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
    gradients = np.empty_like(offsets)
    gradients[..., 0] = du
    gradients[..., 1] = dv
    return Patch(offsets, window_weights(offsets, window), gradients)


def window_weights(offsets: Array, window: Array) -> Array:
    """Return the weights w of pixels.

    Args:
        offsets: From the place to the pixels, shape (h, w, 2) [px].
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


def normal_matrix(patch: Patch) -> Array:
    """Return A, shape (2, 2)."""
    g = patch.gradients
    return np.asarray(np.einsum("ij,ijk,ijl->kl", patch.weights, g, g))


def pull(offsets: Array, gradients: Array) -> Array:
    """Return how strongly each pixel draws the corner q towards it.

    Args:
        offsets: From q to the pixels p, shape (h, w, 2) [px].
        gradients: Central differences g, shape (h, w, 2).

    Returns:
        g (g . (p - q)), shape (h, w, 2).
    """
    along = np.sum(gradients * offsets, axis=-1, keepdims=True)
    return np.asarray(gradients * along)


def interpolated(image: Array, places: Array) -> tuple[Array, Array]:
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
