"""DH rows as JSON, in m and rad with every digit: the tables of a file of the schema ``dh 1``, and their robot.

docs/convert.md describes the file. A URDF that was made from rows holds them in a comment, in the same form.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from calib.basics.arrays import read_only
from calib.basics.json_files import damage
from calib.errors import CalibError, ModelError
from calib.robot.dh_rows import BASE, EQUATIONS, TIP, DHRobot, DHRow, DHTable

SCHEMA = "dh 1"
"""The schema of the file."""

NUMBERS = {"theta": "rad", "d": "m", "a": "m", "alpha": "rad", "beta": "rad"}
"""The numbers of a row and their units."""

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
    """Return the content of a file of DH rows.

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
    """Return a row from its entries in ``joints``, see `joint_json`, and in ``rows``, see `file_content`."""
    unit = "m" if joint["type"] == "prismatic" else "rad"
    if joint["driver"] != joint["joint"] or abs(joint["factor"]) != 1.0:
        raise ModelError(
            f"the joint '{joint['joint']}' has no value of its own; a robot whose joints follow others is given as "
            "a URDF"
        )
    return DHRow(
        joint=joint["joint"],
        prismatic=joint["type"] == "prismatic",
        **{name: float(numbers[f"{name}_{unit_}"]) for name, unit_ in NUMBERS.items()},
        direction=int(joint["factor"]),
        offset=float(joint[f"offset_{unit}"]),
        lower=joint.get(f"lower_{unit}"),
        upper=joint.get(f"upper_{unit}"),
    )
