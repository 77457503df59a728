"""Program: what a robot is to do, row by row, as joint values planned on the nominal robot or as poses of its tool.

Files are kept apart from the correction: a reader makes a `Program` of a file, `compensate` corrects its targets, and a
writer makes a file of the `Commands`. `calib.verbs.compensate.program_table` has reader and writer of tables.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from calib.basics.arguments import check_mapping, check_names, check_type, finite_numbers, numbers
from calib.basics.arrays import Array, read_only
from calib.basics.values import Value, keep_read_only, one_line
from calib.errors import ModelError, choices
from calib.numerics.geometry import not_rotations
from calib.verbs.compensate.inverse import MATCHES, POSITION

#: Words for joint values, and for poses, in messages.
_VALUES = "joint values of shape (N, m) or (m,), [rad] or [m]"
_POSES = "poses of shape (N, 4, 4) or (4, 4), [m]"


@dataclass(frozen=True, slots=True, eq=False)
class Program(Value):
    """N rows that a robot is to run through: joint values, poses of the tool, or both.

    Raises:
        ModelError: Neither joint values nor poses, numbers that are not finite, a matrix that is not a pose, or a match
            or a start that does not fit the rows.
    """

    #: Name of each row in messages, such as ``"row 3"``.
    labels: tuple[str, ...]
    #: shape (N, m), joint values in the order of ``Robot.joint_names`` [rad] or [m]; with ``T_wanted`` those at which
    #: the search for joint values starts; None: poses alone.
    q: Array | None = None
    #: shape (N, 4, 4), wanted poses of the tool [m]; None: those of the nominal robot at ``q``.
    T_wanted: Array | None = None
    #: Whether ``T_wanted`` gives orientations, or positions only.
    oriented: bool = True
    #: Part of the poses that is to be reached, one of `MATCHES`; None: ``"pose"``, ``"axis"`` with five joints,
    #: ``"position"`` with fewer or if no orientation is given.
    match: str | None = None
    #: Joint values by name [rad] or [m] near which the search for the first pose starts, of a program of poses alone;
    #: joints that are not named start in mid range; None: all do.
    start: Mapping[str, float] | None = None
    #: Other columns of a table, header and cells, which its commands get too.
    kept: tuple[tuple[str, tuple[str, ...]], ...] = ()
    #: Convention of a table's orientations, one of `calib.data.forms.orientations.CONVENTIONS`, in which those of its
    #: commands are written; empty if there are none.
    form: str = ""

    def __post_init__(self) -> None:
        """Check the values, which raises `CalibError`, and make the arrays read-only copies."""
        check_names("labels", self.labels)
        check_type("match", self.match, (str, type(None)), f"one of {choices(MATCHES)}, or None")
        if self.start is not None:
            check_mapping("start", self.start)
        if not self.labels or (self.q is None and self.T_wanted is None):
            raise ModelError("A program has rows of joint values, of poses, or of both.")
        matches = MATCHES if self.oriented else (POSITION,)
        if self.match not in (None, *matches):
            raise ModelError(
                f"'{self.match}' cannot be matched; this program's rows allow {choices(matches)}."
            )
        if self.start and self.q is not None:
            raise ModelError("Each row has joint values to start at: leave out the start.")
        count = len(self.labels)
        if self.q is not None:
            allowed = f"{_VALUES}, one for each of the {count} labels"
            q = finite_numbers("q", self.q, (count, None), allowed)
            object.__setattr__(self, "q", read_only(q))
        if self.T_wanted is not None:
            allowed = f"{_POSES}, one for each of the {count} labels"
            T_wanted = finite_numbers("T_wanted", self.T_wanted, (count, 4, 4), allowed)
            if not_rotations(T_wanted[:, :3, :3]).any():
                raise ModelError(
                    "T_wanted of a program has a matrix that is not a pose: its rotation is not orthonormal."
                )
            object.__setattr__(self, "T_wanted", read_only(T_wanted))
        keep_read_only(self, "start")

    def __repr__(self) -> str:
        """Return one line: the number of rows, and whether they are joint values, poses or positions."""
        what = "joint values"
        if self.T_wanted is not None:
            what = "poses" if self.oriented else "positions"
        return one_line("Program", f"{len(self)} rows of {what}")

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.labels)

    @classmethod
    def of_joints(cls, q: ArrayLike) -> Program:
        """Make a program of joint values for the nominal robot, shape (N, m) or (m,), [rad] or [m]."""
        values = np.atleast_2d(numbers("q", q, _VALUES))
        return cls(_labels(len(values)), q=values)

    @classmethod
    def of_poses(
        cls,
        T_wanted: ArrayLike,
        q: ArrayLike | None = None,
        *,
        start: Mapping[str, float] | None = None,
    ) -> Program:
        """Make a program of poses of the tool.

        Args:
            T_wanted: Poses in the frame that the commands are computed with, shape (N, 4, 4) or (4, 4), [m].
            q: Joint values at which the search starts, shape (N, m), [rad] or [m]; None: not given.
            start: Joint values by name near which the search for the first pose starts, without ``q`` [rad] or [m];
                None: mid range.
        """
        given = numbers("T_wanted", T_wanted, _POSES)
        poses = given[None] if given.ndim == 2 else given
        finite_numbers("T_wanted", poses, (None, 4, 4), _POSES)
        starts = None if q is None else np.atleast_2d(numbers("q", q, _VALUES))
        return cls(_labels(len(poses)), starts, poses, start=start)

    @classmethod
    def of_points(
        cls,
        points: ArrayLike,
        q: ArrayLike | None = None,
        *,
        start: Mapping[str, float] | None = None,
    ) -> Program:
        """Make a program of positions of the tool, its orientation left free.

        Args:
            points: Positions in the frame that the commands are computed with, shape (N, 3) or (3,), [m].
            q: Joint values at which the search starts, shape (N, m), [rad] or [m]; None: not given.
            start: Joint values by name near which the search for the first point starts, without ``q`` [rad] or [m];
                None: mid range.
        """
        allowed = "positions of shape (N, 3) or (3,), [m]"
        given = np.atleast_2d(numbers("points", points, allowed))
        positions = finite_numbers("points", given, (None, 3), allowed)
        return replace(cls.of_poses(poses_at(positions), q, start=start), oriented=False)


def _labels(count: int) -> tuple[str, ...]:
    """Return the labels of so many rows: ``"row 1"``, ``"row 2"`` and so on."""
    return tuple(f"row {i + 1}" for i in range(count))


def poses_at(points: Array) -> Array:
    """Return poses at points (N, 3) [m], their axes along those of the frame, shape (N, 4, 4)."""
    poses = np.tile(np.eye(4), (len(points), 1, 1))
    poses[:, :3, 3] = points
    return poses
