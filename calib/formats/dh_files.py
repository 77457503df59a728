"""The DH rows of a robot before and after its calibration as files: CSV in mm and deg, JSON in m and rad.

The rows are compared with the robots' poses; docs/convert.md describes the files.
"""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from calib.errors import FileError, ModelError, choices
from calib.files import write_atomically
from calib.formats.notes import Note
from calib.json_files import json_bytes
from calib.model.dh import EQUATIONS, HAYATI, MODIFIED, STANDARD, DHRow, DHTable
from calib.model.dh_table import dh_table, near_parallel, taken_as_parallel
from calib.robot.ranges import spread_poses
from calib.robot.readback import TOLERANCE
from calib.robot.robot import Robot, rigid_inverse
from calib.units import Array

ENDINGS = (".csv", ".json")
"""What the name of a DH table may end in."""

#: Of each unit of a heading: what one is in SI units, and the decimals written. They hold poses to 1e-9 m and rad also
#: where d is kilometres.
_UNITS = {"[mm]": (1e-3, 9), "[deg]": (np.pi / 180.0, 14)}

#: Headings of a constant pose.
_POSE = ("x [mm]", "y [mm]", "z [mm]", "roll [deg]", "pitch [deg]", "yaw [deg]")

#: The field of a row under each heading of the standard convention, in the order of the factors.
_STANDARD_HEADS = {"theta [deg]": "theta", "d [mm]": "d", "a [mm]": "a", "alpha [deg]": "alpha"}

#: The field of a row under each heading, in the order of the factors, by convention.
_HEADS = {
    STANDARD: _STANDARD_HEADS,
    HAYATI: {**_STANDARD_HEADS, "beta [deg]": "beta"},
    MODIFIED: {
        "alpha(i-1) [deg]": "alpha",
        "a(i-1) [mm]": "a",
        "theta [deg]": "theta",
        "d [mm]": "d",
    },
}

#: The numbers of a row and their units in JSON.
_NUMBERS = {"theta": "rad", "d": "m", "a": "m", "alpha": "rad", "beta": "rad"}

#: Number of joint values at which poses are compared.
_POSES = 64


class Added(NamedTuple):
    """The value that is added to a row: that of a joint times a factor, plus an offset."""

    #: The joint; None: none, the row's joint is held.
    driver: str | None
    #: How many times its value; 0 without a joint.
    factor: float
    #: What is added besides [rad], or [m] of a row whose joint slides.
    offset: float
    #: The same as text, ``"-2 * arm + 5 deg"``; of most rows the joint's own name.
    formula: str


@dataclass(frozen=True, slots=True, eq=False)
class DHTables:
    """The DH rows of a robot beside those of its nominal state; both hold the poses of their robots."""

    #: The robot, as it is.
    robot: Robot
    #: The same chain before the calibration; None: not known.
    nominal: Robot | None
    #: The rows of ``robot``; their open choices are those of ``before``.
    after: DHTable
    #: The rows of ``nominal``.
    before: DHTable | None

    @classmethod
    def of(cls, robot: Robot, nominal: Robot | None = None, convention: str = STANDARD) -> DHTables:
        """Return the DH rows of a robot, compared with its poses.

        Args:
            robot: The robot.
            nominal: The same chain before the calibration; None: not known.
            convention: One of `calib.model.dh.CONVENTIONS`.

        Returns:
            The rows of both robots.

        Raises:
            ModelError: No such convention, the robots have other joints, or the rows do not hold
                the robot's poses.
        """
        after = dh_table(robot, convention, like=nominal)
        before = None if nominal is None else dh_table(nominal, convention)
        q = spread_poses(robot, _POSES)
        _check_poses(robot, after, q)
        if nominal is not None and before is not None:
            _check_poses(nominal, before, q)
        return cls(robot, nominal, after, before)

    def added(self) -> list[Added]:
        """Return what a controller adds to each row."""
        robot = self.robot
        at_zero = robot.chain_values(np.zeros(len(robot.joint_names)))[0].tolist()
        result = []
        for coupled, offset, row in zip(robot.coupling, at_zero, self.after.rows, strict=True):
            drivers = [n for n, c in zip(robot.joint_names, coupled, strict=True) if c]
            driver = drivers[0] if drivers else None
            factor = float(coupled.sum())
            formula = _formula(driver, factor, offset, prismatic=row.prismatic)
            result.append(Added(driver, factor, offset + 0.0, formula))
        return result

    @property
    def notes(self) -> tuple[Note, ...]:
        """Notes for whoever types the rows in."""
        notes = []
        rows = self.after.rows
        pairs = near_parallel(self.robot) if self.after.convention != HAYATI else {}
        if pairs:
            names = ", ".join(f"'{a}' and '{b}'" for a, b in pairs)
            largest_d = max(abs(row.d) for row in rows)
            notes.append(Note("nearly parallel axes", (names, largest_d)))
        unusual = []
        for row, added in zip(rows, self.added(), strict=True):
            if added.formula != row.joint:
                unusual.append(f"'{row.joint}' ({added.formula})")
        if unusual:
            notes.append(Note("joints without value", (", ".join(unusual),)))
        return tuple(notes)

    def states(self) -> dict[str, DHTable]:
        """Return the tables of a file by name: ``robot``; or ``before``, ``after``, ``change``.

        The change is after minus before; of the constant poses it is before^-1 after.
        """
        if self.before is None:
            return {"robot": self.after}
        before, after = self.before, self.after
        pairs = zip(before.rows, after.rows, strict=True)
        rows = tuple(_difference(row_after, row_before) for row_before, row_after in pairs)
        base = rigid_inverse(before.T_base_0) @ after.T_base_0
        tool = rigid_inverse(before.T_n_tip) @ after.T_n_tip
        change = DHTable(rows, base, tool, after.convention)
        return {"before": before, "after": after, "change": change}


def _check_poses(robot: Robot, table: DHTable, q: Array) -> None:
    """Compare DH rows with their robot at joint values q (N, n) [rad or m]; `ModelError` if they differ."""
    difference = np.abs(table.poses(robot.chain_values(q)) - robot.poses(q)).max()
    # Axes that are taken as parallel cost the angle times the arm's length, there and back.
    length = 1.0 + np.linalg.norm(robot.placements[:, :3, 3], axis=1).sum()
    cost = 0.0
    if table.convention != HAYATI:
        cost = 2.0 * taken_as_parallel(robot) * length
    if not difference <= TOLERANCE + cost:
        raise ModelError(
            f"{robot.urdf.source}: the rows in the convention '{table.convention}' put the tip up "
            f"to {difference:.1e} m or rad away from the robot '{robot.name}', so nothing is "
            "written. Choose the convention 'hayati', which has no far common normals."
        )


def _formula(driver: str | None, factor: float, offset: float, *, prismatic: bool) -> str:
    """Return the formula of `Added`."""
    shown = f"{1e3 * offset:+.12g} mm" if prismatic else f"{np.degrees(offset):+.12g} deg"
    if driver is None:
        return f"held at {shown.removeprefix('+')}"
    name = driver if factor == 1.0 else f"{factor:.12g} * {driver}"
    return f"{name} {shown[0]} {shown[1:]}" if offset else name


def _difference(after: DHRow, before: DHRow) -> DHRow:
    """Return a row with the numbers after minus before."""
    numbers = {name: getattr(after, name) - getattr(before, name) for name in _NUMBERS}
    return replace(before, **numbers)


def write_dh(tables: DHTables, path: str | os.PathLike[str], *, overwrite: bool = False) -> Path:
    """Write DH tables as CSV or JSON, by the file's ending.

    Args:
        tables: The tables.
        path: The file, with one of `ENDINGS`.
        overwrite: Whether a file that exists is replaced.

    Returns:
        The path.

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


def _equation(convention: str) -> str:
    """Return the equation of a convention: the robot as a product of its rows."""
    factor = EQUATIONS[convention]
    return f"T_base_tip = base {factor[0]}_1 ... {factor[0]}_n tool, {factor}"


# CSV


def _csv(tables: DHTables) -> bytes:
    """Return comments that say how the numbers are meant, then the lines of each table."""
    robot, convention = tables.robot, tables.after.convention
    heads = _HEADS[convention]
    comments = [
        f"DH rows of {robot.name}, {robot.base} to {robot.tip}, {convention} convention, by calib",
        _equation(convention),
        "The joint's value is added to theta; that of a sliding joint to d. 'base' and 'tool' are constant poses, "
        "R = Rz(yaw) Ry(pitch) Rx(roll).",
        "change = after - before; of 'base' and 'tool' it is the pose before^-1 after.",
    ]
    formulas = [added.formula for added in tables.added()]
    text = io.StringIO(newline="")
    text.writelines(f"# {' '.join(line.split())}\n" for line in comments)
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["table", "row", "joint", "added to", "value added", *heads, *_POSE])
    for name, table in tables.states().items():
        writer.writerows(_csv_lines(name, table, formulas, heads))
    return text.getvalue().encode()


def _csv_lines(
    name: str,
    table: DHTable,
    formulas: list[str],
    heads: Mapping[str, str],
) -> Iterator[list[object]]:
    """Return the lines of a table: its constant pose before the rows, the rows, that behind them.

    Args:
        name: What the table is called.
        table: The table.
        formulas: What is added to each row.
        heads: The field of a row under each heading.
    """
    no_row = [""] * (3 + len(heads))
    no_pose = [""] * len(_POSE)
    yield [name, "base", *no_row, *_pose_cells(table.T_base_0)]
    for i, (row, formula) in enumerate(zip(table.rows, formulas, strict=True), start=1):
        numbers = [_number(getattr(row, field), head) for head, field in heads.items()]
        yield [name, i, row.joint, _added_to(row), formula, *numbers, *no_pose]
    yield [name, "tool", *no_row, *_pose_cells(table.T_n_tip)]


def _pose_cells(T: Array) -> list[str]:
    """Return the cells of a pose (4, 4) [m] under the headings of `_POSE`."""
    numbers = (*T[:3, 3], *pin.rpy.matrixToRpy(T[:3, :3]))
    return [_number(value, head) for value, head in zip(numbers, _POSE, strict=True)]


def _number(value: float, head: str) -> str:
    """Return a number [m or rad] in the unit of its heading, without zeros at its end or ``-0``."""
    to_si, decimals = _UNITS[head.split()[-1]]
    rounded = round(value / to_si, decimals) + 0.0
    return f"{rounded:.{decimals}f}".rstrip("0").rstrip(".")


def _added_to(row: DHRow) -> str:
    """Return the number of a row that the joint's value is added to."""
    return "d" if row.prismatic else "theta"


# JSON


def _json(tables: DHTables) -> bytes:
    """Return the tables in m and rad, with every digit."""
    robot, convention = tables.robot, tables.after.convention
    states = tables.states()
    joints = [_json_joint(*pair) for pair in zip(tables.after.rows, tables.added(), strict=True)]
    content: dict[str, Any] = {
        "schema": "dh 1",
        "convention": convention,
        "equation": _equation(convention),
        "robot": {"name": robot.name, "base": robot.base, "tip": robot.tip},
        "joints": joints,
        "before": _json_table(states.get("before")),
        "after": _json_table(tables.after),
        "change": _json_table(states.get("change")),
    }
    return json_bytes(content)


def _json_joint(row: DHRow, added: Added) -> dict[str, Any]:
    """Return what is added to a row, in m and rad."""
    return {
        "joint": row.joint,
        "type": "prismatic" if row.prismatic else "revolute",
        "driver": added.driver,
        "factor": added.factor,
        "offset_m" if row.prismatic else "offset_rad": added.offset,
    }


def _json_table(table: DHTable | None) -> dict[str, Any] | None:
    """Return a table in m and rad; None where there is none."""
    if table is None:
        return None
    rows = []
    for row in table.rows:
        numbers = {f"{name}_{unit}": getattr(row, name) for name, unit in _NUMBERS.items()}
        rows.append({"joint": row.joint, "added_to": _added_to(row), **numbers})
    return {
        "T_base_0": table.T_base_0.tolist(),
        "rows": rows,
        "T_n_tip": table.T_n_tip.tolist(),
    }
