"""Markers in an image, and the place of a board by them: a map on which most of its markers agree.

The markers are found by OpenCV's detector, with parameters for small, steep and blurred ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.basics.arrays import Array, Integers, Mask
from calib.basics.values import Value
from calib.boards.corners.planar_map import PlanarMap, fit_planar_map
from calib.boards.dictionaries import opencv_dictionary
from calib.boards.opencv import opencv

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
        """Return the markers at which a mask, shape (m,), is True."""
        return Markers(self.ids[chosen], self.corners[chosen])

    def of_ids(self, ids: Integers) -> Markers:
        """Return the markers of a board, whose ids are then their places among ``ids`` (n,), from 0."""
        place = {number: k for k, number in enumerate(ids.tolist())}
        used = self.select(np.isin(self.ids, ids))
        return Markers(np.array([place[k] for k in used.ids.tolist()], dtype=int), used.corners)


def no_markers() -> Markers:
    """Return an empty set of markers, which is that of a chessboard."""
    return Markers(np.zeros(0, dtype=int), np.zeros((0, 4, 2)))


def find_markers(
    image: Any,  # noqa: ANN401  8-bit, which Array is not
    dictionary: str,
    *,
    thorough: bool = False,
    enlarged: int = 1,
    border: int = 1,
) -> Markers:
    """Find the markers of a dictionary in an image.

    Args:
        image: Grey values, 8 bits, shape (height, width).
        dictionary: Name of the dictionary.
        thorough: True to search three times as long, which finds some more markers that are blurred or badly lit.
        enlarged: Factor by which the image is enlarged first, which finds smaller markers.
        border: Width of the black border of the markers [bits].

    Returns:
        The markers, with OpenCV's corners: to about half a pixel.

    Raises:
        CalibError: This version of OpenCV does not have the dictionary.
    """
    cv2 = opencv()
    aruco = cv2.aruco
    parameters = aruco.DetectorParameters()
    parameters.adaptiveThreshWinSizeMax = _WIDEST_THRESHOLD
    parameters.adaptiveThreshWinSizeStep = _THOROUGH_STEP if thorough else _THRESHOLD_STEP
    parameters.minMarkerPerimeterRate = _SMALLEST_PERIMETER
    parameters.polygonalApproxAccuracyRate = 0.05
    parameters.minDistanceToBorder = 1
    parameters.minMarkerDistanceRate = 0.02
    parameters.perspectiveRemovePixelPerCell = 8
    parameters.markerBorderBits = border
    parameters.cornerRefinementMethod = aruco.CORNER_REFINE_SUBPIX
    detector = aruco.ArucoDetector(opencv_dictionary(dictionary), parameters)
    if enlarged > 1:
        size = (enlarged * image.shape[1], enlarged * image.shape[0])
        image = cv2.resize(image, size, interpolation=cv2.INTER_CUBIC)
    corners, ids, _ = detector.detectMarkers(image)
    if ids is None or len(ids) == 0:
        return no_markers()
    quadrilaterals = np.array(corners, dtype=np.float64).reshape(-1, 4, 2)
    quadrilaterals = (quadrilaterals + 0.5) / enlarged - 0.5
    return _without_doubles(Markers(np.asarray(ids, dtype=int).reshape(-1), quadrilaterals))


def _without_doubles(markers: Markers) -> Markers:
    """Drop further outlines of the same marker, such as the inner edge of its black frame: the largest one is kept."""
    centres = markers.corners.mean(axis=1)
    sides = markers.sides
    kept = np.zeros(len(sides), dtype=bool)
    for k in np.argsort(-sides, kind="stable").tolist():
        same = kept & (markers.ids == markers.ids[k])
        distances = np.linalg.norm(centres[same] - centres[k], axis=1)
        kept[k] = not np.any(distances < _DOUBLE * sides[k])
    return markers.select(kept)


# The place of a board

#: Fewest markers that place a board.
FEWEST_MARKERS = 2

#: Tolerance with which the corners of a marker agree with a homography, in sides of a marker: a lens bends it.
_COARSE = 0.4

#: Tolerance with which they agree with a map that includes the lens, in sides of the marker.
_FINE = 0.15

#: Tolerance with which they agree with the homography of the neighbouring markers, in sides of the marker.
_BESIDE = 0.3

#: Distance of a marker's middle from where it is predicted at which it is the same marker, in sides of the marker.
_INSIDE = 0.5

#: Number of neighbours that predict where a marker is.
_NEIGHBOURS = 4

#: Smallest value of the tolerances above [px].
_TOLERANCE_PX = 1.5

#: Share of the markers that may disagree on where the board is, and one in any case: an id that was misread. With a
#: wrong layout every second row may agree, or all markers but the last of every second row.
_MISREAD_SHARE = 0.06

#: Maximum number of fits of the map, each to the markers that agreed with the last.
_ROUNDS = 3


@dataclass(frozen=True, slots=True, eq=False)
class Placement(Value):
    """The place of a board by its markers."""

    #: From the board to pixels.
    map: PlanarMap
    #: The markers that agree, shape (m,).
    agrees: Mask
    #: Number of the others that are where the board has them, though their outlines are not.
    ill_outlined: int = 0
    #: Fewest markers that place the board.
    fewest: int = FEWEST_MARKERS

    @property
    def is_sound(self) -> bool:
        """True if two markers or more agree with the place, or the only one, and few enough do not."""
        allowed = max(1.0, _MISREAD_SHARE * len(self.agrees))
        return int(self.agrees.sum()) >= self.fewest and self.misread <= allowed

    @property
    def misread(self) -> int:
        """Number of the markers that are not where the board has them."""
        return int((~self.agrees).sum()) - self.ill_outlined


def place_board(
    markers: Markers, layout: Array, image_size: tuple[int, int], *, are_touched: bool = False
) -> Placement | None:
    """Fit a map from a board to an image by the markers found, leaving out those that were misread.

    Args:
        markers: The markers of the board that were found, with ids counted from 0.
        layout: Corners of all markers of the board, shape (markers, 4, 2) [m].
        image_size: Width and height [px].
        are_touched: True if other black squares touch the corners of the markers, so that an outline may include a part
            of them and the id is right all the same.

    Returns:
        The placement on which most markers agree, sound or not; None for fewer than two markers, unless the board has
        one only, or for no agreement.
    """
    fewest = min(FEWEST_MARKERS, len(layout))
    if len(markers.ids) < fewest:
        return None
    points = layout[markers.ids]

    # The largest set of markers that one homography explains roughly.
    cv2 = opencv()
    tolerance = max(_TOLERANCE_PX, _COARSE * float(np.median(markers.sides)))
    source = points.reshape(-1, 1, 2)
    image = markers.corners.reshape(-1, 1, 2)
    _, used = cv2.findHomography(source, image, cv2.RANSAC, tolerance)
    if used is None:
        return None
    agrees = np.asarray(used.reshape(-1, 4).astype(bool).all(axis=1))
    if agrees.sum() < fewest:
        return None

    # The map that includes the lens, refitted to the markers whose corners are where it predicts them.
    for _ in range(_ROUNDS):
        planar_map = fit_planar_map(
            points[agrees].reshape(-1, 2), markers.corners[agrees].reshape(-1, 2), image_size
        )
        before = agrees
        agrees = _agree_with_map(planar_map, points, markers)
        if agrees.sum() < fewest:
            return None
        if (agrees == before).all():
            break
    agrees = agrees | _agree_with_neighbours(points, markers, agrees)
    ill_outlined = 0
    if are_touched:
        middles = planar_map.project(points.mean(axis=1))
        away = np.linalg.norm(markers.corners.mean(axis=1) - middles, axis=1)
        ill_outlined = int(np.sum(~agrees & (away < _INSIDE * markers.sides)))
    return Placement(planar_map, agrees, ill_outlined, fewest)


def _agree_with_map(planar_map: PlanarMap, points: Array, markers: Markers) -> Mask:
    """Return True for markers whose corners are where a map projects ``points`` (m, 4, 2) [m] to, shape (m,)."""
    predicted = planar_map.project(points.reshape(-1, 2)).reshape(-1, 4, 2)
    distance = np.linalg.norm(markers.corners - predicted, axis=2).max(axis=1)
    return np.asarray(distance <= np.maximum(_TOLERANCE_PX, _FINE * markers.sides))


def _agree_with_neighbours(points: Array, markers: Markers, agrees: Mask) -> Mask:
    """Mark those of the markers not in ``agrees`` (m,) that the homography of their nearest neighbours in it predicts.

    ``points`` are their corners on the board, shape (m, 4, 2) [m]; the mask returned has the shape (m,), and marks none
    if there are too few neighbours.
    A lens may bend in a way that no map of the whole board follows.
    """
    result = np.zeros(len(points), dtype=bool)
    known = np.flatnonzero(agrees)
    if len(known) < _NEIGHBOURS:
        return result
    cv2 = opencv()
    middles = points.mean(axis=1)
    tolerance = np.maximum(_TOLERANCE_PX, _BESIDE * markers.sides)
    for k in np.flatnonzero(~agrees).tolist():
        distances = np.linalg.norm(middles[known] - middles[k], axis=1)
        near = known[np.argsort(distances)[:_NEIGHBOURS]]
        source = points[near].reshape(-1, 2)
        H, _ = cv2.findHomography(source, markers.corners[near].reshape(-1, 2))
        if H is not None:
            predicted = cv2.perspectiveTransform(points[k][None], H)[0]
            distance = np.linalg.norm(predicted - markers.corners[k], axis=1)
            result[k] = distance.max() <= tolerance[k]
    return result
