"""Prints of boards: the scale that was measured on one, and prints as they really are.

A real print is stretched by the printer, sags, and each corner is a little off:

    x = s_x x_0,  y = s_y y_0,  z = w_x (1 - xi^2) + w_y (1 - eta^2)

with x_0 and y_0 as described, xi and eta from -1 to 1 across the pattern. The scales differ because a printer feeds
paper at another scale than it prints across it. A sag is positive if the middle is farther from the camera than the
edges.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np

from calib.basics.arrays import Array, read_only
from calib.basics.units import LENGTH, parse_amount
from calib.basics.value_forms import shift_decimal
from calib.basics.values import Value
from calib.boards.board import Board
from calib.errors import CalibError

# Measured prints

#: Standard deviation of a length read from a ruler [m].
READING = 0.0003

#: Smallest relative standard deviation of a measurement: paper changes its size with humidity.
_BEST = 5e-4

#: Largest relative difference of a measured length from that of the whole pattern.
_NEAR = 0.05

#: Example of a measured length, for messages.
_EXAMPLE = "249.3 mm / 10"


@dataclass(frozen=True, slots=True)
class PrintScale:
    """A measurement of the scale of a print."""

    #: Length measured [m].
    measured: float
    #: That length as drawn [m].
    drawn: float
    #: Number of squares in it, or of distances between tags; None for the whole pattern of a grid of tags.
    squares: int | None

    @property
    def scale(self) -> float:
        """Measured length over the drawn one."""
        return self.measured / self.drawn

    @property
    def sigma(self) -> float:
        """Standard deviation of the scale, at least that of paper, which humidity stretches."""
        return max(READING / self.measured, _BEST)


def print_scale(board: Board, text: str) -> PrintScale:
    """Determine the scale of a print by a length measured on it: of the whole pattern, one square, or several.

    Args:
        board: The board as drawn.
        text: ``"249.3 mm"``, or over a number of squares ``"249.3 mm / 10"``.

    Returns:
        The scale of the print.

    Raises:
        CalibError: It is not a length; the board has fewer squares; or, without a number of squares, it is close to
            none or to several of the pattern's width, its height and a square.
    """
    amount, slash, squares = text.partition("/")
    length = parse_amount(amount, "--measured", LENGTH, _EXAMPLE)
    is_count = re.fullmatch(r"\s*[0-9]{1,4}\s*", squares)
    if length <= 0.0 or (slash and not is_count):
        raise CalibError(
            f'--measured was given as "{text}"; it must be a length above 0, and may be divided by the number of '
            f'squares: "{_EXAMPLE}".'
        )
    if is_count:
        count = int(squares)
        if not 1 <= count <= max(board.columns, board.rows):
            raise CalibError(
                f"--measured says {count} squares; the board has {board.columns} columns and {board.rows} rows."
            )
        return PrintScale(length, count * board.square, count)
    # The length may be that of the pattern's width, of its height, or of a square.
    candidates = []
    for extent, count in zip(board.size, (board.columns, board.rows), strict=True):
        is_whole = abs(extent - count * board.square) < 1e-9
        candidates.append(PrintScale(length, extent, count if is_whole else None))
    candidates.append(PrintScale(length, board.square, 1))
    near = [scale for scale in candidates if abs(scale.scale - 1.0) < _NEAR]
    if len({scale.drawn for scale in near}) != 1:
        width, height = board.size
        raise CalibError(
            f"--measured is {1e3 * length:g} mm. The pattern was drawn {1e3 * width:g} mm wide and {1e3 * height:g} mm "
            f"high, of squares of {1e3 * board.square:g} mm; over how many squares did you measure? Write "
            f'"{1e3 * length:g} mm / {max(1, round(length / board.square))}".'
        )
    return near[0]


def rescaled(board: Board, scale: PrintScale) -> Board:
    """Return a board with the lengths of its print as measured, rounded to a micrometre.

    Args:
        board: The board as drawn.
        scale: What was measured on the print.

    Returns:
        The board, ``sigma_scale`` that of the measurement.
    """
    return replace(
        board,
        square=shift_decimal(round(1e3 * (board.square * scale.scale), 3), -3),
        marker=shift_decimal(round(1e3 * (board.marker * scale.scale), 3), -3),
        sigma_scale=shift_decimal(round(1e2 * scale.sigma, 3), -2),
    )


# Prints with their errors

#: Decimals to which the coordinates of corners in one row or column agree [m].
_DIGITS = 9


@dataclass(frozen=True, slots=True, eq=False)
class Print(Value):
    """A board as it was printed, with the errors that its description does not have."""

    #: The description.
    board: Board
    #: Length on the print divided by that in the description, along x and along y.
    scale: tuple[float, float] = (1.0, 1.0)
    #: Sag of the middle along x and along y [m].
    warp: tuple[float, float] = (0.0, 0.0)
    #: Displacement of each corner on the print, shape (n, 3) [m]; None: they are not displaced.
    offsets: Array | None = None
    #: True if it was printed mirrored: what lies at x is drawn at width - x. Corners stay where they are described.
    mirrored: bool = False

    def surface(self, x: Array, y: Array) -> Array:
        """Return the height of the surface at points of the description.

        Args:
            x: Along the columns in the description, any shape (...) [m].
            y: Along the rows, of the same shape [m].

        Returns:
            z on the print, shape (...) [m].
        """
        width, height = self.board.size
        xi = 2.0 * x / width - 1.0
        eta = 2.0 * y / height - 1.0
        along_x, along_y = self.warp
        return np.asarray(along_x * (1.0 - xi**2) + along_y * (1.0 - eta**2))

    def points(self, x: Array, y: Array) -> Array:
        """Return where points of the description lie on the print.

        Args:
            x: Along the columns in the description, shape (n,) [m].
            y: Along the rows, shape (n,) [m].

        Returns:
            In the board's frame, shape (n, 3) [m].
        """
        along_x, along_y = self.scale
        return np.column_stack([along_x * x, along_y * y, self.surface(x, y)])

    def displacement(self, x: Array, y: Array) -> Array:
        """Return the displacement of points of the description within the print, interpolated bilinearly.

        Args:
            x: Along the columns in the description, shape (n,) [m].
            y: Along the rows, shape (n,) [m].

        Returns:
            Along x and y, shape (n, 2) [m]; beyond the outermost corners that of the nearest point between them.
        """
        if self.offsets is None:
            return np.zeros((len(x), 2))
        from scipy.ndimage import map_coordinates  # imported late, as few boards have offsets

        corners = self.board.corners
        columns, column = np.unique(corners[:, 0].round(_DIGITS), return_inverse=True)
        rows, row = np.unique(corners[:, 1].round(_DIGITS), return_inverse=True)
        place = [
            np.interp(y, rows, np.arange(len(rows))),
            np.interp(x, columns, np.arange(len(columns))),
        ]
        result = np.empty((len(x), 2))
        for axis in range(2):
            grid = np.zeros((len(rows), len(columns)))
            grid[row, column] = self.offsets[:, axis]
            result[:, axis] = map_coordinates(grid, place, order=1)
        return result

    @property
    def corners(self) -> Array:
        """Places of the corners on the print, in the board's frame, in the order of their ids, shape (n, 3) [m]."""
        x, y, _ = self.board.corners.T
        corners = self.points(x, y)
        if self.offsets is not None:
            corners = corners + self.offsets
        return corners


def draw_print(board: Board, seed: int | np.random.Generator) -> Print:
    """Draw a print with the errors that a board's description allows: scale, warp, and each corner's place.

    Args:
        board: The description, whose ``sigma_scale``, ``sigma_warp`` and ``sigma_corner`` are the standard deviations.
        seed: Seed or generator of the random numbers.
    """
    rng = np.random.default_rng(seed)
    scale = 1.0 + board.sigma_scale * rng.standard_normal(2)
    warp = board.sigma_warp * rng.standard_normal(2)
    in_plane = rng.normal(scale=board.sigma_corner, size=(len(board.corners), 2))
    offsets = np.column_stack([in_plane, np.zeros(len(in_plane))])
    return Print(
        board,
        scale=(float(scale[0]), float(scale[1])),
        warp=(float(warp[0]), float(warp[1])),
        offsets=read_only(offsets),
    )
