"""Descriptions of printed boards as TOML: what ``calib board`` writes and detection reads.

The file is made to be corrected by hand: every key has a comment, and lengths are in mm. A decimal number keeps its
digits on the way from mm to metres and back.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any

from calib.basics.files import read_bytes
from calib.basics.units import is_number
from calib.boards.board import CHARUCO, CHESSBOARD, PATTERNS, Board
from calib.errors import CalibError, FileError, choices, did_you_mean

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

#: Layouts of a ChArUco board by their names in the file; the value is `Board.legacy`.
LAYOUTS: Mapping[str, bool] = {"new": False, "legacy": True}

#: Names the file of a board that the other keys of a table correct.
_FILE = "file"

_HEAD = """\
# A printed board. Print at 100 %, glue the print to something flat and stiff, then measure it: over many squares, with
# a ruler or a caliper, divided by their number. Correct square_mm here, or let calib do it with what you measured:
#   calib board --measured "249.3 mm" board.toml
# A wrong square_mm makes all positions that the camera finds wrong by the same percentage.
"""


@dataclass(frozen=True, slots=True)
class _Key:
    """A key of the file."""

    #: Attribute of `Board`.
    attribute: str
    #: Reads a value; ValueError or TypeError for one of a wrong kind.
    read: Callable[[Any], Any]
    #: Writes a value as TOML.
    write: Callable[[Any], str]
    #: Values allowed, for messages.
    allowed: str
    #: What the key means.
    comment: str


def shifted(value: float, places: int) -> float:
    """Multiply a decimal number by a power of ten, without a change of its digits: 29.85 mm is 0.02985 m.

    Args:
        value: The number; its digits are those of its shortest representation.
        places: The power of ten, such as -3 for mm in metres.

    Returns:
        The double nearest to the decimal product.
    """
    return float(Decimal(repr(float(value))).scaleb(places))


def _number(places: int) -> Callable[[Any], float]:
    """Return a reader of numbers in a unit that is this power of ten of SI."""

    def read(value: Any) -> float:  # noqa: ANN401  what TOML holds
        if not is_number(value):
            raise ValueError
        return shifted(value, places)

    return read


def _whole(value: Any) -> int:  # noqa: ANN401
    """Read a whole number."""
    if isinstance(value, bool) or not isinstance(value, int):
        raise TypeError
    return value


def _text(value: Any) -> str:  # noqa: ANN401
    """Read a text."""
    if not isinstance(value, str):
        raise TypeError
    return value


def _legacy(value: Any) -> bool:  # noqa: ANN401
    """Read the layout."""
    if value not in LAYOUTS:
        raise ValueError
    return LAYOUTS[value]


def _layout_text(legacy: bool) -> str:
    """Write the layout."""
    return '"legacy"' if legacy else '"new"'


def _shown(places: int) -> Callable[[float], str]:
    """Return a writer of numbers in a unit that is this power of ten of SI."""
    return lambda value: repr(shifted(value, -places))


_KEYS: Mapping[str, _Key] = {
    "name": _Key(
        "name",
        _text,
        json.dumps,
        "a text in quotes",
        "Name, as in the column 'target' of a table of corners.",
    ),
    "pattern": _Key(
        "pattern",
        _text,
        json.dumps,
        f"one of {choices(PATTERNS)}",
        '"charuco", "chessboard" or "apriltag".',
    ),
    "columns": _Key(
        "columns",
        _whole,
        str,
        "a whole number",
        "Squares, or tags, along x: across, with the text of the page below the pattern.",
    ),
    "rows": _Key(
        "rows",
        _whole,
        str,
        "a whole number",
        "Squares, or tags, along y: down. Of a chessboard all squares count, not its inner corners.",
    ),
    "square_mm": _Key(
        "square",
        _number(-3),
        _shown(-3),
        "a number [mm]",
        "Side of a square as measured on the print; of tags the distance of their centres [mm].",
    ),
    "marker_mm": _Key(
        "marker",
        _number(-3),
        _shown(-3),
        "a number [mm]",
        "Side of a marker or tag with its black border, on the same print [mm].",
    ),
    "dictionary": _Key(
        "dictionary",
        _text,
        json.dumps,
        'the name of a dictionary in quotes, such as "DICT_5X5_100"',
        "Dictionary of the markers, named as OpenCV names it.",
    ),
    "first_marker": _Key(
        "first_marker", _whole, str, "a whole number", "Id of the first marker, at the upper left."
    ),
    "layout": _Key(
        "legacy",
        _legacy,
        _layout_text,
        f"one of {choices(LAYOUTS)}",
        '"new", or "legacy": as by OpenCV before 4.6, a marker in the first square. Alike for odd rows.',
    ),
    "sigma_scale_percent": _Key(
        "sigma_scale",
        _number(-2),
        _shown(-2),
        "a number [%]",
        "Standard deviation of square_mm: how well you measured it [%].",
    ),
    "sigma_corner_mm": _Key(
        "sigma_corner",
        _number(-3),
        _shown(-3),
        "a number [mm]",
        "Standard deviation of a corner's place on the print [mm].",
    ),
    "sigma_warp_mm": _Key(
        "sigma_warp",
        _number(-3),
        _shown(-3),
        "a number [mm]",
        "Standard deviation of the sag of the board's middle [mm].",
    ),
}

#: Keys that a chessboard has no use for.
_OF_MARKERS = ("marker_mm", "dictionary", "first_marker")

#: Keys that every description has, and those of markers.
_NEEDED = ("pattern", "columns", "rows", "square_mm")


def read_board(path: str | Path) -> Board:
    """Read the description of a board.

    Args:
        path: The TOML file, in UTF-8.

    Returns:
        The board.

    Raises:
        FileError: The file cannot be read or is not TOML.
        CalibError: A key is unknown, missing or has a wrong value, or the description makes no board.
    """
    data = read_bytes(path, "description of a board")
    try:
        table = parsed_toml(data.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:  # TOMLDecodeError is a ValueError
        raise FileError(f"{path}: this is not a TOML file: {error}") from error
    if _FILE in table:
        raise CalibError(
            f"{path}: '{_FILE}' names the description of a board in another file; this is one itself."
        )
    return board_of_table(table, str(path))


def parsed_toml(text: str) -> dict[str, Any]:
    """Parse a TOML text; ValueError if it is none."""
    table: dict[str, Any] = tomllib.loads(text)
    return table


def board_of_table(table: Mapping[str, Any], where: str, folder: str | Path = ".") -> Board:
    """Read the description of a board from a table of a TOML file.

    Args:
        table: The keys of a file of a board; or ``file``, the name of such a file, with keys that replace its.
        where: Begins the messages of errors: the file and table, ``"cell.toml, [board]"``.
        folder: Where a relative ``file`` begins: the folder of the file that holds the table.

    Returns:
        The board.

    Raises:
        FileError: The file named cannot be read or is not TOML.
        CalibError: A key is unknown, missing or has a wrong value, or the description makes no board.
    """
    values = {}
    for key, value in table.items():
        if key != _FILE:
            attribute = _key(key, where).attribute
            values[attribute] = _value(key, value, where)
    if _FILE in table:
        if not isinstance(table[_FILE], str):
            raise CalibError(
                f"{where}: '{_FILE}' is {table[_FILE]!r}; it must be a text in quotes."
            )
        return _made(_attributes(read_board(Path(folder) / table[_FILE])) | values, where)
    missing = [key for key in _NEEDED if key not in table]
    if table.get("pattern") != CHESSBOARD:
        missing += [key for key in ("marker_mm", "dictionary") if key not in table]
    if missing:
        raise CalibError(f"{where}: the description of a board lacks {choices(missing)}.")
    return _made(values, where)


def _key(name: str, where: str) -> _Key:
    """Return a key of the file by its name."""
    if name not in _KEYS:
        raise CalibError(
            f"{where}: a board has no key '{name}'{did_you_mean(name, _KEYS)}; its keys are "
            f"{choices(_KEYS, len(_KEYS))}."
        )
    return _KEYS[name]


def _value(name: str, value: Any, where: str) -> Any:  # noqa: ANN401
    """Read the value of a key, in SI units."""
    try:
        return _KEYS[name].read(value)
    except (ValueError, TypeError) as error:
        raise CalibError(
            f"{where}: '{name}' is {value!r}; it must be {_KEYS[name].allowed}."
        ) from error


def _attributes(board: Board) -> dict[str, Any]:
    """Return the attributes of a board by their names."""
    return {key.attribute: getattr(board, key.attribute) for key in _KEYS.values()}


def _made(values: Mapping[str, Any], where: str) -> Board:
    """Make a board of its attributes; the message of an error begins with ``where``."""
    try:
        return Board(**values)
    except CalibError as error:
        raise CalibError(f"{where}: {error}") from error


def board_toml(board: Board) -> str:
    """Write the description of a board.

    Lengths of at most 15 digits are read back as the same doubles.

    Args:
        board: The board.

    Returns:
        The content of a TOML file, with a comment for every key.
    """
    lines = [_HEAD]
    for name, key in _KEYS.items():
        if board.pattern == CHESSBOARD and name in _OF_MARKERS:
            continue
        if board.pattern != CHARUCO and name == "layout":
            continue
        value = key.write(getattr(board, key.attribute))
        lines.append(f"# {key.comment}\n{name} = {value}")
    return "\n".join([*lines, ""])
