"""A plan as a table: one row for each pose to drive, with empty cells for what will be measured there.

Filled in, or beside an instrument's list of points, it is a table of measurements; see docs/planning.md. The forecast
that goes with it is a table of another kind, nested and in SI units, for a JSON file.
"""

from __future__ import annotations

import csv
import io
import math
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import calib.kinds as registry
from calib.design.forecast import Forecast
from calib.design.plan import Plan
from calib.errors import MeasurementError
from calib.measure.layout import Layout
from calib.measure.table import DEFAULT_TARGET, EXPECTED, POINT, QUATERNION, Table, name_columns
from calib.measure.values import Values
from calib.model.files import write_atomically
from calib.model.robot import Robot, read_only
from calib.version import __version__

Array = NDArray[np.float64]

SCHEMA = "plan 1"

#: Digits of degrees and millimetres: those that planned joint values have, and a tracker's last.
_DIGITS = 3

#: Joint values of more digits than this are written with all that they have [deg] or [mm].
_EXACT = 1e-9

#: The units that readings are written in, and how many of them are one in SI.
_WRITTEN = {"length": ("mm", 1e3), "angle": ("deg", 180.0 / math.pi)}


def write_plan(
    plan: Plan, path: str | Path, *, overwrite: bool = False, first_row: int = 1
) -> Path:
    """Write a plan as a CSV table, degrees and millimetres, in the order to drive.

    Several targets have a row each at a pose. Each row has the name of a point, ``P1`` for row 1, by which a list of
    points can be matched. The columns of what is measured are empty; ``expected`` columns say what the nominal robot
    would give, to compare.

    Args:
        plan: The plan.
        path: A CSV file.
        overwrite: Whether a file that exists is replaced.
        first_row: Number of the first row: where rows are to be added to a table, one more than its last.

    Raises:
        FileError: The file exists and ``overwrite`` is False, or it cannot be written.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_header(plan))
    writer.writerows(_rows(plan, first_row))
    return write_atomically(path, text.getvalue().encode(), overwrite=overwrite)


def _header(plan: Plan) -> list[str]:
    """The columns' names with their units."""
    types = plan.robot.joint_types
    joints = [
        f"{name} [{'mm' if types[name] == 'prismatic' else 'deg'}]"
        for name in plan.robot.joint_names
    ]
    named = ["target"] if _names_targets(plan) else []
    measured = _measured(plan)
    expected = [EXPECTED + name for name in measured if name not in QUATERNION]
    return ["row", "set", "point", *named, *joints, *measured, *expected]


def _rows(plan: Plan, first_row: int) -> Iterator[list[str]]:
    """The cells of each target at each pose."""
    slides = [plan.robot.joint_types[name] == "prismatic" for name in plan.robot.joint_names]
    scale = np.where(slides, 1e3, 180.0 / math.pi)
    kind = registry.get(plan.kind)
    empty = [""] * len(_measured(plan))
    factors = [_WRITTEN[one.quantity][1] for one in kind.readings]
    number = first_row
    for q, word, places in zip(plan.joints, plan.sets, plan.expected, strict=True):
        joints = [_number(value) for value in (q * scale).tolist()]
        for target, place in zip(plan.targets, places, strict=True):
            named = [target] if _names_targets(plan) else []
            seen = (1e3 * np.asarray(place)).tolist() if kind.position else []
            if kind.readings and kind.measure is not None:
                T = np.eye(4)
                T[:3, 3] = place
                read = kind.measure(T[None])[0, kind.size - len(kind.readings) :]
                seen += (read * factors).tolist()
            expected = [f"{value + 0.0:.{_DIGITS}f}" for value in seen]
            yield [str(number), word, f"P{number}", *named, *joints, *empty, *expected]
            number += 1


def _measured(plan: Plan) -> list[str]:
    """The columns of what is to be measured."""
    kind = registry.get(plan.kind)
    found = [f"{axis} [mm]" for axis in POINT] if kind.position else []
    found += QUATERNION if kind.orientation else ()
    return [*found, *(f"{one.name} [{_WRITTEN[one.quantity][0]}]" for one in kind.readings)]


def _names_targets(plan: Plan) -> bool:
    """Whether the rows say which target they are of."""
    return plan.targets != (DEFAULT_TARGET,)


def _number(value: float) -> str:
    """A joint value in deg or mm, with all of its digits."""
    short = round(value, _DIGITS) + 0.0
    return f"{short:.{_DIGITS}f}" if abs(value - short) < _EXACT else repr(value)


@dataclass(frozen=True, slots=True, eq=False)
class Taken:
    """Poses that were measured already.

    Attributes:
        joints: shape (T, m), [rad] or [m], in the order of the robot's joints; read-only.
        unmeasured: Numbers of the rows that hold no measurement yet, and do not count.
        validation: How many rows are ``validate``, and do not count either.
        last_row: The largest number of a row.
    """

    joints: Array
    unmeasured: tuple[int, ...]
    validation: int
    last_row: int


def read_taken(path: str | Path, robot: Robot, columns: Mapping[str, str] | None = None) -> Taken:
    """The poses of a table that a fit would estimate from: those measured, of the set ``estimate``.

    A table in which nothing is measured, such as a plan or a list of poses, counts whole: it is still to be driven.
    Rows that measure several targets at one pose are one pose.

    Args:
        path: A plan or a table of measurements; the joint values and which cells are empty are all that is read.
        robot: The robot.
        columns: Names of the table to names of calib, see `Measurements.read`.

    Raises:
        MeasurementError: The table cannot be read, or lacks a joint.
    """
    table = Table.read(path)
    values = _joint_values(table, robot, columns)
    measured = _measured_rows(table, robot, columns or {})
    if not any(measured):
        measured = [True] * len(measured)
    estimate = [word == "estimate" for word in values.sets]
    kept = [i for i, row in enumerate(measured) if row and estimate[i]]
    if not kept:
        raise MeasurementError(
            f"{table.source}: no row that is measured is 'estimate', so that no pose counts as taken. Leave out "
            "--taken, or correct the column 'set'."
        )
    return Taken(
        joints=read_only(values.joints[_poses(values, kept)]),
        unmeasured=tuple(row for row, seen in zip(values.rows, measured, strict=True) if not seen),
        validation=sum(
            seen and not fitted for seen, fitted in zip(measured, estimate, strict=True)
        ),
        last_row=max(values.rows),
    )


def _measured_rows(table: Table, robot: Robot, columns: Mapping[str, str]) -> list[bool]:
    """Whether each row holds a measurement, by its cells alone; rows that measure nothing count as such."""
    named, _ = name_columns(table, robot.joint_names, columns)
    at = [named[name].index for name in (*POINT, "distance", "pair") if name in named]
    kind = named.get("kind")
    rest = ("fixed", "plane")
    return [
        not at
        or any(row.cells[i] for i in at)
        or (kind is not None and row.cells[kind.index] in rest)
        for row in table.rows()
    ]


def _poses(values: Values, rows: list[int]) -> list[int]:
    """One row for each pose: of rows with the same joint values, as many as measure the same target."""
    most: Counter[bytes] = Counter()
    seen: Counter[tuple[bytes, str]] = Counter()
    kept = []
    for i in rows:
        pose = values.joints[i].tobytes()
        seen[pose, values.targets[i]] += 1
        if seen[pose, values.targets[i]] > most[pose]:
            most[pose] += 1
            kept.append(i)
    return kept


def read_pose_list(
    path: str | Path, robot: Robot, columns: Mapping[str, str] | None = None
) -> tuple[Array, tuple[str, ...]]:
    """The poses of a table, and the set of each; what was measured there is not read, and may be missing.

    Rows that measure several targets at one pose are one pose.

    Args:
        path: CSV with a column for each of ``robot.joint_names``, and a column ``set`` if there is one.
        robot: The robot.
        columns: Names of the table to names of calib, see `Measurements.read`.

    Returns:
        shape (N, m), [rad] or [m], read-only; and N words, ``"estimate"`` or ``"validate"``.

    Raises:
        MeasurementError: The table cannot be read, or lacks a joint.
    """
    values = _joint_values(Table.read(path), robot, columns)
    kept = _poses(values, list(range(len(values.joints))))
    return read_only(values.joints[kept]), tuple(values.sets[i] for i in kept)


def _joint_values(table: Table, robot: Robot, columns: Mapping[str, str] | None) -> Values:
    """What a table says but for what was measured."""
    # A row of this kind measures nothing but its joint values.
    layout = Layout.find(table, robot.joint_names, robot.joint_types, columns, "fixed")
    return Values.read(table, layout)


def plan_table(plan: Plan) -> dict[str, Any]:
    """A plan as nested tables in SI units, the unit in each key's suffix; docs/planning.md describes them."""
    robot = plan.robot
    return {
        "schema": SCHEMA,
        "calib": __version__,
        "robot": {
            "name": robot.name,
            "urdf": robot.urdf.source,
            "urdf_sha256": robot.urdf.sha256,
            "base": robot.base,
            "tip": robot.tip,
            "joints": [
                {"name": name, "unit": "m" if robot.joint_types[name] == "prismatic" else "rad"}
                for name in robot.joint_names
            ],
        },
        "asked": {
            "criterion": plan.criterion,
            "model": plan.model,
            "kind": plan.kind,
            "targets": list(plan.targets),
            "seed": plan.seed,
            "taken": len(plan.taken),
        },
        "poses": [
            {"set": word, "joints": q.tolist(), "expected_xyz_m": places.tolist()}
            for q, word, places in zip(plan.joints, plan.sets, plan.expected, strict=True)
        ],
        "candidates": {
            "drawn": plan.drawn,
            "kept": plan.candidates,
            "refused": dict(plan.refused),
        },
        "forecast": forecast_table(plan.forecast),
        "before": None if plan.before is None else forecast_table(plan.before),
        "at_random": forecast_table(plan.at_random),
        "ladder": [{"planned": n, **forecast_table(one)} for n, one in plan.ladder],
        "travel": {
            "largest_joint_moves": plan.travel,
            "blocked": [
                {
                    "from": one.start,
                    "to": one.end,
                    "by": None if one.by is None else one.by.tolist(),
                }
                for one in plan.blocked
            ],
        },
        "notes": list(plan.notes),
    }


def forecast_table(forecast: Forecast) -> dict[str, Any]:
    """A forecast as nested tables in SI units."""
    stds = forecast.parameter_std.tolist()
    return {
        "poses": forecast.poses,
        "rms_m": forecast.rms,
        "rms_low_m": forecast.rms_low,
        "rms_high_m": forecast.rms_high,
        "quantile_95_m": forecast.quantile_95,
        "max_m": forecast.max,
        "sigma_m": forecast.sigma,
        "rank": forecast.rank,
        "workspace_rank": forecast.workspace_rank,
        "columns": forecast.columns,
        "efficiency": forecast.efficiency,
        "indices": dict(forecast.indices),
        "parameters": [
            {"name": name, "unit": unit, "std": std, "identifiable": alone}
            for name, unit, std, alone in zip(
                forecast.names, forecast.units, stds, forecast.identifiable.tolist(), strict=True
            )
        ],
    }
