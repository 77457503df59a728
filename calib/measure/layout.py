"""Which column of a table of measurements is what, and the kinds of its rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from calib.errors import MeasurementError, choices
from calib.measure.columns import (
    EXPECTED,
    ORIENTATION,
    POINT,
    QUATERNION,
    RESERVED,
    ROTATION_VECTOR,
    TORQUE,
    Column,
    check_cells,
    close_names,
    list_columns,
    name_columns,
    place,
    with_unit,
)
from calib.measure.kinds import KINDS, USES, check_kind
from calib.measure.table import Table
from calib.units import Quantity, split_header

# Signs that people write for "no unit" in the header of a quaternion.
_NO_UNIT = (None, "", "-", "1")

# A table of commands has these two columns; the second says so where a row has none, and its cells are empty.
_COMMANDS = ("correction position", "status")
_NO_COMMAND = "no command: "


@dataclass(frozen=True, slots=True)
class Layout:
    """Which column of a table is what.

    Attributes:
        words: the columns ``row``, ``set``, ``kind``, ``target``, ``pair``, ``point`` that are used, by name; and
            ``status`` of a table of commands.
        groups: the columns whose words make the group's name, in the order of the table.
        blocks: the columns of numbers that are used: ``joints`` (in the order asked for, else in that of the
            table), ``torques``, ``points``, ``orientation`` (three or four), ``distance``, ``sigma``,
            ``sigma_angle``; none of a block that is not there.
        kinds: the kinds of the rows; more than one only with a column ``kind``.
        ignored: the headers of the columns that were not used, but for those that a plan has and a fit does not need.
    """

    words: Mapping[str, Column]
    groups: tuple[Column, ...]
    blocks: Mapping[str, tuple[Column, ...]]
    kinds: tuple[str, ...]
    ignored: tuple[str, ...]

    @property
    def numbers(self) -> tuple[Column, ...]:
        """The columns of numbers, block after block."""
        return tuple(column for block in self.blocks.values() for column in block)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The names of the joints."""
        return tuple(column.name for column in self.blocks["joints"])

    @property
    def prismatic(self) -> tuple[str, ...]:
        """The names of the joint columns in a unit of length."""
        joints = self.blocks["joints"]
        return tuple(c.name for c in joints if c.unit and c.unit.quantity == "length")

    @property
    def torque_joints(self) -> tuple[int, ...]:
        """Which joint each column of torques belongs to, from 0."""
        names = self.joint_names
        return tuple(names.index(c.name.removesuffix(TORQUE)) for c in self.blocks["torques"])

    def span(self, name: str) -> list[int]:
        """Where the columns of a block stand among ``numbers``."""
        before = list(self.blocks)[: list(self.blocks).index(name)]
        start = sum(len(self.blocks[block]) for block in before)
        return list(range(start, start + len(self.blocks[name])))

    def used_by(self, kind: str) -> list[int]:
        """Which of ``numbers`` a row of this kind uses."""
        other = {name for names in USES.values() for name in names} - set(USES[kind])
        return [i for name in self.blocks if name not in other for i in self.span(name)]

    def measured_by(self, kind: str) -> tuple[Column, ...]:
        """The columns of what a row of this kind measures; none if it measures nothing, or does so elsewhere.

        Of a pair one row is empty, so that nothing follows from it.
        """
        blocks = ("points", "orientation", "distance")
        used = [name for name in blocks if name in USES[kind] and kind != "pair"]
        return tuple(column for name in used for column in self.blocks[name])

    def has_no_command(self, cells: Sequence[str]) -> bool:
        """Whether these are the cells of a row of a table of commands that was never sent."""
        column = self.words.get("status")
        return column is not None and cells[column.index].startswith(_NO_COMMAND)

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
        """Find the columns.

        Args:
            table: the table, whose rows are looked at only if it has a column ``kind``.
            joint_names: see `Measurements.read`, as for the next three.
            joint_types: a joint's URDF type by its name.
            columns: names of the table to names of calib.
            kind: the kind of all rows.
            points_elsewhere: the measured points stand in another file; this one only names them.

        Raises:
            MeasurementError: a column is missing, there twice, without a unit or in a wrong one.
        """
        types = joint_types or {}
        named, groups = name_columns(table, joint_names or (), columns or {})
        joints = (
            _guess_joints(table, named, types)
            if joint_names is None
            else _pick_joints(table, named, joint_names, types)
        )
        for joint in joints:
            _check_joint_unit(table, joint, types)
        kinds = _find_kinds(table, named, kind, points_elsewhere=points_elsewhere)
        used = {name for each in kinds for name in USES[each]}
        blocks: dict[str, tuple[Column, ...]] = {
            "joints": joints,
            "torques": _torques(table, named, joints),
            "points": (),
            "orientation": (),
            "distance": (),
            "sigma": _optional(table, named, "sigma", "length"),
            "sigma_angle": (),
        }
        if "points" in used and not points_elsewhere:
            blocks["points"] = _points(table, named)
        if "orientation" in used:
            blocks["orientation"] = _orientation(table, named)
            blocks["sigma_angle"] = _optional(table, named, "sigma_angle", "angle")
        if "distance" in used:
            blocks["distance"] = (_distance(table, named),)
        always = ("row", "set", "target")
        words: dict[str, Column] = {name: named[name] for name in always if name in named}
        if kind is None and "kind" in named:
            words["kind"] = named["kind"]
        if all(name in named for name in _COMMANDS):
            words["status"] = named["status"]
        if "pair" in kinds:
            words["pair"] = _pair(table, named)
        if points_elsewhere and "point" in named:
            words["point"] = named["point"]
        taken = {c.index for block in (words.values(), groups, *blocks.values()) for c in block}
        taken |= _of_a_plan(table, named, empty=points_elsewhere)
        ignored = tuple(label for i, label in enumerate(table.header) if label and i not in taken)
        return cls(words, groups, blocks, kinds, ignored)


def _of_a_plan(table: Table, named: Mapping[str, Column], *, empty: bool) -> set[int]:
    """Columns that a plan has and that need no word when they are not used, by their index.

    Args:
        table: the table.
        named: its columns.
        empty: whether those for the measurement may have been left empty; the rows are then looked at.
    """
    found = {c.index for name, c in named.items() if name.startswith(EXPECTED) or name == "point"}
    if empty:
        measured = {named[name].index for name in (*POINT, *ORIENTATION) if name in named}
        for row in table.rows() if measured else ():
            measured = {i for i in measured if i >= len(row.cells) or not row.cells[i]}
        found |= measured
    return found


def _find_kinds(
    table: Table, named: Mapping[str, Column], kind: str | None, *, points_elsewhere: bool
) -> tuple[str, ...]:
    """The kinds of the rows: as given, else from the column ``kind``, else from the columns there are."""
    if kind is not None:
        check_kind(kind)
        kinds: tuple[str, ...] = (kind,)
    elif "kind" in named:
        kinds = _kinds_in(table, named)
    elif points_elsewhere:
        kinds = ("point",)
    else:
        kinds = (_guess_kind(named),)
    if points_elsewhere and ("point" not in kinds or "pose" in kinds):
        message = (
            f"{table.source}: with a file of points the rows are of the kind 'point', or some are "
            f"of others that measure no position; here they are {choices(kinds)}. Leave out the "
            "file of points (--points), or the kind."
        )
        raise MeasurementError(message)
    return kinds


def _kinds_in(table: Table, named: Mapping[str, Column]) -> tuple[str, ...]:
    """The kinds that occur in the column ``kind``, in the order of `KINDS`."""
    column, numbers = named["kind"], named.get("row")
    seen = set()
    for row in table.rows():
        check_cells(table, row, numbers)
        text = row.cells[column.index]
        if text not in KINDS:
            message = (
                f"{place(table, row, numbers, column)}: '{text}' is not a kind of measurement; "
                f"allowed are {choices(KINDS)}. If the column means something else, "
                f'--columns "{split_header(column.label)[0]}=-" leaves it out.'
            )
            raise MeasurementError(message)
        seen.add(text)
    return tuple(kind for kind in KINDS if kind in seen) or ("point",)


def _guess_kind(named: Mapping[str, Column]) -> str:
    """The kind of all rows from the columns that there are."""
    if any(all(name in named for name in names) for names in (QUATERNION, ROTATION_VECTOR)):
        return "pose"
    if not any(name in named for name in POINT) and "distance" in named:
        return "pair" if "pair" in named else "distance"
    return "point"


def _points(table: Table, named: Mapping[str, Column]) -> tuple[Column, ...]:
    """The columns x, y, z."""
    missing = [name for name in POINT if name not in named]
    if missing:
        other = (
            " Rows that measure no position have a column 'distance [mm]', or are read with --kind "
            "fixed or --kind plane and a column 'group' (or --columns \"name in the table=group\", "
            "once or more)."
        )
        message = (
            f"{table.source}: no column for the measured point's {choices(missing)}. "
            f"{list_columns(table)} The header of such a column is '{missing[0]} [mm]'; another name "
            f'is mapped by --columns "name in the table={missing[0]}".'
            f"{other if len(missing) == len(POINT) else ''}"
        )
        raise MeasurementError(message)
    return tuple(with_unit(table, named[name], "length") for name in POINT)


def _orientation(table: Table, named: Mapping[str, Column]) -> tuple[Column, ...]:
    """The columns of a quaternion or of a rotation vector; of one of them."""
    there = [n for n in (QUATERNION, ROTATION_VECTOR) if all(name in named for name in n)]
    if not there:
        parts = [name for name in ORIENTATION if name in named]
        some = f" There are only {choices(parts)}." if parts else ""
        message = (
            f"{table.source}: rows of the kind 'pose' need an orientation.{some} "
            f"{list_columns(table)} Its columns are qx, qy, qz, qw (a quaternion, no unit) or "
            "'rx [rad]', 'ry [rad]', 'rz [rad]' (a rotation vector). Without one, --kind point."
        )
        raise MeasurementError(message)
    if len(there) == 2:
        message = (
            f"{table.source}: the orientation is there twice, as {choices(QUATERNION)} and as "
            f'{choices(ROTATION_VECTOR)}. Leave one out: --columns "rx=-" or --columns "qx=-".'
        )
        raise MeasurementError(message)
    if there[0] == ROTATION_VECTOR:
        what = "a rotation vector; --kind point leaves the orientation out"
        return tuple(with_unit(table, named[n], "angle", what, "rad") for n in ROTATION_VECTOR)
    columns = tuple(named[name] for name in QUATERNION)
    for column in columns:
        unit = column.unit.symbol if column.unit else split_header(column.label)[1]
        if unit not in _NO_UNIT:
            message = (
                f"{table.source}, column '{column.label}': '{unit}' cannot be; a quaternion has no "
                f"unit. Correct the header to '{column.name}'; for angles, to 'rx [deg]' and so on."
            )
            raise MeasurementError(message)
    return tuple(replace(column, unit=None) for column in columns)


def _distance(table: Table, named: Mapping[str, Column]) -> Column:
    """The column of a length."""
    if "distance" not in named:
        message = (
            f"{table.source}: rows of the kind 'distance' or 'pair' need a column 'distance [mm]'. "
            f"{list_columns(table)} Another name is mapped by "
            '--columns "name in the table=distance".'
        )
        raise MeasurementError(message)
    return with_unit(table, named["distance"], "length")


def _pair(table: Table, named: Mapping[str, Column]) -> Column:
    """The column of the words that two rows share."""
    if "pair" not in named:
        message = (
            f"{table.source}: rows of the kind 'pair' need a column 'pair' with a word that the two "
            f"rows of each distance share. {list_columns(table)} Another name is mapped by "
            '--columns "name in the table=pair".'
        )
        raise MeasurementError(message)
    return named["pair"]


def _optional(
    table: Table, named: Mapping[str, Column], name: str, quantity: Quantity
) -> tuple[Column, ...]:
    """The column of this name and quantity, if it is there."""
    return (with_unit(table, named[name], quantity),) if name in named else ()


def _torques(
    table: Table, named: Mapping[str, Column], joints: Sequence[Column]
) -> tuple[Column, ...]:
    """The columns of torques, those that there are, in the order of the joints."""
    names = {joint.name for joint in joints}
    found = []
    for joint in joints:
        column = named.get(joint.name + TORQUE)
        if column is not None and column.name not in names:
            sliding = joint.unit is not None and joint.unit.quantity == "length"
            what = f"{'prismatic' if sliding else 'revolute'} joint '{joint.name}'"
            found.append(with_unit(table, column, "force" if sliding else "torque", what))
    return tuple(found)


def _guess_joints(
    table: Table, named: Mapping[str, Column], types: Mapping[str, str]
) -> tuple[Column, ...]:
    """The joint columns when no names were given: those in angles, and known prismatic ones."""
    joints = tuple(
        column
        for name, column in named.items()
        if name not in (*RESERVED, *ORIENTATION)
        and column.unit is not None
        and (column.unit.quantity == "angle" or name in types)
    )
    if not joints:
        message = (
            f"{table.source}: no column of joint angles. {list_columns(table)} The header of such a "
            "column is the joint's name and a unit of angle, 'elbow_joint [deg]'."
        )
        raise MeasurementError(message)
    return joints


def _pick_joints(
    table: Table,
    named: Mapping[str, Column],
    joint_names: Sequence[str],
    types: Mapping[str, str],
) -> tuple[Column, ...]:
    """The columns of the joints asked for, in that order."""
    clash = [name for name in joint_names if name in RESERVED]
    if clash:
        message = (
            f"{table.source}: a joint cannot be called {choices(clash)}, which is the name of "
            "another column of the table. Rename the joint in the URDF."
        )
        raise MeasurementError(message)
    if not joint_names:
        message = f"{table.source}: no names of joints were given, not even one"
        raise MeasurementError(message)
    missing = [name for name in joint_names if name not in named]
    if not missing:
        return tuple(named[name] for name in joint_names)
    free = [n for n in named if n not in joint_names and n not in (*RESERVED, *ORIENTATION)]
    # One each where many are missing: the line stays short enough to read.
    close = {name: close_names(name, free)[: 3 if len(missing) < 3 else 1] for name in missing}
    hint = "".join(f" Close to '{n}': {choices(names)}." for n, names in close.items() if names)
    unit = "mm" if types.get(missing[0]) == "prismatic" else "deg"
    header = f"{missing[0]} [{unit}]"
    message = (
        f"{table.source}: no column for the joints {choices(missing)}. {list_columns(table)}{hint} "
        f"The header of such a column is '{header}'; another name is mapped by "
        f'--columns "name in the table={header}".'
    )
    raise MeasurementError(message)


def _check_joint_unit(table: Table, column: Column, types: Mapping[str, str]) -> None:
    """Refuse a joint column without a unit, or in a unit that is not of the joint's kind."""
    kind = types.get(column.name)
    quantity: Quantity = "length" if kind == "prismatic" else "angle"
    if kind is not None or column.unit is None:
        with_unit(table, column, quantity, f"{kind or 'revolute'} joint '{column.name}'")
