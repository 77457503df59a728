"""Program: what a robot is to do, row by row: joint values made for the nominal robot, or poses of its tool.

As a file it is read as a table of measurements is (`calib.data.values`): units in the header, decimal commas between
semicolons, values in a wrong unit refused. What is different: poses may also be given by roll, pitch and yaw, nothing
may be missing, and columns that mean nothing here are kept.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from calib.data.checks import no_rotation
from calib.data.layout import Layout
from calib.data.table import (
    POINT,
    QUATERNION,
    ROLL_PITCH_YAW,
    ROTATION_VECTOR,
    STATUS,
    Column,
    Row,
    Table,
    close_names,
    list_columns,
    name_columns,
    with_unit,
    without_unit,
)
from calib.data.values import Values
from calib.errors import MeasurementError, ModelError, choices
from calib.robot.robot import Robot, read_only
from calib.units import split_header

Array = NDArray[np.float64]

#: The forms of an orientation, and what a message calls them; angles are about fixed axes: Rz(yaw) Ry(pitch) Rx(roll).
FORMS = {
    ROTATION_VECTOR: "a rotation vector",
    QUATERNION: "a quaternion",
    ROLL_PITCH_YAW: "roll, pitch and yaw",
}

#: What stands before the names of columns that say what was changed, in a table of commands.
CORRECTION = "correction "

#: What a program may be where a table has both.
GIVEN = ("joints", "poses")


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
        form: How the file's orientations were read, in words; empty if there are none.

    Raises:
        ModelError: Neither joint values nor poses, no rows, other shapes, or a number that is not finite.
    """

    labels: tuple[str, ...]
    q: Array | None = None
    T_wanted: Array | None = None
    oriented: bool = True
    kept: tuple[tuple[str, tuple[str, ...]], ...] = ()
    form: str = ""

    def __post_init__(self) -> None:
        """Copy the arrays and check them."""
        if not self.labels or (self.q is None and self.T_wanted is None):
            raise ModelError(
                "A program has rows of joint values, of poses, or of both. Give one at least."
            )
        for name, what, own in (("q", "joint values", ()), ("T_wanted", "poses", (4, 4))):
            if getattr(self, name) is None:
                continue
            values = read_only(getattr(self, name))
            wanted = (len(self.labels), *(own or values.shape[1:2]))
            if values.shape != wanted or values.ndim < 2:
                raise ModelError(
                    f"The {what} of a program have the shape {values.shape}; {'(N, 4, 4)' if own else '(N, m)'} is "
                    f"wanted, with N = {len(self.labels)}."
                )
            wrong = ~np.isfinite(values).all(axis=tuple(range(1, values.ndim)))
            if own:
                wrong |= no_rotation(values[:, :3, :3])
                wrong |= (values[:, 3] != [0.0, 0.0, 0.0, 1.0]).any(axis=1)
            if wrong.any():
                is_what = "finite numbers, a rotation and the row 0 0 0 1" if own else "numbers"
                raise ModelError(
                    f"The {what} of {self.labels[int(np.argmax(wrong))]} of a program are not all finite: {is_what} "
                    "are wanted."
                )
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
    rows = list(table.rows())
    names = robot.joint_names
    named, _ = name_columns(table, names, columns or {})
    old = {CORRECTION + name for name in ("position", "angle", *names)} & set(named)
    if old and given is None:
        raise MeasurementError(
            f"{table.source}: these are commands that calib compensate wrote: they are corrected already. Give the "
            "program that they were made from; or --given joints or --given poses, if these are to be corrected once "
            "more."
        )
    filled = {i for row in rows for i, cell in enumerate(row.cells) if cell}

    def block(wanted: Sequence[str], what: str) -> tuple[Column, ...]:
        """The columns of these names, all or none; none if no cell is filled in, as in a plan of poses."""
        own = [named[n] for n in wanted if n in named and (wanted is names or n not in names)]
        if own and len(own) < len(wanted):
            raise MeasurementError(_incomplete(table, named, wanted, own, what))
        return tuple(own) if not rows or {column.index for column in own} & filled else ()

    joints = block(names, f"the chain '{robot.base}' to '{robot.tip}'")
    points = block(POINT, "a position")
    forms = [form for form, what in FORMS.items() if block(form, what)]
    if not {"joints": joints, "poses": points, None: joints or points}[given]:
        missing = {"joints": "joint values", "poses": "positions"}.get(given or "")
        missing = missing or f"joint values and {'an orientation but ' * bool(forms)}no positions"
        raise MeasurementError(
            f"{table.source}: there are no {missing}, or all their cells are empty. {list_columns(table)} A program "
            f"has a column for each joint, such as '{names[0] if names else 'joint_1'} [deg]', or 'x [mm]', 'y [mm]', "
            "'z [mm]' and an orientation; another name is mapped by --columns \"name in the table=x [mm]\"."
        )
    if len(forms) > 1:
        said = " and as ".join(f"{FORMS[form]} ({', '.join(form)})" for form in forms)
        raise MeasurementError(
            f"{table.source}: the orientation is there twice, as {said}. Leave one out: --columns "
            f'"{forms[1][0]}=-" and so on.'
        )
    meant = [n for form in (POINT, *FORMS) for n in form if n not in names and n in named]
    used = {named[name].index for name in (*meant, *old, *names, STATUS) if name in named}
    # A column without a name is kept if anything stands in it: separators at the end of each line are none.
    unread = {column.index for column in named.values()} - used
    unread |= {i for i, label in enumerate(table.header) if not label and i in filled}
    if given == "joints":
        points = ()
    form = forms[0] if forms and points else ()
    return Program(
        labels=_labels(rows, named.get("row")),
        **_numbers(table, robot, joints, points, [named[name] for name in form], form),
        oriented=bool(form) or not points,
        kept=tuple((table.header[i], tuple(row.cells[i] for row in rows)) for i in sorted(unread)),
        form=FORMS.get(form, ""),
    )


def _incomplete(
    table: Table,
    named: Mapping[str, Column],
    wanted: Sequence[str],
    own: Sequence[Column],
    what: str,
) -> str:
    """What to say of a table that has some columns of a position, of an orientation, or of the joints."""
    there = [column.name for column in own]
    missing = [name for name in wanted if name not in there]
    free = [name for name in named if name not in there]
    close = dict.fromkeys(hit for name in missing for hit in close_names(name, free)[:1])
    hint = f" Close to them: {choices(close)}." if close else ""
    left_out = " ".join(f'--columns "{split_header(c.label)[0]}=-"' for c in own)
    return (
        f"{table.source}: {what} has the columns {', '.join(wanted)}; {choices(missing)} "
        f"{'is' if len(missing) == 1 else 'are'} missing. {list_columns(table)}{hint} Map another name with --columns "
        f'"name in the table={missing[0]}", hold a joint that stands still with --hold, or leave out what is there '
        f"with {left_out}."
    )


def _labels(rows: Sequence[Row], column: Column | None) -> tuple[str, ...]:
    """What messages call each row: by the column ``row`` where that tells them apart."""
    own = [] if column is None else [row.cells[column.index] for row in rows]
    if not own or len(set(own)) < len(own) or "" in own:
        own = [str(row.ordinal) for row in rows]
    return tuple(f"row {name}" for name in own)


def _numbers(
    table: Table,
    robot: Robot,
    joints: Sequence[Column],
    points: Sequence[Column],
    turns: Sequence[Column],
    form: tuple[str, ...],
) -> dict[str, Array | None]:
    """Joint values and poses of the rows, in SI units; roll, pitch and yaw are read as joint values are."""
    by_angles = form == ROLL_PITCH_YAW
    if form == QUATERNION:
        turns = [without_unit(table, column) for column in turns]
    else:
        common = "deg" if by_angles else "rad"
        turns = [with_unit(table, c, "angle", FORMS[form], common) for c in turns]
    own = []
    for column in joints:
        kind = robot.joint_types[column.name]
        quantity = "length" if kind == "prismatic" else "angle"
        own.append(with_unit(table, column, quantity, f"{kind} joint '{column.name}'"))  # type: ignore[arg-type]
    blocks = {
        "joints": (*own, *(turns if by_angles else ())),
        "points": tuple(with_unit(table, column, "length") for column in points),
        "orientation": () if by_angles else tuple(turns),
    }
    kind = "fixed" if not points else "pose" if blocks["orientation"] else "point"
    empty = dict.fromkeys(("torques", "distance", "sigma", "sigma_angle"), ())
    values = Values.read(table, Layout({}, (), {**empty, **blocks}, (kind,), ()))
    if values.unmeasured:
        row = next(row for row in table.rows() if row.ordinal == values.unmeasured[0])
        raise MeasurementError(
            f"{table.source}, line {row.line} (row {row.ordinal}): there is no position, all its cells are empty, "
            "while other rows have one. Fill it in, or remove the row."
        )
    poses = _unturned(values.points) if points else None
    if poses is not None and by_angles:
        angles = values.joints[:, len(joints) :]
        poses[:, :3, :3] = Rotation.from_euler("xyz", angles).as_matrix()
    elif poses is not None and values.rotations is not None:
        poses[:, :3, :3] = values.rotations
    return {"q": values.joints[:, : len(joints)] if joints else None, "T_wanted": poses}
