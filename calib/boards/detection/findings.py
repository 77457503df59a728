"""What pictures say against the description of a board, or against themselves; codes and numbers, no sentences."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from calib.basics.values import Value
from calib.boards.board import CHESSBOARD, Board
from calib.boards.corners.chessboards import is_ambiguous
from calib.boards.detection.board_search import (
    FEW_CORNERS,
    LAYOUT,
    MIRRORED,
    NO_BOARD,
    TWO_BOARDS,
    BoardView,
)
from calib.boards.detection.other_boards import (
    FIRST_MARKER,
    LEGACY,
    RATIO,
    SIZE,
    SWAPPED,
    Explanation,
    Seen,
    explanation,
    measured_ratio,
)
from calib.boards.detection.picture import OTHER_SIZE, Picture

#: The markers are of another dictionary.
DICTIONARY = "dictionary"

#: Markers are not where the description has them, and no usual mistake explains it.
UNEXPLAINED = "unexplained"

#: A chessboard that looks the same after half a turn.
AMBIGUOUS = "ambiguous"

#: There are markers beside the last row of the description.
MORE_MARKERS = "more_markers"

#: The last row of the description is never seen.
UNSEEN_ROW = "unseen_row"

#: Two pictures are the same to the last bit.
SAME_PICTURE = "same_picture"

#: The findings of a wrong description, after which no corner of the board can be trusted.
WRONG_DESCRIPTION = (SWAPPED, LEGACY, SIZE, RATIO, FIRST_MARKER, DICTIONARY, UNEXPLAINED)

#: Markers that are larger or smaller than described by more than this are another print [relative].
_RATIO_TOLERANCE = 0.05

#: Fewest pictures, with a board in each, that show that something is never seen.
_FEWEST_PICTURES = 3

#: Markers of further ids in a picture beside the board that make it larger.
_FEWEST_MORE = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding(Value):
    """Something to mend, or to know."""

    #: One of the codes of this module, of `board_search` or of `other_boards` beside it.
    code: str
    #: The board's name; "" where it is not about one.
    board: str = ""
    #: Names of the pictures that show it.
    pictures: tuple[str, ...] = ()
    #: The board as it should be described; None where that is not known.
    better: Board | None = None
    #: What was measured: of `RATIO` the marker's side in sides of the square.
    value: float = np.nan
    #: Name of the dictionary that the markers are of.
    dictionary: str = ""


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
            yield Finding(code=code, board=board.name, pictures=names(by_reason[code]))
    yield from _of_layout(board, pictures)
    placed = [picture for picture in pictures if _view(picture, board).visible]
    yield from _of_size(board, placed)
    yield from _of_ratio(board, [*placed, *by_reason[FEW_CORNERS]])


def is_wrong_description(finding: Finding, pictures: Sequence[Picture], board: Board) -> bool:
    """Test whether a finding takes a board's corners out of all pictures: no fewer speak for it than against it.

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
    return len(concerned) >= len(against) and finding.code != RATIO


def picture_findings(pictures: Sequence[Picture]) -> Iterator[Finding]:
    """Yield what pictures say of each other: other sizes, and the same picture twice."""
    others = [picture for picture in pictures if picture.reason == OTHER_SIZE]
    if others:
        yield Finding(code=OTHER_SIZE, pictures=names(others))
    by_hash: dict[tuple[str, str], list[Picture]] = defaultdict(list)
    for picture in pictures:
        if picture.sha256:
            by_hash[picture.file.camera, picture.sha256].append(picture)
    for same in by_hash.values():
        if len(same) > 1:
            yield Finding(code=SAME_PICTURE, pictures=names(same))


def usual_sizes(pictures: Sequence[Picture]) -> dict[str, tuple[int, int]]:
    """Return the size of most pictures by the name of the camera."""
    counts: dict[str, Counter[tuple[int, int]]] = defaultdict(Counter)
    for picture in pictures:
        if picture.size != (0, 0):
            counts[picture.file.camera][picture.size] += 1
    return {camera: count.most_common(1)[0][0] for camera, count in counts.items()}


def names(pictures: Sequence[Picture]) -> tuple[str, ...]:
    """Return the names of pictures."""
    return tuple(picture.file.name for picture in pictures)


def without_board(board: Board, pictures: Sequence[Picture]) -> list[Picture]:
    """Return the pictures that show nothing of a board; a larger chessboard is another one.

    Args:
        board: The board.
        pictures: The pictures that could be read.
    """
    reasons = (NO_BOARD, LAYOUT) if board.pattern == CHESSBOARD else (NO_BOARD,)
    return [picture for picture in pictures if _view(picture, board).reason in reasons]


def _view(picture: Picture, board: Board) -> BoardView:
    """Return what a picture shows of a board."""
    return next(view for view in picture.views if view.board == board.name)


def _seen(board: Board, pictures: Sequence[Picture]) -> list[Seen]:
    """Return the markers of a board's dictionary in pictures, with their sizes."""
    return [(picture.markers[board.dictionary], picture.size) for picture in pictures]


def _of_layout(board: Board, pictures: Sequence[Picture]) -> Iterator[Finding]:
    """Yield why markers are not where the description has them; one or two that were misread are no reason."""
    wrong = [picture for picture in pictures if _view(picture, board).reason == LAYOUT]
    doubtful = [picture for picture in pictures if _view(picture, board).misread]
    if not wrong and not doubtful:
        return
    concerned = [*wrong, *doubtful]
    better: Explanation | None = explanation(board, _seen(board, concerned))
    value = np.nan
    if better is not None and better.code == RATIO:
        value = measured_ratio(better.board, _seen(board, concerned))
        if np.isnan(value) or _is_as_described(board, value):
            better = None
    if better is None and wrong:
        yield Finding(code=UNEXPLAINED, board=board.name, pictures=names(wrong))
    if better is None:
        return
    yield Finding(
        code=better.code,
        board=board.name,
        pictures=names(concerned),
        better=better.board,
        value=value,
    )


def _of_size(board: Board, placed: Sequence[Picture]) -> Iterator[Finding]:
    """Yield whether the board has more rows than described, or fewer."""
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
        yield Finding(code=MORE_MARKERS, board=board.name, pictures=names(larger))
    per_row = max(1, board.markers // board.rows)
    last_row = set(range(last - per_row, last))
    if len(placed) >= _FEWEST_PICTURES and not seen_ids & last_row:
        yield Finding(code=UNSEEN_ROW, board=board.name)


def _of_ratio(board: Board, placed: Sequence[Picture]) -> Iterator[Finding]:
    """Yield whether the markers have another size beside the squares than described."""
    ratio = measured_ratio(board, _seen(board, placed))
    if np.isfinite(ratio) and not _is_as_described(board, ratio):
        yield Finding(code=RATIO, board=board.name, pictures=names(placed), value=ratio)


def _is_as_described(board: Board, ratio: float) -> bool:
    """Tell whether markers have the described size beside the squares, as well as it is measured.

    Args:
        board: The board.
        ratio: Side of the markers in sides of a square; NaN if it is not known.
    """
    return bool(abs(ratio * board.square / board.marker - 1.0) <= _RATIO_TOLERANCE)
