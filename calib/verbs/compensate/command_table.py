"""The table of commands: a CSV file in degrees and millimetres, described in docs/compensation.md."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from calib.basics.arrays import Array
from calib.basics.files import csv_bytes, write_atomically
from calib.data.columns import POINT, STATUS
from calib.data.forms.orientations import ROTATION_VECTOR, Convention, find_convention
from calib.verbs.compensate.commands import Commands
from calib.verbs.compensate.program import CORRECTION, EXPECTED


class _Unit(NamedTuple):
    """Unit of a column."""

    #: Number of it in one SI unit
    scale: float
    #: Decimals: angles are exact to 1e-11 rad, lengths to 1e-9 m
    digits: int


_UNITS = {
    "deg": _Unit(math.degrees(1.0), 9),
    "rad": _Unit(1.0, 12),
    "mm": _Unit(1e3, 6),
    "": _Unit(1.0, 12),
}


class _Block(NamedTuple):
    """Columns of numbers."""

    names: Sequence[str]
    units: Sequence[str]
    #: (N, columns), SI units; NaN: an empty cell
    values: Array


def write_commands(
    commands: Commands,
    path: str | Path,
    *,
    send: Literal["both", "joints", "poses"] = "both",
    orientation: str | None = None,
    overwrite: bool = False,
) -> Path:
    """Write commands as a CSV table in deg and mm; docs/compensation.md describes it.

    First the columns of the program that went along, then joint values and poses to send, then by how much they were
    changed, then with a result the expected position error, then ``ok`` or the codes of warnings or of the reason why a
    row has no command and its cells are empty.

    Args:
        commands: The commands.
        path: The file.
        send: Which of the two forms are written.
        orientation: Convention of the orientations, one of `calib.data.forms.orientations.CONVENTIONS`; None: that of
            the program, or of one without orientations rotation vectors.
        overwrite: Whether an existing file is replaced.

    Returns:
        The file.

    Raises:
        FileError: The file exists and ``overwrite`` is False, or it cannot be written.
        MeasurementError: No such convention.
    """
    convention = find_convention(orientation or commands.program.form or ROTATION_VECTOR.name)
    columns: list[Sequence[str]] = [(label, *cells) for label, cells in commands.program.kept]
    for block in _blocks(commands, send, convention):
        columns += _columns(block)
    columns.append((STATUS, *_status(commands)))
    rows = zip(*columns, strict=True)
    return write_atomically(path, csv_bytes(rows), overwrite=overwrite)


def _blocks(commands: Commands, send: str, convention: Convention) -> Iterator[_Block]:
    """Yield the columns of numbers, in the order of the table."""
    robot = commands.nominal
    names = robot.joint_names
    joint_units = ["mm" if robot.joint_types[name] == "prismatic" else "deg" for name in names]
    if send != "poses":
        yield _Block(names, joint_units, commands.q)
    if send != "joints":
        yield _Block(POINT, ["mm"] * 3, commands.T_send[:, :3, 3])
        units = [convention.unit] * len(convention.columns)
        yield _Block(convention.columns, units, _orientations(commands, convention))
    if send != "poses":
        corrected = [CORRECTION + name for name in names]
        yield _Block(corrected, joint_units, commands.joint_corrections)
    of_pose = (CORRECTION + "position", CORRECTION + "angle")
    yield _Block(of_pose, ("mm", "deg"), commands.pose_corrections)
    if commands.expected is not None:
        yield _Block((EXPECTED,), ("mm",), commands.expected_errors[:, :1])


def _orientations(commands: Commands, convention: Convention) -> Array:
    """Return the numbers of the orientations to send, shape (N, columns); NaN for a row without a command."""
    numbers = np.full((len(commands), len(convention.columns)), np.nan)
    reached = commands.reached
    numbers[reached] = convention.numbers(commands.T_send[reached, :3, :3])
    return numbers


def _columns(block: _Block) -> Iterator[Sequence[str]]:
    """Yield each column of a block as its header and its cells."""
    for name, symbol, values in zip(block.names, block.units, block.values.T, strict=True):
        unit = _UNITS[symbol]
        header = f"{name} [{symbol}]" if symbol else name
        yield header, *(_cell(value, unit.digits) for value in (unit.scale * values).tolist())


def _cell(value: float, digits: int) -> str:
    """Return a number as text, without a minus before zero; empty for NaN."""
    if math.isnan(value):
        return ""
    return f"{round(value, digits) + 0.0:.{digits}f}"


def _status(commands: Commands) -> Iterator[str]:
    """Yield the status of each row: ``ok``, its warnings, or why it has no command."""
    for reason, warnings in zip(commands.reasons, commands.warnings, strict=True):
        codes = "; ".join(dict.fromkeys(warning.code for warning in warnings))
        if reason:
            yield f"no command: {reason.code}"
        else:
            yield f"warning: {codes}" if codes else "ok"
