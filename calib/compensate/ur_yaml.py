"""``kinematics.yaml``: the six placements that Universal Robots' description for ROS takes, and the calibration's hash.

    kinematics:
      shoulder: {x, y, z, roll, pitch, yaw}      and so on: upper_arm, forearm, wrist_1, wrist_2, wrist_3
      hash: calib_...

Each is the pose of a link's joint in the link before it, the first in ``base_link_inertia``, which is the controller's
base; the joints turn about z and ``tool0`` is the frame of the last. Lengths in metres, angles in radians, in the
order of a URDF: R = Rz(yaw) Ry(pitch) Rx(roll).
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import yaml
from numpy.typing import NDArray

from calib.compensate.ur_models import LINKS
from calib.errors import FileError, choices, did_you_mean
from calib.model.files import read_bytes, write_atomically
from calib.model.number_text import NUMBER
from calib.model.robot import read_only

Array = NDArray[np.float64]

LENGTHS, ANGLES = ("x", "y", "z"), ("roll", "pitch", "yaw")


#: Larger values are no metres and no radians.
_LARGEST = {"m": 10.0, "rad": 4.0 * np.pi}

#: What a hash is made of. A space or a line break in it would be another YAML.
_HASH = re.compile(r"[\w.+-]+")

#: What YAML calls plain text, and nothing; and what its own tags begin with.
_OF_YAML = "tag:yaml.org,2002:"
_TEXT, _NULL = f"{_OF_YAML}str", f"{_OF_YAML}null"


@dataclass(frozen=True, slots=True, eq=False)
class UrYaml:
    """What a ``kinematics.yaml`` says.

    Attributes:
        chain: shape (7, 4, 4), [m]: the six placements, and the identity for the flange; see `FullDH.chain`.
        hash: The name of the calibration, or None.
    """

    chain: Array
    hash: str | None


def read_yaml(path: str | os.PathLike[str]) -> UrYaml:
    """Read a ``kinematics.yaml``.

    Raises:
        FileError: The file cannot be read, is no YAML, lacks a link or a number, has a key twice, or numbers that are
            no metres and radians.
    """
    return _parsed(path, read_bytes(path, "kinematics.yaml"))


def write_yaml(
    path: str | os.PathLike[str],
    chain: Array,
    hash: str,
    comments: Sequence[str] = (),
    *,
    overwrite: bool = False,
) -> Path:
    """Write a ``kinematics.yaml``; its numbers read back exactly.

    Args:
        path: File to write.
        chain: shape (6 or 7, 4, 4), [m], of which the first six are written.
        hash: The name of the robot's own calibration.
        comments: Lines for the top of the file.
        overwrite: Whether a file that exists may be replaced.

    Raises:
        FileError: The hash is none; or the file exists and ``overwrite`` is False, or it cannot be written.
    """
    check_hash(hash)
    lines = [f"# {comment}" for comment in comments]
    lines.append("kinematics:")
    for link, T in zip(LINKS, chain, strict=False):
        lines.append(f"  {link}:")
        values = (*T[:3, 3], *pin.rpy.matrixToRpy(T[:3, :3]))
        for key, value in zip((*LENGTHS, *ANGLES), values, strict=True):
            lines.append(f"    {key}: {_number(value)}")
    lines += [f"  hash: {hash}", ""]
    data = "\n".join(lines).encode()
    again = _parsed(path, data).chain[:6]
    if np.abs(again - chain[:6]).max() > 1e-12:
        message = (
            f"{path}: read back, the kinematics differ by {np.abs(again - chain[:6]).max():.1e} from those to be "
            "written, so it is not written. Please report this with the robot."
        )
        raise FileError(message)
    return write_atomically(path, data, overwrite=overwrite)


def check_hash(hash: str) -> None:
    """Refuse what the driver could not have made: a hash with spaces, none, or what YAML takes for no text.

    Raises:
        FileError: It is none.
    """
    if not _HASH.fullmatch(hash) or _tag(hash) != _TEXT:
        message = (
            f"The hash '{hash}' is none of a calibration: one such as 'calib_12788084448423163542' is wanted. Take it "
            "from the robot's own kinematics.yaml or calibration.conf."
        )
        raise FileError(message)


def _parsed(path: str | os.PathLike[str], data: bytes) -> UrYaml:
    """What the bytes of a file say."""
    try:
        root = yaml.compose(data.decode("utf-8-sig"), Loader=yaml.SafeLoader)
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as error:
        message = f"{path}: this is not a YAML file: {_reason(error)}. A kinematics.yaml of the ROS driver is wanted."
        raise FileError(message) from error
    top = _mapping(path, root, "the file")
    if "kinematics" not in top:
        message = (
            f"{path}: there is no 'kinematics' in it{did_you_mean('kinematics', top)}, its keys are {choices(top)}. "
            "Give the kinematics.yaml of the ROS driver (ur_calibration), or one that calib wrote."
        )
        raise FileError(message)
    links = _mapping(path, top["kinematics"], "kinematics")
    _check_present(path, "kinematics", links, LINKS)
    chain = [_placement(path, link, links[link]) for link in LINKS]
    return UrYaml(read_only([*chain, np.eye(4)]), _hash(path, links.get("hash")))


def _tag(text: str) -> str:
    """What YAML takes plain text for: true for a truth, 1e+5 for a number."""
    resolver: Any = yaml.resolver.Resolver()
    return str(resolver.resolve(yaml.ScalarNode, text, (True, False)))


def _check_tag(path: str | os.PathLike[str], node: yaml.Node, what: str, known: str = "") -> None:
    """Refuse tags but those of YAML itself and the ones that the description knows."""
    tag = str(node.tag)
    if not tag.startswith(_OF_YAML) and tag not in known.split():
        read = f"; {known.replace(' ', ' and ')} are read there" if known else ""
        message = f"{_where(path, node)}: the tag {tag} of {what} is not known{read}. Write the value without it."
        raise FileError(message)


def _reason(error: Exception) -> str:
    """What a YAML reader says, with the line where it says it."""
    if isinstance(error, yaml.MarkedYAMLError) and error.problem_mark is not None:
        return f"line {error.problem_mark.line + 1}: {error.problem}"
    return "it is nested too deeply" if isinstance(error, RecursionError) else str(error)


def _number(value: float) -> str:
    """A number that every YAML reader takes for one: 1e-05 without a point is text to YAML 1.1."""
    text = repr(float(value) + 0.0)
    mantissa, e, exponent = text.partition("e")
    return text if not e or "." in mantissa else f"{mantissa}.0e{exponent}"


def _where(path: str | os.PathLike[str], node: yaml.Node) -> str:
    """The file and the line of a node."""
    return f"{path}, line {node.start_mark.line + 1}"


def _mapping(
    path: str | os.PathLike[str], node: yaml.Node | None, what: str
) -> dict[str, yaml.Node]:
    """The values of a mapping by key; refused if it is none, or if a key stands twice."""
    if not isinstance(node, yaml.MappingNode):
        where = str(path) if node is None else _where(path, node)
        message = (
            f"{where}: {what} has no keys with values; a kinematics.yaml has 'kinematics' with {choices(LINKS)} and "
            "'hash' in it."
        )
        raise FileError(message)
    _check_tag(path, node, what)
    values: dict[str, yaml.Node] = {}
    for key, value in node.value:
        name = str(key.value)
        if name in values:
            message = f"{_where(path, key)}: '{name}' stands a second time in {what}; keep the one that is right."
            raise FileError(message)
        values[name] = value
    return values


def _check_present(
    path: str | os.PathLike[str], what: str, found: Mapping[str, yaml.Node], wanted: Sequence[str]
) -> None:
    """Refuse a mapping that lacks a key."""
    for name in wanted:
        if name not in found:
            others = [key for key in found if key not in wanted]
            message = f"{path}: {what} has no '{name}'{did_you_mean(name, others)}; it must have {choices(wanted)}."
            raise FileError(message)


def _placement(path: str | os.PathLike[str], link: str, node: yaml.Node) -> Array:
    """The pose of a link's joint, shape (4, 4), [m]."""
    values = _mapping(path, node, f"'{link}'")
    _check_present(path, f"'{link}'", values, (*LENGTHS, *ANGLES))
    T = np.eye(4)
    T[:3, 3] = [_value(path, link, key, values[key], "m") for key in LENGTHS]
    roll, pitch, yaw = (_value(path, link, key, values[key], "rad") for key in ANGLES)
    T[:3, :3] = pin.rpy.rpyToMatrix(roll, pitch, yaw)
    return T


def _value(path: str | os.PathLike[str], link: str, key: str, node: yaml.Node, unit: str) -> float:
    """A number in metres or radians; ``!degrees`` or ``!radians`` before an angle is heeded."""
    _check_tag(path, node, f"{key} of '{link}'", "!degrees !radians" if unit == "rad" else "")
    text = node.value if isinstance(node, yaml.ScalarNode) else "a list or a table"
    value = float(text) if NUMBER.fullmatch(text) else np.inf
    if not np.isfinite(value):
        message = f"{_where(path, node)}: {key} of '{link}' is '{text[:40]}'; a finite number [{unit}] is wanted."
        raise FileError(message)
    if node.tag == "!degrees":
        value = float(np.radians(value))
    if abs(value) > _LARGEST[unit]:
        message = (
            f"{_where(path, node)}: {key} of '{link}' is {value:g}, more than {_LARGEST[unit]:.4g} {unit}: that is no "
            "arm's. Lengths are in metres and angles in radians."
        )
        raise FileError(message)
    return value


def _hash(path: str | os.PathLike[str], node: yaml.Node | None) -> str | None:
    """The hash, None where there is none."""
    if node is None or node.tag == _NULL or (node.tag == _TEXT and not node.value.strip()):
        return None
    if node.tag != _TEXT or not _HASH.fullmatch(node.value):
        said = f"'{node.value[:40]}', " if isinstance(node, yaml.ScalarNode) else ""
        message = (
            f"{_where(path, node)}: hash is {said}not one word of text such as 'calib_12788084448423163542'. Take the "
            "line from the robot's own kinematics.yaml."
        )
        raise FileError(message)
    return str(node.value)
