"""One board in one image: its corners, or the reason why they cannot be used."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.basics.arrays import Array, Integers
from calib.basics.values import Value
from calib.boards.board import APRILGRID, APRILTAG, BODY, CHESSBOARD, ROUND, Board, marker_outlines
from calib.boards.corners.body_views import agreeing_tags
from calib.boards.corners.chessboards import (
    find_chessboard,
    find_inner_corners,
    is_part_of_larger,
    visible_corners,
)
from calib.boards.corners.circles import find_circles, refine_circles
from calib.boards.corners.markers import (
    FEWEST_MARKERS,
    Markers,
    find_markers,
    place_board,
)
from calib.boards.corners.planar_map import fit_planar_map
from calib.boards.corners.tags import tag_corners
from calib.boards.opencv import opencv

#: Default for the fewest corners of a board with which an image is used: with fewer the pose is poor.
FEWEST_CORNERS = 12

#: The image shows nothing of the board.
NO_BOARD = "no_board"

#: The board is found only in a smaller copy of the image, or the image is blurred.
BLURRED = "blurred"

#: There is hardly any contrast in the picture: no light, or a cap on the lens.
FLAT = "flat"

#: Most of the picture is as bright as can be.
OVEREXPOSED = "overexposed"

#: The board is found only in the mirrored image.
MIRRORED = "mirrored"

#: Too few corners, and some are outside the image.
CUT = "cut"

#: Too few corners, though all are inside: hidden, small, or badly lit.
FEW_CORNERS = "few_corners"

#: The markers are not where the description has them, or a chessboard has more columns or rows.
LAYOUT = "layout"

#: Some ids are seen twice: there is another board of the same dictionary.
TWO_BOARDS = "two_boards"

#: Fewest markers, besides the board's, that make a second board of the same dictionary.
_SECOND_BOARD = 3

#: Factors by which the copies are smaller in which a blurred board is sought.
_SMALLER = (2, 4)

#: Smallest difference between the darkest and the brightest pixels, one in a thousand each, in which there may be a
#: board [grey values]: that of a corner, see `saddles`.
_LEAST_CONTRAST = 8.0

#: Share of the pixels at the highest grey value above which a picture is overexposed.
_OVEREXPOSED = 0.5

#: Blur above which a picture without a board is called blurred [px].
_BLURRED = 3.0

#: Smallest slope of an edge whose blur can be measured [grey values per px].
_LEAST_SLOPE = 0.5

#: Blur that is added to measure that of a picture [px].
_FURTHER_BLUR = 3.0

#: Fewest refined corners of tags to which a map is fitted; below, it is fitted to the corners from OpenCV.
_FEWEST_REFINED = 4


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
    #: Number of corners that are inside the image; 0 if the board is not placed.
    visible: int = 0
    #: Distance of the corners from one smooth map of the board, rms [px]; NaN without corners.
    rms: float = np.nan
    #: Number of markers that are not where the others and the description have them.
    misread: int = 0
    #: The copy of the picture that shows it, one of the codes of `copies`; "" for the picture as it is.
    copy: str = ""
    #: Why the corners are not used, one of the codes above; "" if they are used.
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
    *,
    grey: Array | None = None,
    quick: bool = False,
) -> BoardView:
    """Search an image for the corners of a board.

    Args:
        image: Grey values, 8 bits, shape (height, width).
        board: The board.
        markers: All markers of its dictionary that the image shows; none for a chessboard.
        fewest: Fewest corners with which the image is used.
        grey: The same grey values before they were rounded to 8 bits, shape (height, width); None: those of the image.
        quick: True to seek a chessboard by OpenCV's quicker detector alone.

    Returns:
        The corners, and the reason if they are not used.
    """
    if grey is None:
        grey = np.asarray(image, dtype=np.float64)
    image_size = (image.shape[1], image.shape[0])
    misread = 0
    if board.pattern == CHESSBOARD:
        chessboard = find_chessboard(image, board, quick=quick)
        if chessboard is None:
            return _empty(board, NO_BOARD)
        saddles, planar_map = find_inner_corners(
            grey,
            board,
            chessboard.map,
            board.corners[:, :2],
            chessboard.pixels,
            is_white_first=chessboard.is_white_first,
        )
        if is_part_of_larger(grey, board, planar_map):
            return _empty(board, LAYOUT)
    elif board.pattern == BODY:
        return _search_body(grey, board, markers.of_ids(board.marker_ids), fewest)
    elif board.pattern in ROUND:
        circles = find_circles(image, board)
        if circles is None:
            return _empty(board, NO_BOARD)
        saddles, planar_map = refine_circles(grey, board, circles)
    else:
        markers = markers.of_ids(board.marker_ids)
        layout = marker_outlines(board)
        if len(markers.ids) < min(FEWEST_MARKERS, board.markers):
            return _empty(board, NO_BOARD)
        are_touched = board.pattern == APRILGRID
        placement = place_board(markers, layout, image_size, are_touched=are_touched)
        if placement is not None:
            # Markers that do not agree on the board, but have ids of it, may make a second one.
            others = markers.select(~placement.agrees)
            twice = others.select(np.isin(others.ids, markers.ids[placement.agrees]))
            if len(twice.ids) >= _SECOND_BOARD:
                second = place_board(twice, layout, image_size)
                if second is not None and second.agrees.sum() >= _SECOND_BOARD and second.is_sound:
                    return _empty(board, TWO_BOARDS)
        if placement is None or not placement.is_sound:
            return _empty(board, LAYOUT)
        misread = placement.misread
        used = markers.select(placement.agrees)
        if board.pattern == APRILTAG:
            ids = (4 * used.ids[:, None] + np.arange(4)).reshape(-1)
            saddles = tag_corners(grey, used.corners).among(len(board.corners), ids)
            refined = saddles.exist
            points, pixels = board.corners[refined, :2], saddles.pixels[refined]
            if refined.sum() < _FEWEST_REFINED:
                points, pixels = board.corners[ids, :2], used.corners.reshape(-1, 2)
            planar_map = fit_planar_map(points, pixels, image_size)
        else:
            points = layout[used.ids].reshape(-1, 2)
            pixels = used.corners.reshape(-1, 2)
            saddles, planar_map = find_inner_corners(grey, board, placement.map, points, pixels)

    exist = saddles.exist
    visible = int(visible_corners(board, planar_map, image_size).sum())
    predicted = planar_map.project(board.corners[exist, :2])
    square = np.sum((saddles.pixels[exist] - predicted) ** 2, axis=1)
    reason = ""
    if exist.sum() < min(fewest, len(board.corners)):
        reason = CUT if visible < len(board.corners) else FEW_CORNERS
    return BoardView(
        board=board.name,
        ids=np.flatnonzero(exist),
        pixels=saddles.pixels[exist],
        sigma=saddles.sigma[exist],
        visible=visible,
        rms=float(np.sqrt(np.mean(square))) if exist.any() else np.nan,
        misread=misread,
        reason=reason,
    )


def _search_body(grey: Array, board: Board, markers: Markers, fewest: int) -> BoardView:
    """Return the corners of the tags of a body, by their ids, that agree on its pose; ``fewest`` as of `search_board`.

    An image shows a side of it only, and so one tag is enough.
    """
    if not len(markers.ids):
        return _empty(board, NO_BOARD)
    layout = board.corners.reshape(-1, 4, 3)
    agrees = agreeing_tags(markers, layout, (grey.shape[1], grey.shape[0]))
    if agrees is None:
        return _empty(board, LAYOUT)
    used = markers.select(agrees)
    ids = (4 * used.ids[:, None] + np.arange(4)).reshape(-1)
    order = np.argsort(ids)
    saddles = tag_corners(grey, used.corners)
    found = saddles.exist[order]
    return BoardView(
        board=board.name,
        ids=ids[order][found],
        pixels=saddles.pixels[order][found],
        sigma=saddles.sigma[order][found],
        visible=len(ids),
        misread=int((~agrees).sum()),
        reason="" if found.sum() >= min(fewest, 4) else FEW_CORNERS,
    )


def reason_of_nothing(
    image: Any,  # noqa: ANN401  8-bit
    board: Board,
    *,
    quick: bool = False,
) -> str:
    """Return why a board is not found in an image: `MIRRORED`, `FLAT`, `OVEREXPOSED`, `BLURRED` or `NO_BOARD`.

    Args:
        image: Grey values, 8 bits, shape (height, width).
        board: The board.
        quick: As of `search_board`.
    """
    if np.mean(image == np.iinfo(image.dtype).max) > _OVEREXPOSED:
        return OVEREXPOSED
    darkest, brightest = np.quantile(image, [1e-3, 1.0 - 1e-3])
    if brightest - darkest < _LEAST_CONTRAST:
        return FLAT
    if board.markers and _is_in(np.ascontiguousarray(image[:, ::-1]), board, quick=quick):
        return MIRRORED
    cv2 = opencv()
    for factor in _SMALLER:
        size = (max(1, image.shape[1] // factor), max(1, image.shape[0] // factor))
        if _is_in(cv2.resize(image, size, interpolation=cv2.INTER_AREA), board, quick=quick):
            return BLURRED
    return BLURRED if blur_of(image) > _BLURRED else NO_BOARD


def blur_of(image: Any) -> float:  # noqa: ANN401  8-bit
    """Return the standard deviation of the blur of an image's sharpest edges [px]; ``image`` is grey, shape (h, w).

    It is 0 without edges and for edges too sharp to measure. It is infinite if a further blur makes
    them no less steep.

    The steepest slope of an edge of height h is h / (sqrt(2 pi) sigma). A further blur of s makes sqrt(sigma^2 + s^2)
    of sigma. So the ratio of the slopes after a blur of 1 px and of s determines sigma:

        before^2 / after^2 = (sigma^2 + s^2) / (sigma^2 + 1)
    """
    cv2 = opencv()
    smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), 1.0)
    smoother = cv2.GaussianBlur(image.astype(np.float32), (0, 0), _FURTHER_BLUR)
    slopes = []
    for picture in (smooth, smoother):
        by_v, by_u = np.gradient(picture)
        # The slope that one pixel of a thousand exceeds.
        slopes.append(float(np.quantile(np.hypot(by_u, by_v), 0.999)))
    before, after = slopes
    if before < _LEAST_SLOPE:
        return 0.0
    if before <= after:
        return np.inf
    square = (before / after) ** 2
    return float(np.sqrt(max((_FURTHER_BLUR**2 - square) / (square - 1.0), 0.0)))


def _is_in(image: Any, board: Board, *, quick: bool) -> bool:  # noqa: ANN401  8-bit
    """Return True if a board is found in an image, grey values (h, w), roughly: whether it is there, not where."""
    if board.pattern == CHESSBOARD:
        return find_chessboard(image, board, quick=quick) is not None
    if board.pattern in ROUND:
        return find_circles(image, board) is not None
    markers = find_markers(image, board.dictionary, border=board.border)
    markers = markers.of_ids(board.marker_ids)
    if board.pattern == BODY:
        return len(markers.ids) >= min(FEWEST_MARKERS, board.markers)
    placement = place_board(
        markers,
        marker_outlines(board),
        (image.shape[1], image.shape[0]),
        are_touched=board.pattern == APRILGRID,
    )
    return placement is not None and placement.is_sound


def _empty(board: Board, reason: str) -> BoardView:
    """Return a view without corners of a board, with the reason."""
    return BoardView(
        board=board.name,
        ids=np.zeros(0, dtype=int),
        pixels=np.zeros((0, 2)),
        sigma=np.zeros(0),
        reason=reason,
    )
