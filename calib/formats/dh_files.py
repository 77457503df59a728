"""The DH rows of a robot before and after its calibration as files: CSV and Markdown in mm and deg, JSON in m and rad.

The rows are compared with the robots' poses; docs/convert.md describes the files.
"""

from __future__ import annotations

import csv
import io
import os
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib.errors import FileError, ModelError, choices
from calib.files import json_bytes, write_atomically
from calib.formats.notes import Note
from calib.formats.origins import one_line
from calib.model.dh import dh_table, near_parallel, taken_as_parallel
from calib.model.dh_table import EQUATIONS, HAYATI, MODIFIED, STANDARD, DHTable
from calib.robot.readback import TOLERANCE, column_ranges, spread_between
from calib.robot.robot import Robot, rigid_inverse

Array = NDArray[np.float64]

ENDINGS = (".csv", ".json", ".md")
"""What the name of a DH table may end in."""

#: Decimals of mm and deg: they hold poses to 1e-9 m and rad also where d is kilometres.
_DECIMALS = {"[mm]": 9, "[deg]": 14}

_DEG, _MM = np.pi / 180.0, 1e-3

_POSE = ("x [mm]", "y [mm]", "z [mm]", "roll [deg]", "pitch [deg]", "yaw [deg]")

#: The field of a row under each heading; the order is that of the factors.
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
        off = tables.deviation()
        allowed = TOLERANCE + tables._cost_of_parallels()
        if not off <= allowed:
            raise ModelError(
                f"{robot.urdf.source}: the rows in the convention '{convention}' put the tip up to {off:.1e} m or rad "
                f"away from the robot '{robot.name}'; {allowed:.1e} is allowed, so nothing is written. Choose the "
                "convention 'hayati', which has no far common normals."
            )
        return tables

    def drivers(self) -> list[tuple[str | None, float, float]]:
        """What is added to each row: the joint (None: held), times a factor, plus an offset [rad or m]."""
        robot = self.robot
        at_zero = robot.chain_values(np.zeros(len(robot.joint_names)))[0]
        found: list[tuple[str | None, float, float]] = []
        for row, offset in zip(robot.coupling, at_zero, strict=True):
            k = int(np.argmax(row != 0.0)) if row.any() else None
            name, factor = (None, 0.0) if k is None else (robot.joint_names[k], float(row[k]))
            found.append((name, factor, float(offset) + 0.0))
        return found

    def added(self) -> list[str]:
        """The same as formulas, such as ``"-2 * arm + 5 deg"``; of most joints the joint's own name."""
        texts = []
        for (driver, factor, offset), row in zip(self.drivers(), self.after.rows, strict=True):
            shown = f"{offset / _MM:+.12g} mm" if row.prismatic else f"{offset / _DEG:+.12g} deg"
            name = driver if factor == 1.0 else f"{factor:.12g} * {driver}"
            constant = f" {shown[0]} {shown[1:]}" if offset else ""
            texts.append(f"{name}{constant}" if driver else f"held at {shown.removeprefix('+')}")
        return texts

    @property
    def notes(self) -> tuple[Note, ...]:
        """What whoever types the rows in should know."""
        notes = []
        if self.after.convention != HAYATI:
            pairs = near_parallel(self.robot)
            if pairs:
                named = ", ".join(f"'{a}' and '{b}'" for a, b in pairs)
                longest = max(abs(row.d) for row in self.after.rows)
                notes.append(Note("nearly parallel axes", (named, longest)))
        pairs_of = zip(self.after.rows, self.added(), strict=True)
        others = [f"'{row.joint}' ({text})" for row, text in pairs_of if text != row.joint]
        if others:
            notes.append(Note("joints without value", (", ".join(others),)))
        return tuple(notes)

    def states(self) -> dict[str, DHTable]:
        """The tables that a file has, by what they are called: ``robot``, or before, after and change."""
        if self.before is None:
            return {"robot": self.after}
        before, after = self.before, self.after
        # After - before; of the constant poses before^-1 after.
        rows = tuple(
            replace(b, **{k: getattr(b, k) - getattr(a, k) for k in _NUMBERS})
            for a, b in zip(before.rows, after.rows, strict=True)
        )
        base = rigid_inverse(before.T_base_0) @ after.T_base_0
        tool = rigid_inverse(before.T_n_tip) @ after.T_n_tip
        change = DHTable(rows, base, tool, after.convention)
        return {"before": before, "after": after, "change": change}

    def deviation(self) -> float:
        """The largest difference of position [m] or of an entry of the rotation between rows and robots."""
        q = spread_between(column_ranges(self.robot), _POSES)
        values = self.robot.chain_values(q)
        off = np.abs(self.after.poses(values) - self.robot.poses(q)).max()
        if self.before is not None and self.nominal is not None:
            off = max(off, np.abs(self.before.poses(values) - self.nominal.poses(q)).max())
        return float(off)

    def _cost_of_parallels(self) -> float:
        """What taking axes as parallel may cost [m]: the angle times the arm's length, there and back."""
        robots = [one for one in (self.robot, self.nominal) if one is not None]
        lengths = [1.0 + np.linalg.norm(r.placements[:, :3, 3], axis=1).sum() for r in robots]
        costs = (2.0 * taken_as_parallel(r) * size for r, size in zip(robots, lengths, strict=True))
        return 0.0 if self.after.convention == HAYATI else float(max(costs))


def write_dh(tables: DHTables, path: str | os.PathLike[str], *, overwrite: bool = False) -> Path:
    """Write DH tables as CSV, JSON or Markdown, by the file's ending.

    Raises:
        FileError: Another ending, the file exists, or it cannot be written.
    """
    form = _FORMS.get(Path(path).suffix.lower())
    if form is None:
        raise FileError(
            f"{path}: a DH table is written as {choices(ENDINGS)}; end the name in one of these."
        )
    return write_atomically(path, form(tables), overwrite=overwrite)


def _legend(tables: DHTables) -> list[str]:
    """What it is and how the numbers are to be understood, line by line."""
    robot, factor = tables.robot, EQUATIONS[tables.after.convention]
    name, base, tip = map(one_line, (robot.name, robot.base, robot.tip))
    lines = [
        f"DH rows of {name}, {base} to {tip}, {tables.after.convention} convention, by calib",
        f"T_base_tip = base {factor[0]}_1 ... {factor[0]}_n tool, {factor}",
        "The joint's value is added to theta; that of a sliding joint to d. 'base' and 'tool' are constant poses, "
        "R = Rz(yaw) Ry(pitch) Rx(roll).",
    ]
    if tables.before is not None:
        lines.append(
            "change = after - before; of 'base' and 'tool' it is the pose before^-1 after."
        )
    return lines


# CSV and Markdown, out of the same records: what is under each heading


def _records(tables: DHTables) -> dict[str, list[dict[str, str]]]:
    """Every row of every table, base, the rows, tool, as text."""
    heads, added = _HEADS[tables.after.convention], tables.added()

    def pose(place: str, T: Array) -> dict[str, str]:
        values = (*T[:3, 3], *pin.rpy.matrixToRpy(T[:3, :3]))
        return {"row": place, **dict(zip(_POSE, map(_number, values, _POSE), strict=True))}

    found = {}
    for name, table in tables.states().items():
        rows = [
            {
                "row": str(i + 1),
                "joint": one_line(row.joint),
                "added to": "d" if row.prismatic else "theta",
                "value added": one_line(added[i]),
                **{head: _number(getattr(row, field), head) for head, field in heads.items()},
            }
            for i, row in enumerate(table.rows)
        ]
        found[name] = [pose("base", table.T_base_0), *rows, pose("tool", table.T_n_tip)]
    return found


def _number(value: float, head: str) -> str:
    """A number in the unit of its heading, without zeros at its end and without a sign before zero."""
    unit = head.split()[-1]
    scaled = value / (_DEG if unit == "[deg]" else _MM)
    return f"{round(scaled, _DECIMALS[unit]) + 0.0:.{_DECIMALS[unit]}f}".rstrip("0").rstrip(".")


def _csv(tables: DHTables) -> bytes:
    """A CSV file: comments, then one line for each row of each table."""
    heads = ["table", "row", "joint", "added to", "value added", *_HEADS[tables.after.convention]]
    text = io.StringIO(newline="")
    text.writelines(f"# {line}\n" for line in _legend(tables))
    writer = csv.DictWriter(text, [*heads, *_POSE], restval="", lineterminator="\n")
    writer.writeheader()
    for name, records in _records(tables).items():
        writer.writerows({"table": name, **one} for one in records)
    return text.getvalue().encode("utf-8", "backslashreplace")


def _markdown(tables: DHTables) -> bytes:
    """A Markdown file: a heading for each table, with the rows and the two poses under it."""
    heads = ["row", "joint", "added to", *_HEADS[tables.after.convention]]
    title, equation, *others = _legend(tables)
    lines = [f"# {_escaped(title)}", "", f"`{equation}`"]
    for line in others:
        lines += ["", _escaped(line)]
    for name, (base, *rows, tool) in _records(tables).items():
        lines += ["", f"## {name.capitalize()}", "", *_grid(heads, rows, left=3)]
        lines += ["", *_grid(["row", *_POSE], [base, tool], left=1)]
    return ("\n".join(lines) + "\n").encode("utf-8", "backslashreplace")


def _grid(heads: list[str], records: list[dict[str, str]], left: int) -> Iterator[str]:
    """A table of Markdown; all but the first columns are aligned to the right."""
    yield f"| {' | '.join(heads)} |"
    yield f"|{'---|' * left}{'---:|' * (len(heads) - left)}"
    for record in records:
        yield f"| {' | '.join(_escaped(record[head]) for head in heads)} |"


def _escaped(text: str) -> str:
    """Text that Markdown leaves as it is, on one line; an underscore inside a word means nothing to it."""
    text = one_line(text)
    return re.sub(r"([\\|*`<\[\]#~&]|(?<![A-Za-z0-9])_|_(?![A-Za-z0-9]))", r"\\\1", text)


def _json(tables: DHTables) -> bytes:
    """The tables in m and rad, every digit."""

    def of(table: DHTable | None) -> dict[str, Any] | None:
        if table is None:
            return None
        rows = [
            {
                "joint": row.joint,
                "added_to": "d" if row.prismatic else "theta",
                **{f"{name}_{unit}": getattr(row, name) for name, unit in _NUMBERS.items()},
            }
            for row in table.rows
        ]
        return {
            "T_base_0": table.T_base_0.tolist(),
            "rows": rows,
            "T_n_tip": table.T_n_tip.tolist(),
        }

    joints = [
        {
            "joint": row.joint,
            "type": "prismatic" if row.prismatic else "revolute",
            "driver": driver,
            "factor": factor,
            "offset_m" if row.prismatic else "offset_rad": offset,
        }
        for row, (driver, factor, offset) in zip(tables.after.rows, tables.drivers(), strict=True)
    ]
    robot, states = tables.robot, tables.states()
    content = {
        "schema": "dh 1",
        "convention": tables.after.convention,
        "equation": _legend(tables)[1],
        "robot": {"name": robot.name, "base": robot.base, "tip": robot.tip},
        "joints": joints,
        **{name: of(states.get(name)) for name in ("before", "after", "change")},
    }
    return json_bytes({**content, "after": of(tables.after)})


_FORMS: Mapping[str, Callable[[DHTables], bytes]] = dict(
    zip(ENDINGS, (_csv, _json, _markdown), strict=True)
)
