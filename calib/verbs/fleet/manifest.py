"""The manifest of a fleet: a robot a row, each with the options of ``calib calibrate`` as columns."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from calib.cli.options import ColumnChoice, FitOptions, ModelOptions
from calib.cli.setup import read_cell
from calib.errors import CalibError, choices

if TYPE_CHECKING:
    from calib.robot.urdf import Urdf
    from calib.verbs.fleet.job import FleetInputs, FleetRobot

#: Columns that a manifest must have.
NEEDED = ("name", "robot", "data")

#: Columns with options of the measurement setup and the model.
_SETUP = tuple(f.name for f in fields(ModelOptions))

#: Columns that a manifest may have: those options, and how the data are read.
OPTIONAL = (*_SETUP, "points", "points_unit", *(f.name for f in fields(ColumnChoice)))


def read_manifest(
    path: Path,
    setup: FitOptions,
    columns: ColumnChoice,
    points_unit: str | None,
) -> tuple[FleetRobot, ...]:
    """Read a manifest; the robots themselves are read later, where they are calibrated.

    Args:
        path: The manifest, a CSV table.
        setup: Options of the command line, for all robots; the cells of a row win.
        columns: Names, orientations and units of the tables' columns, for all robots.
        points_unit: ``--points-unit``, for all robots; None: not given.

    Returns:
        A robot a row.

    Raises:
        CalibError: A column is missing or unknown, a cell is empty, or a name is no folder's or there twice.
    """
    from calib.basics.tables import Table
    from calib.verbs.fleet.job import FleetRobot, check_names

    # Options that are wrong for every robot are refused before the work.
    columns.parsed()
    read_cell(**asdict(setup))
    table = Table.read(path)
    header = _checked_header(path, table.header)
    defaults = _Defaults(path.parent, setup, columns, points_unit)
    robots, places = [], []
    for line, row in zip(table.lines, table.cells, strict=True):
        where = f"{path.name}, line {line}"
        cells = {name: cell for name, cell in zip(header, row, strict=True) if name and cell}
        if not cells.keys() >= set(NEEDED):
            raise CalibError(f"{where}: a cell is empty; each robot has {choices(NEEDED)}.")
        places.append((cells["name"], where))
        robots.append(FleetRobot(cells["name"], partial(_load, where, cells, defaults)))
    if not robots:
        raise CalibError(f"{path.name}: there are no robots in it, only a header.")
    check_names(places)
    return tuple(robots)


def _checked_header(path: Path, labels: Sequence[str]) -> list[str]:
    """Return the names of the columns in lower case, ``""`` for an empty one; raises `CalibError`."""
    header = [label.strip().lower() for label in labels]
    missing = [name for name in NEEDED if name not in header]
    allowed = {*NEEDED, *OPTIONAL, ""}
    wrong = {name for name in header if name not in allowed}
    wrong |= {name for name in header if name and header.count(name) > 1}
    if missing or wrong:
        problem = "is missing" if missing else "is not known, or there twice"
        raise CalibError(
            f"{path.name}: of its columns {choices(missing or wrong)} {problem}. A manifest has "
            f"{choices(NEEDED)}, and may have {choices(OPTIONAL)}."
        )
    return header


@dataclass(frozen=True, slots=True)
class _Defaults:
    """Options of the command line, which hold for all robots."""

    #: The manifest's, where relative paths begin
    folder: Path
    setup: FitOptions
    columns: ColumnChoice
    points_unit: str | None


def _load(
    where: str,
    cells: Mapping[str, str],
    defaults: _Defaults,
    urdf_of: Callable[[str], Urdf],
) -> FleetInputs:
    """Read the robot of a row.

    Args:
        where: The row, for messages.
        cells: Its cells that are not empty, by column.
        defaults: Options for what it does not say.
        urdf_of: Reads a URDF, or returns one that was read already.
    """
    from calib.verbs.fleet.job import FleetRobot

    folder = defaults.folder
    options: dict[str, Any] = {name: cells[name] for name in _SETUP if name in cells}
    if "hold" in cells:
        options["hold"] = _split(cells["hold"])
    if "cell" in cells:
        options["cell"] = folder / cells["cell"]
    changes: dict[str, Any] = {n: cells[n] for n in ("orientation", "joint_unit") if n in cells}
    if "columns" in cells:
        changes["columns"] = _split(cells["columns"])
    columns = replace(defaults.columns, **changes)
    points, points_unit = None, None
    if "points" in cells:
        points = folder / cells["points"]
        points_unit = cells.get("points_unit", defaults.points_unit)
    try:
        robot = FleetRobot.of_files(
            cells["name"],
            _source(cells["robot"], folder),
            folder / cells["data"],
            read_cell(**asdict(replace(defaults.setup, **options))),
            columns=columns.parsed(),
            points=points,
            points_unit=points_unit,
        )
        return robot.load(urdf_of)
    except CalibError as error:
        raise CalibError(f"{where}: {error}") from error


def _split(cell: str) -> list[str]:
    """Return the values of a cell that holds several, separated by semicolons."""
    parts = [part.strip() for part in cell.split(";")]
    return [part for part in parts if part]


def _source(robot: str, folder: Path) -> str:
    """Return the robot's file, with the arguments behind a xacro, or its name in example-robot-data.

    Args:
        robot: As the manifest has it; a relative path begins at ``folder``.
        folder: The manifest's.
    """
    is_file = _is_file(robot, folder)
    if not is_file or robot.startswith("~"):
        return robot
    # As text: what follows a xacro is no path.
    return os.path.join(folder, robot)  # noqa: PTH118


def _is_file(robot: str, folder: Path) -> bool:
    """Tell a file from the name of a robot in example-robot-data."""
    from calib.robot.xacro_file import is_xacro

    return bool(is_xacro(robot)) or bool(Path(robot).suffix) or (folder / robot).is_file()
