"""Markers in a picture, of whatever dictionary.

The first markers of a large dictionary are those of the small one of the same kind: DICT_5X5_1000 begins with
DICT_5X5_50. So a picture is searched once for each kind, with its largest dictionary.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.basics.arrays import Array, Integers
from calib.basics.values import Value
from calib.boards.dictionaries import DICTIONARIES
from calib.boards.opencv import opencv

#: The dictionaries of each kind, the smallest first.
KINDS: tuple[tuple[str, ...], ...] = (
    ("DICT_4X4_50", "DICT_4X4_100", "DICT_4X4_250", "DICT_4X4_1000"),
    ("DICT_5X5_50", "DICT_5X5_100", "DICT_5X5_250", "DICT_5X5_1000"),
    ("DICT_6X6_50", "DICT_6X6_100", "DICT_6X6_250", "DICT_6X6_1000"),
    ("DICT_7X7_50", "DICT_7X7_100", "DICT_7X7_250", "DICT_7X7_1000"),
    ("DICT_ARUCO_ORIGINAL",),
    ("DICT_APRILTAG_36h11",),
    ("DICT_APRILTAG_36h10",),
    ("DICT_APRILTAG_25h9",),
    ("DICT_APRILTAG_16h5",),
    ("DICT_ARUCO_MIP_36h12",),
)

#: Longest side of the picture of a quick look [px].
_QUICK = 2000

#: Half of the window in which a corner is refined: a larger one reaches the next square's corner [px].
_REFINED = 2

#: Markers of each kind that a quick look knows.
_LOW_IDS = 100


@dataclass(frozen=True, slots=True, eq=False)
class Markers(Value):
    """Markers of one kind in a picture."""

    #: Dictionaries of the kind, the smallest first.
    kind: tuple[str, ...]
    #: Id of each marker, shape (n,).
    ids: Integers
    #: Corners of each marker in its own order, clockwise from its top left, shape (n, 4, 2) [px].
    corners: Array

    @property
    def centres(self) -> Array:
        """Centres: where the diagonals meet, which perspective keeps, shape (n, 2) [px]."""
        a, b, c, d = np.swapaxes(self.corners, 0, 1)
        along = c - a
        across = d - b
        offset = b - a
        area = along[:, 0] * across[:, 1] - along[:, 1] * across[:, 0]
        share = (offset[:, 0] * across[:, 1] - offset[:, 1] * across[:, 0]) / area
        return np.asarray(a + share[:, None] * along)

    @property
    def side(self) -> float:
        """Median length of the sides [px]."""
        edges = np.roll(self.corners, -1, axis=1) - self.corners
        return float(np.median(np.linalg.norm(edges, axis=-1)))


def smallest_dictionary(kind: tuple[str, ...], largest_id: int) -> str:
    """Return the smallest dictionary of a kind that has a marker with this id.

    Args:
        kind: The dictionaries, the smallest first.
        largest_id: The id; if none has it, the largest dictionary is returned.
    """
    for name in kind:
        if largest_id < DICTIONARIES[name].markers:
            return name
    return kind[-1]


def find_markers(image: Any) -> Iterator[Markers]:  # noqa: ANN401  an image of OpenCV
    """Find the markers of the kinds that a quick look sees some of, those with the most first.

    The quick look knows the first hundred markers of each kind, for the time of a search grows with their number.

    Args:
        image: Grey picture, shape (height, width), of bytes.

    Yields:
        The markers of each kind.
    """
    counts = _quick_counts(image)
    for kind in sorted(counts, key=lambda kind: -counts[kind]):
        markers = _find(image, kind, None)
        if markers is not None:
            yield markers


def find_high_ids(image: Any) -> Iterator[Markers]:  # noqa: ANN401
    """Find the markers of the kinds that `find_markers` leaves out; this takes seconds.

    Args:
        image: Grey picture, shape (height, width), of bytes.

    Yields:
        The markers of each kind.
    """
    counts = _quick_counts(image)
    for kind in KINDS:
        markers = None if kind in counts else _find(image, kind, None)
        if markers is not None:
            yield markers


def _quick_counts(image: Any) -> dict[tuple[str, ...], int]:  # noqa: ANN401
    """Count the markers with low ids of each kind, in a copy of the picture that is not too large."""
    scale = _QUICK / max(image.shape)
    if scale < 1.0:
        cv2 = opencv()
        image = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    counts = {}
    for kind in KINDS:
        markers = _find(image, kind, _LOW_IDS)
        if markers is not None:
            counts[kind] = len(markers.ids)
    return counts


def _find(image: Any, kind: tuple[str, ...], count: int | None) -> Markers | None:  # noqa: ANN401
    """Find the markers of a kind.

    Args:
        image: Grey picture.
        kind: The dictionaries of the kind.
        count: So many markers of it are known, from id 0; None: all.

    Returns:
        The markers; None if there are none.
    """
    aruco = opencv().aruco
    parameters = aruco.DetectorParameters()
    parameters.cornerRefinementMethod = aruco.CORNER_REFINE_SUBPIX
    parameters.cornerRefinementWinSize = _REFINED
    full = aruco.getPredefinedDictionary(getattr(aruco, kind[-1]))
    codes = full.bytesList[:count]
    dictionary = aruco.Dictionary(codes, full.markerSize, full.maxCorrectionBits)
    corners, ids, _ = aruco.ArucoDetector(dictionary, parameters).detectMarkers(image)
    if ids is None or len(ids) == 0:
        return None
    places = np.reshape(np.asarray(corners, dtype=float), (-1, 4, 2))
    return Markers(kind, np.asarray(ids, dtype=int).ravel(), places)
