"""The manifest of a fleet: a robot a row, each with the options of ``calib calibrate`` as columns."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, fields, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from calib.cli.options import FitOptions, ModelOptions
from calib.cli.setup import parse_columns, read_cell
from calib.errors import CalibError, choices

if TYPE_CHECKING:
    from calib.fleets.fleet import FleetInputs, FleetRobot
    from calib.robot.urdf import Urdf

NEEDED = ("name", "robot", "data")

#: Columns that are options of the set-up, and those that say how the data are read.
_SETUP = tuple(f.name for f in fields(ModelOptions))
OPTIONAL = (*_SETUP, "points", "points_unit", "columns")


def read_manifest(
    path: Path, setup: FitOptions, columns: Sequence[str], points_unit: str | None
) -> tuple[FleetRobot, ...]:
    """The robots of a manifest, none of them read yet; a row's own cells win over what the command line says of all."""
    from calib.data.table import Table
    from calib.fleets.fleet import FleetRobot, check_names

    parse_columns(columns)
    read_cell(**asdict(setup))
    table = Table.read(path)
    header = [label.strip().lower() for label in table.header]
    lacking = [name for name in NEEDED if name not in header]
    wrong = {n for n in header if n and (n not in (*NEEDED, *OPTIONAL) or header.count(n) > 1)}
    if lacking or wrong:
        problem = "is missing" if lacking else "is not known, or there twice"
        raise CalibError(
            f"{path.name}: of its columns {choices(lacking or wrong)} {problem}. A manifest has {choices(NEEDED)}, "
            f"and may have {choices(OPTIONAL)}."
        )
    robots, names = [], []
    for line, row in zip(table.lines, table.cells, strict=True):
        where = f"{path.name}, line {line}"
        cells = {k: v for k, v in zip(header, row, strict=True) if k and v}
        if not cells.keys() >= set(NEEDED):
            raise CalibError(f"{where}: a cell is empty; each robot has {choices(NEEDED)}.")
        names.append((cells["name"], where))
        load = partial(_load, where, cells, path.parent, setup, columns, points_unit)
        robots.append(FleetRobot(cells["name"], load))
    if not robots:
        raise CalibError(f"{path.name}: there are no robots in it, only a header.")
    check_names(names)
    return tuple(robots)


def _load(
    where: str,
    cells: dict[str, str],
    folder: Path,
    setup: FitOptions,
    columns: Sequence[str],
    points_unit: str | None,
    urdf_of: Callable[[str], Urdf],
) -> FleetInputs:
    """Read the robot of a row; relative paths begin at the manifest's folder."""
    from calib.fleets.fleet import FleetRobot

    own: dict[str, Any] = {name: cells[name] for name in _SETUP if name in cells}
    lists: dict[str, Any] = {
        name: [part.strip() for part in cells[name].split(";") if part.strip()]
        for name in ("hold", "columns")
        if name in cells
    }
    renamed = lists.pop("columns", columns)
    files: dict[str, Any] = {
        name: folder / cells[name] for name in ("cell", "points") if name in cells
    }
    points = files.pop("points", None)
    try:
        return FleetRobot.of_files(
            cells["name"],
            _source(cells["robot"], folder),
            folder / cells["data"],
            read_cell(**asdict(replace(setup, **(own | lists | files)))),
            columns=parse_columns(renamed),
            points=points,
            points_unit=cells.get("points_unit", points_unit) if points else None,
        ).load(urdf_of)
    except CalibError as error:
        raise CalibError(f"{where}: {error}") from error


def _source(robot: str, folder: Path) -> str:
    """The robot's file, with what stands behind a xacro, or its name in example-robot-data where it is no file."""
    from calib.robot.xacro_file import is_xacro

    file = is_xacro(robot) or Path(robot).suffix or (folder / robot).is_file()
    # As text: what stands behind a xacro is no path.
    return os.path.join(folder, robot) if file and robot[0] != "~" else robot  # noqa: PTH118
