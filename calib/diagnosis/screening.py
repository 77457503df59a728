"""Errors of the nominal robot for thousands of other inputs at once, to choose those that are worth a registration.

    b_i = p_i + R_i c + e_i

with the tip at (R_i, p_i), the measured point b_i in the base and the target c in the tip. With the frame known, c is
the mean of R_i^T (b_i - p_i). With it unknown, frame and targets are improved in turn, each in closed form.
"""

from __future__ import annotations

import numpy as np

from calib.basics.arrays import Array
from calib.fit.registration.rows import Rows
from calib.fit.registration.setup import Setup
from calib.robot.robot import Robot

#: Poses that are computed at once: more take memory and no less time.
_CHUNK = 50_000

#: Turns of improving an unknown frame and the targets. Each lowers the error of the target to about the square of the
#: mean rotation's size: to a tenth if the tip's orientations vary by 90 deg. Candidates are ranked, not judged, by it.
_ROUNDS = 8


def screened_errors(robot: Robot, setup: Setup, rows: Rows, q: Array, points: Array) -> Array:
    """Return the rms error of each of T other inputs, with all targets unknown.

    Args:
        robot: The nominal robot.
        setup: Frames and targets; a frame with any unknown is taken as wholly unknown.
        rows: N rows of points, which say frame and target of each.
        q: Joint values of each input, shape (T, N, m) [rad] or [m].
        points: Measured points of each, shape (T, N, 3) or, if they are the same in all, (N, 3) [m].

    Returns:
        Rms error, the norm of three scalars, shape (T,) [m]; of an unknown frame not quite the least one.
    """
    trials, count, columns = q.shape
    points = np.broadcast_to(points, (trials, count, 3))
    errors = np.empty(trials)
    step = max(1, _CHUNK // count)
    for first in range(0, trials, step):
        part = slice(first, first + step)
        tried = q[part]
        chain = rows.samples.chain
        chains = None if chain is None else np.tile(chain, len(tried))
        T = robot.poses(tried.reshape(-1, columns), chains).reshape(-1, count, 4, 4)
        errors[part] = errors_of_tips(setup, rows, T, points[part])
    return errors


def errors_of_tips(setup: Setup, rows: Rows, T_base_tip: Array, points: Array) -> Array:
    """Return the rms error of each of T robots, with all targets unknown.

    Args:
        setup: Frames and targets; a frame with any unknown is taken as wholly unknown.
        rows: N rows of points, which say frame and target of each.
        T_base_tip: Pose of each robot's tip at the rows, shape (T, N, 4, 4) [m].
        points: Measured points of each, shape (T, N, 3) [m].

    Returns:
        Rms error, the norm of three scalars, shape (T,) [m]; of an unknown frame not quite the least one.
    """
    R, p = T_base_tip[..., :3, :3], T_base_tip[..., :3, 3]
    frame, target = rows.samples.frame, rows.samples.target
    to_frame = setup.T_frame_base[frame]
    base_points = np.einsum("nji,tnj->tni", to_frame[:, :3, :3], points - to_frame[:, :3, 3])
    unknown = [f for f, directions in enumerate(setup.unknown) if directions and np.any(frame == f)]
    c = np.broadcast_to(setup.T_tip_target[target, :3, 3], p.shape).copy()
    for _ in range(_ROUNDS if unknown else 1):
        predicted = p + np.einsum("tnij,tnj->tni", R, c)
        for f in unknown:
            of_frame = frame == f
            base_points[:, of_frame] = _moved_onto(points[:, of_frame], predicted[:, of_frame])
        in_tip = np.einsum("tnji,tnj->tni", R, base_points - p)
        for t in np.unique(target):
            of_target = target == t
            c[:, of_target] = np.mean(in_tip[:, of_target], axis=1, keepdims=True)
    residual = base_points - p - np.einsum("tnij,tnj->tni", R, c)
    return np.asarray(np.sqrt(np.mean(np.sum(residual**2, axis=2), axis=1)))


def _moved_onto(points: Array, others: Array) -> Array:
    """Return T sets of points, (T, n, 3), moved rigidly so that they lie as close as may be to others, (T, n, 3)."""
    centre, centre_of_others = (
        points.mean(axis=1, keepdims=True),
        others.mean(axis=1, keepdims=True),
    )
    away = points - centre
    U, _, Vt = np.linalg.svd(np.einsum("tni,tnj->tij", away, others - centre_of_others))
    U[..., 2] *= np.linalg.det(U @ Vt)[:, None]  # a rotation, no mirror
    return np.asarray(np.einsum("tni,tij->tnj", away, U @ Vt) + centre_of_others)
