"""Corners of tags: where the lines of two edges of the black square meet.

A blur rounds a corner and moves what a corner detector finds inwards, but it does not move an edge away from the
corners. Each edge is sampled across, once for each pixel of its length, and located at the mean position of the slope,
weighted by its steepness. A line is fitted to the half of the edge next to the corner, which a lens bends little. The
scatter about the lines gives the uncertainty.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.basics.arrays import Array
from calib.basics.values import Value
from calib.boards.corners.saddles import FLOOR, Saddles

#: Cells along a side of a tag, border included, at most: the black border is one cell wide.
_CELLS = 10.0

#: Beginning of the part of an edge that is used, in lengths of the edge from the corner: the blur rounds the corner.
_FROM = 0.08

#: Its end, in lengths of the edge.
_TO = 0.55

#: Shortest and longest reach to either side of an edge [px]; the longest is as many cells at least, for a large tag
#: may be blurred over more pixels.
_REACH = (1.5, 3.5)
_REACH_IN_CELLS = 0.25

#: Distance between samples across an edge [px].
_STEP = 0.5

#: Fewest and most iterations, each sampling around the lines of the last: an edge blurred beyond the reach draws the
#: lines nearer each time.
_ROUNDS = (3, 20)

#: Move of the corners below which the iterations end [px].
_STILL = 0.01

#: Fewest places along half an edge for a line.
_FEWEST = 4

#: Smallest mean slope of an edge [grey values per px].
_LEAST_SLOPE = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class _Line(Value):
    """A line n . p = c."""

    #: Unit normal n, shape (2,).
    normal: Array
    #: Distance c from the origin along the normal [px].
    offset: float
    #: Middle of the places, shape (2,) [px].
    middle: Array
    #: Variance at the middle [px^2], and of the direction [rad^2].
    variances: tuple[float, float]

    def variance_at(self, point: Array) -> float:
        """Return the variance across the line at a point (2,) near it [px^2]."""
        square = float(np.sum((point - self.middle) ** 2))
        return self.variances[0] + self.variances[1] * square


def tag_corners(image: Array, quadrilaterals: Array) -> Saddles:
    """Refine the corners of tags by lines that are fitted to their edges.

    Args:
        image: Grey values, shape (height, width).
        quadrilaterals: Corners of each tag, clockwise, to a pixel or two, shape (m, 4, 2) [px].

    Returns:
        The corners, tag after tag: 4 m of them; NaN for all four of a tag if an edge is not found from those given.
    """
    pixels = np.full((4 * len(quadrilaterals), 2), np.nan)
    sigma = np.full(4 * len(quadrilaterals), np.nan)
    for k, corners in enumerate(quadrilaterals):
        refined = corners
        for number in range(1, _ROUNDS[1] + 1):
            ends = [_corner(image, refined, j) for j in range(4)]
            if any(corner is None for corner in ends):
                break
            known = [corner for corner in ends if corner is not None]
            last = refined
            refined = np.array([place for place, _ in known])
            pixels[4 * k : 4 * k + 4] = refined
            sigma[4 * k : 4 * k + 4] = [uncertainty for _, uncertainty in known]
            if number >= _ROUNDS[0] and np.abs(refined - last).max() < _STILL:
                break
    return Saddles(pixels, sigma)


def _corner(image: Array, corners: Array, j: int) -> tuple[Array, float] | None:
    """Return where the edges beside corner j of four (4, 2) meet, (2,), and its sigma [px]; None without an edge."""
    here = corners[j]
    before = _line(image, here, corners[j - 1], inside=1.0)
    after = _line(image, here, corners[(j + 1) % 4], inside=-1.0)
    if before is None or after is None:
        return None
    normals = np.stack([before.normal, after.normal])
    if abs(np.linalg.det(normals)) < 0.1:
        return None
    inverse = np.linalg.inv(normals)
    place = inverse @ np.array([before.offset, after.offset])
    variances = np.diag([before.variance_at(place), after.variance_at(place)])
    covariance = inverse @ variances @ inverse.T
    return place, float(np.sqrt(np.trace(covariance) / 2.0 + FLOOR**2))


def _line(image: Array, corner: Array, other: Array, inside: float) -> _Line | None:
    """Fit a line to the half next to ``corner`` (2,) of an edge from there to ``other`` (2,) [px]; None if hardly seen.

    ``inside`` is 1 if the tag is on the left when the image is walked from the corner to the other end, otherwise -1.
    """
    length = float(np.hypot(*(other - corner)))
    direction = (other - corner) / length
    outwards = inside * np.array([-direction[1], direction[0]])
    cell = length / _CELLS
    reach = float(np.clip(0.7 * cell, _REACH[0], max(_REACH[1], _REACH_IN_CELLS * cell)))
    count = int((_TO - _FROM) * length)
    if count < _FEWEST:
        return None
    fractions = np.linspace(_FROM, _TO, count)
    starts = corner + fractions[:, None] * (other - corner)
    shifts = _edge_shifts(image, starts, outwards, reach)
    seen = np.isfinite(shifts)
    if seen.sum() < _FEWEST:
        return None

    # Total least squares.
    places = starts[seen] + shifts[seen, None] * outwards
    middle = places.mean(axis=0)
    _, singular, axes = np.linalg.svd(places - middle, full_matrices=False)
    normal = axes[1] * np.sign(axes[1] @ outwards)
    variance = float(singular[1] ** 2) / max(len(places) - 2, 1)
    variances = (variance / len(places), variance / float(singular[0] ** 2))
    return _Line(normal, float(normal @ middle), middle, variances)


def _edge_shifts(image: Array, starts: Array, outwards: Array, reach: float) -> Array:
    """Return the distances outwards from places (n, 2) to an edge from black to white, (n,) [px]; NaN without one.

    The edge is sought along ``outwards``, a unit vector (2,), up to ``reach`` [px] to either side.
    """
    steps = np.arange(-reach - _STEP, reach + 1.5 * _STEP, _STEP)
    places = starts[:, None, :] + steps[:, None] * outwards
    values = _interpolate(image, places)
    slopes = np.maximum(values[:, 2:] - values[:, :-2], 0.0) / (2.0 * _STEP)
    total = slopes.sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        shift = slopes @ steps[1:-1] / total
    is_edge = np.nan_to_num(total) >= _LEAST_SLOPE * len(steps)
    return np.where(is_edge, shift, np.nan)


def _interpolate(image: Array, places: Array) -> Array:
    """Return grey values at places (n, m, 2) [px], bilinear between pixels, shape (n, m); NaN outside the image."""
    height, width = image.shape
    u, v = places[..., 0], places[..., 1]
    inside = (u >= 0) & (u < width - 1) & (v >= 0) & (v < height - 1)
    column = np.where(inside, np.floor(u), 0).astype(int)
    row = np.where(inside, np.floor(v), 0).astype(int)
    du, dv = u - column, v - row
    upper = (1.0 - du) * image[row, column] + du * image[row, column + 1]
    lower = (1.0 - du) * image[row + 1, column] + du * image[row + 1, column + 1]
    return np.where(inside, (1.0 - dv) * upper + dv * lower, np.nan)
