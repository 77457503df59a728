"""Rigid motions that explain small displacements of points best: the gauge of predictions whose base is unknown.

A small motion (v, w) of a body displaces its point p by v + w x p. With many displacements at a time, one for each
parameter, the least-squares motions are columns of one matrix.
"""

from __future__ import annotations

import numpy as np

from calib.units import Array

#: Points whose rms distance from a line is below this do not determine a turn about it [m]. It is the least ratio of
#: singular values, of a turn's and a shift's.
_SHORT_LEVER = 1e-2


def best_motion(points: Array, displacements: Array) -> Array:
    """Fit rigid motions to displacements of points, by least squares.

    A turn about a line that all points are near to is not determined; the shortest solution has none.

    Args:
        points: shape (N, 3), [m].
        displacements: shape (N, 3, k), k displacements of each point, in a unit of any kind.

    Returns:
        Motions, shape (6, k): the velocity of the origin, then the turn, in that unit [.] and [./m].
    """
    middle = points.mean(axis=0)
    columns = np.zeros((len(points), 3, 6))
    columns[:, :, :3] = np.eye(3)
    columns[:, :, 3:] = np.cross(np.eye(3), (points - middle)[:, None, :]).transpose(0, 2, 1)
    flat = displacements.reshape(-1, displacements.shape[2])
    motion = np.linalg.lstsq(columns.reshape(-1, 6), flat, rcond=_SHORT_LEVER)[0]
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
    turns = np.cross(motion[3:].T, points[:, None])
    return np.asarray(motion[:3] + turns.transpose(0, 2, 1))


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
    fitted_points, fitted_displacements = reference or (points, displacements)
    motion = best_motion(fitted_points, fitted_displacements)
    return np.asarray(displacements - displacements_by(motion, points))
