"""DH rows: those of a robot before and after its calibration as files, CSV in mm and deg, JSON in m and rad.

The rows are compared with the robots' poses; docs/convert.md describes the files.
"""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from calib.basics.arrays import Array, rigid_inverse
from calib.basics.files import write_atomically
from calib.basics.json_files import json_bytes
from calib.errors import FileError, ModelError, choices
from calib.model.dh_table import dh_table, near_parallel, taken_as_parallel
from calib.robot.dh_file import (
    ENDINGS as SOURCE_ENDINGS,
    NUMBERS,
    equation,
    file_content,
    joint_json,
)
from calib.robot.dh_rows import EQUATIONS, HAYATI, MODIFIED, STANDARD, DHRow, DHTable
from calib.robot.ranges import spread_poses
from calib.robot.readback import TOLERANCE
from calib.robot.robot import Robot
from calib.verbs.convert.format import Format, Note, Notes, Options, Source, SourceKind
from calib.verbs.convert.urdf_formats import robot_source

ENDINGS = (".csv", ".json")
"""Endings of files with DH tables."""

#: Of each unit of a heading: its size in SI units, and the decimals written, which hold poses to 1e-9 m and rad even if
#: d is kilometres.
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

#: Headings of a joint's limits; each cell has its unit.
_LIMITS = ("lower", "upper")

#: Number of joint values at which poses are compared.
_POSES = 64


class Added(NamedTuple):
    """The value that a controller adds to a row: values of joints times factors, plus an offset."""

    #: The joint, the row's own if it is among them; None if the row's joint is held.
    driver: str | None
    #: Factor of its value; 0 without a joint.
    factor: float
    #: The offset [rad], or [m] if the row's joint slides.
    offset: float
    #: The same as text, ``"-2 * arm + 5 deg"``; for most rows the joint's own name.
    formula: str
    #: Factors of the values of other joints, if readings are coupled.
    others: Mapping[str, float] = {}


@dataclass(frozen=True, slots=True, eq=False)
class DHTables:
    """The DH rows of a robot beside those of its nominal state; both give the poses of their robots."""

    #: The robot, as it is.
    robot: Robot
    #: The same chain before the calibration; None: not known.
    nominal: Robot | None
    #: The rows of ``robot``; what the convention leaves open is chosen as in ``before``.
    after: DHTable
    #: The rows of ``nominal``; None: not known.
    before: DHTable | None

    @classmethod
    def of(cls, robot: Robot, nominal: Robot | None = None, convention: str = STANDARD) -> DHTables:
        """Return the DH rows of a robot, compared with its poses.

        Args:
            robot: The robot.
            nominal: The same chain before the calibration; None: not known.
            convention: One of `calib.robot.dh_rows.CONVENTIONS`.

        Returns:
            The rows of both robots.

        Raises:
            ModelError: There is no such convention, the robots have different joints, or the rows do not give
                the robot's poses.
        """
        sheet = _sheet(robot, convention)
        after = dh_table(robot, convention, nominal, sheet)
        before = None if nominal is None else dh_table(nominal, convention, sheet=sheet)
        q = spread_poses(robot, _POSES)
        _check_poses(robot, after, q)
        if nominal is not None and before is not None:
            _check_poses(nominal, before, q)
        return cls(robot, nominal, after, before)

    def added(self) -> list[Added]:
        """Return what a controller adds to each row's theta, or to its d if the joint slides.

        That is a linear function of the readings of the joints: for most rows the reading of the row's own joint.
        """
        robot = self.robot
        at_zero = robot.chain_values(np.zeros(len(robot.joint_names)))[0].tolist()
        by_readings = robot.mimic_matrix @ robot.reading_matrix
        result = []
        for coupled, value, row in zip(by_readings, at_zero, self.after.rows, strict=True):
            pairs = zip(robot.joint_names, (row.direction * coupled).tolist(), strict=True)
            factors = {name: factor for name, factor in pairs if factor}
            offset = row.direction * value + row.offset + 0.0
            driver = row.joint if row.joint in factors else next(iter(factors), None)
            if driver is None:
                result.append(Added(None, 0.0, offset, _formula({}, offset, row)))
                continue
            factor = factors.pop(driver)
            formula = _formula({driver: factor, **factors}, offset, row)
            result.append(Added(driver, factor, offset, formula, factors))
        return result

    @property
    def notes(self) -> Notes:
        """Notes on nearly parallel axes, whose numbers are large, and on rows whose own joint has no value."""
        notes = []
        rows = self.after.rows
        pairs = near_parallel(self.robot) if self.after.convention != HAYATI else {}
        if pairs:
            names = ", ".join(f"'{a}' and '{b}'" for a, b in pairs)
            largest_d = max(abs(row.d) for row in rows)
            sentence = (
                "Nearly parallel axes: {0}. d and theta of their rows may be large (here up to {1:.3g} mm) and cancel "
                "over the rows: enter every digit, and all rows together. 'hayati' has no such rows."
            )
            notes.append(Note("nearly parallel axes", sentence, (names, largest_d)))
        unusual = []
        for row, added in zip(rows, self.added(), strict=True):
            if added.driver != row.joint:
                unusual.append(f"'{row.joint}' ({added.formula})")
        if unusual:
            sentence = "Joints without a value of their own: {0}."
            notes.append(Note("joints without value", sentence, (", ".join(unusual),)))
        return tuple(notes)

    def states(self) -> dict[str, DHTable]:
        """Return the tables of a file by name: ``before``, ``after``, ``change``; or ``robot`` if before is not known.

        The change is after minus before; for the constant poses it is before^-1 after.
        """
        if self.before is None:
            return {"robot": self.after}
        before, after = self.before, self.after
        rows = []
        for row_before, row_after in zip(before.rows, after.rows, strict=True):
            numbers = {n: getattr(row_after, n) - getattr(row_before, n) for n in NUMBERS}
            rows.append(replace(row_before, **numbers))
        base = rigid_inverse(before.T_base_0) @ after.T_base_0
        tool = rigid_inverse(before.T_n_tip) @ after.T_n_tip
        change = DHTable(tuple(rows), base, tool, after.convention)
        return {"before": before, "after": after, "change": change}


def _check_poses(robot: Robot, table: DHTable, q: Array) -> None:
    """Compare poses by DH rows with the robot's at joint values q (N, n) [rad or m]; `ModelError` if they differ."""
    difference = np.abs(table.poses(robot.chain_values(q)) - robot.poses(q)).max()
    # Axes that are taken as parallel displace the tip by the angle times the arm's length, in both directions.
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


def _sheet(robot: Robot, convention: str) -> DHTable | None:
    """Return the DH rows that a robot was made from, if they are of its chain and in this convention; else None."""
    stated = robot.urdf.dh
    joints = tuple(joint.name for joint in robot.joints)
    if stated is None or (stated.base, stated.tip, stated.joint_names) != (
        robot.base,
        robot.tip,
        joints,
    ):
        return None
    # Standard rows are Hayati's with beta = 0.
    if stated.table.convention == STANDARD and convention == HAYATI:
        return replace(stated.table, convention=HAYATI)
    return stated.table if stated.table.convention == convention else None


def _with_unit(row: DHRow, value: float | None) -> str:
    """Return a value of a row's joint, [m] if it slides, else [rad], as text in mm or deg; empty for None."""
    if value is None:
        return ""
    return f"{1e3 * value:.12g} mm" if row.prismatic else f"{np.degrees(value):.12g} deg"


def _formula(factors: Mapping[str, float], offset: float, row: DHRow) -> str:
    """Return `Added.formula`, such as ``"-2 * arm + 5 deg"``: joints' values times factors by name, plus an offset.

    The offset is [m] if the row's joint slides, else [rad]; without factors the joint is held at it.
    """
    constant = _with_unit(row, offset)
    if not factors:
        return f"held at {constant}"
    terms = []
    for name, factor in factors.items():
        terms.append(name if factor == 1.0 else f"{factor:.12g} * {name}")
    if offset:
        terms.append(constant)
    first, *rest = terms
    signed = [f" - {term[1:]}" if term.startswith("-") else f" + {term}" for term in rest]
    return first + "".join(signed)


def write_dh(tables: DHTables, path: str | os.PathLike[str], *, overwrite: bool = False) -> Path:
    """Write DH tables as CSV or JSON, by the file's ending.

    Args:
        tables: The tables.
        path: The file, with one of `ENDINGS`.
        overwrite: Whether an existing file is replaced.

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
    if ending == ".csv":
        data = _csv(tables)
    else:
        robot = tables.robot
        joints = []
        for row, added in zip(tables.after.rows, tables.added(), strict=True):
            joints.append(joint_json(row, added.driver, added.factor, added.offset, added.others))
        states = tables.states() if tables.before is not None else {"after": tables.after}
        names = {"name": robot.name, "base": robot.base, "tip": robot.tip}
        data = json_bytes(file_content(names, joints, states))
    return write_atomically(path, data, overwrite=overwrite)


# CSV


def _csv(tables: DHTables) -> bytes:
    """Return the tables as CSV in mm and deg: comments that say how the numbers are meant, then the lines."""
    robot, convention = tables.robot, tables.after.convention
    heads = _HEADS[convention]
    comments = [
        f"DH rows of {robot.name}, {robot.base} to {robot.tip}, {convention} convention, by calib",
        f"robot: {robot.name}",
        f"base: {robot.base}",
        f"tip: {robot.tip}",
        f"convention: {convention}",
        equation(convention),
        "The value of 'value added' is added to theta; that of a sliding joint to d. 'base' and 'tool' are constant "
        "poses, R = Rz(yaw) Ry(pitch) Rx(roll).",
        "change = after - before; of 'base' and 'tool' it is the pose before^-1 after.",
    ]
    text = io.StringIO(newline="")
    text.writelines(f"# {' '.join(line.split())}\n" for line in comments)
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["table", "row", "joint", "added to", "value added", *heads, *_LIMITS, *_POSE])

    formulas = [added.formula for added in tables.added()]
    no_row = [""] * (3 + len(heads) + len(_LIMITS))
    no_pose = [""] * len(_POSE)
    for name, table in tables.states().items():
        writer.writerow([name, "base", *no_row, *_pose_cells(table.T_base_0)])
        for i, (row, formula) in enumerate(zip(table.rows, formulas, strict=True), start=1):
            added_to = "d" if row.prismatic else "theta"
            numbers = [_number(getattr(row, field), head) for head, field in heads.items()]
            limits = [
                "" if name == "change" else _with_unit(row, getattr(row, end)) for end in _LIMITS
            ]
            writer.writerow([name, i, row.joint, added_to, formula, *numbers, *limits, *no_pose])
        writer.writerow([name, "tool", *no_row, *_pose_cells(table.T_n_tip)])
    return text.getvalue().encode()


def _pose_cells(T: Array) -> list[str]:
    """Return the cells of a pose (4, 4) [m] under the headings of `_POSE`."""
    numbers = (*T[:3, 3], *pin.rpy.matrixToRpy(T[:3, :3]))
    return [_number(value, head) for value, head in zip(numbers, _POSE, strict=True)]


def _number(value: float, head: str) -> str:
    """Return a number [m or rad] in the unit of its heading, without trailing zeros, and 0 instead of ``-0``."""
    to_si, decimals = _UNITS[head.split()[-1]]
    rounded = round(value / to_si, decimals) + 0.0
    return f"{rounded:.{decimals}f}".rstrip("0").rstrip(".")


# As formats and a source of a conversion


def _write(convention: str | None, source: Source, path: Path, options: Options) -> Notes:
    """Write DH rows as CSV or JSON, by the ending, beside the nominal ones if the nominal robot is another one.

    Without a convention it is that of the rows that the robot was made from, else the standard one.
    """
    nominal = None if source.nominal is source.robot else source.nominal
    notes: Notes = ()
    if convention is None:
        made_from = source.robot.urdf.dh
        convention = STANDARD if made_from is None else made_from.table.convention
        sentence = "The convention of the rows is {0}, {1}."
        notes = (Note("rows written", sentence, (convention, EQUATIONS[convention])),)
    tables = DHTables.of(source.robot, nominal, convention)
    write_dh(tables, path, overwrite=options.overwrite)
    return notes + tables.notes


def _read(source: str, options: Options) -> Source:
    """Read a file of DH rows: they define the nominal robot, and results are written in their convention."""
    result = robot_source(source, options)
    rows = result.robot.urdf.dh
    if rows is None:
        return result
    convention = rows.table.convention
    values = (f"{len(rows.table.rows)}", convention, EQUATIONS[convention])
    note = Note("rows read", "{0} DH rows, {1} convention, {2}.", values)
    return replace(result, kind="rows", notes=(note,))


FORMATS = {
    "dh": Format(
        "DH rows in the convention that they came in, else standard",
        ENDINGS,
        partial(_write, None),
    ),
    "modified-dh": Format(
        "DH rows, modified (Craig's) convention", ENDINGS, partial(_write, MODIFIED)
    ),
    "hayati": Format("DH rows with Hayati's beta", ENDINGS, partial(_write, HAYATI)),
}

KINDS = {"rows": SourceKind(SOURCE_ENDINGS, "equation", _read)}
