"""plan: a robot in a cell in, the poses to measure out.

The order of the work: candidates inside the joint ranges, in the region, in the tracker's sight and free of collision;
the choice under the model that the fit will use; poses to validate with; the order to drive; the forecast.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.data.cell import Cell
from calib.data.surroundings import check_outside
from calib.design.candidates import Condition, draw, planning_ranges, turn_limits
from calib.design.collision import HOLDER_RADIUS, CollisionModel, in_sight
from calib.design.forecast import Forecast, Sensitivity
from calib.design.optimal import check_asked, choose_poses
from calib.design.region import Region
from calib.design.route import Blocked, route
from calib.robot.robot import Robot, read_only

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]

#: Default margin to joint limits [rad].
MARGIN = math.radians(5.0)

#: Poses among which those to drive by are looked for.
_STOPS = 4000


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """Poses to measure, in the order to drive.

    Attributes:
        robot: The robot.
        cell: What was planned for.
        joints: shape (K, m), [rad] or [m], whole steps of 0.001 deg or mm.
        sets: ``"estimate"`` or ``"validate"`` for each pose.
        taken: shape (T, m), poses that were measured already.
        targets: The targets measured at every pose.
        T_tip_target: shape (targets, 4, 4), where they sit in the tip [m].
        expected: shape (K, targets, 3), where the nominal robot puts each target, in the measurement frame if that is
            known, else in the base [m].
        criterion: ``"D"``, ``"A"`` or ``"V"``.
        model: The parameter set planned for.
        kind: What is measured at each pose.
        seed: The same seed makes the same plan.
        forecast: Of the fit of taken poses and planned ones.
        before: Of a fit of the poses taken alone; None without.
        at_random: Of as many poses drawn at random from the same candidates, in place of the planned ones: the median
            of several draws.
        ladder: Forecasts for other numbers of planned poses, in rising order, that of the plan among them.
        drawn: Candidates drawn.
        candidates: Of these, those that can be measured.
        refused: How many of those drawn were refused, by reason.
        travel: The sum over all moves of the largest move of a joint [rad] or [m].
        blocked: The moves whose straight way is not free.
        notes: Sentences that the person who measures must read.
    """

    robot: Robot
    cell: Cell
    joints: Array
    sets: tuple[str, ...]
    taken: Array
    targets: tuple[str, ...]
    T_tip_target: Array
    expected: Array
    criterion: str
    model: str
    kind: str
    seed: int
    forecast: Forecast
    before: Forecast | None
    at_random: Forecast
    ladder: tuple[tuple[int, Forecast], ...]
    drawn: int
    candidates: int
    refused: dict[str, int]
    travel: float
    blocked: tuple[Blocked, ...]
    notes: tuple[str, ...]

    def places(self, q: Array) -> Array:
        """Where the nominal robot puts each target in the base at q, shape (N, m); shape (N, targets, 3), [m]."""
        poses = self.robot.poses(q)[:, None] @ self.T_tip_target
        return np.asarray(poses[:, :, :3, 3])

    @property
    def estimation(self) -> Array:
        """The poses to fit, shape (N, m), in the order to drive."""
        return np.asarray(self.joints[np.array(self.sets) == "estimate"])

    @property
    def validation(self) -> Array:
        """The poses to validate with, shape (V, m)."""
        return np.asarray(self.joints[np.array(self.sets) == "validate"])


def plan(
    robot: Robot,
    cell: Cell | None = None,
    *,
    count: int = 30,
    validation: int = 5,
    criterion: str = "V",
    candidates: int = 20_000,
    region: Region | None = None,
    margin: float = MARGIN,
    taken: ArrayLike | None = None,
    collisions: bool = True,
    clearance: float = 0.0,
    floor: bool = True,
    holder_radius: float = HOLDER_RADIUS,
    package_dirs: Sequence[str | Path] = (),
    ladder: Sequence[int] | None = None,
    start: ArrayLike | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Plan:
    """Plan the poses of a calibration.

    Args:
        robot: The nominal robot.
        cell: What the fit will be told, model and priors with it, and what stands around the robot: boxes, tracker,
            reflector, joint ranges. The model ``"auto"`` is planned for as ``"placement"``, the largest geometry.
        count: Poses to fit.
        validation: Poses to validate with, drawn at random from the same candidates.
        criterion: ``"V"``: least mean variance of predicted positions (default); ``"D"``: largest determinant of the
            information; ``"A"``: least mean variance of the parameters.
        candidates: Poses among which is chosen.
        region: Where the first target is to lie, in the base; None: anywhere.
        margin: Distance to the joint limits of the URDF [rad].
        taken: shape (T, m), poses that are measured already: the plan adds to them.
        collisions: Whether poses, and moves between them, are checked for collisions of the robot and its targets
            with the robot itself, the cell's boxes and the mounting plane.
        clearance: Least distance there [m].
        floor: Whether nothing may come below the robot's mounting plane, see `CollisionModel`.
        holder_radius: A target and what holds it are a rod of this radius from the tip to the target [m].
        package_dirs: Folders in which packages of meshes lie.
        ladder: Numbers of poses to forecast too; None: some around ``count``; empty: none.
        start: shape (m,), where the robot stands before it begins; None: it begins at any pose.
        seed: The same seed makes the same plan.
        progress: Called with what is being done, how much of it is done, and how much there is.

    Raises:
        ModelError: An unknown model or criterion, fewer poses than it needs, or no candidate that can be measured.
        CalibError: Ranges, boxes or meshes that do not fit the robot.
    """
    cell = Cell() if cell is None else cell
    check_asked(count, validation, criterion, candidates)
    measured = _poses(robot, np.zeros((0, len(robot.inputs))) if taken is None else taken)
    begin = None if start is None else _poses(robot, start)[0]
    sensitivity = Sensitivity.of(robot, cell)
    T_tip_target, names = sensitivity.setup.T_tip_target, sensitivity.setup.targets
    ranges = planning_ranges(robot, cell.ranges, margin)
    body = None
    if collisions:
        body = CollisionModel.of(
            robot,
            cell.boxes,
            clearance,
            package_dirs,
            targets=dict(zip(names, T_tip_target[:, :3, 3], strict=True)),
            holder_radius=holder_radius,
            floor=floor,
        )
        if cell.tracker is not None:
            check_outside(cell.tracker, cell.boxes)

    def part(what: str) -> Callable[[int, int], None] | None:
        return None if progress is None else partial(progress, what)

    conditions = _conditions(robot, cell, region, T_tip_target, body)
    pool = draw(robot, ranges, conditions, candidates, seed, part("candidates"))
    choice = choose_poses(
        sensitivity,
        pool,
        count=count,
        validation=validation,
        criterion=criterion,
        taken=measured,
        ladder=ladder,
        seed=seed,
        progress=part("choice"),
    )
    blind = "The reflector's direction was not looked at: nothing says where the tracker stands (--tracker)."
    notes = [blind] if cell.reflector is not None and cell.tracker is None else []
    notes += ["Collisions were not checked."] if body is None else body.notes
    sets = ("estimate",) * len(choice.planned) + ("validate",) * len(choice.validation)
    # With errors that change with a joint's value, a pose one turn on is another pose.
    terms = sensitivity.kinematics.model.joint_terms
    limits = ranges if terms else turn_limits(robot, cell.ranges, margin)

    def stops() -> Array:
        # Nothing need see the target on the way.
        some = pool.workspace[:_STOPS]
        return some if body is None else some[body.free(some)]

    way = route(
        robot,
        np.concatenate([choice.planned, choice.validation]),
        limits,
        begin,
        None if body is None else body.path_free,
        stops,
    )
    return Plan(
        robot=robot,
        cell=cell,
        joints=way.joints,
        sets=tuple(sets[i] for i in way.indices),
        taken=measured,
        targets=names,
        T_tip_target=T_tip_target,
        expected=read_only(sensitivity.expected(way.joints)),
        criterion=criterion,
        model=sensitivity.kinematics.model.name,
        kind=sensitivity.kind,
        seed=seed,
        forecast=choice.forecast,
        before=choice.before,
        at_random=choice.at_random,
        ladder=choice.ladder,
        drawn=pool.drawn,
        candidates=len(pool.q),
        refused=pool.refused,
        travel=way.length,
        blocked=way.blocked,
        notes=(*sensitivity.notes, *notes),
    )


def _poses(robot: Robot, joints: ArrayLike) -> Array:
    """Joint values, checked, shape (T, m)."""
    robot.chain_values(joints)
    return read_only(np.atleast_2d(np.asarray(joints, dtype=np.float64)))


def _conditions(
    robot: Robot,
    cell: Cell,
    region: Region | None,
    T_tip_target: Array,
    body: CollisionModel | None,
) -> list[Condition]:
    """What a candidate must pass, the cheap conditions first."""
    conditions = []
    if region is not None:

        def inside(q: Array) -> NDArray[np.bool_]:
            return region.contains((robot.poses(q) @ T_tip_target[0])[:, :3, 3])

        conditions.append(Condition("outside of the region", inside, where=True))
    tracker = cell.tracker
    if tracker is not None:

        def seen(q: Array, what: str) -> NDArray[np.bool_]:
            result = np.ones(len(q), dtype=bool)
            for T in T_tip_target:
                looked = body if what == "beam" else None
                sight = in_sight(robot, q[result], T, tracker, cell.reflector, looked)
                result[result] = getattr(sight, what)
            return result

        conditions.append(Condition("out of the tracker's range", lambda q: seen(q, "range")))
        if cell.reflector is not None:
            away = "with the reflector turned away"
            conditions.append(Condition(away, lambda q: seen(q, "cone")))
        # A beam is one rod against all links; they among themselves take ten times as long.
        if body is not None:
            conditions.append(Condition("with something in the beam", lambda q: seen(q, "beam")))
    if body is not None:
        conditions.append(Condition("in collision", body.free))
    return conditions
