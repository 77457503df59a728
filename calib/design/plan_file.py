"""A plan as a table: one row for each pose to drive, with empty cells for what will be measured there.

Filled in, or beside an instrument's list of points, it is a table of measurements; see docs/planning.md. The forecast
that goes with it is a table of another kind, nested and in SI units, for a JSON file.
"""

from __future__ import annotations

import csv
import io
import math
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import calib.data.kinds as registry
from calib.data.layout import Layout
from calib.data.table import DEFAULT_TARGET, EXPECTED, POINT, QUATERNION, Table, name_columns
from calib.data.values import Values, read_values
from calib.design.forecast import Forecast
from calib.design.plan import Plan
from calib.errors import MeasurementError
from calib.files import write_atomically
from calib.robot.robot import Robot, read_only
from calib.version import __version__

Array = NDArray[np.float64]

SCHEMA = "plan 1"

#: Digits of degrees and millimetres: those that planned joint values have, and a tracker's last.
_DIGITS = 3

#: The units that values are written in, and how many of them are one in SI.
_WRITTEN = {"length": ("mm", 1e3), "angle": ("deg", 180.0 / math.pi)}


def write_plan(
    plan: Plan, path: str | Path, *, overwrite: bool = False, first_row: int = 1
) -> Path:
    """Write a plan as a CSV table, degrees and millimetres, in the order to drive; several targets have a row each.

    The columns of what is measured are empty; ``expected`` columns are what the nominal robot would give. ``first_row``
    is the number of the first row: where rows are to be added to a table, one more than its last.
    """
    rows = list(_rows(plan, first_row))
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return write_atomically(path, text.getvalue().encode(), overwrite=overwrite)


def _rows(plan: Plan, number: int) -> Iterator[dict[str, str]]:
    """The cells of each target at each pose, by their columns."""
    types, kind = plan.robot.joint_types, registry.get(plan.kind)
    units = [
        _WRITTEN["length" if types[n] == "prismatic" else "angle"] for n in plan.robot.joint_names
    ]
    lengths = [f"{axis} [mm]" for axis in POINT] if kind.position else []
    written = [_WRITTEN[one.quantity] for one in kind.readings]
    readings = [f"{r.name} [{unit}]" for r, (unit, _) in zip(kind.readings, written, strict=True)]
    empty = [*lengths, *(QUATERNION if kind.orientation else ()), *readings]
    for q, word, places in zip(plan.joints, plan.sets, plan.expected, strict=True):
        for target, place in zip(plan.targets, places, strict=True):
            row = {"row": str(number), "set": word, "point": f"P{number}"}
            if plan.targets != (DEFAULT_TARGET,):
                row["target"] = target
            for name, (unit, scale), value in zip(plan.robot.joint_names, units, q, strict=True):
                row[f"{name} [{unit}]"] = f"{scale * value + 0.0:.{_DIGITS}f}"
            row |= dict.fromkeys(empty, "")
            seen = (1e3 * np.asarray(place)).tolist() if kind.position else []
            if kind.readings and kind.measure is not None:
                T = np.eye(4)
                T[:3, 3] = place
                read = kind.measure(T[None])[0, kind.size - len(kind.readings) :]
                seen += (read * [factor for _, factor in written]).tolist()
            for column, value in zip((*lengths, *readings), seen, strict=True):
                row[EXPECTED + column] = f"{value + 0.0:.{_DIGITS}f}"
            yield row
            number += 1


@dataclass(frozen=True, slots=True, eq=False)
class Taken:
    """Poses that were measured already.

    ``joints``, shape (T, m), [rad] or [m], read-only, the largest number of a row, and the table's name.
    """

    joints: Array
    last_row: int
    source: str


def read_taken(path: str | Path, robot: Robot) -> Taken:
    """The poses of a table that a fit would estimate from: those measured, of the set ``estimate``.

    A table in which nothing is measured, such as a plan that is still to be driven, counts whole. Rows that measure
    several targets at one pose are one pose.
    """
    table, values = _joint_values(path, robot)
    named, _ = name_columns(table, robot.joint_names, {})
    at = [named[name].index for name in (*POINT, "distance", "pair") if name in named]
    # By the cells alone; a row that measures nothing, of a socket or a plane, counts.
    kind = [named["kind"].index] if "kind" in named else []
    words = [row.cells for row in table.rows()]
    measured = np.array(
        [any(c[i] for i in at) or any(c[i] in ("fixed", "plane") for i in kind) for c in words]
    )
    measured |= not measured.any()
    estimate = np.array(values.sets) == "estimate"
    if not np.any(measured & estimate):
        raise MeasurementError(
            f"{table.source}: no row that is measured is 'estimate', so that no pose counts as taken. Leave out "
            "--taken, or correct the column 'set'."
        )
    return Taken(
        joints=read_only(values.joints[_poses(values, np.flatnonzero(measured & estimate))]),
        last_row=max(values.rows),
        source=table.source,
    )


def read_pose_list(path: str | Path, robot: Robot) -> tuple[Array, tuple[str, ...]]:
    """The poses of a table, shape (N, m), [rad] or [m], and the set of each; what was measured may be missing."""
    _, values = _joint_values(path, robot)
    kept = _poses(values, range(len(values.joints)))
    return read_only(values.joints[kept]), tuple(values.sets[i] for i in kept)


def _joint_values(path: str | Path, robot: Robot) -> tuple[Table, Values]:
    """A table, and what it says but for what was measured."""
    table = Table.read(path)
    # A row of this kind measures nothing but its joint values.
    layout = Layout.find(table, robot.joint_names, robot.joint_types, None, "fixed")
    return table, read_values(table, layout)


def _poses(values: Values, rows: Iterable[int]) -> list[int]:
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


def plan_table(plan: Plan) -> dict[str, Any]:
    """A plan as nested tables in SI units, the unit in each key's suffix; docs/planning.md describes them."""
    robot, request = plan.robot, plan.request
    units = ["m" if joint.type == "prismatic" else "rad" for joint in robot.inputs]
    joints = zip(robot.joint_names, units, strict=True)
    return {
        "schema": SCHEMA,
        "calib": __version__,
        "robot": {
            "name": robot.name,
            "urdf": robot.urdf.source,
            "urdf_sha256": robot.urdf.sha256,
            "base": robot.base,
            "tip": robot.tip,
            "joints": [{"name": name, "unit": unit} for name, unit in joints],
        },
        "asked": {
            "criterion": request.criterion,
            "model": plan.model,
            "kind": plan.kind,
            "targets": plan.targets,
            "seed": request.seed,
            "taken": len(plan.taken),
        },
        "poses": [
            {"set": word, "joints": q, "expected_xyz_m": places}
            for q, word, places in zip(plan.joints, plan.sets, plan.expected, strict=True)
        ],
        "candidates": {"drawn": plan.drawn, "kept": plan.candidates, "refused": plan.refused},
        "forecast": forecast_table(plan.forecast),
        "before": None if plan.before is None else forecast_table(plan.before),
        "at_random": forecast_table(plan.at_random),
        "ladder": [{"planned": n, **forecast_table(one)} for n, one in plan.ladder],
        "travel": {
            "largest_joint_moves": plan.travel,
            "blocked": [{"from": one.start, "to": one.end, "by": one.by} for one in plan.blocked],
        },
        "notes": [note._asdict() for note in plan.notes],
    }


def forecast_table(f: Forecast) -> dict[str, Any]:
    """A forecast as nested tables in SI units."""
    counted = ("poses", "rank", "workspace_rank", "columns", "efficiency")
    lengths = ("rms", "rms_low", "rms_high", "quantile_95", "max", "sigma")
    return {
        **{name: getattr(f, name) for name in counted},
        **{f"{name}_m": getattr(f, name) for name in lengths},
        "indices": f.indices,
        "parameters": [
            dict(zip(("name", "unit", "std", "identifiable"), row, strict=True))
            for row in zip(f.names, f.units, f.parameter_std, f.identifiable, strict=True)
        ],
    }
