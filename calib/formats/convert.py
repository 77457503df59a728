"""Convert a robot into the formats that controllers and ROS take.

A format is one row of `FORMATS`: what it is, its files' endings and the function that writes it;
`calib.formats.sources.KINDS` has what can be read.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from calib.errors import CalibError, ModelError, choices
from calib.formats.dh_files import ENDINGS, DHTables, write_dh
from calib.formats.notes import Note, Source
from calib.formats.origins import write_origins
from calib.formats.sources import YAML, Options, read_source, source_kind
from calib.formats.universal_robots import read_ur, write_ur_conf, write_ur_yaml
from calib.formats.ur_arms import UrModel
from calib.formats.ur_files import Conf
from calib.model.dh_table import HAYATI, MODIFIED, STANDARD
from calib.robot.readback import TOLERANCE, check_written, random_joint_values
from calib.robot.robot import Robot

Notes = tuple[Note, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Conversion:
    """What was read, the format and the file that were written, and what the writer has to say."""

    source: Source
    format: str
    path: Path
    notes: Notes


class Format(NamedTuple):
    """A format that can be written: what it is, its files' endings, and what writes it."""

    what: str
    endings: tuple[str, ...]
    write: Callable[[Source, Path, Options], Notes]


def convert(source: str, path: str | Path, options: Options | None = None) -> Conversion:
    """Read a file or the name of a robot, and write it in the format that the file's ending or ``options.to`` says.

    What is written is read back and compared with the robot before it appears.

    Raises:
        FileError: A file cannot be read or written.
        UrdfError: A URDF cannot be read, or, read back, is not the robot.
        ModelError: The robot has no form in this format, or things do not fit each other.
        CalibError: Something that the format needs was not given, or something given has no use.
    """
    options, path = options or Options(), Path(path)
    kind = source_kind(source)
    name = chosen_format(path, options.to, kind)
    conf = options.hash_from is not None and options.hash_from.suffix.lower() == ".conf"
    for option, used in (
        ("hash_from", name == "ur-yaml"),
        ("update", name == "ur-conf"),
        ("urcontrol", kind == "ur-conf" or conf),
    ):
        if getattr(options, option) is not None and not used:
            raise CalibError(
                f"--{option.replace('_', '-')} has no use in this conversion. Leave it out."
            )
    found = read_source(source, options)
    notes = FORMATS[name].write(found, path, options)
    return Conversion(found, name, path, notes)


def chosen_format(path: Path, asked: str | None, source_kind: str) -> str:
    """The format that a file is written in: the one asked for, or what its ending says; `CalibError` if none."""
    ending = path.suffix.lower()
    fitting = [name for name, one in FORMATS.items() if ending in one.endings]
    if asked is None:
        if source_kind == "ur-conf" and ending in YAML:
            return "ur-yaml"
        if len(fitting) == 1:
            return fitting[0]
        said = ", ".join(f"--to {name} ({FORMATS[name].what})" for name in fitting or FORMATS)
        raise CalibError(
            f"{path}: '{ending}' does not say which format is wanted. Add one of: {said}."
        )
    if asked not in FORMATS:
        raise CalibError(f"There is no format '{asked}'; --to is one of {choices(FORMATS)}.")
    return asked


def _write_urdf(source: Source, path: Path, options: Options) -> Notes:
    """The URDF, read back by Pinocchio and yourdfpy."""
    robot = source.robot
    q = random_joint_values(robot)
    poses = robot.poses(q)
    if source.kind == "robot" and source.nominal is not None:
        robot = source.nominal.with_placements(robot.placements)
        if not np.abs(robot.poses(q) - poses).max() <= TOLERANCE:
            raise ModelError(
                f"{source.robot.urdf.source} and {source.nominal.urdf.source} differ in more than the origins of "
                "their joints, so that one cannot be written on the other. Leave out --robot, or give the URDF that "
                "the other was made from."
            )
    check_written(robot, poses, q)
    robot.urdf.write(path, overwrite=options.overwrite)
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
    nominal, arm = _arm(source, path)
    hash, own = source.hash, options.hash_from
    notes: Notes = ()
    if own is not None:
        read = read_ur(own, urcontrol=options.urcontrol, model=arm)
        hash, notes = read.hash, read.notes
    if hash is None:
        raise CalibError(
            f"{path}: a kinematics.yaml has the hash of the robot's own calibration, which the ROS driver "
            "compares with what the controller reports. Give the robot's own kinematics.yaml (from ros2 launch "
            "ur_calibration calibration_correction.launch.py) or its calibration.conf as --hash-from."
        )
    again = options.overwrite
    written = write_ur_yaml(source.robot, nominal, path, hash=hash, model=arm, overwrite=again)
    return notes + written.notes


def _write_ur_conf(source: Source, path: Path, options: Options) -> Notes:
    """The deltas of a calibration.conf."""
    nominal, arm = _arm(source, path)
    own, update = source.conf, options.update
    written = write_ur_conf(
        source.robot,
        nominal,
        path,
        update=None if update is None else Conf.read(update),
        like=None if own is None else own.deltas,
        model=arm,
        overwrite=options.overwrite,
    )
    if own is None or update is not None or not own.others:
        return written.notes
    return (*written.notes, Note("other lines left out", (choices(own.others),)))


def _arm(source: Source, path: Path) -> tuple[Robot, UrModel]:
    """The nominal robot, which must be an arm of Universal Robots, and which arm it is."""
    if source.nominal is None or source.model is None:
        raise ModelError(
            f"{path}: this format is for arms of Universal Robots, and the nominal robot is none that is known. "
            "Name the arm with --ur-model, or give its nominal URDF as --robot; for other robots write 'urdf', "
            "'origins' or DH rows."
        )
    return source.nominal, source.model


def _dh(what: str, convention: str) -> Format:
    """A row for DH rows in a convention."""
    return Format(f"DH rows{what}", ENDINGS, partial(_write_dh, convention))


FORMATS: Mapping[str, Format] = {
    "urdf": Format("the URDF", (".urdf", ".xml"), _write_urdf),
    "ur-yaml": Format("kinematics.yaml of Universal Robots' ROS driver", YAML, _write_ur_yaml),
    "ur-conf": Format("DH deltas of a Universal Robots controller", (".conf",), _write_ur_conf),
    "origins": Format("the joints' origins, for a xacro to load", YAML, _write_origins),
    "dh": _dh(", standard convention", STANDARD),
    "modified-dh": _dh(", modified (Craig's) convention", MODIFIED),
    "hayati": _dh(" with Hayati's beta", HAYATI),
}
"""The formats by name, as in ``--to``."""
