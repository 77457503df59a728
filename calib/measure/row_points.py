"""Where the target was at each row of a table, in the base frame: as measured, or as the nominal robot predicts it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calib.measure.cell import Cell
from calib.measure.measurements import Measurements
from calib.measure.table import Table
from calib.model.robot import Robot, read_only, rigid_inverse
from calib.units import split_header

Array = NDArray[np.float64]

_AXES = {"x", "y", "z"}


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

    Args:
        robot: The nominal robot.
        rows: The table.
        cell: The set-up: a measurement frame that is estimated says nothing of the base, so that positions in it are
            predicted.
        target: shape (3,), in the tip [m]; targets of other names that the cell has are predicted at their places.

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
    names = []
    for label in table.header:
        name = split_header(label)[0]
        names.append(split_header(columns.get(name, columns.get(label, name)))[0].lower())
    places = [i for i, name in enumerate(names) if name in _AXES]
    if {names[i] for i in places} != _AXES:
        return False
    return any(row.cells[i] for row in table.rows() for i in places if i < len(row.cells))
