"""Printed boards: where their corners are, as designed and as measured.

A board's frame is OpenCV's: the origin at the outer corner of the pattern, x along the columns, y along the rows, down
the page, and z = x cross y, which points into the page, away from a camera that sees it. Lengths are those of the
print as measured, not of the drawing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from calib.basics.arrays import Array, Integers
from calib.basics.values import ReadOnlyMapping, Value
from calib.boards.dictionaries import check_markers
from calib.errors import CalibError, choices, did_you_mean

#: A chessboard whose white squares hold markers: corners are known even where a part of the board is seen.
CHARUCO = "charuco"

#: A plain chessboard, of which all inner corners must be seen.
CHESSBOARD = "chessboard"

#: A grid of AprilTags, whose four corners each are measured.
APRILTAG = "apriltag"

#: The patterns, and what their descriptions need besides columns, rows and square.
PATTERNS: Mapping[str, tuple[str, ...]] = ReadOnlyMapping(
    {CHARUCO: ("marker", "dictionary"), CHESSBOARD: (), APRILTAG: ("marker", "dictionary")}
)

#: Fewest columns and rows of squares, and of tags.
_FEWEST = {CHARUCO: 2, CHESSBOARD: 3, APRILTAG: 1}


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Board(Value):
    """A printed board.

    Raises:
        CalibError: An unknown pattern, too few columns or rows, or lengths that make no board.
    """

    #: Name, as in the column ``target`` of a table of corners.
    name: str = "board"
    #: `CHARUCO`, `CHESSBOARD` or `APRILTAG`.
    pattern: str
    #: Squares, or tags, along x.
    columns: int
    #: Squares, or tags, along y.
    rows: int
    #: Side of a square as measured on the print; of a grid of tags the distance of two tags' centres [m].
    square: float
    #: Side of a marker or tag, black border included [m]; 0 for a chessboard.
    marker: float = 0.0
    #: Name of OpenCV's dictionary of markers, ``"DICT_5X5_100"``; "" for a chessboard.
    dictionary: str = ""
    #: Id of the first marker or tag.
    first_marker: int = 0
    #: Whether an even number of rows is laid out as by OpenCV before 4.6: a marker in the first square.
    legacy: bool = False
    #: Standard deviation of the relative error of ``square``: how well the print was measured.
    sigma_scale: float = 0.003
    #: Standard deviation of each corner's place on the print, along x and along y [m].
    sigma_corner: float = 5e-5
    #: Standard deviation of the sag of the board's middle, along x and along y [m].
    sigma_warp: float = 1e-3

    def __post_init__(self) -> None:
        """Check the pattern and its sizes."""
        if self.pattern not in PATTERNS:
            raise CalibError(
                f"The board '{self.name}' has the pattern '{self.pattern}'; allowed are "
                f"{choices(PATTERNS)}{did_you_mean(self.pattern, PATTERNS)}."
            )
        fewest = _FEWEST[self.pattern]
        if min(self.columns, self.rows) < fewest:
            raise CalibError(
                f"The board '{self.name}' has {self.columns} columns and {self.rows} rows; a {self.pattern} has "
                f"{fewest} or more of each."
            )
        if not 0.0 < self.square < 10.0:
            raise CalibError(
                f"The board '{self.name}' has squares of {self.square:g} m; they are above 0 and below 10 m."
            )
        needs_marker = "marker" in PATTERNS[self.pattern]
        if needs_marker and not 0.0 < self.marker < self.square:
            raise CalibError(
                f"The board '{self.name}' has markers of {self.marker:g} m in squares of {self.square:g} m; they are "
                "above 0 and smaller than the squares."
            )
        if needs_marker and not self.dictionary:
            raise CalibError(
                f"The board '{self.name}' needs the dictionary of its markers, such as 'DICT_5X5_100'."
            )
        if needs_marker:
            where = f"The board '{self.name}' with {self.columns} columns and {self.rows} rows"
            check_markers(self.dictionary, self.first_marker, self.markers, where)
        if min(self.sigma_scale, self.sigma_corner, self.sigma_warp) < 0.0:
            raise CalibError(
                f"The board '{self.name}' has a standard deviation below 0; 0 stands for a perfect print."
            )

    @property
    def markers(self) -> int:
        """Number of markers or tags; 0 for a chessboard."""
        squares = self.columns * self.rows
        return {CHARUCO: squares // 2, CHESSBOARD: 0, APRILTAG: squares}[self.pattern]

    @property
    def size(self) -> tuple[float, float]:
        """Width along x and height along y of the pattern, without margins [m]."""
        if self.pattern == APRILTAG:
            gap = self.square - self.marker
            return self.columns * self.square - gap, self.rows * self.square - gap
        return self.columns * self.square, self.rows * self.square

    @property
    def corners(self) -> Array:
        """Positions of all corners in the board's frame, in the order of their ids, shape (n, 3) [m]."""
        grid = _tag_corners(self) if self.pattern == APRILTAG else _inner_corners(self)
        return np.column_stack([grid, np.zeros(len(grid))])

    @property
    def centre(self) -> Array:
        """Middle of the pattern in the board's frame, shape (3,) [m]."""
        width, height = self.size
        return np.array([width / 2.0, height / 2.0, 0.0])

    def corner_ids(self) -> Integers:
        """Return the ids of the corners: 0 to n - 1, in rows along x; of a tag its corners, clockwise from top left."""
        return np.arange(len(self.corners))


def _inner_corners(board: Board) -> Array:
    """Inner corners of a chessboard, in rows along x, shape (n, 2) [m]."""
    x = np.arange(1, board.columns) * board.square
    y = np.arange(1, board.rows) * board.square
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def _tag_corners(board: Board) -> Array:
    """Corners of all tags of a grid, tag after tag, each clockwise from its top left, shape (4 tags, 2) [m]."""
    x = np.arange(board.columns) * board.square
    y = np.arange(board.rows) * board.square
    origins = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 1, 2)
    of_tag = board.marker * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    return np.asarray(origins + of_tag).reshape(-1, 2)
