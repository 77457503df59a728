"""DH tables as files: CSV and Markdown in mm and deg, JSON in m and rad. See docs/convert.md.

CSV and Markdown have as many decimals as the poses need to hold 1e-9 m and rad; every file is read back, and its rows
compared with the robot, before it appears.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.compensate.dh_tables import DHTables, deviation
from calib.compensate.dh_text import (
    AFTER,
    BEFORE,
    CHANGE,
    Record,
    csv_bytes,
    csv_records,
    from_records,
    legend,
    markdown_bytes,
    markdown_records,
    states,
)
from calib.errors import FileError, choices
from calib.model.dh_conventions import DHRows, Row
from calib.model.files import write_atomically
from calib.model.json_file import json_bytes
from calib.model.readback import TOLERANCE

Array = NDArray[np.float64]

SCHEMA = "dh 1"
"""What ``schema`` says in the JSON form."""

ENDINGS = (".csv", ".json", ".md")
"""What the name of a DH table may end in."""

#: Decimals of mm that one begins with, and the most.
_LEAST, _MOST = 6, 14


def write_dh(tables: DHTables, path: str | os.PathLike[str], *, overwrite: bool = False) -> Path:
    """Write DH tables as CSV, JSON or Markdown, by the file's ending.

    Raises:
        FileError: Another ending, the file exists, or it cannot be written.
        ModelError: The file, read back, does not hold the robot.
    """
    return write_atomically(path, dh_bytes(tables, path), overwrite=overwrite)


def dh_bytes(tables: DHTables, path: str | os.PathLike[str]) -> bytes:
    """The bytes of such a file, read back and compared with the robot.

    Raises:
        FileError: Another ending.
        ModelError: The file, read back, does not hold the robot.
    """
    forms: dict[str, Callable[[], bytes]] = {
        ".csv": lambda: _rounded(tables, csv_bytes, csv_records),
        ".json": lambda: json_bytes(_json(tables)),
        ".md": lambda: _rounded(tables, markdown_bytes, markdown_records),
    }
    ending = Path(path).suffix.lower()
    if ending not in forms:
        message = (
            f"{path}: a DH table is written as {choices(forms)}; end the name in one of these."
        )
        raise FileError(message)
    data = forms[ending]()
    readers = {".csv": csv_records, ".md": markdown_records}
    found = (
        _from_json(data)
        if ending == ".json"
        else from_records(readers[ending](data), tables.convention)
    )
    tables.check(*found, str(path))
    return data


def _rounded(
    tables: DHTables,
    write: Callable[[DHTables, int], bytes],
    read: Callable[[bytes], list[Record]],
) -> bytes:
    """A text file with as few decimals as hold the poses."""
    for decimals in count(_LEAST):
        data = write(tables, decimals)
        before, after = from_records(read(data), tables.convention)
        off = deviation(after, tables.values, tables.after.poses(tables.values))
        if before is not None and tables.before is not None:
            off = max(off, deviation(before, tables.values, tables.before.poses(tables.values)))
        if off <= TOLERANCE / 2 or decimals == _MOST:
            break
    return data


# JSON


def _json(tables: DHTables) -> dict[str, Any]:
    """The tables in m and rad, every digit."""
    joints = [
        {
            "joint": j.joint,
            "type": "prismatic" if j.prismatic else "revolute",
            "driver": j.driver,
            "factor": j.factor,
            "offset_m" if j.prismatic else "offset_rad": j.offset,
        }
        for j in tables.joints
    ]
    by_name = dict(states(tables))
    return {
        "schema": SCHEMA,
        "convention": tables.convention,
        "equation": next(legend(tables)),
        "robot": {"name": tables.name, "base": tables.base, "tip": tables.tip},
        "joints": joints,
        BEFORE: _json_rows(by_name[BEFORE]) if BEFORE in by_name else None,
        AFTER: _json_rows(tables.after),
        CHANGE: _json_rows(by_name[CHANGE]) if CHANGE in by_name else None,
        "remarks": list(tables.remarks),
    }


def _json_rows(rows: DHRows) -> dict[str, Any]:
    """One table."""
    return {
        "T_base_0": rows.T_base_0.tolist(),
        "rows": [
            {
                "joint": row.joint,
                "added_to": "d" if row.prismatic else "theta",
                "theta_rad": row.theta,
                "d_m": row.d,
                "a_m": row.a,
                "alpha_rad": row.alpha,
                "beta_rad": row.beta,
            }
            for row in rows.rows
        ],
        "T_n_tip": rows.T_n_tip.tolist(),
    }


def _from_json(data: bytes) -> tuple[DHRows | None, DHRows]:
    """The rows before and after, out of a JSON file."""
    table = json.loads(data)

    def rows(entry: Mapping[str, Any]) -> DHRows:
        found = tuple(
            Row(
                row["joint"],
                row["added_to"] == "d",
                *(row[key] for key in ("theta_rad", "d_m", "a_m", "alpha_rad", "beta_rad")),
            )
            for row in entry["rows"]
        )
        poses = (np.array(entry["T_base_0"]), np.array(entry["T_n_tip"]))
        return DHRows(table["convention"], found, *poses)

    before = None if table[BEFORE] is None else rows(table[BEFORE])
    return before, rows(table[AFTER])
