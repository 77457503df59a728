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

from calib.errors import FileError, choices, did_you_mean
from calib.formats.ur_models import LINKS
from calib.formats.yaml_file import parse_yaml
from calib.model.files import read_bytes, write_atomically
from calib.model.robot import read_only
from calib.units import NUMBER

Array = NDArray[np.float64]

_WHAT = "kinematics.yaml"

#: The keys of a link and their units.
_UNITS = {"x": "m", "y": "m", "z": "m", "roll": "rad", "pitch": "rad", "yaw": "rad"}

#: Larger values are no metres and no radians.
_LARGEST = {"m": 10.0, "rad": 4.0 * np.pi}

#: What a hash is made of. A space or a line break in it would be another YAML.
_HASH = re.compile(r"[\w.+-]+")


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
    return _parsed(path, read_bytes(path, _WHAT))


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
        for key, value in zip(_UNITS, values, strict=True):
            lines.append(f"    {key}: {_text(value)}")
    lines += [f"  hash: {hash}", ""]
    data = "\n".join(lines).encode()
    off = float(np.abs(_parsed(path, data).chain[:6] - chain[:6]).max())
    if not off <= 1e-12:
        message = (
            f"{path}: read back, the kinematics differ by {off:.1e} from those to be written, so it is not written. "
            "Please report this with the robot."
        )
        raise FileError(message)
    return write_atomically(path, data, overwrite=overwrite)


def check_hash(hash: str) -> None:
    """Refuse what the driver could not have made: a hash with spaces, none, or what YAML takes for no text.

    Raises:
        FileError: It is none.
    """
    if not _HASH.fullmatch(hash) or not isinstance(yaml.safe_load(hash), str):
        message = (
            f"The hash '{hash}' is none of a calibration: one such as 'calib_12788084448423163542' is wanted. Take it "
            "from the robot's own kinematics.yaml or calibration.conf."
        )
        raise FileError(message)


def _text(value: float) -> str:
    """A number that every YAML reader takes for one: 1e-05 without a point is text to YAML 1.1."""
    text = repr(float(value) + 0.0)
    mantissa, e, exponent = text.partition("e")
    return text if not e or "." in mantissa else f"{mantissa}.0e{exponent}"


def _parsed(path: str | os.PathLike[str], data: bytes) -> UrYaml:
    """What the bytes of a file say."""
    top = parse_yaml(data, str(path), _WHAT)
    if "kinematics" not in top:
        message = (
            f"{path}: there is no 'kinematics' in it{did_you_mean('kinematics', map(str, top))}, its keys are "
            f"{choices(map(str, top))}. Give the kinematics.yaml of the ROS driver (ur_calibration), or one that "
            "calib wrote."
        )
        raise FileError(message)
    links = _table(path, "kinematics", top["kinematics"], LINKS)
    chain = []
    for link in LINKS:
        values = _table(path, f"'{link}'", links[link], tuple(_UNITS))
        numbers = [_number(path, link, key, values[key], unit) for key, unit in _UNITS.items()]
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = pin.rpy.rpyToMatrix(*numbers[3:]), numbers[:3]
        chain.append(T)
    hash = links.get("hash") or None
    if hash is not None and not (isinstance(hash, str) and _HASH.fullmatch(hash)):
        message = (
            f"{path}: the hash is {str(hash)[:40]!r}, not one word of text such as 'calib_12788084448423163542'. Take "
            "the line from the robot's own kinematics.yaml."
        )
        raise FileError(message)
    return UrYaml(read_only([*chain, np.eye(4)]), hash)


def _table(
    path: str | os.PathLike[str], what: str, found: object, wanted: Sequence[str]
) -> Mapping[str, Any]:
    """A table with these keys.

    Raises:
        FileError: It is none, or lacks one.
    """
    if not isinstance(found, dict):
        message = f"{path}: {what} has no keys with values; it must have {choices(wanted)}."
        raise FileError(message)
    for name in wanted:
        if name not in found:
            others = [str(key) for key in found if key not in wanted]
            message = f"{path}: {what} has no '{name}'{did_you_mean(name, others)}; it must have {choices(wanted)}."
            raise FileError(message)
    return found


def _number(path: str | os.PathLike[str], link: str, key: str, value: object, unit: str) -> float:
    """A number in metres or radians.

    Raises:
        FileError: It is none, or too large for its unit.
    """
    where = f"{path}: {key} of '{link}'"
    text = "" if isinstance(value, bool) else str(value)  # 1e-5 is text to YAML 1.1
    number = float(text) if NUMBER.fullmatch(text) else np.inf
    if not np.isfinite(number):
        message = f"{where} is '{str(value)[:40]}'; a finite number [{unit}] is wanted."
        raise FileError(message)
    if abs(number) > _LARGEST[unit]:
        message = (
            f"{where} is {number:g}, more than {_LARGEST[unit]:.4g} {unit}: that is no arm's. Lengths are in metres "
            "and angles in radians."
        )
        raise FileError(message)
    return number
