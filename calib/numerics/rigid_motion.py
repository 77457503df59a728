"""Rigid motions that explain small displacements of points best: the gauge of predictions whose base is unknown.

A small motion (v, w) of a body displaces its point p by v + w x p. With many displacements at a time, one for each
parameter, the least-squares motions are columns of one matrix.
"""

from __future__ import annotations

import numpy as np

from calib.basics.arrays import Array

#: Points whose rms distance from a line is below this do not determine a turn about it [m]: the least ratio of a turn's
#: singular value to a shift's.
_SHORT_LEVER = 1e-2


def best_motion(points: Array, displacements: Array) -> Array:
    """Fit rigid motions to displacements of points, by least squares.

    A turn about a line that all points are near to is not determined; the shortest solution has none.

    Args:
        points: shape (N, 3), [m].
        displacements: shape (N, 3, k), k displacements of each point, in any unit.

    Returns:
        Motions, shape (6, k), that make these displacements: rows 0 to 2 are the velocity of the origin, in that unit;
        rows 3 to 5 the turn, in that unit per metre.
    """
    middle = points.mean(axis=0)
    columns = displacements_by(np.eye(6), points - middle).reshape(-1, 6)
    flat = displacements.reshape(-1, displacements.shape[2])
    motion, *_ = np.linalg.lstsq(columns, flat, rcond=_SHORT_LEVER)
    # From the middle of the points to the origin.
    motion[:3] -= np.cross(motion[3:], middle, axisa=0).T
    return np.asarray(motion)


def displacements_by(motion: Array, points: Array) -> Array:
    """Return the displacements of points by small rigid motions, v + w x p.

    Args:
        motion: shape (6, k), velocity v of the origin [m], then turn w [rad].
        points: shape (N, 3), [m].

    Returns:
        shape (N, 3, k), [m].
    """
    velocity = motion[:3]
    turn = motion[3:]
    by_turns = np.cross(turn.T, points[:, None])  # one row for each motion
    return np.asarray(velocity + by_turns.transpose(0, 2, 1))


def without_rigid_motion(
    points: Array, displacements: Array, reference: tuple[Array, Array] | None = None
) -> Array:
    """Subtract from displacements the rigid motion that explains them best.

    Args:
        points: shape (N, 3), [m].
        displacements: shape (N, 3, k), [m].
        reference: Points (M, 3) and displacements (M, 3, k) to which the motion is fitted; None: those above.

    Returns:
        Displacements less those by the motion, shape (N, 3, k), [m].
    """
    if reference is None:
        reference = (points, displacements)
    motion = best_motion(*reference)
    return np.asarray(displacements - displacements_by(motion, points))
