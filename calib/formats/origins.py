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
from collections.abc import Hashable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
import yaml
from numpy.typing import NDArray

from calib.errors import FileError, UrdfError, choices, did_you_mean
from calib.files import read_bytes, write_atomically
from calib.robot.robot import Robot
from calib.units import NUMBER

FloatArray = NDArray[np.float64]
Triple = tuple[float, float, float]

#: A number beyond this [m or rad] is a mistake.
_FARTHEST = 1e6

_SECTION, _KEYS = "origins", ("xyz", "rpy")
_EXAMPLE = 'elbow_joint: {xyz: "0.0 0.0 0.15", rpy: "0.0 0.0 1e-05"}'

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


class JointOrigin(NamedTuple):
    """The ``<origin>`` of a joint, as a URDF states it: xyz [m]; rpy [rad], R = Rz(yaw) Ry(pitch) Rx(roll)."""

    xyz: Triple
    rpy: Triple

    @property
    def T_parent_joint(self) -> FloatArray:
        """Pose of the joint's frame in the parent link, shape (4, 4), [m]."""
        T = np.eye(4)
        T[:3, :3] = pin.rpy.rpyToMatrix(*self.rpy)
        T[:3, 3] = self.xyz
        return T


@dataclass(frozen=True, slots=True)
class Origins:
    """Origins by the name of their joint, in the file's order; ``source`` is the file or the URDF, for messages."""

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
                raise UrdfError(
                    f"{self.source}: '{name}' is no joint of {robot.urdf.source}{did_you_mean(name, names)}. Its "
                    f"joints: {choices(joint.name for joint in robot.urdf.joints)}. Give the robot that the file "
                    "was made for."
                )
        origins = {name: origin.T_parent_joint for name, origin in self.joints}
        return robot.rebuilt(robot.urdf.with_origins(origins))

    def to_yaml(self, header: str = "") -> bytes:
        """The file's bytes: ``header``, then one line for each joint; numbers read back exactly."""
        lines = [f"{_SECTION}:"]
        for name, origin in self.joints:
            key = name if _PLAIN.fullmatch(name) else _quoted(name)
            lines.append(
                f'  {key}: {{xyz: "{" ".join(map(repr, origin.xyz))}", rpy: "{" ".join(map(repr, origin.rpy))}"}}'
            )
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
        FileError: The file exists and ``overwrite`` is False, it cannot be written, or YAML cannot hold the names.
    """
    origins = origins_of(robot)
    names = (robot.name, robot.base, robot.tip, Path(path).name, origins.joints[0][0])
    name, base, tip, file, joint = map(one_line, names)
    header = _HEADER.format(name=name, base=base, tip=tip, file=file, section=_SECTION, joint=joint)
    data = origins.to_yaml(header)
    if read_origins(path, data).joints != origins.joints:
        raise FileError(
            f"{path}: the origins of '{robot.name}' do not read back; rename its joints in the URDF."
        )
    return write_atomically(path, data, overwrite=overwrite)


def read_origins(path: str | os.PathLike[str], data: bytes | None = None) -> Origins:
    """What an origins file says, or will say that is to be written.

    Raises:
        FileError: It cannot be read, or is no origins file; the text names file, joint and key.
    """
    source = str(path)
    data = read_bytes(path, "origins file") if data is None else data
    table = parse_yaml(data, source, "origins file").get(_SECTION)
    if not isinstance(table, dict) or not table:
        raise FileError(
            f"{source}: this is no origins file: it has no section '{_SECTION}:' with a line for each joint, such as "
            f"{_EXAMPLE}"
        )
    joints = tuple((name, _origin(name, value, source)) for name, value in table.items())
    return Origins(joints, Path(source).name)


def _origin(name: object, value: object, source: str) -> JointOrigin:
    """The origin of one joint."""
    where = f"{source}, {_SECTION}, joint '{name}'"
    if not isinstance(name, str):
        raise FileError(f"{where}: this is no joint's name; write it in quotes")
    if not isinstance(value, dict) or set(value) != set(_KEYS):
        found = f", not {choices(map(str, value))}" if isinstance(value, dict) else ""
        raise FileError(f"{where}: the keys {choices(_KEYS)} are wanted{found}, as in {_EXAMPLE}")
    return JointOrigin(*(_numbers(value[key], key, where) for key in _KEYS))


def _numbers(value: object, key: str, where: str) -> Triple:
    """Three finite numbers of a text, or of a list as other programs write them."""
    words = value.split() if isinstance(value, str) else value if isinstance(value, list) else []
    texts = ["" if isinstance(word, bool) else str(word) for word in words]
    found = [float(text) for text in texts if NUMBER.fullmatch(text)]
    if not len(texts) == len(found) == 3 or not all(abs(number) <= _FARTHEST for number in found):
        unit = "m" if key == "xyz" else "rad"
        raise FileError(
            f"{where}: {key} is {value!r}; three numbers [{unit}] no larger than {_FARTHEST:g} are wanted, "
            f'such as "0.0 0.0 0.15"'
        )
    return _triple(found)


def _triple(values: Iterable[float]) -> Triple:
    """Three plain floats, without -0."""
    x, y, z = (float(value) + 0.0 for value in values)
    return (x, y, z)


def _quoted(name: str) -> str:
    """A name in YAML's double quotes; what could end a line, or be no character of YAML, by its number."""
    quoted = json.dumps(name, ensure_ascii=False)
    return "".join(c if c.isprintable() else f"\\U{ord(c):08x}" for c in quoted)


def one_line(text: str) -> str:
    """A name for a comment: what could end the line, or be no character of YAML, is a question mark."""
    return "".join(character if character.isprintable() else "?" for character in text)


# YAML


class _StrictLoader(yaml.SafeLoader):
    """PyYAML's safe loader without aliases, without keys that stand twice, with the tags of ROS for angles."""

    def compose_node(self, parent: Any, index: Any) -> Any:  # noqa: ANN401  PyYAML's own types
        """A node; aliases are refused."""
        if self.check_event(yaml.AliasEvent):
            event: Any = self.peek_event()  # type: ignore[no-untyped-call]
            raise yaml.MarkedYAMLError(
                problem=f"an alias (*{event.anchor}) is not read; write the value itself",
                problem_mark=event.start_mark,
            )
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        """A mapping; a key that stands twice is refused."""
        seen: dict[Hashable, int] = {}
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            line = key_node.start_mark.line + 1
            if isinstance(key, Hashable) and key in seen:
                raise yaml.MarkedYAMLError(
                    problem=f"'{key}' stands twice, first in line {seen[key]}; delete one of them",
                    problem_mark=key_node.start_mark,
                )
            if isinstance(key, Hashable):
                seen[key] = line
        return super().construct_mapping(node, deep)


def _angle(unit: float) -> Any:  # noqa: ANN401  PyYAML's constructor
    """What reads a number behind a tag."""
    return lambda loader, node: unit * float(loader.construct_scalar(node))


_StrictLoader.add_constructor("!degrees", _angle(math.radians(1.0)))
_StrictLoader.add_constructor("!radians", _angle(1.0))


def parse_yaml(data: bytes, source: str, what: str) -> dict[Any, Any]:
    """The outermost table of a YAML file's bytes, read strictly: what a program overlooked is an error and no number.

    ``source`` is the file's name and ``what`` what it should be, for messages. Empty where the file holds no table.

    Raises:
        FileError: It is no YAML, a key stands twice, or it has an alias or a tag that is not known.
    """
    try:
        table = _StrictLoader(data).get_single_data()
    except (yaml.YAMLError, ValueError, RecursionError, ArithmeticError) as error:
        mark = getattr(error, "problem_mark", None)
        place = "" if mark is None else f", line {mark.line + 1}, column {mark.column + 1}"
        reason = getattr(error, "problem", None) or str(error).partition("\n")[0]
        raise FileError(f"{source}{place}: this {what} cannot be read as YAML: {reason}") from error
    return table if isinstance(table, dict) else {}
