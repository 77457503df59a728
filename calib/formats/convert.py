"""Convert a robot into the formats that controllers and ROS take.

What can be read is a row of `KINDS`, what can be written a row of `FORMATS`: files' endings and the function.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

from calib.compensation.nominal_actual import check_same_joints, is_corrected
from calib.errors import CalibError, FileError, ModelError, choices
from calib.files import read_bytes
from calib.formats.dh_files import ENDINGS, DHTables, Note, write_dh
from calib.formats.origins import origins_of, parse_yaml, read_origins, with_origins, write_origins
from calib.formats.universal_robots import Source, read_ur, write_ur_conf, write_ur_yaml
from calib.formats.ur_arms import Mount, UrModel, the_mount, ur_model, ur_robot
from calib.model.dh import HAYATI, MODIFIED, STANDARD
from calib.result.calibration_file import read_result
from calib.robot.ranges import random_joint_values
from calib.robot.readback import check_written
from calib.robot.robot import Robot
from calib.robot.xacro_file import is_xacro

Notes = tuple[Note, ...]

_YAML = (".yaml", ".yml")


@dataclass(frozen=True, slots=True)
class Options:
    """What goes with a conversion; all may be left out."""

    to: str | None = None  #: The format, one of `FORMATS`; None: what the file's ending says.
    robot: str | None = None  #: The nominal robot: URDF, xacro or name.
    ur_model: str | None = None  #: The name of an arm of Universal Robots.
    urcontrol: Path | None = None  #: Its file with the nominal rows of a ``calibration.conf``.
    hash_from: Path | None = None  #: The robot's own, whose hash a new ``kinematics.yaml`` keeps.
    update: Path | None = None  #: A ``calibration.conf`` whose other lines a new one keeps.
    base: str | None = None  #: First link of the chain; None: that of the source.
    tip: str | None = None  #: Last link of the chain.
    held: Mapping[str, float] | None = None  #: Joints that stay [rad or m].
    overwrite: bool = False  #: Whether a file that exists is replaced.

    def load(self, source: str) -> Robot:
        """A robot between the links asked for."""
        return Robot.load(source, self.base, self.tip, held=self.held)


@dataclass(frozen=True, slots=True, eq=False)
class Conversion:
    """What was read, the format and the file that were written, and what the writer has to say."""

    source: Source
    format: str
    path: Path
    notes: Notes
    against: str = ""  #: The verdict ``do not use`` and its reason, where one was accepted.


def read_source(source: str, path: Path, options: Options) -> tuple[Source, str]:
    """Read a file or the name of a robot, and choose the format that it is to be written in.

    Args:
        source: A file that `KINDS` has a row for, or the name of a robot.
        path: The file to write.
        options: What goes with the conversion.

    Returns:
        What was read, and one of `FORMATS`.

    Raises:
        FileError: The file cannot be read.
        UrdfError: A URDF cannot be read.
        ModelError: Things do not fit each other.
        CalibError: Something was not given that is needed.
    """
    kind = source_kind(source)
    name = chosen_format(path, options.to, kind)
    return KINDS[kind].read(source, options), name


def source_kind(source: str) -> str:
    """Which of `KINDS` a source is: by its ending, and a YAML file by its first key; `FileError` if none."""
    ending = "" if is_xacro(source) else Path(source).suffix.lower()
    keys: tuple[str, ...] = ()
    if ending in _YAML:
        keys = tuple(map(str, parse_yaml(read_bytes(source, "YAML file"), source, "YAML file")))
    for name, kind in KINDS.items():
        if ending in kind.endings and (not kind.key or kind.key in keys):
            return name
    raise FileError(
        f"{source}: neither its ending nor a key says what it is. Give a calibration.conf or a kinematics.yaml of "
        "Universal Robots, a result (.json), an origins file (.yaml), a URDF, a xacro, or the name of a robot such as "
        "'ur3'."
    )


def chosen_format(path: Path, asked: str | None, source_kind: str) -> str:
    """The format that a file is written in: the one asked for, or what its ending says; `CalibError` if none."""
    ending = path.suffix.lower()
    if asked is None and source_kind == "ur-conf" and ending in _YAML:
        return "ur-yaml"
    fitting = [name for name, one in FORMATS.items() if ending in one.endings]
    if asked is None and len(fitting) == 1:
        return fitting[0]
    if asked is None or asked not in FORMATS:
        said = ", ".join(f"--to {name} ({FORMATS[name].what})" for name in fitting or FORMATS)
        what = f"'{ending}' does not say which format is wanted" if asked is None else ""
        raise CalibError(f"{path}: {what or f'there is no format {asked!r}'}. Give one of: {said}.")
    return asked


# What can be read


def _universal_robots(source: str, options: Options) -> Source:
    """A calibration.conf or a kinematics.yaml, on the robot asked for or on a bare one."""
    given = None if options.robot is None else options.load(options.robot)
    found = read_ur(source, urcontrol=options.urcontrol, model=options.ur_model, robot=given)
    if given is not None or not (options.base or options.tip or options.held):
        return found
    robot, nominal = (
        Robot.from_urdf(
            one.urdf, options.base or one.base, options.tip or one.tip, held=options.held
        )
        for one in (found.robot, found.nominal or found.robot)
    )
    return replace(found, robot=robot, nominal=nominal)


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
        corrected = is_corrected(result, arm)
        nominal = result.uncorrected(arm) if corrected else arm
        robot = arm if corrected else result.corrected(arm)
    notes = (
        ()
        if result.non_geometric is None
        else (Note("geometry alone", (result.non_geometric.name,)),)
    )
    model = _arm(nominal, options)
    return Source("result", robot, nominal, model=model, notes=notes, verdict=result.verdict)


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
    nominal = None
    if options.robot is not None:
        nominal = replace(options, base=robot.base, tip=robot.tip).load(options.robot)
        check_same_joints(robot, nominal)
    elif (mounted := _mount(robot)) is not None and mounted.nominal:
        nominal = robot  # an arm with the kinematics of the data sheet is its own nominal robot
    elif options.ur_model is not None:
        nominal = ur_robot(options.ur_model).rebuilt(base=robot.base, tip=robot.tip)
    model = None if nominal is None else _arm(nominal, options)
    return Source("robot", robot, nominal, model=model)


def _arm(nominal: Robot, options: Options) -> UrModel | None:
    """The arm of Universal Robots that a nominal robot is, if it is one; it must be the one asked for."""
    if options.ur_model is not None:
        return the_mount(nominal, ur_model(options.ur_model)).model
    mounted = _mount(nominal)
    return None if mounted is None else mounted.model


def _mount(robot: Robot) -> Mount | None:
    """How a robot is mounted as an arm of Universal Robots; None of another maker."""
    try:
        return the_mount(robot)
    except ModelError:
        return None


class Kind(NamedTuple):
    """What a source may be: its files' endings, the first key of one in YAML, and the function that reads it."""

    endings: tuple[str, ...]
    key: str
    read: Callable[[str, Options], Source]


KINDS = {
    "ur-conf": Kind((".conf",), "", _universal_robots),
    "ur-yaml": Kind(_YAML, "kinematics", _universal_robots),
    "result": Kind((".json",), "", _result),
    "origins": Kind(_YAML, "origins", _origins),
    "robot": Kind(("", ".urdf", ".xml"), "", _robot),
}
"""What can be read, by name."""


# What can be written


def _write_urdf(source: Source, path: Path, options: Options) -> Notes:
    """The URDF, read back by Pinocchio and yourdfpy."""
    robot = source.robot
    q = random_joint_values(robot)
    written = robot
    if source.kind == "robot" and source.nominal is not None:
        written = source.nominal.with_placements(robot.placements)
    written = replace(written, urdf=written.urdf.with_verdict(robot.urdf.verdict))
    check_written(written, robot.poses(q), q)
    written.urdf.write(path, overwrite=options.overwrite)
    return ()


def _write_origins(source: Source, path: Path, options: Options) -> Notes:
    """The origins of the chain's joints."""
    write_origins(source.robot, path, overwrite=options.overwrite)
    return ()


def _write_dh(convention: str, source: Source, path: Path, options: Options) -> Notes:
    """DH rows, beside the nominal ones where these are another robot's."""
    nominal = None if source.nominal is source.robot else source.nominal
    tables = DHTables.of(source.robot, nominal, convention)
    write_dh(tables, path, overwrite=options.overwrite)
    return tables.notes


def _write_ur_yaml(source: Source, path: Path, options: Options) -> Notes:
    """A kinematics.yaml with the robot's own hash."""
    hash, own = source.hash, options.hash_from
    notes: Notes = ()
    numbers = source.numbers
    if own is not None:
        read = read_ur(own, urcontrol=options.urcontrol, model=source.model)
        hash, notes, numbers = read.hash, read.notes, read.numbers
    if hash is None:
        raise CalibError(
            f"{path}: a kinematics.yaml has the hash of the robot's own calibration, which the ROS driver "
            "compares with what the controller reports. Give the robot's own kinematics.yaml (from ros2 launch "
            "ur_calibration calibration_correction.launch.py) or its calibration.conf as --hash-from."
        )
    written = write_ur_yaml(source, path, hash, like=numbers, overwrite=options.overwrite)
    return notes + written.notes


def _write_ur_conf(source: Source, path: Path, options: Options) -> Notes:
    """The deltas of a calibration.conf."""
    return write_ur_conf(source, path, options.update, overwrite=options.overwrite).notes


class Format(NamedTuple):
    """A format that can be written: what it is, its files' endings, and what writes it."""

    what: str
    endings: tuple[str, ...]
    write: Callable[[Source, Path, Options], Notes]


FORMATS: Mapping[str, Format] = {
    "urdf": Format("the URDF", (".urdf", ".xml"), _write_urdf),
    "ur-yaml": Format("kinematics.yaml of Universal Robots' ROS driver", _YAML, _write_ur_yaml),
    "ur-conf": Format("DH deltas of a Universal Robots controller", (".conf",), _write_ur_conf),
    "origins": Format("the joints' origins, for a xacro to load", _YAML, _write_origins),
    "dh": Format("DH rows, standard convention", ENDINGS, partial(_write_dh, STANDARD)),
    "modified-dh": Format(
        "DH rows, modified (Craig's) convention", ENDINGS, partial(_write_dh, MODIFIED)
    ),
    "hayati": Format("DH rows with Hayati's beta", ENDINGS, partial(_write_dh, HAYATI)),
}
"""The formats by name, as in ``--to``."""
