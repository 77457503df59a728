"""``calib compensate``: compensated commands, so that the real robot reaches the programmed poses."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from calib.cli.notices import say_accepted
from calib.cli.options import Accept, ColumnChoice, Force, Hold, PayloadMass, Quiet, RobotFile
from calib.cli.outputs import check_outputs
from calib.cli.setup import coupling_of_result, load, read_cell
from calib.cli.verb import verb
from calib.cli.words import parse_held, parse_pair, parse_payload, parse_tool
from calib.errors import CalibError, VerdictError

if TYPE_CHECKING:
    from calib.data.cell import Cell
    from calib.result.calibration import Calibration
    from calib.robot.payload import Payload
    from calib.robot.robot import Robot
    from calib.verbs.compensate.commands import Commands
    from calib.verbs.compensate.program import Program

#: What `--poses-in` calls the robot's base, and the (only) frame that was measured in.
_BASE = "base"
_MEASURED = "measured"

#: Error of a row that the search for joint values may leave, unless --tolerance says otherwise [m], [rad].
_TOLERANCE = 1e-8


@dataclass(frozen=True, slots=True)
class ModelChoice:
    """The model of the real robot."""

    calibration: Annotated[Path | None, typer.Option(help="Result JSON of a calibration.")] = None
    corrected: Annotated[
        str | None, typer.Option(help="Corrected URDF, in place of --calibration.")
    ] = None
    geometry: Annotated[
        bool, typer.Option("--geometry", help="Without the non-geometric model.")
    ] = False
    payload: PayloadMass = None
    accept: Accept = False

    @property
    def source(self) -> Path | str:
        """The file of the model.

        Raises:
            CalibError: None or two are given, or a payload for a model that does not use it.
        """
        source = self.calibration or self.corrected
        if source is None or (self.calibration and self.corrected):
            raise CalibError(
                "Give one of --calibration result.json and --corrected corrected.urdf."
            )
        if self.geometry and self.payload:
            raise CalibError(
                "--payload is for the non-geometric model, which --geometry leaves out."
            )
        return source


@dataclass(frozen=True, slots=True)
class GoalOptions:
    """Poses to reach, and the error that they may keep."""

    tool: Annotated[
        str | None,
        typer.Option(
            metavar='"X Y Z UNIT [RX RY RZ UNIT]"|target[:NAME]',
            help="Tool in the tip, such as '0 0 150 mm', or the calibrated target. Default: the tip.",
        ),
    ] = None
    poses_in: Annotated[
        str,
        typer.Option(
            metavar="base|measured|GROUP",
            help="Frame of the poses: the base, the one that was measured in, or that of a group.",
        ),
    ] = _BASE
    match: Annotated[
        Literal["pose", "position", "axis"] | None,
        typer.Option(
            help="What is to be reached; axis: position and direction of the tool's z. Default: pose."
        ),
    ] = None
    start: Annotated[
        list[str] | None,
        typer.Option(
            metavar='"JOINT=VALUE UNIT"',
            help="Joint value near which the search for the first row starts, for poses without "
            "joint values. Can be repeated.",
        ),
    ] = None
    tolerance: Annotated[
        str,
        typer.Option(metavar='"LENGTH [ANGLE]"', help="Error that a row may keep."),
    ] = "1e-8 m 1e-8 rad"
    skip: Annotated[bool, typer.Option("--skip", help="Rows out of reach stay empty.")] = False


@dataclass(frozen=True, slots=True)
class ChainOptions(ColumnChoice):
    """Chain of the robot, and the names of the program's columns."""

    cell: Annotated[
        Path | None,
        typer.Option(
            "--cell",
            help="Cell file, for --corrected: base, tip, held joints and coupled readings.",
        ),
    ] = None
    base: Annotated[str | None, typer.Option(help="Base link. Default: the result's.")] = None
    tip: Annotated[str | None, typer.Option(help="Tip link. Default: the result's.")] = None
    hold: Hold = None
    orientation: Annotated[
        str | None,
        typer.Option(
            metavar="CONVENTION",
            help="Convention of the orientations that are written, and of the program's if it has such columns: "
            "{conventions}. Default: as the program's columns are named; without orientations that of the brand, else "
            "rotation-vector.",
        ),
    ] = None


@dataclass(frozen=True, slots=True)
class CommandOutputs:
    """The table of commands."""

    output: Annotated[Path | None, typer.Option("-o", "--output", help="CSV to write.")] = None
    send: Annotated[
        Literal["both", "joints", "poses"],
        typer.Option(help="What is written: joint values to command, poses to send, or both."),
    ] = "both"
    force: Force = False


@dataclass(frozen=True, slots=True, eq=False)
class _Models:
    """Both models of the robot, and the verdict on the real one's."""

    #: As the controller has it
    nominal: Robot
    #: As it really is: a result, or the robot of a corrected URDF
    actual: Calibration | Robot
    #: What the tip carried when it was calibrated; None: nothing is known
    payload: Payload | None
    #: The verdict, as `calib.show.verdict.against` gives it; empty: nothing against it
    stated: str
    #: What to do about it besides
    remedy: str = ""


@verb("""Compute compensated commands so that the real robot reaches the programmed poses.

\b
Examples:
  calib compensate robot.urdf program.csv --calibration result.json -o commands.csv
  calib compensate robot.urdf program.csv --corrected corrected.urdf --base base --tip tool0

ROBOT is the robot as its controller has it. PROGRAM is a table of joint values planned for that robot, or of poses of
its tool, or of both: then the poses are the goal, and the search starts at the joint values. If a row cannot be
reached, nothing is written, unless --skip leaves such rows empty; and nothing where the verdict on the calibration is
'do not use' (exit status 3), unless --accept is given.
""")
def compensate(
    robot: RobotFile,
    program: Annotated[
        Path,
        typer.Argument(metavar="PROGRAM", help="Table (CSV, .xlsx): joint values, poses, or both."),
    ],
    model: ModelChoice,
    goal: GoalOptions,
    chain: ChainOptions,
    outputs: CommandOutputs,
    quiet: Quiet = False,
) -> None:
    """Run the verb; its help is the text of `verb`."""
    from calib.show.verdict import refusal
    from calib.verbs.compensate.text import no_commands, text

    source = model.source
    check_outputs([outputs.output], [robot, program, source, chain.cell], force=outputs.force)
    models = _load_models(robot, program, model, chain)
    if models.stated and not model.accept:
        raise VerdictError(refusal(f"'{source}'", models.stated) + models.remedy)
    commands = _compute(models, _read_program(program, models.nominal, goal, chain), model, goal)
    none_reached = not commands.reached.any()
    if not commands.reached.all() and (none_reached or not goal.skip):
        raise CalibError(no_commands(commands))
    convention = chain.orientation or commands.program.form or chain.parsed().brand
    _write(commands, outputs, convention)
    if not quiet:
        typer.echo(text(commands, Path(source).name, outputs.output))
    say_accepted(f"'{source}'", models.stated)


def _load_models(robot: str, program: Path, model: ModelChoice, chain: ChainOptions) -> _Models:
    """Load the nominal robot and the model of the real one."""
    if model.calibration is not None:
        return _models_of_result(robot, model.calibration, model, chain)
    from calib.basics.tables import Table
    from calib.data.columns import column_names
    from calib.data.inputs import chain_of

    joints = column_names(Table.read(program), chain.parsed())
    nominal = load(robot, _cell(chain), joints)
    actual = load(str(model.corrected), chain_of(nominal))
    return _Models(nominal, actual, payload=None, stated=actual.urdf.verdict)


def _cell(chain: ChainOptions) -> Cell:
    """Return the cell of the chain's options: the cell file's, with the options on top."""
    return read_cell(chain.cell, base=chain.base, tip=chain.tip, hold=chain.hold)


def _models_of_result(robot: str, path: Path, model: ModelChoice, chain: ChainOptions) -> _Models:
    """Load a result, and the nominal robot with its chain unless the options name another."""
    from calib.result.calibration_file import read_result
    from calib.show.verdict import against

    result = read_result(path)
    calibrated_chain = result.nominal
    given = _cell(chain)
    cell = replace(
        given,
        base=given.base or calibrated_chain.base,
        tip=given.tip or calibrated_chain.tip,
        held={**calibrated_chain.held, **given.held},
        coupling=coupling_of_result(given, result, str(path)),
    )
    nominal = load(robot, cell)
    payload = result.non_geometric.payload if result.non_geometric else None
    stated = against(result.verdict_on(non_geometric=not model.geometry))
    remedy = ""
    if stated and not against(result.verdict):
        remedy = " --geometry leaves out the non-geometric model, which this verdict is on."
    return _Models(nominal, result, payload, stated, remedy)


def _read_program(path: Path, nominal: Robot, goal: GoalOptions, chain: ChainOptions) -> Program:
    """Read the program for the nominal robot."""
    from calib.verbs.compensate.program_table import read_program

    return read_program(
        path,
        nominal,
        columns=chain.parsed(),
        match=goal.match,
        start=parse_held(goal.start or [], "--start"),
    )


def _compute(models: _Models, program: Program, model: ModelChoice, goal: GoalOptions) -> Commands:
    """Compute the commands."""
    from calib.verbs.compensate.compensate import compensate as compute_commands

    length, angle = parse_pair(goal.tolerance, "--tolerance", "0.05 mm 0.01 deg")
    non_geometric: bool | Payload = not model.geometry
    if model.payload:
        non_geometric = parse_payload(model.payload, models.payload)
    return compute_commands(
        models.actual,
        program,
        nominal=models.nominal,
        tool=parse_tool(goal.tool) if goal.tool else None,
        frame={_BASE: None, _MEASURED: ""}.get(goal.poses_in, goal.poses_in),
        tolerance=(length or _TOLERANCE, angle or _TOLERANCE),
        non_geometric=non_geometric,
        accept=model.accept,
    )


def _write(commands: Commands, outputs: CommandOutputs, orientation: str | None) -> None:
    """Write the table of commands, if it was asked for."""
    from calib.verbs.compensate.program_table import write_commands

    if outputs.output is None:
        return
    write_commands(
        commands,
        outputs.output,
        send=outputs.send,
        orientation=orientation,
        overwrite=outputs.force,
    )
