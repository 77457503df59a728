"""``calib compensate``: compensated commands, so that the real robot reaches the programmed poses."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import typer

from calib.cli.loading import load
from calib.cli.notices import say_accepted
from calib.cli.options import Accept, CellOptions, ColumnChoice, Force, Quiet, RobotFile
from calib.cli.output_files import check_outputs
from calib.cli.verb import verb
from calib.errors import CalibError, MeasurementError, VerdictError, choices

if TYPE_CHECKING:
    from calib.basics.arrays import Array
    from calib.data.cell import Cell
    from calib.result.calibration import Calibration
    from calib.robot.gravity import Payload
    from calib.robot.robot import Robot

#: The words by which `--poses-in` means the robot's base, and the only measurement frame.
_BASE = "base"
_MEASURED = "measured"

#: Error of a row that the search for joint values may leave, unless --tolerance says otherwise [m], [rad].
_TOLERANCE = 1e-8


@dataclass(frozen=True, slots=True)
class ModelChoice:
    """The model of the real robot."""

    calibration: Annotated[
        Path | None,
        typer.Option(help="Result of a calibration, as 'calib calibrate --json' writes it."),
    ] = None
    corrected: Annotated[
        str | None, typer.Option(help="Corrected URDF, instead of --calibration.")
    ] = None
    geometry: Annotated[
        bool, typer.Option("--geometry", help="Leave out the non-geometric model.")
    ] = False
    payload: Annotated[
        str | None,
        typer.Option(
            metavar='"MASS UNIT"',
            help='Mass that the tip carries, such as "5 kg", if it differs from that of the calibration.',
        ),
    ] = None
    accept: Accept = False

    @property
    def source(self) -> Path | str:
        """The result file, or the URDF or name of the corrected robot, whichever was given.

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
class ChainOptions(CellOptions):
    """Chain of the robot; it is the result's unless the options say otherwise."""

    names: ClassVar[tuple[str, ...]] = ("base", "tip", "hold")
    helps: ClassVar[Mapping[str, str]] = {
        "cell": "Cell file (TOML), for --corrected: its base, tip, held joints and coupled readings.",
        "base": "Link in whose frame the chain starts. Default: that of the result.",
        "tip": "Link that the tool is mounted on; of a result of several chains also the name of the target on it. "
        "Default: that of the result.",
    }


@dataclass(frozen=True, slots=True)
class ProgramColumns(ColumnChoice):
    """Names and units of the program's columns."""

    orientation: Annotated[
        str | None,
        typer.Option(
            metavar="CONVENTION",
            help="Convention of the orientations that are written, and of the program's if it has such columns: "
            "{conventions}. Default: as the program's columns are named; for a program without orientations that of "
            "the brand, else rotation-vector.",
        ),
    ] = None


def parse_tool(text: str) -> Array | str:
    """Parse ``--tool``: ``X Y Z UNIT [RX RY RZ UNIT]``, or ``target[:NAME]``.

    Args:
        text: As typed; the rotation is a rotation vector.

    Returns:
        T_tip_tool, shape (4, 4) [m]; or the name of a target, empty for the only one.

    Raises:
        CalibError: It is neither.
    """
    import numpy as np
    from scipy.spatial.transform import Rotation

    from calib.basics.units import ANGLE, LENGTH, parse_quantities

    word, _, name = text.strip().partition(":")
    if word == "target":
        return name.strip()
    example = "0 0 100 mm 0 0 90 deg"
    if not any(character.isdigit() for character in text):
        raise CalibError(f'--tool "{text}": it must be a pose, "{example}", or target[:NAME].')
    values = parse_quantities(text, "--tool", {LENGTH: 3, ANGLE: 3}, example)
    zero = [0.0, 0.0, 0.0]
    T_tip_tool = np.eye(4)
    T_tip_tool[:3, 3] = values.get(LENGTH, zero)
    T_tip_tool[:3, :3] = Rotation.from_rotvec(values.get(ANGLE, zero)).as_matrix()
    return T_tip_tool


def parse_pair(text: str, option: str, example: str) -> tuple[float | None, float | None]:
    """Parse a length, an angle, or both, such as ``10 mm 2 deg``.

    Args:
        text: As typed.
        option: The option that it was given with, for messages.
        example: A text that would be right, for messages.

    Returns:
        Length [m] and angle [rad]; None for one that is not given.

    Raises:
        CalibError: It is neither, or negative.
    """
    from calib.basics.units import ANGLE, LENGTH, parse_quantities

    values = parse_quantities(text, option, {LENGTH: 1, ANGLE: 1}, example, signed=False)
    length = values.get(LENGTH, [None])[0]
    angle = values.get(ANGLE, [None])[0]
    return length, angle


@verb("""Compute compensated commands so that the real robot reaches the programmed poses.

\b
Examples:
  calib compensate robot.urdf program.csv --calibration result.json -o commands.csv
  calib compensate robot.urdf program.csv --corrected corrected.urdf --base base --tip tool0

ROBOT is the controller's model of the robot. PROGRAM is a table of joint values planned for that robot, or of poses of
its tool, or of both: then the poses are the goal, and the search starts at the joint values. If a row cannot be
reached, nothing is written, unless --skip leaves such rows empty. Nor is anything written if the verdict on the
calibration is 'do not use' (exit status 3), unless --accept is given.
""")
def compensate(
    robot: RobotFile,
    program: Annotated[
        Path,
        typer.Argument(metavar="PROGRAM", help="Table (CSV, .xlsx): joint values, poses, or both."),
    ],
    *,
    model_options: ModelChoice,
    tool: Annotated[
        str | None,
        typer.Option(
            metavar='"X Y Z UNIT [RX RY RZ UNIT]"|target[:NAME]',
            help="Pose of the tool in the tip, such as '0 0 150 mm', or the calibrated target. Default: the tip.",
        ),
    ] = None,
    poses_in: Annotated[
        str,
        typer.Option(
            metavar="base|measured|GROUP",
            help="Frame of the poses: the robot's base, the measurement frame, or the measurement frame of a group.",
        ),
    ] = _BASE,
    match: Annotated[
        Literal["pose", "position", "axis"] | None,
        typer.Option(
            help="What is to be reached: pose (the default), position, or axis, the position and the direction of the "
            "tool's z axis."
        ),
    ] = None,
    start: Annotated[
        list[str] | None,
        typer.Option(
            metavar='"JOINT=VALUE UNIT"',
            help="Joint value near which the search for the first row starts, for poses without "
            "joint values. Can be repeated.",
        ),
    ] = None,
    tolerance: Annotated[
        str,
        typer.Option(metavar='"LENGTH [ANGLE]"', help="Error that is allowed to remain in a row."),
    ] = "1e-8 m 1e-8 rad",
    skip: Annotated[
        bool, typer.Option("--skip", help="Leave rows empty whose pose cannot be reached.")
    ] = False,
    cell_options: ChainOptions,
    column_options: ProgramColumns,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Write the commands as CSV.")
    ] = None,
    send: Annotated[
        Literal["both", "joints", "poses"],
        typer.Option(
            help="What is written: the joint values to command, the poses to send, or both."
        ),
    ] = "both",
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Load both models, compute the commands, and write and print them.

    It raises `VerdictError` for a verdict 'do not use' that was not accepted, and `CalibError` if rows have no command,
    unless they are to be skipped and others have one.
    """
    from calib.basics.tables import Table
    from calib.basics.units import MASS, parse_amount, parse_joint_values
    from calib.data.columns import column_names
    from calib.data.inputs import chain_of
    from calib.result.calibration_file import read_result
    from calib.robot.gravity import Payload
    from calib.show.verdict_text import do_not_use_text, refusal
    from calib.verbs.compensate.compensate import compensate as compute_commands
    from calib.verbs.compensate.nominal_actual import chain_of_hand
    from calib.verbs.compensate.program_table import read_program, write_commands
    from calib.verbs.compensate.text import no_commands, text

    source = model_options.source
    check_outputs([output], [robot, program, source, cell_options.file], force=force)
    cell = cell_options.cell()
    columns = column_options.parsed()

    # The model of the real robot, the nominal one with the same chain, and the verdict on the model if it is negative.
    actual: Calibration | Robot
    calibrated_payload: Payload | None = None
    remedy = ""
    if model_options.calibration is not None:
        actual = result = read_result(model_options.calibration)
        with_chain = _with_chain_of(result, cell, str(source))
        if result.nominal.branches:
            target = tool.partition(":")[2] if tool and tool.startswith("target") else None
            # --tip LINK, or as for the fit, --tip NAME=LINK; the base likewise.
            tip = _only_link(cell.tip, cell.tips)
            hand = chain_of_hand(result, tip, target, _only_link(cell.base, cell.bases))
            nominal = load(robot, with_chain, result=result).rebuilt(None, *hand)
            _check_hand(program, column_names(Table.read(program), columns), nominal, result)
        else:
            nominal = load(robot, with_chain)
        if result.non_geometric:
            calibrated_payload = result.non_geometric.payload
        stated = do_not_use_text(result.verdict_on(non_geometric=not model_options.geometry))
        if stated and not do_not_use_text(result.verdict):
            remedy = " --geometry leaves out the non-geometric model, which this verdict is on."
    else:
        nominal = load(robot, cell, column_names(Table.read(program), columns))
        actual = load(str(model_options.corrected), chain_of(nominal))
        stated = actual.urdf.verdict
    if stated and not model_options.accept:
        raise VerdictError(refusal(f"'{source}'", stated) + remedy)

    rows = read_program(
        program,
        nominal,
        columns=columns,
        match=match,
        start=parse_joint_values(start or [], "--start"),
    )
    length, angle = parse_pair(tolerance, "--tolerance", "0.05 mm 0.01 deg")
    non_geometric: bool | Payload = not model_options.geometry
    if model_options.payload:
        mass = parse_amount(model_options.payload, "--payload", MASS, "5 kg")
        # The centre of mass is that of the calibration, or else the tip.
        non_geometric = replace(calibrated_payload or Payload(mass), mass=mass)
    commands = compute_commands(
        actual,
        rows,
        nominal=nominal,
        tool=parse_tool(tool) if tool else None,
        frame={_BASE: None, _MEASURED: ""}.get(poses_in, poses_in),
        tolerance=(length or _TOLERANCE, angle or _TOLERANCE),
        non_geometric=non_geometric,
        accept=model_options.accept,
    )
    none_reached = not commands.reached.any()
    if not commands.reached.all() and (none_reached or not skip):
        raise CalibError(no_commands(commands))

    if output is not None:
        orientation = column_options.orientation or rows.form or columns.brand
        write_commands(commands, output, send=send, orientation=orientation, overwrite=force)
    if not quiet:
        typer.echo(text(commands, Path(source).name, output))
    say_accepted(f"'{source}'", stated)


def _only_link(link: str | None, by_name: Mapping[str, str]) -> str | None:
    """Return the link that is given, plainly or by a name; None if none or several are."""
    links = [*by_name.values()] if link is None else [link, *by_name.values()]
    return links[0] if len(links) == 1 else None


def _check_hand(
    program: Path, columns: Collection[str] | None, nominal: Robot, result: Calibration
) -> None:
    """Refuse a program with all joints of another hand and not those of the commanded one, by a `MeasurementError`.

    Its columns are by the names that calib uses; None, if these are not known, is not checked.
    """
    if columns is None or set(nominal.joint_names) <= set(columns):
        return
    setup = result.setup
    for name, link in zip(setup.targets, setup.target_links, strict=True):
        for chain in result.nominal.chains:
            own = result.nominal.rebuilt(None, chain.base, chain.tip).joint_names
            if chain.tip == link != nominal.tip and set(own) <= set(columns):
                missing = [joint for joint in nominal.joint_names if joint not in columns]
                raise MeasurementError(
                    f"{program}: the program has all joints of the hand '{name}' ('{link}'), and of the hand that "
                    f"ends at '{nominal.tip}' it lacks {choices(missing, limit=3)}. Did you mean --tip {name}?"
                )


def _with_chain_of(result: Calibration, cell: Cell, path: str) -> Cell:
    """Return a cell with base, tip, held joints and coupled readings of a result, as far as the cell gives none.

    The path of the result's file is for messages.
    """
    from calib.result.chain_of_result import coupling_of_result

    chain = result.nominal
    return replace(
        cell,
        base=cell.base or chain.base,
        tip=cell.tip or chain.tip,
        held={**chain.held, **cell.held},
        coupling=coupling_of_result(cell, result, path),
    )
