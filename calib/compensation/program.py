"""Program: what a robot is to do, row by row: joint values made for the nominal robot, or poses of its tool.

As a file it is read as a table of measurements is (`calib.data.layout`). What is different: poses may also be given by
roll, pitch and yaw, nothing may be missing, and columns that mean nothing here are kept.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from calib.compensation.inverse import MATCHES, POSITION
from calib.data.columns import (
    POINT,
    QUATERNION,
    ROLL_PITCH_YAW,
    ROTATION_VECTOR,
    STATUS,
    list_columns,
    name_columns,
    with_unit,
)
from calib.data.layout import Layout
from calib.data.measurements import Measurements
from calib.data.table import Column, Table
from calib.data.values import read_values
from calib.errors import MeasurementError, ModelError, choices
from calib.numerics.geometry import not_rotations
from calib.robot.robot import Robot, read_only
from calib.units import Array, Quantity

#: The forms of an orientation; roll, pitch and yaw are about fixed axes: Rz(yaw) Ry(pitch) Rx(roll).
FORMS = {
    ROTATION_VECTOR: "rotation vector",
    QUATERNION: "quaternion",
    ROLL_PITCH_YAW: "roll, pitch, yaw",
}

#: What stands before the names of columns that say what was changed, in a table of commands.
CORRECTION = "correction "

#: The column of the position error to expect of each row of a table of commands.
EXPECTED = "expected error"


@dataclass(frozen=True, slots=True, eq=False)
class Program:
    """N rows that a robot is to run through: joint values, poses of the tool, or both.

    Raises:
        ModelError: Neither joint values nor poses, a number or a rotation that is none, or words that do not fit.
    """

    labels: tuple[str, ...]  #: What messages call each row, such as ``"row 3"``.
    #: shape (N, m), joint values in the order of ``Robot.joint_names`` [rad] or [m]; with ``T_wanted`` those to start
    #: looking for joint values at.
    q: Array | None = None
    #: shape (N, 4, 4), poses of the tool that are wanted [m]; None: those that the nominal robot reaches at ``q``.
    T_wanted: Array | None = None
    oriented: bool = True  #: Whether ``T_wanted`` says the orientation too, or the position alone.
    #: What of the poses is to be reached, one of `MATCHES`; None: ``"pose"``, ``"axis"`` with five joints,
    #: ``"position"`` with fewer or where no orientation is given.
    match: str | None = None
    #: Joint values by name [rad] or [m] that the first of poses alone starts near; others start in mid range.
    start: Mapping[str, float] | None = None
    kept: tuple[tuple[str, tuple[str, ...]], ...] = ()  #: Other columns: header and cells.
    form: str = ""  #: How the file's orientations were given; empty if there are none.

    def __post_init__(self) -> None:
        """Check what a person gets wrong, and make the arrays read-only copies."""
        if not self.labels or (self.q is None and self.T_wanted is None):
            raise ModelError("A program has rows of joint values, of poses, or of both.")
        allowed = MATCHES if self.oriented else (POSITION,)
        if self.match not in (None, *allowed):
            raise ModelError(
                f"'{self.match}' cannot be matched; this program's rows allow {choices(allowed)}."
            )
        if self.start and self.q is not None:
            raise ModelError("Each row has joint values to start at: leave out the start.")
        for name, values in (("q", self.q), ("T_wanted", self.T_wanted)):
            if values is not None:
                turned = values[:, :3, :3] if values.ndim == 3 else np.eye(3)[None]
                if not np.isfinite(values).all() or not_rotations(turned).any():
                    raise ModelError(f"{name} of a program has a number or a pose that is none.")
                object.__setattr__(self, name, read_only(values))

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.labels)

    @classmethod
    def of_joints(cls, q: ArrayLike) -> Program:
        """A program of joint values made for the nominal robot, shape (N, m) or (m,), [rad] or [m]."""
        values = np.atleast_2d(np.asarray(q, dtype=np.float64))
        return cls(tuple(f"row {i + 1}" for i in range(len(values))), q=values)

    @classmethod
    def of_poses(cls, T_wanted: ArrayLike, q: ArrayLike | None = None) -> Program:
        """A program of poses of the tool, shape (N, 4, 4) or (4, 4), [m]; ``q`` (N, m) is where to start looking."""
        poses = np.reshape(np.asarray(T_wanted, dtype=np.float64), (-1, 4, 4))
        starts = None if q is None else np.atleast_2d(np.asarray(q, dtype=np.float64))
        return cls(tuple(f"row {i + 1}" for i in range(len(poses))), starts, poses)

    @classmethod
    def of_points(cls, points: ArrayLike, q: ArrayLike | None = None) -> Program:
        """A program of positions of the tool, shape (N, 3) or (3,) [m], orientation left free; ``q`` as of poses."""
        places = np.reshape(np.asarray(points, dtype=np.float64), (-1, 3))
        return replace(cls.of_poses(_unturned(places), q), oriented=False)


def _unturned(points: Array) -> Array:
    """Poses at points (N, 3), axes along those of the frame, shape (N, 4, 4)."""
    poses = np.tile(np.eye(4), (len(points), 1, 1))
    poses[:, :3, 3] = points
    return poses


def read_program(
    path: str | Path,
    robot: Robot,
    *,
    columns: Mapping[str, str] | None = None,
    match: str | None = None,
    start: Mapping[str, float] | None = None,
) -> Program:
    """Read a table of joint values, of poses, or of both; see docs/compensation.md.

    ``columns`` maps names of the table to names of calib; ``match`` and ``start`` are those of `Program`.

    Raises:
        MeasurementError: The table cannot be read; the text names file, row and column.
    """
    table = Table.read(path)
    rows = table.cells
    names = robot.joint_names
    named, _ = name_columns(table, names, columns or {})
    if any(name.startswith(CORRECTION) for name in named):
        raise MeasurementError(
            f"{table.source}: these are commands of calib compensate, corrected already. Give the program itself."
        )
    filled = {i for row in rows for i, cell in enumerate(row) if cell}

    def block(wanted: Sequence[str]) -> tuple[Column, ...]:
        """The columns of these names, all or none; none if no cell is filled in, as in a plan of poses."""
        own = [named[n] for n in wanted if n in named and (wanted is names or n not in names)]
        if own and len(own) < len(wanted):
            missing = choices(n for n in wanted if n not in named)
            raise MeasurementError(
                f"{table.source}: {missing} missing beside {choices(c.name for c in own)}. {list_columns(table)} Map "
                'another name with --columns "name in the table=name", hold a joint that stands still with --hold, or '
                f'leave out what is there with --columns "{own[0].name}=-".'
            )
        return tuple(own) if not rows or {column.index for column in own} & filled else ()

    joints, points = block(names), block(POINT)
    forms = [form for form in FORMS if block(form)]
    if not (joints or points):
        raise MeasurementError(
            f"{table.source}: there are no joint values and no positions, or all their cells are empty. "
            f"{list_columns(table)} A program has '{names[0]} [deg]' and so on, or 'x [mm]', 'y [mm]', 'z [mm]'."
        )
    if len(forms) > 1:
        raise MeasurementError(
            f"{table.source}: the orientation is there twice, as {' and as '.join(FORMS[f] for f in forms)}. Leave "
            f'one out: --columns "{forms[1][0]}=-" and so on.'
        )
    form = forms[0] if forms and points else ()
    q, T_wanted = _numbers(table, robot, joints, points, tuple(named[name] for name in form))
    meant = {n for one in (POINT, *FORMS) for n in one if n not in names} | {
        *names,
        EXPECTED,
        STATUS,
    }
    # A column without a name is kept if anything stands in it: separators at the end of each line are none.
    unread = {column.index for name, column in named.items() if name not in meant}
    unread |= {i for i, label in enumerate(table.header) if not label and i in filled}
    labels = table.column(named["row"]) if "row" in named else []
    if len(set(labels)) < len(rows) or "" in labels:
        labels = [str(i + 1) for i in range(len(rows))]
    return Program(
        labels=tuple(f"row {label}" for label in labels),
        q=q,
        T_wanted=T_wanted,
        oriented=bool(form) or not points,
        match=match,
        start=start,
        kept=tuple((table.header[i], tuple(row[i] for row in rows)) for i in sorted(unread)),
        form=FORMS.get(form, ""),
    )


def _numbers(
    table: Table,
    robot: Robot,
    joints: tuple[Column, ...],
    points: tuple[Column, ...],
    turns: tuple[Column, ...],
) -> tuple[Array | None, Array | None]:
    """Joint values and poses of the rows, in SI units; roll, pitch and yaw are read as joint values are."""
    form = tuple(column.name for column in turns)
    by_angles = form == ROLL_PITCH_YAW
    if form == QUATERNION:
        turns = tuple(with_unit(table, column, None, FORMS[form]) for column in turns)
    else:
        common = "deg" if by_angles else "rad"
        turns = tuple(with_unit(table, c, "angle", FORMS[form], common) for c in turns)
    angles: list[Column] = []
    for column in joints:
        kind = robot.joint_types[column.name]
        quantity: Quantity = "length" if kind == "prismatic" else "angle"
        angles.append(with_unit(table, column, quantity, f"{kind} joint '{column.name}'"))
    blocks: dict[str, tuple[Column, ...]] = {
        "joints": (*angles, *(turns if by_angles else ())),
        "points": tuple(with_unit(table, column, "length") for column in points),
        "orientation": () if by_angles else turns,
    }
    kind = "fixed" if not points else "pose" if blocks["orientation"] else "point"
    values = Measurements(**read_values(table, Layout({}, (), blocks, (kind,))))
    if values.unmeasured:
        raise MeasurementError(
            f"{table.source}, row {values.unmeasured[0]}: there is no position, all its cells are empty, while other "
            "rows have one. Fill it in, or remove the row."
        )
    poses = _unturned(values.points) if points else None
    if poses is not None and by_angles:
        turned = values.joints[:, len(joints) :]
        poses[:, :3, :3] = Rotation.from_euler("xyz", turned).as_matrix()
    elif poses is not None and values.rotations is not None:
        poses[:, :3, :3] = values.rotations
    return values.joints[:, : len(joints)] if joints else None, poses
