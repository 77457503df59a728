"""``calib measure``: a session in the terminal, pose by pose, until the aim is reached."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import typer

from calib.cli.loading import load
from calib.cli.options import ColumnChoice, FitOptions, Seed
from calib.cli.terminal import progress_bar, say_lines
from calib.cli.verb import verb
from calib.errors import CalibError, DeviceError, FileError
from calib.verbs.calibrate.command import Outputs, calibrate_files
from calib.verbs.plan.command import PlaceOptions

if TYPE_CHECKING:
    from calib.data.cell import Cell
    from calib.verbs.measure.aim import Aim
    from calib.verbs.measure.session import Session


@dataclass(frozen=True, slots=True)
class SessionCellOptions(FitOptions):
    """Options of the cell, with those of robot, tracker and fit."""

    groups: ClassVar[tuple[str, ...]] = ("model", "fit", "tracker")


@dataclass(frozen=True, slots=True)
class StartOptions:
    """Options that start a session, besides those of its cell."""

    aim: Annotated[
        str | None,
        typer.Option(
            metavar="LENGTH",
            help='The position error, rms over region or joint ranges, that shall hold with 95 %: "0.15 mm".',
        ),
    ] = None
    as_good_as: Annotated[
        int | None,
        typer.Option(
            min=3,
            metavar="N",
            help="In place of --aim: as good as this number of random poses. Default: 40.",
        ),
    ] = None
    region: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Region in which the robot shall be accurate, as 'calib workspace' writes it.",
        ),
    ] = None
    start: Annotated[
        list[str] | None,
        typer.Option(
            metavar='"JOINT=VALUE UNIT"',
            help="Joint value of the pose that the robot starts from; joints that are not named are at 0. Can be "
            "repeated.",
        ),
    ] = None
    collisions: Annotated[
        bool, typer.Option(help="Check poses and the moves to them for collisions.")
    ] = True
    seed: Seed = 0

    @property
    def given(self) -> list[str]:
        """The options that are not as by default, by name."""
        usual = StartOptions()
        names = ("aim", "as_good_as", "region", "start", "seed")
        given = [name for name in names if getattr(self, name) != getattr(usual, name)]
        flags = [f"--{name.replace('_', '-')}" for name in given]
        return flags if self.collisions else [*flags, "--no-collisions"]

    def open(self, folder: Path, robot: str, cell: Cell) -> Session:
        """Start a session in a folder; raises `CalibError`."""
        from calib.basics.units import parse_joint_values
        from calib.data.cell_chains import check_arm_is_named
        from calib.verbs.compensate.inverse import start_values
        from calib.verbs.measure.session import Session

        arm = load(robot, cell)
        check_arm_is_named(arm, cell)
        start: tuple[float, ...] = ()
        if self.start:
            typed = parse_joint_values(self.start, "--start")
            start = tuple(start_values(arm, typed, 0.0).tolist())
        aim = self._aim(robot, cell)
        with progress_bar("looking for poses", quiet=False) as progress:
            return Session.start(
                folder,
                robot,
                cell,
                aim,
                collisions=self.collisions,
                start=start,
                seed=self.seed,
                progress=progress,
            )

    def _aim(self, robot: str, cell: Cell) -> Aim:
        """Return the aim; raises `CalibError` for another text, or a region of another robot."""
        from calib.basics.units import LENGTH, parse_amount
        from calib.verbs.measure.aim import Aim
        from calib.verbs.workspace.region_file import read_region

        if self.aim is not None and self.as_good_as is not None:
            raise CalibError("--aim and --as-good-as both say what is aimed at; give one of them.")
        region = None
        if self.region is not None:
            target = next(iter(cell.targets.values()), cell.target)
            region = read_region(self.region, load(robot, cell), target)
        if self.aim is None:
            return Aim(poses=self.as_good_as or Aim().poses, region=region)
        return Aim(parse_amount(self.aim, "--aim", LENGTH, "0.15 mm"), region=region)


@dataclass(frozen=True, slots=True)
class DeviceOptions(ColumnChoice):
    """Instrument, robot, and how rows are read."""

    reader: Annotated[
        str,
        typer.Option(
            metavar="NAME[:WHAT]",
            help="The instrument: {readers}. Default: stdin, rows are typed.",
        ),
    ] = "stdin"
    controller: Annotated[
        str | None,
        typer.Option(
            metavar="NAME[:WHERE]",
            help="The robot that is asked where it stands: {controllers}. Default: it stands where it is proposed, "
            "unless the rows say otherwise.",
        ),
    ] = None
    unit: Annotated[
        str, typer.Option(metavar="UNIT", help="Unit of lengths in rows without a header.")
    ] = "mm"

    @property
    def words(self) -> list[str]:
        """The options as they are typed, those that are not as by default."""
        words = []
        usual = DeviceOptions()
        for name in ("reader", "controller", "unit", "orientation", "joint_unit"):
            if getattr(self, name) != getattr(usual, name):
                words += [f"--{name.replace('_', '-')}", getattr(self, name)]
        for word in self.columns or ():
            words += ["--columns", word]
        return words


def _reader_names() -> tuple[str, ...]:
    """Return what there is to read, in words."""
    from calib.verbs.measure.devices.readers import READERS

    return tuple(f"{name} ({reader.words})" for name, reader in READERS.items())


def _controller_names() -> tuple[str, ...]:
    """Return the robots that can be asked, in words."""
    from calib.verbs.measure.devices.controllers import CONTROLLERS

    return tuple(f"{name} ({robot.words})" for name, robot in CONTROLLERS.items())


@verb(
    """Measure a robot pose by pose: the next pose, an answer to each stop, and when it is enough.

\b
Examples:
  calib measure session ur3 --base base --tip tool0 --frame estimate --reader virtual
  calib measure session robot.urdf --cell cell.toml --aim "0.15 mm" --reader file:points.txt
  calib measure session robot.urdf --frame estimate --reader tcp:192.168.0.20:5000 --controller rtde:192.168.0.5
  calib measure session --reader file:points.txt -o corrected.urdf --report report.html

FOLDER keeps all of it; without ROBOT its session goes on, after a crash too. Each pose is the one that lowers the
expected error most. Drive there, measure, and the answer says whether the reading is good, and how accurate the robot
would be by now. Without --reader you type what the instrument shows. Between readings type undo, again, skip, note
TEXT, state, done, or help. The table and the cell file in FOLDER are those of calib calibrate; with -o, --json or
--report it runs at the end.
""",
    {"{readers}": _reader_names, "{controllers}": _controller_names},
)
def measure(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="FOLDER", help="Folder of the session: a new one, or one that goes on."
        ),
    ],
    robot: Annotated[
        str | None,
        typer.Argument(
            metavar="ROBOT",
            help="Starts a session: URDF or xacro file, MuJoCo model, DH rows, or the name of a robot such as 'ur3'.",
        ),
    ] = None,
    *,
    cell_options: SessionCellOptions,
    places: PlaceOptions,
    starting: StartOptions,
    devices: DeviceOptions,
    stop_at_aim: Annotated[
        bool, typer.Option("--stop-at-aim", help="End by itself when the aim is reached.")
    ] = False,
    outputs: Outputs,
) -> None:
    """Start a session or go on with it, measure, and calibrate if outputs are named."""
    from calib.verbs.measure.dialogue import Dialogue
    from calib.verbs.measure.session import Session
    from calib.verbs.measure.settings import CELL, SETTINGS, TABLE
    from calib.verbs.measure.station import Station, check_devices
    from calib.verbs.measure.text import (
        calibrate_command,
        count_text,
        kept_text,
        opening_lines,
    )

    outputs.check([robot, cell_options.file, starting.region])
    columns = devices.parsed()
    check_devices(devices.reader, devices.controller or "", devices.unit)
    is_begun = (folder / SETTINGS).exists()
    given = [*_cell_words(cell_options, places), *starting.given]
    if robot is None:
        _check_begun(folder, is_begun=is_begun, given=given)
        with progress_bar("looking for poses", quiet=False) as progress:
            session = Session.open(folder, progress=progress)
    elif is_begun:
        raise CalibError(
            f"'{folder}' has a session already. Go on with it: {shlex.join(_again(folder, devices))}; or name another "
            "folder for a new one."
        )
    else:
        session = starting.open(folder, robot, places.in_cell(cell_options.cell()))
    again = shlex.join(_again(folder, devices))
    is_open = False
    try:
        with (
            session,
            Station(
                session,
                devices.reader,
                devices.controller or "",
                columns=columns,
                unit=devices.unit,
            ) as station,
        ):
            is_open = True
            say_lines(opening_lines(session, goes_on=robot is None))
            dialogue = Dialogue(station, devices.reader, stops_at_aim=stop_at_aim)
            is_done = dialogue.run()
    except KeyboardInterrupt as error:
        raise KeyboardInterrupt(kept_text(str(folder), len(session.stops), again)) from error
    except DeviceError as error:
        if is_open or robot is None:
            raise
        raise DeviceError(f"{error} The session has begun; go on with: {again}") from error
    counted = sum(stop.counts for stop in session.stops)
    if not is_done or not counted:
        typer.echo(f"\n{kept_text(str(folder), len(session.stops), again)}")
        return
    table, cell_file, named = folder / TABLE, folder / CELL, session.robot_file
    if any((outputs.output, outputs.json, outputs.view, outputs.report, outputs.figures)):
        typer.echo("")
        calibrate_files(named, table, FitOptions(cell_file), outputs)
        return
    counts = count_text(counted, len(session.stops))
    typer.echo(f"\n{counts} They are in {table}, their cell in {cell_file}. Calibrate the robot:")
    typer.echo(f"  {calibrate_command(named, str(table), str(cell_file))}")


def _again(folder: Path, devices: DeviceOptions) -> list[str]:
    """Return the words of the command that goes on with a session."""
    return ["calib", "measure", str(folder), *devices.words]


def _output_words(outputs: Outputs) -> list[str]:
    """Return the outputs as they are typed."""
    words = []
    for flag, path in {
        "-o": outputs.output,
        "--json": outputs.json,
        "--view": outputs.view,
        "--report": outputs.report,
        "--figures": outputs.figures,
    }.items():
        words += [] if path is None else [flag, str(path)]
    return words


def _cell_words(cell_options: SessionCellOptions, places: PlaceOptions) -> list[str]:
    """Return the options of the cell that were given."""
    words = ["--cell"] if cell_options.file is not None else []
    words += [f"--{name.replace('_', '-')}" for name in cell_options.given]
    for name in ("camera_at", "board_at"):
        if getattr(places, name) is not None:
            words.append(f"--{name.replace('_', '-')}")
    return words


def _check_begun(folder: Path, *, is_begun: bool, given: list[str]) -> None:
    """Refuse to go on where there is no session, or with options that belong to its start; raises `CalibError`."""
    if not is_begun:
        raise FileError(
            f"There is no session in '{folder}'. Name the robot to start one: calib measure {folder} robot.urdf"
        )
    if given:
        raise CalibError(
            f"{', '.join(given)} belongs to the start of a session, and that in '{folder}' was started before. Leave "
            "it out, or start another session in another folder."
        )
