"""One board in one image: its corners, or the reason why there are none to use."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calib.basics.arrays import Array, Integers
from calib.basics.values import Value
from calib.boards.board import APRILTAG, CHESSBOARD, Board, marker_outlines
from calib.boards.corners.chessboards import find_chessboard, is_part_of_larger
from calib.boards.corners.growth import grow, visible_corners
from calib.boards.corners.markers import Markers, find_markers
from calib.boards.corners.placing import FEWEST_MARKERS, Placement, place
from calib.boards.corners.planar_map import PlanarMap, fit_planar_map
from calib.boards.corners.saddles import Saddles
from calib.boards.corners.tags import tag_corners
from calib.boards.opencv import opencv

#: Fewest corners of an image that is used, if nothing else is said: of fewer the pose is poor.
FEWEST_CORNERS = 12

#: The image shows nothing of the board.
NO_BOARD = "no_board"

#: It is found in a smaller copy of the image only.
BLURRED = "blurred"

#: It is found in the mirrored image only.
MIRRORED = "mirrored"

#: Too few corners, and some are outside the image.
CUT = "cut"

#: Too few corners, though all are inside: hidden, small, or badly lit.
FEW_CORNERS = "few_corners"

#: The markers are not where the description has them, or a chessboard has more columns or rows.
LAYOUT = "layout"

#: Some ids are there twice: another board of the same dictionary.
TWO_BOARDS = "two_boards"

#: Markers beside the board that make a second board of the same.
_SECOND_BOARD = 3

#: How much smaller the copies are in which a blurred board is sought.
_SMALLER = (2, 4)

#: Blur without a board above which the picture is called blurred [px].
_BLURRED = 3.0

#: Slope below which there is no edge whose blur could be measured [grey values a px].
_LEAST_SLOPE = 0.5

#: Blur that is added to measure that of a picture [px].
_FURTHER_BLUR = 3.0

#: Fewest corners or markers that tell that a board is in a copy.
_SIGN_OF_BOARD = 4


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class BoardView(Value):
    """The corners of one board in one image, and whether they are used."""

    #: The board's name.
    board: str
    #: Ids of the corners found, shape (n,).
    ids: Integers
    #: Their pixels, shape (n, 2).
    pixels: Array
    #: Their standard deviation along u and along v, shape (n,) [px].
    sigma: Array
    #: Number of corners that are inside the image; 0 where the board is not placed.
    visible: int = 0
    #: Distance of the corners from one smooth map of the board, rms [px]; NaN without corners.
    rms: float = np.nan
    #: Number of markers that are not where the others and the description have them.
    misread: int = 0
    #: Why the corners are not used, one of the codes above; "" if they are.
    reason: str = ""

    @property
    def is_used(self) -> bool:
        """True if the corners are used."""
        return not self.reason

    @property
    def is_complete(self) -> bool:
        """True if all corners that are inside the image were found."""
        return len(self.ids) >= self.visible


def search_board(
    image: Any,  # noqa: ANN401  8-bit, which Array is not
    board: Board,
    markers: Markers,
    fewest: int = FEWEST_CORNERS,
) -> BoardView:
    """Search an image for the corners of a board.

    Args:
        image: Grey values, 8 bits, shape (height, width).
        board: The board.
        markers: All markers of its dictionary that the image shows; of a chessboard none.
        fewest: Fewest corners that are used.

    Returns:
        The corners, with the reason why they are not used, if so.
    """
    if board.pattern == CHESSBOARD:
        return _search_chessboard(image, board, fewest)
    markers = markers.of_ids(board.first_marker, board.markers)
    layout = marker_outlines(board)
    image_size = (image.shape[1], image.shape[0])
    placement = place(markers, layout, image_size)
    if len(markers.ids) < FEWEST_MARKERS:
        return _empty(board, NO_BOARD)
    second = None if placement is None else _second(markers, layout, placement, image_size)
    if second is not None:
        return _empty(board, TWO_BOARDS)
    if placement is None or not placement.is_sound:
        return _empty(board, LAYOUT)
    used = Markers(markers.ids[placement.agrees], markers.corners[placement.agrees])
    grey = np.asarray(image, dtype=np.float64)
    if board.pattern == APRILTAG:
        saddles, planar_map = _tags(grey, board, used)
    else:
        points = layout[used.ids].reshape(-1, 2)
        pixels = used.corners.reshape(-1, 2)
        saddles, planar_map = grow(grey, board, placement.map, points, pixels)
    view = _judged(board, saddles, planar_map, image_size, fewest)
    return replace(view, misread=placement.misread)


def reason_of_nothing(image: Any, board: Board) -> str:  # noqa: ANN401  8-bit
    """Return why a board is not found in an image: `MIRRORED`, `BLURRED` or `NO_BOARD`.

    Args:
        image: Grey values, 8 bits, shape (height, width).
        board: The board.
    """
    if board.pattern != CHESSBOARD and _is_in(np.ascontiguousarray(image[:, ::-1]), board):
        return MIRRORED
    cv2 = opencv()
    for factor in _SMALLER:
        size = (image.shape[1] // factor, image.shape[0] // factor)
        if _is_in(cv2.resize(image, size, interpolation=cv2.INTER_AREA), board):
            return BLURRED
    return BLURRED if blur_of(image) > _BLURRED else NO_BOARD


def blur_of(image: Any) -> float:  # noqa: ANN401  8-bit
    """Return the standard deviation of the blur of an image's sharpest edges [px]; 0 without edges.

    The steepest slope of an edge is its step divided by sqrt(2 pi) sigma. A further blur of s makes sigma to
    sqrt(sigma^2 + s^2), so the ratio of the slopes before and after tells sigma.
    """
    cv2 = opencv()
    smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), 1.0)
    smoother = cv2.GaussianBlur(image.astype(np.float32), (0, 0), _FURTHER_BLUR)
    before, after = (_steepest(picture) for picture in (smooth, smoother))
    if before < _LEAST_SLOPE:
        return 0.0
    if before <= after:
        return np.inf
    square = (before / after) ** 2
    # before^2 / after^2 = (sigma^2 + s^2) / (sigma^2 + 1)
    return float(np.sqrt(max((_FURTHER_BLUR**2 - square) / (square - 1.0), 0.0)))


def _steepest(image: Any) -> float:  # noqa: ANN401  32-bit
    """Return the slope that one pixel of a thousand exceeds [grey values a px]."""
    by_v, by_u = np.gradient(image)
    return float(np.quantile(np.hypot(by_u, by_v), 0.999))


def _is_in(image: Any, board: Board) -> bool:  # noqa: ANN401  8-bit
    """Test whether a board is found in an image, roughly."""
    if board.pattern == CHESSBOARD:
        return find_chessboard(image, board) is not None
    markers = find_markers(image, board.dictionary).of_ids(board.first_marker, board.markers)
    placement = place(markers, marker_outlines(board), (image.shape[1], image.shape[0]))
    return placement is not None and placement.is_sound


def _empty(board: Board, reason: str) -> BoardView:
    """Return a view without corners."""
    nothing = np.zeros(0)
    return BoardView(
        board=board.name,
        ids=np.zeros(0, dtype=int),
        pixels=np.zeros((0, 2)),
        sigma=nothing,
        reason=reason,
    )


def _search_chessboard(image: Any, board: Board, fewest: int) -> BoardView:  # noqa: ANN401  8-bit
    """Search an image for a chessboard."""
    chessboard = find_chessboard(image, board)
    if chessboard is None:
        return _empty(board, NO_BOARD)
    planar_map, pixels = chessboard
    grey = np.asarray(image, dtype=np.float64)
    saddles, planar_map = grow(grey, board, planar_map, board.corners[:, :2], pixels)
    if is_part_of_larger(grey, board, planar_map):
        return _empty(board, LAYOUT)
    return _judged(board, saddles, planar_map, (image.shape[1], image.shape[0]), fewest)


def _tags(image: Array, board: Board, markers: Markers) -> tuple[Saddles, PlanarMap]:
    """Return all corners of a grid of tags, those found refined, and the map that they make."""
    pixels = np.full((len(board.corners), 2), np.nan)
    sigma = np.full(len(board.corners), np.nan)
    refined = tag_corners(image, markers.corners)
    ids = (4 * markers.ids[:, None] + np.arange(4)).reshape(-1)
    pixels[ids] = refined.pixels
    sigma[ids] = refined.sigma
    saddles = Saddles(pixels, sigma)
    exist = saddles.exist
    image_size = (image.shape[1], image.shape[0])
    if exist.sum() < _SIGN_OF_BOARD:
        points = marker_outlines(board)[markers.ids].reshape(-1, 2)
        return saddles, fit_planar_map(points, markers.corners.reshape(-1, 2), image_size)
    return saddles, fit_planar_map(board.corners[exist, :2], pixels[exist], image_size)


def _second(
    markers: Markers, layout: Array, placement: Placement, image_size: tuple[int, int]
) -> Placement | None:
    """Return the placement of a second board among the markers that do not agree on the first; None without one."""
    others = Markers(markers.ids[~placement.agrees], markers.corners[~placement.agrees])
    twice = np.isin(others.ids, markers.ids[placement.agrees])
    if twice.sum() < _SECOND_BOARD:
        return None
    second = place(Markers(others.ids[twice], others.corners[twice]), layout, image_size)
    if second is None or second.agrees.sum() < _SECOND_BOARD or not second.is_sound:
        return None
    return second


def _judged(
    board: Board,
    saddles: Saddles,
    planar_map: PlanarMap,
    image_size: tuple[int, int],
    fewest: int,
) -> BoardView:
    """Return the view of corners that were found, with the reason if they are too few."""
    exist = saddles.exist
    visible = int(visible_corners(board, planar_map, image_size).sum())
    predicted = planar_map.project(board.corners[exist, :2])
    square = np.sum((saddles.pixels[exist] - predicted) ** 2, axis=1)
    view = BoardView(
        board=board.name,
        ids=np.flatnonzero(exist),
        pixels=saddles.pixels[exist],
        sigma=saddles.sigma[exist],
        visible=visible,
        rms=float(np.sqrt(np.mean(square))) if exist.any() else np.nan,
    )
    if exist.sum() >= fewest:
        return view
    return replace(view, reason=CUT if visible < len(board.corners) else FEW_CORNERS)
