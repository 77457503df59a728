"""Patterns in the residuals of a fit, each with its cause: rounded or lagging joints, a moved target, a drift.

The tests are those of `calib.diagnosis.patterns`; here are the regressors. A drift or a step is reported with the share
by which it lowers the error of held-out blocks of consecutive rows: what predicts nothing explains nothing. A drift of
positions in one frame is reported with its vector, from the first row to the last, so that it can be taken out of them.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from calib.basics.arrays import Array, Integers
from calib.diagnosis.augmented_fit import (
    FEWEST_FREEDOM,
    PREDICTS,
    estimate_jointly,
    gain_on_blocks,
)
from calib.diagnosis.computed import ROUNDING_NOISE, SOME_VALUES, largest_step
from calib.diagnosis.patterns import Stack, drift, functions_of_joint, lag, step
from calib.diagnosis.reasons import Reason, Why
from calib.diagnosis.residuals import Residuals
from calib.fit.estimate.fitting import Fitted

#: Grids of joint values that are looked for [deg], [0.1 rad], [0.1 m].
_STEPS = np.array([10.0, 5.0, 1.0, 0.5, 0.1, 0.05, 0.01])

#: Values are multiples of a step if they are so within this share of it.
_ON_GRID = 0.01

#: Rounding matters if it explains more than this share of the variance of the residuals.
_LEAST_ROUNDED = 0.5

#: Commanded values that the arm reached exactly are round too; their grid would explain more than this share.
_MOST_ROUNDED = 3.0


def residual_patterns(fitted: Fitted, numbers: Integers, moves: Array) -> Iterator[Reason]:
    """Find the patterns that the residuals of a fit have.

    Args:
        fitted: The fit of the best model, so that no better model explains the patterns.
        numbers: Numbers of its N rows in the table, in the order of their measurement, shape (N,).
        moves: Each joint's value minus that in the table's row before, shape (N, m), [rad] or [m].

    Yields:
        A reason for each pattern; none if the residuals are rounding or have few degrees of freedom.
    """
    problem = fitted.estimate.problem
    noise = np.median(problem.scales[problem.rows.used])
    if fitted.estimate.freedom < FEWEST_FREEDOM or noise < ROUNDING_NOISE:
        return
    residuals = Residuals.of(fitted, numbers, moves)
    yield from _rounded_joints(residuals)
    yield from lagging_joints(residuals)

    stack = residuals.stack
    for target in range(len(fitted.setup.targets)):
        moved = _moved_target(residuals, stack, target)
        if moved is not None:
            reason, Z = moved
            yield reason
            stack = stack.beyond(Z)

    patterns = residuals.joint_patterns(stack)
    for joint, explained, _ in patterns[:1]:
        yield Reason.of(
            Why.JOINT_PATTERN,
            quantity="position" if residuals.slides(joint) else "angle",
            joint=residuals.name_of(joint),
            **explained.values,
        )

    drifting = drift(stack.beyond(*(Z for _, _, Z in patterns)), residuals.order)
    if drifting is not None:
        # A drift of each of D scalars, from 0 in the first row to 1 in the last one.
        columns = residuals.order[:, None, None] * np.eye(problem.rows.width)
        columns = columns * problem.rows.used[:, :, None]
        falls = gain_on_blocks(fitted, columns, residuals.weights)
        values: dict[str, Any] = {**drifting.values, "falls": falls}
        # Positions in one frame drift by three lengths, which can be taken out of them.
        rows = problem.rows
        if len(fitted.setup.groups) == 1 and np.all(rows.where(lambda kind: kind.position)):
            by = estimate_jointly(fitted, columns[:, :, :3]).b
            values |= {"drift_xyz": by.tolist(), "drift_m": float(np.linalg.norm(by))}
        yield Reason.of(Why.DRIFT, **values)


def _rounded_joints(residuals: Residuals) -> Iterator[Reason]:
    """Yield a reason if rounding of joint values explains much of the residuals' variance.

    It has the joint that explains most, its step [rad] or [m], and the share that all joints explain, at most 1. None
    is yielded if rounding would explain far more than there is.
    """
    joints = residuals.joints
    grids, effects = [], []
    for joint in joints:
        q, steps = residuals.q[:, joint], _STEPS / 10.0
        if not residuals.slides(joint):
            steps = np.concatenate([np.radians(_STEPS), steps])
        varies = len(np.unique(q)) >= SOME_VALUES
        grids.append(largest_step(q, steps, _ON_GRID) if varies else 0.0)
        effects.append(np.mean(residuals.along(joint) ** 2))
    # A value rounded to a step has the variance step^2 / 12.
    rounding = np.array(grids) ** 2 / 12.0 * effects
    share = float(np.sum(rounding))
    if _LEAST_ROUNDED < share < _MOST_ROUNDED:
        worst = int(np.argmax(rounding))
        joint = joints[worst]
        grid = {"by_m" if residuals.slides(joint) else "by_rad": float(grids[worst])}
        name = residuals.name_of(joint)
        yield Reason.of(Why.JOINTS_COARSE, joint=name, share=min(share, 1.0), **grid)


def lagging_joints(residuals: Residuals) -> Iterator[Reason]:
    """Say if joints were measured before they had arrived: they miss a share of their last move.

    Args:
        residuals: Of a fit to N rows, with the joints' moves.

    Yields:
        At most one reason, with the joint of the largest share, and the rms share of all; none if moves do not predict
        held-out blocks of rows.
    """
    joints, moves = residuals.joints, residuals.moves
    if not joints:
        return
    # Moves are correlated with the values moved to: what depends on those is not a lag.
    of_values, of_moves = [], []
    for joint in joints:
        along = residuals.along(joint)
        functions = functions_of_joint(residuals.values[:, joint], slides=residuals.slides(joint))
        of_values.append(residuals.stack.times(functions, along))
        of_moves.append(residuals.stack.times(moves[:, [joint]], along))
    lagging = lag(residuals.stack.beyond(*of_values), np.hstack(of_moves))
    if lagging is None:
        return

    shares, explained = lagging
    zeros = [residuals.zero(joint) for joint in joints]
    columns = residuals.columns[:, :, zeros] * moves[:, None, joints]
    falls = gain_on_blocks(residuals.fitted, columns, residuals.weights)
    if falls >= PREDICTS:
        worst = joints[int(np.argmax(np.abs(shares)))]
        yield Reason.of(
            Why.JOINTS_LAG,
            joint=residuals.name_of(worst),
            of_move=float(np.sqrt(np.mean(shares**2))),
            falls=falls,
            **explained.values,
        )


def _moved_target(residuals: Residuals, stack: Stack, target: int) -> tuple[Reason, Array] | None:
    """Find the row from which on a target, by its number from 0, is displaced in the tip.

    The stack, of M scalars, has regressors of the steps of other targets. Returned are the reason, with the row's
    number in the table, and the regressors of the step, shape (M, 6 or 3); None if there is no step beyond chance, or a
    drift explains as much.
    """
    # Rows may be in the order of a joint's values: what depends on these is not a step, nor is what a drift explains
    # better.
    patterns = residuals.joint_patterns(stack)
    beyond = stack.beyond(*(Z for _, _, Z in patterns))
    fitted, places = residuals.fitted, residuals.of_target(target)
    of_target = fitted.estimate.problem.rows.samples.target == target
    in_stack = np.isin(np.arange(len(of_target)), stack.row_of)
    jump = step(beyond, np.flatnonzero(of_target & in_stack), residuals.whitened[:, places])
    if jump is None:
        return None
    drifting = drift(beyond, residuals.order)
    if drifting is not None and jump.test.share <= drifting.share:
        return None

    later = np.arange(len(residuals.weights)) >= jump.row
    columns = later[:, None, None] * residuals.columns[:, :, places]
    reason = Reason.of(
        Why.TARGET_STEP,
        target=fitted.setup.targets[target],
        row=int(residuals.numbers[jump.row]),
        moved_m=jump.size,
        falls=gain_on_blocks(fitted, columns, residuals.weights),
        **jump.test.values,
    )
    return reason, jump.Z
