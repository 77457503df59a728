"""The files of Universal Robots: a controller's ``calibration.conf`` and ``urcontrol.conf``, and ``kinematics.yaml``.

``calibration.conf`` has the deltas of an arm, ``urcontrol.conf`` its nominal rows: lists ``key = [six numbers]`` in
sections, ``[mounting]`` and ``[DH]``, lengths in metres and angles in radians; ``#`` and ``;`` begin a comment.
Everything else in them is kept as it is, byte for byte, which no reader of INI files does.

``kinematics.yaml`` has the six placements that the description for ROS takes, and the calibration's hash:

    kinematics:
      shoulder: {x, y, z, roll, pitch, yaw}      and so on: upper_arm, forearm, wrist_1, wrist_2, wrist_3
      hash: calib_...

Each is the pose of a link's joint in the link before it, the first in ``base_link_inertia``, which is the controller's
base; the joints turn about z and ``tool0`` is the frame of the last. R = Rz(yaw) Ry(pitch) Rx(roll).
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
import yaml
from numpy.typing import NDArray

from calib.errors import FileError, choices, did_you_mean
from calib.files import read_bytes
from calib.formats.origins import parse_yaml
from calib.formats.ur_arms import COLUMNS, LINKS
from calib.robot.robot import read_only
from calib.units import NUMBER

Array = NDArray[np.float64]
PathLike = str | os.PathLike[str]

_DELTAS = tuple(f"delta_{name}" for name in COLUMNS)

#: What is too large for a number [m, rad]: no delta in metres and radians, and no place on an arm. d runs away between
#: axes that are nearly parallel, theta with it.
_LARGEST_DELTA = dict(zip(_DELTAS, (8.0 * np.pi, 10.0, 1e9, 0.5), strict=True))
_LARGEST_NOMINAL = dict(zip(COLUMNS, (2.0 * np.pi, 10.0, 10.0, 2.0 * np.pi), strict=True))
_LARGEST_POSE = dict.fromkeys("xyz", 10.0) | dict.fromkeys(("roll", "pitch", "yaw"), 4.0 * np.pi)

#: The head of a section; a key whose value is a list of numbers, which may go on over lines; and any key.
_SECTION = re.compile(r"^[ \t]*\[[ \t]*(\w+)[ \t]*\]", re.MULTILINE)
_LIST = r"^([ \t]*{}[ \t]*=[ \t]*)(\[[^\]]*\])"
_KEY = re.compile(r"^[ \t]*(\w+)[ \t]*=[ \t]*([^#;\r\n]*)", re.MULTILINE)

#: What a hash is made of. A space or a line break in it would be another YAML.
_HASH = re.compile(r"[\w.+-]+")


@dataclass(frozen=True, slots=True, eq=False)
class Conf:
    """A ``calibration.conf``.

    Attributes:
        deltas: shape (6, 4), ``delta_theta``, ``delta_a``, ``delta_d`` and ``delta_alpha`` [rad], [m].
        others: The other keys of ``[mounting]``, such as ``joint_checksum``.
        status: Its ``calibration_status``, if that is not 2, linearised; else empty.
        text: The whole file, a character for each byte, so that it goes back as it came.
    """

    deltas: Array
    others: tuple[str, ...]
    status: str
    text: str

    @classmethod
    def read(cls, path: PathLike, data: bytes | None = None) -> Conf:
        """What a file says, or will say that is to be written; `FileError` where it has not these numbers."""
        text = (read_bytes(path, "calibration.conf") if data is None else data).decode("latin-1")
        deltas = _columns(path, text, "mounting", _LARGEST_DELTA)
        keys = dict(_KEY.findall(_section(text, "mounting")))
        status = keys.get("calibration_status", "2").strip()
        others = tuple(key for key in keys if key not in _DELTAS)
        return cls(deltas, others, "" if status == "2" else status[:40], text)

    def with_deltas(self, deltas: Array) -> bytes:
        """The file with other deltas, every other byte as it was."""
        text = self.text
        for key, old, new in zip(_DELTAS, self.deltas.T, deltas.T, strict=True):
            if (old != new).any():  # else it stays, digit for digit
                pattern = re.compile(_LIST.format(key), re.MULTILINE)
                text = pattern.sub(lambda found, new=new: found[1] + _list(new), text)  # type: ignore[misc]
        return text.encode("latin-1")


def conf_bytes(deltas: Array) -> bytes:
    """A ``calibration.conf`` with nothing but the deltas (6, 4)."""
    lines = [f"{key} = {_list(values)}" for key, values in zip(_DELTAS, deltas.T, strict=True)]
    return "\n".join(["[mounting]", *lines, ""]).encode()


def read_nominal(path: PathLike) -> Array:
    """The nominal rows (6, 4) of a ``urcontrol.conf``: ``a``, ``d``, ``alpha`` of ``[DH]``, and ``theta`` or zeros."""
    text = read_bytes(path, "urcontrol.conf").decode("latin-1")
    return _columns(path, text, "DH", _LARGEST_NOMINAL, optional="theta")


def _section(text: str, name: str) -> str:
    """What is in the sections of a name, which may come again further down."""
    _, *parts = _SECTION.split(text)
    return "".join(one for own, one in zip(parts[::2], parts[1::2], strict=True) if own == name)


def _columns(
    path: PathLike, text: str, section: str, largest: Mapping[str, float], optional: str = ""
) -> Array:
    """The six numbers of each of some keys in a section, shape (6, 4)."""
    own = _section(text, section)
    keys = dict.fromkeys(key for key, _ in _KEY.findall(own))
    _check_keys(path, f"[{section}]", keys, [key for key in largest if key != optional])
    columns = []
    for key, most in largest.items():
        found = re.findall(_LIST.format(key), own, re.MULTILINE)
        words = re.sub(r"[#;].*", "", found[-1][1]).strip("[]").split(",") if found else []
        if key == optional and key not in keys:
            words = ["0"] * 6
        if len(words) != 6:
            raise FileError(f"{path}: {key} is no list of six numbers in brackets, one a joint.")
        columns.append([_number(f"{path}: {key}", word.strip(), most) for word in words])
    return read_only(np.transpose(columns))


def _number(where: str, word: str, largest: float) -> float:
    """A number in metres or radians, finite and not too large for what it is."""
    number = float(word) if NUMBER.fullmatch(word) else np.inf
    if not abs(number) <= largest:
        raise FileError(
            f"{where}: '{word[:40]}' is no number up to {largest:.4g}. Lengths are in metres, angles in radians."
        )
    return number


def _check_keys(path: PathLike, what: str, found: Any, wanted: list[str]) -> dict[str, Any]:  # noqa: ANN401  YAML's
    """A table with these keys."""
    table = found if isinstance(found, dict) else {}
    for name in wanted:
        if name not in table:
            others = [str(key) for key in table if key not in wanted]
            raise FileError(
                f"{path}: {what} has no {name}{did_you_mean(name, others)}; it must have {choices(wanted)}."
            )
    return table


def _list(values: Array) -> str:
    """Six numbers that read back exactly."""
    return "[ " + ", ".join(repr(float(value) + 0.0) for value in values) + "]"


# kinematics.yaml


class UrYaml(NamedTuple):
    """A ``kinematics.yaml``: the chain, shape (7, 4, 4) [m], its flange the identity; and the hash."""

    chain: Array
    hash: str | None


def read_kinematics(path: PathLike, data: bytes | None = None) -> UrYaml:
    """What a ``kinematics.yaml`` says, or will say that is to be written; `FileError` where it lacks something."""
    what = "kinematics.yaml"
    top = parse_yaml(read_bytes(path, what) if data is None else data, str(path), what)
    links = _check_keys(path, "kinematics", top.get("kinematics"), list(LINKS))
    chain = np.tile(np.eye(4), (7, 1, 1))
    for link, T in zip(LINKS, chain, strict=False):
        values = _check_keys(path, f"'{link}'", links[link], list(_LARGEST_POSE))
        numbers = [
            _number(f"{path}: {key} of '{link}'", str(values[key]), most)
            for key, most in _LARGEST_POSE.items()
        ]
        T[:3, :3], T[:3, 3] = pin.rpy.rpyToMatrix(*numbers[3:]), numbers[:3]
    return UrYaml(read_only(chain), _checked_hash(path, links.get("hash") or None))


def kinematics_bytes(chain: Array, hash: str, comment: str = "") -> bytes:
    """A ``kinematics.yaml`` of the first six of a chain (7, 4, 4) [m]; its numbers read back exactly.

    Raises:
        FileError: The hash is one that the driver could not have made: it has spaces, or YAML takes it for no text.
    """
    _checked_hash("kinematics.yaml", yaml.safe_load(hash) or "")
    lines = [f"# {comment}"] * bool(comment) + ["kinematics:"]
    for link, T in zip(LINKS, chain, strict=False):
        lines.append(f"  {link}:")
        values = (*T[:3, 3], *pin.rpy.matrixToRpy(T[:3, :3]))
        for key, value in zip(_LARGEST_POSE, values, strict=True):
            # A number that every YAML reader takes for one: 1e-05 without a point is text to YAML 1.1.
            text = re.sub(r"^(-?\d+)e", r"\1.0e", repr(float(value) + 0.0))
            lines.append(f"    {key}: {text}")
    return "\n".join([*lines, f"  hash: {hash}", ""]).encode()


def _checked_hash(path: PathLike, hash: object) -> str | None:
    """A hash that is one word of text, or none."""
    if hash is None or (isinstance(hash, str) and _HASH.fullmatch(hash)):
        return hash
    raise FileError(
        f"{path}: the hash is {str(hash)[:40]!r}, not one such as 'calib_12788084448423163542'. Take the line from the "
        "robot's own kinematics.yaml or calibration.conf."
    )
