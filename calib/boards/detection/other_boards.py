"""Other descriptions of a board that its markers fit better: a mistake in the description, by name.

Each marker tells its id. Where the markers of a picture are not where the description has the ids, one of the usual
mistakes puts most of them right.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from calib.basics.arrays import Array
from calib.basics.values import Value
from calib.boards.board import CHARUCO, Board, marker_outlines
from calib.boards.corners.markers import Markers
from calib.boards.corners.placing import place
from calib.boards.corners.planar_map import fit_planar_map
from calib.errors import CalibError

#: Columns and rows are swapped.
SWAPPED = "swapped"

#: An even number of rows, laid out as OpenCV did before 4.6, or since.
LEGACY = "legacy"

#: Another number of columns or rows.
SIZE = "size"

#: Markers of another size in the same squares.
RATIO = "ratio"

#: Another id of the first marker.
FIRST_MARKER = "first_marker"

#: Most columns that are tried.
_MOST_COLUMNS = 24

#: Ratios of marker and square that are tried.
_RATIOS = (0.5, 0.6, 0.7, 0.8, 0.9)

#: Pictures that are tried, those with the most markers.
_MOST_PICTURES = 6

#: Fewest markers of a picture that tell anything.
_FEWEST_MARKERS = 4

#: Least share of all markers that agree with the right description.
_LEAST_SHARE = 0.8

#: How much larger than with the description as it is [share of all markers].
_GAIN = 0.02

#: Fewest markers that tell the ratio of marker and square.
_FEWEST_FOR_RATIO = 6

#: A picture's markers and its width and height.
Seen = tuple[Markers, tuple[int, int]]


@dataclass(frozen=True, slots=True)
class Explanation(Value):
    """A description that fits, and what is different in it."""

    #: One of the codes above.
    code: str
    #: The board so described; of `SIZE` with the fewest rows that have all markers seen.
    board: Board


def explanation(board: Board, seen: Sequence[Seen]) -> Explanation | None:
    """Find the usual mistake in a description that puts the markers right.

    Args:
        board: The board as described.
        seen: Markers of the board's dictionary in pictures where some do not fit it.

    Returns:
        The mistake without which most markers agree, the first of several; None if there is none.
    """
    telling = [(markers, size) for markers, size in seen if len(markers.ids) >= _FEWEST_MARKERS]
    telling = sorted(telling, key=lambda pair: -len(pair[0].ids))[:_MOST_PICTURES]
    if not telling:
        return None
    ids = np.concatenate([markers.ids for markers, _ in telling])
    best = None
    most = max(_LEAST_SHARE, _share(board, telling) + _GAIN)
    for code, other in _alternatives(board, int(ids.min()), int(ids.max())):
        share = _share(other, telling)
        if (best is None and share >= most) or share > most + _GAIN:
            best, most = Explanation(code, other), share
        if share == 1.0:
            break
    return best


def measured_ratio(board: Board, seen: Sequence[Seen]) -> float:
    """Measure the side of the markers in sides of a square, by the distances of their middles; NaN if it is unknown.

    Args:
        board: The board, with the right layout.
        seen: Markers in pictures.
    """
    ratios = []
    for markers, image_size in seen:
        inside = markers.of_ids(board.first_marker, board.markers)
        if len(inside.ids) < _FEWEST_FOR_RATIO:
            continue
        placement = place(inside, marker_outlines(board), image_size)
        if placement is None or not placement.is_sound:
            continue
        used = placement.agrees
        if used.sum() >= _FEWEST_FOR_RATIO:
            used_markers = Markers(inside.ids[used], inside.corners[used])
            ratios.append(_ratio(board, used_markers, image_size))
    return float(np.median(ratios)) if ratios else np.nan


def _ratio(board: Board, markers: Markers, image_size: tuple[int, int]) -> float:
    """Return the mean side of markers on a map of their middles, in sides of a square."""
    middles = marker_outlines(board)[markers.ids].mean(axis=1)
    # The diagonals of a square seen in perspective meet in its middle.
    pixels = np.array([_crossing(corners) for corners in markers.corners])
    planar_map = fit_planar_map(middles, pixels, image_size)
    corners = planar_map.unproject(markers.corners.reshape(-1, 2)).reshape(-1, 4, 2)
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    return float(np.median(sides)) / board.square


def _crossing(corners: Array) -> Array:
    """Return where the diagonals of a quadrilateral meet, shape (2,)."""
    first = corners[2] - corners[0]
    second = corners[3] - corners[1]
    along, _ = np.linalg.solve(np.stack([first, -second], axis=1), corners[1] - corners[0])
    return np.asarray(corners[0] + along * first)


def _share(board: Board, seen: Sequence[Seen]) -> float:
    """Return the share of all markers that agree with a description."""
    layout = marker_outlines(board)
    agreeing = 0
    total = 0
    for markers, image_size in seen:
        total += len(markers.ids)
        inside = markers.of_ids(board.first_marker, board.markers)
        placement = place(inside, layout, image_size)
        agreeing += 0 if placement is None else int(placement.agrees.sum())
    return agreeing / total


def _alternatives(board: Board, first: int, last: int) -> Iterator[tuple[str, Board]]:
    """Yield descriptions with one of the usual mistakes put right, the likely ones first.

    Args:
        board: The board as described.
        first: The smallest id that is seen.
        last: The largest.
    """
    even = board.pattern == CHARUCO
    if even and board.rows % 2 == 0:
        yield LEGACY, replace(board, legacy=not board.legacy)
    if board.rows != board.columns:
        swapped = replace(board, columns=board.rows, rows=board.columns)
        yield SWAPPED, swapped
        if even and swapped.rows % 2 == 0:
            yield SWAPPED, replace(swapped, legacy=not board.legacy)
    for ratio in _RATIOS:
        yield RATIO, replace(board, marker=ratio * board.square)
    if first != board.first_marker:
        with suppress(CalibError):
            yield FIRST_MARKER, replace(board, first_marker=first)
    yield from _other_sizes(board, last)


def _other_sizes(board: Board, last: int) -> Iterator[tuple[str, Board]]:
    """Yield boards of other columns, the nearest first, with just enough rows to have all markers seen."""
    columns = sorted(range(2, _MOST_COLUMNS + 1), key=lambda number: abs(number - board.columns))
    needed = last - board.first_marker + 1
    for number in columns:
        per_row = number / 2 if board.pattern == CHARUCO else number
        fewest = max(2, int(np.ceil(needed / per_row)))
        for rows in (fewest, fewest + 1):
            # Even and odd numbers of rows are laid out alike, but for the older layout.
            legacies = {board.legacy, rows % 2 == 0 and not board.legacy}
            for legacy in sorted(legacies):
                with suppress(CalibError):
                    yield SIZE, replace(board, columns=number, rows=rows, legacy=legacy)
