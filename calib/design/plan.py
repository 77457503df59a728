"""plan: a robot in a cell in, the poses to measure out, in the order to drive.

The order of the work: candidates inside the joint ranges, in the region, in the tracker's sight and free of collision;
the choice under the model that the fit will use; poses to validate with; the order to drive; the forecast.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from calib.data.cell import Cell
from calib.design.candidates import Condition, Pool, draw, planning_ranges
from calib.design.choice import Choice, PlanRequest, choose_poses
from calib.design.collision import CollisionCheck, CollisionModel
from calib.design.forecast import Forecast
from calib.design.notes import Note
from calib.design.ordering import Blocked, Route
from calib.design.route import route
from calib.design.sensitivity import Sensitivity
from calib.design.sight import in_cone, in_range, target_positions
from calib.regions.region import Region
from calib.robot.robot import Robot, read_only
from calib.units import Array

#: Called with the stage of the work, how much of it is done, and all of it.
Progress = Callable[[str, int, int], None]

#: Poses among which those to drive by are looked for.
_STOPS = 4000

_USUAL_REQUEST = PlanRequest()
_USUAL_CHECK = CollisionCheck()


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """Poses to measure, in the order to drive."""

    #: The robot.
    robot: Robot
    #: The cell that was planned for.
    cell: Cell
    #: The request.
    request: PlanRequest
    #: Shape (K, m), [rad] or [m], whole steps of 0.001 deg or mm.
    joints: Array
    #: ``"estimate"`` or ``"validate"`` for each pose.
    sets: tuple[str, ...]
    #: Shape (T, m), poses that were measured already.
    taken: Array
    #: The targets measured at every pose.
    targets: tuple[str, ...]
    #: Shape (targets, 4, 4), their poses in the tip [m].
    T_tip_target: Array
    #: shape (K, targets, 3), each target as the nominal robot predicts it, in the measurement frame if that is known,
    #: else in the base [m].
    expected: Array
    #: The parameter set planned for.
    model: str
    #: Kind of measurement at each pose.
    kind: str
    #: Of the fit of taken poses and planned ones.
    forecast: Forecast
    #: Of a fit of the poses taken alone; None without.
    before: Forecast | None
    #: Of as many poses drawn at random from the same candidates, in place of the planned ones: the median of several
    #: draws.
    at_random: Forecast
    #: Forecasts for other numbers of planned poses, in rising order, that of the plan among them.
    ladder: tuple[tuple[int, Forecast], ...]
    #: Candidates drawn.
    drawn: int
    #: Of these, those that can be measured.
    candidates: int
    #: Number of those drawn that were refused, by reason, see `calib.design.candidates.Reason`.
    refused: dict[str, int]
    #: The sum over all moves of the largest move of a joint [rad] or [m].
    travel: float
    #: The moves whose straight way is not free.
    blocked: tuple[Blocked, ...]
    #: Remarks for the person who measures.
    notes: tuple[Note, ...]

    def places(self, q: Array) -> Array:
        """Predict where each target is in the base at q, shape (N, m), by the nominal robot; (N, targets, 3), [m]."""
        by_target = [target_positions(self.robot, T, q) for T in self.T_tip_target]
        return np.stack(by_target, axis=1)

    @property
    def estimation(self) -> Array:
        """The poses to fit, shape (N, m), in the order to drive."""
        return np.asarray(self.joints[np.array(self.sets) == "estimate"])


def plan(
    robot: Robot,
    cell: Cell | None = None,
    request: PlanRequest = _USUAL_REQUEST,
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
            reflector, joint ranges; None: the default cell. The model ``"auto"`` is planned for as ``"placement"``, the
            largest geometry.
        request: Number of poses, criterion, number of candidates.
        region: Where the first target is to lie, in the base; None: anywhere.
        taken: shape (T, m), poses that are measured already [rad] or [m]: the plan adds to them; None: none.
        collisions: How poses and moves are checked for collisions of the robot and its targets with the robot itself,
            the cell's boxes and the mounting plane; None: they are not.
        progress: Called with the stage of the work, how much of it is done, and all of it.

    Returns:
        The plan.

    Raises:
        CalibError: Too few poses for the model, no candidate that can be measured, or a cell that does not fit.
    """
    cell = cell or Cell()
    request.check(request.candidates)
    measured = np.zeros((0, len(robot.inputs))) if taken is None else np.atleast_2d(taken)
    measured = read_only(measured)
    sensitivity = Sensitivity.of(robot, cell)
    body = _collision_model(sensitivity, collisions)
    pool = _draw(sensitivity, request, region, body, _stage(progress, "candidates"))
    choice = choose_poses(sensitivity, pool, request, measured, progress=_stage(progress, "choice"))
    way = _route(sensitivity, request, pool, choice, body)
    is_planned = way.indices < len(choice.planned)
    return Plan(
        robot=robot,
        cell=cell,
        request=request,
        joints=way.joints,
        sets=tuple(np.where(is_planned, "estimate", "validate").tolist()),
        taken=measured,
        targets=sensitivity.setup.targets,
        T_tip_target=sensitivity.setup.T_tip_target,
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
        notes=(*sensitivity.notes, *_notes(cell, body)),
    )


def _stage(progress: Progress | None, stage: str) -> Callable[[int, int], None] | None:
    """Return what a stage of the work calls with the work done and all of it; None: nothing."""
    return None if progress is None else partial(progress, stage)


def _collision_model(
    sensitivity: Sensitivity, collisions: CollisionCheck | None
) -> CollisionModel | None:
    """Return the robot with its targets and boxes, to be checked for collisions; None: it is not."""
    if collisions is None:
        return None
    setup = sensitivity.setup
    targets = dict(zip(setup.targets, setup.T_tip_target[:, :3, 3], strict=True))
    robot, boxes = sensitivity.kinematics.robot, sensitivity.cell.boxes
    return CollisionModel.of(robot, boxes, targets, collisions)


def _draw(
    sensitivity: Sensitivity,
    request: PlanRequest,
    region: Region | None,
    body: CollisionModel | None,
    progress: Callable[[int, int], None] | None,
) -> Pool:
    """Draw candidates that can be measured."""
    robot = sensitivity.kinematics.robot
    ranges = planning_ranges(robot, sensitivity.cell.ranges, request.margin)
    conditions = list(_conditions(sensitivity, region, body))
    return draw(robot, ranges, conditions, request.candidates, request.seed, progress)


def _conditions(
    sensitivity: Sensitivity, region: Region | None, body: CollisionModel | None
) -> Iterator[Condition]:
    """Yield what a candidate must pass, the cheap conditions first; the tracker must see every target.

    Args:
        sensitivity: The robot in its cell.
        region: Where the first target must lie, in the robot's base; None: anywhere.
        body: Checks collisions of the links and of the tracker's beam with them; None: neither is checked.

    Yields:
        Conditions of joint values, shape (n, m), that return True for those that pass, shape (n,).
    """
    robot, cell = sensitivity.kinematics.robot, sensitivity.cell
    T_tip_target = sensitivity.setup.T_tip_target
    tracker, reflector = cell.tracker, cell.reflector
    if region is not None:
        first = T_tip_target[0]
        yield Condition("region", lambda q: region.contains(target_positions(robot, first, q)))
    if tracker is not None:
        for T in T_tip_target:
            yield Condition("tracker_range", partial(in_range, robot, T, tracker))
    if tracker is not None and reflector is not None:
        for T in T_tip_target:
            yield Condition("reflector_cone", partial(in_cone, robot, T, tracker, reflector))
    if body is None:
        return
    # A beam is one rod against all links; they among themselves take ten times as long.
    if tracker is not None:
        for T in T_tip_target:
            yield Condition("beam", partial(body.beam_free, T, tracker.position))
    yield Condition("collision", body.free)


def _route(
    sensitivity: Sensitivity,
    request: PlanRequest,
    pool: Pool,
    choice: Choice,
    body: CollisionModel | None,
) -> Route:
    """Order the chosen poses."""
    robot = sensitivity.kinematics.robot
    # With errors that change with a joint's value, a pose one turn on is another pose.
    turns = not sensitivity.kinematics.model.joint_terms
    limits = planning_ranges(robot, sensitivity.cell.ranges, request.margin, turns=turns)
    start = None
    if request.start is not None:
        start = np.asarray(request.start, dtype=np.float64)

    def stops() -> Array:
        # Nothing need see the target on the way.
        poses = pool.workspace[:_STOPS]
        return poses if body is None else poses[body.free(poses)]

    poses = np.concatenate([choice.planned, choice.validation])
    free_path = None if body is None else body.path_free
    return route(robot, poses, limits, start, free_path, stops)


def _notes(cell: Cell, body: CollisionModel | None) -> list[Note]:
    """Return remarks on what was checked, and what was not."""
    notes = []
    if cell.reflector is not None and cell.tracker is None:
        notes.append(Note("reflector_not_checked"))
    if body is None:
        notes.append(Note("collisions_not_checked"))
    else:
        notes += body.notes
    return notes
