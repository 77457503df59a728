"""plan: a robot in a cell in, the poses to measure out.

The order of the work: candidates inside the joint ranges, in the region, in the tracker's sight and free of collision;
the choice under the model that the fit will use; poses to validate with; the order to drive; the forecast.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.data.cell import Cell
from calib.data.surroundings import Reflector, Tracker, check_outside
from calib.design.candidates import Condition, Note, draw, planning_ranges
from calib.design.collision import CollisionCheck, CollisionModel
from calib.design.forecast import Forecast, Sensitivity
from calib.design.optimal import PlanRequest, choose_poses
from calib.design.route import Blocked, route
from calib.design.workspace import Region
from calib.robot.robot import Robot, read_only

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Progress = Callable[[str, int, int], None]

#: Poses among which those to drive by are looked for.
_STOPS = 4000

_USUAL, _USUAL_CHECK = PlanRequest(), CollisionCheck()


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """Poses to measure, in the order to drive.

    Attributes:
        robot: The robot.
        cell: What was planned for.
        request: What was asked for.
        joints: shape (K, m), [rad] or [m], whole steps of 0.001 deg or mm.
        sets: ``"estimate"`` or ``"validate"`` for each pose.
        taken: shape (T, m), poses that were measured already.
        targets: The targets measured at every pose.
        T_tip_target: shape (targets, 4, 4), their poses in the tip [m].
        expected: shape (K, targets, 3), where the nominal robot puts each target, in the measurement frame if that is
            known, else in the base [m].
        model: The parameter set planned for.
        kind: What is measured at each pose.
        forecast: Of the fit of taken poses and planned ones.
        before: Of a fit of the poses taken alone; None without.
        at_random: Of as many poses drawn at random from the same candidates, in place of the planned ones: the median
            of several draws.
        ladder: Forecasts for other numbers of planned poses, in rising order, that of the plan among them.
        drawn: Candidates drawn.
        candidates: Of these, those that can be measured.
        refused: How many of those drawn were refused, by reason, see `calib.design.candidates.Reason`.
        travel: The sum over all moves of the largest move of a joint [rad] or [m].
        blocked: The moves whose straight way is not free.
        notes: What the person who measures must know.
    """

    robot: Robot
    cell: Cell
    request: PlanRequest
    joints: Array
    sets: tuple[str, ...]
    taken: Array
    targets: tuple[str, ...]
    T_tip_target: Array
    expected: Array
    model: str
    kind: str
    forecast: Forecast
    before: Forecast | None
    at_random: Forecast
    ladder: tuple[tuple[int, Forecast], ...]
    drawn: int
    candidates: int
    refused: dict[str, int]
    travel: float
    blocked: tuple[Blocked, ...]
    notes: tuple[Note, ...]

    def places(self, q: Array) -> Array:
        """Where the nominal robot puts each target in the base at q, shape (N, m); shape (N, targets, 3), [m]."""
        poses = self.robot.poses(q)[:, None] @ self.T_tip_target
        return np.asarray(poses[:, :, :3, 3])

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
        ModelError: An unknown model or criterion, fewer poses than it needs, or no candidate that can be measured.
        CalibError: Ranges, boxes or meshes that do not fit the robot.
    """
    cell = Cell() if cell is None else cell
    request.check(request.candidates)
    measured = _poses(robot, np.zeros((0, len(robot.inputs))) if taken is None else taken)
    begin = None if request.start is None else _poses(robot, request.start)[0]
    sensitivity = Sensitivity.of(robot, cell)
    T_tip_target, names = sensitivity.setup.T_tip_target, sensitivity.setup.targets
    ranges = planning_ranges(robot, cell.ranges, request.margin)
    body = None
    if collisions is not None:
        targets = dict(zip(names, T_tip_target[:, :3, 3], strict=True))
        body = CollisionModel.of(robot, cell.boxes, targets, collisions)
        if cell.tracker is not None:
            check_outside(cell.tracker, cell.boxes)

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

    free_path = None if body is None else body.path_free
    poses = np.concatenate([choice.planned, choice.validation])
    way = route(robot, poses, limits, begin, free_path, stops)
    estimate = way.indices < len(choice.planned)
    return Plan(
        robot=robot,
        cell=cell,
        request=request,
        joints=way.joints,
        sets=tuple("estimate" if one else "validate" for one in estimate),
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
                yield Condition("beam", partial(_beam_free, robot, T, tracker, body))
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


def _beam_free(
    robot: Robot, T_tip_target: Array, tracker: Tracker, body: CollisionModel, q: Array
) -> Mask:
    """Whether nothing is in the tracker's beam, shape (N,)."""
    return body.beam_free(q, places(robot, T_tip_target, q), tracker.position)
