"""Scatter of the fitted rows about a model's prediction: what an arrival of the robot adds to the error of a pose.

Of each scalar of a unit the rows show the variance

    s^2 = max(noise^2, mean(e^2 - K (1 - K)^-1 noise^2))

with the noise that the fit estimated, the held-out residuals e, and the leverage K of the rows of a pose: what a fit
without the pose adds to its residual. It is that of the instrument, of the arm's arrivals, and of what the model lacks.
The instrument's part is not an error of the robot. It is what the table, the cell or a certificate states, at the
distances of the rows.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from calib.basics.arrays import Array, Mask, read_only
from calib.basics.values import Value
from calib.fit.estimate.fitting import Fitted
from calib.fit.registration.rows import Rows
from calib.model.kinematics import Kinematics, Samples
from calib.numerics.errors import CrossValidation
from calib.numerics.repeats import scatter_of_repeats
from calib.result.board_errors import BoardErrors
from calib.result.parts import Noise

#: Units of the scalars of positions and of orientations, in the order of arrays of two.
UNITS = ("m", "rad")

#: Largest leverage that is used: a pose that alone determines a direction says nothing of its scatter.
_HIGHEST_LEVERAGE = 0.9

#: Step of the differences by joint readings [rad or m]: they are then exact to 1e-9.
_STEP = 1e-5

#: Rows over which effects of joints are averaged; of more rows leverages are too small to count.
_MOST_ROWS = 500


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RowScatter(Value):
    """Variances of a scalar of the fitted rows: first of a coordinate [m^2], then of a turn about an axis [rad^2]."""

    #: Shape (2,), about the prediction, without the variance of the prediction itself; NaN if none was measured
    total: Array
    #: Shape (2,), degrees of freedom of ``total``; 0 where it is NaN
    freedom: Array
    #: Shape (2,), the instrument's part, as stated; NaN where nothing states it
    instrument: Array
    #: Shape (2,), within repeats of a pose: of the instrument and of the arm's arrivals; NaN without repeats
    within: Array
    #: Shape (2,), degrees of freedom of ``within``; 0 where it is NaN
    within_freedom: Array
    #: Shape (2, m), mean square change of a coordinate, and of a turn, by a unit of each joint reading at the measured
    #: poses [m^2 or 1 over rad^2 or m^2]
    by_joints: Array

    @classmethod
    def of(
        cls,
        fitted: Fitted,
        validation: CrossValidation | None,
        board: BoardErrors | None,
        noise: Noise,
    ) -> RowScatter:
        """Sum up the rows of a fit.

        Args:
            fitted: The fit to N rows.
            validation: Its cross-validation; None if there was none.
            board: Held-out errors of the poses of boards; None without images.
            noise: The noise of the table: what is stated, and whether poses were repeated.
        """
        total, freedom = np.full(2, np.nan), np.zeros(2)
        instrument, within, within_freedom = np.full(2, np.nan), np.full(2, np.nan), np.zeros(2)
        estimate = fitted.estimate
        rows = estimate.problem.rows
        kept = estimate.weights > 0.0
        count = float(np.sum(rows.used[kept]))
        added = None if validation is None else _added_by_fits(fitted)
        repeats = None
        if noise.repeats is not None:  # by this model, which may know from where the joints came
            residual = fitted.residual(rows)
            repeats = scatter_of_repeats(residual, rows.channels, rows.poses, estimate.weights)
        for k, unit in enumerate(UNITS):
            chosen = rows.channels.where(unit) & kept[:, None]
            if np.any(chosen):
                total[k] = float(np.mean(estimate.problem.scales[chosen] ** 2))
                freedom[k] = estimate.freedom * float(np.sum(chosen)) / count
                if validation is not None and added is not None:
                    good = chosen & ~estimate.outliers[:, None]
                    left = validation.residual[good] ** 2 - added[good]
                    total[k] = max(total[k], float(np.mean(left)))
            instrument[k] = instrument_variance(fitted, unit, noise.sigma_given)
            if repeats is not None and np.isfinite(repeats.within.get(unit, np.nan)):
                within[k] = repeats.within[unit] ** 2
                within_freedom[k] = repeats.freedoms[unit]
        if board is not None and np.isnan(total[0]):
            # Pictures: what held-out views show of the board's pose beyond the noise of their own corners.
            turn = max(board.turn**2 - board.turn_alone**2, 0.0)
            total[:] = board.predicted**2 / 3.0, turn / 3.0
            freedom[:] = 3.0 * board.views
            instrument[:] = 0.0
        return cls(
            total=read_only(total),
            freedom=read_only(freedom),
            instrument=read_only(instrument),
            within=read_only(within),
            within_freedom=read_only(within_freedom),
            by_joints=read_only(_effect_of_joints(fitted.kinematics, estimate.x, rows)),
        )


def joint_twists(kinematics: Kinematics, x: Array, samples: Samples) -> Array:
    """Differentiate predicted poses by the readings of the joints.

    Args:
        kinematics: The nominal robot, with frames and targets; m measured joints.
        x: Shape (p,), the parameters of its model, of which the geometry, frames and targets count.
        samples: N samples.

    Returns:
        Shape (N, 6, m), displacement [m] and turn [rad] of the target along and about the frame's axes by a unit of
        each reading [rad] or [m].
    """
    q = samples.q
    step = _STEP
    poses = kinematics.poses(x, samples)
    result = np.empty((len(q), 6, q.shape[1]))
    for j in range(q.shape[1]):
        ends = []
        for side in (step, -step):
            moved = q.copy()
            moved[:, j] += side
            ends.append(kinematics.poses(x, replace(samples, q=moved)))
        ahead, behind = ends
        result[:, :3, j] = (ahead[:, :3, 3] - behind[:, :3, 3]) / (2.0 * step)
        spin = (ahead[:, :3, :3] - behind[:, :3, :3]) @ poses[:, :3, :3].transpose(0, 2, 1)
        result[:, 3:, j] = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=1) / (
            2.0 * step
        )
    return result


def instrument_variance(fitted: Fitted, unit: str, stated: Mapping[str, float]) -> float:
    """Return the variance of the instrument's own noise of a scalar, at the distances of the rows.

    A limit by certificate counts first, then a standard deviation of table or cell, then the tracker's noise.

    Args:
        fitted: The fit to the rows, whose cell may state limits or a tracker.
        unit: Symbol of the scalar's unit, ``"m"`` or ``"rad"``.
        stated: Standard deviations that table or cell state, by the symbol of the unit.

    Returns:
        In the square of the unit; NaN if nothing states it.
    """
    cell = fitted.task.cell
    limits = cell.uncertainty
    if unit == "rad" and limits.instrument_limit_angle > 0.0:
        return limits.instrument_limit_angle**2 / 3.0
    if unit == "m" and (limits.instrument_limit or limits.instrument_limit_per_length):
        return limits.instrument_std(_distance(fitted)) ** 2
    if unit in stated:
        return stated[unit] ** 2
    if unit == "m" and cell.tracker is not None:
        noise = cell.tracker.noise
        return (noise.constant + noise.per_length * _distance(fitted)) ** 2
    return np.nan


def _distance(fitted: Fitted) -> float:
    """Return the rms distance of the rows' targets from the instrument [m]: from the tracker, or the frame's origin."""
    cell = fitted.task.cell
    rows = fitted.estimate.problem.rows
    T = fitted.kinematics.poses(fitted.estimate.x, rows.samples)
    origin = np.zeros((len(T), 3))
    if cell.tracker is not None:
        T_frame_base = fitted.estimated_setup().T_frame_base[rows.samples.frame]
        origin = T_frame_base[:, :3, 3] + T_frame_base[:, :3, :3] @ cell.tracker.position
    return float(np.sqrt(np.mean(np.sum((T[:, :3, 3] - origin) ** 2, axis=1))))


def _added_by_fits(fitted: Fitted) -> Array:
    """Return what a fit without a pose adds to the variance of its held-out scalars, (N, D), in their units squared."""
    estimate = fitted.estimate
    problem, rows = estimate.problem, estimate.problem.rows
    if len(rows) > _MOST_ROWS:
        return np.zeros(rows.used.shape)
    A, scales = problem.prediction_jacobian(estimate.x), problem.scales
    whitened = np.where(rows.used[:, :, None], A / scales[:, :, None], 0.0)
    result = np.zeros(rows.used.shape)
    for pose in np.unique(rows.blocks).tolist():
        of_pose = np.flatnonzero(rows.blocks == pose)
        used = rows.used[of_pose]
        root = np.sqrt(problem.weights[of_pose])[:, None, None]
        unweighted = whitened[of_pose][used]
        weighted = (whitened[of_pose] * root)[used]
        leverage = weighted @ estimate.covariance @ weighted.T
        values, vectors = np.linalg.eigh(leverage)
        values = np.clip(values, 0.0, _HIGHEST_LEVERAGE)
        inverse = (vectors / (1.0 - values)) @ vectors.T
        # Of a fit without the pose, C + C A^T (1 - A C A^T)^-1 A C.
        across = unweighted @ estimate.covariance @ weighted.T
        square = unweighted @ estimate.covariance @ unweighted.T + across @ inverse @ across.T
        block = result[of_pose]
        block[used] = np.diag(square) * scales[of_pose][used] ** 2
        result[of_pose] = block
    return result


def _effect_of_joints(kinematics: Kinematics, x: Array, rows: Rows) -> Array:
    """Return the mean square change of a coordinate, and of a turn, by each joint reading over the rows, (2, m)."""
    chosen: Mask = rows.evenly(_MOST_ROWS)
    J = joint_twists(kinematics, x, rows.samples.select(chosen))
    return np.stack([np.mean(J[:, :3] ** 2, axis=(0, 1)), np.mean(J[:, 3:] ** 2, axis=(0, 1))])
