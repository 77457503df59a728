"""``calib calibrate``: a URDF and a table in, a corrected URDF out."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from calib.cli.options import (
    Dask,
    DataFile,
    FitOptions,
    Force,
    Quiet,
    RobotFile,
    Robust,
    SampleWorkers,
    SolverName,
    TableOptions,
    TargetLink,
    Validate,
    verb,
)
from calib.cli.setup import check_outputs, executor_of, load_with_data, read_cell, say_ignored
from calib.cli.terminal import command_line, progress_bar, say
from calib.errors import CalibError
from calib.text.intervals import LEVEL, bootstrap_text, profile_text

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from calib.calibration import Calibration
    from calib.result.uncertainty import Bootstrap


@dataclass(frozen=True, slots=True)
class Outputs:
    """What is written."""

    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Write the corrected URDF.")
    ] = None
    json: Annotated[Path | None, typer.Option("--json", help="Write the whole result as JSON.")] = (
        None
    )
    view: Annotated[
        Path | None,
        typer.Option("--view", help="Write a page that shows both robots, to open in a browser."),
    ] = None
    report: Annotated[
        Path | None,
        typer.Option(
            "--report",
            metavar="FILE",
            help="Write a report with figures to print and sign: a page, .html.",
        ),
    ] = None
    figures: Annotated[
        Path | None,
        typer.Option(
            "--figures",
            metavar="FOLDER",
            help="Write every figure into a folder, and their captions as captions.md; it is made if missing.",
        ),
    ] = None
    figure_format: Annotated[
        Literal["png", "svg", "pdf"] | None,
        typer.Option("--figure-format", help="The kind of file of --figures. Default: png."),
    ] = None
    target_link: TargetLink = False
    force: Force = False

    def check(self, inputs: list[str | Path]) -> None:
        """Refuse before the work what cannot be written after it.

        Raises:
            CalibError: It cannot.
        """
        if self.figures is None and self.figure_format is not None:
            raise CalibError(
                "--figure-format is for figures; name their folder with --figures FOLDER."
            )
        if self.figures is not None and self.figures.is_file():
            raise CalibError(f"{self.figures} is a file; --figures names a folder.")
        if self.report is not None:
            from calib.report.report import check_ending

            check_ending(self.report)
        check_outputs((self.output, self.json, self.view, self.report), inputs, force=self.force)

    def write(
        self, result: Calibration, tables: dict[str, Any], *, quiet: bool
    ) -> Iterator[Path | str]:
        """Write what was asked for, one after the other; ``tables`` go into the result file too."""
        force, kind = self.force, self.figure_format or "png"
        if self.figures is not None and not force:
            from calib.report.figures import check_free, drawings, figure_files

            check_free(figure_files(drawings(result), self.figures, kind))
        if self.output is not None:
            yield result.write_urdf(self.output, overwrite=force, target_link=self.target_link)
        if self.json is not None:
            from calib.result.calibration_file import write_result

            yield write_result(result, self.json, overwrite=force, extra=tables)
        if self.view is not None:
            from calib.viewer.page import write_page

            yield write_page(result, self.view, overwrite=force)
        if self.report is not None:
            from calib.report.report import write_report

            yield write_report(result, self.report, command=command_line(), overwrite=force)
        if self.figures is not None:
            from calib.report.figures import write_figures

            with progress_bar("figures", quiet=quiet) as progress:
                made = write_figures(
                    result, self.figures, kind=kind, overwrite=force, progress=progress
                )
            yield f"{self.figures} ({len(made)} figures)"


@dataclass(frozen=True, slots=True)
class Intervals:
    """Which intervals are computed beside those of the covariance."""

    bootstrap: Annotated[
        int | None,
        typer.Option(
            min=40,
            metavar="N",
            help="Fit again to N random samples of the poses, and print the intervals that follow; 1000 is a good "
            "number.",
        ),
    ] = None
    workers: SampleWorkers = None
    dask: Dask = None
    seed: Annotated[
        int | None,
        typer.Option(min=0, metavar="S", help="Seed of --bootstrap; the same S, the same samples."),
    ] = None
    profile: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PARAMETER",
            help="Print the interval of a parameter by the profile of the cost. Can be repeated.",
        ),
    ] = None

    def compute(
        self, result: Calibration, executor: Executor | None, *, quiet: bool
    ) -> tuple[list[str], dict[str, Any]]:
        """Bootstrap and profiles, as far as they are asked for: texts to print, and tables for the result file."""
        from calib.result.uncertainty import bootstrap, profile_interval

        texts: list[str] = []
        tables: dict[str, Any] = {}
        if self.bootstrap is not None:
            with progress_bar("bootstrap", quiet=quiet) as progress:
                found = bootstrap(result, self.bootstrap, self.seed or 0, progress, executor)
            texts.append(bootstrap_text(result, found))
            tables["bootstrap"] = _bootstrap_table(found)
        if self.profile:
            profiles = [
                (result.parameter(n), profile_interval(result, n, LEVEL)) for n in self.profile
            ]
            texts.append(profile_text(profiles))
            tables["profiles"] = [
                {"name": p.name, "unit": p.unit, **asdict(found)} for p, found in profiles
            ]
        return texts, tables


@verb("""Calibrate a robot from measurements.

\b
Examples:
  calib calibrate robot.urdf data.csv -o corrected.urdf
  calib calibrate robot.urdf data.csv --base base --tip tool0 --target "70 -70 22.5 mm" \\
        -o corrected.urdf --json result.json --report report.html --view view.html
  calib calibrate robot.urdf tracker.csv --frame estimate -o corrected.urdf
  calib calibrate robot.urdf joints.csv --points tracker.txt --frame estimate -o corrected.urdf
  calib calibrate robot.urdf data.csv --columns "J1=joint_1 [deg]" --columns "X=x [mm]" ...
  calib calibrate robot.urdf data.csv --bootstrap 1000 --seed 1 --profile alpha2

The table holds one row a pose: a column for each joint, such as "joint_1 [deg]", and the measured point "x [mm]",
"y [mm]", "z [mm]". Orientations, distances, balls in sockets and touched planes can be measured too; see
docs/data-format.md. An optional column "set" says which rows are for estimation ("estimate") and which for validation
("validate").
""")
def calibrate(
    robot: RobotFile,
    data: DataFile,
    setup: FitOptions,
    table: TableOptions,
    outputs: Outputs,
    intervals: Intervals,
    solver: SolverName = "lm",
    robust: Robust = True,
    validate: Validate = True,
    quiet: Quiet = False,
) -> None:
    """See the text of `verb`."""
    count = intervals.bootstrap
    for option in ("seed", "workers", "dask"):
        if getattr(intervals, option) is not None and count is None:
            raise CalibError(
                f"--{option} is for the samples of --bootstrap; say how many, such as --bootstrap 1000."
            )
    outputs.check([robot, data, *(path for path in (setup.cell, table.points) if path)])
    with executor_of(intervals.workers, intervals.dask, count, default=1) as executor:
        cell = read_cell(**asdict(setup))
        arm, rows = load_with_data(robot, cell, data, **asdict(table))

        from calib.calibration import calibrate as calibrated

        with progress_bar("cross-validation", quiet=quiet) as progress:
            result = calibrated(
                arm,
                rows,
                cell=cell,
                solver=solver,
                robust=robust,
                validate=validate,
                progress=progress,
            )
        texts, tables = intervals.compute(result, executor, quiet=quiet)
    # Files first: a reader of the text that goes away (head, less) must not cost the results.
    written = list(outputs.write(result, tables, quiet=quiet))
    if not quiet:
        say_ignored(rows, arm)
        say("\n\n".join([result.summary(), *texts]) + "\n")
        for path in written:
            typer.echo(f"Written: {path}")
        if outputs.output is None:
            typer.echo("No URDF was written; add -o corrected.urdf to write it.")
    if outputs.output and result.verdict is not None and result.verdict.use == "do not use":
        from calib.text.verdict import reason_text

        why = reason_text(result.verdict.reasons[0])
        typer.echo(f"calib: the verdict on {outputs.output} is 'do not use': {why}", err=True)


def _bootstrap_table(found: Bootstrap) -> dict[str, Any]:
    """The bootstrap as nested tables of plain values, for the result file."""
    return {
        "samples": len(found.x),
        "seed": found.seed,
        "stopped": found.stopped,
        "level": LEVEL,
        "parameters": [
            {"name": p.name, "unit": p.unit, "std": std, "low": low, "high": high}
            for p, std, (low, high) in zip(
                found.parameters, found.std, found.intervals(LEVEL), strict=True
            )
        ],
        "expected": {
            "measured_rms_m": found.measured_rms,
            "everywhere_rms_m": found.everywhere_rms,
        },
    }
