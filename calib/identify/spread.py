"""How far predicted positions spread, from the parameters' covariance or between two sets of parameters.

A position's standard deviation is sqrt(trace(J C J^T)), with the derivative J of the point and the parameters'
covariance C. Sockets, planes and anchors tell neither where the base stands nor how it is turned, and nobody asks them:
all points are then looked at in one frame, and what one rigid motion of them would do is left out, by the projection
onto what it cannot do.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib.identify.fitting import Fitted
from calib.identify.rows import POINT, POSE
from calib.model.kinematics import Samples

Array = NDArray[np.float64]


def position_std(fitted: Fitted, samples: Samples) -> Array:
    """Standard deviation of predicted positions, shape (N,), [m].

    It knows nothing of errors that the model lacks.

    Args:
        fitted: The fit.
        samples: N joint values, each with its frame and target.
    """
    points, jacobian = fitted.kinematics.points_jacobian(
        fitted.estimate.x, as_one_body(fitted, samples)
    )
    jacobian = own_moves(fitted, points, jacobian)
    spread = np.einsum("nij,jk,nik->n", jacobian, fitted.estimate.covariance, jacobian)
    return np.asarray(np.sqrt(np.maximum(spread, 0.0)))


def as_one_body(fitted: Fitted, samples: Samples) -> Samples:
    """The samples, all in the first frame where the fit's rows do not tell where the base stands in any.

    Args:
        fitted: The fit.
        samples: N of them.
    """
    if _tells_place(fitted):
        return samples
    return replace(samples, frame=np.zeros_like(samples.frame))


def own_moves(fitted: Fitted, points: Array, moves: Array) -> Array:
    """Moves of points, less a rigid motion of all of them where the fit's rows do not tell it, shape (N, 3, k).

    Args:
        fitted: The fit.
        points: shape (N, 3), all in one frame [m].
        moves: shape (N, 3, k), k moves of them, [m] or [m per unit].
    """
    return moves if _tells_place(fitted) else without_rigid_motion(points, moves)


def without_rigid_motion(points: Array, moves: Array) -> Array:
    """Moves of points, less what one rigid motion of all of them can do, shape (N, 3, k).

    Args:
        points: shape (N, 3), [m].
        moves: shape (N, 3, k), k moves of them, [m] or [m per unit].
    """
    motion = np.zeros((len(points), 3, 6))
    motion[:, :, :3] = np.eye(3)
    motion[:, :, 3:] = np.cross(np.eye(3), points[:, None, :]).transpose(0, 2, 1)
    base = np.linalg.qr(motion.reshape(-1, 6))[0]
    flat = moves.reshape(-1, moves.shape[2])
    return np.asarray((flat - base @ (base.T @ flat)).reshape(moves.shape))


def _tells_place(fitted: Fitted) -> bool:
    """Whether any row measured a position."""
    return bool(np.any(np.isin(fitted.estimate.problem.rows.kinds, (POINT, POSE))))
