"""Patterns in the residuals of a fit, each with its cause: rounded or lagging joints, a moved target, a drift.

The tests are those of `calib.diagnosis.patterns`; here are the regressors. A drift or a step is reported with the share
by which it lowers the error of held-out blocks of consecutive rows: what predicts nothing explains nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from calib.diagnosis.further_unknowns import PREDICTS, gain_on_blocks
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
from calib.estimate.fitting import Fitted
from calib.model.error_model import error_model
from calib.model.kinematics import Kinematics
from calib.model.parameters import ErrorModel
from calib.units import Array, Integers, Mask

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
    #: shape (N, m), each joint's value minus that in the table's row before [rad] or [m]; 0 in the first row
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
            fitted: The fit.
        """
        problem = fitted.estimate.problem
        displacements, columns = _displacements(fitted)
        weights = np.where(_flagged_from_some_row_on(fitted), 1.0, fitted.estimate.weights)
        counts = problem.rows.used & (weights > 0.0)[:, None]
        row_of, component_of = np.nonzero(counts)
        x = fitted.estimate.x
        ones = np.eye(counts.shape[1])[None, :, np.unique(component_of)]
        stack = Stack(
            A=_fitted_directions(fitted, _whiten(fitted, problem.jacobian(x), weights)),
            r=_whiten(fitted, problem.residual(x)[:, :, None], weights)[:, 0],
            row_of=row_of,
            component_of=component_of,
            ones=_whiten(fitted, ones, weights),
            poses=problem.rows.poses,
        )
        whitened = _whiten(fitted, columns, weights)
        return cls(fitted, stack, weights, displacements, columns, whitened)

    @property
    def joints(self) -> list[int]:
        """Numbers, from 0, of the measured joints whose zero is a displacement."""
        names = self.displacements.names
        inputs = self.fitted.task.robot.inputs
        return [i for i, joint in enumerate(inputs) if f"{joint.name}.zero" in names]

    @property
    def q(self) -> Array:
        """Measured joint values of the rows, shape (N, m) [rad] or [m]."""
        return self.fitted.estimate.problem.rows.joints

    def slides(self, joints: Sequence[int]) -> list[bool]:
        """Tell for each of some joints, by their numbers, whether it is prismatic."""
        return [self.fitted.task.robot.inputs[i].type == "prismatic" for i in joints]

    def zero(self, joint: int) -> int:
        """Number of the displacement that is a joint's zero."""
        return self.displacements.index(f"{self.fitted.task.robot.inputs[joint].name}.zero")

    def along(self, joint: int) -> Array:
        """Derivative of the stack's scalars by a joint's zero, whitened, shape (M, 1)."""
        return self.whitened[:, [self.zero(joint)]]

    def of_target(self, target: int) -> Mask:
        """Find the displacements that are a target's, by its number, shape (p,)."""
        place = self.fitted.setup.places[1][target]
        return np.array([p.place == place for p in self.displacements.parameters])

    def joint_patterns(self, stack: Stack) -> list[tuple[int, Explained, Array]]:
        """Find the joints whose value the residual follows.

        Args:
            stack: The whitened scalars, perhaps with further regressors.

        Returns:
            Number, test and regressors (M, k) of each joint, the surest first.
        """
        joints = self.joints
        directions = [self.along(i) for i in joints]
        patterns = joint_patterns(stack, self.q[:, joints], self.slides(joints), directions)
        return [(joints[k], explained, Z) for k, explained, Z in patterns]


def _whiten(fitted: Fitted, values: Array, weights: Array) -> Array:
    """Whiten columns of scalars, (N, D, k) or (1, D, k), with the weights of N rows: shape (M, k) of those that count.

    Scalars of a stop that share an error are made independent.
    """
    problem = fitted.estimate.problem
    counts = problem.rows.used & (weights > 0.0)[:, None]
    factors = np.sqrt(weights)[:, None] / problem.scales
    return problem.independent(values * factors[:, :, None], weights)[counts]


def _fitted_directions(fitted: Fitted, A: Array) -> Array:
    """Orthonormal basis of the directions of the scalars that were fitted, from their whitened derivatives (M, p).

    Directions in which an error of the expected size moves the scalars by less than their noise were not fitted: such
    a direction may be the residual itself, scaled or rotated.
    """
    precision = np.maximum(fitted.estimate.problem.precision, np.finfo(float).tiny)
    basis, effects, _ = np.linalg.svd(A / np.sqrt(precision), full_matrices=False)
    return np.asarray(basis[:, effects > _FITTED])


def _displacements(fitted: Fitted) -> tuple[ErrorModel, Array]:
    """Zeros of joints and places of targets, p in all, and their columns, (N, D, p), at the solution."""
    rows, names, placed = fitted.estimate.problem.rows, fitted.setup.target_names, fitted.placed()
    frames = dict.fromkeys(fitted.setup.frame_unknowns, ())
    model = error_model(fitted.task.robot, "zeros", frame=frames, target=names, targets=names)
    nominal = Kinematics(fitted.task.robot, model, placed.T_frame_base, placed.T_tip_target)
    return model, rows.derivative(*nominal.twists(np.zeros(len(model)), rows.samples))


def residual_patterns(fitted: Fitted, order: Order) -> Iterator[Reason]:
    """Find the patterns that the residuals of a fit have.

    Args:
        fitted: The fit of the best model, so that no better model explains the patterns.
        order: The order in which its rows were measured.

    Yields:
        A reason for each pattern; none if the residuals are rounding or have few degrees of freedom.
    """
    rows = fitted.estimate.problem.rows
    noise = np.median(fitted.estimate.problem.scales[rows.used])
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
        quantity = "position" if residuals.slides([joint])[0] else "angle"
        values = {"quantity": quantity, "joint": fitted.task.robot.inputs[joint].name}
        yield Reason.of(Why.JOINT_PATTERN, **values, **explained.values)
    drifting = _drift_beside(residuals, stack, patterns)
    if drifting is not None:
        falls = gain_on_blocks(fitted, _drift_columns(fitted), residuals.weights)
        yield Reason.of(Why.DRIFT, **drifting.values, falls=falls)


def _rounded_joints(residuals: Residuals) -> Iterator[Reason]:
    """Find whether joint values on a grid explain the noise, and name the joint that explains most."""
    joints = residuals.joints
    slides = residuals.slides(joints)
    grids, effects = [], []
    for joint, prismatic in zip(joints, slides, strict=True):
        grids.append(_grid(residuals.q[:, joint], prismatic))
        effects.append(np.mean(residuals.along(joint) ** 2))
    # A value rounded to a step has the variance step^2 / 12.
    rounding = np.array(grids) ** 2 / 12.0 * effects
    share = float(np.sum(rounding))
    if _LEAST_ROUNDED < share < _MOST_ROUNDED:
        worst = int(np.argmax(rounding))
        step_name = "by_m" if slides[worst] else "by_rad"
        name = residuals.fitted.task.robot.inputs[joints[worst]].name
        grid = {step_name: float(grids[worst])}
        yield Reason.of(Why.JOINTS_COARSE, joint=name, share=min(share, 1.0), **grid)


def _lagging_joints(residuals: Residuals, order: Order) -> Iterator[Reason]:
    """Find whether joints were measured before they had arrived: they miss a share of their last move.

    Moves are correlated with the values moved to: what depends on those is no lag.
    """
    joints = residuals.joints
    if not joints:
        return
    stack = residuals.stack
    of_values = []
    for joint, slides in zip(joints, residuals.slides(joints), strict=True):
        functions = functions_of_joint(residuals.q[:, joint], slides=slides)
        of_values.append(stack.times(functions, residuals.along(joint)))
    stack = stack.beyond(*of_values)
    moves = [stack.times(order.moves[:, [joint]], residuals.along(joint)) for joint in joints]
    lagging = lag(stack, np.hstack(moves))
    if lagging is None:
        return
    shares, explained = lagging
    zeros = [residuals.zero(joint) for joint in joints]
    columns = residuals.columns[:, :, zeros] * order.moves[:, None, joints]
    falls = gain_on_blocks(residuals.fitted, columns, residuals.weights)
    if falls >= PREDICTS:
        worst = joints[int(np.argmax(np.abs(shares)))]
        name = residuals.fitted.task.robot.inputs[worst].name
        values = {"joint": name, "of_move": float(np.sqrt(np.mean(shares**2))), "falls": falls}
        yield Reason.of(Why.JOINTS_LAG, **values, **explained.values)


def _moved_target(
    residuals: Residuals, stack: Stack, target: int, order: Order
) -> tuple[Reason, Array] | None:
    """Find the row from which on a target is displaced in the tip.

    Rows may be in the order of a joint's values: what depends on these is no step, nor is what a drift explains better.

    Args:
        residuals: The residuals.
        stack: Their whitened scalars, with regressors of the steps of other targets.
        target: Number of the target, from 0.
        order: The order of the rows.

    Returns:
        The reason, and the regressors of the step, shape (M, 6 or 3); None if the target did not move.
    """
    fitted, columns = residuals.fitted, residuals.of_target(target)
    patterns = residuals.joint_patterns(stack)
    beyond = stack.beyond(*(Z for *_, Z in patterns))
    rows = fitted.estimate.problem.rows
    number = np.arange(len(rows))
    seen = (rows.samples.target == target) & np.isin(number, stack.row_of)
    jump = step(beyond, np.flatnonzero(seen), residuals.whitened[:, columns])
    drifting = _drift_beside(residuals, stack, patterns)
    if jump is None or (drifting is not None and jump.test.share <= drifting.share):
        return None
    later = (number >= jump.row)[:, None, None]
    falls = gain_on_blocks(fitted, later * residuals.columns[:, :, columns], residuals.weights)
    values = {
        "target": fitted.setup.targets[target],
        "row": int(order.numbers[jump.row]),
        "moved_m": jump.size,
        "falls": falls,
    }
    return Reason.of(Why.TARGET_STEP, **values, **jump.test.values), jump.Z


def _drift_beside(
    residuals: Residuals, stack: Stack, patterns: list[tuple[int, Explained, Array]]
) -> Explained | None:
    """Test for a drift in the order of the rows, beyond patterns of joints; None where it may be chance."""
    beyond = stack.beyond(*(Z for *_, Z in patterns))
    return drift(beyond, np.linspace(0.0, 1.0, len(residuals.weights)))


def _drift_columns(fitted: Fitted) -> Array:
    """Columns (N, D, D) of a drift of each scalar, from 0 in the first row to 1 in the last one."""
    rows = fitted.estimate.problem.rows
    order = np.linspace(0.0, 1.0, len(rows))
    return np.asarray(order[:, None, None] * np.eye(rows.width) * rows.used[:, :, None])


def _flagged_from_some_row_on(fitted: Fitted) -> Mask:
    """Flagged rows, (N,), of targets of which the last (or first) rows are flagged and hardly any others.

    These are no accidents: the target may have moved.
    """
    flagged, target = fitted.estimate.outliers, fitted.estimate.problem.rows.samples.target
    result = np.zeros_like(flagged)
    for t in np.unique(target):
        in_order = np.flatnonzero(target == t)
        for rows in (in_order, in_order[::-1]):
            count = np.arange(1, len(rows) + 1)
            before = np.cumsum(flagged[rows])
            behind = before[-1] - before
            many_behind = (behind >= SOME_FLAGGED) & (
                behind > _FLAGGED_BEHIND * (len(rows) - count)
            )
            few_before = before < _FLAGGED_BEFORE * count
            result[rows] |= flagged[rows] & np.any(many_behind & few_before)
    return result


def _grid(q: Array, slides: bool) -> float:
    """Largest step of which a joint's values (N,) are multiples [rad] or [m]; 0 where there is none."""
    if len(np.unique(q)) < _SOME_VALUES:
        return 0.0
    steps = _STEPS / 10.0
    if not slides:
        steps = np.concatenate([np.radians(_STEPS), steps])
    largest = 0.0
    for size in steps:
        multiples = q / size
        if np.all(np.abs(multiples - np.round(multiples)) < _ON_GRID):
            largest = max(largest, float(size))
    return largest
