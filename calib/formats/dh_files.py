"""The DH rows of a robot before and after its calibration as files: CSV in mm and deg, JSON in m and rad.

The rows are compared with the robots' poses; docs/convert.md describes the files.
"""

from __future__ import annotations

import csv
import io
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import pinocchio as pin

from calib.errors import FileError, ModelError, choices
from calib.files import json_bytes, write_atomically
from calib.model.dh import (
    EQUATIONS,
    HAYATI,
    MODIFIED,
    STANDARD,
    DHTable,
    dh_table,
    near_parallel,
    taken_as_parallel,
)
from calib.robot.ranges import column_ranges, spread_between
from calib.robot.readback import TOLERANCE
from calib.robot.robot import Robot, rigid_inverse

Code = Literal[
    "arm not certain",
    "nominal hash",
    "not linearised",
    "base displaced",
    "flange displaced",
    "other lines kept",
    "other lines left out",
    "joints without origin",
    "geometry alone",
    "nearly parallel axes",
    "joints without value",
]


class Note(NamedTuple):
    """What a conversion has to say: a code and its values, in SI units; `calib.text.convert` has the sentences."""

    code: Code
    values: tuple[str | float, ...] = ()


ENDINGS = (".csv", ".json")
"""What the name of a DH table may end in."""

#: What one is in SI units, and its decimals: they hold poses to 1e-9 m and rad also where d is kilometres.
_UNITS = {"[mm]": (1e-3, 9), "[deg]": (np.pi / 180.0, 14)}

_POSE = ("x [mm]", "y [mm]", "z [mm]", "roll [deg]", "pitch [deg]", "yaw [deg]")

#: The field of a row under each heading; the order is that of the factors.
_OWN = {"theta [deg]": "theta", "d [mm]": "d", "a [mm]": "a", "alpha [deg]": "alpha"}
_HEADS = {
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
        """The rows in one of `calib.model.dh.CONVENTIONS`, compared with the poses of both robots.

        Raises:
            ModelError: No such convention, the robots have other joints, or the rows do not hold the robot.
        """
        after = dh_table(robot, convention, like=nominal)
        before = None if nominal is None else dh_table(nominal, convention)
        q = spread_between(column_ranges(robot), _POSES)
        for one, table in ((robot, after), (nominal, before)):
            if one is None or table is None:
                continue
            off = float(np.abs(table.poses(robot.chain_values(q)) - one.poses(q)).max())
            # Axes that are taken as parallel cost the angle times the arm's length, there and back.
            length = 1.0 + np.linalg.norm(one.placements[:, :3, 3], axis=1).sum()
            cost = 0.0 if convention == HAYATI else 2.0 * taken_as_parallel(one) * length
            if not off <= TOLERANCE + cost:
                raise ModelError(
                    f"{one.urdf.source}: the rows in the convention '{convention}' put the tip up to {off:.1e} m or "
                    f"rad away from the robot '{one.name}', so nothing is written. Choose the convention 'hayati', "
                    "which has no far common normals."
                )
        return cls(robot, nominal, after, before)

    def added(self) -> list[tuple[str | None, float, float, str]]:
        """What is added to each row: a joint (None: held), times a factor, plus an offset [rad or m]; as a formula too.

        The formula is such as ``"-2 * arm + 5 deg"``; of most joints the joint's own name.
        """
        robot, found = self.robot, []
        at_zero = robot.chain_values(np.zeros(len(robot.joint_names)))[0].tolist()
        for coupled, offset, row in zip(robot.coupling, at_zero, self.after.rows, strict=True):
            driver = next((n for n, c in zip(robot.joint_names, coupled, strict=True) if c), None)
            factor = float(coupled.sum())
            degrees = np.degrees(offset)
            shown = f"{1e3 * offset:+.12g} mm" if row.prismatic else f"{degrees:+.12g} deg"
            name = driver if factor == 1.0 else f"{factor:.12g} * {driver}"
            formula = f"{name} {shown[0]} {shown[1:]}" if offset else f"{name}"
            formula = formula if driver else f"held at {shown.removeprefix('+')}"
            found.append((driver, factor, offset + 0.0, formula))
        return found

    @property
    def notes(self) -> tuple[Note, ...]:
        """What whoever types the rows in should know."""
        notes, rows = [], self.after.rows
        pairs = near_parallel(self.robot) if self.after.convention != HAYATI else ()
        if pairs:
            named = ", ".join(f"'{a}' and '{b}'" for a, b in pairs)
            notes.append(Note("nearly parallel axes", (named, max(abs(row.d) for row in rows))))
        added = zip(rows, self.added(), strict=True)
        others = [f"'{row.joint}' ({text})" for row, (*_, text) in added if text != row.joint]
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


def write_dh(tables: DHTables, path: str | os.PathLike[str], *, overwrite: bool = False) -> Path:
    """Write DH tables as CSV or JSON, by the file's ending.

    Raises:
        FileError: Another ending, the file exists, or it cannot be written.
    """
    ending = Path(path).suffix.lower()
    if ending not in ENDINGS:
        raise FileError(
            f"{path}: a DH table is written as {choices(ENDINGS)}; end the name in one of these."
        )
    data = _csv(tables) if ending == ".csv" else _json(tables)
    return write_atomically(path, data, overwrite=overwrite)


def _csv(tables: DHTables) -> bytes:
    """Comments that say how the numbers are meant, then a line for base, each row and tool of each table."""
    robot, convention = tables.robot, tables.after.convention
    heads, added = _HEADS[convention], tables.added()
    comments = [
        f"DH rows of {robot.name}, {robot.base} to {robot.tip}, {convention} convention, by calib",
        _equation(convention),
        "The joint's value is added to theta; that of a sliding joint to d. 'base' and 'tool' are constant poses, "
        "R = Rz(yaw) Ry(pitch) Rx(roll).",
        "change = after - before; of 'base' and 'tool' it is the pose before^-1 after.",
    ]
    text = io.StringIO(newline="")
    text.writelines(f"# {' '.join(line.split())}\n" for line in comments)
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["table", "row", "joint", "added to", "value added", *heads, *_POSE])
    for name, table in tables.states().items():
        poses = [
            map(_number, (*T[:3, 3], *pin.rpy.matrixToRpy(T[:3, :3])), _POSE)
            for T in (table.T_base_0, table.T_n_tip)
        ]
        writer.writerow([name, "base", *[""] * (3 + len(heads)), *poses[0]])
        for i, (row, (*_, formula)) in enumerate(zip(table.rows, added, strict=True), start=1):
            numbers = (_number(getattr(row, field), head) for head, field in heads.items())
            to = "d" if row.prismatic else "theta"
            writer.writerow([name, i, row.joint, to, formula, *numbers, *[""] * len(_POSE)])
        writer.writerow([name, "tool", *[""] * (3 + len(heads)), *poses[1]])
    return text.getvalue().encode()


def _equation(convention: str) -> str:
    """The robot as a product of its rows."""
    factor = EQUATIONS[convention]
    return f"T_base_tip = base {factor[0]}_1 ... {factor[0]}_n tool, {factor}"


def _number(value: float, head: str) -> str:
    """A number in the unit of its heading, without zeros at its end and without a sign before zero."""
    one, digits = _UNITS[head.split()[-1]]
    return f"{round(value / one, digits) + 0.0:.{digits}f}".rstrip("0").rstrip(".")


def _json(tables: DHTables) -> bytes:
    """The tables in m and rad, every digit."""
    robot, convention = tables.robot, tables.after.convention

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
        T_base_0, T_n_tip = table.T_base_0.tolist(), table.T_n_tip.tolist()
        return {"T_base_0": T_base_0, "rows": rows, "T_n_tip": T_n_tip}

    joints = [
        {
            "joint": row.joint,
            "type": "prismatic" if row.prismatic else "revolute",
            "driver": driver,
            "factor": factor,
            "offset_m" if row.prismatic else "offset_rad": offset,
        }
        for row, (driver, factor, offset, _) in zip(tables.after.rows, tables.added(), strict=True)
    ]
    content = {
        "schema": "dh 1",
        "convention": convention,
        "equation": _equation(convention),
        "robot": {"name": robot.name, "base": robot.base, "tip": robot.tip},
        "joints": joints,
        **{name: of(tables.states().get(name)) for name in ("before", "after", "change")},
    }
    return json_bytes({**content, "after": of(tables.after)})
