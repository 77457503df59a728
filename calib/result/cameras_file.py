"""Cameras and printed boards of a result as tables of its JSON file, and back; see docs/result-json.md."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from calib.basics.arrays import Array
from calib.basics.json_files import Json, JsonLayout, Key
from calib.basics.records import json_key
from calib.basics.values import ReadOnlyMapping
from calib.boards.board import Board
from calib.camera.camera import UNKNOWN, Camera
from calib.camera.lenses import LENSES


def _numbers(entries: Any) -> Array | None:  # noqa: ANN401  any JSON
    """Return numbers from a list of the file, `UNKNOWN` where it has null; None for null."""
    if entries is None:
        return None
    return np.array([UNKNOWN if entry is None else float(entry) for entry in entries])


#: The fields of a camera; a null among its numbers is infinite.
_CAMERA = JsonLayout(
    {Camera: {"values": Key("values", read=_numbers), "sigma": Key("sigma", read=_numbers)}}, {}
)


def cameras_table(cameras: Mapping[str, Camera]) -> list[dict[str, Any]]:
    """Return cameras as a list for the file.

    Args:
        cameras: By the names of their stations; ``""`` for the only one, or that of all others.

    Returns:
        A table for each; ``lens_names`` are the names of its numbers, ``values``. The standard deviation ``sigma`` of
        one that is not known is infinite.
    """
    table = []
    for station, camera in cameras.items():
        lens_names = LENSES[camera.lens].names
        table.append({"station": station, **_CAMERA.table(camera), "lens_names": lens_names})
    return table


def read_cameras(table: Iterable[Json]) -> Mapping[str, Camera]:
    """Return cameras from their tables in the file, by the names of their stations."""
    cameras = {row["station"]: Camera(**_CAMERA.values(Camera, row)) for row in table}
    return ReadOnlyMapping(cameras)


def boards_table(boards: Mapping[str, Board]) -> list[dict[str, Any]]:
    """Return printed boards as a list for the file.

    Args:
        boards: By the names of their targets; ``""`` for the only one, or that of all others.
    """
    table = []
    for target, board in boards.items():
        entries = {json_key(field): getattr(board, field.name) for field in fields(board)}
        table.append({"target": target, **entries})
    return table


def read_boards(table: Iterable[Json]) -> Mapping[str, Board]:
    """Return printed boards from their tables in the file, by the names of their targets."""
    boards = {}
    for row in table:
        arguments = {field.name: row[json_key(field)] for field in fields(Board)}
        boards[row["target"]] = Board(**arguments)
    return ReadOnlyMapping(boards)
