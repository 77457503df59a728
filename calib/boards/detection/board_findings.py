"""Findings: mistakes in the description of a board, or in the pictures; as codes and numbers, without sentences."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

import calib.basics.jobs as jobs
from calib.basics.arrays import Array
from calib.basics.values import Value
from calib.boards.board import BODY, CHARUCO, CHESSBOARD, Board, marker_outlines
from calib.boards.corners.chessboards import size_of_chessboard
from calib.boards.corners.markers import Markers, find_markers, place_board
from calib.boards.corners.planar_map import fit_planar_map
from calib.boards.detection.board_search import (
    BLURRED,
    FEW_CORNERS,
    LAYOUT,
    MIRRORED,
    NO_BOARD,
    TWO_BOARDS,
    BoardView,
)
from calib.boards.detection.copies import as_it_is
from calib.boards.detection.picture import OTHER_SIZE, ImageFile, Picture, read_image
from calib.boards.dictionaries import KINDS, kind_of, smallest_dictionary
from calib.errors import CalibError

#: Columns and rows are swapped.
SWAPPED = "swapped"

#: An even number of rows is laid out as OpenCV did before 4.6, or as it does since.
LEGACY = "legacy"

#: Another number of columns or rows.
SIZE = "size"

#: A chessboard is described by the numbers of its inner corners, not of its squares.
INNER_CORNERS = "inner_corners"

#: Markers of another size in the same squares.
RATIO = "ratio"

#: Another id of the first marker.
FIRST_MARKER = "first_marker"

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
WRONG_DESCRIPTION = (
    SWAPPED,
    LEGACY,
    SIZE,
    INNER_CORNERS,
    RATIO,
    FIRST_MARKER,
    DICTIONARY,
    UNEXPLAINED,
)

#: Largest relative error of the markers' size; with a larger one it is another print.
_RATIO_TOLERANCE = 0.05

#: Fewest pictures of a board from which it is concluded that something is never seen.
_FEWEST_PICTURES = 3

#: Fewest markers with further ids in a picture for a board with more rows than described.
_FEWEST_MORE = 2

#: Number of pictures in which another pattern is sought; a chessboard of another size needs a majority of them.
MOST_SEARCHED = 5

#: Fewest different markers of another dictionary that are not an accident.
_FEWEST_MARKERS = 4


Item = TypeVar("Item")


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding(Value):
    """Something to correct, or to know."""

    #: One of the codes of this module, or of `board_search` and `copies` beside it.
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
    """Return the width and height [px] of most pictures of each camera, by its name; unreadable ones do not count."""
    counts: dict[str, Counter[tuple[int, int]]] = defaultdict(Counter)
    for picture in pictures:
        if picture.size != (0, 0):
            counts[picture.file.camera][picture.size] += 1
    return {camera: count.most_common(1)[0][0] for camera, count in counts.items()}


def board_findings(
    board: Board, pictures: Sequence[Picture], boards: Sequence[Board] = ()
) -> Iterator[Finding]:
    """Yield what pictures say against the description of a board.

    Args:
        board: The board.
        pictures: The pictures that could be read, with the markers of the board's dictionary.
        boards: All boards that they may show.
    """
    by_reason: dict[str, list[Picture]] = defaultdict(list)
    by_copy: dict[str, list[Picture]] = defaultdict(list)
    for picture in pictures:
        view = _view(picture, board)
        by_reason[view.reason].append(picture)
        if view.is_used and view.copy:
            by_copy[view.copy].append(picture)
    for code, of_copy in by_copy.items():
        yield Finding(code=code, board=board.name, pictures=_names(of_copy))
    if board.looks_same_turned and by_reason[""]:
        yield Finding(code=AMBIGUOUS, board=board.name)
    if not board.markers:
        return
    for code in (MIRRORED, TWO_BOARDS):
        if by_reason[code]:
            yield Finding(code=code, board=board.name, pictures=_names(by_reason[code]))

    if board.pattern == BODY:
        if by_reason[LAYOUT]:
            yield Finding(code=UNEXPLAINED, board=board.name, pictures=_names(by_reason[LAYOUT]))
        return

    # Why markers are not where the description has them; an id or two that were misread are not a reason.
    wrong = by_reason[LAYOUT]
    doubtful = [picture for picture in pictures if _view(picture, board).misread]
    if wrong or doubtful:
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

    # Markers of the dictionary with the ids of no board.
    of_others = [other for other in boards if other.marker_kind == board.marker_kind]
    known = np.concatenate([other.marker_ids for other in (board, *of_others)])
    strange = [
        picture
        for picture in by_reason[NO_BOARD]
        if len(np.setdiff1d(picture.markers[board.marker_kind].ids, known)) >= _FEWEST_TRIED
    ]
    if len(strange) > len(pictures) / 2:
        code, better = explanation(board, _seen(board, strange)) or (UNEXPLAINED, board)
        if code == FIRST_MARKER:
            yield Finding(code=code, board=board.name, pictures=_names(strange), better=better)

    # More rows than described, or fewer.
    placed = [picture for picture in pictures if _view(picture, board).visible]
    last = board.first_marker + board.markers
    larger = []
    seen_ids: set[int] = set()
    for picture in placed:
        ids = picture.markers[board.marker_kind].ids
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

    # Markers of another size.
    measured = [*placed, *by_reason[FEW_CORNERS]]
    ratio = measured_ratio(board, _seen(board, measured))
    if np.isfinite(ratio) and not _is_as_described(board, ratio):
        yield Finding(code=RATIO, board=board.name, pictures=_names(measured), value=ratio)


def spread_over(items: Sequence[Item]) -> list[Item]:
    """Return `MOST_SEARCHED` items spread evenly over all; all if there are fewer."""
    places = np.linspace(0, len(items) - 1, min(len(items), MOST_SEARCHED))
    return [items[int(place)] for place in places]


def other_pattern(
    board: Board,
    pictures: Sequence[Picture],
    executor: Executor | None = None,
    *,
    fewest_alike: int = 1,
) -> list[Finding]:
    """Find what pictures show instead of a board, if half of them or more show nothing of it.

    Args:
        board: The board.
        pictures: The pictures that could be read.
        executor: Where pictures are searched; None: here.
        fewest_alike: Fewest pictures that show a chessboard of the same size.

    Returns:
        The finding of another dictionary, or of a chessboard of another size; none if neither is seen.
    """
    without = pictures_without(board, pictures)
    if not without:
        return []
    files = [picture.file for picture in spread_over(without)]
    if board.pattern == CHESSBOARD:
        found = [size for _, size in jobs.run(_chessboard_in, None, files, executor)]
        sizes = Counter(size for size in found if size is not None)
        described = (max(board.columns, board.rows), min(board.columns, board.rows))
        (columns, rows), alike = sizes.most_common(1)[0] if sizes else (described, 0)
        if (columns, rows) == described or alike < fewest_alike:
            return []
        if board.columns < board.rows:
            columns, rows = rows, columns
        better = replace(board, columns=columns, rows=rows)
        is_by_corners = (board.columns, board.rows) == (columns - 1, rows - 1)
        code = INNER_CORNERS if is_by_corners else SIZE
        return [Finding(code=code, board=board.name, pictures=_names(without), better=better)]

    if not board.markers:
        return []
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


def pictures_without(board: Board, pictures: Sequence[Picture]) -> list[Picture]:
    """Return the pictures that show nothing of a board; none if they are less than half of all."""
    # A chessboard with more columns or rows is another one.
    is_chessboard = board.pattern == CHESSBOARD
    reasons = (NO_BOARD, LAYOUT, BLURRED, FEW_CORNERS) if is_chessboard else (NO_BOARD,)
    without = [picture for picture in pictures if _view(picture, board).reason in reasons]
    return without if len(without) >= len(pictures) / 2 else []


def _chessboard_in(_: None, file: ImageFile) -> tuple[int, int] | None:
    """Return columns and rows of whatever chessboard a picture shows, the larger number first; None without one."""
    return size_of_chessboard(as_it_is(read_image(file)).image)


def _ids_in(_: None, file: ImageFile) -> dict[tuple[str, ...], set[int]]:
    """Return the ids of the markers in a picture by the kinds of dictionary, of `KINDS`, in which they were sought."""
    image = as_it_is(read_image(file)).image
    return {kind: set(find_markers(image, kind[-1]).ids.tolist()) for kind in KINDS}


def is_wrong_description(finding: Finding, pictures: Sequence[Picture], board: Board) -> bool:
    """Return True if a finding discards a board's corners in all pictures: as many speak for it as against it, or more.

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
    """Return the names of the files of pictures."""
    return tuple(picture.file.name for picture in pictures)


def _view(picture: Picture, board: Board) -> BoardView:
    """Return the corners of a board that were found in a picture, or the reason why there are none."""
    return next(view for view in picture.views if view.board == board.name)


def _seen(board: Board, pictures: Sequence[Picture]) -> list[Seen]:
    """Return the markers of a board's dictionary in pictures, with the sizes of the pictures."""
    return [(picture.markers[board.marker_kind], picture.size) for picture in pictures]


def _is_as_described(board: Board, ratio: float) -> bool:
    """Return True if markers of ``ratio`` sides of a square have the described size, as well as it is measured."""
    return bool(abs(ratio * board.square / board.marker - 1.0) <= _RATIO_TOLERANCE)


# Other descriptions that fit better: each marker has its id, so a mistake moves many of them

#: Largest number of columns that is tried.
_MOST_COLUMNS = 24

#: Ratios of marker and square that are tried.
_RATIOS = (0.5, 0.6, 0.7, 0.8, 0.9)

#: Number of pictures that are tried, those with the most markers.
_MOST_PICTURES = 6

#: Fewest markers with which a picture is tried.
_FEWEST_TRIED = 4

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
    used = [(markers, size) for markers, size in seen if len(markers.ids) >= _FEWEST_TRIED]
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
        seen: Markers in pictures, with the sizes of the pictures; those with too few markers are left out.
    """
    layout = marker_outlines(board)
    ratios = []
    for markers, image_size in seen:
        inside = markers.of_ids(board.marker_ids)
        if len(inside.ids) < _FEWEST_FOR_RATIO:
            continue
        placement = place_board(inside, layout, image_size)
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
    """Return the point (2,) [px] where the diagonals of corners (4, 2) meet: the middle of a square."""
    first = corners[2] - corners[0]
    second = corners[3] - corners[1]
    along, _ = np.linalg.solve(np.stack([first, -second], axis=1), corners[1] - corners[0])
    return np.asarray(corners[0] + along * first)


def _agreeing_share(board: Board, seen: Sequence[Seen]) -> float:
    """Return the share, 0 to 1, of all markers in pictures that are where a description of the board has them."""
    layout = marker_outlines(board)
    agreeing = 0
    total = 0
    for markers, image_size in seen:
        total += len(markers.ids)
        inside = markers.of_ids(board.marker_ids)
        placement = place_board(inside, layout, image_size)
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
