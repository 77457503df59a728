"""``calib fleet``: many robots, a row of a manifest each, calibrated and compared with each other."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, fields, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calib.cli.options import (
    Columns,
    Dask,
    FitOptions,
    ModelOptions,
    PointsUnit,
    Quiet,
    Robust,
    SolverName,
    TargetLink,
    Validate,
    Workers,
    verb,
)
from calib.cli.setup import executor_of, parse_columns, read_cell
from calib.errors import CalibError, FileError, choices

if TYPE_CHECKING:
    from calib.fleets.fleet import FleetInputs, FleetRobot
    from calib.robot.urdf import Urdf

NEEDED = ("name", "robot", "data")

#: Columns that are options of the set-up, and those that say how the data are read.
_SETUP = tuple(f.name for f in fields(ModelOptions))
OPTIONAL = (*_SETUP, "points", "points_unit", "columns")


@verb("""Calibrate a batch of robots and flag outliers.

\b
Examples:
  calib fleet manifest.csv --out results
  calib fleet manifest.csv --out results --base base --tip tool0 --target "70 -70 22.5 mm" --no-reports
  calib fleet manifest.csv --out results --dask tcp://192.168.0.10:8786

The manifest has a robot a row: its name, its robot (a URDF, a xacro, or a name such as ur3) and its data, and may say
cell, points, points_unit, base, tip, target, frame, model, kind, payload, hold and columns of it, as the options of
'calib calibrate' do. Options on the line are for all robots; what a row says wins. Each robot gets a folder with
corrected.urdf, result.json, report.html and summary.txt; fleet.csv and fleet.json compare them. Given again, the same
command keeps what is finished and unchanged. The exit code is 1 if a robot failed. See docs/fleet.md.
""")
def fleet(
    manifest: Annotated[
        Path, typer.Argument(metavar="MANIFEST", help="CSV table of the robots, one a row.")
    ],
    out: Annotated[
        Path,
        typer.Option(
            "--out", metavar="FOLDER", help="The folder for the results; made if missing."
        ),
    ],
    setup: FitOptions,
    solver: SolverName = "lm",
    points_unit: PointsUnit = None,
    columns: Columns = None,
    target_link: TargetLink = False,
    robust: Robust = True,
    validate: Validate = True,
    reports: Annotated[
        bool,
        typer.Option(
            help="Write a report for each robot, which takes longer than its calibration."
        ),
    ] = True,
    workers: Workers = None,
    dask: Dask = None,
    force: Annotated[
        bool, typer.Option("--force", help="Calibrate all robots anew, finished ones too.")
    ] = False,
    quiet: Quiet = False,
) -> None:
    """See the text of `verb`."""
    from calib.cli.terminal import command_line, progress_bar, say_table
    from calib.fleets.fleet import CSV, JSON, FleetOptions, fleet as calibrate_fleet

    if manifest.resolve() == (out / CSV).resolve():
        raise FileError(f"{manifest} would be the table of results too; choose another --out.")
    robots = read_manifest(manifest, setup, columns or (), points_unit)
    options = FleetOptions(solver, robust, validate, reports, target_link, command_line())
    try:
        with (
            executor_of(workers, dask, len(robots)) as executor,
            progress_bar("robots", quiet=quiet) as progress,
        ):
            found = calibrate_fleet(
                robots, out, options, executor=executor, progress=progress, force=force
            )
    except KeyboardInterrupt as error:
        text = f"Finished robots are kept in {out}: the same command goes on with the others."
        raise KeyboardInterrupt(text) from error
    if not quiet:
        from calib.text.fleet import fleet_cells, fleet_text

        table = found.table()
        say_table("Errors and noise, rms [mm]", *fleet_cells(table))
        for paragraph in fleet_text(table, found.kept):
            typer.echo(paragraph)
        for name in (CSV, JSON):
            typer.echo(f"Written: {out / name}")
    if found.failed:
        typer.echo(f"calib: {len(found.failed)} of {len(found.rows)} robots failed.", err=True)
        raise typer.Exit(1)


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
