"""Program: what a robot is to do, row by row: joint values made for the nominal robot, or poses of its tool.

As a file it is read as a table of measurements is (`calib.measure.values`): units in the header, decimal commas between
semicolons, values in a wrong unit refused. What is different: poses may also be given by roll, pitch and yaw, nothing
may be missing, and columns that mean nothing here are kept.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from calib.compensate.program_columns import FORMS, GIVEN, ROLL_PITCH_YAW, ProgramColumns
from calib.errors import MeasurementError, ModelError, choices
from calib.measure.columns import QUATERNION
from calib.measure.orientation import to_matrices, wrong_length
from calib.measure.table import Table
from calib.measure.values import Values
from calib.model.robot import Robot, read_only

Array = NDArray[np.float64]

#: A rotation matrix may differ from one by this: poses come from files with rounded numbers.
_NO_ROTATION = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Program:
    """N rows that a robot is to run through.

    Attributes:
        labels: What messages call each row, such as ``"row 3"``.
        q: shape (N, m), joint values in the order of ``Robot.joint_names`` [rad] or [m]; None where only poses are
            known. With ``T_wanted`` they are where to start looking for joint values.
        T_wanted: shape (N, 4, 4), poses of the tool that are wanted [m]; None where they are those that the nominal
            robot reaches at ``q``.
        oriented: Whether ``T_wanted`` says the orientation too, or the position alone.
        kept: Other columns of the table, header and cells, that go into the commands unchanged.
        source: Name of the file, for messages; empty if there is none.
        form: How the file's orientations were read, in words; empty if there are none.

    Raises:
        ModelError: Neither joint values nor poses, no rows, other shapes, or a number that is not finite.
    """

    labels: tuple[str, ...]
    q: Array | None = None
    T_wanted: Array | None = None
    oriented: bool = True
    kept: tuple[tuple[str, tuple[str, ...]], ...] = ()
    source: str = ""
    form: str = ""

    def __post_init__(self) -> None:
        """Copy the arrays and check them."""
        count = len(self.labels)
        if self.q is None and self.T_wanted is None:
            raise ModelError(
                "A program has neither joint values nor poses. Give one of them, or both."
            )
        if not count:
            raise ModelError("A program has no rows. Give at least one.")
        if self.q is not None:
            object.__setattr__(self, "q", _checked(self.q, count, 2, "joint values"))
        if self.T_wanted is not None:
            poses = _checked(self.T_wanted, count, 3, "poses")
            _check_rotations(poses, self.labels)
            object.__setattr__(self, "T_wanted", poses)

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.labels)

    @classmethod
    def of_joints(cls, q: ArrayLike) -> Program:
        """A program of joint values made for the nominal robot.

        Args:
            q: shape (N, m) or (m,), [rad] or [m].
        """
        values = np.atleast_2d(np.asarray(q, dtype=np.float64))
        return cls(_counted(len(values)), q=values)

    @classmethod
    def of_poses(cls, T_wanted: ArrayLike, q: ArrayLike | None = None) -> Program:
        """A program of poses of the tool.

        Args:
            T_wanted: shape (N, 4, 4) or (4, 4), [m].
            q: shape (N, m) or (m,), where to start looking for joint values [rad] or [m].
        """
        poses = np.reshape(np.asarray(T_wanted, dtype=np.float64), (-1, 4, 4))
        return cls(_counted(len(poses)), _rows(q), poses)

    @classmethod
    def of_points(cls, points: ArrayLike, q: ArrayLike | None = None) -> Program:
        """A program of positions of the tool, orientation left free.

        Args:
            points: shape (N, 3) or (3,), [m].
            q: shape (N, m) or (m,), where to start looking for joint values [rad] or [m].
        """
        positions = np.reshape(np.asarray(points, dtype=np.float64), (-1, 3))
        poses = np.tile(np.eye(4), (len(positions), 1, 1))
        poses[:, :3, 3] = positions
        return cls(_counted(len(poses)), _rows(q), poses, oriented=False)


def _counted(count: int) -> tuple[str, ...]:
    """Labels from 1."""
    return tuple(f"row {i + 1}" for i in range(count))


def _rows(q: ArrayLike | None) -> Array | None:
    """Joint values as rows."""
    return None if q is None else np.atleast_2d(np.asarray(q, dtype=np.float64))


def _checked(values: Array, count: int, dimensions: int, what: str) -> Array:
    """A read-only copy of finite numbers, one row for each label."""
    array = read_only(values)
    fits = array.ndim == dimensions and len(array) == count
    if not fits or (dimensions == 3 and array.shape[1:] != (4, 4)):
        wanted = "(N, 4, 4)" if dimensions == 3 else "(N, m)"
        raise ModelError(
            f"The {what} of a program have the shape {array.shape}; {wanted} is wanted, with N = {count}."
        )
    if not np.isfinite(array).all():
        row = int(np.argwhere(~np.isfinite(array))[0, 0])
        raise ModelError(f"The {what} of row {row + 1} of a program are not all finite numbers.")
    return array


def _check_rotations(poses: Array, labels: Iterable[str]) -> None:
    """Refuse matrices that are no poses."""
    R = poses[:, :3, :3]
    defect = np.abs(np.swapaxes(R, 1, 2) @ R - np.eye(3)).max(axis=(1, 2))
    wrong = (
        (defect > _NO_ROTATION)
        | (np.linalg.det(R) < 0.0)
        | (poses[:, 3] != [0.0, 0.0, 0.0, 1.0]).any(axis=1)
    )
    for row, label in zip(wrong, labels, strict=True):
        if row:
            raise ModelError(
                f"The pose of {label} of a program is none: its upper left block must be a rotation and its last row "
                "0 0 0 1."
            )


# A program as a table


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
        raise MeasurementError(
            f"A program cannot be given as '{given}'; it is one of {choices(GIVEN)}."
        )
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
        raise MeasurementError(
            f"{table.source}, line {row.line} (row {row.ordinal}): there is no position, all its cells are empty, "
            f"while other rows have one. Fill it in, or remove the row; {len(values.unmeasured)} of "
            f"{len(values.unmeasured) + len(values.rows)} rows are so."
        )


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
    raise MeasurementError(
        f"{table.source}, line {row.line} (row {row.ordinal}), columns qx, qy, qz, qw: the quaternion has the length "
        f"{length:.6g}; that of an orientation is 1. Correct it; some controllers write w first: then map the columns "
        "with --columns."
    )
