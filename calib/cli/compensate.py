"""``calib compensate``: what to command so that the true robot arrives."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calib.cli.compensate_words import BASE, MEASURED, TARGET, Given, Match, Orientation, Send
from calib.cli.options import (
    Base,
    Debug,
    Force,
    Hold,
    Quiet,
    RobotFile,
    Tip,
    reporting,
)
from calib.errors import CalibError, choices

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from calib.identify.stored import StoredResult
    from calib.model.robot import Robot
    from calib.model.torques import Payload

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


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """What is known of the true robot.

    Attributes:
        nominal: The robot as its controller has it.
        true: A result, or a corrected robot.
        table: The result's file; None where there is none.
        name: What the text calls it.
        was_corrected: Whether ROBOT has the result's joint origins already.
    """

    nominal: Robot
    true: StoredResult | Robot
    table: dict[str, Any] | None
    name: str
    was_corrected: bool = False

    @property
    def result(self) -> StoredResult | None:
        """The result, where there is one."""
        return None if self.table is None else self.true  # type: ignore[return-value]  # a table is of a result


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
    ] = BASE,
    given: Annotated[
        Given | None,
        typer.Option(
            "--given",
            help="What is wanted where PROGRAM has joint values and poses. Default: poses.",
        ),
    ] = None,
    match: Annotated[
        Match | None,
        typer.Option(
            "--match",
            help="pose; position, orientation left free; axis: position and direction of the tool's z; weighted: as "
            "well as can be. Default: pose, weighted below six joints, position where no orientation is given.",
        ),
    ] = None,
    lever: Annotated[
        str,
        typer.Option(
            "--lever",
            metavar="LENGTH",
            help="With --match weighted: what an angle of one radian counts as.",
        ),
    ] = "10 mm",
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
            help="What may be left of the error of a row. Default: 1e-5 mm, 1e-6 deg.",
        ),
    ] = None,
    skip: Annotated[
        bool, typer.Option("--skip", help="Rows without a command stay in the table, empty.")
    ] = False,
    send: Annotated[
        Send, typer.Option("--send", help="What is written: joint values, poses, or both.")
    ] = Send.both,
    orientation: Annotated[
        Orientation, typer.Option("--orientation", help="How orientations are written.")
    ] = Orientation.vector,
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
    base: Base = None,
    tip: Tip = None,
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
        from calib.cli.compensate_text import no_commands, text
        from calib.cli.compensate_words import parse_accept, parse_lever, parse_limit, parse_start
        from calib.cli.setup import check_outputs
        from calib.cli.terminal import say
        from calib.cli.words import parse_columns
        from calib.compensate.commands import commands
        from calib.compensate.program import Program

        if (calibration is None) == (corrected is None):
            message = (
                "What is true of the robot comes from --calibration result.json or from --corrected corrected.urdf: "
                f"give one of them{'' if calibration is None else ', not both'}."
            )
            raise CalibError(message)
        inputs = [robot, program, *(name for name in (calibration, corrected) if name)]
        check_outputs([output], inputs, force=force)
        renamed = parse_columns(columns or [])
        truth = (
            _of_result(robot, calibration, base, tip, hold)
            if calibration is not None
            else _of_robots(robot, str(corrected), _names(program, renamed), base, tip, hold)
        )
        asked = Program.read(
            program, truth.nominal, columns=renamed, given=None if given is None else given.value
        )
        found = commands(
            truth.true,
            asked,
            nominal=truth.nominal,
            tool=_tool(tool, truth),
            frame=_frame(poses_in, truth),
            match=None if match is None else match.value,
            lever=parse_lever(lever),
            start=parse_start(start, truth.nominal) if start else None,
            limit=parse_limit(limit),
            accept=parse_accept(accept),
            larger=not geometry,
            payload=None if payload is None else _payload(payload, truth, geometry=geometry),
        )
        if not found.reached.all() and (not skip or not found.reached.any()):
            raise CalibError(no_commands(found, skip=skip))
        written = None
        if output is not None:
            written = found.write(
                output, send=send.value, orientation=orientation.value, overwrite=force
            )
        if quiet:
            return
        larger = truth.result is not None and truth.result.larger is not None and not geometry
        say(text(found, truth, tool=tool, larger=larger, send=send.value, written=written))


def _of_result(
    robot: str, path: Path, base: str | None, tip: str | None, hold: list[str] | None
) -> Truth:
    """The robot of a result.

    Raises:
        CalibError: The result cannot be read, is of another chain, or began with another robot.
    """
    from calib.cli.known import check_chain
    from calib.cli.words import parse_held
    from calib.identify.result_file import read_table, stored_result
    from calib.measure.cell import Cell
    from calib.model.robot import Robot

    table = read_table(path)
    stored = stored_result(table, path)
    check_chain(Cell(base=base, tip=tip), stored, str(path))
    held = {**stored.held, **parse_held(hold or [])}
    nominal = Robot.load(robot, stored.base, stored.tip, held=held)
    was_corrected = _differ(nominal, stored.corrected(nominal)) is None
    if not was_corrected:
        _check_nominal(nominal, stored, path)
    return Truth(nominal, stored, table, path.name, was_corrected)


def _check_nominal(robot: Robot, stored: StoredResult, path: Path) -> None:
    """Refuse a robot that is not the one that the result began with: what its controller has is not known then.

    Raises:
        CalibError: It has other joint origins.
    """
    joint = _differ(robot, stored.nominal(robot))
    if joint is None:
        return
    message = (
        f"{robot.urdf.source}: the origin of '{joint}' is neither the one that {path.name} began with nor its "
        "corrected one. Give the URDF that the result was made with. If the controller has a model of its own, such as "
        "a factory calibration, give that as ROBOT and the corrected URDF with --corrected."
    )
    raise CalibError(message)


def _differ(a: Robot, b: Robot) -> str | None:
    """A joint whose origin is not the same in both; None where there is none."""
    import numpy as np

    others = b.origins()
    for name, T in a.origins().items():
        if np.abs(T - others[name]).max() > _SAME:
            return name
    return None


#: Origins of one robot differ by rounding [m; rotation matrices: 1].
_SAME = 1e-9


def _of_robots(
    robot: str,
    corrected: str,
    names: set[str],
    base: str | None,
    tip: str | None,
    hold: list[str] | None,
) -> Truth:
    """The robots of two URDFs.

    Args:
        robot: As the controller has it.
        corrected: As it is.
        names: Columns of the program: a tip that is not named is the end of the longest chain with these joints.
        base: Link.
        tip: Link.
        hold: Values of joints.

    Raises:
        CalibError: A URDF cannot be read, or both are the same.
    """
    from calib.cli.words import parse_held
    from calib.model.robot import Robot

    held = parse_held(hold or [])
    nominal = Robot.load(robot, base, tip, measured=names, held=held)
    true = Robot.load(corrected, nominal.base, nominal.tip, held=held)
    if true.joint_names == nominal.joint_names and _differ(nominal, true) is None:
        message = (
            f"{robot} and {corrected} have the same joint origins from '{nominal.base}' to '{nominal.tip}': there is "
            "nothing to correct. ROBOT is the robot as its controller has it, --corrected as it truly is."
        )
        raise CalibError(message)
    return Truth(nominal, true, None, Path(corrected).name)


def _names(program: Path, renamed: dict[str, str]) -> set[str]:
    """The names of a program's columns, those that they are mapped to among them."""
    from calib.measure.table import Table
    from calib.units import split_header

    names = {split_header(label)[0] for label in Table.read(program).header}
    return names | {split_header(wanted)[0] for wanted in renamed.values()}


def _tool(text: str | None, truth: Truth) -> NDArray[np.float64] | str | None:
    """What is to arrive: a pose in the tip, the name of a target, or the tip.

    Raises:
        CalibError: The words mean nothing, or a corrected URDF carries no target.
    """
    from calib.cli.compensate_words import parse_tool
    from calib.cli.known import with_target_link
    from calib.measure.cell import Cell
    from calib.model.robot import Robot

    tool = None if text is None else parse_tool(text)
    if not isinstance(tool, str) or not isinstance(truth.true, Robot):
        return tool
    target = with_target_link(truth.true, Cell()).target
    if tool or target is None:
        message = (
            f"--tool was given as '{text}', and {truth.name} has no link calib_target, which 'calib fit --target-link' "
            'adds. Give the tool\'s place, such as "0 0 150 mm", or --calibration.'
        )
        if tool:
            message = (
                f"--tool was given as '{text}'; a URDF knows one target, without a name. Write --tool {TARGET}, or "
                "give --calibration."
            )
        raise CalibError(message)
    return target


def _frame(text: str, truth: Truth) -> str | None:
    """The set-up whose frame poses are given in; None for the base.

    Raises:
        CalibError: There is no result that knows set-ups, or none of that name.
    """
    if text == BASE:
        return None
    if truth.result is None:
        message = (
            f"--poses-in was given as '{text}', and two URDFs know no measurement frames. Leave it out, or give the "
            "result with --calibration."
        )
        raise CalibError(message)
    if text != MEASURED and text not in truth.result.known.frames:
        names = [name for name in truth.result.known.frames if name]
        message = (
            f"--poses-in was given as '{text}'; choose '{BASE}', '{MEASURED}' (the frame of the result's points)"
            + (
                f", or one of its set-ups {choices(names)}."
                if names
                else ". The result has no named set-ups."
            )
        )
        raise CalibError(message)
    return "" if text == MEASURED else text


def _payload(text: str, truth: Truth, *, geometry: bool) -> Payload:
    """What the tip carries; its centre of mass is that of the payload in the result.

    Raises:
        CalibError: No mass, or the result has no compliances that it could matter for.
    """
    from calib.cli.words import parse_payload

    larger = None if truth.result is None else truth.result.larger
    if larger is None or geometry or "compliance" not in larger.name:
        message = (
            f'--payload was given as "{text}", and the model in use knows no compliances: a payload changes nothing. '
            "Leave it out"
            + (
                ", or --geometry."
                if geometry and larger is not None
                else "; 'calib fit --model dh+compliance' estimates them."
            )
        )
        raise CalibError(message)
    return parse_payload(text, larger.payload)


compensate.__doc__ = _HELP
