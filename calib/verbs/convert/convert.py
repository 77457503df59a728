"""Convert a robot into the formats that controllers and ROS take.

What can be read is a row of `KINDS`, what can be written a row of `FORMATS`: files' endings and the function.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import calib.basics.plugins as plugins
from calib.basics.values import Value
from calib.data.inputs import RobotInput
from calib.errors import CalibError, choices, did_you_mean
from calib.result.calibration import Calibration
from calib.robot.coupled_readings import coupling_lines
from calib.robot.dh.rows import EQUATIONS, HAYATI, MODIFIED, STANDARD
from calib.robot.ranges import random_joint_values
from calib.robot.readback import check_written
from calib.robot.robot import Robot
from calib.verbs.convert.camera.intrinsics import write_intrinsics
from calib.verbs.convert.camera.static_transform import LAUNCH
from calib.verbs.convert.camera.write import mounted, write_static_transform
from calib.verbs.convert.dh_files import ENDINGS, DHTables, write_dh
from calib.verbs.convert.notes import Note
from calib.verbs.convert.origins import write_origins
from calib.verbs.convert.pal import write_pal
from calib.verbs.convert.source import Options as Options, Source as Source
from calib.verbs.convert.source_kinds import KINDS, YAML, result_source, robot_source, source_kind
from calib.verbs.convert.universal_robots import read_ur, write_ur_conf, write_ur_yaml
from calib.verbs.convert.zeros.table import TABLE_ENDINGS
from calib.verbs.convert.zeros.write import write_zeros

__all__ = [
    "FORMATS",
    "KINDS",
    "Conversion",
    "Format",
    "Options",
    "Source",
    "chosen_format",
    "read_source",
    "register",
]

Notes = tuple[Note, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Conversion(Value):
    """A conversion that was done: what was read, and what was written."""

    #: What was read.
    source: Source
    #: Name of the format that was written, one of `FORMATS`.
    format: str
    #: The file that was written.
    path: Path
    #: What the writer has to say.
    notes: Notes
    #: The verdict ``do not use`` and its reason, where one was accepted.
    against: str = ""
    #: What went with it.
    options: Options = field(default_factory=Options)


def read_source(
    source: Calibration | RobotInput, path: Path, options: Options
) -> tuple[Source, str]:
    """Read what is to be converted, unless it is there already, and choose the format that it is written in.

    Args:
        source: A result; a robot; a file that `KINDS` has a row for; or the name of a robot.
        path: The file to write.
        options: What goes with the conversion.

    Returns:
        What was read, and the name of the format, one of `FORMATS`.

    Raises:
        FileError: The file cannot be read.
        UrdfError: A URDF cannot be read.
        ModelError: Things do not fit each other.
        CalibError: Something was not given that is needed.
    """
    if isinstance(source, Calibration):
        name = chosen_format(path, options.to, "result")
        return result_source(source, options, "The calibration"), name
    if isinstance(source, Robot):
        name = chosen_format(path, options.to, "robot")
        return robot_source(source, options), name
    kind = source_kind(str(source))
    name = chosen_format(path, options.to, kind)
    return KINDS[kind].read(str(source), options), name


def chosen_format(path: Path, given: str | None, kind: str) -> str:
    """Choose the format that a file is written in.

    Args:
        path: The file to write.
        given: Name of the format; None: by the ending of the file.
        kind: Kind of the source, one of `KINDS`: a ``ur-conf`` becomes a ``ur-yaml``.

    Returns:
        The name of the format, one of `FORMATS`.

    Raises:
        CalibError: There is no such format, or several have this ending.
    """
    if given is not None and given in FORMATS:
        return given
    ending = path.suffix.lower()
    fitting = [name for name, row in FORMATS.items() if ending in row.endings]
    if given is None:
        if kind == "ur-conf" and ending in YAML:
            return "ur-yaml"
        if len(fitting) == 1:
            return fitting[0]
    options = ", ".join(f"--to {name} ({FORMATS[name].what})" for name in fitting or FORMATS)
    fault = f"there is no format '{given}'{did_you_mean(given or '', FORMATS)}"
    if given is None:
        fault = f"'{ending}' does not say which format is wanted"
    raise CalibError(f"{path}: {fault}. Give one of: {options}. {plugins.HINT}")


# What can be written


def _write_urdf(source: Source, path: Path, options: Options) -> Notes:
    """Write the URDF, read back by Pinocchio and yourdfpy."""
    robot = source.robot
    q = random_joint_values(robot)
    written = robot
    if source.kind == "robot" and source.nominal is not None:
        written = source.nominal.with_placements(robot.placements)
    written = replace(written, urdf=written.urdf.with_verdict(robot.urdf.verdict))
    check_written(written, robot.poses(q), q)
    written.urdf.write(path, overwrite=options.overwrite)
    coupled = robot.reading_coupling
    if not coupled:
        return ()
    known = "" if written.urdf.dh is None else ", or the rows in a comment of the URDF do"
    return (Note("coupled readings", (coupling_lines(coupled), known)),)


def _write_origins(source: Source, path: Path, options: Options) -> Notes:
    """Write the origins of the chain's joints."""
    write_origins(source.robot, path, overwrite=options.overwrite)
    return ()


def _write_pal(source: Source, path: Path, options: Options) -> Notes:
    """Write the corrections of the joints' origins for PAL's robots."""
    write_pal(source, path, overwrite=options.overwrite)
    return ()


def _write_dh(convention: str | None, source: Source, path: Path, options: Options) -> Notes:
    """Write DH rows, beside the nominal ones where these are another robot's.

    Without a convention it is that of the rows that the robot was made from, else the standard one.
    """
    nominal = None if source.nominal is source.robot else source.nominal
    notes: Notes = ()
    if convention is None:
        made_from = source.robot.urdf.dh
        convention = STANDARD if made_from is None else made_from.table.convention
        notes = (Note("rows written", (convention, EQUATIONS[convention])),)
    tables = DHTables.of(source.robot, nominal, convention)
    write_dh(tables, path, overwrite=options.overwrite)
    return notes + tables.notes


def _write_ur_yaml(source: Source, path: Path, options: Options) -> Notes:
    """Write a kinematics.yaml with the robot's own hash."""
    hash = source.hash
    numbers = source.numbers
    notes: Notes = ()
    if options.hash_from is not None:
        own_file = read_ur(options.hash_from, urcontrol=options.urcontrol, model=source.model)
        hash = own_file.hash
        numbers = own_file.numbers
        notes = own_file.notes
    if hash is None:
        raise CalibError(
            f"{path}: a kinematics.yaml has the hash of the robot's own calibration, which the ROS "
            "driver compares with what the controller reports. Give the robot's own "
            "kinematics.yaml (from ros2 launch ur_calibration calibration_correction.launch.py) or "
            "its calibration.conf as --hash-from."
        )
    written = write_ur_yaml(source, path, hash, like=numbers, overwrite=options.overwrite)
    return notes + written.notes


def _write_camera_mount(source: Source, path: Path, options: Options) -> Notes:
    """Write the URDF with the camera and the board at their estimated poses."""
    return _write_urdf(mounted(source, options), path, options)


def _write_static_transform(source: Source, path: Path, options: Options) -> Notes:
    """Write the pose of the camera for ROS 2."""
    write_static_transform(source, path, options)
    return ()


def _write_intrinsics(name: str, source: Source, path: Path, options: Options) -> Notes:
    """Write the intrinsics of the camera for ROS or OpenCV."""
    write_intrinsics(name, source, path, options)
    return ()


def _write_ur_conf(source: Source, path: Path, options: Options) -> Notes:
    """Write the deltas of a calibration.conf."""
    return write_ur_conf(source, path, options.update, overwrite=options.overwrite).notes


class Format(NamedTuple):
    """A format that can be written."""

    #: What it is, for texts.
    what: str
    #: Endings of its files; none where the name alone chooses it.
    endings: tuple[str, ...]
    #: Writes a source to a file that is read back and compared; returns what it has to say.
    write: Callable[[Source, Path, Options], Notes]
    #: Whether it may be a copy of a robot's own file, `Options.update`, with new numbers.
    updates: bool = False
    #: Whether it is of a camera, and takes the names of `Options.camera`.
    of_camera: bool = False


FORMATS: dict[str, Format] = {
    "urdf": Format("the URDF", (".urdf", ".xml"), _write_urdf),
    "ur-yaml": Format("kinematics.yaml of Universal Robots' ROS driver", YAML, _write_ur_yaml),
    "ur-conf": Format(
        "DH deltas of a Universal Robots controller", (".conf",), _write_ur_conf, updates=True
    ),
    "origins": Format("the joints' origins, for a xacro to load", YAML, _write_origins),
    "pal": Format("geometric_calibration of PAL's robots", YAML, _write_pal),
    "dh": Format(
        "DH rows in the convention that they came in, else standard",
        ENDINGS,
        partial(_write_dh, None),
    ),
    "modified-dh": Format(
        "DH rows, modified (Craig's) convention", ENDINGS, partial(_write_dh, MODIFIED)
    ),
    "hayati": Format("DH rows with Hayati's beta", ENDINGS, partial(_write_dh, HAYATI)),
    "zeros": Format("joint zeros to type in", TABLE_ENDINGS, partial(write_zeros, "zeros")),
    "dynamixel-hardware": Format(
        "joint zeros as offsets of ROS' dynamixel_hardware",
        YAML,
        partial(write_zeros, "dynamixel-hardware"),
        updates=True,
    ),
    "ros2-transmission": Format(
        "joint zeros as offsets of ros2_control's transmissions",
        YAML,
        partial(write_zeros, "ros2-transmission"),
        updates=True,
    ),
    "lerobot": Format(
        "joint zeros as homing_offset of LeRobot's Feetech servos (SO-100, SO-101)",
        (".json",),
        partial(write_zeros, "lerobot"),
        updates=True,
    ),
    "lerobot-dynamixel": Format(
        "joint zeros as homing_offset of LeRobot's Dynamixel servos",
        (".json",),
        partial(write_zeros, "lerobot-dynamixel"),
        updates=True,
    ),
    "camera-mount": Format(
        "the URDF with the calibrated mount of the camera", (), _write_camera_mount, of_camera=True
    ),
    "static-transform": Format(
        "the camera's pose for ROS 2's static_transform_publisher",
        (".sh", LAUNCH),
        _write_static_transform,
        of_camera=True,
    ),
    "camera-info": Format(
        "the camera's intrinsics for ROS (camera_info)",
        YAML,
        partial(_write_intrinsics, "camera-info"),
        of_camera=True,
    ),
    "opencv": Format(
        "the camera's intrinsics for OpenCV (FileStorage)",
        YAML,
        partial(_write_intrinsics, "opencv"),
        of_camera=True,
    ),
}
"""The formats by name, as in ``--to``."""

plugins.watch("formats", FORMATS)


def register(name: str, row: Format) -> None:
    """Add a format that robots can be written in.

    Args:
        name: Its name, as in ``--to``, which no other format has.
        row: What it is, the endings of its files, and the function that writes it.

    Raises:
        CalibError: The name is taken.
    """
    if name in FORMATS:
        raise CalibError(f"The format '{name}' needs a name other than {choices(FORMATS, 60)}.")
    FORMATS[name] = row
