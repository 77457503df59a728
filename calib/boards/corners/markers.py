"""Markers in an image, by OpenCV's detector with parameters for small, steep and blurred ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.basics.arrays import Array, Integers, Mask
from calib.basics.values import Value
from calib.boards.dictionaries import DICTIONARIES
from calib.boards.opencv import opencv
from calib.errors import CalibError

#: Widest window of the adaptive threshold [px]: large markers and blurred edges need more than the default of 23.
_WIDEST_THRESHOLD = 43

#: Step from the narrowest window, of 3 px, to the widest [px]: each costs a pass through the image.
_THRESHOLD_STEP = 20

#: The step of a thorough search [px].
_THOROUGH_STEP = 5

#: Outlines of one id belong to one marker if their middles are nearer than this, in sides of the smaller one.
_DOUBLE = 0.5

#: Smallest perimeter of a marker as a share of the image's longer side: 26 px in 1280.
_SMALLEST_PERIMETER = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Markers(Value):
    """The markers of one dictionary that an image shows; an id may occur more than once, or be wrong."""

    #: Their ids, shape (m,).
    ids: Integers
    #: Their corners, clockwise from the top left, shape (m, 4, 2) [px].
    corners: Array

    @property
    def sides(self) -> Array:
        """Mean side of each marker, shape (m,) [px]."""
        edges = self.corners - np.roll(self.corners, 1, axis=1)
        return np.asarray(np.linalg.norm(edges, axis=2).mean(axis=1))

    def select(self, chosen: Mask) -> Markers:
        """Return the markers of a mask, shape (m,)."""
        return Markers(self.ids[chosen], self.corners[chosen])

    def of_ids(self, first: int, count: int) -> Markers:
        """Return the markers of a board.

        Args:
            first: Id of the board's first marker.
            count: Number of its markers.

        Returns:
            Those with one of these ids, which are then counted from 0.
        """
        used = self.select((self.ids >= first) & (self.ids < first + count))
        return Markers(used.ids - first, used.corners)


def no_markers() -> Markers:
    """Return no markers, as a chessboard has."""
    return Markers(np.zeros(0, dtype=int), np.zeros((0, 4, 2)))


def find_markers(
    image: Any,  # noqa: ANN401  8-bit, which Array is not
    dictionary: str,
    *,
    thorough: bool = False,
) -> Markers:
    """Find the markers of a dictionary.

    Args:
        image: Grey values, 8 bits, shape (height, width).
        dictionary: Name of the dictionary.
        thorough: True to search three times as long, which finds some more markers that are blurred or badly lit.

    Returns:
        The markers, with OpenCV's corners: to about half a pixel.

    Raises:
        CalibError: This version of OpenCV does not have the dictionary.
    """
    cv2 = opencv()
    aruco = cv2.aruco
    number = getattr(aruco, dictionary, None) if dictionary in DICTIONARIES else None
    if number is None:
        raise CalibError(
            f"OpenCV {cv2.__version__} has no dictionary of markers '{dictionary}'; a newer one may: pip install "
            "--upgrade opencv-python-headless"
        )
    parameters = aruco.DetectorParameters()
    parameters.adaptiveThreshWinSizeMax = _WIDEST_THRESHOLD
    parameters.adaptiveThreshWinSizeStep = _THOROUGH_STEP if thorough else _THRESHOLD_STEP
    parameters.minMarkerPerimeterRate = _SMALLEST_PERIMETER
    parameters.polygonalApproxAccuracyRate = 0.05
    parameters.minDistanceToBorder = 1
    parameters.minMarkerDistanceRate = 0.02
    parameters.perspectiveRemovePixelPerCell = 8
    parameters.cornerRefinementMethod = aruco.CORNER_REFINE_SUBPIX
    detector = aruco.ArucoDetector(aruco.getPredefinedDictionary(number), parameters)
    corners, ids, _ = detector.detectMarkers(image)
    if ids is None or len(ids) == 0:
        return no_markers()
    quadrilaterals = np.array(corners, dtype=np.float64).reshape(-1, 4, 2)
    return _without_doubles(Markers(np.asarray(ids, dtype=int).reshape(-1), quadrilaterals))


def _without_doubles(markers: Markers) -> Markers:
    """Drop a second outline of the same marker, such as the inner edge of its black frame: the larger one is kept."""
    centres = markers.corners.mean(axis=1)
    sides = markers.sides
    kept = np.zeros(len(sides), dtype=bool)
    for k in np.argsort(-sides, kind="stable").tolist():
        same = kept & (markers.ids == markers.ids[k])
        distances = np.linalg.norm(centres[same] - centres[k], axis=1)
        kept[k] = not np.any(distances < _DOUBLE * sides[k])
    return markers.select(kept)
