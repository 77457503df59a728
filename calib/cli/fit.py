"""``calib fit``: a URDF and a table in, a corrected URDF out."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calib.cli.executors import Dask, SampleWorkers, executor_of
from calib.cli.options import (
    DataFile,
    FitOptions,
    Force,
    Quiet,
    RobotFile,
    Robust,
    SolverName,
    TableOptions,
    TargetLink,
    Validate,
    one_of,
    verb,
)
from calib.errors import CalibError, FileError

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from calib.calibration import Calibration
    from calib.measure.measurements import Measurements
    from calib.model.robot import Robot


def parse_figure_format(name: str) -> str:
    """The ending of a picture's file, for ``--figure-format``."""
    from calib.show.figure_base import KINDS

    return one_of(name, KINDS)


@verb("""Calibrate a robot from measurements.

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
""")
def fit(
    robot: RobotFile,
    data: DataFile,
    setup: FitOptions,
    table: TableOptions,
    solver: SolverName = "lm",
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
    report: Annotated[
        Path | None,
        typer.Option(
            "--report",
            metavar="FILE",
            help="Write a report with figures to print and sign: a page, .html.",
        ),
    ] = None,
    figures: Annotated[
        Path | None,
        typer.Option(
            "--figures",
            metavar="FOLDER",
            help="Write every figure into a folder, and their captions as captions.md; it is made if missing.",
        ),
    ] = None,
    figure_format: Annotated[
        str | None,
        typer.Option(
            "--figure-format",
            parser=parse_figure_format,
            metavar="png|svg|pdf",
            help="The kind of file of --figures. Default: png.",
        ),
    ] = None,
    target_link: TargetLink = False,
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
    robust: Robust = True,
    validate: Validate = True,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """See the text of `verb`."""
    from calib.cli.setup import check_outputs, load_with_data, read_cell
    from calib.cli.terminal import command_line, progress_bar

    _check_bootstrap(bootstrap, {"--seed": seed, "--workers": workers, "--dask": dask})
    _check_report(report, figures, figure_format, [output, json, view])
    inputs: list[str | Path] = [robot, data, *(path for path in (setup.cell, table.points) if path)]
    check_outputs([output, json, view, report], inputs, force=force)
    with executor_of(workers, dask, bootstrap, default=1) as executor:
        cell = read_cell(**asdict(setup))
        arm, rows = load_with_data(robot, cell, data, **asdict(table))

        from calib.calibration import calibrate

        with progress_bar("cross-validation", quiet=quiet) as progress:
            result = calibrate(
                arm,
                rows,
                cell=cell,
                solver=solver,
                robust=robust,
                validate=validate,
                progress=progress,
            )
        texts, tables = _intervals(
            result, bootstrap, seed or 0, profile or [], executor, quiet=quiet
        )
    kind = figure_format or "png"
    if figures is not None and not force:
        from calib.show.figures import check_free, drawings, figure_files

        check_free(figure_files(drawings(result), figures, kind))
    # Files first: a reader of the text that goes away (head, less) must not cost the results.
    written: list[object] = [
        *_write(result, output, json, view, tables, target_link=target_link, force=force)
    ]
    if report is not None:
        from calib.show.report import write_report

        written.append(write_report(result, report, command=command_line(), overwrite=force))
    if figures is not None:
        from calib.show.figures import write_figures

        with progress_bar("figures", quiet=quiet) as progress:
            made = write_figures(result, figures, kind=kind, overwrite=force, progress=progress)
        written.append(f"{figures} ({len(made)} figures)")
    if not quiet:
        _say(result, arm, rows, texts, written, urdf=output is not None)
    if output is not None and result.verdict is not None and result.verdict.use == "do not use":
        typer.echo(
            f"calib: the verdict on {output} is 'do not use': {result.verdict.reasons[0]}", err=True
        )


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
    """Write robot, result and page as far as they are asked for, one after the other."""
    if output is not None:
        yield result.write_urdf(output, overwrite=force, target_link=target_link)
    if json is not None:
        from calib.identify.result_file import write_result

        yield write_result(result, json, overwrite=force, extra=tables)
    if view is not None:
        from calib.show.pictures import write_page

        yield write_page(result, view, overwrite=force)


def _say(
    result: Calibration,
    robot: Robot,
    rows: Measurements,
    texts: Iterable[str],
    written: Iterable[object],
    *,
    urdf: bool,
) -> None:
    """Print what was left out, the summary, the intervals asked for, and what was written."""
    from calib.cli.setup import say_ignored
    from calib.cli.terminal import say

    say_ignored(rows, robot)
    say("\n\n".join([result.summary(), *texts]) + "\n")
    for path in written:
        typer.echo(f"Written: {path}")
    if not urdf:
        typer.echo("No URDF was written; add -o corrected.urdf to write it.")


def _check_report(
    report: Path | None,
    figures: Path | None,
    kind: str | None,
    others: Iterable[Path | None],
) -> None:
    """Refuse before the work what cannot be written after it.

    Args:
        report: The report's file.
        figures: The figures' folder.
        kind: Their kind.
        others: What else the command reads and writes.

    Raises:
        FileError: The report's name has an ending that no report has, or a file stands where the folder should,
            or will.
        CalibError: A kind of figures, and no folder for them.
    """
    if kind is not None and figures is None:
        raise CalibError(
            f"--figure-format {kind} is for figures; name their folder with --figures FOLDER."
        )
    if figures is not None and figures.exists() and not figures.is_dir():
        raise FileError(f"{figures} is a file; --figures names a folder, choose another name.")
    if figures is not None:
        _check_folder(figures, (report, *others))
    if report is not None:
        from calib.show.report import check_ending

        check_ending(report)


def _check_folder(folder: Path, files: Iterable[Path | None]) -> None:
    """Refuse a folder whose name a file is to have, or in whose path one stands.

    Raises:
        FileError: It has.
    """
    real = Path(os.path.realpath(folder))
    for file in files:
        if file is None:
            continue
        taken = Path(os.path.realpath(file))
        if taken == real or taken in real.parents:
            raise FileError(
                f"{folder} is the folder of --figures, and {file} is a file of this command: both cannot have the "
                "name; choose another for one of them."
            )


def _check_bootstrap(bootstrap: int | None, given: dict[str, object]) -> None:
    """Refuse what says how to draw or to fit samples that nobody asked for."""
    for option, value in given.items():
        if value is not None and bootstrap is None:
            raise CalibError(
                f"{option} is for the samples of --bootstrap; say how many, such as --bootstrap 1000."
            )


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
    from calib.cli.intervals import (
        LEVEL,
        bootstrap_table,
        bootstrap_text,
        profile_table,
        profile_text,
    )
    from calib.cli.terminal import progress_bar
    from calib.identify.uncertainty import bootstrap, profile_interval

    texts: list[str] = []
    tables: dict[str, Any] = {}
    if count is not None:
        with progress_bar("bootstrap", quiet=quiet) as progress:
            found = bootstrap(result, count, seed, progress, executor)
        texts.append(bootstrap_text(result, found))
        tables["bootstrap"] = bootstrap_table(found)
    if names:
        profiles = [
            (result.parameter(name), profile_interval(result, name, LEVEL)) for name in names
        ]
        texts.append(profile_text(profiles))
        tables["profiles"] = profile_table(profiles)
    return texts, tables
