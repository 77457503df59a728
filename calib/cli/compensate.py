"""``calib compensate``: what to command so that the true robot arrives."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from calib.cli.options import (
    Debug,
    Force,
    Hold,
    Quiet,
    RobotFile,
    reporting,
)
from calib.errors import CalibError

_HELP = """What to command so that the true robot arrives.

\b
Examples:
  calib compensate robot.urdf program.csv --calibration result.json -o commands.csv
  calib compensate robot.urdf points.csv --calibration result.json --tool target --send poses -o commands.csv
  calib compensate robot.urdf program.csv --corrected corrected.urdf --base base --tip tool0

ROBOT is the robot as its controller has it. PROGRAM is a table: joint values that were made for that robot, or poses
of its tool, x y z and an orientation, or both: then the poses are wanted, and the joint values say where to start. Out
come joint values, and poses to send to a controller that keeps its own model. A row that cannot be reached is an
error, and then nothing is written; --skip leaves such rows empty.
"""


def compensate(
    robot: RobotFile,
    program: Annotated[
        Path,
        typer.Argument(
            metavar="PROGRAM",
            help="CSV table with units in its header: joint values, poses of the tool, or both.",
        ),
    ],
    calibration: Annotated[
        Path | None, typer.Option("--calibration", help="Result that 'calib fit --json' wrote.")
    ] = None,
    corrected: Annotated[
        str | None,
        typer.Option("--corrected", metavar="ROBOT", help="Corrected URDF, in place of a result."),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Write the commands as a CSV table.")
    ] = None,
    tool: Annotated[
        str | None,
        typer.Option(
            "--tool",
            metavar='"X Y Z UNIT [RX RY RZ UNIT]"|target[:NAME]',
            help="What is to arrive: a tool in the tip, such as '0 0 150 mm', or the calibrated target. Default: the "
            "tip.",
        ),
    ] = None,
    poses_in: Annotated[
        str,
        typer.Option(
            "--poses-in",
            metavar="base|measured|SET-UP",
            help="Frame that poses are given and sent in: the base, or the one that the result's points, or those of a "
            "set-up, were measured in.",
        ),
    ] = "base",
    given: Annotated[
        Literal["joints", "poses"] | None,
        typer.Option(
            "--given",
            help="What is wanted where PROGRAM has joint values and poses. Default: poses.",
        ),
    ] = None,
    match: Annotated[
        Literal["pose", "position", "axis", "weighted"] | None,
        typer.Option(
            "--match",
            help="pose; position, orientation left free; axis: position and direction of the tool's z; weighted: as "
            "well as can be. Default: pose, weighted below six joints, position where no orientation is given.",
        ),
    ] = None,
    lever: Annotated[
        str | None,
        typer.Option(
            "--lever",
            metavar="LENGTH",
            help="With --match weighted: what an angle of one radian counts as. Default: 10 mm.",
        ),
    ] = None,
    start: Annotated[
        list[str] | None,
        typer.Option(
            "--start",
            metavar='"JOINT=VALUE UNIT"',
            help="Of poses alone: where the first row starts; each other one starts at the row before. Can be "
            "repeated. Default: the middle of the limits.",
        ),
    ] = None,
    limit: Annotated[
        str,
        typer.Option(
            "--limit",
            metavar='"LENGTH ANGLE"',
            help="Warn where the pose to send is changed by more.",
        ),
    ] = "10 mm 2 deg",
    accept: Annotated[
        str | None,
        typer.Option(
            "--accept",
            metavar='"LENGTH ANGLE"',
            help="What may be left of the error of a row. Default: 1e-8 m, 1e-8 rad.",
        ),
    ] = None,
    skip: Annotated[
        bool, typer.Option("--skip", help="Rows without a command stay in the table, empty.")
    ] = False,
    send: Annotated[
        Literal["both", "joints", "poses"],
        typer.Option("--send", help="What is written: joint values, poses, or both."),
    ] = "both",
    orientation: Annotated[
        Literal["rotation-vector", "quaternion", "rpy"],
        typer.Option("--orientation", help="How orientations are written."),
    ] = "rotation-vector",
    units: Annotated[
        Literal["deg mm", "rad m"],
        typer.Option(
            "--units",
            help="Units of the table: 'deg mm', or 'rad m' as ROS and URScript have them. A rotation vector is in rad.",
        ),
    ] = "deg mm",
    geometry: Annotated[
        bool,
        typer.Option("--geometry", help="Use the joint origins, not the result's larger model."),
    ] = False,
    payload: Annotated[
        str | None,
        typer.Option(
            "--payload",
            metavar='"MASS UNIT"',
            help="What the tip carries, for a result with compliances. Default: what it carried at its "
            "calibration.",
        ),
    ] = None,
    base: Annotated[
        str | None,
        typer.Option(
            help="Link in whose frame poses are. Default: the result's; with --corrected the URDF's root."
        ),
    ] = None,
    tip: Annotated[
        str | None,
        typer.Option(
            help="Link that the tool sits on. Default: the result's; with --corrected the end of the longest chain "
            "whose joints are in the table."
        ),
    ] = None,
    hold: Hold = None,
    columns: Annotated[
        list[str] | None,
        typer.Option(
            metavar='"NAME IN TABLE=NAME [UNIT]"',
            help="Rename a column of the table, and give its unit if it has none. Can be repeated.",
        ),
    ] = None,
    force: Force = False,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """See `_HELP`."""
    with reporting(debug=debug):
        import calib.cli.compensate_setup as setup
        from calib.cli.compensate_notes import no_commands
        from calib.cli.compensate_text import text
        from calib.cli.setup import check_outputs, parse_columns
        from calib.cli.terminal import progress_bar, say
        from calib.compensate.commands import commands
        from calib.compensate.commands_file import write_commands
        from calib.compensate.program import read_program

        inputs = [robot, program, *(name for name in (calibration, corrected) if name)]
        check_outputs([output], inputs, force=force)
        renamed = parse_columns(columns or [])
        robots = setup.robots_of(robot, calibration, corrected, program, renamed, (base, tip), hold)
        asked = read_program(program, robots.nominal, columns=renamed, given=given)
        weighs = setup.parse_lever(lever, match)
        with progress_bar("Rows", quiet=quiet) as progress:
            found = commands(
                robots.actual,
                asked,
                nominal=robots.nominal,
                tool=setup.tool_of(tool, robots),
                frame=setup.frame_of(poses_in, robots),
                match=match,
                start=setup.parse_start(start, robots.nominal) if start else None,
                limit=setup.parse_sizes(limit, "--limit", setup.UNLIMITED),
                accept=setup.parse_sizes(accept, "--accept", setup.ACCEPT),
                larger=not geometry,
                payload=setup.payload_of(payload, robots, geometry=geometry),
                progress=progress,
                **({} if weighs is None else {"lever": weighs}),
            )
        setup.parse_lever(lever, found.match)  # what is matched may have been left to the program
        if not found.reached.all() and (not skip or not found.reached.any()):
            raise CalibError(no_commands(found, skip=skip))
        written = None
        if output is not None:
            written = write_commands(
                found, output, send=send, orientation=orientation, units=units, overwrite=force
            )
        if not quiet:
            larger = robots.result is not None and robots.result.larger is not None and not geometry
            say(
                text(
                    found,
                    robots,
                    tool=tool,
                    larger=larger,
                    send=send,
                    poses_in=poses_in,
                    written=written,
                )
            )
            return
        verdict = None if found.result is None else found.result.verdict
        if verdict is not None and verdict.use == "do not use":
            typer.echo(f"calib: the verdict of {robots.name} is 'do not use'.", err=True)


compensate.__doc__ = _HELP
