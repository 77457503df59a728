"""Commands as a table, for a robot's program: what to send, what was changed, and which rows have no command."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.compensate.commands import Commands
from calib.compensate.program_columns import CORRECTION, ROLL_PITCH_YAW, STATUS
from calib.errors import ModelError, choices
from calib.measure.columns import POINT, QUATERNION, ROTATION_VECTOR
from calib.measure.orientation import to_quaternions
from calib.model.files import write_atomically

Array = NDArray[np.float64]

#: What may be written of a command, and how an orientation may be.
SEND = ("both", "joints", "poses")
ORIENTATIONS = ("rotation-vector", "quaternion", "rpy")

#: The units of a table: of angles, of lengths. A rotation vector is in radians in both.
UNITS = ("deg mm", "rad m")

#: Decimals: angles are exact to 1e-11 rad, lengths to 1e-9 m, on any arm far below what a controller resolves.
_DEG, _RAD, _MM, _M, _NO_UNIT = 9, 12, 6, 9, 12

#: What the column `STATUS` says of a row without anything to say, and before what there is to say.
OK, WARNING, NO_COMMAND = "ok", "warning: ", "no command: "


def write_commands(
    commands: Commands,
    path: str | Path,
    *,
    send: str = "both",
    orientation: str = "rotation-vector",
    units: str = UNITS[0],
    overwrite: bool = False,
) -> Path:
    """Write commands as a CSV table; docs/compensation.md describes it.

    First the columns of the program that went along, then joint values and poses to send, then by how much they were
    changed, then whether the row has a command. A row without one has empty cells there.

    Args:
        commands: The commands.
        path: A CSV file.
        send: One of `SEND`: joint values, poses for a controller with the nominal model, or both.
        orientation: One of `ORIENTATIONS`, of the poses.
        units: One of `UNITS`.
        overwrite: Whether a file that exists is replaced.

    Raises:
        ModelError: No such way to send, no such form of an orientation, or no such units.
        FileError: The file exists and ``overwrite`` is False, or it cannot be written.
    """
    for what, given, known in (
        ("send", send, SEND),
        ("orientation", orientation, ORIENTATIONS),
        ("units", units, UNITS),
    ):
        if given not in known:
            raise ModelError(
                f"Commands cannot be written with {what} '{given}'; choose one of {choices(known)}."
            )
    blocks = list(_blocks(commands, send, orientation, *_UNITS[units]))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    kept = commands.program.kept
    header = [label for label, _ in kept]
    writer.writerow([*header, *(name for names, _, _ in blocks for name in names), STATUS])
    numbers = [_cells(values, digits) for _, values, digits in blocks]
    reached = commands.reached
    for i in range(len(commands)):
        cells = [
            cell for block in numbers for cell in (block[i] if reached[i] else [""] * len(block[i]))
        ]
        words = [column[i] for _, column in kept]
        writer.writerow([*words, *cells, status(commands.reasons[i], commands.warnings[i])])
    return write_atomically(path, text.getvalue().encode(), overwrite=overwrite)


def status(reason: str, warnings: tuple[str, ...]) -> str:
    """What the last column says of a row.

    Example:
        >>> status("", ("near a singularity",))
        'warning: near a singularity'
    """
    if reason:
        return NO_COMMAND + reason
    return WARNING + "; ".join(warnings) if warnings else OK


@dataclass(frozen=True, slots=True)
class _Unit:
    """One unit of a table: its symbol, how many of it are one metre or radian, and its decimals."""

    symbol: str
    scale: float
    digits: int


_UNITS = {
    UNITS[0]: (_Unit("deg", math.degrees(1.0), _DEG), _Unit("mm", 1e3, _MM)),
    UNITS[1]: (_Unit("rad", 1.0, _RAD), _Unit("m", 1.0, _M)),
}


def _blocks(
    commands: Commands, send: str, orientation: str, angle: _Unit, length: _Unit
) -> Iterator[tuple[list[str], Array, list[int]]]:
    """The columns of numbers: their headers, their values, shape (N, k), and their decimals."""
    robot = commands.nominal
    units = [
        length if robot.joint_types[name] == "prismatic" else angle for name in robot.joint_names
    ]
    scale = np.array([unit.scale for unit in units])
    joints = [
        f"{name} [{unit.symbol}]" for name, unit in zip(robot.joint_names, units, strict=True)
    ]
    digits = [unit.digits for unit in units]
    if send != "poses":
        yield joints, commands.q * scale, digits
    if send != "joints":
        places = commands.T_send[:, :3, 3] * length.scale
        yield [f"{axis} [{length.symbol}]" for axis in POINT], places, [length.digits] * 3
        yield _orientation(commands.T_send[:, :3, :3], orientation, angle)
    if send != "poses":
        yield [CORRECTION + name for name in joints], commands.joint_corrections * scale, digits
    yield (
        [f"{CORRECTION}position [{length.symbol}]", f"{CORRECTION}angle [{angle.symbol}]"],
        commands.pose_corrections * [length.scale, angle.scale],
        [length.digits, angle.digits],
    )


def _orientation(R: Array, form: str, angle: _Unit) -> tuple[list[str], Array, list[int]]:
    """Rotation matrices, shape (N, 3, 3), in one of `ORIENTATIONS`; NaN stays NaN."""
    if form == "quaternion":
        return list(QUATERNION), to_quaternions(R), [_NO_UNIT] * 4
    there = np.isfinite(R).all(axis=(1, 2))
    values = np.full((len(R), 3), np.nan)
    if form == "rpy":
        if there.any():
            values[there] = [pin.rpy.matrixToRpy(matrix) for matrix in R[there]]
        names = [f"{name} [{angle.symbol}]" for name in ROLL_PITCH_YAW]
        return names, values * angle.scale, [angle.digits] * 3
    if there.any():
        values[there] = Rotation.from_matrix(R[there]).as_rotvec()
    return [f"{name} [rad]" for name in ROTATION_VECTOR], values, [_RAD] * 3


def _cells(values: Array, digits: list[int]) -> list[list[str]]:
    """Numbers as text, each column with its decimals; empty for NaN, and none is minus zero."""
    return [
        [_number(value, n) for value, n in zip(row, digits, strict=True)] for row in values.tolist()
    ]


def _number(value: float, digits: int) -> str:
    """One number as text."""
    if not math.isfinite(value):
        return ""
    text = f"{value:.{digits}f}"
    return text.removeprefix("-") if float(text) == 0.0 else text
