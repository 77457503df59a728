"""What `calib board` says: the text on the printed page, what was drawn or measured, and what to do next."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable
from pathlib import Path

from calib.boards.board import (
    APRILGRID,
    APRILTAG,
    ASYMMETRIC_CIRCLES,
    BODY,
    CHARUCO,
    CHESSBOARD,
    CIRCLES,
    ROUND,
    TAGS,
    Board,
)
from calib.boards.board_page import NO_PAPER, PAPERS, Sheet
from calib.boards.printed import READING, PrintScale
from calib.show.lines import fill, plural

#: Names of the patterns.
_PATTERNS = {
    CHARUCO: "ChArUco board",
    CHESSBOARD: "Chessboard",
    APRILTAG: "Grid of AprilTags",
    BODY: "Body of tags",
    APRILGRID: "AprilGrid of Kalibr",
    CIRCLES: "Grid of circles",
    ASYMMETRIC_CIRCLES: "Asymmetric grid of circles",
}

#: Maximum length of a board's name on the page [characters].
_LONGEST_NAME = 20

#: What each output is for, by the ending of the file.
_OUTPUTS = {
    "pdf": "to print",
    "svg": "the same drawing, for other programs",
    "toml": "the description, which calib reads",
}

#: Deviations above this mean that the printer scaled the page [%].
_FAR_PERCENT = 1.0

#: Deviations above this mean that the description was only a guess [%].
_RESIZED_PERCENT = 10.0

_NEW_LAYOUT = (
    "Note: OpenCV before 4.6 lays out an even number of rows differently; programs that use it see the markers but no "
    "corners. With an odd number of rows all versions agree."
)

_LEGACY_LAYOUT = (
    "Note: with an even number of rows in the legacy layout, programs with OpenCV 4.6 or newer see the markers but no "
    "corners, unless they are set to that layout. calib reads the layout from the description."
)

_AMBIGUOUS = (
    "Note: this board looks the same after half a turn, so only the robot's poses show which end is the first. A "
    "chessboard of one column more or less, or an asymmetric grid with an odd number of rows, shows it."
)

_FITTED_TO_PAGE = (
    "Note: the print is more than 1 % off; was it printed to fit the page? It can be used as it is if width and height "
    "are off by the same percentage: measure both."
)


def _mm(length: float) -> str:
    """Write a length in millimetres with as many digits as it has, to a micrometre."""
    return f"{round(1e3 * length, 3):g} mm"


def _squares(board: Board) -> str:
    """Describe columns, rows and the size of squares or tags [mm], and a legacy layout."""
    if board.pattern in (*TAGS, *ROUND):
        what = "tags" if board.pattern in TAGS else "circles"
        return f"{board.columns} x {board.rows} {what} of {_mm(board.marker)} every {_mm(board.square)}"
    text = f"{board.columns} x {board.rows} squares of {_mm(board.square)}"
    is_legacy = board.pattern == CHARUCO and board.legacy and board.rows % 2 == 0
    return f"{text}, legacy layout" if is_legacy else text


def _markers(board: Board) -> str:
    """Describe the markers; an empty text without any."""
    if not board.markers:
        return ""
    last = board.first_marker + board.markers - 1
    text = f"{board.dictionary}, ids {board.first_marker} to {last}"
    if board.pattern == CHARUCO:
        text = f"markers of {_mm(board.marker)}, {text}"
    return text


def description(board: Board) -> str:
    """Describe a board in one line, without its name."""
    parts = [_squares(board), _markers(board)]
    return f"{_PATTERNS[board.pattern]}: {'; '.join(part for part in parts if part)}"


def page_lines(board: Board) -> list[str]:
    """Return the lines of text that are printed below the pattern: name and size, markers, and what to check."""
    name = textwrap.shorten(board.name, _LONGEST_NAME, placeholder="...")
    lines = [f"{name}: {_squares(board)}", _markers(board)]
    lines.append("Print at 100 %: both rulers must be true. Then measure the print.")
    return [line for line in lines if line]


def drawn_text(board: Board, sheet: Sheet, paper: str, files: Iterable[Path]) -> list[str]:
    """Return what was drawn and written, and what to do next.

    Args:
        board: The board.
        sheet: The sheet it was drawn on.
        paper: Name of the paper, ``"a4"``; `NO_PAPER` for a sheet of any size.
        files: The files written.

    Returns:
        Lines of at most 100 columns.
    """
    files = list(files)
    width, height = board.size
    lines = [fill(f"{description(board)}.")]
    if paper == NO_PAPER:
        where = f"on a sheet of {_mm(sheet.width)} x {_mm(sheet.height)}"
    else:
        name = paper.upper() if paper in ("a4", "a3") else paper
        is_portrait = sheet.width <= PAPERS[paper][0]
        where = f"on {name} paper, {'portrait' if is_portrait else 'landscape'}"
    corners = plural(len(board.corners), "corner")
    lines.append(fill(f"{corners}; {_mm(width)} wide and {_mm(height)} high, {where}."))
    note = ""
    if board.looks_same_turned:
        note = _AMBIGUOUS
    elif board.pattern == CHARUCO and board.rows % 2 == 0:
        note = _LEGACY_LAYOUT if board.legacy else _NEW_LAYOUT
    lines += [fill(note)] if note else []
    lines.append("")
    longest = max(len(str(path)) for path in files)
    for path in files:
        lines.append(f"Written: {str(path).ljust(longest)}  {_OUTPUTS[path.suffix[1:]]}")
    toml = next((path for path in files if path.suffix == ".toml"), files[0].with_suffix(".toml"))
    return [*lines, "", *_next_steps(board, files[0], toml)]


def _next_steps(board: Board, pdf: Path, toml: Path) -> list[str]:
    """Return lines on what to do: print, glue and measure the board, and the command that takes the measured width."""
    width = board.size[0]
    over = f"{board.columns} squares"
    if board.pattern in (*TAGS, *ROUND):
        over = (
            f"{board.columns} {'tags' if board.pattern in TAGS else 'circles'}, from edge to edge"
        )
    steps = [
        f"Print {pdf} at 100 % ('actual size', not 'fit to page'). Check that its rulers are as long as they say.",
        "Glue the print onto something flat and stiff, such as glass or an aluminium panel; cardboard bends.",
        f"Measure the pattern across with a ruler or a caliper: {over}, drawn {_mm(width)} wide. Give calib what you "
        "read, because every length that the camera finds depends on it:",
    ]
    lines = ["Next:"]
    for number, step in enumerate(steps, 1):
        lines.append(fill(f"{number}. {step}", "", "   "))
    word = f'"{toml}"' if " " in str(toml) else str(toml)
    lines.append(f'     calib board {word} --measured "{_mm(width)}"')
    return lines


def measured_text(drawn: Board, measured: Board, scale: PrintScale, path: Path) -> list[str]:
    """Return what a measurement of the print changed in the description.

    Args:
        drawn: The board before.
        measured: The board with its size as measured.
        scale: What was measured, over how many squares, and the scale that follows.
        path: The description, which was written.

    Returns:
        Lines of at most 100 columns.
    """
    over = "the whole pattern" if scale.squares is None else plural(scale.squares, "square")
    change = 100.0 * (scale.scale - 1.0)
    is_apart = drawn.pattern in (*TAGS, *ROUND)
    what = "distances between centres" if is_apart else "squares"
    text = (
        f"{_mm(scale.measured)} over {over}: {what} of {_mm(measured.square)}, {change:+.2f} % from the "
        f"{_mm(drawn.square)} in {path}."
    )
    lines = [fill(text)]
    lines.append(
        fill(
            f"Their standard deviation is {100.0 * measured.sigma_scale:g} %, for a length read to {_mm(READING)}; if "
            "you measured more precisely, correct it in the file."
        )
    )
    if _FAR_PERCENT < abs(change) < _RESIZED_PERCENT:
        lines.append(fill(_FITTED_TO_PAGE))
    return [*lines, f"Written: {path}"]
