"""Touching a board: joint values that bring a pointer to corners of a calibrated board, to check a calibration by eye.

With a camera in the hand the chain leads from the camera's link, here the base, to the link that the board stands on,
here the tip. The pointer is fixed to the camera's link, the corner c to the tip, and the joint values bring both
together, the pointer's z axis along the board's:

    T_base_tip(q) T_tip_board c  =  p_pointer,    z_board  =  z_pointer

How far the tip of the pointer is to be expected from the corner comes from the covariance of the board's pose in the
base, with what the model lacks, carried to the corner, and from that of the print, S. The length of a normal error with
this covariance is taken for a multiple of chi with n = (tr S)^2 / tr S^2 degrees of freedom, as in
`calib.verbs.compensate.expected`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.special import chdtri

from calib.basics.arrays import Array, Integers, Mask, read_only
from calib.basics.values import Value
from calib.boards.board import Board
from calib.errors import ModelError, choices
from calib.result.calibration import Calibration
from calib.robot.full_model import full_configurations, full_model, link_frame
from calib.robot.ranges import column_limits, full_ranges, spread_between
from calib.robot.robot import Robot
from calib.verbs.compensate.expected import arrival_covariance
from calib.verbs.compensate.inverse import AXIS, Matching, solve
from calib.verbs.compensate.nominal_actual import Pair, pair_of
from calib.verbs.plan.board_print import PrintedCorners, printed_corners
from calib.verbs.plan.collision import CollisionCheck, CollisionModel
from calib.verbs.plan.images.sight import outline
from calib.verbs.plan.solids import clusters

#: Share of robots whose error at a corner is below the one that is stated.
SHARE = 0.95

#: The pointer first comes to this far above the corner [m].
ABOVE = 0.050

#: Length that one radian weighs as where poses are matched [m].
_RADIAN = 0.3

#: A corner that the pointer misses by more than this is not reached [m].
_REACHED = 1e-6

#: Sets of joint values from which solutions are looked for: over the measured ranges, and over the limits.
_SPREAD = (64, 32)

#: Steps of each search at most.
_STEPS = 60

#: Solutions that are tested for collisions at most.
_TRIES = 8

#: Solutions that differ by less than this in each joint are one [rad or m].
_SAME = 1e-3

_TURN = 2.0 * np.pi


class Pointer(NamedTuple):
    """A pointed tool in the hand."""

    #: Shape (4, 4), its tip and its axis z, along which it points, in `link` [m].
    T_link_pointer: Array
    #: The link that it is fixed to; empty: the link that carries the camera.
    link: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class TouchPlan(Value):
    """Corners of a board to touch, and how."""

    #: The nominal robot, from the camera's link to the board's link.
    robot: Robot
    #: The board.
    board: Board
    #: Shape (k,), ids of the corners.
    corners: Integers
    #: Shape (k, 3), the corners in the link that the board stands on, as calibrated [m].
    places: Array
    #: Shape (k, m), joint values that touch, columns as ``robot.joint_names`` [rad] or [m]; NaN: none.
    touching: Array
    #: Shape (k, m), joint values above the corner, from where the pointer comes straight down; NaN: none.
    above: Array
    #: Shape (k,), 95 % of robots are nearer to the corner than this [m]; NaN where it cannot be touched.
    expected: Array
    #: Shape (k,), whether the pointer reaches the corner and the pose above within the joints' limits.
    reached: Mask
    #: Shape (k,), whether the robot is free of collisions with itself and the mounting plane at both poses.
    free: Mask

    @property
    def usable(self) -> Mask:
        """Corners that can be touched, shape (k,)."""
        return np.asarray(self.reached & self.free)


class _Scene(NamedTuple):
    """The calibrated robot, its board and its pointer."""

    #: The calibration.
    result: Calibration
    #: Shape (4, 4), the board in the tip, as calibrated [m].
    T_tip_board: Array
    #: Shape (4, 4), the pointer in the base [m].
    T_base_pointer: Array
    #: Shape (n, m), joint values from which solutions are sought [rad] or [m].
    seeds: Array
    #: Tests for collisions; None: nothing is tested.
    body: CollisionModel | None


class _Postures(NamedTuple):
    """Joint values that touch a corner, and those above it."""

    #: Shape (m,), [rad] or [m].
    touching: Array
    #: Shape (m,), [rad] or [m].
    above: Array
    #: Whether both are free of collisions.
    free: bool


def plan_touch(
    result: Calibration,
    board: Board,
    pointer: Pointer,
    corners: Integers | None = None,
    *,
    target: str = "",
    collisions: CollisionCheck | None = None,
) -> TouchPlan:
    """Plan to touch corners of a calibrated board with a pointer.

    Args:
        result: A calibration with a camera in the hand, and the board among its targets.
        board: The board.
        pointer: What touches it.
        corners: Ids of the corners, shape (k,); None: the outer four and the one nearest to the middle.
        target: Name of the board among the result's targets; empty: the only one.
        collisions: How the robot is checked for collisions with itself and the mounting plane; None: it is not. The
            pointer is not checked, nor is the board.

    Returns:
        Joint values for each corner, those above it, and the error to expect.

    Raises:
        ModelError: The board moves with the robot, the pointer is on a link that moves against the camera, or there is
            no such target or corner.
    """
    _check_board_stands(result.nominal)
    pair = pair_of(result, tool=target)
    chosen = _usual_corners(board) if corners is None else _checked_corners(board, corners)
    assert pair.target is not None
    part = result.part(non_geometric=pair.non_geometric)
    corner = printed_corners(part, board, pair.target, board.corners[chosen])
    scene = _scene(pair, result, pointer, collisions)
    postures = _all_postures(scene, corner.points)
    nothing = np.full(len(result.nominal.joint_names), np.nan)
    touching = np.array([nothing if p is None else p.touching for p in postures])
    above = np.array([nothing if p is None else p.above for p in postures])
    reached = np.array([p is not None for p in postures])
    return TouchPlan(
        robot=result.nominal,
        board=board,
        corners=chosen,
        places=read_only(_points_at(scene.T_tip_board, corner.points)),
        touching=read_only(touching),
        above=read_only(above),
        expected=read_only(_expected(pair, touching, reached, corner)),
        reached=reached,
        free=np.array([p is not None and p.free for p in postures]),
    )


def _scene(
    pair: Pair, result: Calibration, pointer: Pointer, collisions: CollisionCheck | None
) -> _Scene:
    """Return what the postures are sought with; see `plan_touch`."""
    robot = pair.actual.robot
    body = None
    if collisions is not None:
        body = CollisionModel.of(result.nominal, check=collisions)
    return _Scene(
        result=result,
        T_tip_board=pair.actual.T_tip_tool,
        T_base_pointer=_in_base(robot, pointer),
        seeds=_seeds(robot, result.rows.ranges),
        body=body,
    )


def _all_postures(scene: _Scene, points: Array) -> list[_Postures | None]:
    """Find the postures at each corner, near those of the one before, the first near the middle of what was measured.

    Args:
        scene: The calibrated robot, its board and its pointer.
        points: The corners on the board, shape (k, 3), [m].

    Returns:
        One entry for each corner, None where it is not reached.
    """
    near = scene.result.rows.ranges.mean(axis=1)
    postures = []
    for point in points:
        posture = _postures(scene, point, near)
        if posture is not None:
            near = posture.touching
        postures.append(posture)
    return postures


def _check_board_stands(robot: Robot) -> None:
    """Refuse a chain whose board is in the hand of the robot.

    Raises:
        ModelError: The base of the chain, which carries the camera, does not move.
    """
    if not robot.base_moves:
        raise ModelError(
            f"The board is on '{robot.tip}', which the robot moves, and the camera on '{robot.base}' stands: the robot "
            "cannot touch a board in its own hand. Corners can be touched where the board stands and the camera is in "
            "the hand. Check this calibration by images that were not fitted instead: rows of the set 'validate'."
        )


def _usual_corners(board: Board) -> Integers:
    """Return the ids of the outermost four corners, nearest to those of the pattern, and of the one in the middle."""
    nearest = []
    for place in [*outline(board), board.centre]:
        away = np.linalg.norm(board.corners - place, axis=1)
        nearest.append(int(np.argmin(away)))
    return np.array(list(dict.fromkeys(nearest)))


def _checked_corners(board: Board, corners: Integers) -> Integers:
    """Return ids of corners that the board has.

    Raises:
        ModelError: It does not have one of them.
    """
    count = len(board.corners)
    absent = [int(corner) for corner in corners if not 0 <= corner < count]
    if absent:
        raise ModelError(
            f"The board '{board.name}' has no corner {choices(map(str, absent))}; its corners are 0 to {count - 1}."
        )
    return np.asarray(corners, dtype=np.int_)


def _in_base(robot: Robot, pointer: Pointer) -> Array:
    """Return the pose of the pointer in the base of the chain, shape (4, 4) [m].

    Args:
        robot: The calibrated robot, from the camera's link to the board's link.
        pointer: The pointer and its link.

    Raises:
        ModelError: The link does not exist, or moves against the base.
    """
    link = pointer.link or robot.base
    if link not in robot.urdf.links:
        raise ModelError(f"There is no link '{link}' for the pointer in {robot.urdf.source}.")
    fixed = [joint for joint in robot.urdf.joints if joint.type == "fixed"]
    welded = clusters(robot.urdf, fixed)
    if welded[link] != welded[robot.base]:
        raise ModelError(
            f"The pointer is on '{link}', which moves against '{robot.base}', the link of the camera. The calibrated "
            "chain ends there: give the pointer on a link that is fixed to it."
        )
    model = full_model(robot.urdf)
    values = robot.urdf_values(np.zeros((1, len(robot.joint_names))))
    data = model.createData()
    pin.framesForwardKinematics(model, data, full_configurations(model, values)[0])
    base, other = (data.oMf[link_frame(model, name)] for name in (robot.base, link))
    return np.asarray((base.inverse() * other).homogeneous @ pointer.T_link_pointer)


def _points_at(T: Array, points: Array) -> Array:
    """Return points (k, 3) of a frame at a pose (4, 4), shape (k, 3) [m]."""
    return np.asarray(points @ T[:3, :3].T + T[:3, 3])


def _postures(scene: _Scene, point: Array, near: Array) -> _Postures | None:
    """Find joint values that touch a corner, and that stand above it.

    Args:
        scene: The calibrated robot, its board and its pointer.
        point: The corner on the board, shape (3,), [m].
        near: Joint values near which they are sought, shape (m,), [rad] or [m].

    Returns:
        Those free of collisions and nearest; those that collide where there are no others; None where the corner is not
        reached.
    """
    colliding = None
    seeds = np.concatenate([near[None], scene.seeds])
    higher = point - [0.0, 0.0, ABOVE]
    for touching in _solutions(scene, point, seeds, near)[:_TRIES]:
        for above in _solutions(scene, higher, touching[None], touching):
            if scene.body is None or bool(scene.body.free(np.array([touching, above])).all()):
                return _Postures(touching, above, free=True)
            colliding = colliding or _Postures(touching, above, free=False)
    return colliding


def _solutions(scene: _Scene, point: Array, seeds: Array, near: Array) -> Array:
    """Find joint values that bring a point of the board to the pointer, its z axis along the board's.

    Args:
        scene: The calibrated robot, its board and its pointer.
        point: The point on the board, shape (3,), [m].
        seeds: Joint values from which they are sought, shape (n, m), [rad] or [m].
        near: Joint values to which they are near, shape (m,), [rad] or [m].

    Returns:
        Shape (k, m), [rad] or [m], within the limits, all different, the nearest first; k may be 0.
    """
    T_tip_point = scene.T_tip_board.copy()
    T_tip_point[:3, 3] += scene.T_tip_board[:3, :3] @ point
    arm = pair_of(scene.result, tool=T_tip_point).actual
    matching = Matching(AXIS, _RADIAN)
    wanted = np.tile(scene.T_base_pointer, (len(seeds), 1, 1))
    limits = column_limits(arm.robot)
    solution = solve(arm, wanted, seeds, matching, limits, steps=_STEPS)
    q = _whole_turns_off(arm.robot, solution.q, near)
    values = arm.robot.input_values(q)
    inside = ((values >= limits[:, 0]) & (values <= limits[:, 1])).all(axis=1)
    missed = np.linalg.norm(matching.error(solution.T_base_tool, wanted), axis=1)
    q = q[inside & (missed <= _REACHED)]
    away = np.abs(q - near).max(axis=1)
    return _different(q[np.argsort(away)])


def _seeds(robot: Robot, measured: Array) -> Array:
    """Return joint values spread over the measured ranges (m, 2) and over the limits, shape (n, m)."""
    inner, outer = _SPREAD
    spread = robot.readings(spread_between(full_ranges(robot), outer))
    return np.concatenate([spread_between(measured, inner), spread])


def _whole_turns_off(robot: Robot, q: Array, middle: Array) -> Array:
    """Return readings (n, m) with joints that turn moved by whole turns next to others (m,), where limits allow."""
    turns = np.array([joint.type != "prismatic" for joint in robot.inputs])
    limits = column_limits(robot)
    values, centre = robot.input_values(q), robot.input_values(middle)
    moved = values - _TURN * np.round((values - centre) / _TURN)
    fits = turns & (moved >= limits[:, 0]) & (moved <= limits[:, 1])
    return robot.readings(np.where(fits, moved, values))


def _different(q: Array) -> Array:
    """Return joint values (n, m), each solution once, in the same order."""
    kept: list[Array] = []
    for row in q:
        if all(np.abs(row - other).max() > _SAME for other in kept):
            kept.append(row)
    return np.array(kept).reshape(-1, q.shape[1])


def _expected(pair: Pair, touching: Array, reached: Mask, corners: PrintedCorners) -> Array:
    """Compute the error that 95 % of robots stay below at each corner, shape (k,) [m]; NaN where it is not reached.

    Args:
        pair: The calibrated robot with the board as its tool.
        touching: Joint values at the corners, shape (k, m), [rad] or [m].
        reached: Corners that are reached, shape (k,).
        corners: The k corners on the board.
    """
    expected = np.full(len(reached), np.nan)
    if reached.any():
        q = touching[reached]
        R = pair.actual.poses(q)[:, :3, :3]
        lever = (R @ corners.points[reached][:, :, None])[:, :, 0]
        of_pose = at_lever(arrival_covariance(pair, q), lever)
        of_print = R @ corners.covariance[reached] @ R.swapaxes(1, 2)
        expected[reached] = bounds(of_pose + of_print)
    return expected


def at_lever(covariance: Array, lever: Array) -> Array:
    """Carry the covariance of poses to points fixed to them.

    Args:
        covariance: Shape (n, 6, 6), of poses, linear part first [m, rad].
        lever: From each pose's origin to its point, along the axes of the covariance, shape (n, 3), [m].

    Returns:
        Covariance of the points' positions, shape (n, 3, 3), [m^2].
    """
    # A small turn w moves the point by w x lever = -[lever]x w.
    J = np.zeros((len(lever), 3, 6))
    J[:, range(3), range(3)] = 1.0
    for k, axis in enumerate(np.eye(3)):
        J[:, :, 3 + k] = np.cross(axis, lever)
    return np.asarray(J @ covariance @ J.swapaxes(1, 2))


def bounds(covariance: Array) -> Array:
    """Return the length that 95 % of normal errors stay below, covariance (n, 3, 3) [m^2], shape (n,) [m]."""
    trace = np.trace(covariance, axis1=1, axis2=2)
    square = np.sum(covariance**2, axis=(1, 2))
    freedom = trace**2 / np.maximum(square, np.finfo(np.float64).tiny)
    return np.asarray(np.sqrt(trace / freedom * chdtri(freedom, 1.0 - SHARE)))
