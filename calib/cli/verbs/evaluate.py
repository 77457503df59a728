"""``calib evaluate``: how far a robot is off, without changing it."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

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


#: A tolerance as it could be typed, and the exit code where one was not shown to be kept.
_EXAMPLE, NOT_PASSED = "0.5 mm 0.1 deg", 3


@verb("""Compare a robot with measurements, and hold its accuracy against a tolerance.

\b
Examples:
  calib evaluate corrected.urdf data.csv --calibration result.json
  calib evaluate robot.urdf fresh.csv --base base --tip tool0 --target "70 -70 22.5 mm"
  calib evaluate corrected.urdf fresh.csv --calibration result.json --tolerance "0.5 mm"

With --calibration, targets, measurement frames and held joints are those of that result, and the robot is evaluated
as its URDF is, with the origins that the result began with, with those it found, and with its larger model if it has
one. Without it, what is not given is registered to the rows: the target (unless the URDF has the link that
'calib fit --target-link' adds), and with --frame estimate the frame.

With --tolerance the pose accuracy of ISO 9283 is judged: the exit code is 0 if it is shown to be within the tolerance,
and 3 if not. Judge on rows that the calibration was not fitted to.
""")
def evaluate(
    robot: RobotFile,
    data: DataFile,
    said: _Options,
    read: TableOptions,
    calibration: Annotated[
        Path | None, typer.Option("--calibration", help="Result that 'calib fit --json' wrote.")
    ] = None,
    tolerance: Annotated[
        str | None,
        typer.Option(
            metavar='"LENGTH [ANGLE]"',
            help='What the accuracy must be within, such as "0.5 mm" or "0.5 mm 0.1 deg".',
        ),
    ] = None,
    uncertainty: Annotated[
        str | None,
        typer.Option(
            metavar='"LENGTH [ANGLE]"',
            help="Expanded uncertainty (k = 2) of what was measured; it counts against the outcome. Default: none.",
        ),
    ] = None,
    criterion: Annotated[
        Literal["max", "mean", "single"] | None,
        typer.Option(
            help="What must be within: the AP of every pose (max, default), their mean, or every single repeat."
        ),
    ] = None,
    judge: Annotated[
        Literal["nominal", "urdf", "calibration", "larger"] | None,
        typer.Option(
            help="Which robot is judged. Default: with the joint origins of --calibration, or else the URDF as it is."
        ),
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
    from calib.result.calibration_file import read_result, write_table
    from calib.result.evaluation import check_measured
    from calib.text.evaluation import evaluate_all, evaluated_table, evaluated_text

    inputs: list[str | Path] = [
        robot,
        data,
        *(path for path in (said.cell, calibration, read.points) if path),
    ]
    check_outputs([json], inputs, force=force)
    given = {"uncertainty": uncertainty, "criterion": criterion, "judge": judge}
    useless = [f"--{name}" for name, value in given.items() if value is not None]
    limits: dict[str, Any] = {}
    if tolerance is None and useless:
        raise CalibError(
            f"{' and '.join(useless)} without --tolerance: nothing is judged without one. State it, such as "
            f'--tolerance "{_EXAMPLE}".'
        )
    if tolerance is not None:
        sure = parse_pair(uncertainty or "0 mm", "--uncertainty", _EXAMPLE)
        names = ("tolerance", "tolerance_angle", "uncertainty", "uncertainty_angle")
        sizes = (*parse_pair(tolerance, "--tolerance", _EXAMPLE), *(one or 0.0 for one in sure))
        limits = dict(zip(names, sizes, strict=True), criterion=criterion or "max")
    cell = read_cell(**asdict(said))
    stored = None if calibration is None else read_result(calibration)
    if stored is not None:
        check_chain(cell, stored, str(calibration))
        own = stored.nominal
        cell = replace(cell, base=own.base, tip=own.tip, held={**own.held, **cell.held})
    arm, table = load_with_data(robot, cell, data, **asdict(read))
    check_measured(arm if stored is None else stored.uncorrected(arm), table)
    source = "as given" if stored is None or said.target is not None else "as the result has it"
    if stored is None and cell.target is None and not cell.targets:
        cell, source = with_target_link(arm, cell), "as the URDF's link 'calib_target' has it"
    found = evaluate_all(
        arm,
        table,
        cell,
        stored,
        result="" if calibration is None else calibration.name,
        which=tuple(name for name in ("frame", "target") if getattr(said, name) is None),
        judge=judge,
        limits=limits,
    )
    written = None if json is None else write_table(evaluated_table(found), json, overwrite=force)
    if not quiet:
        say_ignored(table, arm)
        say(evaluated_text(found, source))
        if written is not None:
            typer.echo(f"\nWritten: {written}")
    if found.accepted is not None and not found.accepted.passed:
        raise typer.Exit(NOT_PASSED)
