"""Origins file: the ``<origin>`` of each joint of a chain as YAML, for a xacro to take its numbers from.

<xacro:property name="origins" value="${xacro.load_yaml('robot_origins.yaml')['origins']}"/>
<joint name="elbow" type="revolute"> <origin xyz="${origins['elbow']['xyz']}" rpy="${origins['elbow']['rpy']}"/>
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
import yaml
from numpy.typing import NDArray

from calib.errors import FileError
from calib.files import read_bytes, write_atomically
from calib.robot.robot import Robot
from calib.units import NUMBER

#: A number beyond this [m or rad] is a mistake.
_FARTHEST = 1e6

_EXAMPLE = 'elbow_joint: {xyz: "0.0 0.0 0.15", rpy: "0.0 0.0 1e-05"}'

_HEADER = """\
# Origins of the joints of '{}' between '{}' and '{}', by calib.
# xyz [m]; rpy [rad] about the fixed axes, R = Rz(yaw) Ry(pitch) Rx(roll), as in the <origin> of a URDF.
# In a xacro:
#   <xacro:property name="origins" value="${{xacro.load_yaml('{}')['origins']}}"/>
#   <origin xyz="${{origins['{}']['xyz']}}" rpy="${{origins['{}']['rpy']}}"/>
"""


class JointOrigin(NamedTuple):
    """The ``<origin>`` of a joint, as a URDF states it: xyz [m]; rpy [rad], R = Rz(yaw) Ry(pitch) Rx(roll)."""

    xyz: tuple[float, ...]
    rpy: tuple[float, ...]

    @property
    def T_parent_joint(self) -> NDArray[np.float64]:
        """Pose of the joint's frame in the parent link, shape (4, 4), [m]."""
        T = np.eye(4)
        T[:3, :3] = pin.rpy.rpyToMatrix(*self.rpy)
        T[:3, 3] = self.xyz
        return T


def origins_of(robot: Robot) -> dict[str, JointOrigin]:
    """The origins of the URDF joints that carry the chain's placements, base to tip, with the numbers of the URDF."""
    joints = [robot.urdf.joint(name) for name in robot.carriers if name is not None]
    return {
        joint.name: JointOrigin(*(tuple((one + 0.0).tolist()) for one in (joint.xyz, joint.rpy)))
        for joint in joints
    }


def with_origins(robot: Robot, origins: Mapping[str, JointOrigin]) -> Robot:
    """The robot with these origins, those of other joints and its held joints stay; `UrdfError` for unknown joints."""
    poses = {name: origin.T_parent_joint for name, origin in origins.items()}
    return robot.rebuilt(robot.urdf.with_origins(poses))


def write_origins(robot: Robot, path: str | os.PathLike[str], *, overwrite: bool = False) -> Path:
    """Write `origins_of` a robot as YAML, whole or not at all; it was read back and compared before.

    Raises:
        FileError: The file exists and ``overwrite`` is False, it cannot be written, or YAML cannot hold the names.
    """
    origins = origins_of(robot)
    first = next(iter(origins))
    table = {
        name: {"xyz": " ".join(map(repr, xyz)), "rpy": " ".join(map(repr, rpy))}
        for name, (xyz, rpy) in origins.items()
    }
    text = yaml.safe_dump(
        {"origins": table},
        default_flow_style=None,
        sort_keys=False,
        allow_unicode=True,
        width=math.inf,
    )
    names = (robot.name, robot.base, robot.tip, Path(path).name, first, first)
    data = (_HEADER.format(*names) + text).encode()
    if read_origins(path, data) != origins:
        raise FileError(
            f"{path}: the origins of '{robot.name}' do not read back; rename its joints in the URDF."
        )
    return write_atomically(path, data, overwrite=overwrite)


def read_origins(path: str | os.PathLike[str], data: bytes | None = None) -> dict[str, JointOrigin]:
    """What an origins file says, or will say that is to be written, by the names of the joints.

    Raises:
        FileError: It cannot be read, or is no origins file; the text names file, joint and key.
    """
    what = "origins file"
    table = parse_yaml(read_bytes(path, what) if data is None else data, str(path), what)
    found = table.get("origins")
    if not isinstance(found, dict) or not found:
        raise FileError(
            f"{path}: this is no origins file: it has no section 'origins:' with a line for each joint, such as "
            f"{_EXAMPLE}"
        )
    origins = {}
    for name, value in found.items():
        parts = [value.get(key) for key in ("xyz", "rpy")] if isinstance(value, dict) else []
        # Texts, or lists as other programs write them.
        words = [one.split() if isinstance(one, str) else one for one in parts]
        numbers = [
            tuple(float(word) + 0.0 for word in map(str, one) if NUMBER.fullmatch(word))
            for one in words
            if isinstance(one, list) and len(one) == 3
        ]
        every = [abs(number) <= _FARTHEST for one in numbers for number in one]
        if not isinstance(name, str) or len(every) != 6 or not all(every):
            raise FileError(
                f"{path}, joint '{name}': xyz and rpy are wanted, three numbers [m] and [rad], as in {_EXAMPLE}"
            )
        origins[name] = JointOrigin(*numbers)
    return origins


def parse_yaml(data: bytes, source: str, what: str) -> dict[Any, Any]:
    """The outermost table of a YAML file's bytes, empty where it holds none; `FileError` where it is no YAML."""
    try:
        table = yaml.safe_load(data)
    except (yaml.YAMLError, ValueError, RecursionError, ArithmeticError) as error:
        reason = " ".join(str(error).split())  # with line and column
        raise FileError(f"{source}: this {what} cannot be read as YAML: {reason}") from error
    return table if isinstance(table, dict) else {}
