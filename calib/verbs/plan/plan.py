"""plan: a robot in a cell in, the poses to measure out, in the order to drive.

The order of the work: candidates inside the joint ranges that the instrument sees, in the region and free of collision;
the choice under the model that the fit will use; poses to validate with; the order to drive; the forecast. The cell has
the instrument: a tracker and its targets, or a camera and a board.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from calib.basics.arguments import check_callable, check_type
from calib.basics.arrays import Array, Mask, read_only
from calib.basics.values import Value, keep_read_only, shown_by
from calib.data.cell import Cell
from calib.data.cell_chains import Sight
from calib.data.inputs import CellInput, RobotInput, cell_of, robot_of
from calib.errors import ModelError
from calib.instruments.instrument import Instrument, Sightline
from calib.numerics.moves import last_moves
from calib.robot.robot import Robot
from calib.verbs.plan.choice import PlanRequest, choose_poses
from calib.verbs.plan.collision import CollisionCheck
from calib.verbs.plan.forecast import Forecast, Workspace
from calib.verbs.plan.notes import Note
from calib.verbs.plan.pose_candidates import Pool, rounded
from calib.verbs.plan.reachable import check_placed, reachable
from calib.verbs.plan.route import Blocked, find_route
from calib.verbs.plan.sensitivity import Sensitivity, View
from calib.verbs.workspace.region import Region

#: Called with the stage of the work, how much of it is done, and all of it.
Progress = Callable[[str, int, int], None]

#: The print's scale is worth a remark if the error without its uncertainty is a smaller share of that with it.
_MATTERS = 0.7

_USUAL_REQUEST = PlanRequest()
_USUAL_CHECK = CollisionCheck()


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Plan(Value):
    """Poses to measure, in the order to drive."""

    #: The robot.
    robot: Robot
    #: The cell that was planned for.
    cell: Cell
    #: The instrument that measures the targets, or the first one of several.
    instrument: Instrument
    #: The request.
    request: PlanRequest
    #: Shape (K, m), joint values [rad] or [m], whole steps of 0.001 deg or mm, columns as ``robot.joint_names``; a pose
    #: that is measured from both sides is there twice.
    joints: Array
    #: Shape (K, m), last move of each joint before each pose, [rad] or [m]; 0 before the first one of a straight route.
    moves: Array
    #: ``"estimate"`` or ``"validate"`` for each pose.
    sets: tuple[str, ...]
    #: Shape (T, m), poses that were measured already.
    taken: Array
    #: Shape (T, m), last move of each joint before each of these, [rad] or [m].
    taken_moves: Array
    #: The targets measured at every pose.
    targets: tuple[str, ...]
    #: Shape (targets, 4, 4), their poses in the tip [m].
    T_tip_target: Array
    #: Shape (K, k, 3), each target (of a board its centre) as the nominal robot predicts it, in the measurement frame
    #: if that is known, else in the base [m]; in the order of ``sights``.
    expected: Array
    #: The parameter set planned for.
    model: str
    #: Kind of measurement at each pose.
    kind: str
    #: Forecast of the fit of taken poses and planned ones.
    forecast: Forecast
    #: Forecast of a fit of the poses taken alone; None if none are taken.
    before: Forecast | None
    #: Forecast of as many poses drawn at random from the same candidates, in place of the planned ones: the median of
    #: several draws.
    at_random: Forecast
    #: Forecasts for other numbers of planned poses, in rising order, that of the plan among them.
    ladder: tuple[tuple[int, Forecast], ...]
    #: Number of candidates drawn.
    drawn: int
    #: Number of these that can be measured.
    candidates: int
    #: Number of these that were refused, by reason, in the order of the conditions.
    refused: Mapping[str, int]
    #: The sum over all moves of the largest move of a joint [rad] or [m].
    travel: float
    #: The moves whose straight way is not free.
    blocked: tuple[Blocked, ...]
    #: Remarks for the person who measures.
    notes: tuple[Note, ...]
    #: Station and target of each of the k places of ``expected``, by name.
    sights: tuple[Sight, ...]
    #: Shape (K, k), whether each of them is to be measured at each pose.
    seen: Mask
    #: Shape (T, k), whether each of them was measured at the poses measured already.
    taken_seen: Mask
    #: What the instruments measure at a pose.
    views: tuple[View, ...]

    def __repr__(self) -> str:
        """One line: the robot, numbers of poses, expected error."""
        return str(shown_by("verbs.plan.text").plan_line(self))

    def _repr_html_(self) -> str:
        """A small table for notebooks: numbers of poses, expected errors."""
        return str(shown_by("verbs.plan.text").plan_html(self))

    def summary(self) -> str:
        """Return the plan as text, as ``calib plan`` prints it."""
        return str(shown_by("verbs.plan.text").plan_text(self))

    def __post_init__(self) -> None:
        """Keep a read-only copy of the mapping."""
        keep_read_only(self, "refused")

    @property
    def sightline(self) -> Sightline:
        """The instrument and its first target, with the chain between them; the instrument's place must be known."""
        return self.sightlines[0]

    @property
    def sightlines(self) -> tuple[Sightline, ...]:
        """Each instrument and its first target; the instruments' places must be known."""
        sightlines = []
        for view in self.views:
            T_instrument_base = view.instrument.T_instrument_base
            assert T_instrument_base is not None
            chain = self.robot.chains[view.chain]
            sightlines.append(
                Sightline(chain, T_instrument_base, self.T_tip_target[view.targets[0]])
            )
        return tuple(sightlines)

    def places(self, q: Array) -> Array:
        """Predict the position of each target in the robot's base, by the nominal robot.

        Each target is on the tip of its own chain. One that is seen from other links only is in the first of these.

        Args:
            q: Joint values of N poses, shape (N, m), [rad] or for sliding joints [m], columns as ``robot.joint_names``.

        Returns:
            Shape (N, k, 3), [m], in the order of ``targets``.
        """
        chains = self.robot.chains
        by_target = []
        for t, T in enumerate(self.T_tip_target):
            seen_through = [chains[view.chain] for view in self.views if t in view.targets]
            from_base = [chain for chain in seen_through if chain.base == self.robot.base]
            chain = (*from_base, *seen_through)[0]
            by_target.append((chain.poses(q) @ T)[:, :3, 3])
        return np.stack(by_target, axis=1)

    @property
    def via(self) -> Array | None:
        """Joint values to drive to before each pose, so that it is approached as requested.

        Shape (K, m), [rad] or for sliding joints [m]; None: straight from the pose before.
        """
        if self.request.approach == "straight":
            return None
        return rounded(self.robot, self.joints - self.moves)

    @property
    def fitted(self) -> tuple[Array, Array]:
        """Joint values of all poses to fit, taken and planned, and the last move of each joint before each of them."""
        chosen = np.array(self.sets) == "estimate"
        joints = np.concatenate([self.taken, self.joints[chosen]])
        return joints, np.concatenate([self.taken_moves, self.moves[chosen]])

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
    taken_moves: ArrayLike | None = None,
    taken_sights: Sequence[Collection[Sight]] | None = None,
    collisions: CollisionCheck | None = _USUAL_CHECK,
    progress: Progress | None = None,
) -> Plan:
    """Plan the poses of a calibration: which to measure, and in which order to drive.

    Args:
        robot: The nominal robot, from the link of the instrument (of a tracker, any link that does not move) to the
            link of the targets, with a branch for each further pair of such links; or the path of a URDF or xacro, or a
            name such as ``"ur3"``, with the cell's links, or the URDF's root and its farthest link.
        cell: Cell that the fit will use, model and priors included, and the surroundings: boxes, joint ranges, tracker
            and reflector. With a camera and a board, ``T_frame_base`` is the pose of the camera's link in the camera,
            and ``target`` and ``target_rotation`` are the pose of the board in its link, to a few centimetres and
            degrees. Or the path of a cell file; None: the default cell. The model ``"auto"`` is planned for as
            ``"placement"``, the largest geometry.
        request: Numbers of poses, criterion, margin to joint limits, start, seed, and where a board may be in a camera.
        region: Voxels of the robot's base frame in which the first target is to lie; None: anywhere.
        taken: Joint values of poses that are measured already, shape (T, m) or (m,), [rad] or for sliding joints [m],
            columns as ``robot.joint_names``: the plan adds to them; None: none.
        taken_moves: Last move of each joint before each of these, of the same shape, [rad] or [m]; None: from the pose
            before.
        taken_sights: Stations and targets, by name, that were measured at each of these, in a cell of several; None:
            all.
        collisions: How poses and moves are checked for collisions of the robot and what it holds with the robot itself,
            the cell's boxes and the mounting plane, and lines of sight; None: they are not checked.
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
    check_placed(known)
    sensitivity = Sensitivity.of(arm, known, limits=request.sight)
    instrument, views = sensitivity.instrument, sensitivity.views
    several = len(views) > 1
    request = request.complete(instrument)
    no_poses = np.zeros((0, len(arm.inputs)))
    measured = no_poses if taken is None else arm.columns(taken, "taken")
    measured_moves = last_moves(measured)
    if taken_moves is not None:
        measured_moves = arm.columns(taken_moves, "taken_moves")
        if measured_moves.shape != measured.shape:
            raise ModelError("The argument 'taken_moves' must have one row for each of 'taken'.")
    taken_seen = _seen_already(sensitivity, len(measured), taken_sights)
    if several and instrument.VIEWPOINT_NUMBERS:
        # A table of corners has many rows for an image.
        stops_of_table = np.hstack([measured, measured_moves])
        _, first, same = np.unique(stops_of_table, axis=0, return_index=True, return_inverse=True)
        union = np.zeros((len(first), len(views)), dtype=np.bool_)
        np.logical_or.at(union, same.reshape(-1), taken_seen)
        order = np.argsort(first)
        measured, measured_moves = measured[first[order]], measured_moves[first[order]]
        taken_seen = union[order]
    elif not several:
        visited = instrument.stops(np.hstack([measured, measured_moves]))
        measured, measured_moves = np.hsplit(visited, 2)
        taken_seen = np.ones((len(measured), 1), dtype=np.bool_)
    measured, measured_moves = read_only(measured), read_only(measured_moves)

    ground = reachable(sensitivity, request, region, collisions, _stage(progress, "candidates"))
    pool, body, sides = ground.pool, ground.body, ground.sides
    choice = choose_poses(
        sensitivity,
        pool,
        request,
        measured,
        taken_moves=measured_moves,
        taken_seen=taken_seen if several else None,
        sides=sides,
        progress=_stage(progress, "choice"),
    )

    poses = np.concatenate([choice.planned, choice.validation])
    start = None if request.start is None else np.asarray(request.start, dtype=np.float64)
    path_free = None if body is None else body.path_free
    route = find_route(arm, poses, ground.limits, start, path_free, ground.stops, sides)
    is_fitted = route.order < len(choice.planned)
    fitted = np.concatenate([measured, route.joints[is_fitted]])
    fitted_moves = np.concatenate([measured_moves, route.moves[is_fitted]])
    seen = np.ones((len(route.order), 1), dtype=np.bool_)
    fitted_seen = None
    if choice.seen is not None:
        seen = choice.seen[route.order]
        fitted_seen = np.concatenate([taken_seen, seen[is_fitted]])
    forecast = choice.forecast
    if sensitivity.kinematics.model.depends_on_moves:  # now that the order is known
        forecast = Forecast.of(sensitivity, choice.workspace, fitted, fitted_moves, fitted_seen)
    notes = _scale_notes(sensitivity, pool, fitted, fitted_seen, forecast.rms)
    notes += sensitivity.notes
    if request.approach == "one" and sensitivity.kinematics.model.depends_on_moves:
        notes.append(Note("one_side_hides"))
    if known.reflector is not None and known.tracker is None:
        notes.append(Note("reflector_not_checked"))
    notes += [Note("collisions_not_checked")] if body is None else body.notes
    return Plan(
        robot=arm,
        cell=sensitivity.cell,
        instrument=instrument,
        request=request,
        joints=route.joints,
        moves=route.moves,
        sets=tuple(np.where(is_fitted, "estimate", "validate").tolist()),
        taken=measured,
        taken_moves=measured_moves,
        targets=sensitivity.setup.targets,
        T_tip_target=sensitivity.setup.T_tip_target,
        expected=read_only(sensitivity.expected(route.joints)),
        model=sensitivity.kinematics.model.name,
        kind=instrument.kind.name,
        forecast=forecast,
        before=choice.before,
        at_random=choice.at_random,
        ladder=choice.ladder,
        drawn=pool.drawn,
        candidates=len(pool.q),
        refused=pool.refused,
        travel=route.travel,
        blocked=route.blocked,
        notes=tuple(notes),
        sights=sensitivity.sights,
        seen=sensitivity.of_sights(seen),
        taken_seen=sensitivity.of_sights(taken_seen),
        views=views,
    )


def _seen_already(
    sensitivity: Sensitivity, count: int, sights: Sequence[Collection[Sight]] | None
) -> Mask:
    """Return which views measured at the poses that are measured already, by their stations and targets, (T, v).

    It raises `ModelError` if there are more or fewer of these than the ``count`` poses.
    """
    of_views = []
    for view in sensitivity.views:
        group = sensitivity.setup.groups[view.frame]
        of_views.append({(group, sensitivity.setup.targets[t]) for t in view.targets})
    if sights is None:
        return np.ones((count, len(of_views)), dtype=np.bool_)
    if len(sights) != count:
        raise ModelError("The argument 'taken_sights' must have one entry for each of 'taken'.")
    seen = [[bool(of_view & set(at_pose)) for of_view in of_views] for at_pose in sights]
    return np.array(seen, dtype=np.bool_).reshape(count, len(of_views))


def _stage(progress: Progress | None, stage: str) -> Callable[[int, int], None] | None:
    """Return the function to which one stage of the work reports its progress."""
    return None if progress is None else partial(progress, stage)


def _scale_notes(
    sensitivity: Sensitivity, pool: Pool, q: Array, seen: Mask | None, rms: float
) -> list[Note]:
    """Return the remark that the unknown scale of a print makes most of the forecast error, if it does, else nothing.

    The fit is of poses (n, m) where some views, (n, v), or all (None) measure, whose forecast error is ``rms`` [m]; it
    is compared with that of an exact scale.
    """
    is_scale = np.array([name.startswith("board_scale") for name in sensitivity.names])
    if not is_scale.any():
        return []
    precision = np.where(is_scale, 1e6 * sensitivity.precision, sensitivity.precision)
    exact = replace(sensitivity, precision=read_only(precision))
    workspace = Workspace.of(exact, pool.workspace, pool.measurable, pool.seen)
    rms_if_exact = Forecast.of(exact, workspace, q, seen=seen).rms
    if rms_if_exact > _MATTERS * rms:
        return []
    (sigma, *_) = [
        unknown.sigma
        for unknown in sensitivity.setup.internals
        if unknown.parameter.name.startswith("board_scale")
    ]
    return [Note("board_scale", (sigma, rms_if_exact))]
