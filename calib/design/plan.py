"""plan: a robot in a cell in, the poses to measure out, as a table to drive and fill in.

The order of the work: candidates inside the joint ranges, in the region, in the tracker's sight and free of collision;
the choice under the model that the fit will use; poses to validate with; the order to drive; the forecast.

The table has a row for each pose, with empty cells for what will be measured there; filled in, or beside an
instrument's list of points, it is a table of measurements. The forecast that goes with it is nested, in SI units, for a
JSON file. See docs/planning.md.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

import calib.data.kinds as registry
from calib.data.cell import Cell, Reflector, Tracker
from calib.data.columns import DEFAULT_TARGET, EXPECTED, POINT, QUATERNION, name_columns
from calib.data.layout import Layout
from calib.data.measurements import Measurements
from calib.data.table import Table
from calib.data.values import read_values
from calib.design.candidates import Condition, Note, draw, planning_ranges
from calib.design.collision import CollisionCheck, CollisionModel
from calib.design.forecast import Forecast, Sensitivity
from calib.design.optimal import PlanRequest, choose_poses
from calib.design.route import Blocked, route
from calib.design.workspace import Region
from calib.errors import MeasurementError
from calib.files import csv_bytes, write_atomically
from calib.robot.robot import Robot, read_only
from calib.units import Array, Mask
from calib.version import __version__

Progress = Callable[[str, int, int], None]

SCHEMA = "plan 1"

#: Digits of degrees and millimetres: those that planned joint values have, and a tracker's last.
_DIGITS = 3

#: The units that values are written in, and how many of them are one in SI.
_WRITTEN = {"length": ("mm", 1e3), "angle": ("deg", 180.0 / math.pi)}

#: Poses among which those to drive by are looked for.
_STOPS = 4000

_USUAL, _USUAL_CHECK = PlanRequest(), CollisionCheck()


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """Poses to measure, in the order to drive."""

    robot: Robot  #: The robot.
    cell: Cell  #: What was planned for.
    request: PlanRequest  #: What was asked for.
    joints: Array  #: shape (K, m), [rad] or [m], whole steps of 0.001 deg or mm.
    sets: tuple[str, ...]  #: ``"estimate"`` or ``"validate"`` for each pose.
    taken: Array  #: shape (T, m), poses that were measured already.
    targets: tuple[str, ...]  #: The targets measured at every pose.
    T_tip_target: Array  #: shape (targets, 4, 4), their poses in the tip [m].
    #: shape (K, targets, 3), where the nominal robot puts each target, in the measurement frame if that is known, else
    #: in the base [m].
    expected: Array
    model: str  #: The parameter set planned for.
    kind: str  #: What is measured at each pose.
    forecast: Forecast  #: Of the fit of taken poses and planned ones.
    before: Forecast | None  #: Of a fit of the poses taken alone; None without.
    #: Of as many poses drawn at random from the same candidates, in place of the planned ones: the median of several
    #: draws.
    at_random: Forecast
    #: Forecasts for other numbers of planned poses, in rising order, that of the plan among them.
    ladder: tuple[tuple[int, Forecast], ...]
    drawn: int  #: Candidates drawn.
    candidates: int  #: Of these, those that can be measured.
    #: How many of those drawn were refused, by reason, see `calib.design.candidates.Reason`.
    refused: dict[str, int]
    travel: float  #: The sum over all moves of the largest move of a joint [rad] or [m].
    blocked: tuple[Blocked, ...]  #: The moves whose straight way is not free.
    notes: tuple[Note, ...]  #: What the person who measures must know.

    def places(self, q: Array) -> Array:
        """Where the nominal robot puts each target in the base at q, shape (N, m); shape (N, targets, 3), [m]."""
        return np.stack([places(self.robot, T, q) for T in self.T_tip_target], axis=1)

    @property
    def estimation(self) -> Array:
        """The poses to fit, shape (N, m), in the order to drive."""
        return np.asarray(self.joints[np.array(self.sets) == "estimate"])


def plan(
    robot: Robot,
    cell: Cell | None = None,
    request: PlanRequest = _USUAL,
    *,
    region: Region | None = None,
    taken: ArrayLike | None = None,
    collisions: CollisionCheck | None = _USUAL_CHECK,
    progress: Progress | None = None,
) -> Plan:
    """Plan the poses of a calibration.

    Args:
        robot: The nominal robot.
        cell: What the fit will use, model and priors with it, and what stands around the robot: boxes, tracker,
            reflector, joint ranges. The model ``"auto"`` is planned for as ``"placement"``, the largest geometry.
        request: How many poses, by which criterion, out of how many candidates.
        region: Where the first target is to lie, in the base; None: anywhere.
        taken: shape (T, m), poses that are measured already: the plan adds to them.
        collisions: How poses and moves are checked for collisions of the robot and its targets with the robot itself,
            the cell's boxes and the mounting plane; None: they are not.
        progress: Called with what is being done, how much of it is done, and how much there is.

    Raises:
        CalibError: Too few poses for the model, no candidate that can be measured, or a cell that does not fit.
    """
    cell = cell or Cell()
    request.check(request.candidates)
    none = np.zeros((0, len(robot.inputs)))
    measured = read_only(none if taken is None else np.atleast_2d(taken))
    sensitivity = Sensitivity.of(robot, cell)
    T_tip_target, names = sensitivity.setup.T_tip_target, sensitivity.setup.targets
    ranges = planning_ranges(robot, cell.ranges, request.margin)
    body = None
    if collisions is not None:
        targets = dict(zip(names, T_tip_target[:, :3, 3], strict=True))
        body = CollisionModel.of(robot, cell.boxes, targets, collisions)

    def part(what: str) -> Callable[[int, int], None] | None:
        return None if progress is None else partial(progress, what)

    conditions = list(_conditions(robot, cell, region, T_tip_target, body))
    pool = draw(robot, ranges, conditions, request.candidates, request.seed, part("candidates"))
    choice = choose_poses(sensitivity, pool, request, measured, progress=part("choice"))
    notes = [*sensitivity.notes]
    if cell.reflector is not None and cell.tracker is None:
        notes.append(Note("reflector_not_checked"))
    notes += [Note("collisions_not_checked")] if body is None else body.notes
    # With errors that change with a joint's value, a pose one turn on is another pose.
    terms = sensitivity.kinematics.model.joint_terms
    limits = planning_ranges(robot, cell.ranges, request.margin, turns=not terms)

    def stops() -> Array:
        # Nothing need see the target on the way.
        some = pool.workspace[:_STOPS]
        return some if body is None else some[body.free(some)]

    poses = np.concatenate([choice.planned, choice.validation])
    begin = None if request.start is None else np.asarray(request.start, dtype=np.float64)
    way = route(robot, poses, limits, begin, None if body is None else body.path_free, stops)
    return Plan(
        robot=robot,
        cell=cell,
        request=request,
        joints=way.joints,
        sets=tuple(np.where(way.indices < len(choice.planned), "estimate", "validate").tolist()),
        taken=measured,
        targets=names,
        T_tip_target=T_tip_target,
        expected=read_only(sensitivity.expected(way.joints)),
        model=sensitivity.kinematics.model.name,
        kind=sensitivity.kind,
        forecast=choice.forecast,
        before=choice.before,
        at_random=choice.at_random,
        ladder=choice.ladder,
        drawn=pool.drawn,
        candidates=len(pool.q),
        refused=pool.refused,
        travel=way.length,
        blocked=way.blocked,
        notes=tuple(notes),
    )


def _conditions(
    robot: Robot,
    cell: Cell,
    region: Region | None,
    T_tip_target: Array,
    body: CollisionModel | None,
) -> Iterator[Condition]:
    """What a candidate must pass, the cheap conditions first; the tracker must see every target."""
    tracker, reflector = cell.tracker, cell.reflector
    if region is not None:
        yield Condition("region", lambda q: region.contains(places(robot, T_tip_target[0], q)))
    if tracker is not None:
        for T in T_tip_target:
            yield Condition("tracker_range", partial(in_range, robot, T, tracker))
        if reflector is not None:
            for T in T_tip_target:
                yield Condition("reflector_cone", partial(in_cone, robot, T, tracker, reflector))
    if body is not None:
        # A beam is one rod against all links; they among themselves take ten times as long.
        for T in T_tip_target:
            if tracker is not None:
                yield Condition("beam", partial(body.beam_free, T, tracker.position))
        yield Condition("collision", body.free)


def places(robot: Robot, T_tip_target: Array, q: Array) -> Array:
    """Where the nominal robot puts a target in the base at q, shape (N, m); shape (N, 3), [m]."""
    return np.asarray((robot.poses(q) @ T_tip_target)[:, :3, 3])


def in_range(robot: Robot, T_tip_target: Array, tracker: Tracker, q: Array) -> Mask:
    """Whether the target's distance to the tracker is one that it measures, shape (N,)."""
    distance = np.linalg.norm(tracker.position - places(robot, T_tip_target, q), axis=1)
    return np.asarray((distance >= tracker.nearest) & (distance <= tracker.farthest))


def in_cone(
    robot: Robot, T_tip_target: Array, tracker: Tracker, reflector: Reflector, q: Array
) -> Mask:
    """Whether the angle from the reflector's normal to the tracker is at most its acceptance, shape (N,)."""
    towards = tracker.position - places(robot, T_tip_target, q)
    normal = robot.poses(q)[:, :3, :3] @ reflector.normal
    across = np.linalg.norm(np.cross(normal, towards), axis=1)
    angle = np.arctan2(across, np.einsum("ni,ni->n", normal, towards))
    return np.asarray(angle <= reflector.acceptance)


# The table


def write_plan(
    plan: Plan, path: str | Path, *, overwrite: bool = False, first_row: int = 1
) -> Path:
    """Write a plan as a CSV table, degrees and millimetres, in the order to drive; several targets have a row each.

    The columns of what is measured are empty; ``expected`` columns are what the nominal robot would give. ``first_row``
    is the number of the first row: where rows are to be added to a table, one more than its last.
    """
    rows = list(_rows(plan, first_row))
    table = [list(rows[0]), *(row.values() for row in rows)]
    return write_atomically(path, csv_bytes(table), overwrite=overwrite)


def _rows(plan: Plan, number: int) -> Iterator[dict[str, str]]:
    """The cells of each target at each pose, by their columns."""

    def column(name: str, quantity: str) -> tuple[str, float]:
        unit, scale = _WRITTEN[quantity]
        return f"{name} [{unit}]", scale

    def cells(columns: list[tuple[str, float]], values: Array) -> dict[str, str]:
        found = zip(columns, values, strict=True)
        return {name: f"{scale * value + 0.0:.{_DIGITS}f}" for (name, scale), value in found}

    kind, slides = registry.get(plan.kind), plan.robot.joint_types
    joints = [column(n, "length" if slides[n] == "prismatic" else "angle") for n in slides]
    lengths = [column(axis, "length") for axis in POINT] if kind.position else []
    readings = [column(one.name, one.quantity) for one in kind.readings]
    measured = [*range(len(lengths)), *range(kind.size - len(readings), kind.size)]
    empty = [name for name, _ in lengths] + [*QUATERNION] * kind.orientation
    empty += [name for name, _ in readings]
    told = [(EXPECTED + name, scale) for name, scale in (*lengths, *readings)]
    for q, word, seen in zip(plan.joints, plan.sets, plan.expected, strict=True):
        for target, place in zip(plan.targets, seen, strict=True):
            row = {"row": str(number), "set": word, "point": f"P{number}"}
            if plan.targets != (DEFAULT_TARGET,):
                row["target"] = target
            row |= cells(joints, q) | dict.fromkeys(empty, "")
            if kind.measure is not None:
                T = np.eye(4)
                T[:3, 3] = place
                row |= cells(told, kind.measure(T[None])[0, measured])
            yield row
            number += 1


class Poses(NamedTuple):
    """Poses of a table, shape (N, m), [rad] or [m], the set of each, and the largest number of a row."""

    joints: Array
    sets: tuple[str, ...]
    last_row: int


def read_poses(path: str | Path, robot: Robot, *, taken: bool = False) -> Poses:
    """The poses of a table, in which what was measured may be missing; several targets at one pose are one pose.

    ``taken``: those alone that a fit would estimate from, measured and of the set ``estimate``; a table in which
    nothing is measured, such as a plan that is still to be driven, counts whole.
    """
    table = Table.read(path)
    # A row of the kind ``fixed`` has its joint values alone.
    layout = Layout.find(table, robot.joint_names, robot.joint_types, None, "fixed")
    rows = Measurements(**read_values(table, layout))
    wanted = np.ones(len(rows), dtype=np.bool_)
    if taken:
        named, _ = name_columns(table, robot.joint_names, {})
        at = [named[name].index for name in (*POINT, "distance", "pair") if name in named]
        # By the cells alone; a row that measures nothing, of a socket or a plane, counts.
        kinds = table.column(named["kind"]) if "kind" in named else [""] * len(rows)
        measured = [
            any(cells[i] for i in at) or kind in ("fixed", "plane")
            for cells, kind in zip(table.cells, kinds, strict=True)
        ]
        wanted = rows.estimation & (np.array(measured) | (not any(measured)))
        if not wanted.any():
            raise MeasurementError(f"{table.source}: no row that is measured is 'estimate'.")
    # Of rows with the same joint values as many as measure the same target.
    seen: Counter[tuple[bytes, str]] = Counter()
    first: dict[tuple[bytes, int], int] = {}
    for i in np.flatnonzero(wanted).tolist():
        pose, target = rows.joints[i].tobytes(), rows.targets[i]
        first.setdefault((pose, seen[pose, target]), i)
        seen[pose, target] += 1
    kept = [*first.values()]
    sets = tuple(rows.sets[i] for i in kept)
    return Poses(read_only(rows.joints[kept]), sets, max(rows.rows))


# The forecast


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
    counted = ("poses", "rank", "workspace_rank", "columns")
    lengths = ("rms", "rms_low", "rms_high", "max", "sigma")
    return {
        **{name: getattr(f, name) for name in counted},
        **{f"{name}_m": getattr(f, name) for name in lengths},
        "indices": f.indices,
        "parameters": [
            dict(zip(("name", "unit", "std", "identifiable"), row, strict=True))
            for row in zip(f.names, f.units, f.parameter_std, f.identifiable, strict=True)
        ],
    }
