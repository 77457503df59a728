"""The uncertainty of a corner, from the image around it.

Noise n of the image moves the corner q that `calib.boards.corners.saddles` finds, to first order, by

    delta q = M^-1 sum_i w_i (g_i d_i^T + (g_i . d_i) I) (D n)_i = M^-1 sum_k c_k n_k,      d_i = p_i - q
    M = A - sum_i g_i (g_i . d_i) (d w_i / d q)^T

with D n the central differences of the noise, in which neighbours share its pixels k, and with a second term in M
because the window moves with q: it counts where the blur is as wide as the window. With white noise of standard
deviation s the covariance is

    s^2 M^-1 (sum_k c_k c_k^T) M^-T

and the standard deviation given is the root of the mean of its eigenvalues. s is measured beside each corner: the
picture of four squares is the same after half a turn about q, and what is not is noise, dirt, or a blemish.
"""

from __future__ import annotations

import numpy as np

from calib.basics.arrays import Array
from calib.boards.corners.patches import (
    Patch,
    interpolated,
    normal_matrix,
    patch_at,
    pull,
    window_weights,
)

#: Half of the difference by which the weights are differentiated [px].
_MOVE = 0.01

#: Rounding to whole grey values: the standard deviation of the noise is not below it.
_ROUNDING = 1.0 / np.sqrt(12.0)

#: What remains without noise: pixels have a width, and edges of a print are not straight [px].
FLOOR = 0.01


def uncertainty(image: Array, q: Array, window: Array) -> float:
    """Return the standard deviation of a corner, the mean of all directions.

    Args:
        image: Grey values, shape (height, width).
        q: The corner, shape (2,) [px].
        window: The window that it was found with, shape (2, 2) [px].

    Returns:
        The standard deviation [px]; infinite where the window leaves the image.
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
    M = normal_matrix(patch) - _pull_of_moved_window(patch, window)
    inverse = np.linalg.inv(M)
    covariance = inverse @ np.einsum("ijk,ijl->kl", c, c) @ inverse.T
    noise = _noise(image, q, patch)
    variance = noise**2 * float(np.trace(covariance)) / 2.0
    return float(np.sqrt(variance + FLOOR**2))


def _pull_of_moved_window(patch: Patch, window: Array) -> Array:
    """Return B, shape (2, 2): what the gradients pull at q more for each pixel that the window moves along u, v."""
    pulls = pull(patch.offsets, patch.gradients)
    columns = []
    for axis in np.eye(2):
        ahead = window_weights(patch.offsets - _MOVE * axis, window)
        behind = window_weights(patch.offsets + _MOVE * axis, window)
        columns.append(np.einsum("ij,ijk->k", (ahead - behind) / (2.0 * _MOVE), pulls))
    return np.stack(columns, axis=-1)


def _noise(image: Array, q: Array, patch: Patch) -> float:
    """Return the standard deviation of the grey values: the difference to the picture after half a turn about q.

    A corner that noise has moved is not quite the middle of the symmetry: what moving it explains is no noise.
    """
    used = patch.weights > 0.0
    offsets = patch.offsets[used]
    turned = q - offsets
    size = np.array(image.shape[::-1])
    kept = ((turned >= 1.0) & (turned <= size - 3.0)).all(axis=1)
    at_pixels = np.rint(q + offsets[kept]).astype(int)
    values, gain = interpolated(image, turned[kept])
    difference = image[at_pixels[:, 1], at_pixels[:, 0]] - values
    # Interpolation averages noise: its variance becomes gain times that of a pixel.
    weights = patch.weights[used][kept]
    root = np.sqrt(weights / (1.0 + gain))
    residual = _without_shift(root * difference, root[:, None] * patch.gradients[used][kept])
    return float(max(np.sqrt(np.sum(residual**2) / np.sum(weights)), _ROUNDING))


def _without_shift(difference: Array, gradients: Array) -> Array:
    """Return the part of differences of two pictures that no shift between them explains, shape (n,)."""
    shift = np.linalg.lstsq(gradients, difference, rcond=None)[0]
    return np.asarray(difference - gradients @ shift)
