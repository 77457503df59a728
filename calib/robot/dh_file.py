"""Files of DH rows: a table, one line a joint (docs/dh-rows.md), or calib's own JSON (docs/convert.md).

A file that ``calib convert --to dh`` wrote has several tables: ``after`` is read, the rows after the calibration, or
``robot``, the rows of a robot that was not calibrated.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from calib.basics.arrays import Array, read_only
from calib.basics.json_files import damage, read_json
from calib.basics.tables import Table, read_text
from calib.errors import CalibError, MeasurementError, ModelError, choices
from calib.robot.dh_columns import POSE, DHColumns, dh_columns, is_dh_table, value_added
from calib.robot.dh_rows import (
    BASE,
    EQUATIONS,
    TIP,
    DHRobot,
    DHRow,
    DHTable,
    coupling_fault,
    row_fault,
)

TABLES = (".csv", ".txt", ".tsv")
"""Endings of tables; a table given as a robot holds DH rows."""

ENDINGS = (*TABLES, ".json")
"""Endings of files of DH rows."""

#: Tables of a file that calib wrote; the first of the two that the file has is read.
_READ = ("after", "robot")

#: Its other tables.
_NOT_READ = ("before", "change")

#: If half of the lengths a are more than this, they are in another unit than their heading says [m].
_LONGEST = 10.0

#: A comment that states something: ``# base: base_link``.
_STATEMENT = re.compile(r'"?#\s*(robot|base|tip|convention)\s*[:=]\s*(.*?)"?', re.IGNORECASE)

#: Words for the types of joints: True for one that slides.
_TYPES = {
    "": False,
    "revolute": False,
    "rotary": False,
    "r": False,
    "continuous": False,
    "prismatic": True,
    "linear": True,
    "sliding": True,
    "p": True,
}

NUMBERS = {"theta": "rad", "d": "m", "a": "m", "alpha": "rad", "beta": "rad"}
"""The numbers of a row and their units in JSON."""

#: Lines of constant poses.
_POSES = ("base", "tool")


def read_dh_robot(path: str | Path) -> DHRobot:
    """Read a robot from a file of DH rows.

    Args:
        path: A table, or a JSON file as written by ``calib convert --to dh``.

    Raises:
        FileError: It does not exist, or is JSON of another kind.
        MeasurementError: It is not a table, or one of something else, or has a fault; the text names row and column.
        ModelError: The rows make no robot.
    """
    if Path(path).suffix.lower() == ".json":
        expected = (
            f"'{SCHEMA}' is wanted: a robot is a URDF, or a file written by calib convert --to dh."
        )
        content = read_json(path, "file of DH rows", SCHEMA, expected)
        return robot_of_json(content, Path(path).name)
    table = Table.read(path)
    if not is_dh_table(table):
        raise MeasurementError(
            f"'{path}' is given as the robot, and is not a table of DH rows: it has no columns of d and alpha. The "
            f"robot comes before the table. The headings found: {choices(table.header, 30)}."
        )
    # The statements of comments by their subjects.
    _, _, text = read_text(path, "The table")
    matches = [_STATEMENT.fullmatch(line.strip().rstrip(",;\t")) for line in text.splitlines()]
    statements = {
        match[1].lower(): match[2].strip() for match in matches if match and match[2].strip()
    }
    columns = dh_columns(table, statements.get("convention"))
    dh, coupling = _table_and_coupling(columns)
    # Not d, which may be large between nearly parallel axes.
    lengths = [abs(row.a) for row in dh.rows if row.a]
    if lengths and float(np.median(lengths)) > _LONGEST:
        raise MeasurementError(
            f"{table.source}, column 'a': half of the lengths are more than {_LONGEST:g} m. If they are millimetres, "
            "write 'a [mm]' and 'd [mm]' in the header."
        )
    try:
        return DHRobot(
            dh,
            statements.get("robot", Path(path).stem),
            statements.get("base", BASE),
            statements.get("tip", TIP),
            coupling,
        )
    except ModelError as error:
        raise ModelError(f"{table.source}: {error}") from error


def is_other_table(path: str | Path) -> bool:
    """Return True for a table of anything but DH rows, False for any other file.

    Raises:
        MeasurementError: It has the ending of a table, and does not exist or is not a table.
    """
    return Path(path).suffix.lower() in TABLES and not is_dh_table(Table.read(path))


def _lines_to_read(columns: DHColumns) -> list[int]:
    """Return the lines, from 0, of the table that is read: ``after`` or ``robot``, or all if there is only one.

    MeasurementError for a word that is not one of calib's tables, or if neither of the two is there.
    """
    count = range(len(columns.table.cells))
    if "table" not in columns.by_name:
        return list(count)
    words = [columns.text(i, "table").lower() for i in count]
    for i, word in enumerate(words):
        if word not in (*_READ, *_NOT_READ):
            what = f"'{word}' is not a table; they are {choices((*_NOT_READ, *_READ))}."
            raise columns.error(i, "table", what)
    for name in _READ:
        if name in words:
            return [i for i, word in enumerate(words) if word == name]
    raise MeasurementError(
        f"{columns.table.source}: there is no row of the table {choices(_READ)}, which are read."
    )


def _table_and_coupling(columns: DHColumns) -> tuple[DHTable, dict[str, dict[str, float]]]:
    """Return the rows with their constant poses, and by coupled joint the factors of other joints' readings, by name.

    A pose without a line ``base`` or ``tool`` is the identity, and a joint without a name is called after its number.
    MeasurementError for a second line of a pose, a second joint of one name, a fault in a cell, or no joint at all.
    """
    naming = _naming(columns)
    poses: dict[str, Array] = {}
    joint_lines = []
    for i in _lines_to_read(columns):
        place = columns.text(i, naming).lower()
        if place in poses:
            raise columns.error(i, naming, f"a second line '{place}'. Keep one.")
        if place in _POSES:
            poses[place] = _pose(columns, i)
        else:
            joint_lines.append(i)

    names: list[str] = []
    for number, i in enumerate(joint_lines, start=1):
        name = columns.text(i, "joint") or f"joint_{number}"
        if name in names:
            column = "joint" if "joint" in columns.by_name else "d"
            raise columns.error(i, column, f"a second joint '{name}'. Rename one of them.")
        names.append(name)

    rows = []
    coupling = {}
    for i, name in zip(joint_lines, names, strict=True):
        row, factors = _row(columns, i, name, names)
        rows.append(row)
        if factors:
            coupling[name] = factors
    if not rows:
        raise MeasurementError(
            f"{columns.table.source}: there is no row of a joint; one line a joint is wanted."
        )
    identity = np.eye(4)
    dh = DHTable(
        rows=tuple(rows),
        T_base_0=read_only(poses.get("base", identity)),
        T_n_tip=read_only(poses.get("tool", identity)),
        convention=columns.convention,
    )
    return dh, coupling


def _naming(columns: DHColumns) -> str:
    """Return the name of the column whose words ``base`` and ``tool`` mark the lines of constant poses."""
    return "row" if "row" in columns.by_name else "joint"


def _pose(columns: DHColumns, i: int) -> Array:
    """Return the constant pose in line i, from 0, of a table, shape (4, 4) [m]; empty cells are 0.

    MeasurementError if the table has no columns of a pose, or the line has one of the numbers of a DH row.
    """
    if not {*POSE} & columns.by_name.keys():
        what = f"a constant pose needs the columns {choices(POSE)}, with units."
        raise columns.error(i, _naming(columns), what)
    for name in NUMBERS:
        if columns.text(i, name):
            what = f"the line of a constant pose has no {name}. Leave the cell empty."
            raise columns.error(i, name, what)
    values = [columns.number(i, name) or 0.0 for name in POSE]
    T = np.eye(4)
    T[:3, :3] = pin.rpy.rpyToMatrix(*values[3:])
    T[:3, 3] = values[:3]
    return T


def _row(
    columns: DHColumns, i: int, name: str, names: Sequence[str]
) -> tuple[DHRow, dict[str, float]]:
    """Return the row of line i, from 0, for the joint of this name, and the factors of others' readings in its value.

    ``names`` are all joints of the table, which alone may be coupled. MeasurementError for a fault in a cell.
    """
    word = columns.text(i, "type").lower()
    if word not in _TYPES:
        what = f"'{word}' is not a type of joint; it must be 'revolute' or 'prismatic'."
        raise columns.error(i, "type", what)
    added_to = columns.text(i, "added to").lower()
    if added_to not in ("", "theta", "d"):
        what = f"'{added_to}' is nothing that a value is added to; it must be 'theta' or 'd'."
        raise columns.error(i, "added to", what)
    if word and added_to and _TYPES[word] != (added_to == "d"):
        what = f"'{added_to}' does not fit the type '{word}'. Correct one of them."
        raise columns.error(i, "added to", what)
    slides = _TYPES[word] or added_to == "d"

    for column in POSE:
        if columns.text(i, column):
            what = "only the lines 'base' and 'tool' have a pose. Leave the cell empty."
            raise columns.error(i, column, what)

    direction, offset, coupling = value_added(columns, i, name, slides=slides)
    numbers = {field: columns.number(i, field) or 0.0 for field in NUMBERS}
    row = DHRow(
        joint=name,
        prismatic=slides,
        **numbers,
        direction=direction,
        offset=offset,
        lower=columns.number(i, "lower", slides=slides),
        upper=columns.number(i, "upper", slides=slides),
        line=columns.table.lines[i],
    )
    fault = row_fault(row, columns.convention)
    if fault:
        column = next(c for c in ("upper", "joint", "d") if c in columns.by_name)
        raise columns.error(i, column, f"the row of '{name}' {fault}.")
    fault = coupling_fault(name, coupling, names)
    if fault:
        column = "coupling" if "coupling" in columns.by_name else "value added"
        raise columns.error(i, column, f"the coupling of '{name}' {fault}.")
    return row, coupling


# JSON, in m and rad with every digit; a URDF that was made from rows holds them in a comment, in the same form

SCHEMA = "dh 1"
"""The schema of the file."""

#: Tables of a file: rows before and after the calibration, and their difference; a file may have ``after`` alone.
_STATES = ("before", "after", "change")


def equation(convention: str) -> str:
    """Return the equation of a convention: the robot as a product of its rows."""
    factor = EQUATIONS[convention]
    return f"T_base_tip = base {factor[0]}_1 ... {factor[0]}_n tool, {factor}"


def file_content(
    robot: Mapping[str, str],
    joints: list[dict[str, Any]],
    tables: Mapping[str, DHTable],
) -> dict[str, Any]:
    """Return the content of a JSON file of DH rows, in m and rad; a table that is not given is None.

    Args:
        robot: Its ``name``, and the links ``base`` and ``tip``.
        joints: The value that is added to each row, see `joint_json`.
        tables: ``before``, ``after`` and ``change``, or ``after`` alone.
    """
    convention = tables["after"].convention
    by_state: dict[str, dict[str, Any] | None] = dict.fromkeys(_STATES)
    for state, table in tables.items():
        rows = []
        for row in table.rows:
            numbers = {f"{name}_{unit}": getattr(row, name) for name, unit in NUMBERS.items()}
            added_to = "d" if row.prismatic else "theta"
            rows.append({"joint": row.joint, "added_to": added_to, **numbers})
        by_state[state] = {
            "T_base_0": table.T_base_0.tolist(),
            "rows": rows,
            "T_n_tip": table.T_n_tip.tolist(),
        }
    return {
        "schema": SCHEMA,
        "convention": convention,
        "equation": equation(convention),
        "robot": dict(robot),
        "joints": joints,
        **by_state,
    }


def joint_json(
    row: DHRow, driver: str | None, factor: float, offset: float, others: Mapping[str, float]
) -> dict[str, Any]:
    """Return the value that is added to a row: factor times that of a joint, others, and an offset, in m and rad.

    Args:
        row: The row.
        driver: The joint whose value is added; None if there is none.
        factor: Factor of its value.
        offset: What else is added [rad or m].
        others: Factors of the values of other joints, by name.
    """
    unit = "m" if row.prismatic else "rad"
    return {
        "joint": row.joint,
        "type": "prismatic" if row.prismatic else "revolute",
        "driver": driver,
        "factor": factor,
        f"offset_{unit}": offset,
        "others": dict(others),
        f"lower_{unit}": row.lower,
        f"upper_{unit}": row.upper,
    }


def robot_json(robot: DHRobot) -> dict[str, Any]:
    """Return a robot of DH rows as the content of a JSON file, its rows as the table ``after``."""
    joints = []
    for row in robot.table.rows:
        coupled = robot.coupling.get(row.joint, {})
        others = {name: row.direction * factor for name, factor in coupled.items()}
        joints.append(joint_json(row, row.joint, float(row.direction), row.offset, others))
    names = {"name": robot.name, "base": robot.base, "tip": robot.tip}
    return file_content(names, joints, {"after": robot.table})


def robot_of_json(table: Mapping[str, Any], source: str) -> DHRobot:
    """Return the robot that the content of a file states: its table ``after``.

    Args:
        table: The content.
        source: Name of the file, for messages.

    Raises:
        ModelError: It is damaged, or a joint has no value of its own.
    """
    try:
        rows = tuple(
            _row_of_json(*pair)
            for pair in zip(table["joints"], table["after"]["rows"], strict=True)
        )
        poses = [np.reshape(table["after"][key], (4, 4)) for key in ("T_base_0", "T_n_tip")]
        dh = DHTable(rows, read_only(poses[0]), read_only(poses[1]), table["convention"])
        coupling = {}
        for row, joint in zip(rows, table["joints"], strict=True):
            others = joint.get("others", {})
            if others:
                coupling[row.joint] = {name: row.direction * f for name, f in others.items()}
        names = table["robot"]
        return DHRobot(dh, names["name"], names.get("base", BASE), names.get("tip", TIP), coupling)
    except (KeyError, TypeError, ValueError, AttributeError, CalibError) as error:
        raise ModelError(
            f"{source}: DH rows that make no robot: {damage(error)}. Write the file again with calib convert --to dh."
        ) from error


def _row_of_json(joint: Mapping[str, Any], numbers: Mapping[str, Any]) -> DHRow:
    """Return a row from its entries in ``joints``, see `joint_json`, and in ``rows``, see `file_content`.

    ModelError if the value added is not 1 or -1 times that of the row's own joint, KeyError if an entry is missing.
    """
    unit = "m" if joint["type"] == "prismatic" else "rad"
    if joint["driver"] != joint["joint"] or abs(joint["factor"]) != 1.0:
        raise ModelError(
            f"the joint '{joint['joint']}' has no value of its own; a robot whose joints follow others is given as "
            "a URDF"
        )
    values: dict[str, Any] = {
        name: float(numbers[f"{name}_{symbol}"]) for name, symbol in NUMBERS.items()
    }
    return DHRow(
        joint=joint["joint"],
        prismatic=joint["type"] == "prismatic",
        **values,
        direction=int(joint["factor"]),
        offset=float(joint[f"offset_{unit}"]),
        lower=joint.get(f"lower_{unit}"),
        upper=joint.get(f"upper_{unit}"),
    )
