"""The ``<origin>`` of each joint of a chain as YAML: all of them for a xacro, or their corrections for PAL's robots.

A xacro takes its numbers from an origins file:

<xacro:property name="origins" value="${xacro.load_yaml('robot_origins.yaml')['origins']}"/>
<joint name="elbow" type="revolute"> <origin xyz="${origins['elbow']['xyz']}" rpy="${origins['elbow']['rpy']}"/>

Robots of PAL Robotics add the corrections in ``master_calibration.yaml`` to the origins of their URDF:

    robot_state_publisher:
      geometric_calibration:
        arm_right_2_dx: 0.0004        # of the joint arm_right_2_joint

Each number is added to the ``<origin>`` as it is written: dx, dy, dz to xyz [m], droll, dpitch, dyaw to rpy [rad]. PAL
publishes no description; this is the form in use on TIAGo Pro, as FIGAROH writes it.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin
import yaml

from calib.basics.arrays import Array
from calib.basics.files import read_bytes, write_atomically
from calib.basics.units import NUMBER
from calib.errors import CalibError, FileError, choices
from calib.robot.robot import Robot
from calib.verbs.convert.format import (
    YAML,
    Format,
    Note,
    Notes,
    Options,
    Source,
    SourceKind,
    parse_yaml,
)
from calib.verbs.convert.urdf_formats import arm_of

#: A number beyond this [m or rad] is a mistake.
_FARTHEST = 1e6

#: Endings of the keys of a joint's corrections in a file for PAL's robots, in the order of xyz and rpy.
_PAL_ENDINGS = ("dx", "dy", "dz", "droll", "dpitch", "dyaw")

#: Ending of the joints' names that the keys leave out.
_PAL_JOINT = "_joint"

#: A change of an origin below this is not written [m or rad].
_PAL_LEAST = 1e-12

#: Origins with their corrections agree with those of the corrected robot to this [m; rotation matrices: 1].
_PAL_TOLERANCE = 1e-9

_WHAT = "origins file"

_EXAMPLE = 'elbow_joint: {xyz: "0.0 0.0 0.15", rpy: "0.0 0.0 1e-05"}'

_HEADER = """\
# Origins of the joints of '{}' between '{}' and '{}', by calib.
# xyz [m]; rpy [rad] about the fixed axes, R = Rz(yaw) Ry(pitch) Rx(roll), as in the <origin> of a URDF.
# In a xacro:
#   <xacro:property name="origins" value="${{xacro.load_yaml('{}')['origins']}}"/>
#   <origin xyz="${{origins['{}']['xyz']}}" rpy="${{origins['{}']['rpy']}}"/>
"""


class JointOrigin(NamedTuple):
    """The ``<origin>`` of a joint, as a URDF states it: R = Rz(yaw) Ry(pitch) Rx(roll)."""

    #: x, y, z of the joint's frame in the parent link [m].
    xyz: tuple[float, ...]
    #: Roll, pitch, yaw [rad].
    rpy: tuple[float, ...]

    @classmethod
    def of(cls, T_parent_joint: Array) -> JointOrigin:
        """Return the origin of a pose, shape (4, 4), [m]."""
        rpy = pin.rpy.matrixToRpy(T_parent_joint[:3, :3])
        return cls(tuple(T_parent_joint[:3, 3].tolist()), tuple(rpy.tolist()))

    @property
    def T_parent_joint(self) -> Array:
        """Pose of the joint's frame in the parent link, shape (4, 4), [m]."""
        T = np.eye(4)
        T[:3, :3] = pin.rpy.rpyToMatrix(*self.rpy)
        T[:3, 3] = self.xyz
        return T


def origins_of(robot: Robot) -> dict[str, JointOrigin]:
    """Return the origins, in their parent links, of the URDF joints that carry the chain's placements.

    Args:
        robot: The robot.

    Returns:
        The origins with the numbers of the URDF, by the joints' names, base to tip.
    """
    result = {}
    for name in robot.origins():
        joint = robot.urdf.joint(name)
        xyz = tuple((joint.xyz + 0.0).tolist())
        rpy = tuple((joint.rpy + 0.0).tolist())
        result[joint.name] = JointOrigin(xyz, rpy)
    return result


def with_origins(robot: Robot, origins: Mapping[str, JointOrigin]) -> Robot:
    """Return a robot with other origins.

    Args:
        robot: The robot; its held joints, and the origins of joints that are not named, are kept.
        origins: The new origins, by the joints' names.

    Raises:
        UrdfError: The URDF has no such joint.
    """
    poses = {name: origin.T_parent_joint for name, origin in origins.items()}
    return robot.rebuilt(robot.urdf.with_origins(poses))


def write_origins(robot: Robot, path: str | os.PathLike[str], *, overwrite: bool = False) -> Path:
    """Write as YAML the origins of the URDF joints that carry the chain's placements, as `origins_of` returns them.

    The file is read back and compared before it appears.

    Args:
        robot: The robot.
        path: The file.
        overwrite: Whether an existing file is replaced.

    Returns:
        The path.

    Raises:
        FileError: The file exists and ``overwrite`` is False, it cannot be written, or YAML cannot hold the names.
    """
    origins = origins_of(robot)
    first_joint = next(iter(origins))
    table = {}
    for name, origin in origins.items():
        xyz = " ".join(map(repr, origin.xyz))
        rpy = " ".join(map(repr, origin.rpy))
        table[name] = {"xyz": xyz, "rpy": rpy}
    text = yaml.safe_dump(
        {"origins": table},
        default_flow_style=None,
        sort_keys=False,
        allow_unicode=True,
        width=math.inf,
    )
    names = (robot.name, robot.base, robot.tip, Path(path).name, first_joint, first_joint)
    data = (_HEADER.format(*names) + text).encode()
    if read_origins(path, data) != origins:
        raise FileError(
            f"{path}: the origins of '{robot.name}' do not read back; rename its joints in the URDF."
        )
    return write_atomically(path, data, overwrite=overwrite)


def read_origins(path: str | os.PathLike[str], data: bytes | None = None) -> dict[str, JointOrigin]:
    """Read an origins file.

    Args:
        path: The file, for messages if ``data`` is given.
        data: The bytes of a file that is not written yet; None: they are read from ``path``.

    Returns:
        The origins by the names of the joints.

    Raises:
        FileError: It cannot be read, or is not an origins file; the text names file, joint and key.
    """
    content = read_bytes(path, _WHAT) if data is None else data
    section = parse_yaml(content, str(path), _WHAT).get("origins")
    if not isinstance(section, dict) or not section:
        raise FileError(
            f"{path}: this is not an origins file: it has no section 'origins:' with a line for each joint, such as "
            f"{_EXAMPLE}"
        )
    origins = {}
    for name, value in section.items():
        entries = value if isinstance(value, dict) else {}
        xyz = _three_numbers(entries.get("xyz"))
        rpy = _three_numbers(entries.get("rpy"))
        if not isinstance(name, str) or xyz is None or rpy is None:
            raise FileError(
                f"{path}, joint '{name}': xyz and rpy are wanted, three numbers [m] and [rad], as in {_EXAMPLE}"
            )
        origins[name] = JointOrigin(xyz, rpy)
    return origins


def _three_numbers(value: object) -> tuple[float, ...] | None:
    """Return three numbers from a text, or from a list, as other programs write them.

    None if it is neither, or a number is larger than any in metres or radians.
    """
    words = value.split() if isinstance(value, str) else value
    if not isinstance(words, list) or len(words) != 3:
        return None
    numbers = []
    for word in map(str, words):
        if not NUMBER.fullmatch(word) or not abs(float(word)) <= _FARTHEST:
            return None
        numbers.append(float(word) + 0.0)
    return tuple(numbers)


# Corrections for PAL's robots


def _write_pal(source: Source, path: Path, options: Options) -> Notes:
    """Write what is to be added to a robot's joint origins as PAL Robotics' robots read it, in m and rad.

    Without a nominal robot it raises `CalibError`; numbers that are rounding are left out.
    """
    if source.nominal is None:
        raise CalibError(
            f"{path}: corrections are added to the URDF that the robot runs; give it as --robot."
        )
    nominal, corrected = origins_of(source.nominal), origins_of(source.robot)
    numbers: dict[str, float] = {}
    for name, origin in nominal.items():
        changes = origin_change(origin, corrected[name].T_parent_joint)
        for ending, change in zip(_PAL_ENDINGS, changes.tolist(), strict=True):
            if abs(change) > _PAL_LEAST:
                numbers[f"{name.removesuffix(_PAL_JOINT)}_{ending}"] = change
    table = {"robot_state_publisher": {"geometric_calibration": numbers}}
    text = yaml.safe_dump(table, sort_keys=False, allow_unicode=True, width=math.inf)
    data = f"# Added to the <origin> of each joint [m, rad], by calib.\n{text}".encode()
    for name, origin in with_pal_corrections(nominal, data, path).items():
        if np.abs(origin.T_parent_joint - corrected[name].T_parent_joint).max() > _PAL_TOLERANCE:
            raise FileError(
                f"{path}: the correction of '{name}' does not read back; rename the joint in the URDF."
            )
    write_atomically(path, data, overwrite=options.overwrite)
    return ()


def origin_change(origin: JointOrigin, T_parent_joint: Array) -> Array:
    """Return the numbers to add to an ``<origin>`` as it is written, so that it becomes a pose.

        Rz(yaw + dyaw) Ry(pitch + dpitch) Rx(roll + droll) = R

    Args:
        origin: The origin.
        T_parent_joint: Shape (4, 4), [m], the pose that it becomes.

    Returns:
        dx, dy, dz [m], droll, dpitch, dyaw [rad], shape (6,), with the nearer of the two triples of angles that give
        the rotation. If pitch is a right angle, roll and yaw may change by much, in opposite directions.
    """
    corrected = JointOrigin.of(T_parent_joint)
    roll, pitch, yaw = corrected.rpy
    triples = np.array([corrected.rpy, (roll + math.pi, math.pi - pitch, yaw + math.pi)])
    turns = triples - origin.rpy
    turns -= 2.0 * math.pi * np.round(turns / (2.0 * math.pi))
    nearer = turns[np.argmin(np.abs(turns).sum(axis=1))]
    return np.concatenate([np.subtract(corrected.xyz, origin.xyz), nearer])


def with_pal_corrections(
    origins: Mapping[str, JointOrigin], data: bytes, path: str | Path
) -> dict[str, JointOrigin]:
    """Return origins with the corrections of a file of PAL Robotics added to their numbers.

    A number that the file does not have is not corrected.

    Args:
        origins: The origins as the URDF has them, by the joints' names.
        data: The file.
        path: Its name, for messages.

    Raises:
        FileError: It has no such corrections.
    """
    section = parse_yaml(data, str(path), "master_calibration.yaml").get("robot_state_publisher")
    numbers = section.get("geometric_calibration") if isinstance(section, dict) else None
    if not isinstance(numbers, dict):
        raise FileError(f"{path}: it has no robot_state_publisher: geometric_calibration.")
    result = {}
    for name, origin in origins.items():
        keys = [f"{name.removesuffix(_PAL_JOINT)}_{ending}" for ending in _PAL_ENDINGS]
        changes = [float(numbers.get(key, 0.0)) for key in keys]
        xyz_rpy = np.add([*origin.xyz, *origin.rpy], changes).tolist()
        result[name] = JointOrigin(tuple(xyz_rpy[:3]), tuple(xyz_rpy[3:]))
    return result


# As formats and a source of a conversion


def _write(source: Source, path: Path, options: Options) -> Notes:
    """Write the origins of the corrected chain's joints as YAML; there are no notes."""
    write_origins(source.robot, path, overwrite=options.overwrite)
    return ()


def _read(source: str, options: Options) -> Source:
    """Read an origins file as a source: the robot that the options name, with these origins; others stay.

    Without a robot in the options it raises `CalibError`.
    """
    origins = read_origins(source)
    if options.robot is None:
        raise CalibError(
            f"{source} has the origins of joints alone; give the URDF that they belong to as "
            "--robot."
        )
    nominal = options.load(options.robot)
    robot = with_origins(nominal, origins)
    missing = [name for name in origins_of(robot) if name not in origins]
    notes: Notes = ()
    if missing:
        sentence = "The file has no origin of {0}: they stay as they are in the URDF."
        notes = (Note("joints without origin", sentence, (choices(missing),)),)
    return Source("origins", robot, nominal, model=arm_of(nominal, options), notes=notes)


FORMATS = {
    "origins": Format("the joints' origins, for a xacro to load", YAML, _write),
    "pal": Format("geometric_calibration of PAL's robots", YAML, _write_pal),
}

KINDS = {"origins": SourceKind(YAML, "origins", _read)}
