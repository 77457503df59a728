"""Rows of a table that are compared with a region: where the target was in each of them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from calib.basics.arrays import Array, Mask, rigid_inverse
from calib.basics.tables import Table
from calib.basics.values import Value
from calib.data.cell import Cell
from calib.data.columns import POINT, name_columns
from calib.data.forms.column_options import ColumnsInput
from calib.data.measurements import Measurements
from calib.robot.robot import Robot
from calib.verbs.workspace.region import Density, Region


class Checked(NamedTuple):
    """Rows of a table that are compared with a region."""

    #: The N rows.
    rows: Measurements
    #: Shape (N, 3), position of the target of each row in the base [m].
    points: Array
    #: Shape (N,), whether it was measured; otherwise it is predicted.
    measured: Mask


@dataclass(frozen=True, slots=True, eq=False)
class RegionView(Value):
    """Region of a robot's workspace as it is printed and drawn."""

    #: The robot.
    robot: Robot
    #: Shape (3,), position of the target in the tip [m].
    target: Array
    #: Shape (m, 2), lowest and highest value of each joint, from which the workspace was sampled, [rad] or [m].
    ranges: Array
    #: Counts of the samples of the workspace.
    density: Density
    #: Voxels that hold a share of the samples.
    region: Region
    #: Rows that are compared with the region; None: none are.
    checked: Checked | None = None


def read_rows(
    path: str | Path,
    robot: Robot,
    columns: ColumnsInput = None,
    kind: str | None = None,
) -> Measurements:
    """Read a table whose positions may be missing: a list of poses, or a plan that is not filled in.

    Args:
        path: Path of the table.
        robot: The robot, whose joints have a column each in the table.
        columns: Names that calib uses by the table's names, or all that is said of the columns; None: nothing is.
        kind: Name of the kind of measurement of all rows, such as ``"point"``; None: as the table says, or joint values
            alone if it has no positions.

    Raises:
        MeasurementError: The table cannot be read, or lacks the column of a joint.
    """
    table = Table.read(path)
    named, _ = name_columns(table, robot.joint_names, columns)
    cells = [table.column(named[name]) for name in POINT if name in named]
    has_positions = len(cells) == len(POINT) and any(map(any, cells))
    if kind is None and not has_positions:
        kind = "fixed"  # a row of this kind measures nothing but its joint values
    return Measurements.read(
        table, robot.joint_names, robot.joint_types, columns=columns, kind=kind
    )


def row_points(robot: Robot, rows: Measurements, cell: Cell, target: Array) -> tuple[Array, Mask]:
    """Return where the target of each row was in the robot's base, as measured or else as predicted.

    Args:
        robot: The nominal robot, which predicts positions that were not measured.
        rows: The N rows.
        cell: Has the targets and the measurement frames; positions in a frame that is estimated do not count as
            measured.
        target: Position in the tip of a target that the cell does not name, shape (3,), [m].

    Returns:
        Positions in the robot's base, shape (N, 3), [m]; and whether they were measured, shape (N,).
    """
    T_base_tip = robot.poses(rows.joints_for(robot.joint_names))
    targets = [cell.targets.get(name, target) for name in rows.targets]
    p_tip_target = np.array(targets).reshape(-1, 3)
    carried = np.einsum("nij,nj->ni", T_base_tip[:, :3, :3], p_tip_target)
    points = carried + T_base_tip[:, :3, 3]
    measured = rows.positions.copy()
    for i in np.flatnonzero(measured):
        T_frame_base = cell.frames.get(rows.groups[i], cell.T_frame_base)
        if T_frame_base is None and cell.estimate_frame:
            measured[i] = False
            continue
        T_base_frame = np.eye(4) if T_frame_base is None else rigid_inverse(T_frame_base)
        points[i] = T_base_frame[:3, :3] @ rows.points[i] + T_base_frame[:3, 3]
    return points, measured
