"""The files of Universal Robots: a controller's ``calibration.conf`` and ``urcontrol.conf``, and ``kinematics.yaml``.

``calibration.conf`` has the deltas of an arm, ``urcontrol.conf`` its nominal rows. Both are lists of
``key = [six numbers]`` in sections, ``[mounting]`` and ``[DH]``, lengths in metres and angles in radians. A section may
come again further down, ``#`` and ``;`` begin a comment. Everything else in them is kept as it is, byte for byte, which
no reader of INI files does.

``kinematics.yaml`` has the six placements that the description for ROS takes, and the calibration's hash:

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
from calib.formats.ur_arms import COLUMNS, LINKS, FullDH
from calib.robot.robot import read_only
from calib.units import NUMBER

Array = NDArray[np.float64]
PathLike = str | os.PathLike[str]

MOUNTING, NOMINAL = "mounting", "DH"

_CONF, _CONTROL, _YAML = "calibration.conf", "urcontrol.conf", "kinematics.yaml"

_DELTAS = {f"delta_{name}": name for name in COLUMNS}

#: The unit of each number, and what is too large for one: no delta in metres and radians, and no place on an arm. d
#: runs away between axes that are nearly parallel, theta with it.
_UNITS = {
    "theta": "rad", "a": "m", "d": "m", "alpha": "rad",
    "x": "m", "y": "m", "z": "m", "roll": "rad", "pitch": "rad", "yaw": "rad",
}  # fmt: skip
_LARGEST: Mapping[str, Mapping[str, float]] = {
    MOUNTING: {"theta": 8.0 * np.pi, "a": 10.0, "d": 1e9, "alpha": 0.5},
    NOMINAL: {"theta": 2.0 * np.pi, "a": 10.0, "d": 10.0, "alpha": 2.0 * np.pi},
    _YAML: dict.fromkeys("xyz", 10.0) | dict.fromkeys(("roll", "pitch", "yaw"), 4.0 * np.pi),
}

#: A section, or a key with its value: a list, which may go on over lines, or the rest of its line. The first line may
#: begin with the byte order mark that some editors put there, a character for each byte.
_PART = re.compile(
    r"^(?:\xef\xbb\xbf)?[ \t]*(?:\[(?P<section>[^\]=,\r\n]+)\]"
    r"|(?P<key>\w+)[ \t]*=[ \t]*(?P<value>\[(?:[^\]\[=#;]|[#;][^\n]*)*\]|[^#;\r\n]*))",
    re.MULTILINE,
)

#: What a hash is made of. A space or a line break in it would be another YAML.
_HASH = re.compile(r"[\w.+-]+")


class _Entry(NamedTuple):
    """One ``key = value``: its section, its line from 1, and where the value stands in the text."""

    section: str
    key: str
    value: str
    line: int
    start: int
    end: int


@dataclass(frozen=True, slots=True, eq=False)
class Conf:
    """A ``calibration.conf``.

    Attributes:
        deltas: ``delta_theta``, ``delta_a``, ``delta_d`` and ``delta_alpha``.
        others: The other keys of ``[mounting]``, such as ``joint_checksum``.
        status: Its ``calibration_status``, if that is not 2, linearised; else empty.
        text: The whole file, a character for each byte, so that it goes back as it came.
    """

    deltas: FullDH
    others: tuple[str, ...]
    status: str
    text: str

    @classmethod
    def read(cls, path: PathLike, data: bytes | None = None) -> Conf:
        """What a file says, or will say that is to be written.

        Raises:
            FileError: It cannot be read, has no ``[mounting]``, or not six numbers for each of the four in metres and
                radians.
        """
        text = _text(read_bytes(path, _CONF) if data is None else data, path, _CONF)
        own = [entry for entry in _entries(text) if entry.section == MOUNTING]
        status = [entry.value for entry in own if entry.key == "calibration_status"]
        return cls(
            FullDH(**_columns(path, text, MOUNTING, _CONF, _DELTAS)),
            tuple(dict.fromkeys(entry.key for entry in own if entry.key not in _DELTAS)),
            status[-1][:40] if status and status[-1] != "2" else "",
            text,
        )

    def with_deltas(self, deltas: FullDH) -> bytes:
        """The file with other deltas, every other byte as it was."""
        text = self.text
        # Every place where a key stands, from the last on, so that the places before it stay where they are.
        for entry in reversed(_entries(text)):
            if entry.section == MOUNTING and entry.key in _DELTAS:
                was, values = (getattr(one, _DELTAS[entry.key]) for one in (self.deltas, deltas))
                if (was != values).any():  # else it stays as it is written, digit for digit
                    text = text[: entry.start] + _list(values) + text[entry.end :]
        return text.encode("latin-1")


def conf_bytes(deltas: FullDH) -> bytes:
    """A ``calibration.conf`` with nothing but the deltas."""
    lines = [f"{key} = {_list(getattr(deltas, name))}" for key, name in _DELTAS.items()]
    return "\n".join([f"[{MOUNTING}]", *lines, ""]).encode()


def read_nominal(path: PathLike) -> FullDH:
    """The nominal rows of a ``urcontrol.conf``: ``a``, ``d`` and ``alpha`` of ``[DH]``, and ``theta`` if it is there.

    Raises:
        FileError: As for `Conf.read`.
    """
    text = _text(read_bytes(path, _CONTROL), path, _CONTROL)
    keys = {name: name for name in COLUMNS}
    found = _columns(path, text, NOMINAL, _CONTROL, keys, optional=("theta",))
    return FullDH(**{"theta": np.zeros(6), **found})


def _text(data: bytes, path: PathLike, what: str) -> str:
    """A file's text, a character for each byte."""
    if b"\0" in data:
        raise FileError(
            f"{path}: this is not a {what}: it has bytes that no text has. Copy it from the controller again."
        )
    return data.decode("latin-1")


def _entries(text: str) -> list[_Entry]:
    """Every ``key = value`` in the text's order; a list may go on over the lines that follow."""
    entries: list[_Entry] = []
    section = ""
    for part in _PART.finditer(text):
        if part["section"] is not None:
            section = part["section"].strip()
            continue
        value = re.sub(r"[#;][^\n]*", "", part["value"]).strip()
        line = text.count("\n", 0, part.start("key")) + 1
        end = part.start("value") + len(part["value"].rstrip())
        entries.append(_Entry(section, part["key"], value, line, part.start("value"), end))
    return entries


def _columns(
    path: PathLike,
    text: str,
    section: str,
    what: str,
    keys: Mapping[str, str],
    optional: tuple[str, ...] = (),
) -> dict[str, Array]:
    """The six numbers of each of these keys in a section, by their column."""
    sections = dict.fromkeys(p["section"].strip() for p in _PART.finditer(text) if p["section"])
    if section not in sections:
        raise FileError(
            f"{path}: there is no [{section}] in it; its sections are {choices(sections) or 'none'}. Give the {what} "
            "of a Universal Robots controller."
        )
    own = [entry for entry in _entries(text) if entry.section == section]
    found: dict[str, _Entry] = {}
    for entry in own:
        before = found.setdefault(entry.key, entry)
        if entry.key in keys and before.value.split() != entry.value.split():
            raise FileError(
                f"{path}: {entry.key} stands in [{section}] with two values, in line {before.line} and in line "
                f"{entry.line}; keep the one that is right."
            )
    needed = {key: None for key in keys if key not in optional}
    _check_keys(path, f"[{section}]", {entry.key: None for entry in own}, needed)
    columns = {}
    for key, name in keys.items():
        if key not in found:
            continue
        entry = found[key]
        where = f"{path}, line {entry.line}: {key}"
        words = [word.strip() for word in entry.value.strip("[]").split(",")]
        if not (entry.value.startswith("[") and entry.value.endswith("]") and len(words) == 6):
            raise FileError(
                f"{where} is '{' '.join(entry.value.split())[:60]}'; a list of six numbers in brackets, one for each "
                "joint, with commas between them is wanted."
            )
        columns[name] = np.array(
            [_number(f"{where} of joint {i}", w, section, name) for i, w in enumerate(words, 1)]
        )
    return columns


def _number(where: str, word: str, section: str, name: str) -> float:
    """A number in metres or radians, finite and not too large for what it is."""
    number, unit, largest = np.inf, _UNITS[name], _LARGEST[section][name]
    if NUMBER.fullmatch(word):
        number = float(word)
    if not np.isfinite(number):
        raise FileError(f"{where} is '{word[:40]}'; a finite number [{unit}] is wanted.")
    if abs(number) > largest:
        raise FileError(
            f"{where} is {number:g}, more than {largest:.4g} {unit}: that is no arm's. Lengths are in metres and "
            "angles in radians."
        )
    return number


def _check_keys(
    path: PathLike, what: str, found: object, wanted: Mapping[str, object]
) -> Mapping[str, Any]:
    """A table with these keys."""
    if not isinstance(found, dict):
        raise FileError(f"{path}: {what} has no keys with values; it must have {choices(wanted)}.")
    for name in wanted:
        if name not in found:
            others = [str(key) for key in found if key not in wanted]
            raise FileError(
                f"{path}: {what} has no {name}{did_you_mean(name, others)}; it must have {choices(wanted)}."
            )
    return found


def _list(values: Array) -> str:
    """Six numbers that read back exactly."""
    return "[ " + ", ".join(repr(float(value) + 0.0) for value in values) + "]"


# kinematics.yaml


class UrYaml(NamedTuple):
    """A ``kinematics.yaml``: the chain, shape (7, 4, 4) [m], its flange the identity, see `FullDH.chain`; the hash."""

    chain: Array
    hash: str | None


def read_kinematics(path: PathLike, data: bytes | None = None) -> UrYaml:
    """What a ``kinematics.yaml`` says, or will say that is to be written.

    Raises:
        FileError: It cannot be read, lacks a link or a number, has a key twice, or numbers that are no metres and
            radians.
    """
    top = parse_yaml(read_bytes(path, _YAML) if data is None else data, str(path), _YAML)
    if "kinematics" not in top:
        raise FileError(
            f"{path}: there is no 'kinematics' in it{did_you_mean('kinematics', map(str, top))}, its keys are "
            f"{choices(map(str, top))}. Give the kinematics.yaml of the ROS driver (ur_calibration), or one that "
            "calib wrote."
        )
    links = _check_keys(path, "kinematics", top["kinematics"], dict.fromkeys(LINKS))
    chain = np.tile(np.eye(4), (7, 1, 1))
    for link, T in zip(LINKS, chain, strict=False):
        values = _check_keys(path, f"'{link}'", links[link], _LARGEST[_YAML])
        numbers = [
            _number(f"{path}: {key} of '{link}'", str(values[key]), _YAML, key)
            for key in _LARGEST[_YAML]
        ]
        T[:3, :3], T[:3, 3] = pin.rpy.rpyToMatrix(*numbers[3:]), numbers[:3]
    hash = links.get("hash") or None
    if hash is not None and not (isinstance(hash, str) and _HASH.fullmatch(hash)):
        raise FileError(
            f"{path}: the hash is {str(hash)[:40]!r}, not one word of text such as 'calib_12788084448423163542'. Take "
            "the line from the robot's own kinematics.yaml."
        )
    return UrYaml(read_only(chain), hash)


def kinematics_bytes(chain: Array, hash: str, comment: str = "") -> bytes:
    """A ``kinematics.yaml``; its numbers read back exactly.

    Args:
        chain: shape (6 or 7, 4, 4), [m], of which the first six are written.
        hash: The name of the robot's own calibration.
        comment: The line at the top.

    Raises:
        FileError: The hash is one that the driver could not have made: it has spaces, or YAML takes it for no text.
    """
    if not _HASH.fullmatch(hash) or not isinstance(yaml.safe_load(hash), str):
        raise FileError(
            f"The hash '{hash}' is none of a calibration: one such as 'calib_12788084448423163542' is wanted. Take it "
            "from the robot's own kinematics.yaml or calibration.conf."
        )
    lines = [f"# {comment}"] * bool(comment) + ["kinematics:"]
    for link, T in zip(LINKS, chain, strict=False):
        lines.append(f"  {link}:")
        values = (*T[:3, 3], *pin.rpy.matrixToRpy(T[:3, :3]))
        for key, value in zip(_LARGEST[_YAML], values, strict=True):
            # A number that every YAML reader takes for one: 1e-05 without a point is text to YAML 1.1.
            text = re.sub(r"^(-?\d+)e", r"\1.0e", repr(float(value) + 0.0))
            lines.append(f"    {key}: {text}")
    return "\n".join([*lines, f"  hash: {hash}", ""]).encode()
