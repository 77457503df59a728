"""Between which values joints are moved, and where the target is at the rows of a table that may measure nothing."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.data.table import POINT, Table, name_columns
from calib.errors import CalibError, choices
from calib.robot.readback import column_ranges
from calib.robot.robot import Robot, read_only, rigid_inverse
from calib.robot.urdf import UrdfJoint
from calib.units import unit_fault

Array = NDArray[np.float64]

#: A range may pass a limit by this, for rounding: 360 deg is not quite 6.28318 rad [rad or m].
_ROUNDING = 1e-4


@lru_cache(maxsize=16)
def column_limits(robot: Robot) -> Array:
    """The limits of each column of q, shape (m, 2), [rad] or [m]; infinite where there are none.

    Joints of the chain that mimic a column's joint must stay inside their limits too.
    """

    def ends_of(joint: UrdfJoint) -> tuple[float, float]:
        low, high = joint.lower, joint.upper
        return -np.inf if low is None else low, np.inf if high is None else high

    limits = np.array([ends_of(joint) for joint in robot.inputs])
    offset = robot.chain_values(np.zeros(len(limits)))[0]
    for row, joint, at_zero in zip(robot.coupling, robot.joints, offset, strict=True):
        for column in np.flatnonzero(row):
            ends = (np.array(ends_of(joint)) - at_zero) / row[column]
            low, high = max(limits[column, 0], ends.min()), min(limits[column, 1], ends.max())
            if low < high:
                limits[column] = low, high
    return read_only(limits)


@lru_cache(maxsize=16)
def full_ranges(robot: Robot) -> Array:
    """Values that take each joint everywhere it can go, shape (m, 2), [rad] or [m].

    The limits; of a joint that may turn further one whole turn inside of them, the one nearest to zero; 1 m to both
    sides of zero where a sliding joint has no limits.
    """
    ranges = np.array(column_ranges(robot))
    turn = 2.0 * np.pi
    for column, (joint, (low, high)) in enumerate(
        zip(robot.inputs, column_limits(robot), strict=True)
    ):
        if np.isfinite([low, high]).all() and (joint.type == "prismatic" or high - low <= turn):
            ranges[column] = low, high
        elif joint.type != "prismatic":
            start = min(max(-np.pi, low), high - turn)
            ranges[column] = start, start + turn
    return read_only(ranges)


def joint_ranges(
    robot: Robot,
    given: Mapping[str, tuple[float, float]] | None = None,
    like: ArrayLike | None = None,
    margin: float | Array = 0.0,
) -> Array:
    """Between which values each joint is moved.

    Args:
        robot: The robot; what is not narrowed is as in `full_ranges`.
        given: Lowest and highest value by the joint's name [rad or m]; they win over ``like``.
        like: shape (N, m), joint values that were measured, in the order of ``robot.joint_names``.
        margin: What is added at both ends of ``like`` [rad or m]; one number, or one for each joint.

    Returns:
        shape (m, 2), [rad] or [m], read-only.

    Raises:
        CalibError: A joint that the chain does not have, a range that is empty, leaves the limits, or has
            a unit that is not the joint's.
    """
    limits, ranges = column_limits(robot), np.array(full_ranges(robot))
    if like is not None:
        values = np.atleast_2d(np.asarray(like, dtype=np.float64))
        if not values.size:
            raise CalibError(
                "No rows were given to take the ranges of joints from; give one at least."
            )
        least, most = values.min(axis=0), values.max(axis=0)
        # The margin ends at a limit; a value that was measured beyond it stays in.
        ranges[:, 0] = np.minimum(least, np.maximum(least - margin, limits[:, 0]))
        ranges[:, 1] = np.maximum(most, np.minimum(most + margin, limits[:, 1]))
    for name, (low, high) in (given or {}).items():
        if name not in robot.joint_names:
            raise CalibError(
                f"A range is given for the joint '{name}', which does not move the chain '{robot.base}' to "
                f"'{robot.tip}'. Its joints are {choices(robot.joint_names, limit=30)}."
            )
        fault = unit_fault(low, slides=robot.joint_types[name] == "prismatic")
        if fault is not None:
            raise CalibError(f"The range given for the joint '{name}' {fault}.")
        column = robot.joint_names.index(name)
        said = range_text(robot, name, (low, high))
        if not (np.isfinite(low) and np.isfinite(high) and low < high):
            raise CalibError(
                f"The range of '{name}' is {said}, which is empty; give the lower end first. A joint that stands "
                "still is held at its value (--hold)."
            )
        if low < limits[column, 0] - _ROUNDING or high > limits[column, 1] + _ROUNDING:
            raise CalibError(
                f"The range of '{name}' is {said}; its limits in the URDF are "
                f"{range_text(robot, name, limits[column])}. Give a range inside."
            )
        ranges[column] = max(low, limits[column, 0]), min(high, limits[column, 1])
    return read_only(ranges)


def range_text(robot: Robot, name: str, ends: Array | tuple[float, float]) -> str:
    """A joint's range in words, such as ``-90 to 90 deg`` or ``0 to 300 mm``."""
    scale, unit = (1e3, "mm") if robot.joint_types[name] == "prismatic" else (180.0 / np.pi, "deg")
    return f"{scale * ends[0]:.6g} to {scale * ends[1]:.6g} {unit}"


def read_rows(
    path: str | Path,
    robot: Robot,
    columns: Mapping[str, str] | None = None,
    kind: str | None = None,
) -> Measurements:
    """A table whose positions may be missing: a list of poses, or a plan that is not filled in.

    Raises:
        MeasurementError: The table cannot be read, or lacks a joint.
    """
    table = Table.read(path)
    if kind is None and not _has_positions(table, columns or {}):
        kind = "fixed"  # a row of this kind measures nothing but its joint values
    return Measurements.read(
        table, robot.joint_names, robot.joint_types, columns=columns, kind=kind
    )


def row_points(
    robot: Robot, rows: Measurements, cell: Cell, target: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """Where the target was, and whether that was measured.

    Returns:
        shape (N, 3), in the base frame [m]; and shape (N,).
    """
    measured = rows.positions
    points = predicted_points(robot, rows, cell, target).copy()
    for i in np.flatnonzero(measured):
        T_frame_base = cell.frames.get(rows.groups[i], cell.T_frame_base)
        if T_frame_base is None and cell.estimate_frame:
            measured = measured.copy()
            measured[i] = False
            continue
        T_base_frame = np.eye(4) if T_frame_base is None else rigid_inverse(T_frame_base)
        points[i] = T_base_frame[:3, :3] @ rows.points[i] + T_base_frame[:3, 3]
    return read_only(points), measured


def predicted_points(robot: Robot, rows: Measurements, cell: Cell, target: Array) -> Array:
    """Where the nominal robot puts the target of each row, shape (N, 3), in the base frame [m]."""
    T_base_tip = robot.poses(rows.joints_for(robot.joint_names))
    at = np.array([cell.targets.get(name, target) for name in rows.targets]).reshape(-1, 3)
    return read_only(np.einsum("nij,nj->ni", T_base_tip[:, :3, :3], at) + T_base_tip[:, :3, 3])


def _has_positions(table: Table, columns: Mapping[str, str]) -> bool:
    """Whether a table has columns x, y and z, and a number in any of their cells."""
    named, _ = name_columns(table, (), columns)
    at = [named[name].index for name in POINT if name in named]
    rows = table.rows() if len(at) == len(POINT) else ()
    return any(row.cells[i] for row in rows for i in at if i < len(row.cells))
