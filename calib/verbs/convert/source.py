"""What a conversion starts from: a robot that was read, its nominal robot, and the options that go with it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from calib.basics.arrays import Array
from calib.basics.values import Value, keep_read_only
from calib.data.cell import Cell
from calib.data.inputs import RobotInput, chain_of, robot_of
from calib.diagnosis.reasons import Verdict
from calib.result.calibration import Calibration
from calib.robot.generated.universal_robots import UrModel
from calib.robot.robot import Robot
from calib.verbs.convert.camera.options import NOTHING_NAMED, CameraOptions
from calib.verbs.convert.notes import Note
from calib.verbs.convert.ur_conf import Conf


@dataclass(frozen=True, slots=True)
class Options:
    """Options of a conversion; all may be left out."""

    #: Name of the format to write; None: by the ending of the file.
    to: str | None = None
    #: The nominal robot, or its URDF, xacro or name; None: that of a result, or a bare one of ``ur_model``.
    robot: RobotInput | None = None
    #: Name of an arm of Universal Robots; None: found from the robot.
    ur_model: str | None = None
    #: The arm's file with the nominal rows of a ``calibration.conf``; None: those of the robot or of ``ur_model``.
    urcontrol: str | Path | None = None
    #: The robot's own ``kinematics.yaml`` or ``calibration.conf``, whose hash a new ``kinematics.yaml`` keeps.
    hash_from: str | Path | None = None
    #: A ``calibration.conf`` whose other lines a new one keeps; or a file of offsets, to which zeros are added.
    update: str | Path | None = None
    #: Ticks a turn of a servo's encoder, in which zeros are stored.
    ticks: int = 4096
    #: First link of the chain; None: that of the source.
    base: str | None = None
    #: Last link of the chain; None: that of the source.
    tip: str | None = None
    #: Values of joints that stay, by name [rad or m]; None: those of the source.
    held: Mapping[str, float] | None = None
    #: Factors of other joints' readings by name, of each joint whose readings are coupled; None: those of the source.
    coupling: Mapping[str, Mapping[str, float]] | None = None
    #: Names that the hand-over of a camera needs.
    camera: CameraOptions = NOTHING_NAMED
    #: Whether a file that exists is replaced.
    overwrite: bool = False
    #: Whether what should not be given to a robot is written all the same.
    accept: bool = False

    def __post_init__(self) -> None:
        """Keep read-only copies of the held values and the couplings."""
        keep_read_only(self, "held")
        keep_read_only(self, "coupling")

    def load(self, source: RobotInput) -> Robot:
        """Return a robot, given or by its URDF, xacro or name, between the links of these options."""
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


@dataclass(frozen=True, slots=True, eq=False)
class Source(Value):
    """A robot read from a file, and the same chain with nominal kinematics.

    Of Universal Robots' files also the driver's name of the calibration, the arm, and what the file holds.
    """

    #: Kind of source, one of `calib.verbs.convert.convert.KINDS`.
    kind: str
    #: The robot, calibrated if the file is.
    robot: Robot
    #: The nominal robot; None: not known.
    nominal: Robot | None
    #: The driver's name of the calibration; None: of another file.
    hash: str | None = None
    #: The arm of Universal Robots; None: of another maker.
    model: UrModel | None = None
    #: The ``calibration.conf`` that was read; None: another file was.
    conf: Conf | None = None
    #: Numbers of the ``kinematics.yaml`` that was read, shape (6, 6) [m], [rad], see `read_numbers`; None: another file
    #: was.
    numbers: Array | None = None
    #: What the reader has to say.
    notes: tuple[Note, ...] = ()
    #: The verdict of a result; None of any other file, and of a result that was not validated.
    verdict: Verdict | None = None
    #: The result itself; None of any other file.
    calibration: Calibration | None = None
