"""DH tables as text: CSV and Markdown in mm and deg, out of the same records; see `dh_files`."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib.compensate.dh_tables import DHTables
from calib.model.dh_conventions import CONVENTIONS, EQUATIONS, HAYATI, MODIFIED, DHRows, Row
from calib.model.robot import read_only, rigid_inverse

Array = NDArray[np.float64]

BEFORE, AFTER, CHANGE = "before", "after", "change"
"""What the tables of a file are called; a robot without a nominal one has a single one, ``"robot"``."""

#: An angle gets so many decimals more than a length: degrees act on metres.
_MORE_FOR_DEG = 3

_POSE = ("x [mm]", "y [mm]", "z [mm]", "roll [deg]", "pitch [deg]", "yaw [deg]")

#: The field of a row that stands under each heading; the order is that of the factors.
_HEADS: Mapping[str, Mapping[str, str]] = {
    convention: (
        {
            "alpha(i-1) [deg]": "alpha",
            "a(i-1) [mm]": "a",
            "theta [deg]": "theta",
            "d [mm]": "d",
        }
        if convention == MODIFIED
        else {
            "theta [deg]": "theta",
            "d [mm]": "d",
            "a [mm]": "a",
            "alpha [deg]": "alpha",
            **({"beta [deg]": "beta"} if convention == HAYATI else {}),
        }
    )
    for convention in CONVENTIONS
}

Record = dict[str, str]


def _title(tables: DHTables) -> str:
    """What it is, in one line."""
    name, base, tip = map(_one_line, (tables.name, tables.base, tables.tip))
    return f"DH rows of '{name}', '{base}' to '{tip}', in the convention '{tables.convention}'"


def _one_line(text: str) -> str:
    """Text without what could end its line."""
    return "".join(c if c.isprintable() else "?" for c in text)


def legend(tables: DHTables) -> Iterator[str]:
    """How the numbers are to be understood, line by line."""
    factor = EQUATIONS[tables.convention]
    letter = factor[0]
    yield f"T_base_tip = base {letter}_1 ... {letter}_n tool, {factor}"
    yield (
        "The joint's value is added to theta; that of a sliding joint to d. 'base' and 'tool' are constant poses, "
        "R = Rz(yaw) Ry(pitch) Rx(roll)."
    )
    if tables.before is not None:
        yield "change = after - before; of 'base' and 'tool' it is the pose before^-1 after."
    yield from map(_one_line, tables.remarks)


def _records(tables: DHTables, decimals: int) -> list[Record]:
    """Every row of every table, rounded."""
    heads = _HEADS[tables.convention]

    def numbers(values: Mapping[str, float]) -> Record:
        return {
            head: _fixed(value, decimals + (_MORE_FOR_DEG if "[deg]" in head else 0))
            for head, value in values.items()
        }

    records = []
    for table, rows in states(tables):
        for place, T in (("base", rows.T_base_0), ("tool", rows.T_n_tip)):
            pose = (*(1e3 * T[:3, 3]), *np.degrees(pin.rpy.matrixToRpy(T[:3, :3])))
            record = {"table": table, "row": place, **numbers(dict(zip(_POSE, pose, strict=True)))}
            if place == "tool":
                for i, (row, joint) in enumerate(
                    zip(rows.rows, tables.joints, strict=True), start=1
                ):
                    values = {
                        head: getattr(row, field) * (180.0 / np.pi if "[deg]" in head else 1e3)
                        for head, field in heads.items()
                    }
                    records.append(
                        {
                            "table": table,
                            "row": str(i),
                            "joint": _one_line(row.joint),
                            "added to": "d" if row.prismatic else "theta",
                            "value added": _one_line(joint.text),
                            **numbers(values),
                        }
                    )
            records.append(record)
    return records


def states(tables: DHTables) -> list[tuple[str, DHRows]]:
    """The tables that a file has, by what they are called: one, or before, after and change."""
    if tables.before is None:
        return [("robot", tables.after)]
    change = _change(tables.before, tables.after)
    return [(BEFORE, tables.before), (AFTER, tables.after), (CHANGE, change)]


def _change(before: DHRows, after: DHRows) -> DHRows:
    """After - before; of the constant poses before^-1 after."""
    rows = tuple(
        replace(
            b,
            **{k: getattr(b, k) - getattr(a, k) for k in ("theta", "d", "a", "alpha", "beta")},
        )
        for a, b in zip(before.rows, after.rows, strict=True)
    )
    return DHRows(
        after.convention,
        rows,
        read_only(rigid_inverse(before.T_base_0) @ after.T_base_0),
        read_only(rigid_inverse(before.T_n_tip) @ after.T_n_tip),
    )


def _fixed(value: float, decimals: int) -> str:
    """A number with that many decimals, and no sign before zero."""
    text = f"{value:.{decimals}f}"
    return text.lstrip("-") if float(text) == 0.0 else text


def from_records(records: Iterable[Record], convention: str) -> tuple[DHRows | None, DHRows]:
    """The rows before and after, out of a file's numbers.

    Args:
        records: Of a file, see `csv_records` and `markdown_records`.
        convention: That of the file.

    Returns:
        Rows before, None where the file has none, and after, in m and rad.
    """
    tables: dict[str, dict[str, Record]] = {}
    for record in records:
        tables.setdefault(record["table"], {})[record["row"]] = record
    heads = _HEADS[convention]

    def rows(table: dict[str, Record]) -> DHRows:
        found = []
        for i in range(1, len(table) - 1):
            record = table[str(i)]
            values = {
                field: float(record[head]) * (np.pi / 180.0 if "[deg]" in head else 1e-3)
                for head, field in heads.items()
            }
            found.append(Row(record["joint"], record["added to"] == "d", **values))
        return DHRows(convention, tuple(found), _pose(table["base"]), _pose(table["tool"]))

    before = rows(tables[BEFORE]) if BEFORE in tables else None
    return before, rows(tables[AFTER] if AFTER in tables else tables["robot"])


def _pose(record: Record) -> Array:
    """A constant pose out of its six numbers."""
    numbers = [float(record[head]) for head in _POSE]
    T = np.eye(4)
    T[:3, :3] = pin.rpy.rpyToMatrix(*np.radians(numbers[3:]))
    T[:3, 3] = 1e-3 * np.array(numbers[:3])
    return T


# CSV


def csv_bytes(tables: DHTables, decimals: int) -> bytes:
    """A CSV file: comments, then one line for each row of each table.

    Args:
        tables: What it says.
        decimals: Of a length in mm; of an angle in deg three more.
    """
    heads = ["table", "row", "joint", "added to", "value added"]
    heads += [*_HEADS[tables.convention], *_POSE]
    text = io.StringIO(newline="")
    for line in (_title(tables), *legend(tables)):
        text.write(f"# {line}\n")
    writer = csv.DictWriter(text, heads, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(
        {key: _short(value) if "[" in key else value for key, value in record.items()}
        for record in _records(tables, decimals)
    )
    return text.getvalue().encode("utf-8", "backslashreplace")


def _short(number: str) -> str:
    """A decimal number without the zeros at its end."""
    return number.rstrip("0").rstrip(".")


def csv_records(data: bytes) -> list[Record]:
    """What a CSV file says."""
    # Not splitlines: that ends a line at characters that a joint's name may have in it.
    lines = data.decode().split("\n")
    return list(csv.DictReader(line for line in lines if not line.startswith("#")))


# Markdown


def markdown_bytes(tables: DHTables, decimals: int) -> bytes:
    """A Markdown file: a heading for each table, with the rows and the two poses under it.

    Args:
        tables: What it says.
        decimals: Of a length in mm; of an angle in deg three more.
    """
    rows_heads = ["row", "joint", "added to", *_HEADS[tables.convention]]
    lines = [f"# {_escaped(_title(tables))}"]
    equation, *others = legend(tables)
    lines += ["", f"`{equation}`"]
    for line in others:
        lines += ["", _escaped(line)]
    records = _records(tables, decimals)
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
    text = _one_line(text)
    return re.sub(r"([\\|*`<\[\]#~&]|(?<![A-Za-z0-9])_|_(?![A-Za-z0-9]))", r"\\\1", text)


def markdown_records(data: bytes) -> list[Record]:
    """What a Markdown file says."""
    records: list[Record] = []
    table, heads = "", [""]
    for line in data.decode().split("\n"):
        if line.startswith("## "):
            table = line[3:].lower()
        if not line.startswith("| "):
            heads = []
            continue
        cells = [cell.strip() for cell in re.split(r"(?<!\\)(?:\\\\)*\|", line)[1:-1]]
        if not heads:
            heads = ["row" if cell == "pose" else cell for cell in cells]
        elif not cells[0].startswith("-"):
            cells = [re.sub(r"\\(.)", r"\1", cell) for cell in cells]
            records.append({"table": table, **dict(zip(heads, cells, strict=True))})
    return records
