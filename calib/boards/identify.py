"""Which board a picture shows: its pattern, columns and rows, markers and layout; all but its size.

A print is sometimes mirrored, by the program that printed it or by a camera that flips its picture; its markers are
then found in the flipped picture only.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.basics.arrays import Array
from calib.basics.files import read_bytes
from calib.boards.board import CHARUCO, CHESSBOARD, Board
from calib.boards.board_file import shifted
from calib.boards.dictionaries import DICTIONARIES
from calib.boards.marker_grids import Grid, grid_of
from calib.boards.markers import Markers, find_high_ids, find_markers, smallest_dictionary
from calib.boards.opencv import opencv
from calib.errors import FileError

#: Side of the squares in a board that was identified: a picture does not show it [m].
ASSUMED_SQUARE = 0.03

#: The print or the picture is mirrored.
MIRRORED = "mirrored"

#: The picture ends behind the last row that is seen, so the board may have more.
CUT_OFF = "cut off"

#: Markers between the first and the last one are not found.
MISSING = "missing"

#: The first row of tags is the lowest one; `Board` counts from the top.
BOTTOM_UP = "bottom up"

#: The chessboard looks the same after half a turn.
HALF_TURN = "half turn"

#: Larger pictures are made smaller before they are searched: longest side [px].
_LARGEST = 3000

#: So many markers do not lie on a grid by chance; other kinds are not looked for [markers].
_CERTAIN = 8

#: Between the darkest white and the brightest black square lies this share of their mean difference at least.
_GAP = 0.25

#: A corner's distance from halfway between its neighbours, in squares: perspective and lenses move it little.
_BEND = 0.35

#: Smallest number of inner corners of a chessboard in each direction that is looked for.
_FEWEST_CORNERS = 3


@dataclass(frozen=True, slots=True)
class Identified:
    """The board in a picture, if there is one."""

    #: The board, with squares of `ASSUMED_SQUARE`; None if there is none.
    board: Board | None
    #: Codes of what to know about it, such as `MIRRORED`.
    findings: tuple[str, ...] = ()
    #: Dictionary of the markers that were found; "" if none were.
    dictionary: str = ""
    #: Ids of the markers on the board; of those in the picture, if there is no board.
    markers: tuple[int, ...] = ()


def read_image(path: str | Path) -> NDArray[np.uint8]:
    """Read a picture in grey.

    Args:
        path: The file, of any kind that OpenCV reads.

    Returns:
        The picture, shape (height, width).

    Raises:
        FileError: The file cannot be read, or is no picture.
    """
    cv2 = opencv()
    data = np.frombuffer(read_bytes(path, "picture"), dtype=np.uint8)
    image = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE) if len(data) else None
    if image is None:
        raise FileError(
            f"picture '{path}' cannot be decoded; PNG, JPEG, TIFF and BMP can. A PDF has to be made a PNG first."
        )
    return np.asarray(image)


def sized(board: Board, square: float | None, marker: float | None) -> Board:
    """Return a board that was identified in the size that it is known to have.

    Args:
        board: The board, its lengths assumed.
        square: Side of a square, or distance of two tags' centres [m]; None to keep what was assumed.
        marker: Side of a marker or tag [m]; None for the share of the square that the picture shows.
    """
    square = board.square if square is None else square
    if marker is None:
        marker = shifted(round(1e3 * board.marker * square / board.square, 1), -3)
    return replace(board, square=square, marker=marker)


def identify(image: NDArray[np.uint8]) -> Identified:
    """Say which board a picture shows.

    Args:
        image: The picture, shape (height, width), or (height, width, 3) with blue, green and red.

    Returns:
        The board, as large as assumed, and what to know about it.

    Raises:
        CalibError: OpenCV is not installed.
    """
    grey = _prepared(image)
    upright = _marker_board(find_markers(grey), grey)
    if upright.board is not None:
        return upright
    chessboard = _chessboard(grey)
    if chessboard is not None:
        return chessboard
    flipped_picture = np.ascontiguousarray(grey[:, ::-1])
    flipped = _marker_board(find_markers(flipped_picture), grey)
    if flipped.board is not None:
        return replace(flipped, findings=(MIRRORED, *flipped.findings))
    high = _marker_board(find_high_ids(grey), grey)
    return upright if high.board is None else high


def _prepared(image: NDArray[np.uint8]) -> Any:  # noqa: ANN401  an image of OpenCV
    """Return a picture in grey, not larger than is searched in reasonable time."""
    cv2 = opencv()
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
    scale = _LARGEST / max(grey.shape)
    if scale >= 1.0:
        return grey
    return cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)


def _marker_board(kinds: Iterable[Markers], grey: Any) -> Identified:  # noqa: ANN401
    """Identify a board with markers: of all kinds of markers the one with the most on a grid.

    Args:
        kinds: The markers of each kind.
        grey: The picture.
    """
    best: tuple[Grid, Markers] | None = None
    most: Markers | None = None
    for markers in kinds:
        if most is None or len(markers.ids) > len(most.ids):
            most = markers
        grid = grid_of(markers)
        if grid is not None and (best is None or len(grid.ids) > len(best[0].ids)):
            best = (grid, markers)
        if best is not None and len(best[0].ids) >= _CERTAIN:
            break
    if best is not None:
        return _identified(*best, grey.shape)
    if most is None:
        return Identified(None)
    dictionary = smallest_dictionary(most.kind, int(most.ids.max()))
    return Identified(None, (), dictionary, tuple(sorted(map(int, most.ids))))


def _identified(grid: Grid, markers: Markers, shape: tuple[int, ...]) -> Identified:
    """Describe the board of a grid of markers."""
    board = _board(grid, markers.kind)
    findings = []
    if grid.layout.bottom_up:
        findings.append(BOTTOM_UP)
    if _is_cut_off(grid, board.rows, shape):
        findings.append(CUT_OFF)
    if len(grid.ids) < board.markers:
        findings.append(MISSING)
    ids = tuple(sorted(map(int, grid.ids)))
    return Identified(board, tuple(findings), board.dictionary, ids)


def _board(grid: Grid, kind: tuple[str, ...]) -> Board:
    """Describe the board of a grid of markers, in the smallest dictionary of a kind that is large enough."""
    layout = grid.layout
    rows = grid.rows
    if layout.starts_white:
        rows += rows % 2  # only an even number of rows begins with a marker
    count = layout.columns * rows
    markers = count // 2 if layout.pattern == CHARUCO else count
    dictionary = smallest_dictionary(kind, layout.first + markers - 1)
    # The markers of a last row that is seen in part may not all exist.
    available = DICTIONARIES[dictionary].markers - layout.first
    if markers > available:
        squares = 2 * available if layout.pattern == CHARUCO else available
        rows = squares // layout.columns
    return Board(
        pattern=layout.pattern,
        columns=layout.columns,
        rows=rows,
        square=ASSUMED_SQUARE,
        marker=shifted(round(1e3 * grid.ratio * ASSUMED_SQUARE, 1), -3),
        dictionary=dictionary,
        first_marker=layout.first,
        legacy=layout.starts_white,
    )


def _is_cut_off(grid: Grid, rows: int, shape: tuple[int, ...]) -> bool:
    """Return whether a further row, behind the last one seen, would reach beyond the picture."""
    cv2 = opencv()
    further = -rows if grid.layout.bottom_up else rows + 1
    ends = np.array([[[0.0, further], [grid.layout.columns, further]]])
    corners = cv2.perspectiveTransform(ends, grid.H_image_cells)[0]
    largest = np.array([shape[1], shape[0]]) - 1.0
    return bool(np.any(corners < 0.0) or np.any(corners > largest))


def _chessboard(grey: Any) -> Identified | None:  # noqa: ANN401
    """Identify a plain chessboard; None if there is none."""
    cv2 = opencv()
    flags = cv2.CALIB_CB_LARGER | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_NORMALIZE_IMAGE
    size = (_FEWEST_CORNERS, _FEWEST_CORNERS)
    is_found, corners, meta = cv2.findChessboardCornersSBWithMeta(grey, size, flags)
    if not is_found:
        return None
    grid = np.reshape(np.asarray(corners, dtype=float), (*meta.shape[:2], 2))
    if not (_is_regular(grid) and _is_plain(grey, grid)):
        return None
    rows, columns = sorted(meta.shape[:2])
    board = Board(
        pattern=CHESSBOARD,
        columns=int(columns) + 1,
        rows=int(rows) + 1,
        square=ASSUMED_SQUARE,
    )
    findings = (HALF_TURN,) if (board.columns + board.rows) % 2 == 0 else ()
    return Identified(board, findings)


def _is_regular(corners: Array) -> bool:
    """Return whether each corner lies nearly halfway between its neighbours; OpenCV finds chessboards in noise.

    Args:
        corners: Corners in the picture, shape (rows, columns, 2) [px].
    """
    for axis in (0, 1):
        steps = np.linalg.norm(np.diff(corners, axis=axis), axis=-1)
        bends = np.linalg.norm(np.diff(corners, n=2, axis=axis), axis=-1)
        if bends.max() > _BEND * np.median(steps):
            return False
    return True


def _is_plain(grey: Any, corners: Array) -> bool:  # noqa: ANN401
    """Return whether squares are black and white in turn; those of a ChArUco board, with markers, are not.

    Args:
        grey: The picture.
        corners: Corners in it, shape (rows, columns, 2) [px].
    """
    cv2 = opencv()
    middles = (corners[:-1, :-1] + corners[:-1, 1:] + corners[1:, :-1] + corners[1:, 1:]) / 4.0
    smooth = cv2.GaussianBlur(grey, (0, 0), 1.0)
    x, y = np.rint(middles).astype(int).reshape(-1, 2).T
    grey_levels = smooth[np.clip(y, 0, len(smooth) - 1), np.clip(x, 0, smooth.shape[1] - 1)]
    row, column = np.indices(middles.shape[:2])
    is_odd = (row + column).ravel() % 2 == 1
    first, second = grey_levels[~is_odd].astype(float), grey_levels[is_odd].astype(float)
    contrast = abs(first.mean() - second.mean())
    gap = max(first.min() - second.max(), second.min() - first.max())
    return bool(gap > _GAP * contrast)
