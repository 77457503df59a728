"""A reading: what an instrument gave at one stop, as rows of a table or as pictures."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from calib.basics.arguments import check_type
from calib.basics.arrays import Array
from calib.basics.frames import table_of_frame
from calib.basics.tables import Table
from calib.basics.units import split_header
from calib.basics.values import ReadOnlyMapping, Value
from calib.data.cell import Cell
from calib.data.forms.column_options import ColumnsInput
from calib.data.measurements import Measurements
from calib.errors import ArgumentError
from calib.robot.robot import Robot

#: A row of a table: numbers, in the unit of their header, and words by header, ``{"x [mm]": 512.3, "target": "T1"}``.
Cells = Mapping[str, str | float]

#: A number with a decimal comma.
_WITH_COMMA = re.compile(r"[+-]?\d*,\d+(?:[eE][+-]?\d+)?")


@dataclass(frozen=True, slots=True)
class Context(Value):
    """The session that opens a reader or a controller, as far as that needs to know it."""

    #: Names of the m joints, in the order of the chain.
    joint_names: tuple[str, ...] = ()
    #: URDF types of the joints by name; a ``"prismatic"`` joint is in [m], any other in [rad].
    joint_types: Mapping[str, str] = field(default_factory=dict)
    #: Kind of the rows, such as ``"point"``; None: their columns tell.
    kind: str | None = None
    #: Names of the targets.
    targets: tuple[str, ...] = ()
    #: Headers with units of lines that come without one, ``("x [mm]", "y [mm]", "z [mm]")``; empty: all come with one.
    columns: tuple[str, ...] = ()
    #: Unit of lists of points that do not name theirs, ``"mm"``; None: they must.
    points_unit: str | None = None
    #: Folder of the session.
    folder: Path = Path()
    #: The nominal robot and the cell, for a virtual instrument; None: not said.
    robot: Robot | None = None
    cell: Cell | None = None

    def __post_init__(self) -> None:
        """Make the mapping of types read-only."""
        object.__setattr__(self, "joint_types", ReadOnlyMapping(self.joint_types))

    @property
    def joint_headers(self) -> tuple[str, ...]:
        """Headers of the joints' columns in SI units, ``"elbow_joint [rad]"``."""
        slides = [self.joint_types.get(name) == "prismatic" for name in self.joint_names]
        return tuple(
            f"{name} [{'m' if is_length else 'rad'}]"
            for name, is_length in zip(self.joint_names, slides, strict=True)
        )


@dataclass(frozen=True, slots=True)
class Reading(Value):
    """A reading of an instrument: one row, a row for each target, or pictures."""

    #: Rows of a table; the columns are those of measurements, docs/data-format.md.
    rows: tuple[Cells, ...] = ()
    #: Files of pictures, one for each camera.
    pictures: tuple[Path, ...] = ()
    #: Where it came from, for people: ``"points.txt, line 12"``.
    source: str = ""

    def __post_init__(self) -> None:
        """Copy the rows, and refuse by an ArgumentError what is no mapping from headers to cells."""
        for row in self.rows:
            check_type("rows", row, Mapping, "mappings from headers to numbers and words")
        object.__setattr__(self, "rows", tuple(map(ReadOnlyMapping, self.rows)))

    @classmethod
    def of(cls, *rows: Cells, source: str = "") -> Reading:
        """Return a reading of one row, or of a row for each target: ``Reading.of({"x [mm]": 512.3, ...})``."""
        return cls(rows, source=source)

    def measurements(
        self, context: Context, joints: Array | None = None, columns: ColumnsInput = None
    ) -> Measurements:
        """Return the rows as measurements, read as a table is read.

        Args:
            context: Names and types of the joints, and the kind of the rows.
            joints: Joint values at the stop, shape (m,), [rad] or [m]; None: the rows have them.
            columns: What is said of the columns, as by ``--columns``.

        Returns:
            As many rows as the reading has.

        Raises:
            ArgumentError: There are no rows.
            MeasurementError: They cannot be read as measurements.
        """
        added = {} if joints is None else dict(zip(context.joint_headers, joints, strict=True))
        taken = set(context.joint_names) if added else set()
        rows = tuple(
            {**added, **{h: cell for h, cell in row.items() if split_header(h)[0] not in taken}}
            for row in self.rows
        )
        return Measurements.read(
            replace(self, rows=rows).table(),
            context.joint_names,
            context.joint_types,
            columns,
            context.kind,
        )

    def table(self) -> Table:
        """Return the rows as a table, whose columns are all that a row has; ArgumentError if there are no rows."""
        if not self.rows:
            raise ArgumentError("This reading has no rows; its pictures are detected first.")
        headers = dict.fromkeys(header for row in self.rows for header in row)
        frame = {header: [_plain(row.get(header, "")) for row in self.rows] for header in headers}
        return replace(table_of_frame(frame), source=self.source or "The reading")


def _plain(cell: str | float) -> str | float:
    """Return a number that is a text with a decimal point, since those of the joints have one; other cells as are."""
    if isinstance(cell, str) and _WITH_COMMA.fullmatch(cell.strip()):
        return cell.replace(",", ".")
    return cell
