"""One picture: read, searched for all boards, and reduced to a small copy for a page."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field, replace
from typing import Any

from calib.basics.values import ReadOnlyMapping, Value
from calib.boards.board import CHESSBOARD, Board
from calib.boards.corners.markers import Markers, find_markers, no_markers
from calib.boards.detection.board_search import NO_BOARD, BoardView, reason_of_nothing, search_board
from calib.boards.detection.image_files import ImageFile, read_image
from calib.boards.opencv import opencv
from calib.errors import FileError

#: The file is not a picture.
UNREADABLE = "unreadable"

#: The picture has another size than most of its camera's.
OTHER_SIZE = "other_size"

#: No row of joint values belongs to it.
NO_ROW = "no_row"

#: Longer side of a small copy [px].
_SMALL = 480

#: Quality of its JPEG, of 100.
_QUALITY = 70


@dataclass(frozen=True, slots=True)
class Search(Value):
    """Boards that pictures are searched for."""

    boards: tuple[Board, ...]
    #: Fewest corners of a board with which a picture is used.
    fewest: int
    #: Whether OpenCV uses one thread, as beside other processes.
    single_thread: bool = False


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Picture(Value):
    """A picture, and the boards found in it."""

    file: ImageFile
    #: Width and height [px]; zeros if it cannot be read.
    size: tuple[int, int] = (0, 0)
    #: What it shows of each board, in their order.
    views: tuple[BoardView, ...] = ()
    #: Why nothing of it is used; "" if something is, or if the reasons of the views say it.
    reason: str = ""
    #: The markers in it by the name of their dictionary.
    markers: ReadOnlyMapping[str, Markers] = field(default_factory=ReadOnlyMapping)
    #: Hash of its grey values.
    sha256: str = ""
    #: A small copy as JPEG.
    small: bytes = b""

    @property
    def used(self) -> tuple[BoardView, ...]:
        """The views whose corners are used."""
        return () if self.reason else tuple(view for view in self.views if view.is_used)


def look(search: Search, file: ImageFile) -> Picture:
    """Read a picture and search it for boards.

    Args:
        search: The boards.
        file: The picture.

    Returns:
        What was found, or why there is nothing.
    """
    cv2 = opencv()
    if search.single_thread:
        cv2.setNumThreads(1)
    try:
        image = read_image(file)
    except FileError:
        image = None
    if image is None:
        return Picture(file=file, reason=UNREADABLE)
    markers, views = _search(search, image, thorough=False)
    if not all(view.is_used and view.is_complete for view in views):
        markers, views = _search(search, image, thorough=True)
    if all(view.reason == NO_BOARD for view in views):
        views = [
            replace(view, reason=reason_of_nothing(image, board))
            for view, board in zip(views, search.boards, strict=True)
        ]
    scale = min(1.0, _SMALL / max(image.shape))
    size = (max(1, round(scale * image.shape[1])), max(1, round(scale * image.shape[0])))
    copy = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    _, small = cv2.imencode(".jpg", copy, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    return Picture(
        file=file,
        size=(image.shape[1], image.shape[0]),
        views=tuple(views),
        markers=ReadOnlyMapping(markers),
        sha256=hashlib.sha256(image.tobytes()).hexdigest(),
        small=bytes(small.tobytes()),
    )


def _search(
    search: Search,
    image: Any,  # noqa: ANN401  8-bit
    *,
    thorough: bool,
) -> tuple[dict[str, Markers], list[BoardView]]:
    """Return the markers in a picture by the name of their dictionary, and what it shows of each board."""
    dictionaries = sorted({board.dictionary for board in search.boards if board.dictionary})
    markers = {name: find_markers(image, name, thorough=thorough) for name in dictionaries}
    views = []
    for board in search.boards:
        of_board = no_markers() if board.pattern == CHESSBOARD else markers[board.dictionary]
        views.append(search_board(image, board, of_board, search.fewest))
    return markers, views
