"""``calib fleet``: many robots, a row of a manifest each, calibrated and compared with each other."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from calib.cli.exit_status import ExitStatus
from calib.cli.options import (
    Accept,
    Columns,
    Dask,
    FitOptions,
    PointsUnit,
    Quiet,
    Robust,
    SolverName,
    TargetLink,
    Validate,
    Workers,
    verb,
)
from calib.cli.setup import executor_of
from calib.errors import FileError, choices


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
command keeps what is finished and unchanged. The exit status is 1 if a robot failed; otherwise 3 if one got no
corrected.urdf because its verdict is 'do not use', which --accept writes all the same. See docs/fleet.md.
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
    accept: Accept = False,
    force: Annotated[
        bool, typer.Option("--force", help="Calibrate all robots anew, finished ones too.")
    ] = False,
    quiet: Quiet = False,
) -> None:
    """See the text of `verb`."""
    from calib.cli.manifest import read_manifest
    from calib.cli.terminal import command_line, progress_bar, say_table
    from calib.fleets.fleet import CSV, JSON, FleetOptions, fleet as calibrate_fleet

    if manifest.resolve() == (out / CSV).resolve():
        raise FileError(f"{manifest} would be the table of results too; choose another --out.")
    robots = read_manifest(manifest, setup, columns or (), points_unit)
    options = FleetOptions(
        solver=solver,
        robust=robust,
        validate=validate,
        reports=reports,
        target_link=target_link,
        accept=accept,
        command=command_line(),
    )
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
    for rows, said in (
        (found.withheld, "No URDF was written; to write it all the same, add --accept."),
        (found.accepted, "With --accept the URDF was written all the same."),
    ):
        if rows:
            names = choices(row.name for row in rows)
            typer.echo(f"calib: the verdict on {names} is 'do not use'. {said}", err=True)
    if found.failed or found.withheld:
        raise typer.Exit(ExitStatus.REFUSED if found.failed else ExitStatus.NOT_ACCEPTED)
