"""Other patterns in pictures where a board is not seen: markers of another dictionary, a chessboard of another size."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace

import numpy as np

import calib.basics.jobs as jobs
from calib.boards.board import CHESSBOARD, Board
from calib.boards.corners.chessboards import size_of_chessboard
from calib.boards.corners.markers import find_markers
from calib.boards.detection.findings import DICTIONARY, Finding, names, without_board
from calib.boards.detection.image_files import ImageFile, read_image
from calib.boards.detection.other_boards import SIZE
from calib.boards.detection.picture import Picture
from calib.boards.dictionaries import KINDS, kind_of, smallest_dictionary

#: Pictures that are searched.
_MOST_PICTURES = 2

#: Fewest different markers of a dictionary that are no accident.
_FEWEST_MARKERS = 4


def other_pattern(
    board: Board, pictures: Sequence[Picture], executor: Executor | None = None
) -> list[Finding]:
    """Find what is there in place of a board, if half of the pictures or more show nothing of it.

    Args:
        board: The board.
        pictures: The pictures that could be read.
        executor: Where pictures are searched; None: here.

    Returns:
        The finding of another dictionary, or of a chessboard of another size; none if nothing is seen.
    """
    nothing = without_board(board, pictures)
    if not nothing or len(nothing) < len(pictures) / 2:
        return []
    count = min(len(nothing), _MOST_PICTURES)
    spread = np.linspace(0, len(nothing) - 1, count).astype(int)
    tried = [nothing[k].file for k in spread]
    if board.pattern == CHESSBOARD:
        return _other_size(board, nothing, tried, executor)
    return _other_dictionary(board, nothing, tried, executor)


def _other_size(
    board: Board,
    nothing: Sequence[Picture],
    tried: Sequence[ImageFile],
    executor: Executor | None,
) -> list[Finding]:
    """Return the finding of a chessboard of another size in the pictures that are tried."""
    seen = [size for _, size in jobs.run(_size_of_chessboard, None, tried, executor)]
    sizes = Counter(size for size in seen if size is not None)
    if not sizes:
        return []
    larger, smaller = sizes.most_common(1)[0][0]
    described = sorted((board.columns, board.rows), reverse=True)
    if [larger, smaller] == described:
        return []
    better = replace(board, columns=larger, rows=smaller)
    return [Finding(code=SIZE, board=board.name, pictures=names(nothing), better=better)]


def _size_of_chessboard(_: None, file: ImageFile) -> tuple[int, int] | None:
    """Return the size of whatever chessboard is in a picture."""
    return size_of_chessboard(read_image(file))


def _other_dictionary(
    board: Board,
    nothing: Sequence[Picture],
    tried: Sequence[ImageFile],
    executor: Executor | None,
) -> list[Finding]:
    """Return the finding of markers of another dictionary in the pictures that are tried."""
    ids: dict[tuple[str, ...], set[int]] = {}
    for _, of_file in jobs.run(_markers_of_all, None, tried, executor):
        for kind, seen in of_file.items():
            ids[kind] = ids.get(kind, set()) | seen
    ids.pop(kind_of(board.dictionary), None)
    most = max(ids, key=lambda kind: len(ids[kind]), default=())
    if len(ids.get(most, ())) < _FEWEST_MARKERS:
        return []
    dictionary = smallest_dictionary(most, max(ids[most]))
    return [
        Finding(code=DICTIONARY, board=board.name, pictures=names(nothing), dictionary=dictionary)
    ]


def _markers_of_all(_: None, file: ImageFile) -> dict[tuple[str, ...], set[int]]:
    """Return the ids of the markers in a picture by kind of dictionary."""
    image = read_image(file)
    return {kind: set(find_markers(image, kind[-1]).ids.tolist()) for kind in KINDS}
