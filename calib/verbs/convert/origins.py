"""Origins file: the ``<origin>`` of each joint of a chain as YAML, for a xacro to take its numbers from.

<xacro:property name="origins" value="${xacro.load_yaml('robot_origins.yaml')['origins']}"/>
<joint name="elbow" type="revolute"> <origin xyz="${origins['elbow']['xyz']}" rpy="${origins['elbow']['rpy']}"/>
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
from numpy.typing import NDArray

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
from calib.verbs.convert.robots import arm_of

#: A number beyond this [m or rad] is a mistake.
_FARTHEST = 1e6

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
    def of(cls, T_parent_joint: NDArray[np.float64]) -> JointOrigin:
        """Return the origin of a pose, shape (4, 4), [m]."""
        rpy = pin.rpy.matrixToRpy(T_parent_joint[:3, :3])
        return cls(tuple(T_parent_joint[:3, 3].tolist()), tuple(rpy.tolist()))

    @property
    def T_parent_joint(self) -> NDArray[np.float64]:
        """Pose of the joint's frame in the parent link, shape (4, 4), [m]."""
        T = np.eye(4)
        T[:3, :3] = pin.rpy.rpyToMatrix(*self.rpy)
        T[:3, 3] = self.xyz
        return T


def origins_of(robot: Robot) -> dict[str, JointOrigin]:
    """Return the origins of the URDF joints that carry the chain's placements.

    Args:
        robot: The robot.

    Returns:
        The origins with the numbers of the URDF, by the joints' names, base to tip.
    """
    result = {}
    for name in robot.carriers:
        if name is None:
            continue
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
    """Write the origins of a robot as YAML.

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
    """Return three numbers from a text, or from a list, as other programs write them; None if it is neither."""
    words = value.split() if isinstance(value, str) else value
    if not isinstance(words, list) or len(words) != 3:
        return None
    numbers = []
    for word in map(str, words):
        if not NUMBER.fullmatch(word) or not abs(float(word)) <= _FARTHEST:
            return None
        numbers.append(float(word) + 0.0)
    return tuple(numbers)


# As a format and a source of a conversion


def _write(source: Source, path: Path, options: Options) -> Notes:
    """Write the origins of the corrected chain's joints."""
    write_origins(source.robot, path, overwrite=options.overwrite)
    return ()


def _read(source: str, options: Options) -> Source:
    """Read an origins file, on the given robot."""
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


FORMATS = {"origins": Format("the joints' origins, for a xacro to load", YAML, _write)}

KINDS = {"origins": SourceKind(YAML, "origins", _read)}
