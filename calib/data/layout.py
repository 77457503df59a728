"""Layout of a table of measurements: which column is what, and of what kinds its rows are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NoReturn

import calib.basics.plugins as plugins
import calib.data.kinds as registry
from calib.basics.channels import RESIDUAL_UNITS
from calib.basics.tables import Column, Table
from calib.basics.units import Quantity, split_header
from calib.data.columns import (
    BOARD_POINT,
    COMMON,
    COVARIANCE,
    EXPECTED,
    ORIENTATION,
    POINT,
    STATUS,
    TORQUE,
    Columns,
    Named,
    joint_with_unit,
    list_columns,
    name_columns,
    reserved,
    with_unit,
)
from calib.data.covariances import may_have_covariance
from calib.data.forms.brands import fix_for_brand
from calib.data.forms.column_options import ColumnOptions, ColumnsInput, column_options
from calib.data.forms.orientation_columns import Orientation, conventions_of, find_orientation
from calib.data.kinds import Kind
from calib.errors import MeasurementError, choices, did_you_mean

#: Most joints that a message lists.
_LISTED_JOINTS = 12

#: A column of a table of commands, by which such a table is recognised.
_OF_COMMANDS = "correction position"


@dataclass(frozen=True, slots=True)
class Layout:
    """Columns of a table of measurements by what they hold, and the kinds of its rows."""

    #: Columns of words that are used, by name: ``row``, ``set``, ``kind``, ``target``, ``pair``, ``point``,
    #: ``approach``, ``status``, ``image``, ``corner``.
    words: Named
    #: Columns whose words make the group's name, in the order of the table.
    groups: Columns
    #: Columns of numbers that are used: ``joints`` in the order of the joints, ``torques``, ``points``,
    #: ``board_points``, ``orientation`` (as many as its convention has), the noise of each unit (``sigma``,
    #: ``sigma_angle``), ``covariances``, 36 of them or none, and each reading of a kind by its name.
    blocks: Mapping[str, Columns]
    #: Kinds of the rows; more than one only with a column ``kind``.
    kinds: tuple[str, ...]
    #: Headers of the columns that are not used, but for those that a plan has and a fit does not need.
    ignored: tuple[str, ...] = ()
    #: The orientation; None without one.
    orientation: Orientation | None = None

    @classmethod
    def find(
        cls,
        table: Table,
        joint_names: Sequence[str] | None = None,
        joint_types: Mapping[str, str] | None = None,
        columns: ColumnsInput = None,
        kind: str | None = None,
        *,
        points_elsewhere: bool = False,
    ) -> Layout:
        """Find the columns of a table of measurements.

        Args:
            table: The table.
            joint_names: The joints to read, see `Measurements.read`; None: every column of angles.
            joint_types: URDF types of joints by name; None: not known.
            columns: Names of calib by those of the table, or all that is said of the columns;
                None: nothing.
            kind: Kind of all rows; None: as the columns say.
            points_elsewhere: Whether the positions are in a file of their own, and the table at
                most names them in a column ``point``.

        Returns:
            The layout.

        Raises:
            MeasurementError: A column is missing, there twice, without a unit or in a wrong one.
        """
        options = column_options(columns)
        named, groups = name_columns(table, joint_names or (), options)
        joints = _joints(table, named, joint_names, joint_types or {}, options)
        is_oriented = bool(conventions_of(table, named, joint_names or (), options))
        kinds = _kinds(table, named, kind, is_oriented, points_elsewhere=points_elsewhere)
        present = list(map(registry.get, kinds))
        if points_elsewhere:
            _check_kinds_of_points(table, present)
        orientation: Orientation | None = None
        if any(kind.orientation for kind in present):
            orientation = find_orientation(table, named, joint_names or (), options)
        blocks = {
            "joints": joints,
            "torques": _torques(table, named, joints),
            **_noise(table, named, present),
            "covariances": _covariances(table, named, present),
            **_positions(table, named, present, points_elsewhere=points_elsewhere),
            **_board_points(table, named, present),
            **({} if orientation is None else {"orientation": orientation.columns}),
            **_readings(table, named, present),
        }
        words = _words(
            table, named, present, by_column=kind is None, points_elsewhere=points_elsewhere
        )
        layout = cls(words, groups, blocks, kinds, orientation=orientation)
        return _with_ignored(layout, table, named, points_elsewhere=points_elsewhere)


# Kinds


def _kinds(
    table: Table,
    named: Named,
    kind: str | None,
    is_oriented: bool,
    *,
    points_elsewhere: bool,
) -> tuple[str, ...]:
    """Return the kinds of the rows: as given, by the column ``kind``, or by the columns there are."""
    if kind is not None:
        return (registry.get(kind).name,)
    if "kind" in named:
        return _kinds_by_column(table, named)
    if points_elsewhere:
        return ("point",)
    if is_oriented:
        return ("pose",)
    reading = _kind_of_readings(named)
    has_position = any(name in named for name in POINT)
    return ("point",) if reading is None or has_position else (reading.name,)


def _kinds_by_column(table: Table, named: Named) -> tuple[str, ...]:
    """Return the kinds that the column ``kind`` names; ``point`` in a table without rows."""
    known = registry.names()
    column = named["kind"]
    cells = table.column(column)
    for i, word in enumerate(cells):
        if word not in known:
            what = (
                f"{plugins.unknown('kinds', word, known)} "
                f'--columns "{column.label}=-" leaves the column out.'
            )
            table.fail(i, column, what, named.get("row"))
    return tuple(name for name in known if name in cells) or ("point",)


def _kind_of_readings(named: Named) -> Kind | None:
    """Return the kind whose readings are all there; paired if there is a column ``pair``."""
    has_pairs = "pair" in named
    first = None
    for kind in map(registry.get, registry.names()):
        columns = {reading.name for reading in kind.readings}
        if not columns or not columns <= named.keys():
            continue
        if kind.paired == has_pairs:
            return kind
        first = first or kind
    return first


def _check_kinds_of_points(table: Table, present: Sequence[Kind]) -> None:
    """Refuse kinds that a list of points cannot serve."""
    has_orientation = any(kind.orientation for kind in present)
    names = [kind.name for kind in present]
    if has_orientation or "point" not in names:
        raise MeasurementError(
            f"{table.source}: with a list of points (--points) rows are of the kind 'point', or of "
            f"kinds that measure no position; here they are {choices(names)}. Leave out the list, "
            "or the kind."
        )


# Blocks of columns


def _positions(
    table: Table,
    named: Named,
    present: Sequence[Kind],
    *,
    points_elsewhere: bool,
) -> dict[str, Columns]:
    """Return the columns of measured positions."""
    if points_elsewhere or not any(kind.position for kind in present):
        return {}
    columns = [_needed(table, named, name, "length", "measured points") for name in POINT]
    return {"points": tuple(columns)}


def _board_points(table: Table, named: Named, present: Sequence[Kind]) -> dict[str, Columns]:
    """Return the columns of the positions of corners on their boards."""
    if not any(kind.optical for kind in present):
        return {}
    columns = [
        _needed(table, named, name, "length", "images of a board's corners") for name in BOARD_POINT
    ]
    return {"board_points": tuple(columns)}


def _noise(table: Table, named: Named, present: Sequence[Kind]) -> dict[str, Columns]:
    """Return the column of the noise of scalars in each unit that some kind has, if it is there.

    Poses with a covariance have none.
    """
    blocks: dict[str, Columns] = {}
    with_covariance = _covariances(table, named, present)
    with_noise = [kind for kind in present if not (with_covariance and may_have_covariance(kind))]
    for symbol, unit in RESIDUAL_UNITS.items():
        is_needed = any(symbol in kind.units for kind in with_noise)
        if is_needed and unit.sigma_name in named:
            column = with_unit(table, named[unit.sigma_name], unit.quantity)
            blocks[unit.sigma_name] = (column,)
    return blocks


def _covariances(table: Table, named: Named, present: Sequence[Kind]) -> Columns:
    """Return the 36 columns of the covariances of poses; none where there are no such columns, or no poses."""
    given = [name for name in COVARIANCE if name in named]
    if not given or not any(may_have_covariance(kind) for kind in present):
        return ()
    missing = [name for name in COVARIANCE if name not in named]
    if missing:
        raise MeasurementError(
            f"{table.source}: there is a column '{given[0]}' and none '{missing[0]}'. A covariance has the columns "
            f"'{COVARIANCE[0]}' to '{COVARIANCE[-1]}': its 6 x 6 entries row by row, of x, y, z [m] and of the turns "
            "about x, y, z [rad]."
        )
    what = "a covariance, in SI units"
    return tuple(with_unit(table, named[name], None, what) for name in COVARIANCE)


def _readings(table: Table, named: Named, present: Sequence[Kind]) -> dict[str, Columns]:
    """Return the columns of the readings of kinds, by the readings' names."""
    blocks: dict[str, Columns] = {}
    for kind in present:
        what = f"rows of the kind '{kind.name}'"
        for reading in kind.readings:
            column = _needed(table, named, reading.name, reading.quantity, what)
            blocks[reading.name] = (column,)
    return blocks


def _torques(table: Table, named: Named, joints: Columns) -> Columns:
    """Return the columns of torques, of the joints that have one, in the order of the joints."""
    result = []
    for joint in joints:
        column = named.get(joint.name + TORQUE)
        if column is None or column in joints:
            continue
        if slides(joint):
            what = f"prismatic joint '{joint.name}'"
            result.append(with_unit(table, column, "force", what))
        else:
            what = f"revolute joint '{joint.name}'"
            result.append(with_unit(table, column, "torque", what))
    return tuple(result)


def slides(joint: Column) -> bool:
    """Return True if a joint's column is in a unit of length: the joint is prismatic."""
    return joint.unit is not None and joint.unit.quantity == "length"


# Joints


def _joints(
    table: Table,
    named: Named,
    joint_names: Sequence[str] | None,
    types: Mapping[str, str],
    options: ColumnOptions,
) -> Columns:
    """Return the columns of joints, in the order of ``joint_names``.

    None: every column of angles and of joints in ``types``, but for names with another meaning.
    """
    taken = {*reserved(), *ORIENTATION}
    if joint_names is None:
        taken.update(*(row.columns for row in conventions_of(table, named, (), options)))
    available = {name: column for name, column in named.items() if name not in taken}
    if joint_names is None:
        joint_names = _inferred_joints(table, available, types)
    missing = [name for name in joint_names if name not in named]
    if missing:
        others = [name for name in available if name not in joint_names]
        _fail_on_missing_joints(table, missing, others, types)
    return tuple(joint_with_unit(table, named[n], types.get(n), options) for n in joint_names)


def _fail_on_missing_joints(
    table: Table,
    missing: Sequence[str],
    others: Sequence[str],
    types: Mapping[str, str],
) -> NoReturn:
    """Refuse a table without columns of joints; ``others`` are the columns that could be meant."""
    listed = [f"'{name}'{did_you_mean(name, others)}" for name in missing[:_LISTED_JOINTS]]
    unit = "mm" if types.get(missing[0]) == "prismatic" else "deg"
    header = f"{missing[0]} [{unit}]"
    of_brand = fix_for_brand([split_header(label)[0] for label in table.header])
    raise MeasurementError(
        f"{table.source}: no column for the joints {', '.join(listed)}. {list_columns(table)}"
        f"{of_brand} The header of such a column is '{header}'; another name is mapped by "
        f'--columns "name in the table={header}".'
    )


def _inferred_joints(table: Table, available: Named, types: Mapping[str, str]) -> Sequence[str]:
    """Return the names of the columns that can be joints: in angles, or of a known type."""
    names = []
    for name, column in available.items():
        unit = column.unit
        if unit is not None and (unit.quantity == "angle" or name in types):
            names.append(name)
    if not names:
        raise MeasurementError(
            f"{table.source}: no column of joint angles. {list_columns(table)} The header of such "
            "a column is the joint's name and a unit of angle, 'elbow_joint [deg]'."
        )
    return names


# Words, and what is not used


def _words(
    table: Table,
    named: Named,
    present: Sequence[Kind],
    *,
    by_column: bool,
    points_elsewhere: bool,
) -> dict[str, Column]:
    """Return the columns of words that are used; ``kind`` if ``by_column``."""
    used = ["row", "set", "target", "approach"]
    if by_column:
        used.append("kind")
    if points_elsewhere:
        used.append("point")
    if _OF_COMMANDS in named:  # its status says where a row has no command, and is empty
        used.append(STATUS)
    if any(kind.optical for kind in present):
        used += ["image", "corner"]
    words = {name: named[name] for name in used if name in named}
    for kind in present:
        if kind.paired:
            what = f"rows of the kind '{kind.name}'"
            words["pair"] = _needed(table, named, "pair", None, what)
    return words


def _unneeded(
    table: Table, named: Named, kinds: tuple[str, ...], *, points_elsewhere: bool
) -> list[Column]:
    """Return the columns that are not worth a warning: those that only a plan needs, and a ``kind`` that was given."""
    columns = []
    if "kind" in named and set(table.column(named["kind"])) <= set(kinds):
        columns.append(named["kind"])
    for name, column in named.items():
        if name.startswith(EXPECTED) or name == "point":
            columns.append(column)
    if points_elsewhere:  # a plan leaves them empty in all rows
        position = [named[name] for name in (*POINT, *ORIENTATION) if name in named]
        columns += [column for column in position if not any(table.column(column))]
    return columns


def _with_ignored(layout: Layout, table: Table, named: Named, *, points_elsewhere: bool) -> Layout:
    """Return a layout with the headers of the columns that it does not use, but for those that a fit does not need.

    Args:
        layout: The columns that are used.
        table: The table.
        named: Its columns by the names that calib uses.
        points_elsewhere: Whether the positions are in a file of their own.
    """
    columns = [*layout.words.values(), *layout.groups]
    for block in layout.blocks.values():
        columns += block
    columns += _unneeded(table, named, layout.kinds, points_elsewhere=points_elsewhere)
    indices = {column.index for column in columns}
    labels = []
    for i, label in enumerate(table.header):
        if label and i not in indices:
            labels.append(label)
    return replace(layout, ignored=tuple(labels))


def _needed(table: Table, named: Named, name: str, quantity: Quantity | None, what: str) -> Column:
    """Return the column of this name, in a unit of its quantity; None: a column of words.

    ``what`` needs the column, for the message.
    """
    if name in named:
        column = named[name]
        return column if quantity is None else with_unit(table, column, quantity)
    header = f"{name} [{COMMON[quantity]}]" if quantity else name
    kinds = " --kind fixed and --kind plane need no position." if name in POINT else ""
    raise MeasurementError(
        f"{table.source}: {what} need a column '{header}', and there is none. "
        f'{list_columns(table)} Another name is mapped by --columns "name in the table={header}".'
        f"{kinds}"
    )
