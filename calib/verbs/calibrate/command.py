"""``calib calibrate``: a URDF and a table in, a corrected URDF out."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from calib.basics.progress import Stage, begin, counted, trying
from calib.cli.executor import executor_of
from calib.cli.exit_status import ExitStatus
from calib.cli.loading import load_with_data
from calib.cli.notices import say_accepted, say_ignored, say_unused_camera
from calib.cli.options import (
    DATA_HELP,
    ROBOT_HELP,
    Accept,
    Dask,
    FitOptions,
    Force,
    FrameLink,
    Quiet,
    SolverOptions,
    TableOptions,
    TargetLink,
)
from calib.cli.output_files import check_outputs
from calib.cli.terminal import command_line, say, work_line
from calib.cli.verb import verb
from calib.errors import CalibError, VerdictError

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from calib.result.calibration import Calibration
    from calib.result.call import Call
    from calib.robot.robot import Robot
    from calib.verbs.calibrate.again import ResultFile


@dataclass(frozen=True, slots=True)
class Outputs:
    """Outputs of ``calib calibrate``."""

    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", help="Write the corrected URDF (.urdf), or MuJoCo model (.xml)."
        ),
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
            help="Write a report with figures to print and sign: a page, .html, or a PDF, .pdf.",
        ),
    ] = None
    figures: Annotated[
        Path | None,
        typer.Option(
            "--figures",
            metavar="FOLDER",
            help="Write every figure into this folder, and the captions as captions.md; the folder is made if missing.",
        ),
    ] = None
    figure_format: Annotated[
        Literal["png", "svg", "pdf"] | None,
        typer.Option("--figure-format", help="File format of --figures. Default: png."),
    ] = None
    target_link: TargetLink = False
    frame_link: FrameLink = False
    accept: Accept = False
    force: Force = False

    def check(self, inputs: Iterable[str | Path | None]) -> None:
        """Refuse outputs that cannot be written before the work begins.

        Args:
            inputs: The files that are read; None: not given.

        Raises:
            CalibError: See `check_outputs`; or options that do not go together.
        """
        if self.figures is None and self.figure_format is not None:
            raise CalibError("--figure-format takes --figures FOLDER.")
        if self.figures is not None and self.figures.is_file():
            raise CalibError(f"{self.figures} is a file; --figures names a folder.")
        if self.report is not None or self.figures is not None:
            from calib.show.plotting import require_matplotlib

            require_matplotlib("A report" if self.report is not None else "A figure")
        if self.report is not None:
            from calib.show.report_file import check_report

            check_report(self.report)
        files = (self.output, self.json, self.view, self.report)
        check_outputs(files, inputs, force=self.force)

    def check_robot(self, robot: Robot) -> None:
        """Refuse, before the fit, the name of an MJCF for what cannot be written as one; raises `CalibError`."""
        from calib.robot.mjcf_write import check_mjcf_output, is_mjcf_name

        if self.output is None:
            return
        if is_mjcf_name(self.output) and (self.target_link or self.frame_link):
            raise CalibError(
                f"{self.output}: --target-link and --frame-link add links to a URDF; name it .urdf."
            )
        check_mjcf_output(robot, self.output)

    def _write_robot(self, path: Path, result: Calibration) -> Iterator[Path | str]:
        """Write the corrected URDF, or the corrected MJCF with what there is to say about it; yield the names."""
        from calib.robot.mjcf_write import is_mjcf_name

        if is_mjcf_name(path):
            from calib.show.mjcf_text import mjcf_sentences
            from calib.verbs.calibrate.write_urdf import write_corrected_mjcf

            written = write_corrected_mjcf(result, path, overwrite=self.force)
            yield from written.paths[1:]
            yield f"{path}. {' '.join(mjcf_sentences(written))}"
            return
        yield result.write_urdf(
            path,
            overwrite=self.force,
            target_link=self.target_link,
            frame_link=self.frame_link,
            accept=self.accept,
        )

    def write(self, result: Calibration, tables: Mapping[str, Any]) -> Iterator[Path | str]:
        """Write the outputs that were asked for, one after the other.

        The corrected URDF is not written if the verdict is ``do not use`` and was not accepted.

        Args:
            result: The calibration.
            tables: Further tables for the result file, by key.

        Yields:
            The name of each output, after it was written.

        Raises:
            FileError: An output exists and is not to be replaced, or cannot be written.
        """
        from calib.show.verdict_text import do_not_use_text

        if self.figures is not None and not self.force:
            from calib.verbs.calibrate.figures import drawings, figure_files

            # Figures that exist are refused before anything is written.
            figure_files(drawings(result), self.figures, self.figure_format or "png")
        if self.output is not None and (self.accept or not do_not_use_text(result.verdict)):
            yield from self._write_robot(self.output, result)
        if self.json is not None:
            from calib.result.calibration_file import write_result

            yield write_result(result, self.json, overwrite=self.force, extra=dict(tables))
        if self.view is not None:
            from calib.verbs.view.robots_page import write_page

            trying(self.view.name)
            yield write_page(result, self.view, overwrite=self.force, accepted=self.accept)
        if self.report is not None:
            from calib.verbs.calibrate.report import write_report

            trying(self.report.name)
            command = command_line()
            yield write_report(result, self.report, command=command, overwrite=self.force)
        if self.figures is not None:
            from calib.verbs.calibrate.figures import write_figures

            trying("figures")
            figures = write_figures(
                result,
                self.figures,
                kind=self.figure_format or "png",
                overwrite=self.force,
                progress=counted,
            )
            yield f"{self.figures} ({len(figures)} figures)"


@dataclass(frozen=True, slots=True)
class Intervals:
    """Intervals that are computed beside those of the covariance."""

    bootstrap: Annotated[
        int | None,
        typer.Option(
            min=40,
            metavar="N",
            help="Fit to this number of random samples of the poses, and print the resulting intervals; 1000 is a good "
            "number.",
        ),
    ] = None
    workers: Annotated[
        int | None,
        typer.Option(
            min=1,
            metavar="N",
            help="Number of processes that share the samples of --bootstrap. Default: one.",
        ),
    ] = None
    dask: Dask = None
    seed: Annotated[
        int | None,
        typer.Option(
            min=0,
            metavar="S",
            help="Seed of the samples of --bootstrap; the same seed gives the same samples.",
        ),
    ] = None
    profile: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PARAMETER",
            help="Print the profile-likelihood interval of this parameter. Can be repeated.",
        ),
    ] = None

    def check(self) -> None:
        """Refuse --seed, --workers and --dask without --bootstrap; raises `CalibError`."""
        if self.bootstrap is not None:
            return
        for option in ("seed", "workers", "dask"):
            if getattr(self, option) is not None:
                raise CalibError(
                    f"--{option} is for the samples of --bootstrap; give their number, such as "
                    "--bootstrap 1000."
                )

    def compute(
        self, result: Calibration, executor: Executor | None
    ) -> tuple[list[str], dict[str, Any]]:
        """Compute the intervals that were asked for.

        Args:
            result: The calibration.
            executor: Runs the samples of the bootstrap; None: this process.

        Returns:
            Texts to print, and tables for the result file by key.

        Raises:
            CalibError: Too many samples, no such parameter, one at a bound, or the paper's solver made the calibration.
        """
        from calib.verbs.calibrate.report import bootstrap_text, profile_text
        from calib.verbs.calibrate.uncertainty import (
            LEVEL,
            bootstrap,
            profile_interval,
            profile_table,
        )

        texts: list[str] = []
        tables: dict[str, Any] = {}
        if self.bootstrap is not None:
            begin(Stage.BOOTSTRAP)
            samples = bootstrap(result, self.bootstrap, self.seed or 0, counted, executor)
            texts.append(bootstrap_text(result, samples))
            tables["bootstrap"] = samples.table()
        if self.profile:
            begin(Stage.PROFILE)
            profiles = [
                (result.parameter(name), profile_interval(result, name, LEVEL))
                for name in self.profile
            ]
            texts.append(profile_text(profiles))
            tables["profiles"] = [profile_table(*pair) for pair in profiles]
        return texts, tables


_NO_TABLE_OPTIONS, _NO_SOLVER_OPTIONS, _NO_INTERVALS = TableOptions(), SolverOptions(), Intervals()

#: Options that count over those of a record if they are given, by the names of a call's fields.
_OVER_A_RECORD = (
    "columns",
    "orientation",
    "joint_unit",
    "motors",
    "points",
    "points_unit",
    "solver",
    "robust",
    "validate",
    "bootstrap",
    "seed",
    "profile",
    "workers",
)


def _told(
    record: ResultFile | None,
    robot: str | None,
    data: Path | None,
    cell_options: FitOptions,
    table_options: TableOptions,
    solver_options: SolverOptions,
    intervals: Intervals,
) -> Call:
    """Return what the calibration is told: by the options, of which those given count over a record, if there is one.

    Raises `CalibError` for a fault of the cell file or an option, and if an input of the record cannot be found.
    """
    from calib.basics.records import changes
    from calib.result.call import Call, file_hashes

    if record is not None and (robot is None) != (data is None):
        raise CalibError(
            "--again: name both ROBOT and DATA in place of those of the record, or neither."
        )
    cell = cell_options.cell()
    if record is not None and cell_options.file is None:
        cell = replace(record.call.cell, **changes(record.call.cell, cell_options.given))
    given = Call(
        robot=robot or "",
        table=str(data or ""),
        columns=tuple(table_options.columns or ()),
        orientation=table_options.orientation,
        joint_unit=table_options.joint_unit,
        motors=table_options.motors,
        points=None if table_options.points is None else str(table_options.points),
        points_unit=table_options.points_unit,
        cell=cell,
        solver=solver_options.solver,
        robust=solver_options.robust,
        validate=solver_options.validate,
        bootstrap=intervals.bootstrap,
        seed=intervals.seed,
        profile=tuple(intervals.profile or ()),
        workers=intervals.workers,
    )
    if record is None:
        further = [other.robot for other in cell.robots.values()]
        beside = (given.motors, cell_options.file)
        files = file_hashes([given.robot, given.table, given.points, *beside, *further])
        return replace(given, files=files)
    unsaid = Call(cell=cell)
    over: dict[str, Any] = {"cell": cell}
    for name in _OVER_A_RECORD:
        if getattr(given, name) != getattr(unsaid, name):
            over[name] = getattr(given, name)
    if robot is not None:
        over |= {"robot": given.robot, "table": given.table}
    return record.located(replace(record.call, **over))


def _needed(ctx: typer.Context, param: typer.CallbackParam, value: Any) -> Any:  # noqa: ANN401  a name or a path
    """Refuse a call without ROBOT and DATA, unless --again names a result that was made of them."""
    if value is None and not ctx.params.get("again") and not ctx.resilient_parsing:
        ctx.fail(f"Missing argument '{param.metavar}'.")
    return value


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
  calib calibrate --again result.json

The table has one row for each pose: a column for each joint, such as "joint_1 [deg]", and the measured point "x [mm]",
"y [mm]", "z [mm]". Orientations, distances, balls in sockets and touched planes can be measured too; see
docs/data-format.md. An optional column "set" says which rows are for estimation ("estimate") and which for validation
("validate"). If the verdict is "do not use", -o writes no URDF, and the exit status is 3; --accept writes it.
""")
def calibrate(
    robot: Annotated[
        str | None, typer.Argument(metavar="ROBOT", help=ROBOT_HELP, callback=_needed)
    ] = None,
    data: Annotated[
        Path | None, typer.Argument(metavar="DATA", help=DATA_HELP, callback=_needed)
    ] = None,
    *,
    again: Annotated[
        Path | None,
        typer.Option(
            "--again",
            metavar="RESULT",
            is_eager=True,
            help="Make this result (.json) again from its own record, and say what differs: inputs, versions, and "
            "every number. Options given besides count over those of the record. Exit status 3 if a number differs.",
        ),
    ] = None,
    cell_options: FitOptions,
    table_options: TableOptions,
    outputs: Outputs,
    intervals: Intervals,
    solver_options: SolverOptions,
    quiet: Quiet = False,
) -> None:
    """Calibrate as the options say, see `calibrate_files`."""
    calibrate_files(
        robot,
        data,
        cell_options,
        outputs,
        table_options=table_options,
        solver_options=solver_options,
        intervals=intervals,
        again=again,
        quiet=quiet,
    )


def calibrate_files(
    robot: str | None,
    data: Path | None,
    cell_options: FitOptions,
    outputs: Outputs,
    *,
    table_options: TableOptions = _NO_TABLE_OPTIONS,
    solver_options: SolverOptions = _NO_SOLVER_OPTIONS,
    intervals: Intervals = _NO_INTERVALS,
    again: Path | None = None,
    quiet: bool = False,
) -> None:
    """Load, fit, write the files and print the summary.

    Args:
        robot: ROBOT, as typed; None with a record.
        data: DATA; None with a record.
        cell_options: The cell file, and options over it.
        outputs: The files to write.
        table_options: How the table is read.
        solver_options: How the model is estimated.
        intervals: Intervals that are computed besides.
        again: A result that is made again from its own record.
        quiet: Whether nothing is printed.

    Raises:
        VerdictError: The verdict withheld the corrected robot.
        typer.Exit: The result is not equal to its record.
        CalibError: A fault of the inputs, or a file that cannot be written.
    """
    record = None
    if again is None:
        intervals.check()
    outputs.check([robot, data, cell_options.file, table_options.points, again])
    with contextlib.ExitStack() as stack:
        stack.enter_context(work_line(quiet=quiet))
        begin(Stage.READING)
        if again is not None:
            from calib.verbs.calibrate.again import ResultFile

            trying(again.name)
            record = ResultFile.read(again)
        told = _told(record, robot, data, cell_options, table_options, solver_options, intervals)
        if record is not None:
            intervals = replace(
                intervals,
                bootstrap=told.bootstrap,
                seed=told.seed,
                profile=list(told.profile) or None,
            )
            intervals.check()
            outputs.check([*told.files, again])
        samples = intervals.bootstrap
        executor = stack.enter_context(
            executor_of(intervals.workers, intervals.dask, samples, default=1)
        )
        replace(solver_options, solver=told.solver).check()
        trying(Path(told.table).name)
        cell = told.cell
        arm, measurements = load_with_data(
            told.robot, cell, Path(told.table), TableOptions.of_call(told)
        )
        outputs.check_robot(arm)

        from calib.result.calibrate import calibrate as calibrate_robot
        from calib.result.call import plugin_hashes
        from calib.show.verdict_text import do_not_use_text, refusal

        result = calibrate_robot(
            arm,
            measurements,
            cell=cell,
            solver=told.solver,
            robust=told.robust,
            validate=told.validate,
        )
        told = replace(told, plugins=plugin_hashes())
        result = replace(result, method=replace(result.method, call=told))
        interval_texts, tables = intervals.compute(result, executor)
        # Files first: a reader of the text that goes away (head, less) must not cost the results.
        begin(Stage.WRITING)
        written: list[Path | str] = []
        try:
            written.extend(outputs.write(result, tables))  # an interruption keeps those before it
        except KeyboardInterrupt as error:
            raise KeyboardInterrupt(_kept_text(written)) from error
    if not quiet:
        say_ignored(measurements, arm)
        say_unused_camera(measurements, cell)
        say("\n\n".join([result.summary(), *interval_texts]) + "\n")
        for path in written:
            typer.echo(f"Written: {path}")
        if outputs.output is None and result.verdict is None:
            typer.echo(
                "No URDF was written (no -o), and there is no verdict because of --no-validate."
            )
        elif outputs.output is None and not do_not_use_text(result.verdict):
            typer.echo("No URDF was written; add -o corrected.urdf to write it.")

    differs = False
    if record is not None:
        comparison = record.compared(result, told, tables)
        differs = not comparison.is_equal
        if not quiet:
            say(f"\n{comparison.summary()}\n")
    stated = do_not_use_text(result.verdict)
    withheld = outputs.output is not None and bool(stated)
    if withheld and outputs.accept:
        say_accepted(f"'{outputs.output}'", stated)
    if differs and (outputs.accept or not withheld):
        raise typer.Exit(ExitStatus.NOT_ACCEPTED)
    if outputs.output is None or not stated or outputs.accept:
        return
    message = refusal("this calibration", stated)
    if outputs.output.exists():
        message += f" '{outputs.output}' is an earlier one."
    if written and not outputs.force:
        message += " The other files were written: another attempt needs --force."
    raise VerdictError(message)


def _kept_text(written: Sequence[Path | str]) -> str:
    """Say which files were written before an interruption; empty if there are none."""
    return f"Written before: {', '.join(map(str, written))}." if written else ""
