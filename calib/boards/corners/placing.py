"""The place of a board in an image by its markers: a map that most of them agree on, and those that do not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.basics.arrays import Array, Mask
from calib.basics.values import Value
from calib.boards.corners.markers import Markers
from calib.boards.corners.planar_map import PlanarMap, fit_planar_map
from calib.boards.opencv import opencv

#: Fewest markers that place a board.
FEWEST_MARKERS = 2

#: Tolerance with which the corners of a marker agree with a homography, in sides of a marker: a lens bends it.
_COARSE = 0.4

#: Tolerance with which they agree with a map that includes the lens, in sides of the marker.
_FINE = 0.15

#: Tolerance with which they agree with the homography of the neighbouring markers, in sides of the marker.
_BESIDE = 0.3

#: Number of neighbours that predict where a marker is.
_NEIGHBOURS = 4

#: Smallest value of these tolerances [px].
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

    @property
    def is_sound(self) -> bool:
        """True if enough markers agree."""
        allowed = max(1.0, _MISREAD_SHARE * len(self.agrees))
        return int(self.agrees.sum()) >= FEWEST_MARKERS and self.misread <= allowed

    @property
    def misread(self) -> int:
        """Number of the markers that do not agree."""
        return int((~self.agrees).sum())


def place(markers: Markers, layout: Array, image_size: tuple[int, int]) -> Placement | None:
    """Place a board by its markers.

    Args:
        markers: The markers of the board that were found, with ids counted from 0.
        layout: Corners of all markers of the board, shape (markers, 4, 2) [m].
        image_size: Width and height [px].

    Returns:
        The placement on which most markers agree, sound or not; None for fewer than two markers, or no agreement.
    """
    if len(markers.ids) < FEWEST_MARKERS:
        return None
    points = layout[markers.ids]
    agrees = _agree_on_homography(points, markers)
    if agrees.sum() < FEWEST_MARKERS:
        return None
    for _ in range(_ROUNDS):
        planar_map = fit_planar_map(
            points[agrees].reshape(-1, 2), markers.corners[agrees].reshape(-1, 2), image_size
        )
        before = agrees
        agrees = _agree_with_map(planar_map, points, markers)
        if agrees.sum() < FEWEST_MARKERS:
            return None
        if (agrees == before).all():
            break
    return Placement(planar_map, agrees | _agree_with_neighbours(points, markers, agrees))


def _agree_on_homography(points: Array, markers: Markers) -> Mask:
    """Return the largest set of markers that one homography explains roughly, shape (m,)."""
    cv2 = opencv()
    tolerance = max(_TOLERANCE_PX, _COARSE * float(np.median(markers.sides)))
    source = points.reshape(-1, 1, 2)
    image = markers.corners.reshape(-1, 1, 2)
    _, used = cv2.findHomography(source, image, cv2.RANSAC, tolerance)
    if used is None:
        return np.zeros(len(points), dtype=bool)
    return np.asarray(used.reshape(-1, 4).astype(bool).all(axis=1))


def _agree_with_map(planar_map: PlanarMap, points: Array, markers: Markers) -> Mask:
    """Return which markers are where a map predicts their corners, shape (m,)."""
    predicted = planar_map.project(points.reshape(-1, 2)).reshape(-1, 4, 2)
    distance = np.linalg.norm(markers.corners - predicted, axis=2).max(axis=1)
    return np.asarray(distance <= np.maximum(_TOLERANCE_PX, _FINE * markers.sides))


def _agree_with_neighbours(points: Array, markers: Markers, agrees: Mask) -> Mask:
    """Return the other markers that are where the homography of their nearest neighbours predicts them, shape (m,).

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
