"""Which column of a table is what, of what kinds its rows are, and what they hold in SI units."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import compress
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import calib.data.kinds as registry
from calib.data.points_file import Points
from calib.data.table import (
    COMMON,
    EXPECTED,
    ORIENTATION,
    POINT,
    QUATERNION,
    ROTATION_VECTOR,
    SETS,
    STATUS,
    TORQUE,
    Column,
    Table,
    implausible,
    list_columns,
    name_columns,
    reserved,
    with_unit,
)
from calib.errors import MeasurementError, choices, did_you_mean
from calib.units import Array, Mask, Quantity

Columns = tuple[Column, ...]
Named = Mapping[str, Column]

_WHOLE = re.compile(r"[+-]?[0-9]{1,18}")

#: The blocks of several columns.
_WIDE = ("joints", "torques", "points", "orientation")

# Half of a column beyond this [rad]: hardly any joint turns so far, and degrees mostly do.
_TURNS_RAD = 7.0

# A quaternion written with four digits has length one to half of this.
_LENGTH_TOLERANCE = 1e-3


@dataclass(frozen=True, slots=True)
class Layout:
    """Which column of a table is what."""

    #: ``row``, ``set``, ``kind``, ``target``, ``pair``, ``point``, ``status`` that are used, by name.
    words: Named
    groups: Columns  #: Those whose words make the group's name, in the order of the table.
    #: The columns of numbers that are used: ``joints`` in the order asked for, ``torques``, ``points``, ``orientation``
    #: (three or four), ``sigma``, ``sigma_angle``, and each reading of a kind by its name.
    blocks: Mapping[str, Columns]
    kinds: tuple[str, ...]  #: Of the rows; more than one only with a column ``kind``.
    #: The headers of the columns that were not used, but for those that a plan has and a fit does not need.
    ignored: tuple[str, ...] = ()

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
            MeasurementError: A column is missing, there twice, without a unit or in a wrong one.
        """
        named, groups = name_columns(table, joint_names or (), columns or {})
        joints = _joints(table, named, joint_names, joint_types or {})
        kinds = _kinds(table, named, kind, points_elsewhere=points_elsewhere)
        present = [registry.get(name) for name in kinds]
        blocks = {
            "joints": joints,
            "torques": _torques(table, named, joints),
            "sigma": tuple(with_unit(table, named[n], "length") for n in ("sigma",) if n in named),
        }
        if any(one.position for one in present) and not points_elsewhere:
            blocks["points"] = tuple(
                _needed(table, named, name, "length", "measured points") for name in POINT
            )
        if any(one.orientation for one in present):
            blocks["orientation"] = _orientation(table, named)
        if any(one.angles for one in present) and "sigma_angle" in named:
            blocks["sigma_angle"] = (with_unit(table, named["sigma_angle"], "angle"),)
        used = ["row", "set", "target", *["kind"] * (kind is None), *["point"] * points_elsewhere]
        # A table of commands says in its status where a row has none, and its cells are empty.
        used += [STATUS] * ("correction position" in named)
        words = {name: named[name] for name in used if name in named}
        for one in present:
            what = f"rows of the kind '{one.name}'"
            for read in one.readings:
                blocks[read.name] = (_needed(table, named, read.name, read.quantity, what),)
            if one.paired:
                words["pair"] = _needed(table, named, "pair", None, what)
        taken = {c.index for block in (words.values(), groups, *blocks.values()) for c in block}
        taken |= {c.index for n, c in named.items() if n.startswith(EXPECTED) or n == "point"}
        if points_elsewhere:  # a plan leaves them empty in all rows
            plan = [named[n] for n in (*POINT, *ORIENTATION) if n in named]
            taken |= {c.index for c in plan if not any(table.column(c))}
        ignored = tuple(label for i, label in enumerate(table.header) if label and i not in taken)
        return cls(words, groups, blocks, kinds, ignored)


def _slides(joint: Column) -> bool:
    """Whether a joint's column is in a unit of length."""
    return joint.unit is not None and joint.unit.quantity == "length"


def _kinds(
    table: Table, named: Named, kind: str | None, *, points_elsewhere: bool
) -> tuple[str, ...]:
    """The kinds of the rows: as given, else from the column ``kind``, else from the columns there are."""
    kinds: tuple[str, ...] = ("point",)
    if kind is not None:
        kinds = (registry.get(kind).name,)
    elif "kind" in named:
        known, cells = registry.names(), table.column(named["kind"])
        for i in (i for i, word in enumerate(cells) if word not in known):
            what = (
                f"'{cells[i]}' is not a kind of measurement; allowed are {choices(known)}. --columns "
                f'"{named["kind"].label}=-" leaves the column out.'
            )
            table.fail(i, named["kind"], what, named.get("row"))
        kinds = tuple(one for one in known if one in cells) or kinds
    elif not points_elsewhere:
        every = [registry.get(name) for name in registry.names()]
        read = [k for k in every if k.readings and all(one.name in named for one in k.readings)]
        if any(named.keys() >= set(names) for names in (QUATERNION, ROTATION_VECTOR)):
            kinds = ("pose",)
        elif read and not any(name in named for name in POINT):
            kinds = (max(read, key=lambda one: one.paired == ("pair" in named)).name,)
    turned = any(registry.get(name).orientation for name in kinds)
    if points_elsewhere and (turned or "point" not in kinds):
        raise MeasurementError(
            f"{table.source}: with a list of points (--points) rows are of the kind 'point', or of kinds that measure "
            f"no position; here they are {choices(kinds)}. Leave out the list, or the kind."
        )
    return kinds


def _needed(table: Table, named: Named, name: str, quantity: Quantity | None, what: str) -> Column:
    """The column of this name, in a unit of its quantity (words have none)."""
    if name not in named:
        header = f"{name} [{COMMON[quantity]}]" if quantity else name
        kinds = " --kind fixed and --kind plane need no position." * (name in POINT)
        raise MeasurementError(
            f"{table.source}: {what} need a column '{header}', and there is none. {list_columns(table)} Another name "
            f'is mapped by --columns "name in the table={header}".{kinds}'
        )
    return named[name] if quantity is None else with_unit(table, named[name], quantity)


def _orientation(table: Table, named: Named) -> Columns:
    """The columns of a quaternion or of a rotation vector; of one of them."""
    there = [n for n in (QUATERNION, ROTATION_VECTOR) if named.keys() >= set(n)]
    if len(there) != 1:
        raise MeasurementError(
            f"{table.source}: rows of the kind 'pose' need one orientation: qx, qy, qz, qw (a quaternion, no unit) or "
            f"'rx [rad]', 'ry [rad]', 'rz [rad]' (a rotation vector). {list_columns(table)} --columns \"rx=-\" leaves "
            "one out; --kind point reads none."
        )
    if there[0] == QUATERNION:
        return tuple(with_unit(table, named[n], None, "a quaternion") for n in QUATERNION)
    return tuple(
        with_unit(table, named[n], "angle", "a rotation vector", "rad") for n in ROTATION_VECTOR
    )


def _torques(table: Table, named: Named, joints: Columns) -> Columns:
    """The columns of torques, those that there are, in the order of the joints."""
    found = []
    for joint in joints:
        column = named.get(joint.name + TORQUE)
        if column is not None and column not in joints:
            what = f"{'prismatic' if _slides(joint) else 'revolute'} joint '{joint.name}'"
            found.append(with_unit(table, column, "force" if _slides(joint) else "torque", what))
    return tuple(found)


def _joints(
    table: Table, named: Named, joint_names: Sequence[str] | None, types: Mapping[str, str]
) -> Columns:
    """The columns of the joints asked for, in that order; else those in angles, and known prismatic ones."""
    free = {n: c for n, c in named.items() if n not in (*reserved(), *ORIENTATION)}
    if joint_names is None:
        told = {n: c.unit for n, c in free.items() if c.unit}
        joint_names = [n for n, unit in told.items() if unit.quantity == "angle" or n in types]
        if not joint_names:
            raise MeasurementError(
                f"{table.source}: no column of joint angles. {list_columns(table)} The header of such a column is the "
                "joint's name and a unit of angle, 'elbow_joint [deg]'."
            )
    missing = [name for name in joint_names if name not in named]
    if missing:
        others = [name for name in free if name not in joint_names]
        listed = ", ".join(f"'{name}'{did_you_mean(name, others)}" for name in missing[:12])
        header = f"{missing[0]} [{'mm' if types.get(missing[0]) == 'prismatic' else 'deg'}]"
        raise MeasurementError(
            f"{table.source}: no column for the joints {listed}. {list_columns(table)} The header of "
            f"such a column is '{header}'; another name is mapped by --columns \"name in the table={header}\"."
        )
    joints = tuple(named[name] for name in joint_names)
    for column in joints:
        kind = types.get(column.name)
        if kind is not None or column.unit is None:
            quantity: Quantity = "length" if kind == "prismatic" else "angle"
            with_unit(table, column, quantity, f"{kind or 'revolute'} joint '{column.name}'")
    return joints


# Values


def read_values(table: Table, layout: Layout, elsewhere: Points | None = None) -> dict[str, Any]:
    """What the rows hold, but for those in which all cells of the measurement are empty: arguments of `Measurements`.

    The points of the rows may stand ``elsewhere``: the rows name them (those of others are left out), or are in its
    order.

    Raises:
        MeasurementError: A cell or a column's values cannot be used, a point is not there or is that of another row,
            or nothing is measured.
    """
    columns = {name: block for name, block in layout.blocks.items() if block}
    written = table.numbers([column for block in columns.values() for column in block])
    grid, end = {}, 0
    for name, block in columns.items():
        grid[name] = written[:, end : end + len(block)]
        end += len(block)
    count = len(table.cells)
    kinds = np.full(count, layout.kinds[0])
    if "kind" in layout.words:
        kinds = np.array(table.column(layout.words["kind"]), dtype=np.str_)
    measured = _measured(table, layout, grid, kinds)
    if not measured.any():
        listed = ", or give the instrument's list of points (--points)" * ("point" in layout.kinds)
        raise MeasurementError(
            f"{table.source}: nothing is measured yet in its {count} rows. Fill in what was measured at each "
            f"pose{listed}."
            if count
            else f"{table.source}: there is a header, and no row below it."
        )
    present = [registry.get(name) for name in layout.kinds]
    paired = np.isin(kinds, [kind.name for kind in present if kind.paired])
    placed = np.isin(kinds, [kind.name for kind in present if kind.position])
    told = {"target": measured, "pair": measured & paired, "point": measured & placed}
    words = _words(table, layout, told)
    every = list(map(int, words["row"])) if "row" in words else list(range(1, count + 1))
    if elsewhere is not None:
        at = np.flatnonzero(measured & placed)
        names = [words["point"][i] for i in at] if "point" in words else None
        points = np.full((count, 3), np.nan)
        found = elsewhere.of_rows(table.source, [every[i] for i in at], names)
        points[at] = elsewhere.points[found]
        measured[at] = np.array(found, dtype=np.intp) >= 0
    _check_sets(table, layout, words.get("set", ()), measured)
    words = {name: list(compress(found, measured)) for name, found in words.items()}
    _check_units(
        table, layout, {n: np.where(measured[:, None], v, np.nan) for n, v in grid.items()}
    )
    si = {
        name: values[measured] * [column.to_si for column in columns[name]]
        for name, values in grid.items()
    }
    if elsewhere is not None:
        si["points"] = points[measured]
    joints, torques = {c.name: _slides(c) for c in layout.blocks["joints"]}, None
    if "torques" in si:
        torques = np.full((measured.sum(), len(joints)), np.nan)
        driven = [c.name.removesuffix(TORQUE) for c in layout.blocks["torques"]]
        torques[:, [[*joints].index(name) for name in driven]] = si["torques"]
    single = {name: block[:, 0] for name, block in si.items() if name not in _WIDE}
    readings = {name: single[name] for name in registry.readings() if name in single}
    files = [one for one in (table, elsewhere) if one is not None]
    return {
        "source": " + ".join(one.source for one in files),
        "sha256": " + ".join(one.sha256 for one in files),
        "ignored": layout.ignored,
        "joint_names": [*joints],
        "prismatic": [name for name, slides in joints.items() if slides],
        "joints": si.get("joints", np.empty((measured.sum(), 0))),
        "points": si.get("points", np.full((measured.sum(), 3), np.nan)),
        "sets": words.get("set", ()),
        "sigma": single.get("sigma"),
        "targets": words.get("target", ()),
        "groups": words.get("group", ()),
        "rows": list(compress(every, measured)),
        "kinds": kinds[measured].tolist(),
        "rotations": _matrices(si["orientation"]) if "orientation" in si else None,
        "distances": readings.pop("distance", None),
        "readings": readings,
        "sigma_angle": single.get("sigma_angle"),
        "pairs": words.get("pair", ()),
        "torques": torques,
        "unmeasured": list(compress(every, ~measured)),
    }


def _check_sets(table: Table, layout: Layout, sets: Sequence[str], measured: Mask) -> None:
    """Refuse words of the column ``set``, one for each row, that are no set in a row that is measured."""
    for word in set(sets) - set(SETS):
        column = layout.words["set"]
        what = (
            f"'{word}' is no set; allowed are {choices(SETS)}. Correct it; if the column means something else, "
            f'--columns "{column.label}=-" leaves it out.'
        )
        for i in np.flatnonzero(measured).tolist():
            if sets[i] == word:
                table.fail(i, column, what, layout.words.get("row"))


def _words(table: Table, layout: Layout, told: Mapping[str, Mask]) -> dict[str, list[str]]:
    """The words of all rows, by their columns; none is empty where a row must have it."""
    words = {name: table.column(column) for name, column in layout.words.items()}
    if layout.groups:
        words["group"] = ["/".join(row[c.index] for c in layout.groups) for row in table.cells]
    for i in (i for i, text in enumerate(words.get("row", ())) if not _WHOLE.fullmatch(text)):
        what = f"'{words['row'][i]}' is not a whole number. Number the rows."
        table.fail(i, layout.words["row"], what)
    for name in told.keys() & layout.words.keys():
        for i in (i for i in np.flatnonzero(told[name]).tolist() if not words[name][i]):
            what = "the cell is empty. Fill it in, or remove the row."
            table.fail(i, layout.words[name], what, layout.words.get("row"))
    return words


def _measured(
    table: Table, layout: Layout, grid: dict[str, Array], kinds: NDArray[np.str_]
) -> Mask:
    """Whether anything is measured in each row; in ``grid`` NaN replaces what a row's kind lacks."""
    measured = np.ones(len(table.cells), dtype=np.bool_)
    if STATUS in layout.words:
        status = table.column(layout.words[STATUS])
        measured &= [not word.startswith("no command: ") for word in status]
    for kind in map(registry.get, layout.kinds):
        of_kind = kinds == kind.name
        names = ["points"] * kind.position + ["orientation"] * kind.orientation
        # None if rows measure nothing, or their points stand elsewhere.
        own = [n for n in (*names, *(one.name for one in kind.readings)) if n in grid]
        if own and not kind.paired:  # one row of a pair has the measurement of both
            measured &= ~(of_kind & np.isnan(np.hstack([grid[n] for n in own])).all(axis=1))
        used = {"joints", "torques", "sigma", *["sigma_angle"] * (kind.angles > 0), *own}
        for name, values in grid.items():
            if name not in used:
                values[of_kind] = np.nan
                continue
            bad = ~np.isfinite(values) & (of_kind & measured)[:, None]
            if kind.paired and name in own:
                bad &= ~np.isnan(values)
            if bad.any():
                i, k = map(int, np.argwhere(bad)[0])
                _no_number(table, layout, i, layout.blocks[name][k])
    return measured


def _no_number(table: Table, layout: Layout, row: int, column: Column) -> NoReturn:
    """Refuse a cell in which a finite number should stand."""
    text = table.cells[row][column.index][:80]
    what = f"'{text}' is not a finite number. Write it as 123.45; the unit is in the header."
    if not text:
        what = "the cell is empty. Fill in the number, or remove the row."
    elif "," in text:
        what = (
            f"'{text}' has a decimal comma. Write a point, or put semicolons between the columns."
        )
    table.fail(row, column, what, layout.words.get("row"))


def _matrices(values: Array) -> Array:
    """Rotation matrices, (N, 3, 3), of quaternions (N, 4) or of vectors (N, 3) [rad]; NaN rows stay NaN."""
    result = np.full((len(values), 3, 3), np.nan)
    there = np.isfinite(values).all(axis=1)
    if there.any():
        make = Rotation.from_quat if values.shape[1] == 4 else Rotation.from_rotvec
        result[there] = make(values[there]).as_matrix()
    return result


@np.errstate(over="ignore")  # what is infinite is too large as well
def _check_units(table: Table, layout: Layout, grid: Mapping[str, Array]) -> None:
    """Refuse metres read as millimetres, degrees as radians, in the numbers as written, NaN where a row has none."""
    lengths = {
        n: one.positive for n, one in registry.readings().items() if one.quantity == "length"
    }
    for name, numbers in grid.items():
        columns = layout.blocks[name]
        # A place or an orientation is told by all of its columns, a joint by its own.
        single = [([column], numbers[:, [k]]) for k, column in enumerate(columns)]
        for own, values in single if name == "joints" else [(list(columns), numbers)]:
            there = np.isfinite(values).all(axis=1)
            units = [column.unit for column in own if column.unit]
            if not there.any():
                continue
            size, fault = np.linalg.norm(values, axis=1), None
            if name == "orientation" and not units:
                wrong = np.flatnonzero(np.abs(size - 1.0) > _LENGTH_TOLERANCE)
                if wrong.size:
                    what = f"the quaternion has the length {size[wrong[0]]:.6g}; that of an orientation is 1."
                    fault = int(wrong[0]), 0, what
            elif name in ("orientation", "joints") and {unit.symbol for unit in units} == {"rad"}:
                if np.median(size[there]) > _TURNS_RAD:
                    raise MeasurementError(
                        f"{table.source}, column '{own[0].label}': half of the values are beyond "
                        f"{np.median(size[there]):.4g} rad, more than a turn; they look like degrees. If they are, "
                        f"write '{own[0].name} [deg]' into the header."
                    )
            elif name in ("points", *lengths) or (
                name == "joints" and units[0].quantity == "length"
            ):
                near = name == "points" or lengths.get(name, False)
                fault = implausible(values, units, near=near)
            if fault is not None:
                table.fail(fault[0], own[fault[1]], fault[2], layout.words.get("row"))
