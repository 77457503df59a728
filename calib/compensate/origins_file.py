"""Origins file: the ``<origin>`` of each joint of a chain as YAML, for a xacro to take its numbers from.

A xacro that keeps its joints' origins in a file of their own needs no other change when the robot is calibrated:

    <xacro:property name="origins" value="${xacro.load_yaml('robot_origins.yaml')['origins']}"/>
    <joint name="elbow" type="revolute"> <origin xyz="${origins['elbow']['xyz']}" rpy="${origins['elbow']['rpy']}"/>
"""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib.errors import FileError, UrdfError, choices, did_you_mean
from calib.model.files import read_bytes, write_atomically
from calib.model.number_text import NUMBER
from calib.model.robot import Robot
from calib.model.urdf import Urdf
from calib.model.urdf_joints import FARTHEST
from calib.model.yaml_file import parse_yaml

__all__ = ["JointOrigin", "Origins", "origins_of", "parse_origins", "read_origins", "write_origins"]

FloatArray = NDArray[np.float64]


_SECTION = "origins"
_EXAMPLE = 'elbow_joint: {xyz: "0.0 0.0 0.15", rpy: "0.0 0.0 1e-05"}'
_KEYS = ("xyz", "rpy")

#: Names that YAML takes as text without quotes: all else is quoted, its yes, no, on, off and null too.
_PLAIN = re.compile(
    r"(?!(?:y|n|yes|no|on|off|true|false|null)$)[A-Za-z][A-Za-z0-9_]*", re.IGNORECASE
)

_HEADER = """\
# Origins of the joints of '{name}' between '{base}' and '{tip}', by calib.
# xyz [m]; rpy [rad] about the fixed axes, R = Rz(yaw) Ry(pitch) Rx(roll), as in the <origin> of a URDF.
# In a xacro:
#   <xacro:property name="origins" value="${{xacro.load_yaml('{file}')['{section}']}}"/>
#   <origin xyz="${{origins['{joint}']['xyz']}}" rpy="${{origins['{joint}']['rpy']}}"/>
"""


@dataclass(frozen=True, slots=True)
class JointOrigin:
    """The ``<origin>`` of a joint, as a URDF states it.

    Attributes:
        xyz: Translation in the parent link [m].
        rpy: Rotation about the parent link's fixed x, y, z axes [rad], R = Rz(yaw) Ry(pitch) Rx(roll).
    """

    xyz: tuple[float, float, float]
    rpy: tuple[float, float, float]

    @property
    def T_parent_joint(self) -> FloatArray:
        """Pose of the joint's frame in the parent link, shape (4, 4), [m]."""
        T = np.eye(4)
        T[:3, :3] = pin.rpy.rpyToMatrix(*self.rpy)
        T[:3, 3] = self.xyz
        T.setflags(write=False)
        return T


@dataclass(frozen=True, slots=True)
class Origins:
    """Origins by the name of their joint, as an origins file holds them.

    Attributes:
        joints: Names and origins in the file's order.
        source: Name of the file or of the URDF, for messages.
    """

    joints: tuple[tuple[str, JointOrigin], ...]
    source: str

    def applied_to(self, robot: Robot) -> Robot:
        """The robot with these origins; those of other joints, and its held joints, stay.

        Raises:
            UrdfError: The robot's URDF has no joint of a name.
        """
        names = {joint.name for joint in robot.urdf.joints}
        for name, _ in self.joints:
            if name not in names:
                message = (
                    f"{self.source}: '{name}' is no joint of {robot.urdf.source}{did_you_mean(name, names)}. Its "
                    f"joints: {choices(joint.name for joint in robot.urdf.joints)}. Give the robot that the file "
                    "was made for."
                )
                raise UrdfError(message)
        return robot.rebuilt(_with(robot.urdf, self.joints))

    def to_yaml(self, header: str = "") -> bytes:
        """The file's bytes: ``header``, then one line for each joint; numbers read back exactly."""
        lines = [f"{_SECTION}:"]
        for name, origin in self.joints:
            key = name if _PLAIN.fullmatch(name) else _quoted(name)
            lines.append(f'  {key}: {{xyz: "{_text(origin.xyz)}", rpy: "{_text(origin.rpy)}"}}')
        return (header + "\n".join(lines) + "\n").encode()


def origins_of(robot: Robot) -> Origins:
    """The origins of the URDF joints that carry the chain's placements, base to tip, with the numbers of the URDF."""
    names = [name for name in robot.carriers if name is not None]
    joints = [robot.urdf.joint(name) for name in names]
    found = tuple((j.name, JointOrigin(_triple(j.xyz), _triple(j.rpy))) for j in joints)
    return Origins(found, robot.urdf.source)


def write_origins(robot: Robot, path: str | os.PathLike[str], *, overwrite: bool = False) -> Path:
    """Write `origins_of` a robot as YAML, whole or not at all; it was read back and compared before.

    Raises:
        FileError: The file exists and ``overwrite`` is False, or it cannot be written; or a joint's name is too long
            for YAML.
    """
    origins = origins_of(robot)
    header = _HEADER.format(
        name=_one_line(robot.name),
        base=_one_line(robot.base),
        tip=_one_line(robot.tip),
        file=_one_line(Path(path).name),
        section=_SECTION,
        joint=_one_line(origins.joints[0][0]),
    )
    data = origins.to_yaml(header)
    try:
        found = parse_origins(data, str(path))
    except FileError as error:
        longest = max((name for name, _ in origins.joints), key=len)
        message = (
            f"{path}: the origins of '{robot.name}' are not written: YAML takes no name of more than 1024 characters, "
            f"and the joint '{longest[:30]}...' has one of {len(longest)}. Give it a shorter name in the URDF."
        )
        raise FileError(message) from error
    assert found.joints == origins.joints, "an origins file reads back as it was written"
    return write_atomically(path, data, overwrite=overwrite)


def read_origins(path: str | os.PathLike[str]) -> Origins:
    """Read an origins file.

    Raises:
        FileError: It cannot be read, or is no origins file; the text names file, joint and key.
    """
    return parse_origins(read_bytes(path, "origins file"), str(path))


def parse_origins(data: bytes, source: str) -> Origins:
    """The origins in a file's bytes.

    Args:
        data: The file.
        source: Its name, for messages.

    Raises:
        FileError: It is no origins file; the text names file, joint and key.
    """
    table = parse_yaml(data, source, "origins file")
    if not isinstance(table, dict) or not isinstance(table.get(_SECTION), dict):
        message = (
            f"{source}: this is no origins file: it has no section '{_SECTION}:' with a line for each joint, such as "
            f"{_EXAMPLE}"
        )
        raise FileError(message)
    joints: list[tuple[str, JointOrigin]] = []
    for name, value in table[_SECTION].items():
        if not isinstance(name, str):
            message = (
                f"{source}: '{name}' under '{_SECTION}' is no joint's name; write it in quotes"
            )
            raise FileError(message)
        joints.append((name, _origin(name, value, source)))
    if not joints:
        message = (
            f"{source}: '{_SECTION}' has no joints; give one line for each, such as {_EXAMPLE}"
        )
        raise FileError(message)
    return Origins(tuple(joints), Path(source).name)


def _origin(name: str, value: object, source: str) -> JointOrigin:
    """The origin of one joint."""
    where = f"{source}, {_SECTION}, joint '{name}'"
    if not isinstance(value, dict):
        message = f"{where}: xyz and rpy are wanted, as in {_EXAMPLE}"
        raise FileError(message)
    for key in value:
        if key not in _KEYS:
            message = f"{where}: '{key}' is not known here; the keys are {choices(_KEYS)}"
            raise FileError(message)
    for key in _KEYS:
        if key not in value:
            message = (
                f"{where}: '{key}' is missing; the keys are {choices(_KEYS)}, as in {_EXAMPLE}"
            )
            raise FileError(message)
    return JointOrigin(*(_numbers(value[key], key, where) for key in _KEYS))


def _numbers(value: Any, key: str, where: str) -> tuple[float, float, float]:  # noqa: ANN401  YAML
    """Three finite numbers of a text, or of a list as other programs write them."""
    words: Iterable[object] = value.split() if isinstance(value, str) else ()
    if isinstance(value, list):
        words = value
    found = [_number(word) for word in words]
    if len(found) != len("xyz") or not all(abs(number) <= FARTHEST for number in found):
        unit = "m" if key == "xyz" else "rad"
        message = (
            f"{where}: {key} is {value!r}; three numbers [{unit}] no larger than {FARTHEST:g} are wanted, "
            f'such as "0.0 0.0 0.15"'
        )
        raise FileError(message)
    return _triple(found)


def _number(word: object) -> float:
    """A number, or text that is one; NaN for anything else."""
    if isinstance(word, str):
        return float(word) if NUMBER.fullmatch(word) else math.nan
    return (
        float(word) if isinstance(word, (int, float)) and not isinstance(word, bool) else math.nan
    )


def _with(urdf: Urdf, joints: Iterable[tuple[str, JointOrigin]]) -> Urdf:
    """The URDF with these origins."""
    origins: Mapping[str, FloatArray] = {name: origin.T_parent_joint for name, origin in joints}
    return urdf.with_origins(origins)


def _triple(values: Iterable[float]) -> tuple[float, float, float]:
    """Three plain floats, without -0."""
    x, y, z = (float(value) + 0.0 for value in values)
    return (x, y, z)


def _text(values: Iterable[float]) -> str:
    """Numbers that read back exactly."""
    return " ".join(map(repr, values))


def _quoted(name: str) -> str:
    """A name in YAML's double quotes; what could end a line, or be no character of YAML, by its number."""
    quoted = json.dumps(name, ensure_ascii=False)
    return "".join(c if c.isprintable() else f"\\U{ord(c):08x}" for c in quoted)


def _one_line(text: str) -> str:
    """A name for a comment: what could end the line, or be no character of YAML, is left out."""
    return "".join(character if character.isprintable() else "?" for character in text)
