"""Which column of a table of measurements is what, and the kinds of its rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import calib.data.kinds as registry
from calib.data.kinds import Kind
from calib.data.table import (
    COMMON,
    EXPECTED,
    ORIENTATION,
    POINT,
    QUATERNION,
    ROTATION_VECTOR,
    STATUS,
    TORQUE,
    Column,
    Table,
    close_names,
    list_columns,
    name_columns,
    reserved,
    with_unit,
    without_unit,
)
from calib.errors import MeasurementError, choices
from calib.units import Quantity, split_header

Columns = tuple[Column, ...]


@dataclass(frozen=True, slots=True)
class Layout:
    """Which column of a table is what.

    Attributes:
        words: the columns ``row``, ``set``, ``kind``, ``target``, ``pair``, ``point`` that are used, by name; and
            ``status`` of a table of commands.
        groups: the columns whose words make the group's name, in the order of the table.
        blocks: the columns of numbers that are used: ``joints`` (in the order asked for, else in that of the
            table), ``torques``, ``points``, ``orientation`` (three or four), ``sigma``, ``sigma_angle``, and each
            reading of a kind by its name.
        kinds: the kinds of the rows; more than one only with a column ``kind``.
        ignored: the headers of the columns that were not used, but for those that a plan has and a fit does not need.
        numbers: the columns of numbers, block after block.
    """

    words: Mapping[str, Column]
    groups: Columns
    blocks: Mapping[str, Columns]
    kinds: tuple[str, ...]
    ignored: tuple[str, ...]
    numbers: Columns = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Put the columns of numbers together once."""
        every = tuple(column for block in self.blocks.values() for column in block)
        object.__setattr__(self, "numbers", every)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The names of the joints."""
        return tuple(column.name for column in self.blocks["joints"])

    @property
    def prismatic(self) -> tuple[str, ...]:
        """The names of the joint columns in a unit of length."""
        joints = self.blocks["joints"]
        return tuple(c.name for c in joints if c.unit and c.unit.quantity == "length")

    def span(self, name: str) -> list[int]:
        """Where the columns of a block stand among ``numbers``; nowhere if it is not there."""
        start = 0
        for block, columns in self.blocks.items():
            if block == name:
                return list(range(start, start + len(columns)))
            start += len(columns)
        return []

    def measured_by(self, kind: str) -> list[int]:
        """Which of ``numbers`` hold what a row of this kind measures; none if that is nothing, or stands elsewhere."""
        own = registry.get(kind)
        names = ["points"] * own.position + ["orientation"] * own.orientation
        return [i for n in (*names, *(one.name for one in own.readings)) for i in self.span(n)]

    def used_by(self, kind: str) -> list[int]:
        """Which of ``numbers`` a row of this kind uses."""
        names = ["joints", "torques", "sigma"] + ["sigma_angle"] * (registry.get(kind).angles > 0)
        return [i for name in names for i in self.span(name)] + self.measured_by(kind)

    @classmethod
    def find(
        cls,
        table: Table,
        joint_names: Sequence[str] | None = None,
        joint_types: Mapping[str, str] | None = None,
        columns: Mapping[str, str] | None = None,
        kind: str | None = None,
        *,
        points_elsewhere: bool = False,
    ) -> Layout:
        """Find the columns, see `Measurements.read`; with ``points_elsewhere`` the rows only name their points.

        Raises:
            MeasurementError: a column is missing, there twice, without a unit or in a wrong one.
        """
        named, groups = name_columns(table, joint_names or (), columns or {})
        joints = _joints(table, named, joint_names, joint_types or {})
        kinds = _kinds(table, named, kind, points_elsewhere=points_elsewhere)
        present = [registry.get(name) for name in kinds]
        blocks = _blocks(table, named, joints, present, points_elsewhere=points_elsewhere)
        words: dict[str, Column] = {n: named[n] for n in ("row", "set", "target") if n in named}
        # A table of commands says in its status where a row has none, and its cells are empty.
        if {"correction position", STATUS} <= named.keys():
            words[STATUS] = named[STATUS]
        if points_elsewhere and "point" in named:
            words["point"] = named["point"]
        if kind is None and "kind" in named:
            words["kind"] = named["kind"]
        for one in (one for one in present if one.paired):
            what = f"rows of the kind '{one.name}', of which two share a word,"
            words["pair"] = _needed(table, named, "pair", "pair", what)
        taken = {c.index for block in (words.values(), groups, *blocks.values()) for c in block}
        taken |= {c.index for n, c in named.items() if n.startswith(EXPECTED) or n == "point"}
        if points_elsewhere:
            taken |= _empty(table, [named[n] for n in (*POINT, *ORIENTATION) if n in named])
        ignored = tuple(label for i, label in enumerate(table.header) if label and i not in taken)
        return cls(words, groups, blocks, kinds, ignored)


def _blocks(
    table: Table,
    named: Mapping[str, Column],
    joints: Columns,
    present: Sequence[Kind],
    *,
    points_elsewhere: bool,
) -> dict[str, Columns]:
    """The columns of numbers, see `Layout`."""
    blocks: dict[str, Columns] = {
        "joints": joints,
        "torques": _torques(table, named, joints),
        "sigma": _optional(table, named, "sigma", "length"),
    }
    if any(one.position for one in present) and not points_elsewhere:
        blocks["points"] = _points(table, named)
    if any(one.orientation for one in present):
        blocks["orientation"] = _orientation(table, named)
    if any(one.angles for one in present):
        blocks["sigma_angle"] = _optional(table, named, "sigma_angle", "angle")
    for one in present:
        for read in one.readings:
            header = f"{read.name} [{COMMON[read.quantity]}]"
            column = _needed(table, named, read.name, header, f"rows of the kind '{one.name}'")
            blocks[read.name] = (with_unit(table, column, read.quantity),)
    return blocks


def _empty(table: Table, columns: Sequence[Column]) -> set[int]:
    """Where those of these columns stand that a plan has left empty in all rows."""
    return {column.index for column in columns if not any(table.column(column))}


def _kinds(
    table: Table, named: Mapping[str, Column], kind: str | None, *, points_elsewhere: bool
) -> tuple[str, ...]:
    """The kinds of the rows: as given, else from the column ``kind``, else from the columns there are."""
    if kind is not None:
        kinds: tuple[str, ...] = (registry.get(kind).name,)
    elif "kind" in named:
        kinds = _kinds_in(table, named["kind"], named.get("row"))
    else:
        kinds = ("point",) if points_elsewhere else (_guess_kind(named),)
    wrong = any(registry.get(name).orientation for name in kinds) or "point" not in kinds
    if points_elsewhere and wrong:
        raise MeasurementError(
            f"{table.source}: with a file of points the rows are of the kind 'point', or some are "
            f"of others that measure no position; here they are {choices(kinds)}. Leave out the "
            "file of points (--points), or the kind."
        )
    return kinds


def _kinds_in(table: Table, column: Column, numbers: Column | None) -> tuple[str, ...]:
    """The kinds that occur in the column ``kind``, in the order of the registry."""
    known, cells = registry.names(), table.column(column)
    for i, word in enumerate(cells):
        if word not in known:
            raise MeasurementError(
                f"{table.place(i, numbers, column)}: '{word}' is not a kind of measurement; allowed are "
                f"{choices(known)}. If the column means something else, "
                f'--columns "{split_header(column.label)[0]}=-" leaves it out.'
            )
    return tuple(kind for kind in known if kind in cells) or ("point",)


def _guess_kind(named: Mapping[str, Column]) -> str:
    """The kind of all rows from the columns that there are."""
    if any(named.keys() >= set(names) for names in (QUATERNION, ROTATION_VECTOR)):
        return "pose"
    every = [registry.get(name) for name in registry.names()]
    fitting = [k for k in every if k.readings and all(one.name in named for one in k.readings)]
    if fitting and not any(name in named for name in POINT):
        return max(fitting, key=lambda kind: kind.paired == ("pair" in named)).name
    return "point"


def _needed(
    table: Table, named: Mapping[str, Column], name: str, header: str, what: str, more: str = ""
) -> Column:
    """The column of this name, or an error that says what needs it and what header it has."""
    if name not in named:
        raise MeasurementError(
            f"{table.source}: {what} need a column '{header}', and there is none. {list_columns(table)} "
            f'Another name is mapped by --columns "name in the table={header}".{more}'
        )
    return named[name]


def _points(table: Table, named: Mapping[str, Column]) -> Columns:
    """The columns x, y, z."""
    more = ""
    if not any(name in named for name in POINT):
        more = (
            " Rows that measure no position have a column 'distance [mm]', or are read with --kind "
            "fixed or --kind plane and a column 'group' (or --columns \"name in the table=group\", "
            "once or more)."
        )
    found = [_needed(table, named, n, f"{n} [mm]", "measured points", more) for n in POINT]
    return tuple(with_unit(table, column, "length") for column in found)


def _orientation(table: Table, named: Mapping[str, Column]) -> Columns:
    """The columns of a quaternion or of a rotation vector; of one of them."""
    there = [n for n in (QUATERNION, ROTATION_VECTOR) if all(name in named for name in n)]
    if not there:
        parts = [name for name in ORIENTATION if name in named]
        some = f" There are only {choices(parts)}." if parts else ""
        raise MeasurementError(
            f"{table.source}: rows of the kind 'pose' need an orientation.{some} "
            f"{list_columns(table)} Its columns are qx, qy, qz, qw (a quaternion, no unit) or "
            "'rx [rad]', 'ry [rad]', 'rz [rad]' (a rotation vector). Without one, --kind point."
        )
    if len(there) == 2:
        raise MeasurementError(
            f"{table.source}: the orientation is there twice, as {choices(QUATERNION)} and as "
            f'{choices(ROTATION_VECTOR)}. Leave one out: --columns "rx=-" or --columns "qx=-".'
        )
    if there[0] == ROTATION_VECTOR:
        what = "a rotation vector; --kind point leaves the orientation out"
        return tuple(with_unit(table, named[n], "angle", what, "rad") for n in ROTATION_VECTOR)
    return tuple(without_unit(table, named[name]) for name in QUATERNION)


def _optional(table: Table, named: Mapping[str, Column], name: str, quantity: Quantity) -> Columns:
    """The column of this name and quantity, if it is there."""
    return (with_unit(table, named[name], quantity),) if name in named else ()


def _torques(table: Table, named: Mapping[str, Column], joints: Columns) -> Columns:
    """The columns of torques, those that there are, in the order of the joints."""
    found = []
    for joint in joints:
        column = named.get(joint.name + TORQUE)
        if column is not None and column.name not in {other.name for other in joints}:
            sliding = joint.unit is not None and joint.unit.quantity == "length"
            what = f"{'prismatic' if sliding else 'revolute'} joint '{joint.name}'"
            found.append(with_unit(table, column, "force" if sliding else "torque", what))
    return tuple(found)


def _joints(
    table: Table,
    named: Mapping[str, Column],
    joint_names: Sequence[str] | None,
    types: Mapping[str, str],
) -> Columns:
    """The columns of the joints asked for, in that order; else those in angles, and known prismatic ones."""
    free = {n: c for n, c in named.items() if n not in (*reserved(), *ORIENTATION)}
    if joint_names is None:
        joints = [
            c for n, c in free.items() if c.unit and (c.unit.quantity == "angle" or n in types)
        ]
    else:
        _check_named(table, named, joint_names, types, free)
        joints = [named[name] for name in joint_names]
    if not joints and joint_names is None:
        raise MeasurementError(
            f"{table.source}: no column of joint angles. {list_columns(table)} The header of such a "
            "column is the joint's name and a unit of angle, 'elbow_joint [deg]'."
        )
    for column in joints:
        kind = types.get(column.name)
        if kind is not None or column.unit is None:
            quantity: Quantity = "length" if kind == "prismatic" else "angle"
            with_unit(table, column, quantity, f"{kind or 'revolute'} joint '{column.name}'")
    return tuple(joints)


def _check_named(
    table: Table,
    named: Mapping[str, Column],
    joint_names: Sequence[str],
    types: Mapping[str, str],
    free: Mapping[str, Column],
) -> None:
    """Refuse joints without a column, and those whose name is another column's."""
    clash = [name for name in joint_names if name in reserved()]
    if clash:
        raise MeasurementError(
            f"{table.source}: a joint cannot be called {choices(clash)}, which is the name of "
            "another column of the table. Rename the joint in the URDF."
        )
    missing = [name for name in joint_names if name not in named]
    if not missing:
        return
    others = [name for name in free if name not in joint_names]
    # One each where many are missing: the line stays short enough to read.
    close = {name: close_names(name, others)[: 3 if len(missing) < 3 else 1] for name in missing}
    hint = "".join(f" Close to '{n}': {choices(names)}." for n, names in close.items() if names)
    header = f"{missing[0]} [{'mm' if types.get(missing[0]) == 'prismatic' else 'deg'}]"
    raise MeasurementError(
        f"{table.source}: no column for the joints {choices(missing)}. {list_columns(table)}{hint} "
        f"The header of such a column is '{header}'; another name is mapped by "
        f'--columns "name in the table={header}".'
    )
