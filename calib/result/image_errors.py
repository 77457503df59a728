"""Errors of images in metres at the board: across the line of sight, at the depth of the corner.

An error of e pixels of a corner at the depth Z is e Z / f at the board, with the focal length f [px].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.basics.arrays import Array
from calib.basics.channels import Channels
from calib.fit.estimate.fitting import Fitted
from calib.fit.registration.rows import Rows
from calib.model.kinematics import Sightings
from calib.numerics.errors import Errors

#: Percentile that is reported besides mean and largest error.
_MOST = 95.0


@dataclass(frozen=True, slots=True)
class ImageFigures:
    """Errors of images in pixels and at the board; the error of a corner is the distance of its image."""

    #: Number of images, and of corners in them
    images: int
    corners: int
    #: Mean of the errors, the 95th percentile, and the largest [px]
    mean: float
    p95: float
    largest: float
    #: Mean residual, measured minus predicted, along u and along v [px]
    bias: tuple[float, float]
    #: Mean, 95th percentile and largest error as a length at the board [m]
    mean_at_board: float
    p95_at_board: float
    largest_at_board: float

    @classmethod
    def of(
        cls, residual: Array, scale: Array, rows: Rows, names: Sequence[str]
    ) -> ImageFigures | None:
        """Summarise the residuals of images.

        Args:
            residual: shape (N, D), measured minus predicted.
            scale: shape (N,), length that a pixel is at each corner [m/px]; NaN in rows that are not images.
            rows: The N rows.
            names: Name of the image of each row; without names, a pose has one image.

        Returns:
            The figures; None if no row is an image.
        """
        images = np.isfinite(scale)
        if not np.any(images):
            return None
        uv = residual[images][:, :2]
        errors = np.linalg.norm(uv, axis=1)
        lengths = errors * scale[images]
        bias = uv.mean(axis=0)
        return cls(
            images=len({(rows.blocks[i], names[i]) for i in np.flatnonzero(images).tolist()}),
            corners=int(np.sum(images)),
            mean=float(errors.mean()),
            p95=float(np.percentile(errors, _MOST)),
            largest=float(errors.max()),
            bias=(float(bias[0]), float(bias[1])),
            mean_at_board=float(lengths.mean()),
            p95_at_board=float(np.percentile(lengths, _MOST)),
            largest_at_board=float(lengths.max()),
        )


def metres_per_pixel(fitted: Fitted, rows: Rows) -> Array | None:
    """Return the length at the board that a pixel is, at each corner, as a fit predicts it.

    Args:
        fitted: A fit.
        rows: N rows.

    Returns:
        shape (N,) [m/px], NaN in rows of other kinds; None if no row is an image.
    """
    return length_of_pixels(fitted.kinematics.sightings(fitted.estimate.x, rows.samples), rows)


def length_of_pixels(sightings: Sightings, rows: Rows) -> Array | None:
    """Return the length at the board that a pixel is, at each corner.

    Args:
        sightings: Poses of the boards in their cameras, and the cameras' internals.
        rows: N rows.

    Returns:
        shape (N,) [m/px], NaN in rows of other kinds; None if no row is an image.
    """
    return rows.lengths_per_unit(sightings) if np.any(rows.is_image) else None


def errors_at_board(residual: Array, channels: Channels, scale: Array) -> Errors:
    """Summarise the residuals of images as lengths at the board.

    Args:
        residual: shape (N, D), measured minus predicted; those in pixels count.
        channels: The channel of each entry.
        scale: shape (N,), length that a pixel is at each corner [m/px]; NaN in rows that are not images.

    Returns:
        Figures in metres.
    """
    images = channels.where("px")
    lengths = np.where(images, residual, 0.0) * np.where(np.isfinite(scale), scale, 0.0)[:, None]
    return Errors.of(lengths, Channels.of_unit(images))
