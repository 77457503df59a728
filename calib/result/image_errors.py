"""Errors of images in metres at the board: across the line of sight, as far as the corner is away.

An error of e pixels of a corner at the depth Z is e Z / f at the board, with the focal length f [px].
"""

from __future__ import annotations

import numpy as np

from calib.camera.optics import INTRINSICS
from calib.channels import Channels
from calib.estimate.fitting import Fitted
from calib.numerics.errors import Errors
from calib.registration.rows import Rows
from calib.units import Array, Mask


def metres_per_pixel(fitted: Fitted, rows: Rows) -> Array | None:
    """Return the length at the board that a pixel is, at each corner.

    Args:
        fitted: A fit.
        rows: N rows.

    Returns:
        shape (N,) [m/px], NaN in rows of other kinds; None where no row is an image.
    """
    is_image = rows.where(lambda kind: kind.optical)
    if not np.any(is_image):
        return None
    x = fitted.estimate.x
    optics = fitted.kinematics.optics(x, rows.samples)
    assert optics is not None
    depth = rows.points(fitted.kinematics.poses(x, rows.samples))[:, 2]
    focal = np.mean(optics.values[:, INTRINSICS][:, :2], axis=1)
    return np.where(is_image, depth / np.where(is_image, focal, 1.0), np.nan)


def errors_at_board(residual: Array, channels: Channels, scale: Array, rows: Mask) -> Errors:
    """Summarise the residuals of images as lengths at the board.

    Args:
        residual: shape (N, D), measured minus predicted, of which those in pixels count.
        channels: The channel of each entry.
        scale: shape (N,), length that a pixel is at each corner [m/px].
        rows: shape (N,), which rows count.

    Returns:
        Figures in metres.
    """
    images = channels.where("px")
    lengths = np.where(images, residual, 0.0) * np.where(np.isfinite(scale), scale, 0.0)[:, None]
    return Errors.of(lengths[rows], Channels.of_unit(images[rows]))
