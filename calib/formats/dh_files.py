"""DH tables of a robot before and after its calibration, as files: CSV and Markdown in mm and deg, JSON in m and rad.

CSV and Markdown have as many decimals as the poses need to hold 1e-9 m and rad; the numbers as they are printed are
put back into rows and compared with the robot before the file appears. See docs/convert.md.
"""

from __future__ import annotations

import csv
import io
import os
import re
from collections.abc import Iterator, Mapping
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib.errors import FileError, choices
from calib.formats.dh_tables import AFTER, BEFORE, CHANGE, DHTables
from calib.formats.origins import one_line
from calib.model.dh_table import EQUATIONS, HAYATI, MODIFIED, STANDARD, DHRow, DHTable
from calib.model.files import json_bytes, write_atomically
from calib.model.readback import TOLERANCE

Array = NDArray[np.float64]
Record = dict[str, str]

SCHEMA = "dh 1"
"""What ``schema`` says in the JSON form."""

ENDINGS = (".csv", ".json", ".md")
"""What the name of a DH table may end in."""

#: Decimals of mm that one begins with, and the most; an angle gets three more: degrees act on metres.
_LEAST, _MOST, _MORE_FOR_DEG = 6, 14, 3

_POSE = ("x [mm]", "y [mm]", "z [mm]", "roll [deg]", "pitch [deg]", "yaw [deg]")

#: The field of a row that stands under each heading; the order is that of the factors.
_OWN = {"theta [deg]": "theta", "d [mm]": "d", "a [mm]": "a", "alpha [deg]": "alpha"}
_HEADS: Mapping[str, Mapping[str, str]] = {
    STANDARD: _OWN,
    HAYATI: {**_OWN, "beta [deg]": "beta"},
    MODIFIED: {
        "alpha(i-1) [deg]": "alpha",
        "a(i-1) [mm]": "a",
        "theta [deg]": "theta",
        "d [mm]": "d",
    },
}


def write_dh(tables: DHTables, path: str | os.PathLike[str], *, overwrite: bool = False) -> Path:
    """Write DH tables as CSV, JSON or Markdown, by the file's ending.

    Raises:
        FileError: Another ending, the file exists, or it cannot be written.
    """
    ending = Path(path).suffix.lower()
    if ending not in ENDINGS:
        raise FileError(
            f"{path}: a DH table is written as {choices(ENDINGS)}; end the name in one of these."
        )
    if ending == ".json":
        data = json_bytes(_json(tables))
    else:
        data = (_csv if ending == ".csv" else _markdown)(tables, _rounded(tables))
    return write_atomically(path, data, overwrite=overwrite)


def _title(tables: DHTables) -> str:
    """What it is, in one line."""
    robot = tables.robot
    name, base, tip = map(one_line, (robot.name, robot.base, robot.tip))
    return (
        f"DH rows of '{name}', '{base}' to '{tip}', in the convention '{tables.after.convention}'"
    )


def _legend(tables: DHTables) -> Iterator[str]:
    """How the numbers are to be understood, line by line."""
    factor = EQUATIONS[tables.after.convention]
    letter = factor[0]
    yield f"T_base_tip = base {letter}_1 ... {letter}_n tool, {factor}"
    yield (
        "The joint's value is added to theta; that of a sliding joint to d. 'base' and 'tool' are constant poses, "
        "R = Rz(yaw) Ry(pitch) Rx(roll)."
    )
    if tables.before is not None:
        yield "change = after - before; of 'base' and 'tool' it is the pose before^-1 after."
    yield from map(one_line, tables.remarks)


# CSV and Markdown, out of the same records


def _rounded(tables: DHTables) -> list[Record]:
    """Every row of every table with as few decimals as hold the poses."""
    for decimals in count(_LEAST):
        records = _records(tables, decimals)
        off = tables.deviation(*_from_records(records, tables.after.convention))
        if off <= TOLERANCE / 2 or decimals == _MOST:
            break
    return records


def _records(tables: DHTables, decimals: int) -> list[Record]:
    """Every row of every table: base, the rows, tool."""
    heads = _HEADS[tables.after.convention]

    def numbers(values: Mapping[str, float]) -> Record:
        return {
            head: _fixed(value, decimals + (_MORE_FOR_DEG if "[deg]" in head else 0))
            for head, value in values.items()
        }

    def pose(place: str, T: Array) -> Record:
        values = (*(1e3 * T[:3, 3]), *np.degrees(pin.rpy.matrixToRpy(T[:3, :3])))
        return {"table": name, "row": place, **numbers(dict(zip(_POSE, values, strict=True)))}

    records = []
    for name, table in tables.states():
        records.append(pose("base", table.T_base_0))
        for i, (row, joint) in enumerate(zip(table.rows, tables.joints, strict=True), start=1):
            record = {
                "table": name,
                "row": str(i),
                "joint": one_line(row.joint),
                "added to": "d" if row.prismatic else "theta",
                "value added": one_line(joint.text),
            }
            values = {head: getattr(row, field) / _si(head) for head, field in heads.items()}
            records.append({**record, **numbers(values)})
        records.append(pose("tool", table.T_n_tip))
    return records


def _from_records(records: list[Record], convention: str) -> tuple[DHTable | None, DHTable]:
    """The rows before, None where there are none, and after, out of the numbers as they are printed."""
    heads = _HEADS[convention]
    found: dict[str, list[Record]] = {}
    for record in records:
        found.setdefault(record["table"], []).append(record)

    def pose(record: Record) -> Array:
        values = [float(record[head]) * _si(head) for head in _POSE]
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = pin.rpy.rpyToMatrix(*values[3:]), values[:3]
        return T

    def table(name: str) -> DHTable:
        base, *rows, tool = found[name]
        return DHTable(
            tuple(
                DHRow(
                    row["joint"],
                    row["added to"] == "d",
                    **{field: float(row[head]) * _si(head) for head, field in heads.items()},
                )
                for row in rows
            ),
            pose(base),
            pose(tool),
            convention,
        )

    if BEFORE in found:
        return table(BEFORE), table(AFTER)
    return None, table("robot")


def _si(head: str) -> float:
    """One unit of a column in rad or m."""
    return np.pi / 180.0 if "[deg]" in head else 1e-3


def _fixed(value: float, decimals: int) -> str:
    """A number with that many decimals, and no sign before zero."""
    text = f"{value:.{decimals}f}"
    return text.lstrip("-") if float(text) == 0.0 else text


def _csv(tables: DHTables, records: list[Record]) -> bytes:
    """A CSV file: comments, then one line for each row of each table; no zeros at the ends of numbers."""
    heads = ["table", "row", "joint", "added to", "value added"]
    heads += [*_HEADS[tables.after.convention], *_POSE]
    text = io.StringIO(newline="")
    for line in (_title(tables), *_legend(tables)):
        text.write(f"# {line}\n")
    writer = csv.DictWriter(text, heads, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(
        {key: value.rstrip("0").rstrip(".") if "[" in key else value for key, value in one.items()}
        for one in records
    )
    return text.getvalue().encode("utf-8", "backslashreplace")


def _markdown(tables: DHTables, records: list[Record]) -> bytes:
    """A Markdown file: a heading for each table, with the rows and the two poses under it."""
    rows_heads = ["row", "joint", "added to", *_HEADS[tables.after.convention]]
    equation, *others = _legend(tables)
    lines = [f"# {_escaped(_title(tables))}", "", f"`{equation}`"]
    for line in others:
        lines += ["", _escaped(line)]
    for table in dict.fromkeys(record["table"] for record in records):
        here = [record for record in records if record["table"] == table]
        rows = [record for record in here if "joint" in record]
        poses = [record for record in here if "joint" not in record]
        lines += ["", f"## {table.capitalize()}", ""]
        lines += [*_grid(rows_heads, rows, left=3), "", *_grid(["pose", *_POSE], poses, left=1)]
    return ("\n".join(lines) + "\n").encode("utf-8", "backslashreplace")


def _grid(heads: list[str], records: list[Record], left: int) -> Iterator[str]:
    """A table of Markdown, its columns aligned in the text too."""
    keys = ["row" if head == "pose" else head for head in heads]
    cells = [heads, *([_escaped(record[key]) for key in keys] for record in records)]
    widths = [max(len(row[k]) for row in cells) for k in range(len(heads))]
    rule = ["-" * w if k < left else "-" * (w - 1) + ":" for k, w in enumerate(widths)]
    for row in (cells[0], rule, *cells[1:]):
        padded = [
            cell.ljust(w) if k < left else cell.rjust(w)
            for k, (cell, w) in enumerate(zip(row, widths, strict=True))
        ]
        yield f"| {' | '.join(padded)} |"


def _escaped(text: str) -> str:
    """Text that Markdown leaves as it is, on one line; an underscore inside a word means nothing to it."""
    text = one_line(text)
    return re.sub(r"([\\|*`<\[\]#~&]|(?<![A-Za-z0-9])_|_(?![A-Za-z0-9]))", r"\\\1", text)


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
    by_name = {name: _json_table(table) for name, table in tables.states()}
    robot = tables.robot
    return {
        "schema": SCHEMA,
        "convention": tables.after.convention,
        "equation": next(_legend(tables)),
        "robot": {"name": robot.name, "base": robot.base, "tip": robot.tip},
        "joints": joints,
        BEFORE: by_name.get(BEFORE),
        AFTER: _json_table(tables.after),
        CHANGE: by_name.get(CHANGE),
        "remarks": list(tables.remarks),
    }


def _json_table(table: DHTable) -> dict[str, Any]:
    """One table."""
    return {
        "T_base_0": table.T_base_0.tolist(),
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
            for row in table.rows
        ],
        "T_n_tip": table.T_n_tip.tolist(),
    }
