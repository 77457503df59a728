"""Other descriptions of a board that its markers fit better: a mistake in the description, by name.

Each marker has its id. If the markers of a picture are not where the description has their ids, correcting one of the
usual mistakes puts most of them right.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from calib.basics.arrays import Array
from calib.boards.board import CHARUCO, Board
from calib.boards.corners.markers import Markers
from calib.boards.corners.placing import place
from calib.boards.corners.planar_map import fit_planar_map
from calib.boards.layout import marker_outlines
from calib.errors import CalibError

#: Columns and rows are swapped.
SWAPPED = "swapped"

#: An even number of rows is laid out as OpenCV did before 4.6, or as it does since.
LEGACY = "legacy"

#: Another number of columns or rows.
SIZE = "size"

#: Markers of another size in the same squares.
RATIO = "ratio"

#: Another id of the first marker.
FIRST_MARKER = "first_marker"

#: Largest number of columns that is tried.
_MOST_COLUMNS = 24

#: Ratios of marker and square that are tried.
_RATIOS = (0.5, 0.6, 0.7, 0.8, 0.9)

#: Number of pictures that are tried, those with the most markers.
_MOST_PICTURES = 6

#: Fewest markers with which a picture is tried.
_FEWEST_MARKERS = 4

#: Smallest share of all markers that agree with the right description.
_LEAST_SHARE = 0.8

#: Least gain over the description as it is, and over a likelier one [share of all markers].
_GAIN = 0.02

#: Fewest markers that determine the ratio of marker and square.
_FEWEST_FOR_RATIO = 6

#: A picture's markers and its width and height.
Seen = tuple[Markers, tuple[int, int]]


def explanation(board: Board, seen: Sequence[Seen]) -> tuple[str, Board] | None:
    """Find the usual mistake in a description whose correction puts the markers right.

    Args:
        board: The board as described.
        seen: Markers of the board's dictionary in pictures where some do not fit it.

    Returns:
        The code of the mistake, and the board as it should be described: the first description with which most markers
        agree. None if there is none.
    """
    used = [(markers, size) for markers, size in seen if len(markers.ids) >= _FEWEST_MARKERS]
    used = sorted(used, key=lambda pair: -len(pair[0].ids))[:_MOST_PICTURES]
    if not used:
        return None
    ids = np.concatenate([markers.ids for markers, _ in used])
    best = None
    most = max(_LEAST_SHARE, _agreeing_share(board, used) + _GAIN)
    for code, other in _alternatives(board, int(ids.min()), int(ids.max())):
        share = _agreeing_share(other, used)
        if (best is None and share >= most) or share > most + _GAIN:
            best, most = (code, other), share
        if share == 1.0:
            break
    return best


def measured_ratio(board: Board, seen: Sequence[Seen]) -> float:
    """Measure the side of the markers in sides of a square, by the distances of their middles; NaN if it is unknown.

    Args:
        board: The board, with the right layout.
        seen: Markers in pictures.
    """
    layout = marker_outlines(board)
    ratios = []
    for markers, image_size in seen:
        inside = markers.of_ids(board.first_marker, board.markers)
        if len(inside.ids) < _FEWEST_FOR_RATIO:
            continue
        placement = place(inside, layout, image_size)
        if placement is None or not placement.is_sound:
            continue
        used = inside.select(placement.agrees)
        if len(used.ids) < _FEWEST_FOR_RATIO:
            continue
        # On a map of their middles, which do not depend on the markers' size, their corners show it.
        middles = layout[used.ids].mean(axis=1)
        pixels = np.array([_middle(corners) for corners in used.corners])
        planar_map = fit_planar_map(middles, pixels, image_size)
        corners = planar_map.unproject(used.corners.reshape(-1, 2)).reshape(-1, 4, 2)
        sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
        ratios.append(float(np.median(sides)) / board.square)
    return float(np.median(ratios)) if ratios else np.nan


def _middle(corners: Array) -> Array:
    """Return where the diagonals of a quadrilateral (4, 2) meet, shape (2,): the middle of a square in perspective."""
    first = corners[2] - corners[0]
    second = corners[3] - corners[1]
    along, _ = np.linalg.solve(np.stack([first, -second], axis=1), corners[1] - corners[0])
    return np.asarray(corners[0] + along * first)


def _agreeing_share(board: Board, seen: Sequence[Seen]) -> float:
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
    """Yield descriptions with one of the usual mistakes corrected, the likely ones first; ids seen: first to last."""
    has_layouts = board.pattern == CHARUCO
    if has_layouts and board.rows % 2 == 0:
        yield LEGACY, replace(board, legacy=not board.legacy)
    if board.rows != board.columns:
        swapped = replace(board, columns=board.rows, rows=board.columns)
        yield SWAPPED, swapped
        if has_layouts and swapped.rows % 2 == 0:
            yield SWAPPED, replace(swapped, legacy=not board.legacy)
    for ratio in _RATIOS:
        yield RATIO, replace(board, marker=ratio * board.square)
    if first != board.first_marker:
        with suppress(CalibError):
            yield FIRST_MARKER, replace(board, first_marker=first)

    # Numbers of columns, the described one first, each with the fewest rows that contain every id seen, and one more.
    columns = sorted(range(2, _MOST_COLUMNS + 1), key=lambda number: abs(number - board.columns))
    needed = last - board.first_marker + 1
    for number in columns:
        per_row = number / 2 if has_layouts else number
        fewest = max(2, int(np.ceil(needed / per_row)))
        for rows in (fewest, fewest + 1):
            # The layouts differ for even numbers of rows only.
            legacies = {board.legacy, rows % 2 == 0 and not board.legacy}
            for legacy in sorted(legacies):
                with suppress(CalibError):
                    yield SIZE, replace(board, columns=number, rows=rows, legacy=legacy)
