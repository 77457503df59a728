"""Cameras and printed boards of a result as tables of its JSON file, and back; see docs/result-json.md."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from calib.basics.arrays import Array
from calib.basics.json_files import Json
from calib.basics.values import ReadOnlyMapping
from calib.boards.board import Board
from calib.boards.board_keys import json_key
from calib.camera.camera import UNKNOWN, Camera
from calib.camera.lenses import LENSES


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
        row = {
            "station": station,
            "name": camera.name,
            "width_px": camera.width,
            "height_px": camera.height,
            "lens": camera.lens,
            "lens_names": LENSES[camera.lens].names,
            "values": camera.values,
            "sigma": camera.sigma,
        }
        table.append(row)
    return table


def read_cameras(table: Iterable[Json]) -> Mapping[str, Camera]:
    """Return cameras from their tables in the file, by the names of their stations."""
    cameras = {}
    for row in table:
        cameras[row["station"]] = Camera(
            name=row["name"],
            width=row["width_px"],
            height=row["height_px"],
            lens=row["lens"],
            values=_numbers(row["values"]),
            sigma=_numbers(row["sigma"]),
        )
    return ReadOnlyMapping(cameras)


def _numbers(entries: Any) -> Array | None:  # noqa: ANN401  any JSON
    """Return numbers from a list of the file, `UNKNOWN` where it has null; None for null."""
    if entries is None:
        return None
    return np.array([UNKNOWN if entry is None else float(entry) for entry in entries])


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
