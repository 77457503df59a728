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

#: A marker agrees with a homography whose corners are nearer than this, in sides of a marker: lenses bend.
_COARSE = 0.4

#: A marker agrees with a map that knows the lens where its corners are nearer than this, in sides of a marker.
_FINE = 0.15

#: A marker agrees with its neighbours where its corners are nearer than this to where these have it, in sides of it.
_BESIDE = 0.3

#: The neighbours that tell where a marker is: the nearest ones.
_NEIGHBOURS = 4

#: Fewest pixels that either tolerance means.
_TOLERANCE_PX = 1.5

#: Share of the markers that may disagree on where the board is, and one in any case: an id that was misread. Of a wrong
#: layout every second row may agree, or all markers but the last of every second row.
_MISREAD_SHARE = 0.06

#: Fits of the map, each to the markers that agreed with the last.
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
        markers: The markers, with ids counted from 0; of those that are not on the board nothing comes.
        layout: Corners of all markers of the board, shape (markers, 4, 2) [m].
        image_size: Width and height [px].

    Returns:
        The placement of most agreement, sound or not; None for fewer than two markers, or no agreement.
    """
    if len(markers.ids) < FEWEST_MARKERS:
        return None
    points = layout[markers.ids]
    agrees = _agreeing_on_homography(points, markers.corners)
    if agrees.sum() < FEWEST_MARKERS:
        return None
    for _ in range(_ROUNDS):
        planar_map = fit_planar_map(
            points[agrees].reshape(-1, 2), markers.corners[agrees].reshape(-1, 2), image_size
        )
        before = agrees
        agrees = _agreeing(planar_map, points, markers.corners)
        if agrees.sum() < FEWEST_MARKERS:
            return None
        if (agrees == before).all():
            break
    return Placement(
        planar_map, agrees | _agreeing_with_neighbours(points, markers.corners, agrees)
    )


def _sides(corners: Array) -> Array:
    """Return the mean side of each marker, shape (m,) [px]."""
    edges = corners - np.roll(corners, 1, axis=1)
    return np.asarray(np.linalg.norm(edges, axis=2).mean(axis=1))


def _agreeing_on_homography(points: Array, corners: Array) -> Mask:
    """Return the largest set of markers that one homography explains roughly, shape (m,)."""
    cv2 = opencv()
    tolerance = max(_TOLERANCE_PX, _COARSE * float(np.median(_sides(corners))))
    source = points.reshape(-1, 1, 2)
    image = corners.reshape(-1, 1, 2)
    _, used = cv2.findHomography(source, image, cv2.RANSAC, tolerance)
    if used is None:
        return np.zeros(len(points), dtype=bool)
    return np.asarray(used.reshape(-1, 4).astype(bool).all(axis=1))


def _agreeing_with_neighbours(points: Array, corners: Array, agrees: Mask) -> Mask:
    """Return the other markers that are where their nearest neighbours have them: a lens may bend as no map does.

    Args:
        points: Corners of the markers on the board, shape (m, 4, 2) [m].
        corners: Where they were found, shape (m, 4, 2) [px].
        agrees: The markers that agree with the map of the whole board, shape (m,).
    """
    result = np.zeros(len(points), dtype=bool)
    known = np.flatnonzero(agrees)
    if len(known) < _NEIGHBOURS:
        return result
    middles = points.mean(axis=1)
    tolerance = np.maximum(_TOLERANCE_PX, _BESIDE * _sides(corners))
    for k in np.flatnonzero(~agrees).tolist():
        distances = np.linalg.norm(middles[known] - middles[k], axis=1)
        near = known[np.argsort(distances)[:_NEIGHBOURS]]
        predicted = _by_homography(points[near], corners[near], points[k])
        result[k] = np.linalg.norm(predicted - corners[k], axis=1).max() <= tolerance[k]
    return result


def _by_homography(points: Array, corners: Array, others: Array) -> Array:
    """Predict where other points are seen by the homography of some markers.

    Args:
        points: Corners of the markers on the board, shape (m, 4, 2) [m].
        corners: Where they were found, shape (m, 4, 2) [px].
        others: Other points of the board, shape (n, 2) [m].

    Returns:
        Their pixels, shape (n, 2); NaN where the markers tell no homography.
    """
    cv2 = opencv()
    H, _ = cv2.findHomography(points.reshape(-1, 2), corners.reshape(-1, 2))
    if H is None:
        return np.full(others.shape, np.nan)
    return np.asarray(cv2.perspectiveTransform(others[None], H)[0])


def _agreeing(planar_map: PlanarMap, points: Array, corners: Array) -> Mask:
    """Return the markers whose corners are where a map has them, shape (m,)."""
    predicted = planar_map.project(points.reshape(-1, 2)).reshape(-1, 4, 2)
    distance = np.linalg.norm(corners - predicted, axis=2).max(axis=1)
    tolerance = np.maximum(_TOLERANCE_PX, _FINE * _sides(corners))
    return np.asarray(distance <= tolerance)
