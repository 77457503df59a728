"""Joint columns in the numbers of servos: ticks of encoders, and the degrees and percents that LeRobot makes of them.

A servo of N ticks a turn has the angle (ticks - zero) 360 deg / N. LeRobot's calibration file has for each motor the
first and the last tick of its range, and the middle between them is its zero. Its numbers are

    degrees  = (ticks - zero) 360 / (N - 1)
    percents = (ticks - first) 200 / (last - first) - 100,   clipped to -100 ... 100,

so that its degree is (N - 1) / N of a degree. Positions are those that the servo reports, after its homing offset.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from calib.basics.arrays import Array
from calib.basics.files import read_bytes
from calib.basics.json_files import parse_json
from calib.basics.tables import Column, Table
from calib.basics.units import split_header
from calib.basics.values import ReadOnlyMapping
from calib.data.forms.column_options import (
    BRANDS,
    LEROBOT,
    PERCENT,
    TICKS,
    ColumnOptions,
    ColumnsInput,
    column_options,
)
from calib.errors import FileError, MeasurementError, choices

#: Ticks in a turn of the servos of LeRobot's SO-100 and SO-101 (Feetech STS3215), and of most Dynamixels.
_TICKS = 4096

#: The column of a table made of a LeRobot data set that has all motors in one cell.
STATE = "observation.state"

#: Ends the names of LeRobot's columns.
_ENDING = ".pos"

#: ``4096@2048``, ``1024@my_arm.json``.
_STATED = re.compile(r"(?P<ticks>[0-9]{1,9})@(?P<zero>.+)")

#: A percent this near to the end of the range may have been clipped.
_CLIPPED = 100.0 - 1e-9

#: Keys of a motor in LeRobot's file that are used here, all of them whole numbers.
_KEYS = ("drive_mode", "range_min", "range_max")


class MotorRange(NamedTuple):
    """A motor in LeRobot's calibration file."""

    #: First and last tick of its range.
    first: int
    last: int
    #: Whether percents count backwards, with servos of Feetech; 0 if not.
    drive_mode: int


@dataclass(frozen=True, slots=True)
class Motors:
    """The meaning of the numbers of servos: ticks in a turn, the zero, and the ranges of the motors."""

    #: Number of ticks in a turn.
    ticks: int = _TICKS
    #: The tick of every joint's zero; None: the middle of its range.
    zero: float | None = None
    #: Ranges by the motors' names.
    ranges: Mapping[str, MotorRange] = field(default_factory=dict)
    #: The file that has them, or what was typed, for messages.
    source: str = "--motors"

    def __post_init__(self) -> None:
        """Keep a read-only copy of the ranges."""
        object.__setattr__(self, "ranges", ReadOnlyMapping(self.ranges))

    @classmethod
    def parse(cls, text: str | os.PathLike[str]) -> Motors:
        """Return what ``--motors`` says.

        Args:
            text: LeRobot's calibration file; ``"4096@2048"``: ticks in a turn, and the tick of the joints' zero; or
                ``"1024@FILE"``.

        Raises:
            FileError: The file cannot be read, or is not of LeRobot.
            MeasurementError: A turn has fewer than 2 ticks.
        """
        match = _STATED.fullmatch(str(text))
        if match is None:
            return cls.read(text)
        ticks, zero = int(match["ticks"]), match["zero"]
        if ticks < 2:
            raise MeasurementError(f"--motors {text}: a turn has at least 2 ticks, such as 4096.")
        if re.fullmatch(r"[+-]?[0-9]+(\.[0-9]+)?", zero):
            return cls(ticks, float(zero), {}, str(text))
        return cls.read(zero, ticks)

    @classmethod
    def read(cls, path: str | os.PathLike[str], ticks: int = _TICKS) -> Motors:
        """Read LeRobot's calibration file.

        Args:
            path: The file: ``id``, ``drive_mode``, ``homing_offset``, ``range_min`` and ``range_max`` by motor.
            ticks: Number of ticks in a turn, which the file does not say.

        Raises:
            FileError: It cannot be read, or lacks these numbers.
        """
        table = parse_json(read_bytes(path, "calibration file of LeRobot"), str(path))
        ranges = {}
        for name, motor in table.items() if isinstance(table, dict) else ():
            stated = motor if isinstance(motor, dict) else {}
            numbers = [stated[key] for key in _KEYS if type(stated.get(key)) is int]
            if len(numbers) != len(_KEYS):
                raise FileError(
                    f"{path}: '{name}' does not have whole numbers {choices(_KEYS)}, as a motor of LeRobot's "
                    "calibration file has (~/.cache/huggingface/lerobot/calibration)."
                )
            drive_mode, first, last = numbers
            if not first < last:
                raise FileError(
                    f"{path}: range_min of '{name}' is {first}, and range_max {last}; it must be greater. Record the "
                    "range of motion again."
                )
            ranges[str(name)] = MotorRange(first, last, drive_mode)
        if not ranges:
            raise FileError(
                f"{path}: it has no motors. LeRobot's calibration file has {choices(_KEYS)} of each, by its name."
            )
        return cls(ticks, None, ranges, str(path))

    def degrees(self, name: str, symbol: str, numbers: Array) -> Array:
        """Return the angles of a motor.

        Args:
            name: The motor's name.
            symbol: What the numbers are: ``"deg"``, LeRobot's degrees, `PERCENT` or `TICKS`.
            numbers: The numbers, shape (N,).

        Returns:
            Angles from the zero, shape (N,) [deg].

        Raises:
            MeasurementError: The range of the motor is needed, and not known; or its percents may count backwards.
        """
        if symbol == "deg":
            return numbers * (self.ticks - 1) / self.ticks
        motor = self.ranges.get(name)
        if motor is None and (symbol == PERCENT or self.zero is None):
            raise MeasurementError(
                f"The column of '{name}' is in {_WORDS[symbol]}, and {self.source} does not say what they mean. Give "
                f"LeRobot's calibration file as --motors FILE, with the motor '{name}'"
                f"{_OR_TICKS if symbol == TICKS else ''}."
            )
        if symbol == PERCENT:
            assert motor is not None
            if motor.drive_mode:
                raise MeasurementError(
                    f"{self.source}: the drive_mode of '{name}' is {motor.drive_mode}. Percents of Feetech's servos "
                    "then count backwards, and those of Dynamixel's do not; record in degrees (use_degrees) or in "
                    "ticks, which do not depend on it."
                )
            return numbers * (motor.last - motor.first) / 200.0 * 360.0 / self.ticks
        zero = self.zero if motor is None else (motor.first + motor.last) / 2.0
        assert zero is not None
        return (numbers - zero) * 360.0 / self.ticks


#: What symbols of units mean, for messages.
_WORDS = MappingProxyType({PERCENT: "percent of the motor's range", TICKS: "ticks"})

_OR_TICKS = ", or the ticks in a turn and the tick of the joints' zero, such as --motors 4096@2048"


def with_servo_angles(table: Table, columns: ColumnsInput = None) -> tuple[Table, ColumnOptions]:
    """Return a table with angles in place of the numbers of servos.

    Args:
        table: The table.
        columns: What is said of the columns; without motors and without the brand of LeRobot nothing changes.

    Returns:
        The table, and what is said of its columns.

    Raises:
        MeasurementError: A column does not say what its numbers are, or what they mean is not known; a number is at the
            end of a range, where LeRobot clips.
        FileError: LeRobot's calibration file cannot be read.
    """
    options = column_options(columns)
    is_lerobot = options.brand == LEROBOT
    if options.motors is None and not is_lerobot:
        return table, options
    motors = Motors(source="the table") if options.motors is None else Motors.parse(options.motors)
    if is_lerobot:
        table = _with_state_apart(table)
    header = list(table.header)
    cells = [list(row) for row in table.cells]
    for index, label in enumerate(table.header):
        written, symbol = split_header(label)
        name = written.removesuffix(_ENDING)
        is_of_lerobot = is_lerobot and written != name
        is_motor = is_of_lerobot or name in motors.ranges
        column = Column(index, label, written, symbol or (options.joint_unit if is_motor else None))
        is_degrees = is_of_lerobot and column.unit is not None and column.unit.symbol == "deg"
        scale = "deg" if is_degrees else column.symbol
        if is_of_lerobot and scale is None and name != _GRIPPER:
            raise MeasurementError(
                f"{table.source}, column '{label}': LeRobot writes degrees (use_degrees=True) or percents from -100 to "
                "100, and the table does not say which. Give --joint-unit deg; or --joint-unit % and its calibration "
                "file as --motors FILE."
            )
        if name == _GRIPPER and is_of_lerobot:
            continue  # from 0 to 100, and no joint of the arm
        if scale not in (PERCENT, TICKS) and not is_degrees:
            continue
        numbers = table.numbers([column])[:, 0]
        if scale == PERCENT:
            _check_percents(table, column, numbers)
        angles = motors.degrees(name, scale or "", numbers)
        header[index] = f"{written} [deg]"
        for row, number, angle in zip(cells, numbers, angles, strict=True):
            if np.isfinite(number):  # not an empty cell, nor a fault, which the reader names
                decimal = "," if "," in row[index] else "."
                row[index] = repr(float(angle)).replace(".", decimal)
    renamed = dict(zip(table.header, header, strict=True))
    names = {renamed.get(key.strip(), key): name for key, name in options.names.items()}
    unit = None if options.joint_unit in (PERCENT, TICKS) else options.joint_unit
    made = replace(table, header=tuple(header), cells=tuple(cells))
    return made, replace(options, names=names, joint_unit=unit, motors=None)


#: LeRobot's name of the motor that is no joint of the arm.
_GRIPPER = "gripper"


def _check_percents(table: Table, column: Column, numbers: Array) -> None:
    """Refuse the end of a motor's range, where LeRobot clips what the servo reported, and numbers beyond it."""
    beyond = np.flatnonzero(np.isfinite(numbers) & (np.abs(numbers) >= _CLIPPED))
    if len(beyond):
        row = int(beyond[0])
        text = table.cells[row][column.index]
        table.fail(
            row,
            column,
            f"'{text}' is at the end of the motor's range, or beyond it, where LeRobot clips its numbers. Leave the "
            "row out, or record in degrees (use_degrees), which are not clipped.",
        )


def _with_state_apart(table: Table) -> Table:
    """Return a table whose column ``observation.state`` has become one column for each of LeRobot's motors."""
    labels = [split_header(label)[0] for label in table.header]
    if STATE not in labels:
        return table
    index = labels.index(STATE)
    symbol = split_header(table.header[index])[1]
    names = (*BRANDS[LEROBOT].axes[0], f"{_GRIPPER}{_ENDING}")
    heads = tuple(name if symbol is None else f"{name} [{symbol}]" for name in names)
    cells = []
    for n, row in enumerate(table.cells):
        words = row[index].strip("[]() ").replace(",", " ").split()
        if row[index] and len(words) != len(names):
            table.fail(
                n,
                Column(index, table.header[index], STATE, symbol),
                f"'{row[index]}' is not a list of {len(names)} numbers, of {choices(names)}.",
            )
        values = words or [""] * len(names)
        cells.append([*row[:index], *values, *row[index + 1 :]])
    header = (*table.header[:index], *heads, *table.header[index + 1 :])
    return replace(table, header=header, cells=tuple(cells))
