"""``calib fleet``: many robots, a row of a manifest each, calibrated and compared with each other."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from calib.cli.executor import executor_of
from calib.cli.exit_status import ExitStatus
from calib.cli.options import (
    Accept,
    ColumnChoice,
    FitOptions,
    JobOptions,
    PointsUnit,
    Quiet,
    SolverOptions,
    TargetLink,
)
from calib.cli.terminal import command_line, progress_bar, say_table
from calib.cli.verb import verb
from calib.errors import FileError, choices


@verb("""Calibrate a batch of robots and flag outliers.

\b
Examples:
  calib fleet manifest.csv --out results
  calib fleet manifest.csv --out results --base base --tip tool0 --target "70 -70 22.5 mm" --no-reports
  calib fleet manifest.csv --out results --dask tcp://192.168.0.10:8786

The manifest has one row for each robot: its name, the robot (a URDF, a xacro, or a name such as ur3) and its data. It
may have columns with the options of 'calib calibrate': cell, points, points_unit, base, tip, target, frame, model,
kind, payload, hold, columns, orientation and joint_unit; and serial and date, for 'calib history'. Options on the
command line apply to all robots; the manifest overrides them. Each robot gets a folder with corrected.urdf,
result.json, report.html and summary.txt; fleet.csv and fleet.json compare them. A second run keeps what is finished and
unchanged. The exit status is 1 if a robot failed; otherwise 3 if one got no corrected.urdf because its verdict is 'do
not use'; --accept writes it anyway. See docs/fleet.md.
""")
def fleet(
    manifest: Annotated[
        Path, typer.Argument(metavar="MANIFEST", help="CSV table with one robot in each row.")
    ],
    out: Annotated[
        Path,
        typer.Option(
            "--out", metavar="FOLDER", help="Folder for the results; it is made if missing."
        ),
    ],
    *,
    cell_options: FitOptions,
    solver_options: SolverOptions,
    column_options: ColumnChoice,
    points_unit: PointsUnit = None,
    target_link: TargetLink = False,
    reports: Annotated[
        bool,
        typer.Option(
            help="Write a report for each robot, which takes longer than its calibration."
        ),
    ] = True,
    accept: Accept = False,
    force: Annotated[
        bool, typer.Option("--force", help="Calibrate all robots again, including finished ones.")
    ] = False,
    job_options: JobOptions,
    quiet: Quiet = False,
) -> None:
    """Calibrate the robots of the manifest into the folder and print their table."""
    from calib.verbs.fleet.fleet import CSV, JSON, run_fleet
    from calib.verbs.fleet.job import FleetOptions
    from calib.verbs.fleet.manifest import read_manifest
    from calib.verbs.fleet.text import fleet_cells, fleet_text

    if manifest.resolve() == (out / CSV).resolve():
        raise FileError(f"{manifest} would be the table of results too; choose another --out.")
    robots = read_manifest(manifest, cell_options, column_options, points_unit)
    solver_options.check()
    options = FleetOptions(
        solver=solver_options.solver,
        robust=solver_options.robust,
        validate=solver_options.validate,
        reports=reports,
        target_link=target_link,
        accept=accept,
        command=command_line(),
    )
    try:
        with (
            executor_of(job_options.workers, job_options.dask, len(robots)) as executor,
            progress_bar("robots", quiet=quiet) as progress,
        ):
            if progress is not None:
                progress(0, len(robots))
            calibrated = run_fleet(
                robots, out, options, executor=executor, progress=progress, force=force
            )
    except KeyboardInterrupt as error:
        text = f"Finished robots are kept in {out}: the same command goes on with the others."
        raise KeyboardInterrupt(text) from error

    if not quiet:
        table = calibrated.table()
        heads, rows = fleet_cells(table)
        say_table("Errors and noise, rms [mm]", heads, rows)
        for paragraph in fleet_text(table, calibrated.kept):
            typer.echo(paragraph)
        for name in (CSV, JSON):
            typer.echo(f"Written: {out / name}")

    # On stderr: how many robots failed, and which verdicts were obeyed or overridden.
    if calibrated.failed:
        failed, every = len(calibrated.failed), len(calibrated.rows)
        typer.echo(f"calib: {failed} of {every} robots failed.", err=True)
    consequences = (
        (calibrated.withheld, "No URDF was written; to write it anyway, add --accept."),
        (calibrated.accepted, "Because of --accept the URDF was written anyway."),
    )
    for concerned, consequence in consequences:
        if concerned:
            names = choices(row.name for row in concerned)
            typer.echo(f"calib: the verdict on {names} is 'do not use'. {consequence}", err=True)
    if calibrated.failed:
        raise typer.Exit(ExitStatus.REFUSED)
    if calibrated.withheld:
        raise typer.Exit(ExitStatus.NOT_ACCEPTED)
