"""Descriptions of printed boards as TOML: what ``calib board`` writes and detection reads.

The file is meant to be corrected by hand: every key has a comment, and lengths are in mm. A decimal number keeps its
digits when it is converted from mm to metres and back.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from calib.basics.files import read_bytes
from calib.basics.records import Key, keys_of, parse_toml, read_parts, toml_lines, toml_values
from calib.basics.value_forms import TEXT
from calib.boards.board import CHARUCO, PATTERNS, Board
from calib.errors import CalibError, FileError, choices

#: Names the file of a board that the other keys of a table correct.
_FILE = "file"
_FILE_KEY = Key(_FILE, TEXT, "The name of a description that the other keys correct.", part=_FILE)

#: Keys that a description needs besides its pattern, by the attributes of patterns that have them.
_NEEDED = {
    "columns": "columns",
    "rows": "rows",
    "square": "square_mm",
    "marker": "marker_mm",
    "dictionary": "dictionary",
    "tags": "tags",
}

#: Attributes that only some patterns have.
_OF_SOME_PATTERNS = frozenset().union(*PATTERNS.values())

_HEAD = """\
# A printed board. Print at 100 %, glue the print to something flat and stiff, then measure it: over many squares, with
# a ruler or a caliper, divided by their number. Correct square_mm here, or let calib do it with what you measured:
#   calib board --measured "249.3 mm" board.toml
# A wrong square_mm makes all positions that the camera finds wrong by the same percentage.
"""


def read_board(path: str | Path) -> Board:
    """Read the description of a board.

    Args:
        path: The TOML file, in UTF-8.

    Returns:
        The board.

    Raises:
        FileError: The file cannot be read or is not TOML.
        CalibError: A key is unknown, missing or has a wrong value, or the description does not make a board.
    """
    data = read_bytes(path, "description of a board")
    try:
        table = parse_toml(data.decode("utf-8-sig"))
    except ValueError as error:
        raise FileError(f"{path}: this is not a TOML file: {error}") from error
    if _FILE in table:
        raise CalibError(
            f"{path}: '{_FILE}' names the description of a board in another file, but this is one itself."
        )
    return board_of_table(table, str(path))


def board_of_table(table: Mapping[str, Any], where: str, folder: str | Path = ".") -> Board:
    """Read the description of a board from a table of a TOML file.

    Args:
        table: The keys of a file of a board; or ``file``, the name of such a file, with keys that replace those in it.
        where: Begins the messages of errors: the file and table, ``"cell.toml, [board]"``.
        folder: Where a relative ``file`` begins: the folder of the file that holds the table.

    Returns:
        The board.

    Raises:
        FileError: The file named cannot be read or is not TOML.
        CalibError: A key is unknown, missing or has a wrong value, or the description does not make a board.
    """
    try:
        return _board_of_keys(table, folder)
    except FileError:
        raise
    except CalibError as error:
        raise CalibError(f"{where}: {error}") from error


def _board_of_keys(table: Mapping[str, Any], folder: str | Path) -> Board:
    """Read a board from the keys of a table, and of the file in ``folder`` that it may name; see `board_of_table`.

    Raises CalibError without the place of the fault, or FileError for the file that is named.
    """
    rows = [replace(row, part=field.name, needed=False) for field, row in keys_of(Board)]
    values = read_parts([_FILE_KEY, *rows], table)
    file = values.pop(_FILE, None)
    if file is not None:
        return replace(read_board(Path(folder) / file), **values)
    missing = [] if "pattern" in table else ["pattern"]
    of_pattern = PATTERNS.get(str(table.get("pattern")), PATTERNS[CHARUCO])
    missing += [
        name for attribute, name in _NEEDED.items() if attribute in of_pattern and name not in table
    ]
    if missing:
        raise CalibError(f"the description of a board lacks {choices(missing)}.")
    return Board(**values)


def board_toml(board: Board) -> str:
    """Write the description of a board.

    Lengths of at most 15 digits are read back as the same doubles.

    Args:
        board: The board.

    Returns:
        The content of a TOML file, with a comment for every key.
    """
    attributes = _OF_SOME_PATTERNS - {*PATTERNS[board.pattern]}
    unused = {row.name for field, row in keys_of(Board) if field.name in attributes}
    return "\n".join([_HEAD, *toml_lines(board, without=unused), ""])


def correct_toml(text: str, board: Board) -> str:
    """Change the numbers in the description of a board, and keep everything else in it, including comments.

    Args:
        text: The content of a file that describes a board.
        board: The board as it is to be described.

    Returns:
        The new content; that of `board_toml`, without the user's comments, if other numbers alone do not describe the
        board, because a key is missing or a text differs.
    """
    table = parse_toml(text)
    for name, value in toml_values(board).items():
        if isinstance(value, float) and name in table and table[name] != value:
            line = rf"(?m)^([ \t]*{name}[ \t]*=[ \t]*)[^\s#]+"
            text = re.sub(line, rf"\g<1>{value!r}", text, count=1)
    if board_toml(board_of_table(parse_toml(text), "")) != board_toml(board):
        # A key is missing, or something else differs.
        return board_toml(board)
    return text
