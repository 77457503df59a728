"""``calib compensate``: compensated commands, so that the real robot reaches the programmed poses."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from calib.cli.options import Accept, Columns, Force, Hold, PayloadMass, Quiet, RobotFile, verb
from calib.errors import CalibError, VerdictError

Forms = Literal["rotation-vector", "quaternion", "rpy"]
_TOOL = '"X Y Z UNIT [RX RY RZ UNIT]"|target[:NAME]'
_TOOL_HELP = "Tool in the tip, such as '0 0 150 mm', or the calibrated target. Default: the tip."
_FRAME = "Frame of the poses: the base, the one that was measured in, or that of a set-up."
_MATCH = "What is to be reached; axis: position and direction of the tool's z. Default: pose."
_START = (
    "Joint value that the first row starts near, of poses without joint values. Can be repeated."
)
_SEND = "What is written: joint values to command, poses to send, or both."


@verb("""Compute compensated commands so that the real robot reaches the programmed poses.

\b
Examples:
  calib compensate robot.urdf program.csv --calibration result.json -o commands.csv
  calib compensate robot.urdf program.csv --corrected corrected.urdf --base base --tip tool0

ROBOT is the robot as its controller has it. PROGRAM is a table of joint values planned for that robot, or of poses of
its tool, or of both: then the poses are wanted, and the joint values say where to start. If a row cannot be reached,
nothing is written, unless --skip leaves such rows empty; and nothing where the verdict on the calibration is
'do not use' (exit status 3), unless --accept is given.
""")
def compensate(
    robot: RobotFile,
    program: Annotated[
        Path, typer.Argument(metavar="PROGRAM", help="CSV table: joint values, poses, or both.")
    ],
    calibration: Annotated[Path | None, typer.Option(help="Result JSON of a calibration.")] = None,
    corrected: Annotated[str | None, typer.Option(help="Corrected URDF, in place of it.")] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="CSV to write.")] = None,
    tool: Annotated[str | None, typer.Option(metavar=_TOOL, help=_TOOL_HELP)] = None,
    poses_in: Annotated[str, typer.Option(metavar="base|measured|SET-UP", help=_FRAME)] = "base",
    match: Annotated[Literal["pose", "position", "axis"] | None, typer.Option(help=_MATCH)] = None,
    start: Annotated[
        list[str] | None, typer.Option(metavar='"JOINT=VALUE UNIT"', help=_START)
    ] = None,
    tolerance: Annotated[
        str, typer.Option(metavar='"LENGTH [ANGLE]"', help="Error that may be left of a row.")
    ] = "1e-8 m 1e-8 rad",
    skip: Annotated[bool, typer.Option("--skip", help="Rows out of reach stay empty.")] = False,
    send: Annotated[Literal["both", "joints", "poses"], typer.Option(help=_SEND)] = "both",
    orientation: Annotated[Forms, typer.Option(help="Form of orientations.")] = "rotation-vector",
    geometry: Annotated[
        bool, typer.Option("--geometry", help="Without the non-geometric model.")
    ] = False,
    payload: PayloadMass = None,
    base: Annotated[str | None, typer.Option(help="Base link. Default: the result's.")] = None,
    tip: Annotated[str | None, typer.Option(help="Tip link. Default: the result's.")] = None,
    hold: Hold = None,
    columns: Columns = None,
    accept: Accept = False,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """See the text of `verb`."""
    import calib.cli.setup as words
    from calib.compensation.commands import compensate as compensated, write_commands
    from calib.compensation.program import read_program
    from calib.data.table import Table
    from calib.result.calibration import CalibrationValues
    from calib.result.calibration_file import read_result
    from calib.robot.robot import Robot
    from calib.text.compensation import no_commands, text
    from calib.text.verdict import against, refusal

    source = calibration or corrected
    if source is None or (calibration and corrected):
        raise CalibError("Give one of --calibration result.json and --corrected corrected.urdf.")
    if geometry and payload:
        raise CalibError("--payload is for the non-geometric model, which --geometry leaves out.")
    words.check_outputs([output], [robot, program, source], force=force)
    renamed, held = words.parse_columns(columns or []), words.parse_held(hold or [])
    actual: CalibrationValues | Robot
    carried, without = None, ""
    if calibration is not None:
        actual = read_result(calibration)
        chain = actual.nominal
        held = {**chain.held, **held}
        nominal = Robot.load(robot, base or chain.base, tip or chain.tip, held=held)
        carried = actual.non_geometric.payload if actual.non_geometric else None
        stated = against(actual.verdict_on(non_geometric=not geometry))
        if stated and not against(actual.verdict):
            without = " --geometry leaves out the non-geometric model, which this verdict is on."
    else:
        nominal = Robot.load(robot, base, tip, Table.read(program).names(renamed), held)
        actual = Robot.load(str(corrected), nominal.base, nominal.tip, held=held)
        stated = actual.urdf.verdict
    if stated and not accept:
        raise VerdictError(refusal(f"'{source}'", stated) + without)
    left = words.parse_pair(tolerance, "--tolerance", "0.05 mm 0.01 deg")
    near = words.parse_held(start or [], "--start")
    found = compensated(
        actual,
        read_program(program, nominal, columns=renamed, match=match, start=near),
        nominal=nominal,
        tool=words.parse_tool(tool) if tool else None,
        frame={"base": None, "measured": ""}.get(poses_in, poses_in),
        tolerance=(left[0] or 1e-8, left[1] or 1e-8),
        non_geometric=words.parse_payload(payload, carried) if payload else not geometry,
        accept=accept,
    )
    if not found.reached.all() and (not skip or not found.reached.any()):
        raise CalibError(no_commands(found))
    if output is not None:
        write_commands(found, output, send=send, orientation=orientation, overwrite=force)
    if not quiet:
        typer.echo(text(found, Path(source).name, output))
    words.say_accepted(f"'{source}'", stated)
