"""Findings: mistakes in the description of a board, or in the pictures; as codes and numbers, without sentences."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np

import calib.basics.jobs as jobs
from calib.basics.values import Value
from calib.boards.board import CHESSBOARD, Board
from calib.boards.corners.chessboards import is_ambiguous, size_of_chessboard
from calib.boards.corners.markers import find_markers
from calib.boards.detection.board_search import (
    FEW_CORNERS,
    LAYOUT,
    MIRRORED,
    NO_BOARD,
    TWO_BOARDS,
    BoardView,
)
from calib.boards.detection.image_files import ImageFile, read_image
from calib.boards.detection.other_boards import (
    FIRST_MARKER,
    LEGACY,
    RATIO,
    SIZE,
    SWAPPED,
    Seen,
    explanation,
    measured_ratio,
)
from calib.boards.detection.picture import OTHER_SIZE, Picture
from calib.boards.dictionaries import KINDS, kind_of, smallest_dictionary

#: The markers are of another dictionary.
DICTIONARY = "dictionary"

#: Markers are not where the description has them, and none of the usual mistakes explains it.
UNEXPLAINED = "unexplained"

#: A chessboard that looks the same after half a turn.
AMBIGUOUS = "ambiguous"

#: There are markers below the last row of the description.
MORE_MARKERS = "more_markers"

#: No picture shows a marker of the last row of the description.
UNSEEN_ROW = "unseen_row"

#: Two pictures are the same to the last bit.
SAME_PICTURE = "same_picture"

#: Findings that the description is wrong, so that no corner of the board can be trusted.
WRONG_DESCRIPTION = (SWAPPED, LEGACY, SIZE, RATIO, FIRST_MARKER, DICTIONARY, UNEXPLAINED)

#: Largest relative error of the markers' size; with a larger one it is another print.
_RATIO_TOLERANCE = 0.05

#: Fewest pictures of a board from which it is concluded that something is never seen.
_FEWEST_PICTURES = 3

#: Fewest markers with further ids in a picture for a board with more rows than described.
_FEWEST_MORE = 2

#: Number of pictures in which another pattern is sought.
_MOST_SEARCHED = 2

#: Fewest different markers of another dictionary that are not an accident.
_FEWEST_MARKERS = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding(Value):
    """Something to correct, or to know."""

    #: One of the codes of this module, of `board_search` or of `other_boards` beside it.
    code: str
    #: The board's name; "" if it is not about one.
    board: str = ""
    #: Names of the pictures that show it.
    pictures: tuple[str, ...] = ()
    #: The board as it should be described; None if that is not known.
    better: Board | None = None
    #: For `RATIO`: the side of a marker as measured, in sides of a square.
    value: float = np.nan
    #: Name of the dictionary that the markers are of.
    dictionary: str = ""


def picture_findings(pictures: Sequence[Picture]) -> Iterator[Finding]:
    """Yield what is wrong with pictures among each other: other sizes, and the same picture twice."""
    others = [picture for picture in pictures if picture.reason == OTHER_SIZE]
    if others:
        yield Finding(code=OTHER_SIZE, pictures=_names(others))
    by_hash: dict[tuple[str, str], list[Picture]] = defaultdict(list)
    for picture in pictures:
        if picture.sha256:
            by_hash[picture.file.camera, picture.sha256].append(picture)
    for same in by_hash.values():
        if len(same) > 1:
            yield Finding(code=SAME_PICTURE, pictures=_names(same))


def usual_sizes(pictures: Sequence[Picture]) -> dict[str, tuple[int, int]]:
    """Return the size [px] that most pictures of each camera have, by the name of the camera."""
    counts: dict[str, Counter[tuple[int, int]]] = defaultdict(Counter)
    for picture in pictures:
        if picture.size != (0, 0):
            counts[picture.file.camera][picture.size] += 1
    return {camera: count.most_common(1)[0][0] for camera, count in counts.items()}


def board_findings(board: Board, pictures: Sequence[Picture]) -> Iterator[Finding]:
    """Yield what pictures say against the description of a board.

    Args:
        board: The board.
        pictures: The pictures that could be read, with the markers of the board's dictionary.
    """
    by_reason: dict[str, list[Picture]] = defaultdict(list)
    for picture in pictures:
        by_reason[_view(picture, board).reason].append(picture)
    if board.pattern == CHESSBOARD:
        if is_ambiguous(board):
            yield Finding(code=AMBIGUOUS, board=board.name)
        return
    for code in (MIRRORED, TWO_BOARDS):
        if by_reason[code]:
            yield Finding(code=code, board=board.name, pictures=_names(by_reason[code]))
    yield from _layout_findings(board, pictures)
    placed = [picture for picture in pictures if _view(picture, board).visible]
    yield from _row_findings(board, placed)
    measured = [*placed, *by_reason[FEW_CORNERS]]
    ratio = measured_ratio(board, _seen(board, measured))
    if np.isfinite(ratio) and not _is_as_described(board, ratio):
        yield Finding(code=RATIO, board=board.name, pictures=_names(measured), value=ratio)


def _layout_findings(board: Board, pictures: Sequence[Picture]) -> Iterator[Finding]:
    """Yield why markers are not where the description has them; an id or two that were misread are not a reason."""
    wrong = [picture for picture in pictures if _view(picture, board).reason == LAYOUT]
    doubtful = [picture for picture in pictures if _view(picture, board).misread]
    if not wrong and not doubtful:
        return
    concerned = [*wrong, *doubtful]
    code, better = explanation(board, _seen(board, concerned)) or (UNEXPLAINED, board)
    value = np.nan
    if code == RATIO:
        value = measured_ratio(better, _seen(board, concerned))
        if np.isnan(value) or _is_as_described(board, value):
            code = UNEXPLAINED
    if code != UNEXPLAINED:
        names = _names(concerned)
        yield Finding(code=code, board=board.name, pictures=names, better=better, value=value)
    elif wrong:
        yield Finding(code=UNEXPLAINED, board=board.name, pictures=_names(wrong))


def _row_findings(board: Board, placed: Sequence[Picture]) -> Iterator[Finding]:
    """Yield whether pictures of a board show more rows than described, or fewer."""
    last = board.first_marker + board.markers
    larger = []
    seen_ids: set[int] = set()
    for picture in placed:
        ids = picture.markers[board.dictionary].ids
        seen_ids |= set(ids.tolist())
        further = (ids >= last) & (ids < last + board.columns)
        if further.sum() >= _FEWEST_MORE:
            larger.append(picture)
    if len(larger) > len(placed) / 2:
        yield Finding(code=MORE_MARKERS, board=board.name, pictures=_names(larger))
    per_row = max(1, board.markers // board.rows)
    last_row = set(range(last - per_row, last))
    if len(placed) >= _FEWEST_PICTURES and not seen_ids & last_row:
        yield Finding(code=UNSEEN_ROW, board=board.name)


def other_pattern(
    board: Board, pictures: Sequence[Picture], executor: Executor | None = None
) -> list[Finding]:
    """Find what pictures show instead of a board, if half of them or more show nothing of it.

    Args:
        board: The board.
        pictures: The pictures that could be read.
        executor: Where pictures are searched; None: here.

    Returns:
        The finding of another dictionary, or of a chessboard of another size; none if neither is seen.
    """
    # A chessboard with more columns or rows is another one.
    reasons = (NO_BOARD, LAYOUT) if board.pattern == CHESSBOARD else (NO_BOARD,)
    without = [picture for picture in pictures if _view(picture, board).reason in reasons]
    if not without or len(without) < len(pictures) / 2:
        return []
    count = min(len(without), _MOST_SEARCHED)
    spread = np.linspace(0, len(without) - 1, count).astype(int)
    files = [without[k].file for k in spread]

    if board.pattern == CHESSBOARD:
        found = [size for _, size in jobs.run(_chessboard_in, None, files, executor)]
        sizes = Counter(size for size in found if size is not None)
        described = (max(board.columns, board.rows), min(board.columns, board.rows))
        if not sizes or sizes.most_common(1)[0][0] == described:
            return []
        larger, smaller = sizes.most_common(1)[0][0]
        better = replace(board, columns=larger, rows=smaller)
        return [Finding(code=SIZE, board=board.name, pictures=_names(without), better=better)]

    ids: dict[tuple[str, ...], set[int]] = defaultdict(set)
    for _, of_file in jobs.run(_ids_in, None, files, executor):
        for kind, seen in of_file.items():
            ids[kind] |= seen
    ids.pop(kind_of(board.dictionary), None)
    most = max(ids, key=lambda kind: len(ids[kind]), default=())
    if len(ids.get(most, ())) < _FEWEST_MARKERS:
        return []
    dictionary = smallest_dictionary(most, max(ids[most]))
    return [
        Finding(code=DICTIONARY, board=board.name, pictures=_names(without), dictionary=dictionary)
    ]


def _chessboard_in(_: None, file: ImageFile) -> tuple[int, int] | None:
    """Return the size of whatever chessboard a picture shows, the larger number first."""
    return size_of_chessboard(read_image(file))


def _ids_in(_: None, file: ImageFile) -> dict[tuple[str, ...], set[int]]:
    """Return the ids of the markers in a picture by kind of dictionary."""
    image = read_image(file)
    return {kind: set(find_markers(image, kind[-1]).ids.tolist()) for kind in KINDS}


def is_wrong_description(finding: Finding, pictures: Sequence[Picture], board: Board) -> bool:
    """Return whether a finding discards a board's corners in all pictures: no fewer speak for it than against it.

    Args:
        finding: The finding.
        pictures: The pictures that could be read.
        board: The board.
    """
    if finding.code not in WRONG_DESCRIPTION or finding.board != board.name:
        return False
    if not finding.pictures:
        return False
    sound = [picture for picture in pictures if _view(picture, board).is_used]
    concerned = set(finding.pictures)
    against = [picture for picture in sound if picture.file.name not in concerned]
    # Where the corners are does not depend on the size of the markers.
    return len(concerned) >= len(against) and finding.code != RATIO


def _names(pictures: Sequence[Picture]) -> tuple[str, ...]:
    """Return the names of pictures."""
    return tuple(picture.file.name for picture in pictures)


def _view(picture: Picture, board: Board) -> BoardView:
    """Return what a picture shows of a board."""
    return next(view for view in picture.views if view.board == board.name)


def _seen(board: Board, pictures: Sequence[Picture]) -> list[Seen]:
    """Return the markers of a board's dictionary in pictures, with the sizes of the pictures."""
    return [(picture.markers[board.dictionary], picture.size) for picture in pictures]


def _is_as_described(board: Board, ratio: float) -> bool:
    """Return whether markers of ``ratio`` sides of a square have the described size, as well as it is measured."""
    return bool(abs(ratio * board.square / board.marker - 1.0) <= _RATIO_TOLERANCE)
