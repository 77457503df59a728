"""Program: what a robot is to do, row by row: joint values made for the nominal robot, or poses of its tool.

As a file it is read as a table of measurements is (`calib.data.values`). What is different: poses may also be given by
roll, pitch and yaw, nothing may be missing, and columns that mean nothing here are kept.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from calib.compensation.inverse import MATCHES, POSITION
from calib.data.checks import no_rotation
from calib.data.layout import Layout
from calib.data.table import (
    POINT,
    QUATERNION,
    ROLL_PITCH_YAW,
    ROTATION_VECTOR,
    STATUS,
    Column,
    Table,
    list_columns,
    name_columns,
    with_unit,
    without_unit,
)
from calib.data.values import read_values
from calib.errors import MeasurementError, ModelError, choices, did_you_mean
from calib.robot.robot import Robot, read_only

Array = NDArray[np.float64]

#: The forms of an orientation; roll, pitch and yaw are about fixed axes: Rz(yaw) Ry(pitch) Rx(roll).
FORMS = {
    ROTATION_VECTOR: "rotation vector",
    QUATERNION: "quaternion",
    ROLL_PITCH_YAW: "roll, pitch, yaw",
}

#: What stands before the names of columns that say what was changed, in a table of commands.
CORRECTION = "correction "


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
        match: What of the poses is to be reached, one of `MATCHES`; None: ``"pose"``, ``"axis"`` with five joints,
            ``"position"`` with fewer or where no orientation is given.
        start: Joint values by name [rad] or [m] that the first of poses alone starts near; others start in mid range.
        kept: Other columns of the table, header and cells, that go into the commands unchanged.
        form: How the file's orientations were given; empty if there are none.

    Raises:
        ModelError: Neither joint values nor poses, no rows, other shapes, or a number that is not finite.
    """

    labels: tuple[str, ...]
    q: Array | None = None
    T_wanted: Array | None = None
    oriented: bool = True
    match: str | None = None
    start: Mapping[str, float] | None = None
    kept: tuple[tuple[str, tuple[str, ...]], ...] = ()
    form: str = ""

    def __post_init__(self) -> None:
        """Copy the arrays and check them."""
        if not self.labels or (self.q is None and self.T_wanted is None):
            raise ModelError("A program has rows of joint values, of poses, or of both.")
        if self.match not in (None, *(MATCHES if self.oriented else (POSITION,))):
            known = (
                choices(MATCHES) if self.oriented else f"'{POSITION}', as no orientation is given"
            )
            raise ModelError(f"'{self.match}' cannot be matched; choose {known}.")
        if self.start and self.q is not None:
            raise ModelError("Each row has joint values to start at: leave out the start.")
        for name, rank in (("q", 2), ("T_wanted", 3)):
            if getattr(self, name) is not None:
                values = read_only(getattr(self, name))
                if values.ndim != rank or len(values) != len(self):
                    raise ModelError(f"{name} has the shape {values.shape}, for {len(self)} rows.")
                if not np.isfinite(values).all() or (
                    rank == 3 and no_rotation(values[:, :3, :3]).any()
                ):
                    raise ModelError(f"{name} of a program has a number or a pose that is none.")
                object.__setattr__(self, name, values)

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.labels)

    @classmethod
    def of_joints(cls, q: ArrayLike) -> Program:
        """A program of joint values made for the nominal robot, shape (N, m) or (m,), [rad] or [m]."""
        values = np.atleast_2d(np.asarray(q, dtype=np.float64))
        return cls(_counted(len(values)), q=values)

    @classmethod
    def of_poses(cls, T_wanted: ArrayLike, q: ArrayLike | None = None) -> Program:
        """A program of poses of the tool, shape (N, 4, 4) or (4, 4), [m]; ``q`` (N, m) is where to start looking."""
        poses = np.reshape(np.asarray(T_wanted, dtype=np.float64), (-1, 4, 4))
        starts = None if q is None else np.atleast_2d(np.asarray(q, dtype=np.float64))
        return cls(_counted(len(poses)), starts, poses)

    @classmethod
    def of_points(cls, points: ArrayLike, q: ArrayLike | None = None) -> Program:
        """A program of positions of the tool, shape (N, 3) or (3,) [m], orientation left free; ``q`` as of poses."""
        poses = _unturned(np.reshape(np.asarray(points, dtype=np.float64), (-1, 3)))
        return replace(cls.of_poses(poses, q), oriented=False)


def _counted(count: int) -> tuple[str, ...]:
    """Labels from 1."""
    return tuple(f"row {i + 1}" for i in range(count))


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
    rows = list(table.rows())
    names = robot.joint_names
    named, _ = name_columns(table, names, columns or {})
    if any(name.startswith(CORRECTION) for name in named):
        raise MeasurementError(
            f"{table.source}: these are commands of calib compensate, corrected already. Give the program itself."
        )
    filled = {i for row in rows for i, cell in enumerate(row.cells) if cell}

    def block(wanted: Sequence[str]) -> tuple[Column, ...]:
        """The columns of these names, all or none; none if no cell is filled in, as in a plan of poses."""
        own = [named[n] for n in wanted if n in named and (wanted is names or n not in names)]
        if own and len(own) < len(wanted):
            missing = [n for n in wanted if n not in named]
            hint = did_you_mean(missing[0], [n for n in named if n not in wanted])
            raise MeasurementError(
                f"{table.source}: {choices(missing)} missing beside {choices(c.name for c in own)}{hint}. "
                f'{list_columns(table)} Map another name with --columns "name in the table={missing[0]}", hold a joint '
                f'that stands still with --hold, or leave out what is there with --columns "{own[0].name}=-".'
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
    meant = {n for form in (POINT, *FORMS) for n in form if n not in names} | {*names, STATUS}
    used = {column.index for name, column in named.items() if name in meant}
    # A column without a name is kept if anything stands in it: separators at the end of each line are none.
    unread = {column.index for column in named.values()} - used
    unread |= {i for i, label in enumerate(table.header) if not label and i in filled}
    form = forms[0] if forms and points else ()
    numbered = named.get("row")
    labels = [] if numbered is None else [row.cells[numbered.index] for row in rows]
    if not labels or len(set(labels)) < len(labels) or "" in labels:
        labels = [str(row.ordinal) for row in rows]
    q, T_wanted = _numbers(table, robot, joints, points, tuple(named[name] for name in form))
    return Program(
        labels=tuple(f"row {label}" for label in labels),
        q=q,
        T_wanted=T_wanted,
        oriented=bool(form) or not points,
        match=match,
        start=start,
        kept=tuple((table.header[i], tuple(row.cells[i] for row in rows)) for i in sorted(unread)),
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
        turns = tuple(without_unit(table, column) for column in turns)
    else:
        common = "deg" if by_angles else "rad"
        turns = tuple(with_unit(table, c, "angle", FORMS[form], common) for c in turns)
    own = []
    for column in joints:
        kind = robot.joint_types[column.name]
        quantity = "length" if kind == "prismatic" else "angle"
        own.append(with_unit(table, column, quantity, f"{kind} joint '{column.name}'"))  # type: ignore[arg-type]
    blocks = {
        "joints": (*own, *(turns if by_angles else ())),
        "points": tuple(with_unit(table, column, "length") for column in points),
        "orientation": () if by_angles else turns,
    }
    kind = "fixed" if not points else "pose" if blocks["orientation"] else "point"
    empty = dict.fromkeys(("torques", "distance", "sigma", "sigma_angle"), ())
    values = read_values(table, Layout({}, (), {**empty, **blocks}, (kind,), ()))
    if values.unmeasured:
        raise MeasurementError(
            f"{table.source}, row {values.unmeasured[0]}: there is no position, all its cells are empty, while other "
            "rows have one. Fill it in, or remove the row."
        )
    poses = _unturned(values.points) if points else None
    if poses is not None and by_angles:
        angles = values.joints[:, len(joints) :]
        poses[:, :3, :3] = Rotation.from_euler("xyz", angles).as_matrix()
    elif poses is not None and values.rotations is not None:
        poses[:, :3, :3] = values.rotations
    return values.joints[:, : len(joints)] if joints else None, poses
