"""Corners of tags: where the lines of two edges of the black square meet.

A blur rounds a corner and moves what a corner detector finds inwards, but not an edge away from the corners. Each edge
is sampled across, once a pixel of its length; its place is the mean of the slope's positions there, and a line is
fitted to the half next to the corner, which a lens bends little. The scatter about the lines gives the uncertainty.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.basics.arrays import Array
from calib.basics.values import Value
from calib.boards.corners.saddles import FLOOR, Saddles

#: Bits along a side of a tag's inside, of the families in use, and its border: the black is a cell wide.
_CELLS = 10.0

#: Part of an edge next to a corner that is left out: the blur rounds it.
_FROM = 0.08

#: Where the half of an edge next to a corner ends, in lengths of the edge.
_TO = 0.55

#: Shortest and longest reach to either side of an edge [px].
_REACH = (1.5, 3.5)

#: Distance of two samples across an edge [px].
_STEP = 0.5

#: Rounds, each with samples around the lines of the last.
_ROUNDS = 3

#: Fewest places along half an edge that make a line.
_FEWEST = 4

#: Smallest mean slope of an edge [grey values a px].
_LEAST_SLOPE = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class _Line(Value):
    """A line n . p = c."""

    #: Unit normal, shape (2,).
    normal: Array
    #: Its distance from the origin along the normal [px].
    offset: float
    #: Middle of the places, shape (2,) [px].
    middle: Array
    #: Variance at the middle [px^2], and of the direction [rad^2].
    variances: tuple[float, float]

    def variance_at(self, point: Array) -> float:
        """Return the variance across the line at a point near it [px^2]."""
        square = float(np.sum((point - self.middle) ** 2))
        return self.variances[0] + self.variances[1] * square


def tag_corners(image: Array, quadrilaterals: Array) -> Saddles:
    """Refine the corners of tags.

    Args:
        image: Grey values, shape (height, width).
        quadrilaterals: Corners of each tag, clockwise, to a pixel or two, shape (m, 4, 2) [px].

    Returns:
        The corners, tag after tag: 4 m of them.
    """
    pixels = np.full((4 * len(quadrilaterals), 2), np.nan)
    sigma = np.full(4 * len(quadrilaterals), np.nan)
    for k, corners in enumerate(quadrilaterals):
        refined = corners
        for _ in range(_ROUNDS):
            ends = [_corner(image, refined, j) for j in range(4)]
            if any(corner is None for corner in ends):
                break
            known = [corner for corner in ends if corner is not None]
            refined = np.array([place for place, _ in known])
            pixels[4 * k : 4 * k + 4] = refined
            sigma[4 * k : 4 * k + 4] = [uncertainty for _, uncertainty in known]
    return Saddles(pixels, sigma)


def _corner(image: Array, corners: Array, j: int) -> tuple[Array, float] | None:
    """Return where the two edges beside corner j meet, and its standard deviation [px]; None if there is no edge."""
    here = corners[j]
    before = _line(image, here, corners[j - 1], inside=1.0)
    behind = _line(image, here, corners[(j + 1) % 4], inside=-1.0)
    if before is None or behind is None:
        return None
    normals = np.stack([before.normal, behind.normal])
    if abs(np.linalg.det(normals)) < 0.1:
        return None
    inverse = np.linalg.inv(normals)
    place = inverse @ np.array([before.offset, behind.offset])
    variances = np.diag([before.variance_at(place), behind.variance_at(place)])
    covariance = inverse @ variances @ inverse.T
    return place, float(np.sqrt(np.trace(covariance) / 2.0 + FLOOR**2))


def _line(image: Array, corner: Array, other: Array, inside: float) -> _Line | None:
    """Fit a line to the half of an edge next to a corner.

    Args:
        image: Grey values.
        corner: The corner, shape (2,) [px].
        other: The other end of the edge, shape (2,) [px].
        inside: 1 if the tag is to the left of the way from the corner to the other end as the image shows it, else -1.
    """
    length = float(np.hypot(*(other - corner)))
    direction = (other - corner) / length
    outwards = inside * np.array([-direction[1], direction[0]])
    reach = float(np.clip(0.7 * length / _CELLS, *_REACH))
    count = int((_TO - _FROM) * length)
    if count < _FEWEST:
        return None
    fractions = np.linspace(_FROM, _TO, count)
    starts = corner + fractions[:, None] * (other - corner)
    shifts = _edge_places(image, starts, outwards, reach)
    seen = np.isfinite(shifts)
    if seen.sum() < _FEWEST:
        return None
    return _fitted(starts[seen] + shifts[seen, None] * outwards, outwards)


def _edge_places(image: Array, starts: Array, outwards: Array, reach: float) -> Array:
    """Return how far outwards of each start the edge from black to white is, shape (n,) [px]; NaN without one."""
    steps = np.arange(-reach - _STEP, reach + 1.5 * _STEP, _STEP)
    places = starts[:, None, :] + steps[:, None] * outwards
    values = _bilinear(image, places)
    slopes = np.maximum(values[:, 2:] - values[:, :-2], 0.0) / (2.0 * _STEP)
    total = slopes.sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        shift = slopes @ steps[1:-1] / total
    is_edge = np.nan_to_num(total) >= _LEAST_SLOPE * len(steps)
    return np.where(is_edge, shift, np.nan)


def _bilinear(image: Array, places: Array) -> Array:
    """Return interpolated grey values, shape (n, m); NaN outside the image."""
    height, width = image.shape
    u, v = places[..., 0], places[..., 1]
    inside = (u >= 0) & (u < width - 1) & (v >= 0) & (v < height - 1)
    column = np.where(inside, np.floor(u), 0).astype(int)
    row = np.where(inside, np.floor(v), 0).astype(int)
    du, dv = u - column, v - row
    upper = (1.0 - du) * image[row, column] + du * image[row, column + 1]
    lower = (1.0 - du) * image[row + 1, column] + du * image[row + 1, column + 1]
    return np.where(inside, (1.0 - dv) * upper + dv * lower, np.nan)


def _fitted(places: Array, outwards: Array) -> _Line:
    """Fit a line to places by total least squares."""
    middle = places.mean(axis=0)
    centred = places - middle
    _, singular, axes = np.linalg.svd(centred, full_matrices=False)
    normal = axes[1] * np.sign(axes[1] @ outwards)
    variance = float(singular[1] ** 2) / max(len(places) - 2, 1)
    variances = (variance / len(places), variance / float(singular[0] ** 2))
    return _Line(normal, float(normal @ middle), middle, variances)
