"""The DH rows of a robot before and after its calibration as files: CSV and Markdown in mm and deg, JSON in m and rad.

The rows are compared with the robots' poses. CSV and Markdown have as many decimals as the poses need to hold 1e-9 m
and rad; the numbers as they are printed are put back into rows and compared too, before the file appears. See
docs/convert.md.
"""

from __future__ import annotations

import csv
import io
import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib.errors import FileError, ModelError, choices
from calib.files import json_bytes, write_atomically
from calib.formats.origins import one_line
from calib.model.dh import dh_table, near_parallel, taken_as_parallel
from calib.model.dh_table import EQUATIONS, HAYATI, MODIFIED, STANDARD, DHRow, DHTable
from calib.robot.readback import TOLERANCE, column_ranges, spread_between
from calib.robot.robot import Robot, read_only, rigid_inverse

Array = NDArray[np.float64]
Record = dict[str, str]

BEFORE, AFTER, CHANGE = "before", "after", "change"
"""What the tables are called; a robot without a nominal one has a single one, ``"robot"``."""

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

#: The numbers of a row and their units in JSON.
_NUMBERS = {"theta": "rad", "d": "m", "a": "m", "alpha": "rad", "beta": "rad"}

#: Joint values that poses are compared at.
_POSES = 64

#: A row's d longer than this beside nearly parallel axes is worth a remark [m].
_FAR = 2.0


class RowJoint(NamedTuple):
    """What is added to a row: factor * value of the driver (the joint, or what it mimics; None: held) + offset."""

    joint: str
    prismatic: bool
    driver: str | None
    factor: float
    offset: float

    @property
    def text(self) -> str:
        """As a formula, such as ``"-2 * arm + 5 deg"``; of most joints the joint's own name."""
        unit, size = ("mm", 1e3) if self.prismatic else ("deg", 180.0 / np.pi)
        if self.driver is None:
            return f"held at {size * self.offset:.12g} {unit}"
        name = self.driver if self.factor == 1.0 else f"{self.factor:.12g} * {self.driver}"
        if self.offset == 0.0:
            return name
        return f"{name} {'-' if self.offset < 0 else '+'} {size * abs(self.offset):.12g} {unit}"


@dataclass(frozen=True, slots=True, eq=False)
class DHTables:
    """The DH rows of a robot beside those of its nominal state; both hold the poses of their robots.

    ``nominal`` is the same chain before the calibration, or None; the free choices of ``after`` are as in ``before``.
    """

    robot: Robot
    nominal: Robot | None
    after: DHTable
    before: DHTable | None

    @classmethod
    def of(cls, robot: Robot, nominal: Robot | None = None, convention: str = STANDARD) -> DHTables:
        """The rows in one of `calib.model.dh_table.CONVENTIONS`, compared with the poses of both robots.

        Raises:
            ModelError: No such convention, the robots have other joints, or the rows do not hold the robot.
        """
        after = dh_table(robot, convention, like=nominal)
        before = None if nominal is None else dh_table(nominal, convention)
        tables = cls(robot, nominal, after, before)
        off = tables.deviation(before, after)
        allowed = TOLERANCE + _by_parallels(robot, nominal, convention)
        if not off <= allowed:
            raise ModelError(
                f"{robot.urdf.source}: the rows in the convention '{convention}' put the tip up to {off:.1e} m or rad "
                f"away from the robot '{robot.name}'; {allowed:.1e} is allowed, so nothing is written. Choose the "
                "convention 'hayati', which has no far common normals."
            )
        return tables

    @property
    def joints(self) -> tuple[RowJoint, ...]:
        """What is added to each row."""
        robot = self.robot
        at_zero = robot.chain_values(np.zeros(len(robot.joint_names)))[0]
        found = []
        for joint, row, offset in zip(robot.joints, robot.coupling, at_zero, strict=True):
            driven = np.flatnonzero(row)
            driver = robot.joint_names[driven[0]] if len(driven) else None
            factor = float(row[driven[0]]) if len(driven) else 0.0
            slides = joint.type == "prismatic"
            found.append(RowJoint(joint.name, slides, driver, factor, float(offset) + 0.0))
        return tuple(found)

    @property
    def remarks(self) -> tuple[str, ...]:
        """What whoever types the rows in should know, sentence by sentence."""
        robot, nominal, after = self.robot, self.nominal, self.after
        remarks = []
        if after.convention != HAYATI:
            pairs = near_parallel(robot)
            longest = max(abs(row.d) for row in after.rows)
            if pairs:
                named = ", ".join(
                    f"'{a}' and '{b}' ({np.degrees(angle):.2g} deg)"
                    for (a, b), angle in pairs.items()
                )
                far = f", here up to {longest:,.3g} m, and" if longest > _FAR else " and"
                remarks.append(
                    f"Axes that are nearly parallel: {named}. The common normal of such axes lies anywhere: the d and "
                    f"theta of their rows may be large{far} cancel over the rows. Enter every digit, and all rows "
                    "together; the convention 'hayati' has no such rows."
                )
            angle = max(taken_as_parallel(one) for one in (robot, nominal) if one is not None)
            if angle > TOLERANCE:
                cost = 1e6 * _by_parallels(robot, nominal, after.convention)
                remarks.append(
                    f"Axes that the URDF's rounding leaves {angle:.1e} rad out of parallel are taken as parallel, so "
                    f"that the rows differ from the URDF by less than {cost:.2g} micrometres."
                )
        others = [j for j in self.joints if j.text != j.joint]
        if others:
            named = ", ".join(f"'{j.joint}' ({j.text})" for j in others)
            remarks.append(f"Joints without a value of their own: {named}.")
        return tuple(remarks)

    def states(self) -> list[tuple[str, DHTable]]:
        """The tables that a file has, by what they are called: one, or before, after and change."""
        if self.before is None:
            return [("robot", self.after)]
        before, after = self.before, self.after
        # After - before; of the constant poses before^-1 after.
        rows = tuple(
            replace(b, **{k: getattr(b, k) - getattr(a, k) for k in _NUMBERS})
            for a, b in zip(before.rows, after.rows, strict=True)
        )
        base, tool = (
            read_only(rigid_inverse(a) @ b)
            for a, b in ((before.T_base_0, after.T_base_0), (before.T_n_tip, after.T_n_tip))
        )
        change = DHTable(rows, base, tool, after.convention)
        return [(BEFORE, before), (AFTER, after), (CHANGE, change)]

    def deviation(self, before: DHTable | None, after: DHTable) -> float:
        """The largest difference of position [m] or of an entry of the rotation between rows and robots."""
        q = spread_between(column_ranges(self.robot), _POSES)
        values = self.robot.chain_values(q)
        off = float(np.abs(after.poses(values) - self.robot.poses(q)).max())
        if before is not None and self.nominal is not None:
            off = max(off, float(np.abs(before.poses(values) - self.nominal.poses(q)).max()))
        return off


def _by_parallels(robot: Robot, nominal: Robot | None, convention: str) -> float:
    """What taking axes as parallel may cost [m]: the angle times the arm's length, there and back."""
    if convention == HAYATI:
        return 0.0
    return max(
        2.0
        * taken_as_parallel(one)
        * float(1.0 + np.linalg.norm(one.placements[:, :3, 3], axis=1).sum())
        for one in (robot, nominal)
        if one is not None
    )


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
                **{f"{name}_{unit}": getattr(row, name) for name, unit in _NUMBERS.items()},
            }
            for row in table.rows
        ],
        "T_n_tip": table.T_n_tip.tolist(),
    }
