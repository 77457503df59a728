"""``calib fleet``: many robots, a row of a manifest each, calibrated and compared with each other."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from calib.cli.executors import Dask, Workers, executor_of
from calib.cli.options import (
    Base,
    CellFile,
    Columns,
    Debug,
    Frame,
    Hold,
    MeasuredKind,
    ModelName,
    PayloadMass,
    PointsUnit,
    PriorSizes,
    Quiet,
    Repeats,
    Solver,
    Target,
    Tip,
    reporting,
)

_HELP = """Calibrate many robots and say which of them are odd.

\b
Examples:
  calib fleet manifest.csv --out results
  calib fleet manifest.csv --out results --base base --tip tool0 --target "70 -70 22.5 mm" --no-reports
  calib fleet manifest.csv --out results --dask tcp://192.168.0.10:8786

The manifest has a robot a row: its name, its robot (a URDF, a xacro, or a name such as ur3) and its data, and may say
cell, points, points_unit, base, tip, target, frame, model, kind, payload, hold and columns of it, as the options of
'calib fit' do. Options on the line are for all robots; what a row says wins. Each robot gets a folder with
corrected.urdf, result.json, report.html and summary.txt; fleet.csv and fleet.json compare them. Given again, the same
command keeps what is finished and unchanged. The exit code is 1 if a robot failed. See docs/fleet.md.
"""


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
    base: Base = None,
    tip: Tip = None,
    target: Target = None,
    fix_target: Annotated[
        bool, typer.Option("--fix-target", help="Keep targets where they are said to be.")
    ] = False,
    frame: Frame = None,
    model: ModelName = None,
    solver: Annotated[Solver, typer.Option(help="As of 'calib fit'.")] = Solver.lm,
    priors: Annotated[PriorSizes | None, typer.Option(help="As of 'calib fit'.")] = None,
    freeze: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PARAMETER", help="Keep a parameter at its nominal value. Can be repeated."
        ),
    ] = None,
    payload: PayloadMass = None,
    repeats: Annotated[Repeats | None, typer.Option(help="As of 'calib fit'.")] = None,
    kind: MeasuredKind = None,
    points_unit: PointsUnit = None,
    hold: Hold = None,
    columns: Columns = None,
    cell: CellFile = None,
    target_link: Annotated[
        bool,
        typer.Option(
            "--target-link", help="Add a link 'calib_target' at the target to the corrected URDFs."
        ),
    ] = False,
    robust: Annotated[bool, typer.Option(help="Give outliers no weight.")] = True,
    validate: Annotated[
        bool, typer.Option(help="Cross-validate; without it there is no verdict.")
    ] = True,
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
    debug: Debug = False,
) -> None:
    """See `_HELP`."""
    with reporting(debug=debug):
        from calib.cli.fleet_manifest import Said, check_out, read_manifest
        from calib.cli.fleet_text import print_fleet
        from calib.cli.progress import progress_bar
        from calib.fleets.fleet import fleet as calibrate_fleet
        from calib.fleets.robots import FleetOptions

        said = Said(
            cell=cell,
            points_unit=points_unit,
            base=base,
            tip=tip,
            target=target,
            frame=frame,
            model=model,
            kind=kind,
            payload=payload,
            hold=tuple(hold or ()),
            columns=tuple(columns or ()),
            fix_target=fix_target,
            freeze=tuple(freeze or ()),
            priors=priors,
            repeats=repeats,
        )
        check_out(manifest, out)
        robots = read_manifest(manifest, said)
        options = FleetOptions(
            solver=solver.value,
            robust=robust,
            validate=validate,
            reports=reports,
            target_link=target_link,
            command=_command(),
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
            message = (
                f"Finished robots are kept in {out}: the same command goes on with the others."
            )
            raise KeyboardInterrupt(message) from error
        if not quiet:
            print_fleet(found)
            for name in ("fleet.csv", "fleet.json"):
                typer.echo(f"Written: {out / name}")
        if found.failed:
            text = f"calib: {len(found.failed)} of {len(found.rows)} robots failed"
            # What was printed above has the reasons.
            first = found.failed[0]
            text += f"; '{first.name}': {' '.join(first.message.split())}" if quiet else "."
            typer.echo(text, err=True)
            raise typer.Exit(1)


def _command() -> str:
    """The command for the reports, without where and how loudly it ran: that makes no difference to them."""
    import shlex
    import sys

    words, kept = iter(sys.argv[1:]), ["calib"]
    for word in words:
        name = word.partition("=")[0]
        if name in ("--workers", "--dask"):
            if "=" not in word:
                next(words, None)
        elif name not in ("--force", "--quiet", "--debug"):
            kept.append(word)
    return shlex.join(kept)


fleet.__doc__ = _HELP
