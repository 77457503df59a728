"""Cameras and printed boards of a cell file: its tables ``[camera]`` and ``[cameras.NAME]``, and those of boards."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from calib.boards.board import Board
from calib.boards.board_file import board_of_table
from calib.camera.camera import Camera
from calib.camera.camera_file import camera_of_table
from calib.errors import CalibError, FileError

#: A camera or a board.
_Described = TypeVar("_Described")

#: Reads one from its table: (table, where it stands, for messages; folder where names of files begin).
_ReadTable = Callable[[Mapping[str, Any], str, Path], _Described]


def cameras_of_tables(
    single: Mapping[str, Any] | None, several: Mapping[str, Any], path: Path
) -> dict[str, Camera]:
    """Read the cameras of a cell file.

    Args:
        single: The table ``[camera]``; None without one.
        several: The tables ``[cameras.NAME]`` by their names.
        path: The cell file; names of files in the tables begin at its folder.

    Returns:
        The cameras by name; ``""`` for ``[camera]``.

    Raises:
        FileError: A file that a table names cannot be read.
        CalibError: A table is no description of a camera.
    """
    return _described(camera_of_table, _by_heading("camera", single, several), path)


def boards_of_tables(
    single: Mapping[str, Any] | None, several: Mapping[str, Any], path: Path
) -> dict[str, Board]:
    """Read the printed boards of a cell file.

    Args:
        single: The table ``[board]``; None without one.
        several: The tables ``[boards.NAME]`` by their names.
        path: The cell file; names of files in the tables begin at its folder.

    Returns:
        The boards by name; ``""`` for ``[board]``.

    Raises:
        FileError: A file that a table names cannot be read.
        CalibError: A table is no description of a board.
    """
    return _described(board_of_table, _by_heading("board", single, several), path)


def _by_heading(
    word: str, single: Mapping[str, Any] | None, several: Mapping[str, Any]
) -> dict[str, tuple[str, Mapping[str, Any]]]:
    """Return all tables of cameras or of boards with their headings, by the names in the cell.

    One with a name is called by it unless it says otherwise.

    Args:
        word: ``"camera"`` or ``"board"``.
        single: The table without a name; None without one.
        several: Those with names.
    """
    result: dict[str, tuple[str, Mapping[str, Any]]] = {}
    if single is not None:
        result[""] = (f"[{word}]", single)
    for name, table in several.items():
        if not name:
            raise CalibError(f"[{word}s] has a table without a name; write [{word}].")
        result[name] = (f"[{word}s.{name}]", {"name": name, **table})
    return result


def _described(
    read: _ReadTable[_Described], tables: Mapping[str, tuple[str, Mapping[str, Any]]], path: Path
) -> dict[str, _Described]:
    """Read cameras or boards from their tables.

    Args:
        read: Reads one.
        tables: Heading and table of each by name.
        path: The cell file, for messages and for names of files.
    """
    try:
        return {
            name: read(table, heading, path.parent) for name, (heading, table) in tables.items()
        }
    except FileError as error:
        raise FileError(f"{path}: {error}") from error
