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
    of_points, of_moves = (points, moves) if seen is None else seen
    middle = of_points.mean(axis=0)
    flat = of_moves.reshape(-1, of_moves.shape[2])
    # Points on a line tell nothing of a turn about it: the shortest solution has none.
    motion = np.linalg.lstsq(_rigid(of_points - middle), flat, rcond=1e-9)[0]
    return np.asarray(moves - (_rigid(points - middle) @ motion).reshape(moves.shape))


def _rigid(points: Array) -> Array:
    """What the six rigid motions do to points, shape (3 N, 6)."""
    motion = np.zeros((len(points), 3, 6))
    motion[:, :, :3] = np.eye(3)
    motion[:, :, 3:] = np.cross(np.eye(3), points[:, None, :]).transpose(0, 2, 1)
    return motion.reshape(-1, 6)
