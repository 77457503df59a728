"""Patterns in the residuals of a fit, each with its cause: rounded or lagging joints, a moved target, a drift.

The tests are those of `calib.diagnosis.patterns`; here are the regressors. A drift or a step is reported with the share
by which it lowers the error of held-out blocks of consecutive rows: what predicts nothing explains nothing. A drift of
positions in one frame is reported with its vector, from the first row to the last, so that it can be taken out of them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.basics.arrays import Array, Integers, Mask
from calib.diagnosis.augmented_fit import (
    FEWEST_FREEDOM,
    PREDICTS,
    estimate_jointly,
    gain_on_blocks,
    nominal_under,
)
from calib.diagnosis.computed import ROUNDING_NOISE, SOME_VALUES, largest_step
from calib.diagnosis.patterns import (
    Explained,
    Stack,
    drift,
    functions_of_joint,
    joint_patterns,
    lag,
    step,
)
from calib.diagnosis.reasons import Reason, Why
from calib.diagnosis.stations import SOME_FLAGGED
from calib.fit.estimate.fitting import Fitted
from calib.model.error_model import ErrorModel

#: A direction was fitted if an error of the expected size moves the scalars by so many standard deviations.
_FITTED = 1.0

#: Grids of joint values that are looked for [deg], [0.1 rad], [0.1 m].
_STEPS = np.array([10.0, 5.0, 1.0, 0.5, 0.1, 0.05, 0.01])

#: Values are multiples of a step if they are so within this share of it.
_ON_GRID = 0.01

#: Rounding matters if it explains more than this share of the variance of the residuals.
_LEAST_ROUNDED = 0.5

#: Commanded values that the arm reached exactly are round too; their grid would explain more than this share.
_MOST_ROUNDED = 3.0

#: A target has moved if more than this share of its rows from some row on is flagged.
_FLAGGED_AFTER = 0.5

#: A target has moved if, besides, less than this share of its rows before is flagged.
_FLAGGED_BEFORE = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """Residuals of a fit to N rows, whitened, and their derivatives by p displacements of joints and targets."""

    #: The fit
    fitted: Fitted
    #: Shape (N,), numbers of the rows in the table, in the order of their measurement
    numbers: Integers
    #: Shape (N, m), each joint's value minus that in the table's row before [rad] or [m]; 0 in the first row
    moves: Array
    #: The M whitened scalars that count
    stack: Stack
    #: Shape (N,), of the rows; 1 if a target's first or last rows were flagged: it may have moved
    weights: Array
    #: The zeros of the joints, and the places of the targets
    displacements: ErrorModel
    #: Shape (N, D, p), derivative of the predicted scalars by each displacement, in the units of the rows' channels
    columns: Array
    #: Shape (M, p), the same of the stack's scalars, whitened
    whitened: Array

    @classmethod
    def of(cls, fitted: Fitted, numbers: Integers, moves: Array) -> Residuals:
        """Whiten the residuals of a fit to N rows, and their derivatives by joint zeros and places of targets.

        ``numbers``, shape (N,), are the rows' numbers in the table, in the order of measurement; ``moves``, shape (N,
        m), each joint's value minus that in the table's row before [rad] or [m].
        """
        problem, x, rows = fitted.estimate.problem, fitted.estimate.x, fitted.estimate.problem.rows

        model, columns = displacements_of(fitted)

        weights = np.where(_flagged_from_some_row_on(fitted), 1.0, fitted.estimate.weights)
        counts = rows.used & (weights > 0.0)[:, None]
        row_of, component_of = np.nonzero(counts)
        ones = np.eye(counts.shape[1])[None, :, np.unique(component_of)]

        # Directions in which an error of the expected size moves the scalars by less than their noise were not fitted:
        # such a direction may be the residual itself, scaled or rotated.
        A = _whiten(fitted, problem.prediction_jacobian(x), weights)
        precision = np.maximum(problem.prior_precision, np.finfo(float).tiny)
        basis, effects, _ = np.linalg.svd(A / np.sqrt(precision), full_matrices=False)

        return cls(
            fitted=fitted,
            numbers=numbers,
            moves=moves,
            stack=Stack(
                A=np.asarray(basis[:, effects > _FITTED]),
                r=_whiten(fitted, problem.residual(x)[:, :, None], weights)[:, 0],
                row_of=row_of,
                component_of=component_of,
                ones=_whiten(fitted, ones, weights),
                poses=rows.poses,
            ),
            weights=weights,
            displacements=model,
            columns=columns,
            whitened=_whiten(fitted, columns, weights),
        )

    @property
    def order(self) -> Array:
        """Place of each row in the order of measurement, evenly from 0 in the first to 1 in the last, shape (N,)."""
        return np.linspace(0.0, 1.0, len(self.weights))

    @property
    def joints(self) -> list[int]:
        """Numbers, from 0, of the measured joints whose zero is a displacement."""
        names = self.displacements.names
        inputs = self.fitted.task.robot.inputs
        return [i for i, joint in enumerate(inputs) if f"{joint.name}.zero" in names]

    @property
    def q(self) -> Array:
        """Measured joint readings of the rows, shape (N, m) [rad] or [m]."""
        return self.fitted.estimate.problem.rows.joints

    @property
    def values(self) -> Array:
        """Values of the measured joints at these readings, shape (N, m) [rad] or [m]."""
        return self.fitted.task.robot.input_values(self.q)

    def slides(self, joint: int) -> bool:
        """Return whether a measured joint, by its number from 0, is prismatic."""
        return self.fitted.task.robot.inputs[joint].type == "prismatic"

    def name_of(self, joint: int) -> str:
        """Name of a measured joint, by its number from 0."""
        return self.fitted.task.robot.inputs[joint].name

    def zero(self, joint: int) -> int:
        """Number, from 0, of the displacement that is the zero of a measured joint, by the joint's number from 0."""
        return self.displacements.index(f"{self.name_of(joint)}.zero")

    def along(self, joint: int) -> Array:
        """Derivative of the stack's M scalars by the zero of a measured joint, whitened, shape (M, 1)."""
        return self.whitened[:, [self.zero(joint)]]

    def of_target(self, target: int) -> Mask:
        """Mark the displacements of a target, by its number from 0: True for these, shape (p,)."""
        _, target_places = self.fitted.setup.places
        place = target_places[target]
        return np.array([p.place == place for p in self.displacements.parameters])

    def joint_patterns(self, stack: Stack) -> list[tuple[int, Explained, Array]]:
        """Find the measured joints whose value the residual follows, beyond the regressors of a stack of M scalars.

        Returned are number from 0, test and regressors (M, k) of each such joint, the surest first.
        """
        joints = self.joints
        slides = [self.slides(joint) for joint in joints]
        directions = [self.along(joint) for joint in joints]
        patterns = joint_patterns(stack, self.values[:, joints], slides, directions)
        return [(joints[k], explained, Z) for k, explained, Z in patterns]


def displacements_of(fitted: Fitted) -> tuple[ErrorModel, Array]:
    """Differentiate the predicted scalars of a fit by zeros of the joints and places of the targets.

    Args:
        fitted: A fit to N rows of D scalars.

    Returns:
        The model of these p displacements, and the derivatives, shape (N, D, p), in the units of the rows' channels: of
        the nominal robot, with frames and targets at the solution.
    """
    rows, nominal = fitted.estimate.problem.rows, nominal_under("zeros", fitted)
    zero = np.zeros(len(nominal.model))
    return nominal.model, rows.derivative(nominal.linearised(zero, rows.samples))


def _whiten(fitted: Fitted, values: Array, weights: Array) -> Array:
    """Whiten columns of scalars: over the noise, and times the root of the weight.

    Scalars of a stop (several targets measured at one pose) that share an error are made independent. The columns are
    of the shape (N, D, k), or (1, D, k) if all rows have the same, in the units of the rows' channels; returned are
    those of the M scalars that were measured at rows with a weight, (M, k).
    """
    problem = fitted.estimate.problem
    counts = problem.rows.used & (weights > 0.0)[:, None]
    of_each_row = np.broadcast_to(values, (len(weights), *values.shape[1:]))
    factors = np.sqrt(weights)[:, None] / problem.noise_by_scalar
    whitened = problem.rows.standardise(of_each_row) * factors[:, :, None]
    return problem.independent(whitened, weights)[counts]


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
    yield from _lagging_joints(residuals)

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


def _lagging_joints(residuals: Residuals) -> Iterator[Reason]:
    """Say if joints were measured before they had arrived: they miss a share of their last move.

    The reason names the joint with the largest share, and states the rms share of all. There is none if moves do not
    predict held-out blocks of rows.
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


def _flagged_from_some_row_on(fitted: Fitted) -> Mask:
    """Find the flagged rows of targets of which most last (or first) rows are flagged and hardly any others.

    These are not accidents: the target may have moved. The mask of the rows of the fit, shape (N,), is False for all
    rows of other targets.
    """
    flagged = fitted.estimate.outliers
    target = fitted.estimate.problem.rows.samples.target
    result = np.zeros_like(flagged)
    for t in np.unique(target):
        in_order = np.flatnonzero(target == t)
        for rows in (in_order, in_order[::-1]):
            count = np.arange(1, len(rows) + 1)
            before = np.cumsum(flagged[rows])
            after = before[-1] - before
            most_after = after > _FLAGGED_AFTER * (len(rows) - count)
            many_after = (after >= SOME_FLAGGED) & most_after
            few_before = before < _FLAGGED_BEFORE * count
            result[rows] |= flagged[rows] & np.any(many_after & few_before)
    return result
