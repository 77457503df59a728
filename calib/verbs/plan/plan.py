"""plan: a robot in a cell in, the poses to measure out, in the order to drive.

The order of the work: candidates inside the joint ranges, in the region, in the tracker's sight and free of collision;
the choice under the model that the fit will use; poses to validate with; the order to drive; the forecast.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from calib.basics.arguments import check_callable, check_type
from calib.basics.arrays import Array, read_only
from calib.basics.mappings import keep_read_only
from calib.basics.shown import shown_by
from calib.basics.values import Value
from calib.data.cell import Cell
from calib.data.inputs import CellInput, RobotInput, cell_of, robot_of
from calib.robot.robot import Robot
from calib.verbs.plan.candidates import Condition, Pool, draw, planning_ranges
from calib.verbs.plan.choice import PlanRequest, choose_poses
from calib.verbs.plan.collision import CollisionCheck, CollisionModel
from calib.verbs.plan.forecast import Forecast
from calib.verbs.plan.images.sight import CameraSight
from calib.verbs.plan.notes import Note
from calib.verbs.plan.route import Blocked, find_route
from calib.verbs.plan.sensitivity import Sensitivity
from calib.verbs.plan.sight import in_cone, in_range, target_positions
from calib.verbs.workspace.region import Region

#: Called with the stage of the work, how much of it is done, and all of it.
Progress = Callable[[str, int, int], None]

#: Poses among which those to drive by are looked for.
_STOPS = 4000

_USUAL_REQUEST = PlanRequest()
_USUAL_CHECK = CollisionCheck()


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Plan(Value):
    """Poses to measure, in the order to drive."""

    #: The robot.
    robot: Robot
    #: The cell that was planned for.
    cell: Cell
    #: The request.
    request: PlanRequest
    #: Shape (K, m), joint values [rad] or [m], whole steps of 0.001 deg or mm, columns as ``robot.joint_names``.
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
    #: Forecast of the fit of taken poses and planned ones.
    forecast: Forecast
    #: Forecast of a fit of the poses taken alone; None where none are taken.
    before: Forecast | None
    #: Forecast of as many poses drawn at random from the same candidates, in place of the planned ones: the median of
    #: several draws.
    at_random: Forecast
    #: Forecasts for other numbers of planned poses, in rising order, that of the plan among them.
    ladder: tuple[tuple[int, Forecast], ...]
    #: Candidates drawn.
    drawn: int
    #: Of these, those that can be measured.
    candidates: int
    #: Number of those drawn that were refused, by reason, see `calib.verbs.plan.candidates.Reason`.
    refused: Mapping[str, int]
    #: The sum over all moves of the largest move of a joint [rad] or [m].
    travel: float
    #: The moves whose straight way is not free.
    blocked: tuple[Blocked, ...]
    #: Remarks for the person who measures.
    notes: tuple[Note, ...]
    #: The camera and the board, and where the board may be in the camera; None where no images are planned.
    sight: CameraSight | None = None

    def __repr__(self) -> str:
        """One line: the robot, numbers of poses, expected error."""
        return str(shown_by("verbs.plan.text").plan_line(self))

    def _repr_html_(self) -> str:
        """A small table for notebooks: numbers of poses, expected errors."""
        return str(shown_by("verbs.plan.text").plan_html(self))

    def summary(self) -> str:
        """Return the plan as text, without colours, as ``calib plan`` prints it."""
        return str(shown_by("verbs.plan.text").plan_text(self))

    def __post_init__(self) -> None:
        """Keep a read-only copy of the mapping."""
        keep_read_only(self, "refused")

    def places(self, q: Array) -> Array:
        """Predict the position of each target in the robot's base, by the nominal robot.

        Uses ``robot`` and ``T_tip_target``, the poses of its k targets in the tip, shape (k, 4, 4), [m].

        Args:
            q: Joint values of N poses, shape (N, m), [rad] or for sliding joints [m], columns as ``robot.joint_names``.

        Returns:
            Shape (N, k, 3), [m], in the order of ``targets``.
        """
        by_target = [target_positions(self.robot, T, q) for T in self.T_tip_target]
        return np.stack(by_target, axis=1)

    @property
    def estimation(self) -> Array:
        """Joint values of the poses to fit, without those to validate with, in the order to drive.

        Shape (N, m), [rad] or for sliding joints [m].
        """
        return np.asarray(self.joints[np.array(self.sets) == "estimate"])


def plan(
    robot: RobotInput,
    cell: CellInput = None,
    request: PlanRequest = _USUAL_REQUEST,
    *,
    region: Region | None = None,
    taken: ArrayLike | None = None,
    collisions: CollisionCheck | None = _USUAL_CHECK,
    progress: Progress | None = None,
) -> Plan:
    """Plan the poses of a calibration: which to measure, and in which order to drive.

    Args:
        robot: The nominal robot; or the path of a URDF or xacro, or a name such as ``"ur3"``, with the cell's base and
            tip, or the URDF's root and its farthest link.
        cell: What the fit will use, model and priors with it, and what stands around the robot: boxes, tracker,
            reflector, joint ranges; or the path of a cell file; None: the default cell. The model ``"auto"`` is planned
            for as ``"placement"``, the largest geometry.
        request: Numbers of poses to fit and to validate with, criterion, number of candidates, margin to the limits of
            joints that turn [rad], the robot's joint values before the first move, and the seed.
        region: Voxels of the robot's base frame in which the first target is to lie; None: anywhere.
        taken: Joint values of poses that are measured already, shape (T, m) or (m,), [rad] or for sliding joints [m],
            columns as ``robot.joint_names``: the plan adds to them; None: none.
        collisions: How poses and moves are checked for collisions of the robot and its targets with the robot itself,
            the cell's boxes and the mounting plane; None: they are not.
        progress: Called with the stage of the work, ``"candidates"`` or ``"choice"``, how much of it is done, and all
            of it; None: nothing is called.

    Returns:
        The plan: poses to fit and to validate with, in the order to drive, where each target is expected, the moves
        that are blocked, and the forecast of the fit.

    Raises:
        ArgumentError: An argument of another type.
        CalibError: Too few poses for the model, no candidate that can be measured, or a cell that does not fit.
    """
    known = cell_of(cell)
    arm = robot_of(robot, known)
    check_type("request", request, PlanRequest, "a PlanRequest")
    check_type("region", region, (Region, type(None)), "a Region, or None")
    check_type("collisions", collisions, (CollisionCheck, type(None)), "a CollisionCheck, or None")
    check_callable("progress", progress)
    request.check(request.candidates)
    measured = read_only(
        np.zeros((0, len(arm.inputs))) if taken is None else arm.columns(taken, "taken")
    )
    sensitivity = Sensitivity.of(arm, known)
    body = _collision_model(sensitivity, collisions)
    pool = _draw(sensitivity, request, region, body, stage(progress, "candidates"))
    return planned_of(
        Planned(sensitivity, request, pool, measured, body), stage(progress, "choice")
    )


class Planned(NamedTuple):
    """Candidates that poses are chosen from, and for what."""

    #: The nominal robot in its cell, under the error model of the fit.
    sensitivity: Sensitivity
    #: The request.
    request: PlanRequest
    #: The candidates.
    pool: Pool
    #: Shape (T, m), poses measured already [rad] or [m].
    taken: Array
    #: Tests poses and moves for collisions; None: they are not tested.
    body: CollisionModel | None
    #: The camera and the board, where images are planned.
    sight: CameraSight | None = None


def planned_of(planned: Planned, progress: Callable[[int, int], None] | None) -> Plan:
    """Choose the poses, put them in the order to drive, and return the plan.

    Args:
        planned: What they are chosen from, and for what.
        progress: Called with the number of forecasts done and of all; None: nothing is called.

    Raises:
        ModelError: Too few poses for the model, or a request that cannot be met.
    """
    sensitivity, request, pool, taken, body, sight = planned
    choice = choose_poses(sensitivity, pool, request, taken, progress=progress)
    robot = sensitivity.kinematics.robot
    poses = np.concatenate([choice.planned, choice.validation])
    start = None if request.start is None else np.asarray(request.start, dtype=np.float64)

    def stops() -> Array:
        """Return the first poses of the region that are free of collision; nothing need see the target there."""
        in_region = pool.workspace[:_STOPS]
        return in_region if body is None else in_region[body.free(in_region)]

    # With errors that change with a joint's value, a pose one turn on is another pose.
    turns = not sensitivity.kinematics.model.joint_terms
    limits = planning_ranges(robot, sensitivity.cell.ranges, request.margin, turns=turns)
    free_path = None if body is None else body.path_free
    route = find_route(robot, poses, limits, start, free_path, stops)
    sets = np.where(route.order < len(choice.planned), "estimate", "validate")
    return Plan(
        robot=robot,
        cell=sensitivity.cell,
        request=request,
        joints=route.joints,
        sets=tuple(sets.tolist()),
        taken=taken,
        targets=sensitivity.setup.targets,
        T_tip_target=sensitivity.setup.T_tip_target,
        expected=read_only(sensitivity.expected(route.joints)),
        model=sensitivity.kinematics.model.name,
        kind=sensitivity.kind,
        forecast=choice.forecast,
        before=choice.before,
        at_random=choice.at_random,
        ladder=choice.ladder,
        drawn=pool.drawn,
        candidates=len(pool.q),
        refused=pool.refused,
        travel=route.travel,
        blocked=route.blocked,
        notes=(*sensitivity.notes, *_notes(sensitivity.cell, body)),
        sight=sight,
    )


def stage(progress: Progress | None, stage: str) -> Callable[[int, int], None] | None:
    """Return the function that one stage of the work reports its progress to.

    Args:
        progress: Called with the name of a stage, how much of its work is done, and all of it; None: nothing is called.
        stage: Name of the stage, ``"candidates"`` or ``"choice"``.

    Returns:
        Function of the work done and all of it, two counts; None where nothing is called.
    """
    if progress is None:
        return None
    return partial(progress, stage)


def _collision_model(
    sensitivity: Sensitivity, collisions: CollisionCheck | None
) -> CollisionModel | None:
    """Return the robot with what it holds and what is around it, to be checked for collisions.

    Args:
        sensitivity: The nominal robot in its cell: ``cell.boxes``, obstacles in the robot's base; ``setup``, the names
            of the targets that it holds and their poses in the tip, shape (k, 4, 4), [m].
        collisions: Clearance, radius of what holds the targets, and folders of meshes; None: nothing is checked.

    Returns:
        The collision model, which tests poses, moves and the tracker's beam; None where nothing is checked.
    """
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
    """Draw candidates that can be measured: in the region, in the tracker's sight and free of collision.

    Args:
        sensitivity: The nominal robot in its cell; ``cell.ranges`` narrow the ranges of joints by name, [rad] or [m].
        request: ``request.candidates``, the number that is wanted; ``request.seed``; and ``request.margin`` to the
            limits of joints that turn [rad].
        region: Voxels of the robot's base frame in which the first target must lie; None: anywhere.
        body: Tests poses for collisions; None: they are not tested.
        progress: Called with the number of candidates so far and the number wanted; None: nothing is called.

    Returns:
        The pool: ``q``, joint values of the candidates, shape (n, m), [rad] or for sliding joints [m]; fewer than are
        wanted where drawing ended before. ``workspace``, joint values of poses in the region that need not be
        measurable, shape (k, m); and how many poses were drawn, and refused for which reason.
    """
    robot = sensitivity.kinematics.robot
    ranges = planning_ranges(robot, sensitivity.cell.ranges, request.margin)
    conditions = list(_conditions(sensitivity, region, body))
    return draw(robot, ranges, conditions, request.candidates, request.seed, progress)


def _conditions(
    sensitivity: Sensitivity, region: Region | None, body: CollisionModel | None
) -> Iterator[Condition]:
    """Yield what a candidate must pass, the cheap conditions first; the tracker must see every target.

    Args:
        sensitivity: The nominal robot in its cell: ``setup.T_tip_target``, poses of the targets in the tip, shape
            (k, 4, 4), [m]; ``cell.tracker`` and ``cell.reflector``, each None where it is not known.
        region: Voxels of the robot's base frame in which the first target must lie; None: anywhere.
        body: Tests collisions of the robot, and of the tracker's beam with links and boxes; None: neither is tested.

    Yields:
        A word for the reason of refusal (``"region"``, ``"tracker_range"``, ``"reflector_cone"``, ``"beam"``,
        ``"collision"``), and a function of joint values, shape (n, m), [rad] or [m], that returns True for poses that
        pass, shape (n,).
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


def _notes(cell: Cell, body: CollisionModel | None) -> list[Note]:
    """Return remarks on what was checked of poses and moves, and what was not.

    Args:
        cell: ``cell.reflector``, and ``cell.tracker``, which the reflector must face; each None where it is not known.
        body: The collision model, with ``notes`` on what it checks; None: nothing was checked.

    Returns:
        Notes, each a code with values: ``reflector_not_checked``, then ``collisions_not_checked`` or those of ``body``.
    """
    notes = []
    if cell.reflector is not None and cell.tracker is None:
        notes.append(Note("reflector_not_checked"))
    if body is None:
        notes.append(Note("collisions_not_checked"))
    else:
        notes += body.notes
    return notes
