"""A program as a table: joint values, poses of the tool, or both, and other columns that go along with them.

The table is read as a table of measurements is (`calib.measure.values`): units in the header, decimal commas between
semicolons, values in a wrong unit refused. What is different: poses may also be given by roll, pitch and yaw, nothing
may be missing, and columns that mean nothing here are kept.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.compensate.program import Program
from calib.compensate.program_columns import FORMS, GIVEN, ROLL_PITCH_YAW, ProgramColumns
from calib.errors import MeasurementError, choices
from calib.measure.columns import QUATERNION
from calib.measure.orientation import to_matrices, wrong_length
from calib.measure.table import Table
from calib.measure.values import Values
from calib.model.robot import Robot

Array = NDArray[np.float64]


def read_program(
    path: str | Path,
    robot: Robot,
    *,
    columns: Mapping[str, str] | None = None,
    given: str | None = None,
) -> Program:
    """Read a table of joint values, of poses, or of both; see docs/compensation.md.

    Args:
        path: CSV with the unit of each number in the header.
        robot: The robot whose joints the columns are of.
        columns: Names of the table to names of calib, see `Measurements.read`.
        given: One of `GIVEN`: which of the two is wanted where the table has both; None: the poses.

    Raises:
        MeasurementError: The table cannot be read; the text names file, row and column.
    """
    if given is not None and given not in GIVEN:
        message = f"A program cannot be given as '{given}'; it is one of {choices(GIVEN)}."
        raise MeasurementError(message)
    table = Table.read(path)
    found = ProgramColumns.of(table, robot, columns or {}, given)
    values = Values.read(table, found.layout())
    _check_positions(table, values)
    m = len(found.joints)
    poses = _poses(table, values, found) if found.points else None
    kept, labels = _words(table, found)
    return Program(
        labels=labels,
        q=values.joints[:, :m] if m else None,
        T_wanted=poses,
        oriented=bool(found.form) or not found.points,
        kept=kept,
        source=table.source,
        form=FORMS[found.form] if found.form else "",
    )


def _words(
    table: Table, found: ProgramColumns
) -> tuple[tuple[tuple[str, tuple[str, ...]], ...], tuple[str, ...]]:
    """The kept columns with their cells, and what messages call each row."""
    rows = list(table.rows())
    kept = tuple((label, tuple(row.cells[i] for row in rows)) for i, label in found.kept)
    own = [row.cells[found.row.index] for row in rows] if found.row is not None else []
    if not own or len(set(own)) < len(own) or "" in own:
        own = [str(row.ordinal) for row in rows]
    return kept, tuple(f"row {name}" for name in own)


def _check_positions(table: Table, values: Values) -> None:
    """Refuse rows without a position: a program wants one in each."""
    if values.unmeasured:
        row = next(row for row in table.rows() if row.ordinal == values.unmeasured[0])
        message = (
            f"{table.source}, line {row.line} (row {row.ordinal}): there is no position, all its cells are empty, "
            f"while other rows have one. Fill it in, or remove the row; {len(values.unmeasured)} of "
            f"{len(values.unmeasured) + len(values.rows)} rows are so."
        )
        raise MeasurementError(message)


def _poses(table: Table, values: Values, found: ProgramColumns) -> Array:
    """The poses of the rows, shape (N, 4, 4), [m]; without an orientation, unturned."""
    poses = np.tile(np.eye(4), (len(values.points), 1, 1))
    poses[:, :3, 3] = values.points
    turns = values.joints[:, len(found.joints) :]
    if found.form == ROLL_PITCH_YAW:
        poses[:, :3, :3] = Rotation.from_euler("xyz", turns).as_matrix()
    elif found.form == QUATERNION:
        _check_lengths(table, turns)
        poses[:, :3, :3] = to_matrices(turns)
    elif values.rotations is not None:
        poses[:, :3, :3] = values.rotations
    return poses


def _check_lengths(table: Table, quaternions: Array) -> None:
    """Refuse quaternions that have not length one."""
    wrong = wrong_length(quaternions)
    if wrong is None:
        return
    at, length = wrong
    row = list(table.rows())[at]
    message = (
        f"{table.source}, line {row.line} (row {row.ordinal}), columns qx, qy, qz, qw: the quaternion has the length "
        f"{length:.6g}; that of an orientation is 1. Correct it; some controllers write w first: then map the columns "
        "with --columns."
    )
    raise MeasurementError(message)
