"""``calib evaluate``: how far a robot is off, without changing it."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from calib.cli.exit_status import ExitStatus
from calib.cli.options import (
    CellOptions,
    DataFile,
    Force,
    Quiet,
    ResultTarget,
    RobotFile,
    TableOptions,
    verb,
)
from calib.cli.setup import parse_pair
from calib.errors import CalibError


@dataclass(frozen=True, slots=True)
class _Options(CellOptions):
    """The set-up; targets are those of the result where it has them."""

    target: ResultTarget = None


#: A tolerance as it could be typed.
_EXAMPLE = "0.5 mm 0.1 deg"
_METAVAR = '"LENGTH [ANGLE]"'


@verb("""Compare a robot with measurements, and judge its accuracy by a tolerance.

\b
Examples:
  calib evaluate corrected.urdf data.csv --calibration result.json
  calib evaluate robot.urdf fresh.csv --base base --tip tool0 --target "70 -70 22.5 mm"
  calib evaluate corrected.urdf fresh.csv --calibration result.json --tolerance "0.5 mm"

With --calibration, targets, measurement frames and held joints are those of that result, and the robot is evaluated
as its URDF is, with nominal and with calibrated joint origins, and with the non-geometric model. Without it, what is
not given is registered to the rows. With --tolerance the exit code is 0 if the pose accuracy of ISO 9283 is shown to
be within the tolerance, and 3 if not.
""")
def evaluate(
    robot: RobotFile,
    data: DataFile,
    said: _Options,
    read: TableOptions,
    calibration: Annotated[
        Path | None,
        typer.Option("--calibration", help="Result that 'calib calibrate --json' wrote."),
    ] = None,
    tolerance: Annotated[str | None, typer.Option(metavar=_METAVAR, help="To judge by.")] = None,
    uncertainty: Annotated[
        str | None,
        typer.Option(metavar=_METAVAR, help="Expanded measuring uncertainty (k = 2)."),
    ] = None,
    criterion: Annotated[
        Literal["max", "mean", "single"] | None,
        typer.Option(help="What must be within: every AP, their mean, or every single row."),
    ] = None,
    judge: Annotated[
        Literal["nominal", "urdf", "calibration", "non_geometric"] | None,
        typer.Option(help="Robot to judge. Default: calibration, or else urdf."),
    ] = None,
    json: Annotated[Path | None, typer.Option("--json", help="Write the errors as JSON.")] = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """See the text of `verb`."""
    from calib.cli.setup import (
        check_chain,
        check_outputs,
        load_with_data,
        read_cell,
        say_ignored,
        with_target_link,
    )
    from calib.cli.terminal import say
    from calib.result.acceptance import assess
    from calib.result.calibration_file import read_result, write_table
    from calib.text.evaluation import assessment_table, assessment_text

    inputs: list[str | Path] = [robot, data, *filter(None, (said.cell, calibration, read.points))]
    check_outputs([json], inputs, force=force)
    if tolerance is None and (uncertainty or criterion or judge):
        raise CalibError("--uncertainty, --criterion and --judge need a --tolerance.")
    limits: dict[str, Any] = {}
    if tolerance is not None:
        names = ("tolerance", "tolerance_angle", "uncertainty", "uncertainty_angle")
        sure = parse_pair(uncertainty or "0 mm", "--uncertainty", _EXAMPLE)
        sizes = (*parse_pair(tolerance, "--tolerance", _EXAMPLE), *(one or 0.0 for one in sure))
        limits = dict(zip(names, sizes, strict=True), criterion=criterion or "max")
    cell = read_cell(**asdict(said))
    stored = None if calibration is None else read_result(calibration)
    if stored is not None:
        check_chain(cell, stored, str(calibration))
        own = stored.nominal
        cell = replace(cell, base=own.base, tip=own.tip, held={**own.held, **cell.held})
    arm, table = load_with_data(robot, cell, data, **asdict(read))
    source = "as given" if stored is None or said.target is not None else "as the result has it"
    if stored is None and cell.target is None and not cell.targets:
        cell, source = with_target_link(arm, cell), "as the URDF's link 'calib_target' has it"
    which = tuple(name for name in ("frame", "target") if getattr(said, name) is None)
    found = assess(arm, table, cell, stored, which=which, judge=judge, limits=limits)
    written = None if json is None else write_table(assessment_table(found), json, overwrite=force)
    if not quiet:
        say_ignored(table, arm)
        say(assessment_text(found, calibration.name if calibration else "", source))
        if written is not None:
            typer.echo(f"\nWritten: {written}")
    if found.accepted is not None and found.accepted.outcome != "pass":
        raise typer.Exit(ExitStatus.NOT_ACCEPTED)
