"""Errors of boards in three dimensions: each view's own pose of the board against the predicted one.

Images show displacements across the line of sight well, and those along it hardly: 1 % nearer is 1 % larger. So an
error in depth hides behind small residuals. The pose that a view alone determines differs from the predicted one, to
first order, by

    d = (J^T J)^-1 J^T r,        cov d = sigma^2 (J^T J)^-1,        sigma^2 = |r - J d|^2 / (2 k - 6)

with the residual r of its k corners, measured minus predicted, and its derivative J by the board's displacement at its
middle and its turn. What d exceeds its covariance by is the prediction's error, of the robot, the mount, the lens or
the print.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.basics.arrays import Array, Mask
from calib.basics.values import Value
from calib.fit.registration.rows import Rows
from calib.model.internals import InternalValues
from calib.model.kinematics import Sightings

#: The fewest corners of a view: they leave two scalars beyond the six of the pose.
_FEWEST = 4

#: Condition of J^T J, lengths and angles scaled, above which a view does not determine the pose: corners on a line.
_WORST = 1e12


@dataclass(frozen=True, slots=True)
class BoardErrors(Value):
    """Errors of the predicted poses of boards by V views, along and across the line of sight, and about it."""

    #: Number of views V that determine a pose
    views: int
    #: Rms distance across the line of sight of the board's middle from where it was predicted [m]
    across: float
    #: The same along the line of sight [m]
    depth: float
    #: Rms angle between the measured and the predicted orientation [rad]
    turn: float
    #: Standard deviation of each of these that the views alone have, by the noise of their corners [m], [m], [rad]
    across_alone: float
    depth_alone: float
    turn_alone: float
    #: Errors of the prediction: what the squares exceed those of the views alone by, at least 0 [m]
    predicted_across: float
    predicted_depth: float
    #: Mean error along the line of sight, measured minus predicted: positive if boards are farther away [m]
    depth_bias: float
    #: Its standard deviation, by the covariances of the views [m]
    depth_bias_std: float

    @property
    def predicted(self) -> float:
        """Error of the predicted position in three dimensions, rms [m]."""
        return float(np.hypot(self.predicted_across, self.predicted_depth))


def board_errors(
    rows: Rows, sightings: Sightings, residual: Array, used: Mask | None = None
) -> BoardErrors | None:
    """Compare the pose of the board in each view, by its corners alone, with the predicted one.

    Args:
        rows: N rows.
        sightings: Predicted poses of their targets, and the internals of their instruments.
        residual: shape (N, D), measured minus predicted, perhaps by fits without these rows.
        used: shape (N,), rows that count, such as those that are no outliers; None: all.

    Returns:
        Their errors; None if no view determines a pose.
    """
    chosen = rows.is_image if used is None else rows.is_image & used
    if not np.any(chosen):
        return None
    J = _by_displacement(rows, sightings)
    labels = np.column_stack([rows.blocks, rows.samples.frame, rows.samples.target])
    _, view = np.unique(labels[chosen], axis=0, return_inverse=True)
    numbers = np.flatnonzero(chosen)
    points = rows.points(sightings.T_frame_target)
    found: list[tuple[Array, Array, Array]] = []
    for k in range(int(view.max()) + 1):
        of_view = numbers[view.reshape(-1) == k]
        if len(of_view) < _FEWEST:
            continue
        A, r = J[of_view, :2].reshape(-1, 6), residual[of_view, :2].reshape(-1)
        centre = points[of_view].mean(axis=0)
        # Turns about the board's middle; the derivative is by motions of its origin.
        A = A.copy()
        arm = centre - sightings.T_frame_target[of_view[0], :3, 3]
        A[:, 3:] += np.cross(A[:, :3], arm)
        size = np.linalg.norm(A, axis=0)
        if not np.all(size > 0.0) or np.linalg.cond((A / size).T @ (A / size)) > _WORST:
            continue
        N = np.linalg.inv(A.T @ A)
        d = N @ A.T @ r
        left = r - A @ d
        found.append((d, N * float(left @ left) / (len(r) - 6), centre))
    return _summary(found) if found else None


def _by_displacement(rows: Rows, sightings: Sightings) -> Array:
    """Return the derivative of the N predictions by motions of the board's origin and its turns, (N, D, 6)."""
    motions = np.broadcast_to(np.eye(6), (len(rows), 6, 6))
    internals = sightings.internals
    fixed = None if internals is None else InternalValues.fixed(internals.values)
    return rows.derivative(replace(sightings, twists=motions, internals=fixed))


def _summary(found: list[tuple[Array, Array, Array]]) -> BoardErrors:
    """Summarise displacement and turn (6,), its covariance (6, 6), and the board's middle (3,) [m] of each view."""
    d, C, centre = (np.array(values) for values in zip(*found, strict=True))
    sight = centre / np.linalg.norm(centre, axis=1, keepdims=True)
    depth = np.sum(d[:, :3] * sight, axis=1)
    depth_variance = np.einsum("vi,vij,vj->v", sight, C[:, :3, :3], sight)
    across = np.sum(d[:, :3] ** 2, axis=1) - depth**2
    across_variance = np.trace(C[:, :3, :3], axis1=1, axis2=2) - depth_variance
    turn = np.sum(d[:, 3:] ** 2, axis=1)
    turn_variance = np.trace(C[:, 3:, 3:], axis1=1, axis2=2)

    tiny = np.finfo(float).tiny
    weights = 1.0 / np.maximum(depth_variance, tiny)
    return BoardErrors(
        views=len(d),
        across=_root(np.mean(across)),
        depth=_root(np.mean(depth**2)),
        turn=_root(np.mean(turn)),
        across_alone=_root(np.mean(across_variance)),
        depth_alone=_root(np.mean(depth_variance)),
        turn_alone=_root(np.mean(turn_variance)),
        predicted_across=_excess(across, across_variance),
        predicted_depth=_excess(depth**2, depth_variance),
        depth_bias=float(np.sum(weights * depth) / np.sum(weights)),
        depth_bias_std=_root(1.0 / np.sum(weights)),
    )


def _root(square: float) -> float:
    """Return the root of a number, 0 for one that rounding has made negative."""
    return float(np.sqrt(max(float(square), 0.0)))


def _excess(squares: Array, variances: Array) -> float:
    """Estimate what squares (V,) exceed their variances by, the surer ones weighted more; its root, at least 0 [m]."""
    # The variance of a square of variance v is 2 v^2.
    weights = 1.0 / np.maximum(variances, np.finfo(float).tiny) ** 2
    return _root(np.sum(weights * (squares - variances)) / np.sum(weights))
