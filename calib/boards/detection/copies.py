"""The copies of a picture in which boards are sought: as it is, and if too little is found smaller, evened, negative.

As it is, a picture of more than 8 bits fills the range of grey values. An evened copy has everywhere the same mean m
and standard deviation s of grey values g, about each pixel in a wide window,

    e = 128 + 50 (g - m) / s

so that a dark corner is as bright as the rest. Both fields are so smooth that edges stay where they are: the slope of
an edge is multiplied by a factor that hardly changes across it. A negative shows a print that is white on black. The
pixels of a smaller copy are means of those of the picture, as if the sensor had larger ones: what is soft over many
pixels is sharp over few. Small markers are also read in an enlarged copy; their corners are measured in the picture.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calib.basics.arrays import Array
from calib.basics.values import Value
from calib.boards.opencv import opencv

#: Codes of copies; "" is the picture as it is.
EVENED = "evened"
NEGATIVE = "negative"
SMALLER = "smaller"

#: Shares of a deep picture's pixels that are darker than black, and brighter than white: hot pixels and lamps.
_BEYOND = 1e-3

#: Width of the window in which a picture is evened, as a share of its longer side: wider than a marker or some squares.
_WINDOW = 1.0 / 16.0

#: Mean of an evened copy, and its standard deviation [grey values].
_MEAN = 128.0
_DEVIATION = 50.0

#: Smallest standard deviation that is raised to this: below it there is noise and rounding alone [grey values].
_LEAST_DEVIATION = 2.0

#: Factors by which copies are smaller, ...
_FACTORS = (4, 3, 2)

#: ... while they have so many pixels along their longer side: what is blurred in a picture of this usual size is not
#: soft because its pixels are small.
_USUAL_SIDE = 960

#: Factor by which pictures are enlarged in which markers are small, and the longest side of a picture that is [px]: in
#: a larger one a marker has many pixels, or the board is far away.
_ENLARGED = 2
_LARGEST_ENLARGED = 2600


@dataclass(frozen=True, slots=True, eq=False)
class Copy(Value):
    """A copy of a picture, 8 bits for OpenCV and unrounded to measure in."""

    #: One of the codes of this module; "" for the picture as it is.
    code: str
    #: Grey values, 0 to 255, shape (h, w); a deep picture has values between whole ones.
    grey: Array
    #: The same, 8 bits, uint8.
    image: Any
    #: The copy's pixels are this many of the picture's wide.
    factor: int = 1
    #: Factor by which it is enlarged to read markers.
    enlarged: int = 1

    @classmethod
    def of(cls, code: str, grey: Array, factor: int = 1, enlarged: int = 1) -> Copy:
        """Make a copy of its code, its grey values, shape (h, w), and its factors."""
        image = np.clip(np.rint(grey), 0, 255).astype(np.uint8)
        return cls(code, np.asarray(grey, dtype=np.float64), image, factor, enlarged)

    def in_picture(self, pixels: Array) -> Array:
        """Return the pixels of the picture, shape (..., 2), that are at ``pixels`` (..., 2) of the copy."""
        return np.asarray((pixels + 0.5) * self.factor - 0.5)


def as_it_is(picture: Any) -> Copy:  # noqa: ANN401  8 or 16 bits
    """Return a picture (h, w) as it is; one of more than 8 bits stretched to all grey values."""
    if picture.dtype == np.uint8:
        return Copy("", np.asarray(picture, dtype=np.float64), picture)
    low, high = np.quantile(picture, [_BEYOND, 1.0 - _BEYOND])
    grey = (picture.astype(np.float64) - low) * (255.0 / max(high - low, 1.0))
    return Copy.of("", grey)


def further_copies(copy: Copy, *, is_seen: bool, has_markers: bool) -> Iterator[Copy]:
    """Yield the copies in which a board is sought that the picture as it is shows in part, or not at all.

    Args:
        copy: The picture as it is.
        is_seen: True if it shows a board, so that only smaller copies may show more of it.
        has_markers: True if a board has markers, which may be too small, or white on black.

    Yields:
        The copies, the likely ones first; each is made when it is asked for.
    """
    factors = [factor for factor in _FACTORS if max(copy.grey.shape) / factor >= _USUAL_SIDE]
    for factor in factors:
        yield Copy.of(SMALLER, _smaller(copy.grey, factor), factor)
    if is_seen:
        return
    evened = _evened(copy.grey)
    yield Copy.of(EVENED, evened)
    if has_markers and max(copy.grey.shape) <= _LARGEST_ENLARGED:
        yield replace(copy, enlarged=_ENLARGED)
        yield Copy.of(EVENED, evened, enlarged=_ENLARGED)
    if has_markers:
        yield Copy.of(NEGATIVE, 255.0 - copy.grey)
        yield Copy.of(NEGATIVE, 255.0 - evened)
    for factor in factors:
        yield Copy.of(SMALLER, _smaller(evened, factor), factor)


def _evened(grey: Array) -> Array:
    """Return grey values (h, w) with the same mean and standard deviation everywhere."""
    cv2 = opencv()
    width = _WINDOW * max(grey.shape)
    # The window is wide: means are computed in a small copy.
    step = max(1, int(width / 8.0))
    size = (max(1, grey.shape[1] // step), max(1, grey.shape[0] // step))

    def mean(values: Array) -> Array:
        """Return the mean of values (h, w) about each pixel, shape (h, w)."""
        small = cv2.resize(values, size, interpolation=cv2.INTER_AREA)
        small = cv2.GaussianBlur(small, (0, 0), width / step / 2.0)
        return np.asarray(cv2.resize(small, grey.shape[::-1], interpolation=cv2.INTER_CUBIC))

    m = mean(grey)
    s = np.sqrt(np.maximum(mean(grey**2) - m**2, _LEAST_DEVIATION**2))
    return np.asarray(_MEAN + _DEVIATION * (grey - m) / s)


def _smaller(grey: Array, factor: int) -> Array:
    """Return means of blocks of ``factor`` by ``factor`` of grey values (h, w); what is left over at the end is cut."""
    height, width = (length // factor for length in grey.shape)
    blocks = grey[: height * factor, : width * factor].reshape(height, factor, width, factor)
    return np.asarray(blocks.mean(axis=(1, 3)))
