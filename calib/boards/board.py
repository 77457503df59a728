"""Printed boards: where their squares, markers and corners are, as described and as measured.

A board's frame is OpenCV's: the origin at the outer corner of the pattern, x along the columns, y along the rows, down
the page, and z = x cross y, which points into the page, away from a camera that sees it. Lengths are those of the
print as measured, not of the drawing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from calib.basics.arrays import Array, Integers, Mask
from calib.basics.records import Option, key
from calib.basics.units import LENGTH, parse_amount
from calib.basics.value_forms import WHOLE, decimal, one_of, text
from calib.boards.bodies import TAGS_OF_BODY, Tag, tag_of_corners
from calib.boards.dictionaries import check_markers, dictionary_of
from calib.errors import CalibError, choices, did_you_mean

#: A chessboard whose white squares hold markers: its corners are known even if only a part of it is seen.
CHARUCO = "charuco"

#: A plain chessboard; all of its inner corners must be seen.
CHESSBOARD = "chessboard"

#: A grid of AprilTags; the four corners of each are measured.
APRILTAG = "apriltag"

#: A grid of AprilTags as Kalibr prints it: black borders of two bits, small black squares between the corners of the
#: tags, ids from the lower left, and each tag as OpenCV has it turned by half a turn.
APRILGRID = "aprilgrid"

#: A grid of circles; all must be seen.
CIRCLES = "circles"

#: A grid of circles in which every second row is moved by half a distance, as OpenCV has it; all must be seen.
ASYMMETRIC_CIRCLES = "asymmetric_circles"

#: Tags on a body that is not flat, such as the faces of a cube.
BODY = "body"

#: Attributes of flat prints.
_FLAT = ("columns", "rows", "square", "sigma_warp")

#: The patterns, and the attributes that only some of them have.
PATTERNS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        CHARUCO: (*_FLAT, "marker", "dictionary", "first_marker", "legacy"),
        CHESSBOARD: _FLAT,
        APRILTAG: (*_FLAT, "marker", "dictionary", "first_marker"),
        APRILGRID: (*_FLAT, "marker", "dictionary", "first_marker"),
        CIRCLES: (*_FLAT, "marker"),
        ASYMMETRIC_CIRCLES: (*_FLAT, "marker"),
        BODY: ("dictionary", "tags"),
    }
)

#: The patterns that are grids of tags, and those of circles.
TAGS = (APRILTAG, APRILGRID)
ROUND = (CIRCLES, ASYMMETRIC_CIRCLES)

#: Distance of the tags of a body on a sheet, in the side of the largest.
_TAGS_APART = 1.4

#: Lengths and shares that keep their digits.
_MM = decimal("mm", -3)
_PERCENT = decimal("%", -2)

#: Fewest columns and rows of squares, and of tags.
_FEWEST = {
    CHARUCO: 2,
    CHESSBOARD: 3,
    APRILTAG: 1,
    APRILGRID: 1,
    CIRCLES: 3,
    ASYMMETRIC_CIRCLES: 3,
}


def _length(typed: str, flag: str) -> float:
    """Return a length in metres from a text such as ``"30 mm"``, typed as the option ``flag``."""
    return parse_amount(typed, flag, LENGTH, "30 mm")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Board:
    """A printed board.

    Raises:
        CalibError: An unknown pattern, too few columns or rows, or lengths that do not make a board.
    """

    #: Name, as in the column ``target`` of a table of corners.
    name: str = key(
        "name",
        text("a text"),
        "Name, as in the column 'target' of a table of corners.",
        default="board",
        option=Option("--name", help="Name of the board. Default: that of its files."),
    )
    #: One of `PATTERNS`.
    pattern: str = key(
        "pattern",
        text(f"one of {choices(PATTERNS)}"),
        '"charuco", "chessboard", "apriltag", "aprilgrid" (of Kalibr), "circles", "asymmetric_circles" or "body".',
        option=Option(
            "--pattern",
            type=tuple(PATTERNS),
            help="charuco: a chessboard with markers, found even if partly hidden (default). chessboard: all of it "
            "must be seen. apriltag: a grid of tags, or one. aprilgrid: that of Kalibr. circles, asymmetric_circles: "
            "those of OpenCV.",
        ),
    )
    #: Squares, tags or circles along x.
    columns: int = key(
        "columns",
        WHOLE,
        "Number of squares, tags or circles along x: across, with the text of the page below the pattern.",
        default=0,
        absent="needed, except for a body",
        option=Option(
            "--columns", type=int, least=1, help="Number of squares, tags or circles across."
        ),
    )
    #: Squares, tags or circles along y.
    rows: int = key(
        "rows",
        WHOLE,
        "Number of squares, tags or circles along y: down. For a chessboard count squares, not inner corners.",
        default=0,
        absent="needed, except for a body",
        option=Option("--rows", type=int, least=1, help="Number of squares, tags or circles down."),
    )
    #: Side of a square as measured on the print; for tags and circles the distance between their centres, for an
    #: asymmetric grid of circles that from row to row [m].
    square: float = key(
        "square_mm",
        _MM,
        "Side of a square as measured on the print; for tags and circles the distance between centres, from row to row "
        "[mm].",
        default=0.0,
        absent="needed, except for a body",
        json="square_m",
        option=Option(
            "--square",
            help='Side of a square, or distance between tags, such as "30 mm". Default: as large as fits.',
            metavar="LENGTH",
            parse=_length,
        ),
    )
    #: Side of a marker or tag, black border included, or diameter of a circle [m]; 0 for a chessboard.
    marker: float = key(
        "marker_mm",
        _MM,
        "Side of a marker or tag with its black border, or diameter of a circle, on the same print [mm].",
        default=0.0,
        absent="needed, except for a chessboard and for a body",
        json="marker_m",
        option=Option(
            "--marker",
            help="Side of a marker or tag, or diameter of a circle. Default: as large as can be found reliably.",
            metavar="LENGTH",
            parse=_length,
        ),
    )
    #: Name of OpenCV's dictionary of markers, ``"DICT_5X5_100"``; "" for a chessboard and for circles.
    dictionary: str = key(
        "dictionary",
        text("the name of a dictionary, such as DICT_5X5_100,"),
        "Dictionary of the markers, named as OpenCV names it; one that OpenCV made by size and seed: "
        "DICT_5X5_30_SEED_7.",
        default="",
        absent="needed, except for a chessboard and for circles",
        option=Option(
            "--dictionary",
            help="Dictionary of the markers. Default: DICT_5X5_100, or DICT_APRILTAG_36h11.",
        ),
    )
    #: Id of the first marker or tag.
    first_marker: int = key(
        "first_marker",
        WHOLE,
        "Id of the first marker, at the upper left; of an aprilgrid at the lower left.",
        default=0,
        option=Option(
            "--first-marker",
            type=int,
            least=0,
            help="Id of the first marker. Default: 0; boards in one picture need different ids.",
        ),
    )
    #: True if an even number of rows is laid out as by OpenCV before 4.6: a marker in the first square.
    legacy: bool = key(
        "layout",
        one_of({"new": False, "legacy": True}),
        '"new", or "legacy": as in OpenCV before 4.6, with a marker in the first square. For odd rows they agree.',
        default=False,
        option=Option(
            "--legacy",
            type=bool,
            help="Lay out an even number of rows as OpenCV before 4.6 did.",
            parse=lambda _typed, _flag: True,
        ),
    )
    #: Ids and corners [m] of the tags of a body, in its frame; empty for other boards.
    tags: tuple[Tag, ...] = key(
        "tags",
        TAGS_OF_BODY,
        "Tags of a body: of each its id and its corners [mm], clockwise from its top left; or { id, xyz_mm, rpy_deg, "
        "side_mm }, the pose of its middle with x to its right, y down, z into it.",
        default=(),
        absent="needed for a body",
        json="tags_m",
    )
    #: Standard deviation of the relative error of ``square``: how well the print was measured.
    sigma_scale: float = key(
        "sigma_scale_percent",
        _PERCENT,
        "Standard deviation of square_mm: how well you measured it [%].",
        default=0.003,
    )
    #: Standard deviation of each corner's place on the print, along x and along y [m].
    sigma_corner: float = key(
        "sigma_corner_mm",
        _MM,
        "Standard deviation of a corner's place on the print [mm].",
        default=5e-5,
        json="sigma_corner_m",
    )
    #: Standard deviation of the sag of the board's middle, along x and along y [m].
    sigma_warp: float = key(
        "sigma_warp_mm",
        _MM,
        "Standard deviation of the sag of the board's middle [mm].",
        default=1e-3,
        json="sigma_warp_m",
    )

    def __post_init__(self) -> None:
        """Check pattern, counts, lengths, markers and standard deviations; raises `CalibError`."""
        if self.pattern not in PATTERNS:
            raise CalibError(
                f"The board '{self.name}' has the pattern '{self.pattern}'; allowed are "
                f"{choices(PATTERNS)}{did_you_mean(self.pattern, PATTERNS)}."
            )
        if self.pattern == BODY:
            self._check_body()
            return
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
        if "marker" in PATTERNS[self.pattern]:
            # Rows of an asymmetric grid are moved by half a distance, and so may overlap.
            widest = np.sqrt(2.0) if self.pattern == ASYMMETRIC_CIRCLES else 1.0
            if not 0.0 < self.marker < widest * self.square:
                raise CalibError(
                    f"The board '{self.name}' has markers or circles of {self.marker:g} m in squares of "
                    f"{self.square:g} m; they are above 0 and smaller than the squares."
                )
        if "dictionary" in PATTERNS[self.pattern]:
            if not self.dictionary:
                raise CalibError(
                    f"The board '{self.name}' needs the dictionary of its markers, such as 'DICT_5X5_100'."
                )
            where = f"The board '{self.name}' with {self.columns} columns and {self.rows} rows"
            check_markers(self.dictionary, self.first_marker, self.markers, where)
        self._check_sigma()

    def _check_sigma(self) -> None:
        """Refuse standard deviations below 0; raises `CalibError`."""
        if min(self.sigma_scale, self.sigma_corner, self.sigma_warp) < 0.0:
            raise CalibError(
                f"The board '{self.name}' has a standard deviation below 0; 0 stands for a perfect print."
            )

    def _check_body(self) -> None:
        """Check the tags of a body, and keep them as tuples; a body does not sag. Raises `CalibError`."""
        if not self.tags:
            raise CalibError(
                f"The body '{self.name}' needs its tags: the id and the corners of each."
            )
        tags = tuple(tag_of_corners(int(number), np.array(c)) for number, c in self.tags)
        numbers = [number for number, _ in tags]
        twice = [number for number in numbers if numbers.count(number) > 1]
        if twice:
            raise CalibError(f"The body '{self.name}' has the tag {twice[0]} twice.")
        if not self.dictionary:
            raise CalibError(
                f"The body '{self.name}' needs the dictionary of its tags, such as 'DICT_APRILTAG_36h11'."
            )
        check_markers(self.dictionary, max(numbers), 1, f"The body '{self.name}'")
        object.__setattr__(self, "tags", tags)
        object.__setattr__(self, "sigma_warp", 0.0)
        self._check_sigma()

    def __copy__(self) -> Board:
        """Return the board itself: it cannot be changed."""
        return self

    @property
    def markers(self) -> int:
        """Number of markers or tags; 0 for a chessboard and for circles."""
        if self.pattern == BODY:
            return len(self.tags)
        squares = self.columns * self.rows
        return {CHARUCO: squares // 2, APRILTAG: squares, APRILGRID: squares}.get(self.pattern, 0)

    @property
    def marker_ids(self) -> Integers:
        """Ids of the markers or tags, in the order of their corners, shape (markers,)."""
        if self.pattern == BODY:
            return np.array([number for number, _ in self.tags])
        return self.first_marker + np.arange(self.markers)

    @property
    def border(self) -> int:
        """Width of the black border of the markers [bits]."""
        return 2 if self.pattern == APRILGRID else 1

    @property
    def marker_kind(self) -> str:
        """Dictionary and border of the markers: boards with the same share the markers that a picture shows."""
        return f"{self.dictionary}/{self.border}"

    @property
    def size(self) -> tuple[float, float]:
        """Width along x and height along y of the pattern, without margins [m].

        The small squares outside of the outermost tags of an aprilgrid are in the margin.
        """
        if self.pattern == BODY:
            width, height, _ = np.ptp(self.corners, axis=0).tolist()
            return width, height
        gap = self.square - self.marker
        if self.pattern == ASYMMETRIC_CIRCLES:
            return 2.0 * self.columns * self.square - gap, self.rows * self.square - gap
        if self.pattern in (*TAGS, CIRCLES):
            return self.columns * self.square - gap, self.rows * self.square - gap
        return self.columns * self.square, self.rows * self.square

    @property
    def corners(self) -> Array:
        """Positions of all corners in the board's frame, in the order of their ids, shape (n, 3) [m]."""
        if self.pattern == BODY:
            return np.array([corners for _, corners in self.tags]).reshape(-1, 3)
        if self.pattern in ROUND:
            row, column = np.indices((self.rows, self.columns)).reshape(2, -1)
            across = 2 * column + row % 2 if self.pattern == ASYMMETRIC_CIRCLES else column
            grid = self.marker / 2.0 + self.square * np.column_stack([across, row])
        elif self.pattern in TAGS:
            x = np.arange(self.columns) * self.square
            y = np.arange(self.rows) * self.square
            y = y[::-1] if self.pattern == APRILGRID else y
            square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
            square = square[[2, 3, 0, 1]] if self.pattern == APRILGRID else square
            origins = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 1, 2)
            grid = (origins + self.marker * square).reshape(-1, 2)
        else:
            x = np.arange(1, self.columns) * self.square
            y = np.arange(1, self.rows) * self.square
            grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        return np.column_stack([grid, np.zeros(len(grid))])

    @property
    def centre(self) -> Array:
        """Middle of the pattern in the board's frame, shape (3,) [m]."""
        if self.pattern == BODY:
            corners = self.corners
            return np.asarray((corners.min(axis=0) + corners.max(axis=0)) / 2.0)
        width, height = self.size
        return np.array([width / 2.0, height / 2.0, 0.0])

    @property
    def looks_same_turned(self) -> bool:
        """True if the print looks the same after half a turn, so that no picture shows which end is the first.

        It is so for a chessboard whose columns and rows are both even, or both odd, for a grid of circles, and for an
        asymmetric one with an even number of rows.
        """
        return len(self.orders_alike) > 1

    @property
    def orders_alike(self) -> Integers:
        """The orders in which the corners may be numbered so that the print looks the same, shape (k, n).

        In the order ``o`` the corner found as ``i`` is the corner ``o[i]`` of the board. The first order is that of the
        ids; the next is half a turn: ``n - 1 - i``. A square of odd squares, or of circles, also looks the same after a
        quarter.
        """
        ids = self.corner_ids()
        is_alike = {
            CHESSBOARD: (self.columns + self.rows) % 2 == 0,
            CIRCLES: True,
            ASYMMETRIC_CIRCLES: self.rows % 2 == 0,
        }
        if not is_alike.get(self.pattern, False):
            return ids[None]
        inner = 1 if self.pattern == CHESSBOARD else 0
        grid = ids.reshape(self.rows - inner, self.columns - inner)
        is_odd = self.pattern == CHESSBOARD and self.columns % 2 == 1
        is_quarter = self.columns == self.rows and (is_odd or self.pattern == CIRCLES)
        turns = (0, 2, 1, 3) if is_quarter else (0, 2)
        return np.stack([np.rot90(grid, turn).reshape(-1) for turn in turns])

    def corner_ids(self) -> Integers:
        """Return the ids 0 to n - 1 of the n corners, shape (n,): in rows along x, of tags clockwise from top left.

        Those of an aprilgrid begin at the lower left tag, and there at the lower right corner.
        """
        return np.arange(len(self.corners))


# Layout: squares and markers


def unfolded(board: Board) -> tuple[Array, Array]:
    """Return where the corners of a board are on a sheet: those of a flat one as they are, the tags of a body in rows.

    Args:
        board: The board, of n corners.

    Returns:
        x and y on the sheet, shape (n, 2) [m]; and the axes of the sheet at each corner in the board's frame,
        R_board_sheet, shape (n, 3, 3): x to the right on the tag, y down, z into it.
    """
    corners = board.corners
    if board.pattern != BODY:
        return corners[:, :2], np.tile(np.eye(3), (len(corners), 1, 1))
    tags = corners.reshape(-1, 4, 3)
    sides = np.linalg.norm(tags[:, 1] - tags[:, 0], axis=1)
    x = (tags[:, 1] - tags[:, 0]) / sides[:, None]
    z = np.cross(x, tags[:, 3] - tags[:, 0])
    z /= np.linalg.norm(z, axis=1, keepdims=True)
    R = np.stack([x, np.cross(z, x), z], axis=2)
    across = int(np.ceil(np.sqrt(len(tags))))
    row, column = np.divmod(np.arange(len(tags)), across)
    begin = _TAGS_APART * sides.max() * np.column_stack([column, row])
    places = (tags - tags[:, :1]) @ R
    return (begin[:, None] + places[:, :, :2]).reshape(-1, 2), np.repeat(R, 4, axis=0)


def white_squares(board: Board) -> Mask:
    """Return which squares of a chessboard or ChArUco board are white, shape (rows, columns).

    The first square is black; in the legacy layout with an even number of rows it is white.
    """
    row, column = np.indices((board.rows, board.columns))
    first = 1 if board.pattern == CHARUCO and board.legacy and board.rows % 2 == 0 else 0
    return np.asarray((row + column + first) % 2 == 1)


def cells_across(board: Board) -> int:
    """Return how many bits a marker of a board has along a side with its border; 0 without markers."""
    dictionary = dictionary_of(board.dictionary)
    return 0 if dictionary is None else dictionary.bits + 2 * board.border


def corner_signs(board: Board) -> Array:
    """Return for each of n inner corners 1 if its square towards +x, +y is white, -1 if it is black, shape (n,).

    At a corner of a tag of an aprilgrid the tag and a small square are black.
    """
    if board.pattern == APRILGRID:
        return np.tile([-1.0, 1.0, -1.0, 1.0], board.markers)
    return np.where(white_squares(board)[1:, 1:], 1.0, -1.0).reshape(-1)


def marker_outlines(board: Board) -> Array:
    """Return the corners of all markers or tags of a board.

    Args:
        board: The board.

    Returns:
        x and y in the board's frame, shape (markers, 4, 2) [m], in the order of the ids, each clockwise from its top
        left as OpenCV has it (x right, y down, from the pattern's outer corner), which in an aprilgrid is the lower
        right; shape (0, 4, 2) without markers.
    """
    if not board.markers:
        return np.zeros((0, 4, 2))
    if board.pattern in TAGS:
        return board.corners[:, :2].reshape(-1, 4, 2)
    row, column = np.nonzero(white_squares(board))
    margin = (board.square - board.marker) / 2.0
    first = np.column_stack([column, row]) * board.square + margin
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    return np.asarray(first[:, None] + board.marker * square)
