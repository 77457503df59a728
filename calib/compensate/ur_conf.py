"""The controllers' own files: ``calibration.conf`` with the deltas of an arm, ``urcontrol.conf`` with its nominal rows.

Both are lists of ``key = [six numbers]`` in sections, ``[mounting]`` and ``[DH]``, lengths in metres and angles in
radians. A section may come again further down, ``#`` and ``;`` begin a comment. Everything else in them is kept as it
is, byte for byte.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calib.compensate.ur_dh import COLUMNS, FullDH
from calib.errors import FileError, choices, did_you_mean
from calib.model.files import read_bytes, write_atomically
from calib.model.number_text import NUMBER

Array = NDArray[np.float64]

MOUNTING, NOMINAL = "mounting", "DH"

#: Larger values are no deltas in metres and radians. d runs away between axes that are nearly parallel, theta with it.
_LARGEST = {
    MOUNTING: {"theta": 8.0 * np.pi, "a": 10.0, "d": 1e9, "alpha": 0.5},
    NOMINAL: {"theta": 2.0 * np.pi, "a": 10.0, "d": 10.0, "alpha": 2.0 * np.pi},
}


#: The byte order mark that some editors put before the text, a character for each byte.
_MARK = "\xef\xbb\xbf"


@dataclass(frozen=True, slots=True)
class _Entry:
    """One ``key = value`` of a file.

    Attributes:
        section: Name of its section.
        key: Its key.
        value: The value without a comment.
        line: Its line, from 1.
        start: Where the value begins in the text.
        end: Where it ends.
    """

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
    return _deltas(path, _text(path, "calibration.conf"))


def read_nominal(path: str | os.PathLike[str]) -> FullDH:
    """The nominal rows of a ``urcontrol.conf``: ``a``, ``d`` and ``alpha`` of ``[DH]``, and ``theta`` if it is there.

    Raises:
        FileError: As for `read_deltas`.
    """
    text = _text(path, "urcontrol.conf")
    keys = {name: name for name in COLUMNS}
    found = _wanted(path, text, NOMINAL, "urcontrol.conf", keys, optional=("theta",))
    columns = {name: _column(path, found[name], name) for name in COLUMNS if name in found}
    return FullDH(**{"theta": np.zeros(6), **columns})


def write_deltas(path: str | os.PathLike[str], deltas: FullDH, *, overwrite: bool = False) -> Path:
    """Write a ``calibration.conf`` with nothing but the deltas.

    Raises:
        FileError: The deltas are no arm's; or the file exists and ``overwrite`` is False, or it cannot be written.
    """
    lines = [f"[{MOUNTING}]"]
    for key, name in _delta_keys().items():
        lines.append(f"{key} = {_list(getattr(deltas, name))}")
    text = "\n".join([*lines, ""])
    _deltas(path, text)  # what could not be read again is not written
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
    text = _text(source, "calibration.conf")
    _deltas(source, text)
    values = {key: getattr(deltas, name) for key, name in _delta_keys().items()}
    # Every place where a key stands, from the last on, so that the places before it stay where they are.
    entries = [entry for entry in _entries(text) if _is_wanted(entry, MOUNTING, values)]
    for entry in reversed(entries):
        was = _column(source, entry, entry.key.removeprefix("delta_"))
        if (was != values[entry.key]).any():  # else it stays as it is written, digit for digit
            text = text[: entry.start] + _list(values[entry.key]) + text[entry.end :]
    _deltas(path, text)  # what could not be read again is not written
    return write_atomically(path, text.encode("latin-1"), overwrite=overwrite)


def other_keys(path: str | os.PathLike[str]) -> tuple[str, ...]:
    """The keys of ``[mounting]`` beside the deltas, such as ``joint_checksum``."""
    entries = _entries(_text(path, "calibration.conf"))
    keys = [e.key for e in entries if e.section == MOUNTING and e.key not in _delta_keys()]
    return tuple(dict.fromkeys(keys))


def not_linearised(path: str | os.PathLike[str]) -> str:
    """The ``calibration_status`` of a file, where it has one that is not 2, linearised; else empty."""
    entries = _entries(_text(path, "calibration.conf"))
    found = [e.value for e in entries if e.section == MOUNTING and e.key == "calibration_status"]
    return _short(found[-1]) if found and found[-1] != "2" else ""


def _deltas(path: str | os.PathLike[str], text: str) -> FullDH:
    """The deltas in the text of a file."""
    found = _wanted(path, text, MOUNTING, "calibration.conf", _delta_keys())
    return FullDH(*(_column(path, found[key], name) for key, name in _delta_keys().items()))


def _delta_keys() -> dict[str, str]:
    """The keys of the deltas, each with the column that it is for."""
    return {f"delta_{name}": name for name in COLUMNS}


def _text(path: str | os.PathLike[str], what: str) -> str:
    """A file's text, a character for each byte, so that it goes back as it came."""
    data = read_bytes(path, what)
    if b"\0" in data:
        message = f"{path}: this is not a {what}: it has bytes that no text has. Copy it from the controller again."
        raise FileError(message)
    if b"\r" in data and b"\n" not in data:
        message = (
            f"{path}: its lines end in carriage returns alone, so that it is one line to every other program. Save it "
            "with line feeds (LF or CRLF), or copy it from the controller again."
        )
        raise FileError(message)
    return data.decode("latin-1")


def _entries(text: str) -> list[_Entry]:
    """Every ``key = value`` in the file's order; a list may go on over the lines that follow."""
    entries: list[_Entry] = []
    section, place = "", 0
    open_until = 0
    # Not splitlines: a byte that is a letter in UTF-8 may be a line's end there.
    for number, line in enumerate(text.split("\n"), start=1):
        start = place
        place += len(line) + 1
        if start < open_until:
            continue
        bare = _without_comment(line).removeprefix(_MARK).strip()
        if bare.startswith("[") and bare.endswith("]") and "=" not in bare:
            section = bare[1:-1].strip()
            continue
        key, equals, _ = line.partition("=")
        if not equals or not bare or "=" not in bare:
            continue
        first = start + len(key) + 1
        end = _end_of_value(text, first)
        open_until = end
        raw = text[first:end]
        first += len(raw) - len(raw.lstrip())
        last = first + len(raw.strip())
        value = "".join(_without_comment(part) for part in text[first:last].split("\n"))
        entries.append(_Entry(section, key.strip(), value.strip(), number, first, last))
    return entries


def _end_of_value(text: str, first: int) -> int:
    """Where a value ends: with its line, or with the line further down that closes its list; comments left out."""
    place, own_end = first, first
    while True:
        newline = text.find("\n", place)
        line = _without_comment(text[place : len(text) if newline < 0 else newline])
        if place == first:
            own_end = first + len(line)
            if not line.lstrip().startswith("[") or "]" in line:
                return own_end
        # A list that is never closed ends with its own line: the next key or list is not its end.
        elif "=" in line or "[" in line:
            return own_end
        elif "]" in line:
            return place + len(line)
        if newline < 0:
            return own_end
        place = newline + 1


def _without_comment(line: str) -> str:
    """A line up to its comment."""
    return re.split(r"[#;]", line, maxsplit=1)[0]


def _is_wanted(entry: _Entry, section: str, keys: Mapping[str, object]) -> bool:
    """Whether an entry is one of these keys of that section."""
    return entry.section == section and entry.key in keys


def _wanted(
    path: str | os.PathLike[str],
    text: str,
    section: str,
    what: str,
    keys: Mapping[str, str],
    optional: tuple[str, ...] = (),
) -> dict[str, _Entry]:
    """The entries of these keys in a section, by key.

    Raises:
        FileError: The section or a key is missing, or a key has two values.
    """
    entries = _entries(text)
    found_there = re.findall(rf"^(?:{_MARK})?[ \t]*\[([^\]=\r\n,]+)\]", text, re.MULTILINE)
    sections = list(dict.fromkeys(name.strip() for name in found_there))
    if section not in sections:
        has = f"its sections are {choices(sections)}" if sections else "it has no section"
        message = f"{path}: there is no [{section}] in it, {has}. Give the {what} of a Universal Robots controller."
        raise FileError(message)
    found: dict[str, _Entry] = {}
    for entry in entries:
        if not _is_wanted(entry, section, keys):
            continue
        before = found.get(entry.key)
        if before is not None and before.value.split() != entry.value.split():
            message = (
                f"{path}: {entry.key} stands in [{section}] with two values, in line {before.line} and in line "
                f"{entry.line}; keep the one that is right."
            )
            raise FileError(message)
        found[entry.key] = entry
    others = [entry.key for entry in entries if entry.section == section and entry.key not in keys]
    for key in keys:
        if key not in found and key not in optional:
            message = (
                f"{path}: [{section}] has no {key}{did_you_mean(key, others)}; a {what} has "
                f"{choices(k for k in keys if k not in optional)} there, six numbers each."
            )
            raise FileError(message)
    return found


def _column(path: str | os.PathLike[str], entry: _Entry, name: str) -> Array:
    """The six numbers of an entry.

    Raises:
        FileError: They are not six, one is no finite number, or too large for its unit.
    """
    where = f"{path}, line {entry.line}: {entry.key}"
    if not (entry.value.startswith("[") and entry.value.endswith("]")):
        message = (
            f"{where} is '{_short(entry.value)}'; a list of six numbers in brackets is wanted."
        )
        raise FileError(message)
    words = [word.strip() for word in entry.value[1:-1].split(",")]
    if len(words) != 6:
        message = (
            f"{where} has {len(words)} values; a Universal Robots arm has six joints, six numbers with commas "
            "between them are wanted."
        )
        raise FileError(message)
    values = np.zeros(6)
    largest = _LARGEST[entry.section][name]
    unit = "m" if name in ("a", "d") else "rad"
    for i, word in enumerate(words):
        value = float(word) if NUMBER.fullmatch(word) else np.inf
        if not np.isfinite(value):
            message = (
                f"{where} of joint {i + 1} is '{_short(word)}'; a finite number [{unit}] is wanted."
            )
            raise FileError(message)
        if abs(value) > largest:
            message = (
                f"{where} of joint {i + 1} is {value:g}, more than {largest:g} {unit}: that is no arm's. Lengths are "
                "in metres and angles in radians."
            )
            raise FileError(message)
        values[i] = value
    return values


def _short(text: str) -> str:
    """What a value looks like, for a message."""
    line = " ".join(text.split())
    return line if len(line) <= 40 else f"{line[:37]}..."


def _list(values: Array) -> str:
    """Six numbers that read back exactly."""
    return "[ " + ", ".join(repr(float(value) + 0.0) for value in values) + "]"
