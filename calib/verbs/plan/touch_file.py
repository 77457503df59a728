"""The table of corners to touch: a CSV file in degrees and millimetres, described in docs/planning.md."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from calib.basics.arrays import Array
from calib.basics.files import csv_bytes, write_atomically
from calib.basics.units import UNITS
from calib.robot.robot import Robot
from calib.verbs.plan.touch import TouchPlan

#: Steps of each corner, in the order to drive.
ABOVE, TOUCH = "above", "touch"


def write_touch(plan: TouchPlan, path: str | Path, *, overwrite: bool = False) -> Path:
    """Write corners to touch as a CSV table, two rows each, above and at the corner; those that cannot be are left out.

    Args:
        plan: The corners and the joint values.
        path: The file.
        overwrite: Whether an existing file is replaced.

    Returns:
        The path of the file.

    Raises:
        FileError: It cannot be written.
    """
    return write_atomically(path, csv_bytes(_rows(plan)), overwrite=overwrite)


def _rows(plan: TouchPlan) -> Iterator[list[str]]:
    """Yield the headers, then the rows in the order to drive."""
    order = hand_last(plan.robot)
    names = [plan.robot.joint_names[k] for k in order]
    joints = [f"{name} [{_unit(plan.robot, name)}]" for name in names]
    places = [f"{axis} [mm]" for axis in "xyz"]
    yield ["corner", "step", *joints, *places, "expected error 95 % [mm]"]
    for k in np.flatnonzero(plan.usable).tolist():
        place = [f"{1e3 * value:.3f}" for value in plan.places[k]]
        error = f"{1e3 * plan.expected[k]:.3f}"
        for step, q in ((ABOVE, plan.above[k]), (TOUCH, plan.touching[k])):
            values = in_table_units(plan.robot, q)[order]
            cells = [f"{value + 0.0:.4f}" for value in values]
            yield [str(plan.corners[k]), step, *cells, *place, error]


def _unit(robot: Robot, name: str) -> str:
    """Return the unit that the values of a joint are written in."""
    return "mm" if robot.joint_types[name] == "prismatic" else "deg"


def in_table_units(robot: Robot, q: Array) -> Array:
    """Return joint values (m,) [rad] or [m] in the units of the table, deg or mm."""
    scale = [UNITS[_unit(robot, name)].to_si for name in robot.joint_names]
    return np.asarray(q / scale)


def hand_last(robot: Robot) -> list[int]:
    """Return the places of the joints in ``robot.joint_names``, from 0, in the order from the foot to the hand."""
    places = list(range(len(robot.joint_names)))
    return places[::-1] if robot.base_moves else places
