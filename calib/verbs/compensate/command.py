"""``calib compensate``: compensated commands, so that the real robot reaches the programmed poses."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
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
    from calib.data.forms.column_options import ColumnOptions
    from calib.result.calibration import Calibration
    from calib.robot.gravity import Payload
    from calib.robot.robot import Robot

#: The words by which `--poses-in` means the robot's base, and the only measurement frame.
_BASE = "base"
_MEASURED = "measured"

#: An example of a pose.
_POSE = "0 0 100 mm 0 0 90 deg"

#: The axes of six, as a Yaskawa controller calls them.
_AXES = ("S", "L", "U", "R", "B", "T")

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
    word, _, name = text.strip().partition(":")
    if word == "target":
        return name.strip()
    if not any(character.isdigit() for character in text):
        raise CalibError(f'--tool "{text}": it must be a pose, "{_POSE}", or target[:NAME].')
    return _pose(text, "--tool")


def _pose(text: str, option: str, orientation: str | None = None) -> Array:
    """Parse a pose, ``X Y Z UNIT [RX RY RZ UNIT]``: a rotation vector, or angles of a convention by its name.

    It is of shape (4, 4), [m]; `CalibError` for anything else.
    """
    import numpy as np

    from calib.basics.units import ANGLE, LENGTH, parse_quantities
    from calib.data.forms.orientations import ROTATION_VECTOR, find_convention

    convention = find_convention(orientation or ROTATION_VECTOR.name)
    if len(convention.columns) != 3:
        raise CalibError(
            f"--orientation {convention.name}: of a program it is that of {option}, which takes three numbers."
        )
    values = parse_quantities(text, option, {LENGTH: 3, ANGLE: 3}, _POSE)
    zero = [0.0, 0.0, 0.0]
    T = np.eye(4)
    T[:3, 3] = values.get(LENGTH, zero)
    T[:3, :3] = convention.matrices(np.array([values.get(ANGLE, zero)]))[0]
    return T


def _named_poses(texts: Sequence[str], option: str, orientation: str | None) -> dict[str, Array]:
    """Parse ``NAME=POSE``, repeated, or a pose alone, whose name is empty; `CalibError` for anything else."""
    poses: dict[str, Array] = {}
    for text in texts:
        name, is_named, pose = text.rpartition("=")
        name = name.strip()
        if name in poses or (is_named and not name) or not pose.strip():
            raise CalibError(
                f"{option} was given '{text}'; for a program it must be \"NAME={_POSE}\", each name once."
            )
        poses[name] = _pose(pose, option, orientation)
    return poses


def parse_pulses(texts: Sequence[str], joint_names: Sequence[str]) -> tuple[float, ...]:
    """Parse ``--pulses``: ``JOINT=NUMBER per UNIT``, one for each joint.

    Args:
        texts: As typed; of six joints also by the letters S, L, U, R, B, T.
        joint_names: The joints, in the order of the controller's axes.

    Returns:
        Pulses in one rad or m of each joint, in their order; none if nothing was typed.

    Raises:
        CalibError: One is not of this form, or a joint is missing.
    """
    from calib.basics.units import parse_pairs, parse_quantity

    if not texts:
        return ()
    letters = _AXES if len(joint_names) == len(_AXES) else joint_names
    wanted = f"'JOINT=NUMBER per UNIT', such as 'S=1485.6 per deg', for each of {choices(letters)}"
    found = {}
    for name, text in parse_pairs(texts, "--pulses", wanted).items():
        number, _, unit = (part.strip() for part in text.partition("per"))
        try:
            in_one, _ = parse_quantity(f"1 {unit}")
            found[name] = float(number) / in_one
        except (CalibError, ValueError, ZeroDivisionError) as error:
            raise CalibError(f"--pulses was given '{name}={text}'; it must be {wanted}.") from error
    by_joint = [found.get(a, found.get(b)) for a, b in zip(letters, joint_names, strict=True)]
    if None in by_joint or len(found) != len(joint_names):
        raise CalibError(f"--pulses names {choices(found)}; it must be {wanted}.")
    return tuple(value for value in by_joint if value is not None)


@dataclass(frozen=True, slots=True)
class ProgramOptions:
    """Options for what a program in a maker's language leaves open."""

    frame: Annotated[
        list[str] | None,
        typer.Option(
            metavar='"[NAME=]X Y Z UNIT RX RY RZ UNIT"',
            help="Frame of a robot program in the base, by its name or number there; without a name, all that it does "
            "not define. Can be repeated.",
        ),
    ] = None
    data: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE",
            help="File that defines tools, frames or targets of a robot program. Can be repeated.",
        ),
    ] = None
    pulses: Annotated[
        list[str] | None,
        typer.Option(
            metavar='"JOINT=NUMBER per UNIT"',
            help="Pulses of each axis, of a Yaskawa program, such as 'S=1485.6 per deg'. Can be repeated.",
        ),
    ] = None


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
  calib compensate robot.urdf prog.src --calibration result.json --data \\$config.dat -o corrected/prog.src

ROBOT is the controller's model of the robot. PROGRAM is a table of joint values planned for that robot, or of poses of
its tool, or of both: then the poses are the goal, and the search starts at the joint values. Or it is a program of KUKA
(.src), ABB (.mod), FANUC (.ls), Yaskawa (.jbi) or Universal Robots (.script), of which -o writes one with the numbers
of the targets corrected. If a row cannot be reached, nothing is written, unless --skip leaves such rows empty. Nor
is anything written if the verdict on the calibration is 'do not use' (exit status 3), unless --accept is given.
""")
def compensate(
    robot: RobotFile,
    program: Annotated[
        Path,
        typer.Argument(
            metavar="PROGRAM",
            help="Table (CSV, .xlsx) of joint values, poses, or both; or a robot program (.src, .mod, .ls, .jbi, "
            ".script).",
        ),
    ],
    *,
    model_options: ModelChoice,
    tool: Annotated[
        list[str] | None,
        typer.Option(
            metavar='"[NAME=]X Y Z UNIT [RX RY RZ UNIT]"|target[:NAME]',
            help="Pose of the tool in the tip, such as '0 0 150 mm', or the calibrated target. Default: the tip. Of a "
            "robot program the tool of this name or number, repeatedly; without a name, all that it does not define.",
        ),
    ] = None,
    program_options: ProgramOptions,
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
        bool,
        typer.Option(
            "--skip",
            help="Leave rows empty whose pose cannot be reached, and targets of a robot program as they are.",
        ),
    ] = False,
    cell_options: ChainOptions,
    column_options: ProgramColumns,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", help="Write the commands as CSV, or the corrected robot program."
        ),
    ] = None,
    send: Annotated[
        Literal["both", "joints", "poses"] | None,
        typer.Option(
            help="What is written of a table: the joint values to command, the poses to send, or both, the default."
        ),
    ] = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Load both models, compute the commands, and write and print them.

    It raises `VerdictError` for a verdict 'do not use' that was not accepted, and `CalibError` if rows have no command,
    unless they are to be skipped and others have one.
    """
    from calib.basics.files import make_folder
    from calib.basics.units import MASS, parse_amount, parse_joint_values
    from calib.robot.gravity import Payload
    from calib.show.verdict_text import refusal
    from calib.verbs.compensate.compensate import compensate as compute_commands
    from calib.verbs.compensate.program_table import read_program, write_commands
    from calib.verbs.compensate.programs.correction import corrected
    from calib.verbs.compensate.programs.dialects import find_dialect, read_program_file
    from calib.verbs.compensate.programs.program_file import Stated
    from calib.verbs.compensate.programs.program_output import output_paths, write_program
    from calib.verbs.compensate.programs.text import not_reached_text, program_text
    from calib.verbs.compensate.text import no_commands, text

    source = model_options.source
    columns = column_options.parsed()
    tools = tool or []
    dialect = find_dialect(program)
    if dialect is not None:
        _refuse(
            f"{program} is a robot program ({dialect.name})",
            {
                "--send": send,
                "--poses-in": poses_in != _BASE,
                "--match": match,
                "--columns": column_options.columns,
                "--joint-unit": column_options.joint_unit,
            },
        )
    else:
        _refuse(
            f"{program} is a table",
            {
                "--frame": program_options.frame,
                "--data": program_options.data,
                "--pulses": program_options.pulses,
                "a second --tool": tools[1:],
            },
        )
        check_outputs([output], [robot, program, source, cell_options.file], force=force)
    target = None
    if tools and tools[0].startswith("target"):
        target = tools[0].partition(":")[2]
    models = _load_models(
        robot, None if dialect else program, model_options, cell_options.cell(), columns, target
    )
    nominal, stated = models.nominal, models.stated
    if stated and not model_options.accept:
        raise VerdictError(refusal(f"'{source}'", stated) + models.remedy)

    starts = parse_joint_values(start or [], "--start")
    length, angle = parse_pair(tolerance, "--tolerance", "0.05 mm 0.01 deg")
    tolerances = (length or _TOLERANCE, angle or _TOLERANCE)
    non_geometric: bool | Payload = not model_options.geometry
    if model_options.payload:
        mass = parse_amount(model_options.payload, "--payload", MASS, "5 kg")
        # The centre of mass is that of the calibration, or else the tip.
        non_geometric = replace(models.payload or Payload(mass), mass=mass)

    if dialect is not None:
        orientation = column_options.orientation
        given = Stated(
            nominal.joint_names,
            tools=_named_poses(tools, "--tool", orientation),
            frames=_named_poses(program_options.frame or [], "--frame", orientation),
            data=tuple(program_options.data or []),
            pulses=parse_pulses(program_options.pulses or [], nominal.joint_names),
            robot=nominal,
        )
        file = read_program_file(program, given)
        if output is not None:
            own = [] if force else [text.path for text in file.texts]
            inputs = [*own, robot, source, cell_options.file]
            # Files that a program shares keep their names: they need a folder of their own.
            make_folder(output.parent)
            check_outputs(output_paths(file, output), inputs, force=force)
        result = corrected(
            file,
            nominal,
            models.actual,
            start=starts,
            tolerance=tolerances,
            non_geometric=non_geometric,
            accept=model_options.accept,
        )
        if any(result.reasons) and not (skip and result.is_corrected.any()):
            raise CalibError(not_reached_text(result))
        written = () if output is None else write_program(result, output, overwrite=force)
        if not quiet:
            typer.echo(program_text(result, Path(source).name, written))
        say_accepted(f"'{source}'", stated)
        return

    rows = read_program(program, nominal, columns=columns, match=match, start=starts)
    commands = compute_commands(
        models.actual,
        rows,
        nominal=nominal,
        tool=parse_tool(tools[0]) if tools else None,
        frame={_BASE: None, _MEASURED: ""}.get(poses_in, poses_in),
        tolerance=tolerances,
        non_geometric=non_geometric,
        accept=model_options.accept,
    )
    none_reached = not commands.reached.any()
    if not commands.reached.all() and (none_reached or not skip):
        raise CalibError(no_commands(commands))

    if output is not None:
        orientation = column_options.orientation or rows.form or columns.brand
        write_commands(
            commands, output, send=send or "both", orientation=orientation, overwrite=force
        )
    if not quiet:
        typer.echo(text(commands, Path(source).name, output))
    say_accepted(f"'{source}'", stated)


def _refuse(what: str, options: Mapping[str, object]) -> None:
    """Refuse, by a `CalibError`, options by their names that were given and do not go with a program."""
    given = [name for name, value in options.items() if value]
    if given:
        raise CalibError(f"{what}, with which {choices(given)} cannot be used; leave it out.")


@dataclass(frozen=True, slots=True)
class _Models:
    """Both robots, and what the verdict says."""

    nominal: Robot
    actual: Calibration | Robot
    #: Payload of the calibration's non-geometric model, if it has one.
    payload: Payload | None
    #: The verdict on the model, if it is negative; else empty.
    stated: str
    #: What can be done about it.
    remedy: str


def _load_models(
    robot: str,
    table: Path | None,
    options: ModelChoice,
    cell: Cell,
    columns: ColumnOptions,
    target: str | None,
) -> _Models:
    """Load the model of the real robot and the nominal one with the same chain.

    The columns of a ``table``, if the program is one, and the ``target`` that is the tool, if it is one, determine the
    chain of a robot of several.
    """
    from calib.basics.tables import Table
    from calib.data.columns import column_names
    from calib.data.inputs import chain_of
    from calib.result.calibration_file import read_result
    from calib.show.verdict_text import do_not_use_text
    from calib.verbs.compensate.nominal_actual import chain_of_hand

    names = None
    if options.calibration is None:
        if table is not None:
            names = column_names(Table.read(table), columns)
        nominal = load(robot, cell, names)
        actual = load(str(options.corrected), chain_of(nominal))
        return _Models(nominal, actual, None, actual.urdf.verdict, "")

    result = read_result(options.calibration)
    with_chain = _with_chain_of(result, cell, str(options.calibration))
    if result.nominal.branches:
        # --tip LINK, or as for the fit, --tip NAME=LINK; the base likewise.
        tip = _only_link(cell.tip, cell.tips)
        hand = chain_of_hand(result, tip, target, _only_link(cell.base, cell.bases))
        nominal = load(robot, with_chain, result=result).rebuilt(None, *hand)
        if table is not None:
            names = column_names(Table.read(table), columns)
            _check_hand(table, names, nominal, result)
    else:
        nominal = load(robot, with_chain)
    payload = result.non_geometric.payload if result.non_geometric else None
    stated = do_not_use_text(result.verdict_on(non_geometric=not options.geometry))
    remedy = ""
    if stated and not do_not_use_text(result.verdict):
        remedy = " --geometry leaves out the non-geometric model, which this verdict is on."
    return _Models(nominal, result, payload, stated, remedy)


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
