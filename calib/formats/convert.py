"""Writing a robot in the formats that controllers and ROS take; `calib.formats.sources` reads what comes in.

A format is one row of `FORMATS`: its name, its files' endings, the function that writes it and the options that are for
it alone.
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
from calib.formats.origins import write_origins
from calib.formats.sources import ROBOT, UR_CONF, YAML, Source
from calib.formats.universal_robots import read_ur, write_ur_conf, write_ur_yaml
from calib.formats.ur_arms import UrModel
from calib.formats.ur_files import Conf
from calib.model.dh_table import HAYATI, MODIFIED, STANDARD
from calib.robot.readback import TOLERANCE, check_written, random_joint_values
from calib.robot.robot import Robot


@dataclass(frozen=True, slots=True)
class Wanted:
    """What is to be written, one of `FORMATS`, and where.

    ``hash_from``: a file of the robot's own, whose hash a kinematics.yaml keeps; ``update``: a ``calibration.conf``
    whose other lines are kept; ``urcontrol``: the robot's ``urcontrol.conf``.
    """

    path: Path
    format: str
    hash_from: Path | None = None
    update: Path | None = None
    urcontrol: Path | None = None
    overwrite: bool = False


class Format(NamedTuple):
    """A format that can be written: what it is, its files' endings, and what `write_target` calls.

    ``option``: the field of `Wanted` that is for it alone; ``any_ending``: whether a file of an ending that belongs to
    no format may be one too.
    """

    what: str
    endings: tuple[str, ...]
    write: Callable[[Source, Wanted], tuple[str, ...]]
    option: str = ""
    any_ending: bool = True


def chosen_format(path: Path, asked: str | None, source_kind: str | None = None) -> str:
    """The format that a file is written in.

    Args:
        path: The file.
        asked: What was asked for; None: what the file's ending says.
        source_kind: What is converted: behind a ``calibration.conf`` a YAML file is a ``kinematics.yaml``.

    Raises:
        CalibError: No such format, one that the ending does not go with, or an ending of several or of none.
    """
    ending = path.suffix.lower()
    if ending == ".xacro":
        raise CalibError(
            f"{path}: a xacro is not written: its macros and arguments are not in the robot that was read. Write the "
            "flattened robot (-o robot.urdf), or the origins that your xacro can load (--to origins -o origins.yaml)."
        )
    fitting = [name for name, one in FORMATS.items() if ending in one.endings]
    if asked is None:
        if source_kind == UR_CONF and ending in YAML:
            return "ur-yaml"
        if len(fitting) == 1:
            return fitting[0]
        said = ", ".join(f"--to {name} ({FORMATS[name].what})" for name in fitting or FORMATS)
        raise CalibError(
            f"{path}: '{ending}' does not say which format is wanted. Add one of: {said}."
        )
    if asked not in FORMATS:
        raise CalibError(f"There is no format '{asked}'; --to is one of {choices(FORMATS)}.")
    wanted = FORMATS[asked]
    if asked not in fitting and (fitting or not wanted.any_ending):
        raise CalibError(
            f"{path}: '{asked}' ({wanted.what}) is written into files that end in {choices(wanted.endings)}, not in "
            f"'{ending}'."
        )
    return asked


def check_options(wanted: Wanted, source_kind: str) -> None:
    """Refuse options that would be passed over in silence.

    Raises:
        CalibError: One that this conversion has no use for.
    """
    unused = [one.option for name, one in FORMATS.items() if name != wanted.format and one.option]
    conf = wanted.hash_from is not None and wanted.hash_from.suffix.lower() == ".conf"
    if source_kind != UR_CONF and not conf:
        unused.append("urcontrol")  # for the nominal rows of a calibration.conf
    for option in unused:
        if getattr(wanted, option) is not None:
            raise CalibError(
                f"--{option.replace('_', '-')} {getattr(wanted, option)} has no use in this conversion. Leave it out."
            )


def write_target(source: Source, wanted: Wanted) -> tuple[str, ...]:
    """Write the robot that was read; what the format cannot hold, and what to mind, sentence by sentence.

    Raises:
        FileError: A file cannot be read or written.
        ModelError: The robot has no form in this format.
        UrdfError: The URDF, read back, is not the robot.
        CalibError: Something that the format needs was not given.
    """
    return FORMATS[wanted.format].write(source, wanted)


def _write_urdf(source: Source, wanted: Wanted) -> tuple[str, ...]:
    """The URDF, read back by Pinocchio and yourdfpy."""
    robot = source.robot
    q = random_joint_values(robot)
    poses = robot.poses(q)
    if source.kind == ROBOT and source.nominal is not None:
        robot = source.nominal.with_placements(robot.placements)
        if not np.abs(robot.poses(q) - poses).max() <= TOLERANCE:
            raise ModelError(
                f"{source.robot.urdf.source} and {source.nominal.urdf.source} differ in more than the origins of "
                "their joints, so that one cannot be written on the other. Leave out --robot, or give the URDF that "
                "the other was made from."
            )
    check_written(robot, poses, q)
    robot.urdf.write(wanted.path, overwrite=wanted.overwrite)
    return ()


def _write_origins(source: Source, wanted: Wanted) -> tuple[str, ...]:
    """The origins of the chain's joints."""
    write_origins(source.robot, wanted.path, overwrite=wanted.overwrite)
    return ()


def _write_dh(convention: str, source: Source, wanted: Wanted) -> tuple[str, ...]:
    """DH rows, beside the nominal ones where these are another robot's."""
    nominal = None if source.nominal is source.robot else source.nominal
    tables = DHTables.of(source.robot, nominal, convention)
    write_dh(tables, wanted.path, overwrite=wanted.overwrite)
    return tables.remarks


def _write_ur_yaml(source: Source, wanted: Wanted) -> tuple[str, ...]:
    """A kinematics.yaml with the robot's own hash."""
    nominal, arm = _arm(source, wanted)
    hash = source.hash  # its reader has said what there is to say of it
    remarks: tuple[str, ...] = ()
    if wanted.hash_from is not None:
        own = read_ur(wanted.hash_from, urcontrol=wanted.urcontrol, model=arm)
        hash, remarks = own.hash, own.remarks
    if hash is None:
        raise CalibError(
            f"{wanted.path}: a kinematics.yaml has the hash of the robot's own calibration, which the ROS driver "
            "compares with what the controller reports. Give the robot's own kinematics.yaml (from ros2 launch "
            "ur_calibration calibration_correction.launch.py) or its calibration.conf as --hash-from."
        )
    path, again = wanted.path, wanted.overwrite
    written = write_ur_yaml(source.robot, nominal, path, hash=hash, model=arm, overwrite=again)
    return remarks + written.remarks


def _write_ur_conf(source: Source, wanted: Wanted) -> tuple[str, ...]:
    """The deltas of a calibration.conf."""
    nominal, arm = _arm(source, wanted)
    own = None if source.conf is None else Conf.read(source.conf)
    written = write_ur_conf(
        source.robot,
        nominal,
        wanted.path,
        update=wanted.update,
        like=None if own is None else own.deltas,
        model=arm,
        overwrite=wanted.overwrite,
    )
    if own is None or wanted.update is not None or not own.others:
        return written.remarks
    return (
        *written.remarks,
        f"{wanted.path} has the deltas alone; left out of {source.conf}: {choices(own.others)}. --update {source.conf} "
        "keeps its other lines.",
    )


def _arm(source: Source, wanted: Wanted) -> tuple[Robot, UrModel]:
    """The nominal robot, which must be an arm of Universal Robots, and which arm it is."""
    if source.nominal is None or source.model is None:
        known = (
            "no nominal robot is known"
            if source.nominal is None
            else f"'{source.nominal.name}' has the nominal kinematics of none"
        )
        raise ModelError(
            f"{wanted.path}: '{wanted.format}' is for arms of Universal Robots, and {known}. Name the arm with "
            "--ur-model, or give its nominal URDF as --robot; for other robots write 'urdf', 'origins' or DH rows."
        )
    return source.nominal, source.model


def _dh(what: str, convention: str) -> Format:
    """A row for DH rows in a convention."""
    return Format(f"DH rows{what}", ENDINGS, partial(_write_dh, convention), any_ending=False)


FORMATS: Mapping[str, Format] = {
    "urdf": Format("the URDF", (".urdf", ".xml"), _write_urdf),
    "ur-yaml": Format(
        "kinematics.yaml of Universal Robots' ROS driver", YAML, _write_ur_yaml, "hash_from"
    ),
    "ur-conf": Format(
        "DH deltas of a Universal Robots controller", (".conf",), _write_ur_conf, "update"
    ),
    "origins": Format("the joints' origins, for a xacro to load", YAML, _write_origins),
    "dh": _dh(", standard convention", STANDARD),
    "modified-dh": _dh(", modified (Craig's) convention", MODIFIED),
    "hayati": _dh(" with Hayati's beta", HAYATI),
}
"""The formats by name, as in ``--to``."""
