"""Patterns in the residuals of a fit, each with its cause: rounded or lagging joints, a moved target, a drift.

The tests are those of `calib.diagnosis.patterns`; here are the regressors. A drift or a step is reported with the share
by which it lowers the error of held-out blocks of consecutive rows: what predicts nothing explains nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from calib.basics.arrays import Array, Integers, Mask
from calib.diagnosis.further_unknowns import PREDICTS, gain_on_blocks
from calib.diagnosis.patterns import (
    Explained,
    Stack,
    Step,
    drift,
    functions_of_joint,
    joint_patterns,
    lag,
    step,
)
from calib.diagnosis.reasons import Reason, Why
from calib.diagnosis.stations import SOME_FLAGGED
from calib.fit.estimate.fitting import Fitted
from calib.model.error_model import error_model
from calib.model.kinematics import Kinematics
from calib.model.parameters import ErrorModel

#: Noise below this is rounding, in which any test finds patterns [m, rad].
ROUNDING_NOISE = 1e-6

#: Degrees of freedom of a fit below which no pattern is looked for.
FEWEST_FREEDOM = 10.0

#: A direction was fitted where an error of the expected size moves the scalars by so many standard deviations.
_FITTED = 1.0

#: Grids of joint values that are looked for [deg], [0.1 rad], [0.1 m].
_STEPS = np.array([10.0, 5.0, 1.0, 0.5, 0.1, 0.05, 0.01])

#: Values are multiples of a step if they are so to this share of it.
_ON_GRID = 0.01

#: The fewest different values of a joint that can show a grid.
_SOME_VALUES = 4

#: Rounding matters where it explains more than this share of the variance of the residuals.
_LEAST_ROUNDED = 0.5

#: Commanded values that the arm reached exactly are round too; their grid would explain more than this share.
_MOST_ROUNDED = 3.0

#: A target has moved if more than this share of its rows from some row on is flagged.
_FLAGGED_BEHIND = 0.5

#: And less than this share of its rows before.
_FLAGGED_BEFORE = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Order:
    """The order in which the N rows of a fit were measured."""

    #: Shape (N,), of the rows in the table
    numbers: Integers
    #: Shape (N, m), each joint's value minus that in the table's row before [rad] or [m]; 0 in the first row
    moves: Array


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """Residuals of a fit to N rows, whitened, and their derivatives by p displacements of joints and targets."""

    #: The fit
    fitted: Fitted
    #: The M whitened scalars that count
    stack: Stack
    #: Shape (N,), of the rows; 1 where a target's first or last rows were flagged: it may have moved
    weights: Array
    #: The zeros of the joints, and the places of the targets
    displacements: ErrorModel
    #: Shape (N, D, p), derivative of the predicted scalars [m], [rad] by each displacement
    columns: Array
    #: Shape (M, p), the same of the stack's scalars, whitened
    whitened: Array

    @classmethod
    def of(cls, fitted: Fitted) -> Residuals:
        """Whiten the residuals of a fit.

        Args:
            fitted: The fit to N rows.
        """
        displacements, columns = _displacements(fitted)
        may_have_moved = _flagged_from_some_row_on(fitted)
        weights = np.where(may_have_moved, 1.0, fitted.estimate.weights)
        return cls(
            fitted=fitted,
            stack=_stack_of(fitted, weights),
            weights=weights,
            displacements=displacements,
            columns=columns,
            whitened=_whiten(fitted, columns, weights),
        )

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

    def slides(self, joints: Sequence[int]) -> list[bool]:
        """Tell for each of some measured joints, by their numbers from 0, whether it is prismatic."""
        inputs = self.fitted.task.robot.inputs
        return [inputs[joint].type == "prismatic" for joint in joints]

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
        """Find the joints whose value the residual follows.

        Args:
            stack: The M whitened scalars, perhaps with further regressors.

        Returns:
            Number from 0, test and regressors (M, k) of each joint, the surest first.
        """
        joints = self.joints
        directions = [self.along(joint) for joint in joints]
        patterns = joint_patterns(stack, self.values[:, joints], self.slides(joints), directions)
        return [(joints[k], explained, Z) for k, explained, Z in patterns]


def _stack_of(fitted: Fitted, weights: Array) -> Stack:
    """Stack the scalars of a fit's rows with a weight, whitened.

    Args:
        fitted: A fit to N rows.
        weights: Weights of the rows, shape (N,).
    """
    problem, x = fitted.estimate.problem, fitted.estimate.x
    counts = problem.rows.used & (weights > 0.0)[:, None]
    row_of, component_of = np.nonzero(counts)
    ones = np.eye(counts.shape[1])[None, :, np.unique(component_of)]
    A = _whiten(fitted, problem.jacobian(x), weights)
    r = _whiten(fitted, problem.residual(x)[:, :, None], weights)
    return Stack(
        A=_fitted_directions(fitted, A),
        r=r[:, 0],
        row_of=row_of,
        component_of=component_of,
        ones=_whiten(fitted, ones, weights),
        poses=problem.rows.poses,
    )


def _whiten(fitted: Fitted, values: Array, weights: Array) -> Array:
    """Whiten columns of scalars: over the noise, and times the root of the weight.

    Scalars of a stop (several targets measured at one pose) that share an error are made independent.

    Args:
        fitted: A fit to N rows of D scalars.
        values: The columns, shape (N, D, k), or (1, D, k) where all rows have the same, [m] and [rad].
        weights: Weights of the rows, shape (N,).

    Returns:
        The columns of the M scalars that were measured at rows with a weight, shape (M, k).
    """
    problem = fitted.estimate.problem
    counts = problem.rows.used & (weights > 0.0)[:, None]
    of_each_row = np.broadcast_to(values, (len(weights), *values.shape[1:]))
    factors = np.sqrt(weights)[:, None] / problem.noise_by_scalar
    whitened = problem.rows.standardise(of_each_row) * factors[:, :, None]
    return problem.independent(whitened, weights)[counts]


def _fitted_directions(fitted: Fitted, A: Array) -> Array:
    """Find an orthonormal basis of the directions of the scalars that were fitted.

    Directions in which an error of the expected size moves the scalars by less than their noise were not fitted: such
    a direction may be the residual itself, scaled or rotated.

    Args:
        fitted: A fit of p parameters.
        A: Whitened derivative of M scalars by the parameters, shape (M, p).

    Returns:
        The basis, shape (M, rank).
    """
    precision = np.maximum(fitted.estimate.problem.prior_precision, np.finfo(float).tiny)
    basis, effects, _ = np.linalg.svd(A / np.sqrt(precision), full_matrices=False)
    return np.asarray(basis[:, effects > _FITTED])


def _displacements(fitted: Fitted) -> tuple[ErrorModel, Array]:
    """Displace the zeros of the joints and the places of the targets of a fit.

    Returns:
        The model of the p displacements, and the derivative of the predicted scalars [m], [rad] by each, shape
        (N, D, p), for the nominal robot with frames and targets at the solution.
    """
    robot, rows = fitted.task.robot, fitted.estimate.problem.rows
    names, placed = fitted.setup.target_names, fitted.estimated_setup()
    frames = dict.fromkeys(fitted.setup.frame_unknowns, ())
    model = error_model(robot, "zeros", frame=frames, target=names, targets=names)
    nominal = Kinematics(robot, model, placed.T_frame_base, placed.T_tip_target)
    T_frame_target, twists = nominal.twists(np.zeros(len(model)), rows.samples)
    return model, rows.derivative(T_frame_target, twists)


def residual_patterns(fitted: Fitted, order: Order) -> Iterator[Reason]:
    """Find the patterns that the residuals of a fit have.

    Args:
        fitted: The fit of the best model, so that no better model explains the patterns.
        order: The order in which its rows were measured.

    Yields:
        A reason for each pattern; none if the residuals are rounding or have few degrees of freedom.
    """
    problem = fitted.estimate.problem
    noise = np.median(problem.scales[problem.rows.used])
    if fitted.estimate.freedom < FEWEST_FREEDOM or noise < ROUNDING_NOISE:
        return
    residuals = Residuals.of(fitted)
    yield from _rounded_joints(residuals)
    yield from _lagging_joints(residuals, order)
    stack = residuals.stack
    for target in range(len(fitted.setup.targets)):
        moved = _moved_target(residuals, stack, target, order)
        if moved is not None:
            reason, Z = moved
            yield reason
            stack = stack.beyond(Z)
    patterns = residuals.joint_patterns(stack)
    for joint, explained, _ in patterns[:1]:
        yield _joint_pattern(residuals, joint, explained)
    yield from _drifting(residuals, _beyond(stack, patterns))


def _joint_pattern(residuals: Residuals, joint: int, explained: Explained) -> Reason:
    """Make the reason that the residuals depend on the value of a joint.

    Args:
        residuals: The residuals.
        joint: Number of the measured joint, from 0.
        explained: The test of it.
    """
    (slides,) = residuals.slides([joint])
    return Reason.of(
        Why.JOINT_PATTERN,
        quantity="position" if slides else "angle",
        joint=residuals.name_of(joint),
        **explained.values,
    )


def _drifting(residuals: Residuals, stack: Stack) -> Iterator[Reason]:
    """Find whether the residuals drift in the order of the rows.

    Args:
        residuals: The residuals.
        stack: Their whitened scalars, with regressors of the patterns that are no drift.
    """
    drifting = _drift_of_rows(stack)
    if drifting is not None:
        fitted = residuals.fitted
        falls = gain_on_blocks(fitted, _drift_columns(fitted), residuals.weights)
        yield Reason.of(Why.DRIFT, **drifting.values, falls=falls)


def _rounded_joints(residuals: Residuals) -> Iterator[Reason]:
    """Find whether joint values on a grid explain the noise.

    Yields:
        A reason that names the joint that explains most, with the step of its grid [rad] or [m]; none where rounding
        explains less than half of the noise.
    """
    joints = residuals.joints
    slides = residuals.slides(joints)
    grids, effects = [], []
    for joint, prismatic in zip(joints, slides, strict=True):
        grids.append(_grid(residuals.q[:, joint], slides=prismatic))
        effects.append(np.mean(residuals.along(joint) ** 2))
    # A value rounded to a step has the variance step^2 / 12.
    rounding = np.array(grids) ** 2 / 12.0 * effects
    share = float(np.sum(rounding))
    if _LEAST_ROUNDED < share < _MOST_ROUNDED:
        worst = int(np.argmax(rounding))
        name = residuals.name_of(joints[worst])
        step_name = "by_m" if slides[worst] else "by_rad"
        grid = {step_name: float(grids[worst])}
        yield Reason.of(Why.JOINTS_COARSE, joint=name, share=min(share, 1.0), **grid)


def _lagging_joints(residuals: Residuals, order: Order) -> Iterator[Reason]:
    """Find whether joints were measured before they had arrived: they miss a share of their last move.

    Args:
        residuals: The residuals.
        order: The order of the rows, with the moves of the joints.

    Yields:
        A reason that names the joint with the largest share, and states the rms share of all; none where moves do not
        predict held-out blocks of rows.
    """
    joints = residuals.joints
    if not joints:
        return
    stack = _beyond_joint_values(residuals)
    moves = [stack.times(order.moves[:, [joint]], residuals.along(joint)) for joint in joints]
    lagging = lag(stack, np.hstack(moves))
    if lagging is None:
        return
    shares, explained = lagging
    falls = _gain_of_moves(residuals, order)
    if falls >= PREDICTS:
        worst = joints[int(np.argmax(np.abs(shares)))]
        yield Reason.of(
            Why.JOINTS_LAG,
            joint=residuals.name_of(worst),
            of_move=float(np.sqrt(np.mean(shares**2))),
            falls=falls,
            **explained.values,
        )


def _beyond_joint_values(residuals: Residuals) -> Stack:
    """Add the regressors of errors that depend on the joints' values to the stack of residuals.

    Moves are correlated with the values moved to: what depends on those is no lag.
    """
    joints, stack = residuals.joints, residuals.stack
    of_values = []
    for joint, slides in zip(joints, residuals.slides(joints), strict=True):
        functions = functions_of_joint(residuals.values[:, joint], slides=slides)
        of_values.append(stack.times(functions, residuals.along(joint)))
    return stack.beyond(*of_values)


def _gain_of_moves(residuals: Residuals, order: Order) -> float:
    """Share by which the error of held-out blocks falls if each joint misses a share of its moves."""
    joints = residuals.joints
    zeros = [residuals.zero(joint) for joint in joints]
    columns = residuals.columns[:, :, zeros] * order.moves[:, None, joints]
    return gain_on_blocks(residuals.fitted, columns, residuals.weights)


def _moved_target(
    residuals: Residuals,
    stack: Stack,
    target: int,
    order: Order,
) -> tuple[Reason, Array] | None:
    """Find the row from which on a target is displaced in the tip.

    Args:
        residuals: The residuals.
        stack: Their M whitened scalars, with regressors of the steps of other targets.
        target: Number of the target, from 0.
        order: The order of the rows.

    Returns:
        The reason, and the regressors of the step, shape (M, 6 or 3); None if the target did not move.
    """
    jump = _step_of_target(residuals, stack, target)
    if jump is None:
        return None
    fitted = residuals.fitted
    later = np.arange(len(residuals.weights)) >= jump.row
    columns = later[:, None, None] * residuals.columns[:, :, residuals.of_target(target)]
    reason = Reason.of(
        Why.TARGET_STEP,
        target=fitted.setup.targets[target],
        row=int(order.numbers[jump.row]),
        moved_m=jump.size,
        falls=gain_on_blocks(fitted, columns, residuals.weights),
        **jump.test.values,
    )
    return reason, jump.Z


def _step_of_target(residuals: Residuals, stack: Stack, target: int) -> Step | None:
    """Find the step in the residuals of a target's rows, or None where there is none.

    Rows may be in the order of a joint's values: what depends on these is no step, nor is what a drift explains better.

    Args:
        residuals: The residuals.
        stack: Their whitened scalars, with regressors of the steps of other targets.
        target: Number of the target, from 0.
    """
    beyond = _beyond(stack, residuals.joint_patterns(stack))
    of_target = residuals.fitted.estimate.problem.rows.samples.target == target
    in_stack = np.isin(np.arange(len(of_target)), stack.row_of)
    rows = np.flatnonzero(of_target & in_stack)
    jump = step(beyond, rows, residuals.whitened[:, residuals.of_target(target)])
    if jump is None:
        return None
    drifting = _drift_of_rows(beyond)
    if drifting is not None and jump.test.share <= drifting.share:
        return None
    return jump


def _beyond(stack: Stack, patterns: Sequence[tuple[int, Explained, Array]]) -> Stack:
    """Add the regressors of patterns of joints, see `Residuals.joint_patterns`, to a stack of residuals."""
    return stack.beyond(*(Z for *_, Z in patterns))


def _drift_of_rows(stack: Stack) -> Explained | None:
    """Test for a drift, even in the order of the rows; None where it may be chance.

    Args:
        stack: The whitened scalars, with regressors of what is no drift.
    """
    return drift(stack, np.linspace(0.0, 1.0, len(stack.poses)))


def _drift_columns(fitted: Fitted) -> Array:
    """Columns (N, D, D) of a drift of each of D scalars, from 0 in the first of N rows to 1 in the last one."""
    rows = fitted.estimate.problem.rows
    order = np.linspace(0.0, 1.0, len(rows))
    drifts = order[:, None, None] * np.eye(rows.width)
    return np.asarray(drifts * rows.used[:, :, None])


def _flagged_from_some_row_on(fitted: Fitted) -> Mask:
    """Find the flagged rows of targets of which the last (or first) rows are flagged and hardly any others.

    These are no accidents: the target may have moved.

    Args:
        fitted: A fit to N rows.

    Returns:
        True for these rows, shape (N,).
    """
    flagged = fitted.estimate.outliers
    target = fitted.estimate.problem.rows.samples.target
    result = np.zeros_like(flagged)
    for t in np.unique(target):
        in_order = np.flatnonzero(target == t)
        for rows in (in_order, in_order[::-1]):
            count = np.arange(1, len(rows) + 1)
            before = np.cumsum(flagged[rows])
            behind = before[-1] - before
            most_behind = behind > _FLAGGED_BEHIND * (len(rows) - count)
            many_behind = (behind >= SOME_FLAGGED) & most_behind
            few_before = before < _FLAGGED_BEFORE * count
            result[rows] |= flagged[rows] & np.any(many_behind & few_before)
    return result


def _grid(q: Array, *, slides: bool) -> float:
    """Find the largest step of which a joint's values are multiples.

    Args:
        q: Its values at the rows, shape (N,) [rad] or [m].
        slides: Whether it is prismatic.

    Returns:
        The step [rad] or [m]; 0 where there is none.
    """
    if len(np.unique(q)) < _SOME_VALUES:
        return 0.0
    steps = _STEPS / 10.0
    if not slides:
        steps = np.concatenate([np.radians(_STEPS), steps])
    largest = 0.0
    for size in steps:
        multiples = q / size
        off_grid = np.abs(multiples - np.round(multiples))
        if np.all(off_grid < _ON_GRID):
            largest = max(largest, float(size))
    return largest
