"""Corners of boards in pictures: every picture is searched, and one that gives nothing comes with the reason."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import numpy as np

import calib.basics.jobs as jobs
from calib.basics.arguments import (
    check_callable,
    check_executor,
    check_type,
    check_whole,
    wrong_type,
)
from calib.basics.values import Value
from calib.boards.board import Board
from calib.boards.detection.board_findings import (
    MOST_SEARCHED,
    Finding,
    board_findings,
    is_wrong_description,
    other_pattern,
    picture_findings,
    pictures_without,
    spread_over,
    usual_sizes,
)
from calib.boards.detection.board_search import FEWEST_CORNERS, LAYOUT
from calib.boards.detection.picture import (
    OTHER_SIZE,
    ImageFile,
    Picture,
    Search,
    find_images,
    search_picture,
)
from calib.boards.dictionaries import kind_of
from calib.errors import CalibError, choices

#: Most pictures that are all searched at once: with more, some are searched first.
_MOST_AT_ONCE = 2 * MOST_SEARCHED


@dataclass(frozen=True, slots=True)
class Detection(Value):
    """The corners of boards found in pictures, and the mistakes that the pictures show."""

    boards: tuple[Board, ...]
    #: In the order in which they were given.
    pictures: tuple[Picture, ...]
    findings: tuple[Finding, ...]
    #: Fewest corners of a board with which a picture is used.
    fewest: int

    @property
    def used(self) -> tuple[Picture, ...]:
        """The pictures with corners that are used."""
        return tuple(picture for picture in self.pictures if picture.used)

    @property
    def corner_count(self) -> int:
        """Number of corners that are used, in all pictures together."""
        return sum(len(view.ids) for picture in self.pictures for view in picture.used)


def detect(
    images: Sequence[ImageFile | str | Path],
    boards: Sequence[Board],
    *,
    fewest: int = FEWEST_CORNERS,
    executor: Executor | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Detection:
    """Find the corners of boards in pictures.

    Args:
        images: The pictures, or files, folders and patterns as `find_images` takes them.
        boards: The boards that they may show, with different names and different markers.
        fewest: Fewest corners of a board with which a picture is used.
        executor: Where the pictures are searched; None: here.
        progress: Called with the number of pictures done and of all.

    Returns:
        What every picture shows, and what is wrong with the pictures or with the descriptions of the boards.

    Raises:
        ArgumentError: An argument has a wrong type.
        CalibError: Two boards have one name or share markers, or a picture does not exist.

    Example:
        >>> board = Board(pattern="chessboard", columns=9, rows=6, square=0.025)
        >>> calib.detect(["images"], [board]).corner_count  # doctest: +SKIP
        480
    """
    _check_sequence("images", images, (ImageFile, str, Path), "files, folders or patterns")
    _check_sequence("boards", boards, Board, "Board values")
    check_whole("fewest", fewest, 4)
    check_executor(executor)
    check_callable("progress", progress)
    check_boards(boards)
    words = [image for image in images if not isinstance(image, ImageFile)]
    files = [image for image in images if isinstance(image, ImageFile)]
    if words:
        files += find_images(words)

    search = Search(tuple(boards), fewest, single_thread=executor is not None)
    by_number: dict[int, Picture] = {}
    other_prints: dict[str, list[Finding]] = {}
    if len(files) > _MOST_AT_ONCE:
        # Some are searched first: what they show instead of a board need not be sought in every copy of the others.
        numbers = spread_over(range(len(files)))
        quick = replace(search, quick=tuple(board.name for board in boards))
        first = dict(jobs.run(search_picture, quick, [files[k] for k in numbers], executor))
        other_prints = _other_prints(boards, list(first.values()), executor)
        search = replace(search, quick=tuple(other_prints))
        by_number = {numbers[k]: first[k] for k in first if _is_complete(first[k])}
    remaining = [number for number in range(len(files)) if number not in by_number]
    found = jobs.run(search_picture, search, [files[number] for number in remaining], executor)
    for place, picture in found:
        by_number[remaining[place]] = picture
        if progress is not None:
            progress(len(by_number), len(files))
    pictures = [by_number[number] for number in range(len(files))]

    usual = usual_sizes(pictures)
    for k, picture in enumerate(pictures):
        if not picture.reason and picture.size != usual[picture.file.camera]:
            pictures[k] = replace(picture, reason=OTHER_SIZE)
    findings = list(picture_findings(pictures))
    readable = [picture for picture in pictures if not picture.reason]
    for board in boards:
        of_board = list(board_findings(board, readable, boards))
        if board.name not in other_prints:
            of_board += other_pattern(board, readable, executor)
        elif without := pictures_without(board, readable):
            names = tuple(picture.file.name for picture in without)
            of_board += [replace(known, pictures=names) for known in other_prints[board.name]]
        findings += of_board
        if any(is_wrong_description(finding, readable, board) for finding in of_board):
            # The board is described wrongly: its corners are used in no picture.
            for k, picture in enumerate(pictures):
                views = []
                for view in picture.views:
                    is_wrong = view.board == board.name and view.is_used
                    views.append(replace(view, reason=LAYOUT) if is_wrong else view)
                pictures[k] = replace(picture, views=tuple(views))
    return Detection(tuple(boards), tuple(pictures), tuple(findings), fewest)


def _other_prints(
    boards: Sequence[Board], pictures: Sequence[Picture], executor: Executor | None
) -> dict[str, list[Finding]]:
    """Return the boards, by name, of which no picture shows a corner, and most another print; with what that is.

    Markers with other ids need no finding here: `board_findings` sees them in all pictures.
    """
    readable = [picture for picture in pictures if not picture.reason]
    result = {}
    for board in boards:
        views = [view for picture in readable for view in picture.views if view.board == board.name]
        if any(view.is_used for view in views):
            continue
        most = len(pictures) // 2 + 1
        other_ids = list(board_findings(board, readable, boards))
        others = []
        if not other_ids:
            others = other_pattern(board, readable, executor, fewest_alike=most)
        if any(is_wrong_description(one, readable, board) for one in (*other_ids, *others)):
            result[board.name] = others
    return result


def _is_complete(picture: Picture) -> bool:
    """Return True if a picture shows all that it can of every board, so that no other search finds more."""
    return bool(picture.views) and all(view.is_used and view.is_complete for view in picture.views)


def check_boards(boards: Sequence[Board]) -> None:
    """Refuse boards that cannot be told apart in a picture; raises `CalibError`."""
    for first, second in combinations(boards, 2):
        if first.name == second.name:
            raise CalibError(f"Two boards have the name '{first.name}'; give each its own.")
        if not (first.markers and second.markers):
            sizes = [{board.columns, board.rows} for board in (first, second)]
            is_same = first.pattern == second.pattern and sizes[0] == sizes[1]
        else:
            shared = np.intersect1d(first.marker_ids, second.marker_ids)
            is_kind = kind_of(first.dictionary) == kind_of(second.dictionary)
            is_same = is_kind and first.border == second.border and len(shared) > 0
        if is_same:
            raise CalibError(
                f"The boards {choices([first.name, second.name])} look alike in a picture: they have the same size, or "
                "share markers of a dictionary. Print one with other markers: calib board --first-marker, or another "
                "--dictionary."
            )


def _check_sequence(
    argument: str, given: object, types: type | tuple[type, ...], allowed: str
) -> None:
    """Refuse an argument that is empty, or not a sequence of ``types`` (in words: ``allowed``); `ArgumentError`."""
    if isinstance(given, (str, bytes)) or not isinstance(given, Sequence) or not given:
        raise wrong_type(argument, given, f"a sequence of {allowed}, one or more")
    for k, value in enumerate(given):
        check_type(f"{argument}[{k}]", value, types, f"one of {allowed}")
