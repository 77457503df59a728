"""``calib calibrate``: a URDF and a table in, a corrected URDF out."""

from __future__ import annotations

import math
import os
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
from calib.errors import CalibError, FileError

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from calib.calibration import Calibration
    from calib.result.prediction import ParameterEstimate
    from calib.result.uncertainty import Bootstrap, Profile

#: Probability that an interval holds the true value.
LEVEL = 0.95

#: A parameter with a longer name gets a line for its name alone.
_LONGEST_NAME = 34

#: An end of an interval takes this many columns.
_NUMBER = 10


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
        files = [f for f in (self.output, self.json, self.view, self.report) if f is not None]
        folder = self.figures
        if folder is None and self.figure_format is not None:
            raise CalibError(
                f"--figure-format {self.figure_format} is for figures; name their folder with --figures FOLDER."
            )
        if folder is not None:
            if folder.exists() and not folder.is_dir():
                raise FileError(
                    f"{folder} is a file; --figures names a folder, choose another name."
                )
            real = Path(os.path.realpath(folder))
            for file in files:
                if Path(os.path.realpath(file)) in (real, *real.parents):
                    raise FileError(
                        f"{folder} is the folder of --figures, and {file} is a file of this command: both cannot have "
                        "the name; choose another for one of them."
                    )
        if self.report is not None:
            from calib.report.report import check_ending

            check_ending(self.report)
        check_outputs(files, inputs, force=self.force)

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


def bootstrap_text(result: Calibration, found: Bootstrap) -> str:
    """The bootstrap's intervals beside those of the covariance.

    Those of a frame are left out: its parameters count from where registration put it.
    """
    from calib.model.parameters import FRAME

    own = [parameter.family != FRAME for parameter in result.model.parameters]
    ends = found.intervals(LEVEL).tolist()
    rows = [(p, *pair) for p, pair, shown in zip(found.parameters, ends, own, strict=True) if shown]
    lines = [
        f"Bootstrap: {len(found.x)} samples of whole poses, seed {found.seed}",
        *_interval_table(rows, "bootstrap"),
        f"Predicted positions spread by {1e3 * found.measured_rms:.3f} mm rms at the measured poses and "
        f"{1e3 * found.everywhere_rms:.3f} mm",
        f"over the joint limits; by the covariance {1e3 * result.expected_measured:.3f} mm and "
        f"{1e3 * result.expected_everywhere:.3f} mm.",
    ]
    if found.stopped:
        lines.append(f"The solver did not converge on {found.stopped} of the samples.")
    return "\n".join(lines)


def profile_text(profiles: list[tuple[ParameterEstimate, Profile]]) -> str:
    """Intervals by the profile of the cost beside those of the covariance."""
    rows = [(p, found.low, found.high) for p, found in profiles]
    return "\n".join(["Profile of the cost", *_interval_table(rows, "profile")])


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


def _interval_table(rows: list[tuple[ParameterEstimate, float, float]], what: str) -> list[str]:
    """One line a parameter: its value, the covariance's interval, and another one; in mm, deg and so on."""
    from calib.model.families import unit_of

    width = min(max([len(p.name) for p, *_ in rows] + [len("95 % intervals")]), _LONGEST_NAME) + 2
    pair = 2 * _NUMBER + 4
    lines = [f"{'95 % intervals':<{width}}{'value':>{_NUMBER}}{'covariance':>{pair}}{what:>{pair}}"]
    for p, low, high in rows:
        factor, unit = (math.degrees(1.0), "deg") if p.unit == "rad" else unit_of(p.unit).shown
        name = p.name
        if len(name) > _LONGEST_NAME:
            lines.append(name)
            name = ""
        value, *ends = (
            f"{round(factor * v, 3) + 0.0:.3f}" if math.isfinite(v) else "open"
            for v in (p.value, p.low, p.high, low, high)
        )
        cells = [f"{a:>{_NUMBER}} .. {b:>{_NUMBER}}" for a, b in (ends[:2], ends[2:])]
        if p.at_bound:
            cells[0] = f"{'at bound':>{pair}}"
        lines.append(f"{name:<{width}}{value:>{_NUMBER}}{''.join(cells)} {unit}")
    return lines
