"""How far predicted positions spread, from the parameters' covariance or between two sets of parameters.

A position's standard deviation is sqrt(trace(J C J^T)), with the derivative J of the point and the parameters'
covariance C. Sockets, planes and anchors tell neither where the base stands nor how it is turned, and nobody asks them:
all points are then looked at in one frame, and what one rigid motion of the measured poses would do is left out: the
motion that best makes up for theirs, by least squares, is taken off wherever else it is asked. So a single pose has a
standard deviation too, and one that does not depend on which others are asked with it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib.identify.fitting import Fitted
from calib.model.kinematics import Samples
from calib.model.readback import spread_poses

Array = NDArray[np.float64]

#: Poses over which expected errors are averaged; more do not change them.
_MOST_EXPECTED = 1000


def position_std(fitted: Fitted, samples: Samples) -> Array:
    """Standard deviation of predicted positions, shape (N,), [m].

    It knows nothing of errors that the model lacks.

    Args:
        fitted: The fit.
        samples: N joint values, each with its frame and target.
    """
    points, jacobian = _points_jacobian(fitted, samples)
    if not tells_place(fitted):
        seen = _points_jacobian(fitted, fitted.estimate.problem.rows.samples)
        jacobian = own_moves(fitted, points, jacobian, seen)
    covariance = fitted.estimate.covariance
    wide = (jacobian.reshape(-1, len(covariance)) @ covariance).reshape(jacobian.shape)
    spread = np.sum(wide * jacobian, axis=(1, 2))
    return np.asarray(np.sqrt(np.maximum(spread, 0.0)))


def expected_error(fitted: Fitted, *, everywhere: bool) -> float:
    """Predicted standard deviation of the target's position, rms [m]; see `position_std`.

    Args:
        fitted: The fit.
        everywhere: Over joint values spread over the limits, or over the measured poses, a thousand at most.
    """
    samples = fitted.estimate.problem.rows.samples
    if everywhere:
        samples = Samples.at(spread_poses(fitted.task.robot))
    chosen = samples.select(slice(0, _MOST_EXPECTED))
    return float(np.sqrt(np.mean(position_std(fitted, chosen) ** 2)))


def as_one_body(fitted: Fitted, samples: Samples) -> Samples:
    """The samples, all in the first frame where the fit's rows do not tell where the base stands in any.

    Args:
        fitted: The fit.
        samples: N of them.
    """
    if tells_place(fitted):
        return samples
    return replace(samples, frame=np.zeros_like(samples.frame))


def own_moves(
    fitted: Fitted, points: Array, moves: Array, seen: tuple[Array, Array] | None = None
) -> Array:
    """Moves of points, less a rigid motion of all of them where the fit's rows do not tell it, shape (N, 3, k).

    Args:
        fitted: The fit.
        points: shape (N, 3), all in one frame [m].
        moves: shape (N, 3, k), k moves of them, [m] or [m per unit].
        seen: The points at the fit's own rows and their moves, which say what rigid motion it is; None where ``points``
            are these.
    """
    return moves if tells_place(fitted) else without_rigid_motion(points, moves, seen)


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


def _points_jacobian(fitted: Fitted, samples: Samples) -> tuple[Array, Array]:
    """Points at some samples, as one body, and their derivative, shapes (N, 3) and (N, 3, p)."""
    return fitted.kinematics.points_jacobian(fitted.estimate.x, as_one_body(fitted, samples))


def tells_place(fitted: Fitted) -> bool:
    """Whether any row measured a position, which tells where the base stands.

    Args:
        fitted: The fit.
    """
    return any(kind.position for kind in fitted.estimate.problem.rows.present)
