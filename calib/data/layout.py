"""Layout of a table of measurements: which column is what, and of what kinds its rows are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

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
    MOVE,
    ORDER,
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
    with_unit_elsewhere,
)
from calib.data.forms.column_options import (
    ColumnOptions,
    ColumnsInput,
    column_options,
    fix_for_brand,
)
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
    #: Columns of numbers that are used: ``joints`` in the order of the joints, ``torques``, ``moves``, ``order``,
    #: ``points``, ``board_points``, ``orientation`` (as many as its convention has), the noise of each unit (``sigma``,
    #: ``sigma_angle``), ``covariances``, 36 of them or none, and each reading of a kind by its name.
    blocks: Mapping[str, Columns]
    #: Kinds of the rows; more than one only with a column ``kind``.
    kinds: tuple[str, ...]
    #: Headers of the columns that are not used, except for those that a plan has and a fit does not need.
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
        needs_all_joints: bool = True,
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
            needs_all_joints: Whether each of the named joints must have a column; if not, one must.

        Returns:
            The layout.

        Raises:
            MeasurementError: A column is missing, there twice, without a unit or in a wrong one; there is no such kind;
                or the positions are in a file of their own, and no row is a ``point`` or some measure an orientation.
        """
        options = column_options(columns)
        named, groups = name_columns(table, joint_names or (), options)
        if joint_names is not None and not needs_all_joints and set(joint_names) & named.keys():
            joint_names = [name for name in joint_names if name in named]
        joints = _joints(table, named, joint_names, joint_types or {}, options)
        is_oriented = bool(conventions_of(table, named, joint_names or (), options))
        kinds = _kinds(table, named, kind, is_oriented, points_elsewhere=points_elsewhere)
        present = list(map(registry.get, kinds))
        if points_elsewhere and (any(k.orientation for k in present) or "point" not in kinds):
            raise MeasurementError(
                f"{table.source}: with a list of points (--points) rows are of the kind 'point', or of "
                f"kinds that measure no position; here they are {choices(kinds)}. Leave out the list, "
                "or the kind."
            )
        orientation: Orientation | None = None
        if any(kind.orientation for kind in present):
            orientation = find_orientation(table, named, joint_names or (), options)
        blocks = _blocks(
            table, named, present, joints, orientation, points_elsewhere=points_elsewhere
        )

        words = ["row", "set", "target", "approach"]
        if kind is None:
            words.append("kind")
        if points_elsewhere:
            words.append("point")
        if _OF_COMMANDS in named:  # its status says which rows have no command, and are empty
            words.append(STATUS)
        if any(kind.is_image for kind in present):
            words += ["image", "corner"]
        of_words = {name: named[name] for name in words if name in named}
        for paired in (kind for kind in present if kind.paired):
            what = f"rows of the kind '{paired.name}'"
            of_words["pair"] = _needed(table, named, "pair", None, what)

        used = {*of_words.values(), *groups}
        for block in blocks.values():
            used.update(block)
        # Not worth a warning are columns that only a plan needs, and a kind that was given.
        used.update(named[name] for name in named if name.startswith(EXPECTED) or name == "point")
        if "kind" in named and set(table.column(named["kind"])) <= set(kinds):
            used.add(named["kind"])
        if points_elsewhere:  # a plan leaves them empty in all rows
            position = [named[name] for name in (*POINT, *ORIENTATION) if name in named]
            used.update(column for column in position if not any(table.column(column)))
        indices = {column.index for column in used}
        ignored = [label for i, label in enumerate(table.header) if label and i not in indices]
        return cls(of_words, groups, blocks, kinds, tuple(ignored), orientation)


def _kinds(
    table: Table,
    named: Named,
    kind: str | None,
    is_oriented: bool,
    *,
    points_elsewhere: bool,
) -> tuple[str, ...]:
    """Return the names of the kinds of the rows: ``kind`` if given, those in the column ``kind``, or one by headers.

    It is ``point`` if none of them tells. MeasurementError on a word that names no kind; rows may have none.
    """
    if kind is not None:
        return (registry.get(kind).name,)
    known = registry.names()
    if "kind" in named:
        column = named["kind"]
        cells = table.column(column)
        for i, word in enumerate(cells):
            if word not in known and (word or not any(cells)):
                what = (
                    f"{plugins.unknown('kinds', word, known)} "
                    f'--columns "{column.label}=-" leaves the column out.'
                )
                table.fail(i, column, what, named.get("row"))
        return tuple(name for name in known if name in cells) or ("point",)
    if points_elsewhere:
        return ("point",)
    if is_oriented:
        return ("pose",)
    if any(name in named for name in POINT):
        return ("point",)
    # A kind whose readings are all there; of several the one that is paired as the table is.
    read = []
    for row in map(registry.get, known):
        columns = {reading.name for reading in row.readings}
        if columns and columns <= named.keys():
            read.append(row)
    read.sort(key=lambda row: row.paired != ("pair" in named))
    return (read[0].name,) if read else ("point",)


# Columns of numbers


def _blocks(
    table: Table,
    named: Named,
    present: Sequence[Kind],
    joints: Columns,
    orientation: Orientation | None,
    *,
    points_elsewhere: bool,
) -> dict[str, Columns]:
    """Return the columns of numbers that rows of the present kinds use, by what they hold, as `Layout.blocks`.

    MeasurementError if one that they need is missing or in a wrong unit; noise and torques may be missing.
    """
    covariances: Columns = ()
    given = [name for name in COVARIANCE if name in named]
    if given and any(kind.may_have_covariance for kind in present):
        missing = [name for name in COVARIANCE if name not in named]
        if missing:
            raise MeasurementError(
                f"{table.source}: there is a column '{given[0]}' and none '{missing[0]}'. A covariance has the columns "
                f"'{COVARIANCE[0]}' to '{COVARIANCE[-1]}': its 6 x 6 entries row by row, of x, y, z [m] and of the "
                "rotations about x, y, z [rad]."
            )
        what = "a covariance, in SI units"
        covariances = tuple(with_unit(table, named[name], None, what) for name in COVARIANCE)

    # Torques and last moves of the joints that have such a column, in the order of the joints.
    torques, moves = [], []
    for joint in joints:
        what = f"{'prismatic' if slides(joint) else 'revolute'} joint '{joint.name}'"
        torque = named.get(joint.name + TORQUE)
        if torque is not None and torque not in joints:
            quantity: Quantity = "force" if slides(joint) else "torque"
            torques.append(with_unit(table, torque, quantity, what))
        move = named.get(joint.name + MOVE)
        if move is not None and move not in joints:
            quantity = "length" if slides(joint) else "angle"
            moves.append(with_unit(table, move, quantity, what))

    blocks: dict[str, Columns] = {
        "joints": joints,
        "torques": tuple(torques),
        "moves": tuple(moves),
        "order": (named[ORDER],) if ORDER in named and named[ORDER] not in joints else (),
    }
    # Poses with a covariance have no other noise.
    with_noise = [kind for kind in present if not (covariances and kind.may_have_covariance)]
    for symbol, unit in RESIDUAL_UNITS.items():
        is_needed = any(symbol in kind.units for kind in with_noise)
        if is_needed and unit.sigma_name in named:
            column = with_unit(table, named[unit.sigma_name], unit.quantity)
            blocks[unit.sigma_name] = (column,)
    blocks["covariances"] = covariances
    positions = (
        (
            "points",
            POINT,
            not points_elsewhere and any(k.position for k in present),
            "measured points",
        ),
        (
            "board_points",
            BOARD_POINT,
            any(k.is_image for k in present),
            "images of a board's corners",
        ),
    )
    for block, names, is_used, what in positions:
        if is_used:
            blocks[block] = tuple(_needed(table, named, name, "length", what) for name in names)
    if orientation is not None:
        blocks["orientation"] = orientation.columns
    for kind in present:
        what = f"rows of the kind '{kind.name}'"
        for reading in kind.readings:
            column = _needed(table, named, reading.name, reading.quantity, what)
            blocks[reading.name] = (column,)
    return blocks


def slides(joint: Column) -> bool:
    """Return True if a joint's column is in a unit of length: the joint is prismatic."""
    return joint.unit is not None and joint.unit.quantity == "length"


def _joints(
    table: Table,
    named: Named,
    joint_names: Sequence[str] | None,
    types: Mapping[str, str],
    options: ColumnOptions,
) -> Columns:
    """Return the columns of joints, in the order of ``joint_names``; MeasurementError if one is missing.

    Without names: every column of angles, and of joints whose URDF type is known, except for names with another
    meaning, in the order of the table; MeasurementError if there is none.
    """
    taken = {*reserved(), *ORIENTATION}
    if joint_names is None:
        taken.update(*(row.columns for row in conventions_of(table, named, (), options)))
        taken.update(name + MOVE for name in named)
    available = {name: column for name, column in named.items() if name not in taken}
    if joint_names is None:
        joint_names = []
        for name, column in available.items():
            unit = column.unit
            if unit is not None and (unit.quantity == "angle" or name in types):
                joint_names.append(name)
        if not joint_names:
            raise MeasurementError(
                f"{table.source}: no column of joint angles. {list_columns(table)} The header of such "
                "a column is the joint's name and a unit of angle, 'elbow_joint [deg]'."
            )
    missing = [name for name in joint_names if name not in named]
    if missing:
        others = [name for name in available if name not in joint_names]
        listed = [f"'{name}'{did_you_mean(name, others)}" for name in missing[:_LISTED_JOINTS]]
        unit_symbol = "mm" if types.get(missing[0]) == "prismatic" else "deg"
        header = f"{missing[0]} [{unit_symbol}]"
        of_brand = fix_for_brand([split_header(label)[0] for label in table.header])
        elsewhere = with_unit_elsewhere(
            table, missing[0], "length" if unit_symbol == "mm" else "angle"
        )
        raise MeasurementError(
            f"{table.place}: no column for the joints {', '.join(listed)}. {list_columns(table)}"
            f"{of_brand}{elsewhere} The header of such a column is '{header}'; another name is mapped by "
            f'--columns "name in the table={header}".'
        )
    return tuple(joint_with_unit(table, named[n], types.get(n), options) for n in joint_names)


def _needed(table: Table, named: Named, name: str, quantity: Quantity | None, what: str) -> Column:
    """Return the column of this name, in a unit of the quantity (None: a column of words).

    MeasurementError if it is missing or has another unit; ``what`` says for the message which rows need it.
    """
    if name in named:
        column = named[name]
        return column if quantity is None else with_unit(table, column, quantity)
    header = f"{name} [{COMMON[quantity]}]" if quantity else name
    kinds = " --kind fixed, plane, face and clasp need no position." if name in POINT else ""
    raise MeasurementError(
        f"{table.place}: {what} need a column '{header}', and there is none. "
        f"{list_columns(table)}{with_unit_elsewhere(table, name, quantity)} "
        f'Another name is mapped by --columns "name in the table={header}".'
        f"{kinds}"
    )
