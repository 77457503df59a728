"""The centres of circles on a board: where the darkness of each is in the mean, less what perspective moves that.

The mean place c of a dark spot's pixels, weighted by how much darker than the paper around it they are, is the same
for any blur. But it is not the image of the circle's centre: the half of a tilted disc that is nearer to the camera has
more pixels. With P the map from the board to the image and J its derivatives, the disc D about x has its mean at

    c = integral over D of P |J| / integral over D of |J|

so P(x) is the measured c less c - P(x), which the map of all circles gives. With white noise of standard deviation s of
the pixels p the standard deviation of c along one axis is s sqrt(sum |p - c|^2 / 2) / sum of darkness.

The first map is from OpenCV, which finds all circles or none, and does not know where the board begins. Of the orders
that fit, not mirrored, the one is taken whose x axis points most to the right of the image.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.basics.arrays import Array, Mask
from calib.basics.values import Value
from calib.boards.board import ASYMMETRIC_CIRCLES, Board
from calib.boards.corners.planar_map import PlanarMap, fit_planar_map
from calib.boards.corners.saddles import FLOOR, Saddles
from calib.boards.opencv import opencv

#: Smallest area of a circle in the image that is sought [px^2], and the largest, as a share of the image's.
_AREA = (20.0, 0.05)

#: Largest distance of circles from the best map, relative to that of another order: with it, both fit.
_AS_GOOD = 1.5

#: Radius within which the darkness of a circle is measured, in radii of the circle; ...
_REACH = 1.7

#: ... and in the distance to the edge of the next circle.
_REACH_TO_NEXT = 0.9

#: Beginning of the ring in which the paper's brightness is measured, in these radii.
_RING = 0.85

#: Number of rounds, each with the map of the last.
_ROUNDS = 3

#: Step of the differences by which a map is differentiated, in distances of circles.
_STEP = 0.1

#: Smallest and largest darkness of a circle, in those of all in the median: others are hidden, or dirty.
_DARKNESS = (0.5, 2.0)

#: A circle is an outlier if its distance from the map of all exceeds this many times the median, and this [px].
_OUTLYING = 6.0
_TOLERANCE_PX = 0.5

#: Rings and spokes of the points at which a disc is integrated.
_RINGS, _SPOKES = 6, 16


@dataclass(frozen=True, slots=True, eq=False)
class Circles(Value):
    """A grid of circles in an image, as OpenCV finds it, in order."""

    #: From the board to the image.
    map: PlanarMap
    #: The approximate pixels of the centres in the order of their ids, shape (n, 2).
    pixels: Array


def find_circles(image: Any, board: Board) -> Circles | None:  # noqa: ANN401  8-bit
    """Find a grid of circles in an image, by OpenCV, and the order of its circles.

    Args:
        image: Grey values, 8 bits, dark circles, shape (height, width).
        board: A grid of circles.

    Returns:
        The circles; None if not all are seen.
    """
    cv2 = opencv()
    parameters = cv2.SimpleBlobDetector_Params()
    parameters.minArea = _AREA[0]
    parameters.maxArea = _AREA[1] * image.size
    parameters.minDistBetweenBlobs = 4.0
    parameters.minThreshold = 10.0
    parameters.maxThreshold = 250.0
    parameters.minInertiaRatio = 0.05
    blobs = cv2.SimpleBlobDetector_create(parameters)
    is_asymmetric = board.pattern == ASYMMETRIC_CIRCLES
    kind = cv2.CALIB_CB_ASYMMETRIC_GRID if is_asymmetric else cv2.CALIB_CB_SYMMETRIC_GRID
    size = (board.columns, board.rows)
    for flags in (kind, kind | cv2.CALIB_CB_CLUSTERING):
        is_seen, centres = cv2.findCirclesGrid(image, size, flags=flags, blobDetector=blobs)
        if is_seen:
            found = _in_order(np.asarray(centres, dtype=np.float64).reshape(-1, 2), image, board)
            if found is not None:
                return found
    return None


def _in_order(centres: Array, image: Any, board: Board) -> Circles | None:  # noqa: ANN401  8-bit
    """Return a grid of circles at pixels ``centres`` (n, 2), in one of the orders that fit; None if none does."""
    image_size = (image.shape[1], image.shape[0])
    grid = centres.reshape(board.rows, board.columns, 2)
    points = board.corners[:, :2]
    fitting = []
    for turn in range(4):
        for turned in (np.rot90(grid, turn), np.rot90(grid, turn)[:, ::-1]):
            if turned.shape != grid.shape:
                continue
            pixels = turned.reshape(-1, 2)
            planar_map = fit_planar_map(points, pixels, image_size)
            J = planar_map.jacobians(board.centre[None, :2], _STEP * board.square)[0]
            misses = np.linalg.norm(planar_map.project(points) - pixels, axis=1)
            if np.linalg.det(J) > 0.0 and np.isfinite(misses).all():
                fitting.append((float(misses.max()), float(J[0, 0]), planar_map, pixels))
    if not fitting:
        return None
    best = min(miss for miss, _, _, _ in fitting)
    if (
        best
        > board.marker
        * np.linalg.norm(fitting[0][2].jacobians(points, board.marker), axis=(1, 2)).max()
    ):
        return None
    alike = [row for row in fitting if row[0] <= _AS_GOOD * best + _TOLERANCE_PX]
    _, _, planar_map, pixels = max(alike, key=lambda row: row[1])
    return Circles(planar_map, pixels)


def refine_circles(image: Array, board: Board, circles: Circles) -> tuple[Saddles, PlanarMap]:
    """Refine the centres of the circles of a board, and the map from the board to the image.

    Args:
        image: Grey values, shape (height, width).
        board: A grid of circles.
        circles: The circles, to a few pixels.

    Returns:
        The centres in the order of their ids, NaN for those that are hidden or do not agree with the others; and the
        map fitted to them.
    """
    points = board.corners[:, :2]
    image_size = (image.shape[1], image.shape[0])
    planar_map = circles.map
    found = Saddles(circles.pixels, np.full(len(points), np.nan))
    for _ in range(_ROUNDS):
        pixels = np.full((len(points), 2), np.nan)
        sigma = np.full(len(points), np.nan)
        darkness = np.full(len(points), np.nan)
        offsets = _perspective_offsets(planar_map, board)
        for k, point in enumerate(points):
            spot = _spot(image, planar_map, board, point)
            if spot is not None:
                pixels[k] = spot[0] - offsets[k]
                sigma[k], darkness[k] = spot[1:]
        share = darkness / np.nanmedian(darkness) if np.isfinite(darkness).any() else darkness
        is_whole = (share > _DARKNESS[0]) & (share < _DARKNESS[1])
        found = Saddles(pixels[is_whole], sigma[is_whole]).among(len(points), is_whole)
        if is_whole.sum() < 4:
            break
        planar_map = fit_planar_map(points[is_whole], pixels[is_whole], image_size)
        distance = np.linalg.norm(found.pixels - planar_map.project(points), axis=1)
        agrees: Mask = distance <= max(_TOLERANCE_PX, _OUTLYING * float(np.nanmedian(distance)))
        found = Saddles(found.pixels[agrees], found.sigma[agrees]).among(len(points), agrees)
    return found, planar_map


def _perspective_offsets(planar_map: PlanarMap, board: Board) -> Array:
    """Return how far the mean of each circle's pixels is from the image of its centre, c - P(x), shape (n, 2) [px]."""
    ring = np.sqrt((np.arange(_RINGS) + 0.5) / _RINGS)  # of equal areas
    angle = 2.0 * np.pi * np.arange(_SPOKES) / _SPOKES
    disc = np.stack([np.outer(ring, np.cos(angle)), np.outer(ring, np.sin(angle))], axis=-1)
    around = (board.marker / 2.0 * disc).reshape(-1, 2)
    points = board.corners[:, None, :2] + around
    flat = points.reshape(-1, 2)
    area = np.linalg.det(planar_map.jacobians(flat, _STEP * board.square)).reshape(len(points), -1)
    seen = planar_map.project(flat).reshape(len(points), -1, 2)
    means = np.sum(area[..., None] * seen, axis=1) / np.sum(area, axis=1)[:, None]
    return np.asarray(means - planar_map.project(board.corners[:, :2]))


def _spot(
    image: Array, planar_map: PlanarMap, board: Board, point: Array
) -> tuple[Array, float, float] | None:
    """Return the mean of a circle's dark pixels (2,) [px], its sigma [px] and its mean darkness.

    None if it is not seen. The circle is expected about ``point`` (2,) [m] of the board.
    """
    radius = board.marker / 2.0
    is_asymmetric = board.pattern == ASYMMETRIC_CIRCLES
    next_one = board.square * (np.sqrt(2.0) if is_asymmetric else 1.0)
    reach = min(_REACH * radius, _REACH_TO_NEXT * (next_one - radius))
    angle = 2.0 * np.pi * np.arange(_SPOKES) / _SPOKES
    outline = point + reach * np.column_stack([np.cos(angle), np.sin(angle)])
    edge = planar_map.project(outline)
    if not np.isfinite(edge).all():
        return None
    low, high = np.floor(edge.min(axis=0)).astype(int), np.ceil(edge.max(axis=0)).astype(int)
    height, width = image.shape
    if (low < 0).any() or high[0] >= width or high[1] >= height:
        return None
    u, v = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
    pixels = np.column_stack([u.ravel(), v.ravel()]).astype(np.float64)
    grey = image[low[1] : high[1] + 1, low[0] : high[0] + 1].ravel()
    distance = np.linalg.norm(planar_map.unproject(pixels) - point, axis=1)
    inside = distance <= reach
    ring = inside & (distance >= _RING * reach)
    if ring.sum() < _SPOKES:
        return None

    # The paper's brightness is a plane through the ring.
    middle = pixels[ring].mean(axis=0)
    plane = np.column_stack([np.ones(len(pixels)), pixels - middle])
    fit = np.linalg.lstsq(plane[ring], grey[ring], rcond=None)[0]
    paper = plane @ fit
    noise = float(np.std(grey[ring] - paper[ring]))
    dark = np.where(inside, paper - grey, 0.0)
    total = float(dark.sum())
    if total <= 0.0:
        return None
    mean = dark @ pixels / total
    spread = float(np.sum((pixels[inside] - mean) ** 2)) / 2.0
    sigma = float(np.sqrt((noise * np.sqrt(spread) / total) ** 2 + FLOOR**2))
    area = float(np.sum(distance <= radius))
    return mean, sigma, total / max(area, 1.0)
