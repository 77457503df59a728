"""A table with poses of the flange: its poses, the same table with joint values, and what was measured in its rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.basics.arrays import Array, Integers
from calib.basics.files import csv_bytes
from calib.basics.tables import Table
from calib.basics.units import split_header
from calib.basics.values import Value
from calib.data.columns import cells_of
from calib.data.forms.column_options import ColumnOptions
from calib.data.forms.flange_poses import with_flange_joints
from calib.data.measurements import Measurements
from calib.robot.flange import JOINTS, NAME
from calib.robot.robot import Robot

#: Columns of which a table that measures something has one.
_MEASURED = ("u", "x", "distance", "kind")


@dataclass(frozen=True, slots=True, eq=False)
class PoseTable(Value):
    """A table whose rows were taken at P different poses of the flange."""

    #: The table as given.
    given: Table
    #: What is said of its columns.
    columns: ColumnOptions
    #: The table with joint values of `calib.robot.flange`.
    table: Table
    #: Joint values of `calib.robot.flange` at the poses, in the order in which they come first, (P, 6), [m] and [rad].
    values: Array
    #: shape (R,), index of the pose of each row, from 0; -1 of rows without one.
    pose: Integers

    @classmethod
    def read(cls, table: Table, columns: ColumnOptions) -> PoseTable:
        """Find the poses of a table.

        Args:
            table: The table.
            columns: What is said of its columns.

        Raises:
            MeasurementError: See `with_flange_joints`.
        """
        converted, _ = with_flange_joints(table, columns)
        heads = [split_header(label)[0] for label in converted.header]
        places = [heads.index(name) for name in JOINTS]
        known: dict[tuple[float, ...], int] = {}
        pose = []
        for row in converted.cells:
            cells = [row[place] for place in places]
            values = tuple(map(float, cells)) if all(cells) else ()
            pose.append(known.setdefault(values, len(known)) if values else -1)
        found = np.array(list(known)).reshape(-1, len(JOINTS))
        return cls(table, columns, converted, found, np.array(pose, dtype=np.intp))

    @property
    def T_base_flange(self) -> Array:
        """The poses, shape (P, 4, 4) [m]."""
        return Robot.load(NAME).poses(self.values)

    @property
    def measures(self) -> bool:
        """True if its rows hold measurements, such as corners in pictures."""
        heads = [split_header(label)[0].casefold() for label in self.table.header]
        return any(name in heads for name in _MEASURED)

    def measurements(self, kind: str | None) -> tuple[Measurements, Integers]:
        """Return what was measured, at joint values of `calib.robot.flange`; and the index of each row's pose, from 0.

        Args:
            kind: The kind of all rows; None: as the columns say.

        Raises:
            MeasurementError: The table cannot be read.
        """
        robot = Robot.load(NAME)
        names, types = robot.joint_names, robot.joint_types
        measured = Measurements.read(self.given, names, types, self.columns, kind)
        values = measured.joints_for(JOINTS)
        rows = {tuple(row): p for p, row in enumerate(self.values.tolist())}
        return measured, np.array([rows[tuple(row)] for row in values.tolist()], dtype=np.intp)

    def with_joints(self, names: Sequence[str], q: Array, prismatic: Sequence[str]) -> bytes:
        """Return the table with columns of joint values after its own, as CSV.

        Args:
            names: Names of the joints.
            q: Their values at the poses, (P, m), [rad] or [m].
            prismatic: Names of those that slide.
        """
        columns = []
        heads = []
        for name, values in zip(names, q.T, strict=True):
            unit = "mm" if name in prismatic else "deg"
            heads.append(f"{name} [{unit}]")
            columns.append(cells_of(np.append(values, np.nan)[self.pose], unit))
        rows: list[list[object]] = [[*self.table.header, *heads]]
        for n, cells in enumerate(self.table.cells):
            rows.append([*cells, *(column[n] for column in columns)])
        return csv_bytes(rows)
