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
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
import yaml
from numpy.typing import NDArray

from calib.errors import FileError, choices, did_you_mean
from calib.formats.ur_dh import COLUMNS, FullDH
from calib.formats.ur_models import LINKS
from calib.formats.yaml_file import parse_yaml
from calib.model.files import read_bytes, write_atomically
from calib.model.robot import read_only
from calib.units import NUMBER

Array = NDArray[np.float64]

MOUNTING, NOMINAL = "mounting", "DH"

_CONF, _CONTROL, _YAML = "calibration.conf", "urcontrol.conf", "kinematics.yaml"

_DELTAS = {f"delta_{name}": name for name in COLUMNS}

#: Larger values are no deltas in metres and radians. d runs away between axes that are nearly parallel, theta with it.
_LARGEST = {
    MOUNTING: {"theta": 8.0 * np.pi, "a": 10.0, "d": 1e9, "alpha": 0.5},
    NOMINAL: {"theta": 2.0 * np.pi, "a": 10.0, "d": 10.0, "alpha": 2.0 * np.pi},
}

#: A section, or a key with its value: a list, which may go on over lines, or the rest of its line. The first line may
#: begin with the byte order mark that some editors put there, a character for each byte.
_PART = re.compile(
    r"^(?:\xef\xbb\xbf)?[ \t]*(?:\[(?P<section>[^\]=,\r\n]+)\]"
    r"|(?P<key>\w+)[ \t]*=[ \t]*(?P<value>\[(?:[^\]\[=#;]|[#;][^\n]*)*\]|[^#;\r\n]*))",
    re.MULTILINE,
)

#: The keys of a link and their units.
_UNITS = {"x": "m", "y": "m", "z": "m", "roll": "rad", "pitch": "rad", "yaw": "rad"}

#: Larger values are no metres and no radians.
_FARTHEST = {"m": 10.0, "rad": 4.0 * np.pi}

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


def read_deltas(path: str | os.PathLike[str]) -> FullDH:
    """The deltas of a ``calibration.conf``: ``delta_theta``, ``delta_a``, ``delta_d`` and ``delta_alpha``.

    Raises:
        FileError: The file cannot be read, has no ``[mounting]``, or not six numbers for each of the four in metres
            and radians.
    """
    return _deltas(path, _text(path, _CONF))


def read_nominal(path: str | os.PathLike[str]) -> FullDH:
    """The nominal rows of a ``urcontrol.conf``: ``a``, ``d`` and ``alpha`` of ``[DH]``, and ``theta`` if it is there.

    Raises:
        FileError: As for `read_deltas`.
    """
    keys = {name: name for name in COLUMNS}
    found = _columns(path, _text(path, _CONTROL), NOMINAL, _CONTROL, keys, optional=("theta",))
    return FullDH(**{"theta": np.zeros(6), **found})


def write_deltas(path: str | os.PathLike[str], deltas: FullDH, *, overwrite: bool = False) -> Path:
    """Write a ``calibration.conf`` with nothing but the deltas.

    Raises:
        FileError: The file exists and ``overwrite`` is False, or it cannot be written.
    """
    lines = [f"{key} = {_list(getattr(deltas, name))}" for key, name in _DELTAS.items()]
    text = "\n".join([f"[{MOUNTING}]", *lines, ""])
    return write_atomically(path, text.encode(), overwrite=overwrite)


def update_deltas(
    source: str | os.PathLike[str],
    path: str | os.PathLike[str],
    deltas: FullDH,
    *,
    overwrite: bool = False,
) -> Path:
    """Write a ``calibration.conf`` with other deltas and every other byte as it is in ``source``.

    Raises:
        FileError: ``source`` cannot be read as by `read_deltas`; or the file exists and ``overwrite`` is False, or it
            cannot be written.
    """
    text = _text(source, _CONF)
    old = _deltas(source, text)
    # Every place where a key stands, from the last on, so that the places before it stay where they are.
    for entry in reversed(_entries(text)):
        if entry.section == MOUNTING and entry.key in _DELTAS:
            was, values = (getattr(one, _DELTAS[entry.key]) for one in (old, deltas))
            if (was != values).any():  # else it stays as it is written, digit for digit
                text = text[: entry.start] + _list(values) + text[entry.end :]
    return write_atomically(path, text.encode("latin-1"), overwrite=overwrite)


def other_keys(path: str | os.PathLike[str]) -> tuple[str, ...]:
    """The keys of ``[mounting]`` beside the deltas, such as ``joint_checksum``."""
    keys = [entry.key for entry in _entries(_text(path, _CONF)) if entry.section == MOUNTING]
    return tuple(dict.fromkeys(key for key in keys if key not in _DELTAS))


def not_linearised(path: str | os.PathLike[str]) -> str:
    """The ``calibration_status`` of a file, where it has one that is not 2, linearised; else empty."""
    found = [
        entry.value
        for entry in _entries(_text(path, _CONF))
        if (entry.section, entry.key) == (MOUNTING, "calibration_status")
    ]
    return found[-1][:40] if found and found[-1] != "2" else ""


def _deltas(path: str | os.PathLike[str], text: str) -> FullDH:
    """The deltas in the text of a file."""
    return FullDH(**_columns(path, text, MOUNTING, _CONF, _DELTAS))


def _text(path: str | os.PathLike[str], what: str) -> str:
    """A file's text, a character for each byte, so that it goes back as it came."""
    data = read_bytes(path, what)
    if b"\0" in data:
        raise FileError(
            f"{path}: this is not a {what}: it has bytes that no text has. Copy it from the controller again."
        )
    return data.decode("latin-1")


def _entries(text: str) -> list[_Entry]:
    """Every ``key = value`` in the file's order; a list may go on over the lines that follow."""
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
    path: str | os.PathLike[str],
    text: str,
    section: str,
    what: str,
    keys: Mapping[str, str],
    optional: tuple[str, ...] = (),
) -> dict[str, Array]:
    """The six numbers of each of these keys in a section, by their column.

    Raises:
        FileError: The section or a key is missing, a key has two values, or one is not six numbers.
    """
    sections = list(
        dict.fromkeys(p["section"].strip() for p in _PART.finditer(text) if p["section"])
    )
    if section not in sections:
        has = f"its sections are {choices(sections)}" if sections else "it has no section"
        raise FileError(
            f"{path}: there is no [{section}] in it, {has}. Give the {what} of a Universal Robots controller."
        )
    entries = [entry for entry in _entries(text) if entry.section == section]
    found: dict[str, _Entry] = {}
    for entry in entries:
        before = found.setdefault(entry.key, entry)
        if entry.key in keys and before.value.split() != entry.value.split():
            raise FileError(
                f"{path}: {entry.key} stands in [{section}] with two values, in line {before.line} and in line "
                f"{entry.line}; keep the one that is right."
            )
    for key in keys:
        if key not in found and key not in optional:
            others = [entry.key for entry in entries if entry.key not in keys]
            raise FileError(
                f"{path}: [{section}] has no {key}{did_you_mean(key, others)}; a {what} has "
                f"{choices(k for k in keys if k not in optional)} there, six numbers each."
            )
    return {
        name: _six(path, found[key], _LARGEST[section][name], "m" if name in ("a", "d") else "rad")
        for key, name in keys.items()
        if key in found
    }


def _six(path: str | os.PathLike[str], entry: _Entry, largest: float, unit: str) -> Array:
    """The six numbers of an entry.

    Raises:
        FileError: They are not six, one is no finite number, or too large for its unit.
    """
    where = f"{path}, line {entry.line}: {entry.key}"
    words = [word.strip() for word in entry.value.strip("[]").split(",")]
    if not (entry.value.startswith("[") and entry.value.endswith("]") and len(words) == 6):
        raise FileError(
            f"{where} is '{' '.join(entry.value.split())[:60]}'; a list of six numbers in brackets, one for each "
            "joint, with commas between them is wanted."
        )
    return np.array(
        [_number(f"{where} of joint {i}", word, largest, unit) for i, word in enumerate(words, 1)]
    )


def _number(where: str, word: str, largest: float, unit: str) -> float:
    """A number in metres or radians.

    Raises:
        FileError: It is none, not finite, or too large for its unit.
    """
    number = float(word) if NUMBER.fullmatch(word) else np.inf
    if not np.isfinite(number):
        raise FileError(f"{where} is '{word[:40]}'; a finite number [{unit}] is wanted.")
    if abs(number) > largest:
        raise FileError(
            f"{where} is {number:g}, more than {largest:.4g} {unit}: that is no arm's. Lengths are in metres and "
            "angles in radians."
        )
    return number


def _list(values: Array) -> str:
    """Six numbers that read back exactly."""
    return "[ " + ", ".join(repr(float(value) + 0.0) for value in values) + "]"


# kinematics.yaml


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
    top = parse_yaml(read_bytes(path, _YAML), str(path), _YAML)
    if "kinematics" not in top:
        raise FileError(
            f"{path}: there is no 'kinematics' in it{did_you_mean('kinematics', map(str, top))}, its keys are "
            f"{choices(map(str, top))}. Give the kinematics.yaml of the ROS driver (ur_calibration), or one that "
            "calib wrote."
        )
    links = _table(path, "kinematics", top["kinematics"], LINKS)
    chain = []
    for link in LINKS:
        values = _table(path, f"'{link}'", links[link], tuple(_UNITS))
        numbers = [
            _number(f"{path}: {key} of '{link}'", str(values[key]), _FARTHEST[unit], unit)
            for key, unit in _UNITS.items()
        ]
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = pin.rpy.rpyToMatrix(*numbers[3:]), numbers[:3]
        chain.append(T)
    hash = links.get("hash") or None
    if hash is not None and not (isinstance(hash, str) and _HASH.fullmatch(hash)):
        raise FileError(
            f"{path}: the hash is {str(hash)[:40]!r}, not one word of text such as 'calib_12788084448423163542'. Take "
            "the line from the robot's own kinematics.yaml."
        )
    return UrYaml(read_only([*chain, np.eye(4)]), hash)


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
            lines.append(f"    {key}: {_yaml_number(value)}")
    lines += [f"  hash: {hash}", ""]
    return write_atomically(path, "\n".join(lines).encode(), overwrite=overwrite)


def check_hash(hash: str) -> None:
    """Refuse what the driver could not have made: a hash with spaces, none, or what YAML takes for no text.

    Raises:
        FileError: It is none.
    """
    if not _HASH.fullmatch(hash) or not isinstance(yaml.safe_load(hash), str):
        raise FileError(
            f"The hash '{hash}' is none of a calibration: one such as 'calib_12788084448423163542' is wanted. Take it "
            "from the robot's own kinematics.yaml or calibration.conf."
        )


def _yaml_number(value: float) -> str:
    """A number that every YAML reader takes for one: 1e-05 without a point is text to YAML 1.1."""
    text = repr(float(value) + 0.0)
    mantissa, e, exponent = text.partition("e")
    return text if not e or "." in mantissa else f"{mantissa}.0e{exponent}"


def _table(
    path: str | os.PathLike[str], what: str, found: object, wanted: Sequence[str]
) -> Mapping[str, Any]:
    """A table with these keys.

    Raises:
        FileError: It is none, or lacks one.
    """
    if not isinstance(found, dict):
        raise FileError(f"{path}: {what} has no keys with values; it must have {choices(wanted)}.")
    for name in wanted:
        if name not in found:
            others = [str(key) for key in found if key not in wanted]
            raise FileError(
                f"{path}: {what} has no '{name}'{did_you_mean(name, others)}; it must have {choices(wanted)}."
            )
    return found
