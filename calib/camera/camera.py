"""Cameras: the size of the image, the lens model, its numbers, and how well these are known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.units import Array
from calib.values.pickling import Value

#: Standard deviation of a number of which nothing is known.
UNKNOWN = np.inf


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Camera(Value):
    """A camera: z along the line of sight, x to the right and y down in the image, as OpenCV and ROS have it.

    The centre of the pixel in the image's upper left corner is (0, 0).
    """

    #: Name, as in the column ``group`` of a table of corners.
    name: str = "camera"
    #: Columns of the image [px].
    width: int
    #: Rows of the image [px].
    height: int
    #: A name of `calib.camera.lenses.LENSES`: ``"pinhole"`` or ``"fisheye"``.
    lens: str = "pinhole"
    #: The lens's numbers in the order of ``LENSES[lens].names``: fx, fy, cx, cy [px], then distortion, shape (m,).
    #: None: nothing of them is known, and the images tell.
    values: Array | None = None
    #: Standard deviation of each, in its unit, shape (m,): 0 for one that is exact, `UNKNOWN` for one that is not
    #: known. None: the default of a camera whose numbers are given, see `calib.camera.lenses.Lens.default_sigma`.
    sigma: Array | None = None
