"""Writing a robot in the formats that controllers and ROS take; `conversion_source` reads what comes in."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from calib.compensate.conversion_source import ROBOT, UR_CONF, Source
from calib.compensate.dh_files import ENDINGS, write_dh
from calib.compensate.dh_tables import DHTables
from calib.compensate.origins_file import write_origins
from calib.compensate.universal_robots import (
    UrHash,
    UrWritten,
    read_ur_hash,
    write_ur_conf,
    write_ur_yaml,
)
from calib.compensate.ur_conf import other_keys, read_deltas
from calib.compensate.ur_dh import chain_poses
from calib.compensate.ur_models import UrModel
from calib.compensate.ur_mount import the_mount
from calib.compensate.ur_yaml import read_yaml
from calib.errors import CalibError, ModelError, choices
from calib.model.dh_table import HAYATI, MODIFIED, STANDARD
from calib.model.readback import TOLERANCE, check_written, random_joint_values
from calib.model.robot import Robot

Array = NDArray[np.float64]

_YAML = (".yaml", ".yml")


@dataclass(frozen=True, slots=True)
class Format:
    """A format that can be written.

    Attributes:
        name: As in ``--to``.
        what: What it is, in a few words.
        endings: What its files end in.
    """

    name: str
    what: str
    endings: tuple[str, ...]


FORMATS: Mapping[str, Format] = {
    one.name: one
    for one in (
        Format("urdf", "the URDF", (".urdf", ".xml")),
        Format("ur-yaml", "kinematics.yaml of Universal Robots' ROS driver", _YAML),
        Format("ur-conf", "DH deltas of a Universal Robots controller", (".conf",)),
        Format("origins", "the joints' origins, for a xacro to load", _YAML),
        Format("dh", "DH rows, standard convention", ENDINGS),
        Format("modified-dh", "DH rows, modified (Craig's) convention", ENDINGS),
        Format("hayati", "DH rows with Hayati's beta", ENDINGS),
    )
}
"""The formats by name."""

#: What a remark says where DH rows hold a robot less well than usual.
ROWS_HOLD = "The rows hold the robot to"

_CONVENTIONS = {"dh": STANDARD, "modified-dh": MODIFIED, "hayati": HAYATI}


@dataclass(frozen=True, slots=True)
class Wanted:
    """What is to be written, and where.

    Attributes:
        path: The file.
        format: One of `FORMATS`.
        hash_from: A file of the robot's own, whose hash a kinematics.yaml keeps.
        update: A ``calibration.conf`` whose other lines are kept.
        urcontrol: The robot's ``urcontrol.conf``.
        overwrite: Whether a file that exists may be replaced.
    """

    path: Path
    format: str
    hash_from: Path | None = None
    update: Path | None = None
    urcontrol: Path | None = None
    overwrite: bool = False


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
        message = (
            f"{path}: a xacro is not written: its macros and arguments are not in the robot that was read. Write the "
            "flattened robot (-o robot.urdf), or the origins that your xacro can load (--to origins -o origins.yaml)."
        )
        raise CalibError(message)
    fitting = [one.name for one in FORMATS.values() if ending in one.endings]
    if asked is None:
        if source_kind == UR_CONF and ending in _YAML:
            return "ur-yaml"
        if len(fitting) == 1:
            return fitting[0]
        which = fitting or list(FORMATS)
        said = ", ".join(f"--to {name} ({FORMATS[name].what})" for name in which)
        message = f"{path}: '{ending}' does not say which format is wanted. Add one of: {said}."
        raise CalibError(message)
    if asked not in FORMATS:
        message = f"There is no format '{asked}'; --to is one of {choices(FORMATS)}."
        raise CalibError(message)
    if asked not in fitting and (fitting or asked in _CONVENTIONS):
        message = (
            f"{path}: '{asked}' ({FORMATS[asked].what}) is written into files that end in "
            f"{choices(FORMATS[asked].endings)}, not in '{ending}'."
        )
        raise CalibError(message)
    return asked


def write_target(source: Source, wanted: Wanted) -> tuple[str, ...]:
    """Write the robot.

    Args:
        source: What was read.
        wanted: In which format, and where.

    Returns:
        What the format cannot hold, and what to mind, sentence by sentence.

    Raises:
        FileError: A file cannot be read or written.
        ModelError: The robot has no form in this format.
        UrdfError: The URDF, read back, is not the robot.
        CalibError: Something that the format needs was not given.
    """
    return _WRITERS[wanted.format](source, wanted)


def _write_urdf(source: Source, wanted: Wanted) -> tuple[str, ...]:
    """The URDF, read back by Pinocchio and yourdfpy."""
    robot = source.robot
    if source.kind == ROBOT and source.nominal is not None:
        robot = _on(source.nominal, robot)
    q = random_joint_values(robot)
    check_written(robot, source.robot.poses(q), q)
    robot.urdf.write(wanted.path, overwrite=wanted.overwrite)
    return ()


def _on(nominal: Robot, robot: Robot) -> Robot:
    """The URDF of one robot with the placements of another that has the same joints."""
    result = nominal.with_placements(robot.placements)
    q = random_joint_values(robot)
    if not np.abs(result.poses(q) - robot.poses(q)).max() <= TOLERANCE:
        message = (
            f"{robot.urdf.source} and {nominal.urdf.source} differ in more than the origins of their joints, so that "
            "one cannot be written on the other. Leave out --robot, or give the URDF that the other was made from."
        )
        raise ModelError(message)
    return result


def _write_origins(source: Source, wanted: Wanted) -> tuple[str, ...]:
    """The origins of the chain's joints."""
    write_origins(source.robot, wanted.path, overwrite=wanted.overwrite)
    return ()


def _write_dh(source: Source, wanted: Wanted) -> tuple[str, ...]:
    """DH rows, beside the nominal ones where these are another robot's."""
    nominal = None if source.nominal is source.robot else source.nominal
    tables = DHTables.of(source.robot, nominal, _CONVENTIONS[wanted.format])
    write_dh(tables, wanted.path, overwrite=wanted.overwrite)
    return tables.remarks


def _write_ur_yaml(source: Source, wanted: Wanted) -> tuple[str, ...]:
    """A kinematics.yaml with the robot's own hash."""
    nominal, arm = _arm(source, wanted)
    if wanted.hash_from is not None:
        own = read_ur_hash(wanted.hash_from, urcontrol=wanted.urcontrol, model=arm)
    elif source.hash is not None:
        own = UrHash(source.hash)  # its reader has said what there is to say of it
    else:
        message = (
            f"{wanted.path}: a kinematics.yaml has the hash of the robot's own calibration, which the ROS driver "
            "compares with what the controller reports. Give the robot's own kinematics.yaml (from ros2 launch "
            "ur_calibration calibration_correction.launch.py) or its calibration.conf as --hash-from."
        )
        raise CalibError(message)

    def write(path: Path) -> UrWritten:
        return write_ur_yaml(
            source.robot, nominal, path, hash=own.hash, model=arm, overwrite=wanted.overwrite
        )

    def read(path: Path, q: Array) -> Array:
        return chain_poses(read_yaml(path).chain, q)

    return own.remarks + _tried(source, wanted, write, read)


def _write_ur_conf(source: Source, wanted: Wanted) -> tuple[str, ...]:
    """The deltas of a calibration.conf."""
    nominal, arm = _arm(source, wanted)
    like = None if source.conf is None else read_deltas(source.conf)

    def write(path: Path) -> UrWritten:
        return write_ur_conf(
            source.robot,
            nominal,
            path,
            update=wanted.update,
            like=like,
            model=arm,
            overwrite=wanted.overwrite,
        )

    def read(path: Path, q: Array) -> Array:
        return (arm.nominal + read_deltas(path)).poses(q)

    remarks = _tried(source, wanted, write, read)
    left_out = () if source.conf is None or wanted.update is not None else other_keys(source.conf)
    if left_out:
        remarks += (
            f"{wanted.path} has the deltas alone; left out of {source.conf}: {choices(left_out)}. --update "
            f"{source.conf} keeps its other lines.",
        )
    return remarks


def _tried(
    source: Source,
    wanted: Wanted,
    write: Callable[[Path], UrWritten],
    read: Callable[[Path, Array], Array],
) -> tuple[str, ...]:
    """Write a file of Universal Robots after it was written elsewhere, read back and compared."""
    nominal, arm = _arm(source, wanted)
    q = random_joint_values(source.robot)
    with TemporaryDirectory() as folder:
        trial = write(Path(folder) / wanted.path.name)
        check_read_back(read(trial.path, q), q, source.robot, nominal, arm, trial)
    return write(wanted.path).remarks


def check_read_back(
    flange: Array, q: Array, robot: Robot, nominal: Robot, arm: UrModel, written: UrWritten
) -> None:
    """Compare what a file of Universal Robots says, with what it has no place for put back, with the robot.

    Args:
        flange: The controller's flange in its base by the file's own numbers, shape (N, 4, 4), [m].
        q: Joint values there, shape (N, 6), [rad].
        robot: The robot that was written.
        nominal: The nominal robot of both.
        arm: The arm that the source is of, whatever the writer took it for.
        written: What was written.

    Raises:
        ModelError: They differ by more than 1e-9 m and rad, or by more than was said when it was written.
    """
    _, mounted = the_mount(nominal, arm)
    made = mounted.T_base_arm @ written.T_base @ flange @ written.T_tool @ mounted.T_flange_tip
    off = float(np.abs(made - robot.poses(q)).max())
    # Rows between almost parallel axes may hold less; then a remark has said how much.
    allowed = 1e-6 if any(ROWS_HOLD in remark for remark in written.remarks) else TOLERANCE
    if not off <= allowed:
        message = (
            f"{written.path.name}: read back, it puts the tip of '{robot.name}' {off:.1e} m or rad off; "
            f"{allowed:g} is allowed, so it is not written. Please report this with what was converted."
        )
        raise ModelError(message)


def _arm(source: Source, wanted: Wanted) -> tuple[Robot, UrModel]:
    """The nominal robot, which must be an arm of Universal Robots, and which arm it is."""
    if source.nominal is None or source.model is None:
        known = (
            "no nominal robot is known"
            if source.nominal is None
            else f"'{source.nominal.name}' has the nominal kinematics of none"
        )
        message = (
            f"{wanted.path}: '{wanted.format}' is for arms of Universal Robots, and {known}. Name the arm with "
            "--ur-model, or give its nominal URDF as --robot; for other robots write 'urdf', 'origins' or DH rows."
        )
        raise ModelError(message)
    return source.nominal, source.model


_WRITERS: Mapping[str, Callable[[Source, Wanted], tuple[str, ...]]] = {
    "urdf": _write_urdf,
    "ur-yaml": _write_ur_yaml,
    "ur-conf": _write_ur_conf,
    "origins": _write_origins,
    **dict.fromkeys(_CONVENTIONS, _write_dh),
}


def check_options(wanted: Wanted, source_kind: str) -> None:
    """Refuse options that would be passed over in silence.

    Raises:
        CalibError: One that this conversion has no use for.
    """
    if wanted.update is not None and wanted.format != "ur-conf":
        message = (
            f"--update {wanted.update} is the calibration.conf whose other lines the format 'ur-conf' keeps; the "
            f"format here is '{wanted.format}'. Leave it out, or add --to ur-conf."
        )
        raise CalibError(message)
    if wanted.hash_from is not None and wanted.format != "ur-yaml":
        message = (
            f"--hash-from {wanted.hash_from} is the file whose hash the format 'ur-yaml' keeps; the format here is "
            f"'{wanted.format}'. Leave it out, or add --to ur-yaml."
        )
        raise CalibError(message)
    reads_conf = source_kind == UR_CONF or (
        wanted.hash_from is not None and wanted.hash_from.suffix.lower() == ".conf"
    )
    if wanted.urcontrol is not None and not reads_conf:
        message = (
            f"--urcontrol {wanted.urcontrol} has the nominal rows that a calibration.conf counts from; neither SOURCE "
            "nor --hash-from is one. Leave it out."
        )
        raise CalibError(message)
