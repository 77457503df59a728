"""The manifest of ``calib fleet``: a robot a row, and how its cells and the command line come to a set-up."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from calib.cli.options import PriorSizes, Repeats
from calib.cli.setup import read_cell
from calib.cli.words import parse_columns
from calib.errors import CalibError, FileError, choices, did_you_mean

if TYPE_CHECKING:
    from calib.fleets.robots import FleetInputs, FleetRobot
    from calib.measure.cell import Cell
    from calib.model.urdf import Urdf

NEEDED = ("name", "robot", "data")
OPTIONAL = (
    "cell",
    "points",
    "points_unit",
    "base",
    "tip",
    "target",
    "frame",
    "model",
    "kind",
    "payload",
    "hold",
    "columns",
)


@dataclass(frozen=True, slots=True)
class Said:
    """What the command line says of all robots; a row's own cell wins.

    Attributes:
        cell, points_unit, base, tip, target, frame, model, payload: As the options of the same names.
        kind: Likewise.
        hold, columns: Likewise; each given any number of times.
        fix_target: Whether targets stay where they are said to be.
        freeze: Parameters that stay at their nominal values.
        priors: Where the sizes of the priors come from.
        repeats: How rows of one pose count.
    """

    cell: Path | None = None
    points_unit: str | None = None
    base: str | None = None
    tip: str | None = None
    target: str | None = None
    frame: str | None = None
    model: str | None = None
    kind: str | None = None
    payload: str | None = None
    hold: tuple[str, ...] = ()
    columns: tuple[str, ...] = ()
    fix_target: bool = False
    freeze: tuple[str, ...] = ()
    priors: PriorSizes | None = None
    repeats: Repeats | None = None

    def check(self) -> Cell:
        """Refuse what can be said of no robot; the set-up of those whose row says nothing.

        Raises:
            CalibError: An option that is none, or a cell file that cannot be read.
        """
        parse_columns(self.columns)
        return read_cell(
            self.cell,
            base=self.base,
            tip=self.tip,
            target=self.target,
            frame=self.frame,
            model=self.model,
            kind=self.kind,
            hold=self.hold,
            payload=self.payload,
        )


@dataclass(frozen=True, slots=True)
class _Entry:
    """One row.

    Attributes:
        where: File and line, for messages.
        cells: Its cells that are not empty, by column.
        folder: The manifest's, which relative paths begin at.
        said: What the command line says.
    """

    where: str
    cells: dict[str, str]
    folder: Path
    said: Said

    def load(self, urdf_of: Callable[[str], Urdf]) -> FleetInputs:
        """Read the robot.

        Raises:
            CalibError: Something cannot be read, or does not fit.
        """
        from calib.fleets.robots import FleetRobot

        try:
            robot = FleetRobot.of_files(
                self.cells["name"],
                self.source(),
                self.folder / self.cells["data"],
                self._setup(),
                columns=parse_columns(self._listed("columns") or self.said.columns),
                points=self._path("points"),
                points_unit=self._points_unit(),
            )
            return robot.load(urdf_of)
        except CalibError as error:
            message = f"{self.where}: {self._told(str(error))}"
            raise CalibError(message) from error

    def robot(self, urdf_of: Callable[[str], Urdf]) -> Urdf | None:
        """The robot; None where it cannot be read."""
        try:
            return urdf_of(self.source())
        except CalibError:
            return None

    def says(self, column: str) -> bool:
        """Whether the row has a word of its own on this, or a cell file that may."""
        return column in self.cells or "cell" in self.cells

    def _told(self, text: str) -> str:
        """A message with the row's columns in the place of options that are not on the line."""
        for column in OPTIONAL:
            if column in self.cells:
                option = re.escape(f"--{column.replace('_', '-')}")
                text = re.sub(rf"{option}(?![\w-])", f"column '{column}'", text)
        return text

    def _setup(self) -> Cell:
        """The cell file with what the command line says on top of it, and what the row says on top of that."""
        from calib import kinds

        said, own = self.said, self.cells
        kind = said.kind
        if "kind" in own:
            kind = own["kind"]
            if kind not in kinds.names():
                message = f"column 'kind': '{kind}' is no kind of measurement; choose one of {choices(kinds.names())}."
                raise CalibError(message)
        setup = read_cell(
            self._path("cell") or said.cell,
            base=own.get("base", said.base),
            tip=own.get("tip", said.tip),
            target=own.get("target", said.target),
            frame=own.get("frame", said.frame),
            model=own.get("model", said.model),
            kind=kind,
            hold=self._listed("hold") or said.hold,
            payload=own.get("payload", said.payload),
        )
        return replace(
            setup,
            estimate_target=setup.estimate_target and not said.fix_target,
            frozen=(*setup.frozen, *said.freeze),
            priors=setup.priors
            if said.priors is None
            else setup.priors.with_sizes(said.priors.value),
            repeats=setup.repeats if said.repeats is None else said.repeats.value,
        )

    def source(self) -> str:
        """The robot's file, with what stands behind a xacro, or its name in example-robot-data where it is no file."""
        from calib.model.xacro_file import is_xacro

        source = self.cells["robot"]
        file = is_xacro(source) or Path(source).suffix or (self.folder / source).is_file()
        if not file or Path(source).is_absolute() or source.startswith("~"):
            return source
        # As text: what stands behind a xacro is no path.
        return f"{self.folder}{os.sep}{source}"

    def _path(self, column: str) -> Path | None:
        """A file that the row names."""
        return self.folder / self.cells[column] if column in self.cells else None

    def _points_unit(self) -> str | None:
        """The unit of the row's list of points.

        Raises:
            CalibError: A unit, and no list.
        """
        if "points_unit" in self.cells and "points" not in self.cells:
            message = (
                "points_unit is the unit of a list of points; name the list in the column 'points'."
            )
            raise CalibError(message)
        if "points" not in self.cells:
            return None
        return self.cells.get("points_unit", self.said.points_unit)

    def _listed(self, column: str) -> tuple[str, ...]:
        """The parts of a cell, with semicolons between."""
        return tuple(part.strip() for part in self.cells.get(column, "").split(";") if part.strip())


def read_manifest(path: Path, said: Said) -> tuple[FleetRobot, ...]:
    """The robots of a manifest, none of them read yet.

    Args:
        path: The manifest.
        said: What the command line says of all of them.

    Raises:
        CalibError: It cannot be read, a column is missing, unknown or there twice, a row has no name, robot or data, or
            names are those of no folder or of two robots; or what the command line says can be said of no robot.
    """
    from calib.fleets.fleet import check_names
    from calib.fleets.robots import FleetRobot
    from calib.measure.table import Table

    setup = said.check()
    table = Table.read(path)
    header = [label.strip().lower() for label in table.header]
    _check_header(header, path)
    entries = []
    for row in table.rows():
        where = f"{path.name}, line {row.line}"
        if any(row.cells[len(header) :]):
            message = (
                f"{where}: {len(row.cells)} cells, and the header has {len(header)} columns. Put texts with the "
                "separator in them in double quotes."
            )
            raise CalibError(message)
        cells = {k: v for k, v in zip(header, row.cells, strict=False) if k and v}
        lacking = [name for name in NEEDED if name not in cells]
        if lacking:
            message = f"{where}: {choices(lacking)} is empty; each robot has {choices(NEEDED)}."
            raise CalibError(message)
        entries.append(_Entry(where, cells, path.parent, said))
    if not entries:
        message = f"{path.name}: there are no robots in it, only a header."
        raise CalibError(message)
    check_names((entry.cells["name"], entry.where) for entry in entries)
    for column, what, names in (
        ("base", "link", [setup.base]),
        ("tip", "link", [setup.tip]),
        ("hold", "joint", setup.held),
    ):
        # What the line does not say stands in its cell file.
        where = f"--{column}" if getattr(said, column) else f"{said.cell}: {column}"
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
        message = (
            f"{where} '{name}': no robot of the manifest that it is for has such a {what}"
            f"{did_you_mean(name, names)}. The {what}s of {source}: {choices(names)}."
        )
        raise CalibError(message)


def check_out(path: Path, out: Path) -> None:
    """Refuse a folder whose table would be the manifest.

    Raises:
        FileError: It would.
    """
    from calib.fleets.tables import CSV

    if path.resolve() == (out / CSV).resolve():
        message = f"{path} is the manifest, and the table of results would have its name; choose another --out."
        raise FileError(message)


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
            message = (
                f"{path.name}: of its columns {choices(names)} {problem}. A manifest has {choices(NEEDED)}, and may "
                f"have {choices(OPTIONAL)}."
            )
            raise CalibError(message)
