"""``calib evaluate``: how far a robot is off, without changing it."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import typer

from calib.basics.files import read_bytes
from calib.cli.exit_status import ExitStatus
from calib.cli.loading import load_with_data, with_target_link
from calib.cli.notices import say_coupled, say_ignored
from calib.cli.options import (
    TARGET_OF_RESULT,
    CellOptions,
    DataFile,
    Force,
    Quiet,
    RobotFile,
    TableOptions,
)
from calib.cli.output_files import check_outputs, written_lines
from calib.cli.terminal import command_line, say
from calib.cli.verb import verb
from calib.errors import CalibError
from calib.verbs.detect.picture_folder import table_of

#: A tolerance as it could be typed.
_EXAMPLE = "0.5 mm 0.1 deg"
_METAVAR = '"LENGTH [ANGLE] [PIXELS]"'


def parse_by_unit(text: str, option: str) -> dict[str, float]:
    """Read one size for each of some units of residuals, such as ``0.5 mm 0.1 deg``.

    Args:
        text: The sizes, each with its unit.
        option: Name of the option, for messages.

    Returns:
        Each size [m], [rad] or [px], by the symbol of its unit.

    Raises:
        CalibError: The text is not of this form, or a size is negative.
    """
    from calib.basics.channels import RESIDUAL_UNITS
    from calib.basics.units import parse_quantities, quantity_name

    names = {symbol: quantity_name(unit.quantity) for symbol, unit in RESIDUAL_UNITS.items()}
    counts = dict.fromkeys(names.values(), 1)
    values = parse_quantities(text, option, counts, _EXAMPLE, signed=False)
    return {symbol: values[name][0] for symbol, name in names.items() if name in values}


@dataclass(frozen=True, slots=True)
class EvaluateOptions(CellOptions):
    """Options of the cell; targets are those of the result, if it has any."""

    helps: ClassVar[Mapping[str, str]] = TARGET_OF_RESULT


@dataclass(frozen=True, slots=True)
class AcceptanceOptions:
    """Acceptance test of the pose accuracy."""

    tolerance: Annotated[
        str | None,
        typer.Option(
            metavar=_METAVAR,
            help='Tolerance of the pose accuracy, such as "0.5 mm 0.1 deg", for an acceptance test by ISO 9283.',
        ),
    ] = None
    uncertainty: Annotated[
        str | None,
        typer.Option(
            metavar=_METAVAR,
            help="Expanded measurement uncertainty U (k = 2): AP + U must be within the tolerance. Default: 0.",
        ),
    ] = None
    criterion: Annotated[
        Literal["max", "mean", "single"] | None,
        typer.Option(
            help="What must be within the tolerance: the pose accuracy AP of every pose (max, the default), the "
            "mean of the AP "
            "(mean), or the error of every row (single)."
        ),
    ] = None
    judge: Annotated[
        Literal["nominal", "urdf", "calibration", "non_geometric"] | None,
        typer.Option(
            help="Robot that the tolerance is applied to. Default: the calibrated one; the URDF without --calibration."
        ),
    ] = None

    def limits(self) -> dict[str, Any]:
        """Return tolerance, uncertainty and criterion by name, as `calib.verbs.evaluate.acceptance.assess` takes them.

        Tolerance and uncertainty are by the symbol of their unit, in SI units or px; without a tolerance it is empty.

        Raises:
            CalibError: An option that needs a tolerance is given without one.
        """
        if self.tolerance is None:
            if self.uncertainty or self.criterion or self.judge:
                raise CalibError("--uncertainty, --criterion and --judge need a --tolerance.")
            return {}
        return {
            "tolerance": parse_by_unit(self.tolerance, "--tolerance"),
            "uncertainty": parse_by_unit(self.uncertainty or "0 mm", "--uncertainty"),
            "criterion": self.criterion or "max",
        }


@verb("""Compare a robot with measurements, and test its accuracy against a tolerance.

\b
Examples:
  calib evaluate corrected.urdf data.csv --calibration result.json
  calib evaluate robot.urdf fresh.csv --base base --tip tool0 --target "70 -70 22.5 mm"
  calib evaluate corrected.urdf fresh.csv --calibration result.json --tolerance "0.5 mm" --report test.html
  calib evaluate corrected.urdf fresh_images --calibration result.json

DATA may also be a folder with pictures of the calibration's board and their joint values in joints.csv.
With --calibration, targets, measurement frames and held joints are those of that result. Errors are given for the URDF
as it is, for the nominal and for the calibrated joint origins, and for the non-geometric model. Without it, whatever is
not given is registered to the rows. With --tolerance the exit status is 0 if the pose accuracy of ISO 9283 is shown to
be within the tolerance, and 3 otherwise.
""")
def evaluate(
    robot: RobotFile,
    data: DataFile,
    *,
    cell_options: EvaluateOptions,
    table_options: TableOptions,
    acceptance_options: AcceptanceOptions,
    json: Annotated[Path | None, typer.Option("--json", help="Write the errors as JSON.")] = None,
    report: Annotated[
        Path | None,
        typer.Option(
            "--report",
            metavar="FILE",
            help="Write a report to print and sign: a page, .html, or a PDF, .pdf.",
        ),
    ] = None,
    force: Force = False,
    calibration: Annotated[
        Path | None,
        typer.Option(
            "--calibration", help="Result of a calibration, as 'calib calibrate --json' writes it."
        ),
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Evaluate, write the files and print the errors; exit status 3 if a tolerance is not shown to be kept."""
    from calib.result.calibration_file import read_result, write_table
    from calib.result.chain_of_result import with_chain_of_result
    from calib.show.report_file import check_report
    from calib.show.robot_sentences import other_run_sentence
    from calib.verbs.evaluate.acceptance import assess
    from calib.verbs.evaluate.evaluation_file import assessment_table
    from calib.verbs.evaluate.report import Origins, summary, write_report

    if report is not None:
        check_report(report)
    inputs: list[str | Path | None] = [
        robot,
        data,
        cell_options.file,
        calibration,
        table_options.points,
    ]
    check_outputs([json, report], inputs, force=force)
    limits = acceptance_options.limits()
    cell = cell_options.cell()
    result = None
    if calibration is not None:
        result = read_result(calibration)
        cell = with_chain_of_result(cell, result, str(calibration))
    completed = cell if result is None else result.complete_cell(cell)
    boards, cameras = list(completed.boards.values()), list(completed.cameras.values())
    with table_of(data, boards, cameras, quiet=quiet) as path:
        arm, measurements = load_with_data(robot, cell, path, table_options, result)

    target_source = "as given"
    if result is not None and "target" not in cell_options.given:
        target_source = "as the result has it"
    elif result is None and cell.target is None and not cell.targets:
        cell = with_target_link(arm, cell)
        target_source = "as the URDF's link 'calib_target' has it"
        if cell.target is None:  # nothing is estimated of it, as of a clasp's
            target_source = "the tip itself"
    # Where the options give no frame or target, those of the result are taken.
    of_result = tuple(place for place in ("frame", "target") if place not in cell_options.given)
    assessment = assess(
        arm,
        measurements,
        cell,
        result,
        which=of_result,
        judge=acceptance_options.judge,
        limits=limits,
    )

    origins = Origins(target=target_source, command=command_line())
    if result is not None and calibration is not None:
        contents = read_bytes(calibration, "calibration result")
        origins = replace(
            origins,
            result=calibration.name,
            result_sha256=hashlib.sha256(contents).hexdigest(),
            run=result.run,
            other_run=other_run_sentence(arm, result, calibration.name),
        )
    if json is not None:
        write_table(assessment_table(assessment), json, overwrite=force)
    if report is not None:
        write_report(assessment, report, origins, overwrite=force)
    if not quiet:
        say_ignored(measurements, arm)
        say_coupled(arm)
        say(summary(assessment, origins))
        written = written_lines(json, report)
        if written:
            typer.echo("\n".join(["", *written]))
    if assessment.accepted is not None and assessment.accepted.outcome != "pass":
        raise typer.Exit(ExitStatus.NOT_ACCEPTED)
