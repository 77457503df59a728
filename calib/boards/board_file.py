"""Descriptions of printed boards as TOML: what ``calib board`` writes and detection reads.

The file is meant to be corrected by hand: every key has a comment, and lengths are in mm. A decimal number keeps its
digits when it is converted from mm to metres and back.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from calib.basics.files import read_bytes
from calib.boards.board import CHESSBOARD, PATTERNS, Board
from calib.boards.board_keys import Key, keys_of
from calib.errors import CalibError, FileError, choices, did_you_mean

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

#: Names the file of a board that the other keys of a table correct.
_FILE = "file"

#: Keys that every description needs, and those that it needs besides if the board has markers.
_NEEDED = ("pattern", "columns", "rows", "square_mm")
_NEEDED_FOR_MARKERS = ("marker_mm", "dictionary")

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
        table = tomllib.loads(data.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:  # TOMLDecodeError is a ValueError
        raise FileError(f"{path}: this is not a TOML file: {error}") from error
    if _FILE in table:
        raise CalibError(
            f"{path}: '{_FILE}' names the description of a board in another file; this is one itself."
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
    values = _read_values(table, where)
    described: Board | None = None
    if _FILE in table:
        if not isinstance(table[_FILE], str):
            raise CalibError(
                f"{where}: '{_FILE}' is {table[_FILE]!r}; it must be a text in quotes."
            )
        described = read_board(Path(folder) / table[_FILE])
    else:
        missing = [name for name in _NEEDED if name not in table]
        if table.get("pattern") != CHESSBOARD:
            missing += [name for name in _NEEDED_FOR_MARKERS if name not in table]
        if missing:
            raise CalibError(f"{where}: the description of a board lacks {choices(missing)}.")
    try:
        return Board(**values) if described is None else replace(described, **values)
    except CalibError as error:
        raise CalibError(f"{where}: {error}") from error


def _read_values(table: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Return the values of a table in SI units, by the names of the attributes."""
    rows = {row.name: (field.name, row) for field, row in keys_of(Board)}
    values = {}
    for name, given in table.items():
        if name == _FILE:
            continue
        if name not in rows:
            raise CalibError(
                f"{where}: a board has no key '{name}'{did_you_mean(name, rows)}; its keys are "
                f"{choices(rows, len(rows))}."
            )
        attribute, row = rows[name]
        values[attribute] = row.form.read(given, f"{where}: '{name}'")
    return values


def board_toml(board: Board) -> str:
    """Write the description of a board.

    Lengths of at most 15 digits are read back as the same doubles.

    Args:
        board: The board.

    Returns:
        The content of a TOML file, with a comment for every key.
    """
    lines = [_HEAD]
    for name, (row, value) in _written(board).items():
        lines.append(f"# {row.help}\n{name} = {_toml(value)}")
    return "\n".join([*lines, ""])


def correct_toml(text: str, board: Board) -> str:
    """Change the numbers in the description of a board, and keep everything else in it, including comments.

    Args:
        text: The content of the file.
        board: The board as it is to be described.

    Returns:
        The new content.
    """
    table = tomllib.loads(text)
    for name, (_, value) in _written(board).items():
        if isinstance(value, float) and name in table and table[name] != value:
            line = rf"(?m)^([ \t]*{name}[ \t]*=[ \t]*)[^\s#]+"
            text = re.sub(line, rf"\g<1>{value!r}", text, count=1)
    if board_toml(board_of_table(tomllib.loads(text), "")) != board_toml(board):
        # A key is missing, or something else differs.
        return board_toml(board)
    return text


def _written(board: Board) -> dict[str, tuple[Key, Any]]:
    """Return the keys of a board's pattern by their names, each with its value as a file has it."""
    result = {}
    for field, row in keys_of(board):
        if field.name not in _OF_SOME_PATTERNS or field.name in PATTERNS[board.pattern]:
            result[row.name] = (row, row.form.write(getattr(board, field.name)))
    return result


def _toml(value: object) -> str:
    """Return a text or a number as TOML."""
    return json.dumps(value) if isinstance(value, str) else repr(value)
