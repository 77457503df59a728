"""Program: what a robot is to do, row by row: joint values made for the nominal robot, or poses of its tool."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.errors import ModelError
from calib.model.robot import read_only

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
            message = "A program has neither joint values nor poses. Give one of them, or both."
            raise ModelError(message)
        if not count:
            message = "A program has no rows. Give at least one."
            raise ModelError(message)
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
        message = f"The {what} of a program have the shape {array.shape}; {wanted} is wanted, with N = {count}."
        raise ModelError(message)
    if not np.isfinite(array).all():
        row = int(np.argwhere(~np.isfinite(array))[0, 0])
        message = f"The {what} of row {row + 1} of a program are not all finite numbers."
        raise ModelError(message)
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
            message = (
                f"The pose of {label} of a program is none: its upper left block must be a rotation and its last row "
                "0 0 0 1."
            )
            raise ModelError(message)
