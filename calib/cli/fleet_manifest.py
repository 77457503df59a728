"""The manifest of ``calib fleet``: a robot a row, whose cells are options of that robot."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from calib.cli.options import FitOptions, ModelOptions
from calib.cli.setup import parse_columns, read_cell
from calib.errors import CalibError, FileError, choices, did_you_mean

if TYPE_CHECKING:
    from calib.fleets.robots import FleetInputs, FleetRobot
    from calib.model.urdf import Urdf

NEEDED = ("name", "robot", "data")

#: Columns that are options of the set-up, and those that say how the data are read.
_SETUP = tuple(f.name for f in fields(ModelOptions))
OPTIONAL = (*_SETUP, "points", "points_unit", "columns")


@dataclass(frozen=True, slots=True)
class _Entry:
    """One row.

    Attributes:
        where: File and line, for messages.
        cells: Its cells that are not empty, by column.
        folder: The manifest's, which relative paths begin at.
        setup: What the command line says of all robots; the row's own cells win.
        columns: Likewise.
        points_unit: Likewise.
    """

    where: str
    cells: dict[str, str]
    folder: Path
    setup: FitOptions
    columns: Iterable[str]
    points_unit: str | None

    def load(self, urdf_of: Callable[[str], Urdf]) -> FleetInputs:
        """Read the robot.

        Raises:
            CalibError: Something cannot be read, or does not fit.
        """
        from calib.fleets.robots import FleetRobot

        cells = self.cells
        try:
            own: dict[str, Any] = {name: cells[name] for name in _SETUP if name in cells}
            own |= {"hold": self._listed("hold")} if "hold" in cells else {}
            own |= {"cell": self.folder / cells["cell"]} if "cell" in cells else {}
            points = self.folder / cells["points"] if "points" in cells else None
            if points is None and "points_unit" in cells:
                raise CalibError(  # noqa: TRY301  told with the row
                    "points_unit is the unit of a list of points; name the list in the column 'points'."
                )
            robot = FleetRobot.of_files(
                cells["name"],
                self.source(),
                self.folder / cells["data"],
                read_cell(**asdict(replace(self.setup, **own))),
                columns=parse_columns(self._listed("columns") or self.columns),
                points=points,
                points_unit=cells.get("points_unit", self.points_unit) if points else None,
            )
            return robot.load(urdf_of)
        except CalibError as error:
            raise CalibError(f"{self.where}: {self._told(str(error))}") from error

    def robot(self, urdf_of: Callable[[str], Urdf]) -> Urdf | None:
        """The robot; None where it cannot be read."""
        try:
            return urdf_of(self.source())
        except CalibError:
            return None

    def says(self, column: str) -> bool:
        """Whether the row has a word of its own on this, or a cell file that may."""
        return column in self.cells or "cell" in self.cells

    def source(self) -> str:
        """The robot's file, with what stands behind a xacro, or its name in example-robot-data where it is no file."""
        from calib.model.xacro_file import is_xacro

        source = self.cells["robot"]
        file = is_xacro(source) or Path(source).suffix or (self.folder / source).is_file()
        if not file or Path(source).is_absolute() or source.startswith("~"):
            return source
        # As text: what stands behind a xacro is no path.
        return f"{self.folder}{os.sep}{source}"

    def _told(self, text: str) -> str:
        """A message with the row's columns in the place of options that are not on the line."""
        for column in OPTIONAL:
            if column in self.cells:
                option = re.escape(f"--{column.replace('_', '-')}")
                text = re.sub(rf"{option}(?![\w-])", f"column '{column}'", text)
        return text

    def _listed(self, column: str) -> list[str]:
        """The parts of a cell, with semicolons between."""
        return [part.strip() for part in self.cells.get(column, "").split(";") if part.strip()]


def read_manifest(
    path: Path, setup: FitOptions, columns: Sequence[str], points_unit: str | None
) -> tuple[FleetRobot, ...]:
    """The robots of a manifest, none of them read yet.

    Args:
        path: The manifest.
        setup: What the command line says of all of them.
        columns: Likewise, as ``--columns`` has it.
        points_unit: Likewise.

    Raises:
        CalibError: It cannot be read, a column is missing, unknown or there twice, a row has no name, robot or data, or
            names are those of no folder or of two robots; or what the command line says can be said of no robot.
    """
    from calib.fleets.fleet import check_names
    from calib.fleets.robots import FleetRobot
    from calib.measure.table import Table

    # What can be said of no robot is refused before any is read.
    parse_columns(columns)
    cell = read_cell(**asdict(setup))
    table = Table.read(path)
    header = [label.strip().lower() for label in table.header]
    _check_header(header, path)
    entries = []
    for row in table.rows():
        where = f"{path.name}, line {row.line}"
        if any(row.cells[len(header) :]):
            raise CalibError(
                f"{where}: {len(row.cells)} cells, and the header has {len(header)} columns. Put texts with the "
                "separator in them in double quotes."
            )
        cells = {k: v for k, v in zip(header, row.cells, strict=False) if k and v}
        lacking = [name for name in NEEDED if name not in cells]
        if lacking:
            raise CalibError(
                f"{where}: {choices(lacking)} is empty; each robot has {choices(NEEDED)}."
            )
        entries.append(_Entry(where, cells, path.parent, setup, columns, points_unit))
    if not entries:
        raise CalibError(f"{path.name}: there are no robots in it, only a header.")
    check_names((entry.cells["name"], entry.where) for entry in entries)
    for column, what, names in (
        ("base", "link", [cell.base]),
        ("tip", "link", [cell.tip]),
        ("hold", "joint", cell.held),
    ):
        # What the line does not say stands in its cell file.
        where = f"--{column}" if getattr(setup, column) else f"{setup.cell}: {column}"
        for name in names:
            silent = [entry for entry in entries if not entry.says(column)]
            _check_known(where, what, name, silent)
    return tuple(FleetRobot(entry.cells["name"], entry.load) for entry in entries)


def _check_known(where: str, what: str, name: str | None, entries: Iterable[_Entry]) -> None:
    """Refuse a link or joint that none of the robots has that are to have it.

    Raises:
        CalibError: None has it. Where one does, the others fail alone: a fleet may have robots of several kinds.
    """
    from calib.fleets.robots import urdf_reader

    if name is None:
        return
    urdf_of, seen, first = urdf_reader(), set(), None
    for entry in entries:
        source = entry.source()
        urdf = None if source in seen else entry.robot(urdf_of)
        seen.add(source)
        if urdf is not None:
            names = urdf.links if what == "link" else [joint.name for joint in urdf.joints]
            if name in names:
                return
            first = first or (urdf.source, names)
    if first is not None:
        source, names = first
        raise CalibError(
            f"{where} '{name}': no robot of the manifest that it is for has such a {what}"
            f"{did_you_mean(name, names)}. The {what}s of {source}: {choices(names)}."
        )


def check_out(path: Path, out: Path) -> None:
    """Refuse a folder whose table would be the manifest.

    Raises:
        FileError: It would.
    """
    from calib.fleets.fleet import CSV

    if path.resolve() == (out / CSV).resolve():
        raise FileError(
            f"{path} is the manifest, and the table of results would have its name; choose another --out."
        )


def _check_header(header: list[str], path: Path) -> None:
    """Refuse columns that are missing, unknown or there twice.

    Raises:
        CalibError: One is.
    """
    lacking = [name for name in NEEDED if name not in header]
    strange = [name for name in header if name and name not in (*NEEDED, *OPTIONAL)]
    twice = sorted({name for name in header if name and header.count(name) > 1})
    for names, problem in (
        (lacking, "is missing"),
        (strange, "is not known"),
        (twice, "is there more than once"),
    ):
        if names:
            raise CalibError(
                f"{path.name}: of its columns {choices(names)} {problem}. A manifest has {choices(NEEDED)}, and may "
                f"have {choices(OPTIONAL)}."
            )
