"""What is left of moves of points once the best rigid motion of them all is taken off.

Sockets, planes, anchors and pairs tell neither where the base stands nor how it is turned. Where only the shape of all
positions counts, in forecasts, virtual experiments and comparisons of two fits, points are looked at as one body.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def without_rigid_motion(
    points: Array, moves: Array, seen: tuple[Array, Array] | None = None
) -> Array:
    """Moves of points, less the rigid motion that best makes up for them, shape (N, 3, k).

    Args:
        points: shape (N, 3), [m].
        moves: shape (N, 3, k), k moves of them, [m] or [m per unit].
        seen: Points and their k moves that the motion makes up for; None for the same.
    """
    motion = best_motion(*((points, moves) if seen is None else seen))
    return np.asarray(moves - moved_by(motion, points))


def best_motion(points: Array, moves: Array) -> Array:
    """The rigid motions that best make up for moves of points, shape (6, k): of the origin, then turns [rad].

    Args:
        points: shape (N, 3), [m].
        moves: shape (N, 3, k), k moves of them, [m] or [m per unit].
    """
    middle = points.mean(axis=0)
    columns = np.zeros((len(points), 3, 6))
    columns[:, :, :3] = np.eye(3)
    columns[:, :, 3:] = np.cross(np.eye(3), (points - middle)[:, None, :]).transpose(0, 2, 1)
    flat = moves.reshape(-1, moves.shape[2])
    # Points on a line tell nothing of a turn about it: the shortest solution has none.
    motion = np.linalg.lstsq(columns.reshape(-1, 6), flat, rcond=1e-9)[0]
    motion[:3] -= np.cross(motion[3:], middle, axisa=0).T
    return np.asarray(motion)


def moved_by(motion: Array, points: Array) -> Array:
    """What rigid motions do to points, shape (N, 3, k).

    Args:
        motion: shape (6, k), see `best_motion`.
        points: shape (N, 3), [m].
    """
    return np.asarray(motion[:3] + np.cross(motion[3:].T, points[:, None]).transpose(0, 2, 1))
