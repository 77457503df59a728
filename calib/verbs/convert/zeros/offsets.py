"""Files with an offset for each joint: the changes alone, or the file of a robot with new offsets in it.

An entry stands under the name of its joint, at any depth: ``shoulder_pan: {id: 1, homing_offset: -310}``.
"""

from __future__ import annotations

import copy
import json
import math
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from calib.basics.files import read_bytes
from calib.errors import FileError, choices
from calib.verbs.convert.origins import parse_yaml
from calib.verbs.convert.source_kinds import YAML
from calib.verbs.convert.zeros.rounding import RoundedZeros

#: Decimals that an offset keeps [rad, m]: below any encoder, above the rounding of a sum.
_KEPT = 9


class OffsetFile(NamedTuple):
    """A kind of file with offsets."""

    #: What it is, for messages
    what: str
    #: Endings of its files
    endings: tuple[str, ...]
    #: Reads the outermost table of a file; `FileError` if it is none
    parse: Callable[[bytes, str], dict[Any, Any]]
    #: Writes it
    dump: Callable[[dict[Any, Any]], bytes]
    #: Key of the gear ratio in an entry, by which an offset of the motor is larger than one of the joint; empty: the
    #: offset is one of the joint
    ratio_key: str
    #: Key of the direction in an entry, 0 for a servo that turns with its joint; empty: there is none
    inverted_key: str
    #: Whether an entry without the offset has the offset 0; else it is refused
    may_lack: bool
    #: How a reading is made of the offset, as a comment; empty: such files have no comments
    comment: str = ""
    #: Key by which an entry is one of another kind of file; empty: none is known
    foreign_key: str = ""
    #: Whether offsets are whole numbers
    is_whole: bool = False


def offsets_bytes(kind: OffsetFile, rounded: RoundedZeros, update: str | Path | None) -> bytes:
    """Return the bytes of a file with offsets.

    Args:
        kind: What kind of file it is.
        rounded: The zeros.
        update: The robot's own file, of which all else is kept; None: the file has the changes alone, under the key
            with ``_change`` behind it.

    Returns:
        The file.

    Raises:
        FileError: ``update`` cannot be read, lacks a joint, or an offset is beyond its limit.
    """
    changes = rounded.by_joint()
    key = rounded.stored.key
    if update is None:
        table: dict[Any, Any] = {name: {f"{key}_change": _plain(n)} for name, n in changes.items()}
    else:
        table = _updated(kind, rounded, update)
    comment = f"# {key} of each joint [rad, m] by calib: {kind.comment}\n" if kind.comment else ""
    data = comment.encode() + kind.dump(table)
    if kind.parse(data, "the file to write") != table:
        raise FileError(f"This {kind.what} does not read back; rename the joints in the URDF.")
    return data


def _updated(kind: OffsetFile, rounded: RoundedZeros, update: str | Path) -> dict[Any, Any]:
    """Return the table of a robot's own file with new offsets.

    Args:
        kind: What kind of file it is.
        rounded: The zeros.
        update: The file.
    """
    table = copy.deepcopy(kind.parse(read_bytes(update, kind.what), str(update)))
    changes, key, largest = rounded.by_joint(), rounded.stored.key, rounded.stored.largest
    places = list(_places(table, changes))
    if len(places) > 1:
        raise FileError(
            f"{update}: this {kind.what} has entries of these joints in {len(places)} places, as of two arms. Give a "
            "copy with those of the calibrated arm alone."
        )
    entries = places[0] if places else {}
    missing = [name for name in changes if name not in entries]
    if missing:
        raise FileError(
            f"{update}: this {kind.what} has no entry of the joint {choices(missing)}; it has "
            f"{choices(entries or table)}. Entries have the names of the URDF's joints: rename them in a copy of the "
            "file, or leave out --update, and the file has the changes alone."
        )
    for name, change in changes.items():
        entry = entries[name]
        where = f"{update}: {name}"
        new = _old_offset(kind, entry, key, where) + _ratio(kind, entry, where) * change
        if abs(new) > largest:
            raise FileError(
                f"{where}: its {key} would be {new:g}, beyond {largest:g}, which the servo cannot store. Move the "
                "servo's horn by a tooth towards the zero, or set the middle of the joint again, and measure again."
            )
        entry[key] = _plain(new)
    return table


def _places(table: object, names: Mapping[str, float]) -> Iterator[dict[str, Any]]:
    """Yield the entries of each table, at any depth, that has an entry of a joint, which is a table itself.

    Args:
        table: A table or other value of the file.
        names: The joints, by name.
    """
    if not isinstance(table, dict):
        return
    if any(isinstance(table.get(name), dict) for name in names):
        yield {name: entry for name, entry in table.items() if isinstance(entry, dict)}
        return
    for value in table.values():
        yield from _places(value, names)


def _old_offset(kind: OffsetFile, entry: Mapping[str, Any], key: str, where: str) -> float:
    """Return the offset of an entry; `FileError` if it has none that is a number."""
    if kind.foreign_key in entry:
        raise FileError(
            f"{where}: it has a '{kind.foreign_key}', so that this is no {kind.what}. Choose the format of this file "
            "with --to."
        )
    if kind.may_lack and key not in entry:
        return 0.0
    offset = _number(entry, key, where)
    if kind.is_whole and offset != int(offset):
        raise FileError(f"{where}: its {key} is {offset:g}; a servo stores whole ticks.")
    return offset


def _ratio(kind: OffsetFile, entry: Mapping[str, Any], where: str) -> float:
    """Return by how much the change of an offset is larger than that of the joint.

    Raises:
        FileError: The servo is inverted, or the gear ratio is no number.
    """
    if entry.get(kind.inverted_key, 0) != 0:
        raise FileError(
            f"{where}: its {kind.inverted_key} is {entry[kind.inverted_key]}: whether the joint's reading grows with "
            "the ticks or falls is not known. Leave out --update, and change this offset by hand, with the other sign "
            "if the reading falls."
        )
    if kind.ratio_key not in entry:
        return 1.0
    ratio = _number(entry, kind.ratio_key, where)
    if ratio == 0.0:
        raise FileError(
            f"{where}: its {kind.ratio_key} is 0; it is 1 for a motor that turns with its joint."
        )
    return ratio


def _number(entry: Mapping[str, Any], key: str, where: str) -> float:
    """Return a number of an entry; `FileError` if it is none."""
    value = entry.get(key)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise FileError(f"{where}: its {key} is {value!r}; a number is wanted.")
    return float(value)


def _plain(number: float) -> float | int:
    """Return a number without digits that a sum left behind, whole ones as int."""
    rounded = round(number, _KEPT) + 0.0
    return int(rounded) if rounded == int(rounded) else rounded


# Kinds of files


def _parse_yaml(data: bytes, source: str) -> dict[Any, Any]:
    """Parse a YAML file."""
    return parse_yaml(data, source, "YAML file of offsets")


def _dump_yaml(table: dict[Any, Any]) -> bytes:
    """Write a YAML file, one joint a line."""
    text: str = yaml.safe_dump(
        table, default_flow_style=None, sort_keys=False, allow_unicode=True, width=math.inf
    )
    return text.encode()


def _parse_json(data: bytes, source: str) -> dict[Any, Any]:
    """Parse a JSON file."""
    try:
        table = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise FileError(f"{source}: this is not a JSON file: {error}.") from error
    return table if isinstance(table, dict) else {}


def _dump_json(table: dict[Any, Any]) -> bytes:
    """Write a JSON file as LeRobot does, indented by four spaces."""
    return (json.dumps(table, indent=4, ensure_ascii=False) + "\n").encode()


DYNAMIXEL_YAML = OffsetFile(
    what="file of offsets",
    endings=YAML,
    parse=_parse_yaml,
    dump=_dump_yaml,
    ratio_key="gear_ratio",
    inverted_key="",
    may_lack=True,
    comment="reading = (raw - offset) / gear_ratio",
    foreign_key="homing_offset",
)
"""Parameters of dynamixel_hardware by joint, for a xacro to load."""

TRANSMISSION_YAML = DYNAMIXEL_YAML._replace(
    ratio_key="", comment="reading = raw / reduction + offset"
)
"""Offsets of transmissions by joint, for a xacro to load."""

LEROBOT_JSON = OffsetFile(
    what="calibration file of LeRobot",
    endings=(".json",),
    parse=_parse_json,
    dump=_dump_json,
    ratio_key="",
    inverted_key="drive_mode",
    may_lack=False,
    is_whole=True,
)
"""LeRobot's calibration: ``id``, ``drive_mode``, ``homing_offset``, ``range_min``, ``range_max`` by joint."""
