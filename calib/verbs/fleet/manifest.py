"""The manifest of a fleet: a robot a row, each with the options of ``calib calibrate`` as columns."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from calib.cli.options import ColumnChoice, FitOptions, ModelOptions, is_list
from calib.errors import CalibError, choices

if TYPE_CHECKING:
    from calib.verbs.fleet.job import FleetInputs, FleetRobot, UrdfReader

#: Columns that a manifest must have.
NEEDED = ("name", "robot", "data")

#: Columns that state an entry of the record of the measurement, over that of the cell file, and the entry.
RECORDED = {"serial": "robot_serial", "date": "date"}


def optional_columns() -> tuple[str, ...]:
    """Return the columns that a manifest may have: options of the cell and of the errors, and how the data are read."""
    of_cell = [parameter.name for parameter in ModelOptions.parameters()]
    others = ("points", "points_unit", *RECORDED)
    return (*of_cell, *others, *(f.name for f in fields(ColumnChoice)))


def read_manifest(
    path: Path,
    cell_options: FitOptions,
    column_options: ColumnChoice,
    points_unit: str | None,
) -> tuple[FleetRobot, ...]:
    """Read a manifest; the robots themselves are read later, when their turn has come.

    Args:
        path: The manifest, a CSV table.
        cell_options: Options of the command line, for all robots; the cells of a row override them.
        column_options: Names, orientations and units of the tables' columns, for all robots.
        points_unit: ``--points-unit``, for all robots; None: not given.

    Returns:
        A robot a row.

    Raises:
        CalibError: A column is missing or unknown, a cell is empty, or a name cannot be a folder's or occurs twice.
    """
    from calib.basics.tables import Table
    from calib.verbs.fleet.job import FleetRobot, check_names

    # Options that are wrong for every robot are refused before the work.
    column_options.parsed()
    cell_options.cell()
    table = Table.read(path)
    header = [label.strip().lower() for label in table.header]
    missing = [name for name in NEEDED if name not in header]
    optional = optional_columns()
    wrong = {name for name in header if name not in {*NEEDED, *optional, ""}}
    wrong |= {name for name in header if name and header.count(name) > 1}
    if missing or wrong:
        problem = "is missing" if missing else "is not known, or there twice"
        raise CalibError(
            f"{path.name}: of its columns {choices(missing or wrong)} {problem}. A manifest has "
            f"{choices(NEEDED)}, and may have {choices(optional, len(optional))}."
        )

    robots, places = [], []
    for line, row in zip(table.lines, table.cells, strict=True):
        where = f"{path.name}, line {line}"
        cells = {name: cell for name, cell in zip(header, row, strict=True) if name and cell}
        if not cells.keys() >= set(NEEDED):
            raise CalibError(f"{where}: a cell is empty; each robot has {choices(NEEDED)}.")
        places.append((cells["name"], where))
        load = partial(_load, where, cells, path.parent, cell_options, column_options, points_unit)
        robots.append(FleetRobot(cells["name"], load))
    if not robots:
        raise CalibError(f"{path.name}: there are no robots in it, only a header.")
    check_names(places)
    return tuple(robots)


def _load(
    where: str,
    cells: Mapping[str, str],
    folder: Path,
    cell_options: FitOptions,
    column_options: ColumnChoice,
    points_unit: str | None,
    read_urdf: UrdfReader,
) -> FleetInputs:
    """Read the inputs of the robot of a row, by its cells that are not empty; the options hold for what they omit.

    Paths count from the manifest's folder. A `CalibError` says ``where`` the row is, such as ``"fleet.csv, line 2"``.
    """
    from calib.robot.xacro_file import is_xacro
    from calib.verbs.fleet.job import FleetRobot

    changes: dict[str, Any] = {n: cells[n] for n in ("orientation", "joint_unit") if n in cells}
    if "columns" in cells:
        changes["columns"] = _split(cells["columns"])
    columns = replace(column_options, **changes)
    has_points = "points" in cells
    # The robot's file, relative to the manifest's folder unless absolute, or its name in example-robot-data. The path
    # is joined as text: arguments that follow a xacro are not part of it.
    source = cells["robot"]
    is_file = is_xacro(source) or Path(source).suffix or (folder / source).is_file()
    if is_file and not source.startswith("~"):
        source = os.path.join(folder, source)  # noqa: PTH118
    try:
        cell = options_of_row(cells, folder, cell_options).cell()
        recorded: dict[str, Any] = {
            entry: cells[name] for name, entry in RECORDED.items() if name in cells
        }
        robot = FleetRobot.of_files(
            cells["name"],
            source,
            folder / cells["data"],
            replace(cell, record=replace(cell.record, **recorded)),
            columns=columns.parsed(),
            points=folder / cells["points"] if has_points else None,
            points_unit=cells.get("points_unit", points_unit) if has_points else None,
        )
        return robot.load(read_urdf)
    except CalibError as error:
        raise CalibError(f"{where}: {error}") from error


def options_of_row(cells: Mapping[str, str], folder: Path, line: FitOptions) -> FitOptions:
    """Return the options of the cell and of the errors for a robot.

    Args:
        cells: The cells of its row that are not empty, by column; several words of one are separated by semicolons.
        folder: Folder from which the path of a cell file counts.
        line: The options of the command line, which hold for what the row does not give.
    """
    given = dict(line.given)
    for parameter in ModelOptions.parameters():
        name = parameter.name
        if name in cells and name != "cell":
            given[name] = _split(cells[name]) if is_list(parameter) else cells[name]
    return FitOptions(folder / cells["cell"] if "cell" in cells else line.file, given)


def _split(cell: str) -> list[str]:
    """Return the values of a cell that holds several, separated by semicolons."""
    parts = [part.strip() for part in cell.split(";")]
    return [part for part in parts if part]
