"""The row of a format in the registry, and the values that its functions take and return.

A format is written from a `Source` by a function of source, path and `Options`, which returns a list of `Note`. Each
module of a format has its rows in ``FORMATS``, and of files that it reads in ``KINDS``; `calib.verbs.convert.convert`
puts them together.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from calib.basics.values import Value, keep_read_only
from calib.data.cell import Cell
from calib.data.inputs import RobotInput, chain_of, robot_of
from calib.diagnosis.reasons import Verdict
from calib.errors import CalibError, FileError
from calib.result.calibration import Calibration
from calib.robot.arm_models import ArmModel
from calib.robot.robot import Robot
from calib.robot.ur_models import UrModel

#: Endings of YAML files.
YAML = (".yaml", ".yml")


class Note(NamedTuple):
    """A note of a conversion: something that is not as it seems, or that a file has no place for."""

    #: Its subject: ``"nominal hash"``.
    code: str
    #: Its sentence, with ``{0}``, ``{1}``, ... for the values.
    sentence: str
    #: The values that the sentence names: words, and numbers in SI units [m], [rad].
    values: tuple[str | float, ...] = ()

    @property
    def text(self) -> str:
        """The sentence with its values, lengths in mm and angles in mrad."""
        shown = [value if isinstance(value, str) else 1e3 * value + 0.0 for value in self.values]
        return self.sentence.format(*shown)


Notes = tuple[Note, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraOptions:
    """Names that the hand-over of a camera needs; all may be left out."""

    #: Name of the camera, as in the column ``group``; None: the only one.
    camera: str | None = None
    #: The link that is the camera's optical frame: z along the line of sight, x to the right in the image.
    camera_frame: str | None = None
    #: The fixed joint whose origin is changed, so that the optical frame gets its estimated pose; None: the only one
    #: between the link that carries the camera and the optical frame.
    move: str | None = None
    #: Name of a link to add at the optical frame, if the URDF has none.
    new_camera_frame: str | None = None
    #: Name of the board, as in the column ``target``; None: the only one.
    board: str | None = None
    #: Name of a link to add at the board.
    new_board_frame: str | None = None
    #: Station, target, robot or link in which a pose is published.
    parent: str | None = None
    #: Station, target, robot or link on the same body whose pose is published.
    child: str | None = None


@dataclass(frozen=True, slots=True)
class Options:
    """Options of a conversion; all may be left out."""

    #: Name of the format to write; None: by the ending of the file.
    to: str | None = None
    #: The nominal robot, or its URDF, xacro or name; None: that of a result, or a bare ``arm``.
    robot: RobotInput | None = None
    #: Name of an arm of Universal Robots, UFACTORY or Flexiv; None: found from the robot.
    arm: str | None = None
    #: Which of several arms in a file with ``kinematics``: a key on the way to its table; None: there is one.
    section: str | None = None
    #: The arm's file with the nominal rows of a ``calibration.conf``; None: those of the robot or of ``arm``.
    urcontrol: str | Path | None = None
    #: The robot's own ``kinematics.yaml`` or ``calibration.conf``, whose hash a new ``kinematics.yaml`` keeps.
    hash_from: str | Path | None = None
    #: The robot's own file, of which a copy is written: a ``calibration.conf`` or the kinematics of another maker,
    #: whose other lines stay, or a file of offsets, to which zeros are added.
    update: str | Path | None = None
    #: Ticks per turn of a servo's encoder, in which zeros are stored.
    ticks: int = 4096
    #: First link of the chain; None: that of the source.
    base: str | None = None
    #: Last link of the chain; None: that of the source.
    tip: str | None = None
    #: Values of joints that are held, by name [rad or m]; None: those of the source.
    held: Mapping[str, float] | None = None
    #: Factors of other joints' readings by name, for each joint whose readings are coupled; None: those of the source.
    coupling: Mapping[str, Mapping[str, float]] | None = None
    #: Names that the hand-over of a camera needs.
    camera: CameraOptions = CameraOptions()
    #: Whether an existing file is replaced.
    overwrite: bool = False
    #: Whether to write even what should not be given to a robot.
    accept: bool = False

    def __post_init__(self) -> None:
        """Keep read-only copies of the held values and the couplings."""
        keep_read_only(self, "held")
        keep_read_only(self, "coupling")

    def load(self, source: RobotInput) -> Robot:
        """Return a robot, given or by its URDF, xacro or name, with the chain that these options name.

        Of base, tip, held joints and coupling, what the options leave out is that of the given robot, or for a file or
        a name the usual chain.
        """
        if not isinstance(source, Robot):
            held, coupling = self.held or {}, self.coupling or {}
            return robot_of(
                source, Cell(base=self.base, tip=self.tip, held=held, coupling=coupling)
            )
        chain = chain_of(source)
        held = chain.held if self.held is None else self.held
        coupling = chain.coupling if self.coupling is None else self.coupling
        base, tip = self.base or source.base, self.tip or source.tip
        if (base, tip, held, coupling) == (chain.base, chain.tip, chain.held, chain.coupling):
            return source
        return Robot.from_urdf(source.urdf, base, tip, held=held, coupling=coupling)

    def on_chain(self, source: Source) -> Source:
        """Return what was read onto a bare arm, with the base, the tip and the held joints of these options."""
        if not (self.base or self.tip or self.held):
            return source

        def chain(robot: Robot) -> Robot:
            base, tip = self.base or robot.base, self.tip or robot.tip
            return Robot.from_urdf(robot.urdf, base, tip, held=self.held, coupling=self.coupling)

        nominal = chain(source.nominal or source.robot)
        return replace(source, robot=chain(source.robot), nominal=nominal)


@dataclass(frozen=True, slots=True, eq=False)
class Source(Value):
    """A robot that was read, and the same chain with nominal kinematics."""

    #: Kind of source, one of `calib.verbs.convert.convert.KINDS`.
    kind: str
    #: The robot, calibrated if the file is.
    robot: Robot
    #: The nominal robot; None: not known.
    nominal: Robot | None
    #: The arm that it is; None: none that calib knows.
    model: UrModel | ArmModel | None = None
    #: The name that Universal Robots' ROS driver gives a calibration; None: the file has none.
    hash: str | None = None
    #: The file's own content, for the writer of the same format; None: none is kept.
    content: object = None
    #: Notes of the reader.
    notes: Notes = ()
    #: The verdict of a result; None: another file, or a result that was not validated.
    verdict: Verdict | None = None
    #: The result itself; None: another file.
    calibration: Calibration | None = None

    def require_calibration(self) -> Calibration:
        """Return the calibration that was read.

        Raises:
            CalibError: It was not a calibration, but a robot alone.
        """
        if self.calibration is None:
            raise CalibError(
                "This format is made from a calibration and its measurements, which a robot alone lacks. Give the "
                "result of calib calibrate ROBOT DATA --json result.json."
            )
        return self.calibration


class SourceKind(NamedTuple):
    """A kind of source."""

    #: Endings of its files; ``""`` for the name of a robot.
    endings: tuple[str, ...]
    #: The key by which a file is recognised among those of these endings; empty: by its ending alone.
    key: str
    #: Reads a file, or the name of a robot.
    read: Callable[[str, Options], Source]


class Format(NamedTuple):
    """A format that can be written."""

    #: Description of the file, for texts.
    what: str
    #: Endings of its files; none if only its name selects it.
    endings: tuple[str, ...]
    #: Writes a source to a file, after reading it back and comparing it; returns what there is to say.
    write: Callable[[Source, Path, Options], Notes]
    #: Whether ``Options.update`` may name the robot's own file, of which a copy with new numbers is written.
    updates: bool = False
    #: Whether it is about a camera, and takes the names in ``Options.camera``.
    of_camera: bool = False
    #: Whether it has the corrected chain, so that the displacement of the tip is printed.
    has_chain: bool = True
    #: The options with which its source is read, if ``robot``, ``base`` and ``tip`` are those of the file to write.
    options_of_source: Callable[[Options], Options] | None = None
    #: Paragraphs in words about what was written; None: there is nothing to add.
    describe: Callable[[Conversion], list[str]] | None = None
    #: The command that uses the file, printed last; None: there is none.
    command: Callable[[Conversion], str] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Conversion(Value):
    """A finished conversion: the robot that was read, and the file that was written."""

    #: The robot that was read.
    source: Source
    #: Name of the format that was written, one of `calib.verbs.convert.convert.FORMATS`.
    format: str
    #: The file that was written.
    path: Path
    #: Notes of the writer.
    notes: Notes
    #: The verdict ``do not use`` and its reason, if one was accepted.
    against: str = ""
    #: The options that went with it.
    options: Options = field(default_factory=Options)


def parse_yaml(data: bytes, source: str, what: str) -> dict[Any, Any]:
    """Parse a YAML file.

    Args:
        data: The file's bytes.
        source: The file's name, for the message.
        what: Expected kind of file, for the message: ``"origins file"``.

    Returns:
        The outermost table; empty if the file holds none.

    Raises:
        FileError: It is not YAML.
    """
    try:
        table = yaml.safe_load(data)
    except (yaml.YAMLError, ValueError, RecursionError, ArithmeticError) as error:
        reason = " ".join(str(error).split())  # with line and column
        raise FileError(f"{source}: this {what} cannot be read as YAML: {reason}") from error
    return table if isinstance(table, dict) else {}
