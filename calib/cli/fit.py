"""``calib fit``: a URDF and a table in, a corrected URDF out."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calib.cli.executors import Dask, SampleWorkers, executor_of
from calib.cli.options import (
    Base,
    CellFile,
    Columns,
    DataFile,
    Debug,
    Force,
    Frame,
    Hold,
    MeasuredKind,
    ModelName,
    PayloadMass,
    PointsFile,
    PointsUnit,
    PriorSizes,
    Quiet,
    Repeats,
    RobotFile,
    Solver,
    Target,
    Tip,
    reporting,
)
from calib.cli.report_files import FigureFolder, FigureKind, ReportFile
from calib.errors import CalibError

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from calib.calibration import Calibration

_HELP = """Calibrate a robot from measurements.

\b
Examples:
  calib fit robot.urdf data.csv -o corrected.urdf
  calib fit robot.urdf data.csv --base base --tip tool0 --target "70 -70 22.5 mm" \\
        -o corrected.urdf --json result.json --report report.html --view view.html
  calib fit robot.urdf tracker.csv --frame estimate -o corrected.urdf
  calib fit robot.urdf joints.csv --points tracker.txt --frame estimate -o corrected.urdf
  calib fit robot.urdf data.csv --columns "J1=joint_1 [deg]" --columns "X=x [mm]" ...
  calib fit robot.urdf data.csv --bootstrap 1000 --seed 1 --profile alpha2

The table holds one row a pose: a column for each joint, such as "joint_1 [deg]", and the measured point "x [mm]",
"y [mm]", "z [mm]". Orientations, distances, balls in sockets and touched planes can be measured too; see
docs/data-format.md. An optional column "set" says which rows are for estimation ("estimate") and which for validation
("validate").
"""


def fit(
    robot: RobotFile,
    data: DataFile,
    base: Base = None,
    tip: Tip = None,
    target: Target = None,
    fix_target: Annotated[
        bool, typer.Option("--fix-target", help="Keep the target where --target says it is.")
    ] = False,
    frame: Frame = None,
    model: ModelName = None,
    solver: Annotated[
        Solver,
        typer.Option(
            help="lm: the default. scipy: the same problem by SciPy. paper: the paper's algorithm."
        ),
    ] = Solver.lm,
    priors: Annotated[
        PriorSizes | None,
        typer.Option(
            help="Sizes of the robot's errors: found from the data (data, default), as the cell file or calib's own "
            "3 mm and 15 mrad say (given), or no priors (off)."
        ),
    ] = None,
    freeze: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PARAMETER", help="Keep a parameter at its nominal value. Can be repeated."
        ),
    ] = None,
    payload: PayloadMass = None,
    repeats: Annotated[
        Repeats | None,
        typer.Option(
            help="How rows of one pose count: as their own scatter and what they share say (weighted, default), as "
            "one row (average), or each for itself (independent)."
        ),
    ] = None,
    kind: MeasuredKind = None,
    points: PointsFile = None,
    points_unit: PointsUnit = None,
    hold: Hold = None,
    columns: Columns = None,
    cell: CellFile = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Write the corrected URDF.")
    ] = None,
    json: Annotated[
        Path | None, typer.Option("--json", help="Write the whole result as JSON.")
    ] = None,
    view: Annotated[
        Path | None,
        typer.Option("--view", help="Write a page that shows both robots, to open in a browser."),
    ] = None,
    report: ReportFile = None,
    figures: FigureFolder = None,
    figure_format: FigureKind = None,
    target_link: Annotated[
        bool,
        typer.Option(
            "--target-link", help="Add a link 'calib_target' at the target to the corrected URDF."
        ),
    ] = False,
    bootstrap: Annotated[
        int | None,
        typer.Option(
            min=40,
            metavar="N",
            help="Fit again to N random samples of the poses, and print the intervals that follow; 1000 is a good "
            "number.",
        ),
    ] = None,
    workers: SampleWorkers = None,
    dask: Dask = None,
    seed: Annotated[
        int | None,
        typer.Option(min=0, metavar="S", help="Seed of --bootstrap; the same S, the same samples."),
    ] = None,
    profile: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PARAMETER",
            help="Print the interval of a parameter by the profile of the cost. Can be repeated.",
        ),
    ] = None,
    robust: Annotated[bool, typer.Option(help="Give outliers no weight.")] = True,
    validate: Annotated[
        bool, typer.Option(help="Cross-validate; without it there is no verdict.")
    ] = True,
    force: Force = False,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """See `_HELP`."""
    with reporting(debug=debug), executor_of(workers, dask, bootstrap, default=1) as executor:
        from calib.cli.progress import progress_bar
        from calib.cli.report_files import (
            check_figures,
            check_report,
            write_report_files,
        )
        from calib.cli.setup import check_outputs, load_with_data, read_cell, say_ignored
        from calib.cli.terminal import say

        _check_bootstrap(bootstrap, {"--seed": seed, "--workers": workers, "--dask": dask})
        inputs: list[str | Path] = [robot, data, *(path for path in (cell, points) if path)]
        check_report(report, figures, figure_format, [output, json, view])
        check_outputs([output, json, view, report], inputs, force=force)
        setup = read_cell(
            cell,
            base=base,
            tip=tip,
            target=target,
            frame=frame,
            model=model,
            kind=kind,
            hold=hold,
            payload=payload,
        )
        setup = replace(
            setup,
            estimate_target=setup.estimate_target and not fix_target,
            frozen=(*setup.frozen, *(freeze or ())),
            priors=setup.priors if priors is None else setup.priors.with_sizes(priors.value),
            repeats=setup.repeats if repeats is None else repeats.value,
        )
        arm, table = load_with_data(robot, setup, data, columns, points, points_unit)

        from calib.calibration import calibrate

        with progress_bar("cross-validation", quiet=quiet) as progress:
            result = calibrate(
                arm,
                table,
                cell=setup,
                solver=solver.value,
                robust=robust,
                validate=validate,
                progress=progress,
            )
        texts, tables = _intervals(
            result, bootstrap, seed or 0, profile or [], executor, quiet=quiet
        )
        check_figures(result, figures, figure_format, force=force)
        # Files first: a reader of the text that goes away (head, less) must not cost the results.
        written = [
            *_write(result, output, json, view, tables, target_link=target_link, force=force),
            *write_report_files(result, report, figures, figure_format, force=force, quiet=quiet),
        ]
        if not quiet:
            say_ignored(table, arm)
            say("\n\n".join([result.summary(), *texts]) + "\n")
            for path in written:
                typer.echo(f"Written: {path}")
            if output is None:
                typer.echo("No URDF was written; add -o corrected.urdf to write it.")
        if output is not None and result.verdict is not None and result.verdict.use == "do not use":
            typer.echo(
                f"calib: the verdict on {output} is 'do not use': {result.verdict.reasons[0]}",
                err=True,
            )


def _check_bootstrap(bootstrap: int | None, given: dict[str, object]) -> None:
    """Refuse what says how to draw or to fit samples that nobody asked for."""
    for option, value in given.items():
        if value is not None and bootstrap is None:
            message = f"{option} is for the samples of --bootstrap; say how many, such as --bootstrap 1000."
            raise CalibError(message)


def _intervals(
    result: Calibration,
    count: int | None,
    seed: int,
    names: list[str],
    executor: Executor | None,
    *,
    quiet: bool,
) -> tuple[list[str], dict[str, Any]]:
    """Bootstrap and profiles, as far as they are asked for: texts to print, and tables for the result file."""
    if count is None and not names:
        return [], {}
    from calib.cli import intervals
    from calib.cli.progress import progress_bar
    from calib.identify.uncertainty import bootstrap, profile_interval

    texts: list[str] = []
    tables: dict[str, Any] = {}
    if count is not None:
        with progress_bar("bootstrap", quiet=quiet) as progress:
            found = bootstrap(result, count, seed, progress, executor)
        texts.append(intervals.bootstrap_text(result, found))
        tables["bootstrap"] = intervals.bootstrap_table(found)
    if names:
        profiles = [
            (result.parameter(name), profile_interval(result, name, intervals.LEVEL))
            for name in names
        ]
        texts.append(intervals.profile_text(profiles))
        tables["profiles"] = intervals.profile_table(profiles)
    return texts, tables


def _write(
    result: Calibration,
    output: Path | None,
    json: Path | None,
    view: Path | None,
    tables: dict[str, Any],
    *,
    target_link: bool,
    force: bool,
) -> Iterator[Path]:
    """Write the files asked for, one after the other."""
    if output is not None:
        yield result.write_urdf(output, overwrite=force, target_link=target_link)
    if json is not None:
        from calib.identify.result_file import write_result

        yield write_result(result, json, overwrite=force, extra=tables)
    if view is not None:
        from calib.show.pictures import write_page

        yield write_page(result, view, overwrite=force)


fit.__doc__ = _HELP
