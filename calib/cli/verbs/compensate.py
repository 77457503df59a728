"""``calib compensate``: what to command so that the true robot arrives."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from calib.cli.options import Columns, Force, Hold, Quiet, RobotFile, verb
from calib.errors import CalibError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from calib.text.compensation import Robots


@verb("""What to command so that the true robot arrives.

\b
Examples:
  calib compensate robot.urdf program.csv --calibration result.json -o commands.csv
  calib compensate robot.urdf points.csv --calibration result.json --tool target --send poses -o commands.csv
  calib compensate robot.urdf program.csv --corrected corrected.urdf --base base --tip tool0

ROBOT is the robot as its controller has it. PROGRAM is a table: joint values that were made for that robot, or poses
of its tool, x y z and an orientation, or both: then the poses are wanted, and the joint values say where to start. Out
come joint values, and poses to send to a controller that keeps its own model. A row that cannot be reached is an
error, and then nothing is written; --skip leaves such rows empty.
""")
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
        str,
        typer.Option(
            "--accept",
            metavar='"LENGTH ANGLE"',
            help="What may be left of the error of a row. Default: 1e-8 m, 1e-8 rad.",
            show_default=False,
        ),
    ] = "1e-8 m 1e-8 rad",
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
    columns: Columns = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """See the text of `verb`."""
    from calib.cli.setup import check_outputs, parse_columns, parse_held, parse_payload
    from calib.cli.terminal import progress_bar, say
    from calib.compensation.commands import commands, write_commands
    from calib.compensation.program import read_program
    from calib.text.compensation import BASE, MEASURED, no_commands, text

    inputs = [robot, program, *(name for name in (calibration, corrected) if name)]
    check_outputs([output], inputs, force=force)
    renamed = parse_columns(columns or [])
    robots = robots_of(
        robot, calibration, corrected, program, renamed, (base, tip), parse_held(hold or [])
    )
    asked = read_program(program, robots.nominal, columns=renamed, given=given)
    larger = None if robots.result is None or geometry else robots.result.larger
    with progress_bar("Rows", quiet=quiet) as progress:
        found = commands(
            robots.actual,
            asked,
            nominal=robots.nominal,
            tool=_tool_of(tool, robots),
            frame={BASE: None, MEASURED: ""}.get(poses_in, poses_in),
            match=match,
            lever=None if lever is None else parse_sizes(lever, "--lever", (0.0, 0.0))[0],
            start=parse_held(start or [], "--start"),
            # No correction of a pose passes a length that no arm has, or more than half a turn.
            limit=parse_sizes(limit, "--limit", (1e6, 6.3)),
            accept=parse_sizes(accept, "--accept", (1e-8, 1e-8)),
            larger=not geometry,
            payload=parse_payload(payload, larger.payload if larger else None) if payload else None,
            progress=progress,
        )
    if not found.reached.all() and (not skip or not found.reached.any()):
        raise CalibError(no_commands(found, skip=skip))
    written = None
    if output is not None:
        written = write_commands(
            found, output, send=send, orientation=orientation, units=units, overwrite=force
        )
    verdict = None if found.result is None else found.result.verdict
    if not quiet:
        say(text(found, robots, tool, poses_in, send, written, larger=larger is not None))
    elif verdict is not None and verdict.use == "do not use":
        typer.echo(f"calib: the verdict of {robots.name} is 'do not use'.", err=True)


def robots_of(
    robot: str,
    calibration: Path | None,
    corrected: str | None,
    program: Path,
    renamed: dict[str, str],
    links: tuple[str | None, str | None],
    held: dict[str, float],
) -> Robots:
    """The two robots of a call; without a result the default tip is that of a chain whose joints are in the program."""
    from calib.cli.setup import check_chain
    from calib.compensation.nominal_actual import differing_joint
    from calib.data.cell import Cell
    from calib.data.table import Table
    from calib.result.calibration_file import read_result
    from calib.robot.robot import Robot
    from calib.text.compensation import Robots
    from calib.units import split_header

    if (calibration is None) == (corrected is None):
        raise CalibError(
            "What is true of the robot comes from --calibration result.json or from --corrected corrected.urdf: give "
            "one of them."
        )
    if calibration is not None:
        result = read_result(calibration)
        check_chain(Cell(base=links[0], tip=links[1]), result, str(calibration))
        chain = result.nominal
        nominal = Robot.load(robot, chain.base, chain.tip, held={**chain.held, **held})
        was_corrected = differing_joint(nominal, result.corrected(nominal)) is None
        joint = None if was_corrected else differing_joint(nominal, result.uncorrected(nominal))
        if joint is not None:
            raise CalibError(
                f"{nominal.urdf.source}: the origin of '{joint}' is neither the one that {calibration.name} began with "
                "nor its corrected one. Give the URDF that the result was made with. If the controller has a model of "
                "its own, such as a factory calibration, give that as ROBOT and the corrected URDF with --corrected."
            )
        return Robots(nominal, result, result, calibration.name, was_corrected)
    assert corrected is not None  # one of the two is given
    columns = {split_header(label)[0] for label in (*Table.read(program).header, *renamed.values())}
    nominal = Robot.load(robot, *links, measured=columns, held=held)
    actual = Robot.load(corrected, nominal.base, nominal.tip, held=held)
    if actual.joint_names == nominal.joint_names and differing_joint(nominal, actual) is None:
        raise CalibError(
            f"{robot} and {corrected} have the same joint origins from '{nominal.base}' to '{nominal.tip}': there is "
            "nothing to correct. ROBOT is the robot as its controller has it, --corrected as it truly is."
        )
    return Robots(nominal, actual, None, Path(corrected).name)


def _tool_of(text: str | None, robots: Robots) -> NDArray[np.float64] | str | None:
    """What is to arrive: a pose in the tip, the name of a target of the result, or the tip."""
    from calib.cli.setup import with_target_link
    from calib.data.cell import Cell
    from calib.robot.robot import Robot

    tool = None if text is None else parse_tool(text)
    if tool is None or len(tool) or not isinstance(robots.actual, Robot):
        return tool
    target = with_target_link(robots.actual, Cell()).target
    if target is None:
        raise CalibError(
            f"--tool was given as '{text}', and {robots.name} has no link calib_target, which 'calib fit "
            "--target-link' adds. Give the tool's place, such as \"0 0 150 mm\", or --calibration."
        )
    return target


def parse_tool(text: str) -> NDArray[np.float64] | str:
    """``--tool``: a pose in the tip, shape (4, 4) [m]; or the name of a target, empty for the only one.

    Raises:
        CalibError: Anything else.
    """
    import numpy as np
    from scipy.spatial.transform import Rotation

    from calib.cli.setup import parse_point
    from calib.text.compensation import TARGET

    word, _, name = text.strip().partition(":")
    if word == TARGET:
        return name.strip()
    # "150mm" is as clear as "150 mm".
    words = re.findall(r"[^\s,]+", re.sub(r"(?<=[\d.])(?=[a-z]+(?:\s|$))", " ", text))
    T = np.eye(4)
    T[:3, 3] = parse_point(" ".join(words[:4]), "--tool")
    by_axes = words[4:5] == ["rpy"]
    if words[4:]:
        turn = np.array(parse_point(" ".join(words[4 + by_axes :]), "--tool", "angle"))
        rotation = Rotation.from_euler("xyz", turn) if by_axes else Rotation.from_rotvec(turn)
        T[:3, :3] = rotation.as_matrix()
    return T


def parse_sizes(text: str, option: str, otherwise: tuple[float, float]) -> tuple[float, float]:
    """``--limit``, ``--accept``, ``--lever``: a length [m] and an angle [rad], or what holds where one is not named."""
    from calib.cli.setup import parse_pair

    example = "0.05 mm 0.01 deg" if option == "--accept" else "10 mm 2 deg"
    length, angle = parse_pair(text, option, example)
    return otherwise[0] if length is None else length, otherwise[1] if angle is None else angle
