"""Joint zeros as controllers take them: a table to type in, or a file with an offset for each joint.

A table is CSV in deg and mm, or JSON in rad and m; docs/zeros.md describes the files. A file of offsets has the changes
alone, or it is the robot's own file with new offsets; an entry stands under the name of its joint, at any depth:
``shoulder_pan: {id: 1, homing_offset: -310}``.
"""

from __future__ import annotations

import copy
import csv
import io
import json
import math
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from calib.basics.files import read_bytes, write_atomically
from calib.basics.json_files import json_bytes
from calib.errors import FileError, choices
from calib.result.joint_zeros import ESTIMATION
from calib.robot.robot import Robot
from calib.verbs.convert.format import YAML, Format, Note, Notes, Options, Source, parse_yaml
from calib.verbs.convert.rounded_zeros import (
    DEGREE,
    METRE,
    MILLIMETRE,
    RADIAN,
    TICK,
    RmsErrors,
    RoundedZeros,
    StoredNumber,
    check_improvement,
    zeros_text,
)

TABLE_ENDINGS = (".csv", ".json")
"""Endings of tables of zeros."""

#: Headings of the CSV.
_HEADS = ("joint", "change", "unit", "std", "determined")

#: Digits of a standard deviation.
_STD_DIGITS = 2

#: Decimals that an offset keeps [rad, m]: finer than any encoder, coarser than the rounding of a sum.
_KEPT = 9

#: Largest homing offset of a Feetech servo, which stores 11 bits and a sign [ticks].
_FEETECH_LIMIT = 2047

#: Largest homing offset of a Dynamixel servo [ticks].
_DYNAMIXEL_LIMIT = 1_044_479


# Tables


def table_bytes(robot: Robot, rounded: RoundedZeros, rms_errors: RmsErrors, ending: str) -> bytes:
    """Return a table of joint zeros as the bytes of a CSV or JSON file.

    Args:
        robot: The robot, which the file names.
        rounded: Its zeros, rounded.
        rms_errors: The errors with them and without.
        ending: One of `TABLE_ENDINGS`.

    Returns:
        The file.

    Raises:
        FileError: It does not read back, because it cannot hold a joint's name.
    """
    write = _csv if ending == ".csv" else _json
    data = write(robot, rounded, rms_errors)
    if read_table(data, ending) != rounded.by_joint():
        raise FileError(
            f"The zeros of '{robot.name}' do not read back; rename its joints in the URDF."
        )
    return data


def read_table(data: bytes, ending: str) -> dict[str, float]:
    """Read the zeros of a table that calib wrote.

    Args:
        data: The file.
        ending: One of `TABLE_ENDINGS`.

    Returns:
        The change of the reading by joint [deg] or [mm], for the joints whose zero is determined.
    """
    if ending == ".json":
        joints = json.loads(data)["joints"]
        return {row["joint"]: row["change"] for row in joints if row["determined"]}
    lines = data.decode().splitlines()
    rows = csv.DictReader(line for line in lines if not line.startswith("# "))
    return {row["joint"]: float(row["change"]) for row in rows if row["determined"] == "yes"}


def _csv(robot: Robot, rounded: RoundedZeros, rms_errors: RmsErrors) -> bytes:
    """Return the zeros as CSV in deg and mm: comments on how the numbers are meant, then a line for each joint."""
    comments = [
        f"Joint zeros of {robot.name}, {robot.base} to {robot.tip}, by calib: the best ones where nothing else of the "
        "robot is corrected",
        "While the robot stands still, the reading of each joint must go up by 'change': add it to the angle or "
        "position of the mastering",
        "'determined' no: the measurements do not determine this zero; leave it as it is",
    ]
    comments += [
        f"rms error of {rms_errors.rows} rows [{symbol}]: nominal robot {rms_errors.nominal[symbol]:.6g}, zeros "
        f"{rms_errors.zeros[symbol]:.6g}, zeros rounded {rms_errors.rounded[symbol]:.6g}, whole calibration "
        f"{rms_errors.calibrated[symbol]:.6g}"
        for symbol in rms_errors.zeros
    ]
    text = io.StringIO(newline="")
    text.writelines(f"# {' '.join(line.split())}\n" for line in comments)
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_HEADS)
    zeros = rounded.zeros
    for k, (name, unit) in enumerate(zip(zeros.joints, rounded.units, strict=True)):
        if not zeros.determined[k]:
            writer.writerow([name, "", unit.name, "", "no"])
            continue
        change = f"{rounded.numbers[k]:+.{unit.decimals}f}"
        std = f"{zeros.std[k] / unit.to_si:.{_STD_DIGITS}g}"
        writer.writerow([name, change, unit.name, std, "yes"])
    return text.getvalue().encode()


def _json(robot: Robot, rounded: RoundedZeros, rms_errors: RmsErrors) -> bytes:
    """Return the zeros as JSON, as stored and unrounded in rad and m, with the rms errors of each robot."""
    zeros = rounded.zeros
    joints = []
    for k, (name, unit) in enumerate(zip(zeros.joints, rounded.units, strict=True)):
        si = "m" if rounded.prismatic[k] else "rad"
        determined = bool(zeros.determined[k])
        joints.append(
            {
                "joint": name,
                "determined": determined,
                "change": float(rounded.numbers[k]) if determined else None,
                "unit": unit.name,
                f"delta_{si}": float(zeros.delta[k]) if determined else None,
                f"std_{si}": float(zeros.std[k]),
            }
        )
    content: dict[str, Any] = {
        "schema": "zeros 1",
        "robot": {"name": robot.name, "base": robot.base, "tip": robot.tip},
        "joints": joints,
        "rows": rms_errors.rows,
        "rms": {
            "nominal": rms_errors.nominal,
            "zeros": rms_errors.zeros,
            "rounded": rms_errors.rounded,
            "calibrated": rms_errors.calibrated,
        },
    }
    return json_bytes(content)


# Files of offsets


class OffsetFile(NamedTuple):
    """A kind of file with offsets."""

    #: Its name, for messages
    what: str
    #: Endings of its files, which are YAML or JSON
    endings: tuple[str, ...]
    #: Number, sign and unit in which it stores the zero of a joint
    stored: StoredNumber
    #: Key of the gear ratio in an entry, by which an offset of the motor is larger than one of the joint; empty: the
    #: offset is one of the joint
    ratio_key: str = ""
    #: Key of the direction in an entry, 0 for a servo that turns with its joint; empty: there is none
    inverted_key: str = ""
    #: Equation of a reading by the offset, written as a comment; empty: such files have no comments
    comment: str = ""
    #: Key that shows that an entry belongs to another kind of file; empty: none is known
    foreign_key: str = ""

    @property
    def is_json(self) -> bool:
        """True if its files are JSON, False if they are YAML."""
        return ".json" in self.endings

    def parse(self, data: bytes, source: str) -> dict[Any, Any]:
        """Return the outermost table of a file, named ``source`` in messages; `FileError` if it is damaged."""
        if not self.is_json:
            return parse_yaml(data, source, "YAML file of offsets")
        try:
            table = json.loads(data)
        except (ValueError, RecursionError) as error:
            raise FileError(f"{source}: this is not a JSON file: {error}.") from error
        return table if isinstance(table, dict) else {}

    def dump(self, table: dict[Any, Any]) -> bytes:
        """Return a file with a table: YAML with one joint a line, or JSON as LeRobot writes it."""
        if self.is_json:
            return (json.dumps(table, indent=4, ensure_ascii=False) + "\n").encode()
        text: str = yaml.safe_dump(
            table, default_flow_style=None, sort_keys=False, allow_unicode=True, width=math.inf
        )
        return text.encode()


def offsets_bytes(file: OffsetFile, rounded: RoundedZeros, update: str | Path | None) -> bytes:
    """Return the bytes of a file in which a controller keeps the offsets of its joints, with joint zeros added.

    Args:
        file: The kind of file.
        rounded: The zeros, rounded to what the controller stores.
        update: The robot's own file, a copy of which gets the new offsets; None: the file has the changes alone, under
            the key with the suffix ``_change``.

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
        table = copy.deepcopy(file.parse(read_bytes(update, file.what), str(update)))
        _add_changes(file, rounded, table, f"{update}")
    comment = f"# {key} of each joint [rad, m] by calib: {file.comment}\n" if file.comment else ""
    data = comment.encode() + file.dump(table)
    if file.parse(data, "the file to write") != table:
        raise FileError(f"This {file.what} does not read back; rename the joints in the URDF.")
    return data


def _add_changes(
    file: OffsetFile, rounded: RoundedZeros, table: dict[Any, Any], source: str
) -> None:
    """Add the changes, times any gear ratio, to the offsets in the table of a robot's own file, in place.

    The file is named ``source`` in messages. A joint without an entry, entries in several places, or an offset beyond
    its limit raises `FileError`.
    """
    changes, key, largest = rounded.by_joint(), rounded.stored.key, rounded.stored.largest
    places = list(_places(table, changes))
    if len(places) > 1:
        raise FileError(
            f"{source}: this {file.what} has entries of these joints in {len(places)} places, as of two arms. Give a "
            "copy with those of the calibrated arm alone."
        )
    entries = places[0] if places else {}
    missing = [name for name in changes if name not in entries]
    if missing:
        raise FileError(
            f"{source}: this {file.what} has no entry of the joint {choices(missing)}; it has "
            f"{choices(entries or table)}. Entries have the names of the URDF's joints: rename them in a copy of the "
            "file, or leave out --update, and the file has the changes alone."
        )
    for name, change in changes.items():
        entry = entries[name]
        where = f"{source}: {name}"
        new = _old_offset(file, entry, key, where) + _ratio(file, entry, where) * change
        if abs(new) > largest:
            raise FileError(
                f"{where}: its {key} would be {new:g}, beyond {largest:g}, which the servo cannot store. Move the "
                "servo's horn by a tooth towards the zero, or set the middle of the joint again, and measure again."
            )
        entry[key] = _plain(new)


def _places(table: object, names: Mapping[str, float]) -> Iterator[dict[str, Any]]:
    """Yield the entries of each table, at any depth, that has an entry of one of these joints, which is a table too."""
    if not isinstance(table, dict):
        return
    if any(isinstance(table.get(name), dict) for name in names):
        yield {name: entry for name, entry in table.items() if isinstance(entry, dict)}
        return
    for value in table.values():
        yield from _places(value, names)


def _old_offset(file: OffsetFile, entry: Mapping[str, Any], key: str, where: str) -> float:
    """Return the offset of an entry, in a YAML file 0 if it has none; `FileError` for what is not such a number."""
    if file.foreign_key in entry:
        raise FileError(
            f"{where}: it has a '{file.foreign_key}', so this is not a {file.what}. Choose the format of this file "
            "with --to."
        )
    if key not in entry and not file.is_json:
        return 0.0
    offset = _number(entry, key, where)
    is_whole = file.stored.angle.decimals == 0
    if is_whole and offset != int(offset):
        raise FileError(f"{where}: its {key} is {offset:g}; a servo stores whole ticks.")
    return offset


def _ratio(file: OffsetFile, entry: Mapping[str, Any], where: str) -> float:
    """Return the ratio of the change of an offset to that of the joint, 1 if the entry has none.

    It raises `FileError` if the ratio, or its sign, is not known.
    """
    if entry.get(file.inverted_key, 0) != 0:
        raise FileError(
            f"{where}: its {file.inverted_key} is {entry[file.inverted_key]}: whether the joint's reading grows with "
            "the ticks or falls is not known. Leave out --update, and change this offset by hand, with the other sign "
            "if the reading falls."
        )
    if file.ratio_key not in entry:
        return 1.0
    ratio = _number(entry, file.ratio_key, where)
    if ratio == 0.0:
        raise FileError(
            f"{where}: its {file.ratio_key} is 0; it is 1 for a motor that turns with its joint."
        )
    return ratio


def _number(entry: Mapping[str, Any], key: str, where: str) -> float:
    """Return a number of an entry; `FileError` if it is not a finite one."""
    value = entry.get(key)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise FileError(f"{where}: its {key} is {value!r}; it must be a number.")
    return float(value)


def _plain(number: float) -> float | int:
    """Return a number [rad, m or ticks] without the rounding errors of a sum, whole ones as int."""
    rounded = round(number, _KEPT) + 0.0
    return int(rounded) if rounded == int(rounded) else rounded


# The formats


#: Added to the readings, as one types it into a mastering.
TABLE = StoredNumber("change", 1, DEGREE, MILLIMETRE)

#: Parameters of dynamixel_hardware by joint, for a xacro to load.
DYNAMIXEL_YAML = OffsetFile(
    "file of offsets",
    YAML,
    StoredNumber("offset", -1, RADIAN, METRE),
    ratio_key="gear_ratio",
    comment="reading = (raw - offset) / gear_ratio",
    foreign_key="homing_offset",
)

#: Offsets of transmissions by joint, for a xacro to load.
TRANSMISSION_YAML = OffsetFile(
    "file of offsets",
    YAML,
    StoredNumber("offset", 1, RADIAN, METRE),
    comment="reading = raw / reduction + offset",
    foreign_key="homing_offset",
)

#: LeRobot's calibration of Feetech servos: ``id``, ``drive_mode``, ``homing_offset``, ``range_min``, ``range_max`` by
#: joint; present position = actual position - homing offset.
LEROBOT_JSON = OffsetFile(
    "calibration file of LeRobot",
    (".json",),
    StoredNumber("homing_offset", -1, TICK, None, _FEETECH_LIMIT),
    inverted_key="drive_mode",
)

#: The same for Dynamixel servos: present position = actual position + homing offset.
LEROBOT_DYNAMIXEL_JSON = LEROBOT_JSON._replace(
    stored=StoredNumber("homing_offset", 1, TICK, None, _DYNAMIXEL_LIMIT)
)


def _write(file: OffsetFile | None, source: Source, path: Path, options: Options) -> Notes:
    """Write the joint zeros of a result into a file with offsets, or into a table if ``file`` is None.

    It raises `FileError` for another ending, and `VerdictError` for zeros that are no better than none.
    """
    endings = TABLE_ENDINGS if file is None else file.endings
    if path.suffix.lower() not in endings:
        raise FileError(f"{path}: this format is written as {choices(endings)}; end the name so.")
    stored = TABLE if file is None else file.stored
    rounded = RoundedZeros.of(source, stored.with_ticks(options.ticks))
    rms_errors = RmsErrors.of(source.require_calibration(), rounded)
    check_improvement(rms_errors, path, accept=options.accept)
    if file is None:
        data = table_bytes(source.robot, rounded, rms_errors, path.suffix.lower())
    else:
        data = offsets_bytes(file, rounded, options.update)
    write_atomically(path, data, overwrite=options.overwrite)
    return tuple(_notes(file, rounded, rms_errors, options))


def _notes(
    file: OffsetFile | None, rounded: RoundedZeros, rms_errors: RmsErrors, options: Options
) -> Iterator[Note]:
    """Yield notes on zeros that are not determined or not proven, and on what a file with offsets has and has not."""
    if rounded.undetermined:
        yield Note(
            "zeros not determined",
            "The measurements do not determine the zero of {0}, or it was frozen: leave it as it is. An unknown frame "
            "turns with the first joint, and a target whose place is not given with the last.",
            (choices(rounded.undetermined),),
        )
    if rms_errors.is_no_better:
        yield Note(
            "zeros no better",
            "Joint zeros alone are no better than the nominal robot on these {0} rows. They were accepted.",
            (rms_errors.rows,),
        )
    elif rms_errors.rows == ESTIMATION:
        yield Note(
            "zeros not validated",
            "These errors are of the fitted rows, and prove nothing: calibrate without --no-validate, or with "
            "validation rows.",
        )
    if file is None:
        return

    if options.update is None:
        yield Note(
            "changes alone",
            "The file has the changes alone, to be added to the numbers of the robot's own file; with --update FILE it "
            "is a copy of that file with the sums.",
        )
    elif file.comment:
        sentence = "The comments of {0} are not in the new file."
        yield Note("comments not kept", sentence, (str(options.update),))
    if options.update is not None and file.ratio_key:
        sentence = (
            "The numbers above are of the joints; in the file they are times the {0} of each entry."
        )
        yield Note("times gear ratio", sentence, (file.ratio_key,))
    if file.is_json:
        yield Note(
            "end positions move",
            "range_min and range_max stay as they are, so that each joint's end positions move with its zero: check "
            "them. The readings must grow with the servo's ticks; if they fall, change the sign.",
        )


def _format(what: str, file: OffsetFile | None) -> Format:
    """Return the registry row of a kind of file with offsets, or of the table of zeros if ``file`` is None."""
    return Format(
        what,
        TABLE_ENDINGS if file is None else file.endings,
        partial(_write, file),
        updates=file is not None,
        has_chain=False,
        describe=partial(zeros_text, TABLE if file is None else file.stored),
    )


FORMATS = {
    "zeros": _format("joint zeros to type in", None),
    "dynamixel-hardware": _format(
        "joint zeros as offsets of ROS' dynamixel_hardware", DYNAMIXEL_YAML
    ),
    "ros2-transmission": _format(
        "joint zeros as offsets of ros2_control's transmissions", TRANSMISSION_YAML
    ),
    "lerobot": _format(
        "joint zeros as homing_offset of LeRobot's Feetech servos (SO-100, SO-101)", LEROBOT_JSON
    ),
    "lerobot-dynamixel": _format(
        "joint zeros as homing_offset of LeRobot's Dynamixel servos", LEROBOT_DYNAMIXEL_JSON
    ),
}
