"""A plan as files, and the poses of a table.

The table has a row for each pose, with empty cells for what will be measured there; filled in, or beside an
instrument's list of points, it is a table of measurements. Plan and forecast as nested tables, in SI units, are for a
JSON file. See docs/planning.md.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import calib.data.kinds as registry
from calib.basics.arrays import Array, Mask, read_only
from calib.basics.channels import RESIDUAL_UNITS
from calib.basics.files import csv_bytes, write_atomically
from calib.basics.tables import Table
from calib.basics.units import Quantity
from calib.data.columns import DEFAULT_TARGET, EXPECTED, POINT, name_columns
from calib.data.forms.column_options import ColumnsInput
from calib.data.forms.orientations import QUATERNION
from calib.data.layout import Layout
from calib.data.measurements import Measurements
from calib.data.values import read_values
from calib.errors import MeasurementError
from calib.robot.coupled_readings import coupling_table
from calib.robot.robot import Robot
from calib.verbs.plan.forecast import Forecast
from calib.verbs.plan.plan import Plan
from calib.version import __version__

SCHEMA = "plan 2"

#: Digits of degrees and millimetres: those that planned joint values have, and a tracker's last.
_DIGITS = 3

#: Units that values are written in, and their number in one SI unit.
_WRITTEN = {unit.quantity: (unit.shown, unit.to_shown) for unit in RESIDUAL_UNITS.values()}

#: Kinds whose rows measure something without a cell of their own.
_WITHOUT_CELLS = ("fixed", "plane")


# The table


def write_plan(
    plan: Plan,
    path: str | Path,
    *,
    overwrite: bool = False,
    first_row: int = 1,
) -> Path:
    """Write a plan as a CSV table, degrees and millimetres, in the order to drive; several targets have a row each.

    The columns of what is measured are empty; ``expected`` columns are what the nominal robot would give.

    Args:
        plan: The plan: joint values of the poses [rad] or [m], in the order to drive; ``"estimate"`` or ``"validate"``
            for each; and where each target is expected in the measurement frame [m].
        path: The file.
        overwrite: Whether an existing file is replaced.
        first_row: Number of the first row: where rows are to be added to a table, one more than its last.

    Returns:
        The path of the file.

    Raises:
        FileError: It cannot be written.
    """
    rows = list(_rows(plan, first_row))
    table = [list(rows[0]), *(row.values() for row in rows)]
    return write_atomically(path, csv_bytes(table), overwrite=overwrite)


class _Column(NamedTuple):
    """Column of numbers: its header with the unit, and the number of that unit in one SI unit."""

    #: Name and unit, ``"x [mm]"``.
    header: str
    #: Number of the unit in one SI unit: 1000 for mm.
    scale: float

    @classmethod
    def of(cls, name: str, quantity: Quantity) -> _Column:
        """Return the column of a quantity, in the unit that tables are written in: mm, deg or px.

        Args:
            name: Name of the column, without a unit.
            quantity: ``"length"``, ``"angle"`` or ``"pixel"``.

        Returns:
            The column: its header, such as ``"x [mm]"``, and the number of its unit in one SI unit, 1000 or 180 / pi.
        """
        unit, scale = _WRITTEN[quantity]
        return cls(f"{name} [{unit}]", scale)

    def cell(self, value: float) -> str:
        """Return the text of a number in the unit of the column, with three decimals and no minus before a zero.

        Uses ``scale``, the number of the column's unit in one SI unit, such as 1000 for mm.

        Args:
            value: The number in SI units [m] or [rad].
        """
        return f"{self.scale * value + 0.0:.{_DIGITS}f}"

    def expected(self) -> _Column:
        """Return the column, in the same unit, of what the nominal robot would give in place of what is measured.

        Its header has ``"expected "`` before this one, such as ``"expected x [mm]"``.
        """
        return _Column(EXPECTED + self.header, self.scale)


@dataclass(frozen=True, slots=True)
class _Columns:
    """Columns of a plan's table, besides row, set, point and target."""

    #: Columns of the joint values.
    joints: list[_Column]
    #: Headers of what is to be measured.
    empty: list[str]
    #: Columns of what the nominal robot would give.
    expected: list[_Column]
    #: Index of each of these among the numbers that a row of the kind measures, from 0.
    measured: list[int]

    @classmethod
    def of(cls, plan: Plan) -> _Columns:
        """Return the columns for a plan's robot and kind of measurement.

        Args:
            plan: ``plan.robot``, whose measured joints have a column each, and ``plan.kind``, the name of the kind,
                which says what is measured: a position, an orientation, other readings such as a distance.

        Returns:
            ``joints``, columns of the joint values; ``empty``, headers of what is to be measured: x, y, z, quaternion,
            readings, as the kind has them; ``expected``, columns of what the nominal robot would give of these, but for
            the orientation; ``measured``, the index of each of ``expected``, from 0, among the numbers that a row of
            the kind measures (x, y, z, the 9 entries of a rotation matrix, readings).
        """
        kind = registry.get(plan.kind)
        lengths = [_Column.of(axis, "length") for axis in POINT] if kind.position else []
        readings = [_Column.of(reading.name, reading.quantity) for reading in kind.readings]
        empty = [column.header for column in lengths]
        if kind.orientation:
            empty += QUATERNION.columns
        empty += [column.header for column in readings]
        first_reading = kind.size - len(readings)
        return cls(
            joints=_joint_columns(plan.robot),
            empty=empty,
            expected=[column.expected() for column in (*lengths, *readings)],
            measured=[*range(len(lengths)), *range(first_reading, kind.size)],
        )


def joint_cells(robot: Robot, q: Array) -> dict[str, str]:
    """Return the texts of joint values (m,) [rad] or [m], by the headers of their columns, as ``robot.joint_names``."""
    return _cells(_joint_columns(robot), q)


def _joint_columns(robot: Robot) -> list[_Column]:
    """Return the columns of the m joint values, degrees or for sliding joints millimetres, as ``robot.joint_names``."""
    columns = []
    for name, joint_type in robot.joint_types.items():
        quantity: Quantity = "length" if joint_type == "prismatic" else "angle"
        columns.append(_Column.of(name, quantity))
    return columns


def _rows(plan: Plan, number: int) -> Iterator[dict[str, str]]:
    """Yield the rows of a plan's table: one for each target at each pose, in the order to drive.

    Args:
        plan: The plan: ``joints``, joint values of the K poses, shape (K, m), [rad] or [m]; ``sets``, ``"estimate"`` or
            ``"validate"`` for each; ``targets``, names of the k targets; ``expected``, their positions in the
            measurement frame by the nominal robot, shape (K, k, 3), [m]; ``kind``, the name of the kind of measurement.
        number: Number of the first row; a point is named after its row, ``"P1"``.

    Yields:
        Texts of the cells by the headers of their columns, the same headers in the same order for all rows: row, set,
        point, target (only if there are several, or a name was given), joint values, what is to be measured (empty),
        and what is expected; lengths in mm, angles in deg.
    """
    columns = _Columns.of(plan)
    for q, set_name, places in zip(plan.joints, plan.sets, plan.expected, strict=True):
        for target, place in zip(plan.targets, places, strict=True):
            row = {"row": str(number), "set": set_name, "point": f"P{number}"}
            if plan.targets != (DEFAULT_TARGET,):
                row["target"] = target
            row |= _cells(columns.joints, q)
            row |= dict.fromkeys(columns.empty, "")
            row |= _expected_cells(plan.kind, columns, place)
            yield row
            number += 1


def _cells(columns: list[_Column], values: Array) -> dict[str, str]:
    """Return the texts of numbers, by the headers of their columns.

    Args:
        columns: One column for each number, with its header and unit, mm or deg.
        values: The numbers in SI units [m] or [rad], as many as columns.
    """
    cells = {}
    for column, value in zip(columns, values, strict=True):
        cells[column.header] = column.cell(value)
    return cells


def _expected_cells(kind_name: str, columns: _Columns, place: Array) -> dict[str, str]:
    """Return the texts of what a perfect instrument would measure of a target, by the headers of their columns.

    Args:
        kind_name: Name of the kind of measurement, such as ``"point"``.
        columns: ``columns.expected``, the columns to fill, and ``columns.measured``, the index of each, from 0, among
            the numbers that a row of the kind measures.
        place: Position of the target in the measurement frame, shape (3,), [m].

    Returns:
        The cells of the ``expected`` columns, in mm or deg; none of a kind that measures nothing, such as a ball in a
        socket.
    """
    kind = registry.get(kind_name)
    if kind.measure is None:
        return {}
    T_frame_target = np.eye(4)
    T_frame_target[:3, 3] = place
    values = kind.measure(T_frame_target[None])[0, columns.measured]
    return _cells(columns.expected, values)


class Poses(NamedTuple):
    """Poses of a table."""

    #: Shape (N, m), [rad] or [m].
    joints: Array
    #: ``"estimate"`` or ``"validate"`` for each.
    sets: tuple[str, ...]
    #: Largest number of a row of the table.
    last_row: int


def read_poses(
    path: str | Path, robot: Robot, columns: ColumnsInput = None, *, taken: bool = False
) -> Poses:
    """Read the poses of a table in which measurements may be missing; several targets at one pose are one pose.

    Args:
        path: Path of the table.
        robot: The robot, whose m measured joints have a column each in the table.
        columns: What is said of the columns, as by ``--columns``; None: nothing.
        taken: Whether only those are read that a fit would estimate from, measured and of the set ``estimate``; in a
            table in which nothing is measured, such as a plan that is still to be driven, all poses of that set.

    Returns:
        The poses in the table's order: ``joints``, joint values, shape (N, m), [rad] or for sliding joints [m], columns
        as ``robot.joint_names``; ``sets``, ``"estimate"`` or ``"validate"`` for each; and ``last_row``, the largest row
        number of the whole table.

    Raises:
        MeasurementError: The table cannot be read as one of this robot, or no row is left.
    """
    table = Table.read(path)
    # A row of the kind ``fixed`` has its joint values alone.
    layout = Layout.find(table, robot.joint_names, robot.joint_types, columns, "fixed")
    rows = Measurements(**read_values(table, layout))
    chosen = np.ones(len(rows), dtype=np.bool_)
    if taken:
        measured = _measured_rows(table, robot)
        chosen = rows.estimation & (measured | (not measured.any()))
        if not chosen.any():
            raise MeasurementError(f"{table.source}: no row that is measured is 'estimate'.")
    first = _first_of_each_pose(rows, chosen)
    sets = tuple(rows.sets[i] for i in first)
    return Poses(read_only(rows.joints[first]), sets, max(rows.rows))


def _measured_rows(table: Table, robot: Robot) -> Mask:
    """Find the rows of a table that measure something: a cell of a measured column has text, or the kind needs none.

    Measured columns are x, y, z, ``distance`` and ``pair``; rows of the kinds ``fixed`` and ``plane`` need none.

    Args:
        table: The table of N rows, its cells as text.
        robot: The robot, whose measured joints have a column each in the table.

    Returns:
        True for rows that measure something, shape (N,).
    """
    named, _ = name_columns(table, robot.joint_names, {})
    columns = [named[name].index for name in (*POINT, "distance", "pair") if name in named]
    kinds = [""] * len(table.cells)
    if "kind" in named:
        kinds = table.column(named["kind"])
    measured = []
    for cells, kind in zip(table.cells, kinds, strict=True):
        has_value = any(cells[i] for i in columns)
        measured.append(has_value or kind in _WITHOUT_CELLS)
    return np.array(measured)


def _first_of_each_pose(rows: Measurements, chosen: Mask) -> list[int]:
    """Return the first row of each pose.

    Rows with the same joint values are one pose where their targets differ; where a target comes again, another pose, a
    repetition of the first, has begun.

    Args:
        rows: N rows of a table: ``joints``, their joint values, shape (N, m), [rad] or [m]; ``targets``, the name of
            the target of each.
        chosen: Rows that count, shape (N,).

    Returns:
        Indices of rows, from 0, in rising order, one for each pose.
    """
    repeats: Counter[tuple[bytes, str]] = Counter()
    first: dict[tuple[bytes, int], int] = {}
    for i in np.flatnonzero(chosen).tolist():
        pose, target = rows.joints[i].tobytes(), rows.targets[i]
        first.setdefault((pose, repeats[pose, target]), i)
        repeats[pose, target] += 1
    return [*first.values()]


# Nested tables


def plan_table(plan: Plan) -> dict[str, Any]:
    """Return a plan as nested tables for a JSON file, in SI units; docs/planning.md describes them.

    Args:
        plan: The plan.

    Returns:
        Texts, numbers, arrays, lists or tables of these by their keys: ``schema``, ``calib`` (the version), ``robot``,
        ``asked`` (what was planned for), ``poses`` (in the order to drive: the set, the joint values [rad] or [m], and
        the expected position of each target in the measurement frame [m]), ``candidates``
        (numbers of poses drawn, kept and refused), the forecasts ``forecast``, ``before`` (None where no poses were
        taken), ``at_random`` and ``ladder``, ``travel`` (sum over all moves of the largest joint move [rad or m], and
        the blocked moves), and ``notes``.
    """
    request = plan.request
    poses = []
    for set_name, q, places in zip(plan.sets, plan.joints, plan.expected, strict=True):
        poses.append({"set": set_name, "joints": q, "expected_xyz_m": places})
    if plan.sight is not None:
        T_camera_board = plan.sight.board_poses(plan.robot, plan.joints)
        tilts = plan.sight.tilts(T_camera_board).tolist()
        poses = [{**pose, "tilt_rad": tilt} for pose, tilt in zip(poses, tilts, strict=True)]
    blocked = [{"from": move.start, "to": move.end, "by": move.by} for move in plan.blocked]
    return {
        "schema": SCHEMA,
        "calib": __version__,
        "robot": _robot_table(plan.robot),
        "asked": {
            "criterion": request.criterion,
            "model": plan.model,
            "kind": plan.kind,
            "targets": plan.targets,
            "seed": request.seed,
            "taken": len(plan.taken),
        },
        "poses": poses,
        "candidates": {"drawn": plan.drawn, "kept": plan.candidates, "refused": dict(plan.refused)},
        "forecast": forecast_table(plan.forecast),
        "before": None if plan.before is None else forecast_table(plan.before),
        "at_random": forecast_table(plan.at_random),
        "ladder": [{"planned": n, **forecast_table(forecast)} for n, forecast in plan.ladder],
        "travel": {"largest_joint_moves": plan.travel, "blocked": blocked},
        "notes": [note._asdict() for note in plan.notes],
    }


def _robot_table(robot: Robot) -> dict[str, Any]:
    """Return a robot's URDF, chain and measured joints as tables for a JSON file.

    Returns:
        ``name``; ``urdf``, the name of its file, and ``urdf_sha256`` of its bytes; ``base`` and ``tip``, the links that
        the chain leads between; ``joints``, the ``name`` and ``unit``, ``"rad"`` or ``"m"``, of each column of the
        joint values; ``coupling``, of coupled readings, a row for each factor: ``joint``, ``reading``, ``factor``.
    """
    joints = []
    for name, joint_type in robot.joint_types.items():
        unit = "m" if joint_type == "prismatic" else "rad"
        joints.append({"name": name, "unit": unit})
    return {
        "name": robot.name,
        "urdf": robot.urdf.source,
        "urdf_sha256": robot.urdf.sha256,
        "base": robot.base,
        "tip": robot.tip,
        "joints": joints,
        "coupling": coupling_table(robot.reading_coupling),
    }


def forecast_table(forecast: Forecast) -> dict[str, Any]:
    """Return a forecast as nested tables for a JSON file, in SI units.

    Args:
        forecast: Expected accuracy of a fit, over the workspace and of each parameter.

    Returns:
        The counts ``poses``, ``rank``, ``workspace_rank`` and ``columns`` (parameters); ``rms_m``, ``rms_low_m``,
        ``rms_high_m`` and ``max_m``, errors of a predicted position over the workspace [m]; ``sigma``, the noise of one
        scalar by its unit; ``indices``, the observability indices by name; and ``parameters``, for each its
        ``name``, ``unit``, ``std`` (standard deviation in that unit) and whether it is ``identifiable``.
    """
    counts = ("poses", "rank", "workspace_rank", "columns")
    lengths = ("rms", "rms_low", "rms_high", "max")
    parameters = zip(
        forecast.names,
        forecast.units,
        forecast.parameter_std,
        forecast.identifiable,
        strict=True,
    )
    keys = ("name", "unit", "std", "identifiable")
    return {
        **{name: getattr(forecast, name) for name in counts},
        **{f"{name}_m": getattr(forecast, name) for name in lengths},
        "sigma": dict(forecast.sigma),
        "indices": dict(forecast.indices),
        "parameters": [dict(zip(keys, row, strict=True)) for row in parameters],
    }
