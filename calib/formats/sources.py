"""Source: what ``calib convert`` reads, whatever its form, as one robot before and after its calibration."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

from calib.compensation.nominal_actual import is_corrected
from calib.errors import CalibError, FileError, ModelError, choices
from calib.files import read_bytes
from calib.formats.notes import Note, Source
from calib.formats.origins import origins_of, parse_yaml, read_origins, with_origins
from calib.formats.universal_robots import read_ur
from calib.formats.ur_arms import UrModel, ur_model, ur_robot
from calib.formats.ur_mount import Mount, the_mount
from calib.result.calibration_file import read_result
from calib.robot.robot import Robot
from calib.robot.xacro_file import is_xacro

YAML = (".yaml", ".yml")


@dataclass(frozen=True, slots=True)
class Options:
    """What goes with a conversion; all may be left out.

    Attributes:
        to: The format, one of `calib.formats.convert.FORMATS`; None: what the file's ending says.
        robot: The nominal robot: URDF, xacro or name.
        ur_model: The name of an arm of Universal Robots.
        urcontrol: Its ``urcontrol.conf``, with the nominal rows of a ``calibration.conf``.
        hash_from: A file of the robot's own, whose hash a new ``kinematics.yaml`` keeps.
        update: A ``calibration.conf`` whose other lines a new one keeps.
        base, tip: Links of the chain; None: those of the source.
        held: Joints that stay [rad or m].
        overwrite: Whether a file that exists is replaced.
    """

    to: str | None = None
    robot: str | None = None
    ur_model: str | None = None
    urcontrol: Path | None = None
    hash_from: Path | None = None
    update: Path | None = None
    base: str | None = None
    tip: str | None = None
    held: Mapping[str, float] | None = None
    overwrite: bool = False

    def load(self, source: str) -> Robot:
        """A robot between the links asked for."""
        return Robot.load(source, self.base, self.tip, held=self.held)


def _universal_robots(source: str, options: Options) -> Source:
    """A calibration.conf or a kinematics.yaml, on the robot asked for or on a bare one."""
    given = None if options.robot is None else options.load(options.robot)
    arm = options.ur_model
    found = read_ur(source, urcontrol=options.urcontrol, model=arm, robot=given)
    if given is None and (options.base or options.tip or options.held):
        bare = found.nominal or found.robot
        links = options.base or bare.base, options.tip or bare.tip
        given = Robot.from_urdf(bare.urdf, *links, held=options.held)
        found = read_ur(source, urcontrol=options.urcontrol, model=arm, robot=given)
    return found


def _result(source: str, options: Options) -> Source:
    """A result, on the robot asked for, nominal or corrected, or on the URDF that it holds."""
    result = read_result(source)
    nominal, robot = result.nominal, result.robot
    links = (options.base or nominal.base, options.tip or nominal.tip)
    if links != (nominal.base, nominal.tip) or (options.held and options.held != nominal.held):
        raise CalibError(
            f"{source} holds base, tip and held joints; leave out --base, --tip and --hold."
        )
    if options.robot is not None:
        arm = Robot.load(options.robot, nominal.base, nominal.tip, held=nominal.held)
        if is_corrected(result, arm):
            nominal, robot = result.uncorrected(arm), arm
        else:
            nominal, robot = arm, result.corrected(arm)
    notes = () if result.larger is None else (Note("geometry alone", (result.larger.name,)),)
    return Source("result", robot, nominal, model=_arm(nominal, options), notes=notes)


def _origins(source: str, options: Options) -> Source:
    """An origins file, on the robot asked for."""
    found = read_origins(source)
    if options.robot is None:
        raise CalibError(
            f"{source} has the origins of joints alone; give the URDF that they belong to as --robot."
        )
    nominal = options.load(options.robot)
    robot = with_origins(nominal, found)
    missing = [name for name in origins_of(robot) if name not in found]
    notes = (Note("joints without origin", (choices(missing),)),) if missing else ()
    return Source("origins", robot, nominal, model=_arm(nominal, options), notes=notes)


def _robot(source: str, options: Options) -> Source:
    """A URDF, a xacro or the name of a robot, beside the nominal one asked for."""
    robot = options.load(source)
    own = [joint.name for joint in robot.joints]
    nominal = None
    if options.robot is not None:
        nominal = replace(options, base=robot.base, tip=robot.tip).load(options.robot)
        others = [joint.name for joint in nominal.joints]
        if others != own:
            raise ModelError(
                f"{source} has the joints {choices(own)} between '{robot.base}' and '{robot.tip}', and "
                f"{nominal.urdf.source} has {choices(others)}. --robot is the same robot with its nominal kinematics."
            )
    elif (mounted := _mount(robot)) is not None and mounted.nominal:
        nominal = robot  # an arm with the kinematics of the data sheet is its own nominal robot
    elif options.ur_model is not None:
        nominal = ur_robot(options.ur_model).rebuilt(base=robot.base, tip=robot.tip)
    model = None if nominal is None else _arm(nominal, options)
    return Source("robot", robot, nominal, model=model)


def _mount(robot: Robot, model: UrModel | None = None) -> Mount | None:
    """How a robot is mounted as an arm of Universal Robots, if it is one."""
    try:
        return the_mount(robot, model)
    except ModelError:  # of another maker
        return None


def _arm(nominal: Robot, options: Options) -> UrModel | None:
    """The arm of Universal Robots that a nominal robot is, if it is one; it must be the one asked for."""
    if options.ur_model is not None:
        return the_mount(nominal, ur_model(options.ur_model)).model
    mounted = _mount(nominal)
    return None if mounted is None else mounted.model


class Kind(NamedTuple):
    """What a source may be: its files' endings, the first key of one in YAML, and the function that reads it."""

    endings: tuple[str, ...]
    key: str
    read: Callable[[str, Options], Source]


KINDS = {
    "ur-conf": Kind((".conf",), "", _universal_robots),
    "ur-yaml": Kind(YAML, "kinematics", _universal_robots),
    "result": Kind((".json",), "", _result),
    "origins": Kind(YAML, "origins", _origins),
    "robot": Kind(("", ".urdf", ".xml"), "", _robot),
}
"""What can be read, by name; `calib.formats.convert.FORMATS` is what can be written."""


def source_kind(source: str) -> str:
    """Which of `KINDS` a source is: by its ending, and a YAML file by its first key; `FileError` if none."""
    ending = "" if is_xacro(source) else Path(source).suffix.lower()
    keys: tuple[str, ...] = ()
    if ending in YAML:
        keys = tuple(map(str, parse_yaml(read_bytes(source, "YAML file"), source, "YAML file")))
    for name, kind in KINDS.items():
        if ending in kind.endings and (not kind.key or kind.key in keys):
            return name
    found = f"neither 'kinematics' nor 'origins' is in it, but {choices(keys) or 'no keys'}"
    raise FileError(
        f"{source}: {found if ending in YAML else f'its ending is {ending!r}'}. Give a calibration.conf or a "
        "kinematics.yaml of Universal Robots, a result (.json), an origins file (.yaml), a URDF, a xacro, or the name "
        "of a robot such as 'ur3'."
    )


def read_source(source: str, options: Options) -> Source:
    """Read what is to be converted: a file, or the name of a robot; `CalibError` where things do not fit each other."""
    return KINDS[source_kind(source)].read(source, options)
