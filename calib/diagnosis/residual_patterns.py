"""Patterns in the residuals of a fit, each with its cause: rounded or lagging joints, a moved target, a drift.

The tests are those of `calib.diagnosis.patterns`; here are the regressors. A drift or a step is reported with the share
by which it lowers the error of held-out blocks of consecutive rows: what predicts nothing explains nothing.
"""

from __future__ import annotations

from collections.abc import Iterator
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

#: With fewer degrees of freedom no pattern is looked for.
FEWEST_FREEDOM = 10.0

#: A direction was fitted where an error of the expected size moves the scalars by so many standard deviations.
_FITTED = 1.0

#: Grids of joint values that are looked for [deg], [0.1 rad], [0.1 m].
_STEPS = np.array([10.0, 5.0, 1.0, 0.5, 0.1, 0.05, 0.01])

#: The fewest different values of a joint that can show a grid.
_SOME_VALUES = 4

#: The share of the noise that rounding explains where it matters. Commanded values that the arm reached exactly are
#: round too; they would explain more than there is.
_ROUNDED = (0.5, 3.0)


@dataclass(frozen=True, slots=True, eq=False)
class Order:
    """The order in which the N rows of a fit were measured."""

    numbers: Integers  #: shape (N,), of the rows in the table
    moves: Array  #: shape (N, m), how far the joints moved from the table's row before [rad] or [m]; 0 in the first


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """The residuals of a fit, and their derivatives by displacements of joints and targets."""

    fitted: Fitted
    stack: Stack  #: The M whitened scalars that count
    weights: Array  #: shape (N,), of the rows; 1 where a target's first or last rows were flagged: it may have moved
    displacements: ErrorModel  #: The zeros of the joints, and the places of the targets
    columns: Array  #: shape (N, D, p), what a unit of each does to the predicted scalars [m], [rad]
    whitened: Array  #: shape (M, p), the same of the stack's scalars

    @classmethod
    def of(cls, fitted: Fitted) -> Residuals:
        """Whiten the residual of a fit."""
        estimate, problem = fitted.estimate, fitted.estimate.problem
        displacements, columns = _displacements(fitted)
        weights = np.where(_flagged_from_some_row_on(fitted), 1.0, estimate.weights)
        counts = problem.rows.used & (weights > 0.0)[:, None]
        whiten = np.sqrt(weights)[:, None] / problem.scales
        row_of, component_of = np.nonzero(counts)
        # Directions in which an error of the expected size moves the scalars by less than their noise were not
        # fitted: such a direction may be the residual itself, scaled or rotated.
        J, residual = problem.jacobian(estimate.x), problem.residual(estimate.x)[:, :, None]
        ones = np.eye(counts.shape[1])[None, :, np.unique(component_of)]
        A, r, ones, whitened = (
            problem.independent(values * whiten[:, :, None], weights)[counts]
            for values in (J, residual, ones, columns)
        )
        A = A / np.sqrt(np.maximum(problem.precision, np.finfo(float).tiny))
        basis, effects, _ = np.linalg.svd(A, full_matrices=False)
        fit = basis[:, effects > _FITTED]
        stack = Stack(fit, r[:, 0], row_of, component_of, ones, problem.rows.poses)
        return cls(fitted, stack, weights, displacements, columns, whitened)

    @property
    def joints(self) -> list[int]:
        """The measured joints whose zero is a displacement, by their numbers."""
        names = self.displacements.names
        inputs = self.fitted.task.robot.inputs
        return [i for i, joint in enumerate(inputs) if f"{joint.name}.zero" in names]

    def slides(self, joints: list[int]) -> list[bool]:
        """Whether each of some joints is prismatic."""
        return [self.fitted.task.robot.inputs[i].type == "prismatic" for i in joints]

    def along(self, joint: int) -> Array:
        """What a unit of a joint's zero does to the stack's scalars, shape (M, 1)."""
        name = f"{self.fitted.task.robot.inputs[joint].name}.zero"
        return self.whitened[:, [self.displacements.index(name)]]

    def of_target(self, target: int) -> Mask:
        """The displacements that are a target's, shape (p,)."""
        place = self.fitted.setup.places[1][target]
        return np.array([one.place == place for one in self.displacements.parameters])

    def joint_patterns(self, stack: Stack) -> list[tuple[int, Explained, Array]]:
        """The joints, by their numbers, whose value the residual follows; surest first."""
        q, joints = self.fitted.estimate.problem.rows.joints, self.joints
        directions = [self.along(i) for i in joints]
        patterns = joint_patterns(stack, q[:, joints], self.slides(joints), directions)
        return [(joints[k], explained, Z) for k, explained, Z in patterns]


def _displacements(fitted: Fitted) -> tuple[ErrorModel, Array]:
    """The zeros of joints and places of targets, p in all, and their columns, (N, D, p), at the solution."""
    rows, names, placed = fitted.estimate.problem.rows, fitted.setup.target_names, fitted.placed()
    frames = dict.fromkeys(fitted.setup.frame_unknowns, ())
    model = error_model(fitted.task.robot, "zeros", frame=frames, target=names, targets=names)
    nominal = Kinematics(fitted.task.robot, model, placed.T_frame_base, placed.T_tip_target)
    return model, rows.derivative(*nominal.twists(np.zeros(len(model)), rows.samples))


def residual_patterns(fitted: Fitted, order: Order) -> Iterator[Reason]:
    """Say which patterns the residuals of a fit have; none if they are rounding or have few degrees of freedom.

    Args:
        fitted: The fit of the best model, so that no better model explains the patterns.
        order: The order in which its rows were measured.
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
    """Say if joint values on a grid explain the noise."""
    joints, inputs = residuals.joints, residuals.fitted.task.robot.inputs
    q, slides = residuals.fitted.estimate.problem.rows.joints, residuals.slides(joints)
    grids = np.array([_grid(q[:, i], s) for i, s in zip(joints, slides, strict=True)])
    rounding = grids**2 / 12.0 * [np.mean(residuals.along(i) ** 2) for i in joints]
    share = float(np.sum(rounding))
    if _ROUNDED[0] < share < _ROUNDED[1]:
        worst = int(np.argmax(rounding))
        by = "by_m" if slides[worst] else "by_rad"
        values = {"joint": inputs[joints[worst]].name, "share": min(share, 1.0)}
        yield Reason.of(Why.JOINTS_COARSE, **values, **{by: float(grids[worst])})


def _lagging_joints(residuals: Residuals, order: Order) -> Iterator[Reason]:
    """Say if joints were measured before they had arrived: they miss a share of their last move.

    Moves are correlated with the values moved to: what depends on those is no lag.
    """
    joints, stack = residuals.joints, residuals.stack
    q, slides = residuals.fitted.estimate.problem.rows.joints, residuals.slides(joints)
    of_values = (
        stack.times(functions_of_joint(q[:, i], slides=s), residuals.along(i))
        for i, s in zip(joints, slides, strict=True)
    )
    rest = stack.beyond(*of_values)
    moves = [rest.times(order.moves[:, [i]], residuals.along(i)) for i in joints]
    lagging = lag(rest, np.hstack(moves)) if moves else None
    if lagging is not None:
        shares, explained = lagging
        worst = int(np.argmax(np.abs(shares)))
        fitted = residuals.fitted
        name = fitted.task.robot.inputs[joints[worst]].name
        zeros = [f"{fitted.task.robot.inputs[i].name}.zero" for i in joints]
        columns = residuals.columns[:, :, [residuals.displacements.index(z) for z in zeros]]
        columns = columns * order.moves[:, None, joints]
        falls = gain_on_blocks(fitted, columns, residuals.weights)
        if falls >= PREDICTS:
            values = {"joint": name, "of_move": float(np.sqrt(np.mean(shares**2))), "falls": falls}
            yield Reason.of(Why.JOINTS_LAG, **values, **explained.values)


def _moved_target(
    residuals: Residuals, stack: Stack, target: int, order: Order
) -> tuple[Reason, Array] | None:
    """Find from which row on a target sits elsewhere, and its regressors; None if it does not move.

    Rows may be in the order of a joint's values: what depends on these is no step, nor is what a drift explains better.
    """
    fitted, moved = residuals.fitted, residuals.of_target(target)
    patterns = residuals.joint_patterns(stack)
    rest = stack.beyond(*(Z for *_, Z in patterns))
    rows = fitted.estimate.problem.rows
    seen = (rows.samples.target == target) & np.isin(np.arange(len(rows)), stack.row_of)
    jump = step(rest, np.flatnonzero(seen), residuals.whitened[:, moved])
    drifting = _drift_beside(residuals, stack, patterns)
    if jump is None or (drifting is not None and jump.test.share <= drifting.share):
        return None
    later = (np.arange(len(rows)) >= jump.row)[:, None, None]
    falls = gain_on_blocks(fitted, later * residuals.columns[:, :, moved], residuals.weights)
    name, number = fitted.setup.targets[target], int(order.numbers[jump.row])
    values = {"target": name, "row": number, "moved_m": jump.size, "falls": falls}
    return Reason.of(Why.TARGET_STEP, **values, **jump.test.values), jump.Z


def _drift_beside(
    residuals: Residuals, stack: Stack, patterns: list[tuple[int, Explained, Array]]
) -> Explained | None:
    """The drift in the order of the rows, beyond what depends on a joint's value."""
    rest = stack.beyond(*(Z for *_, Z in patterns))
    return drift(rest, np.linspace(0.0, 1.0, len(residuals.weights)))


def _drift_columns(fitted: Fitted) -> Array:
    """What a drift of each scalar, from none in the first row to a unit in the last one, does, shape (N, D, D)."""
    rows = fitted.estimate.problem.rows
    order = np.linspace(0.0, 1.0, len(rows))
    return np.asarray(order[:, None, None] * np.eye(rows.width) * rows.used[:, :, None])


def _flagged_from_some_row_on(fitted: Fitted) -> Mask:
    """The flagged rows of targets of which the first or last rows, and hardly any others, are flagged: no accidents."""
    flagged, target = fitted.estimate.outliers, fitted.estimate.problem.rows.samples.target
    result = np.zeros_like(flagged)
    for t in np.unique(target):
        in_order = np.flatnonzero(target == t)
        for rows in (in_order, in_order[::-1]):
            before, k = np.cumsum(flagged[rows]), np.arange(1, len(rows) + 1)
            behind, rest = before[-1] - before, len(rows) - k
            block = (behind >= SOME_FLAGGED) & (behind > 0.5 * rest) & (before < 0.1 * k)
            result[rows] |= flagged[rows] & np.any(block)
    return result


def _grid(q: Array, slides: bool) -> float:
    """The largest step of which values (N,) of a joint are multiples, to 1 % [rad, m]; 0 where there is none."""
    steps = [*np.radians(_STEPS), *_STEPS / 10.0] if not slides else _STEPS / 10.0
    fits = [one for one in steps if np.all(np.abs(q / one - np.round(q / one)) < 0.01)]
    return max(fits, default=0.0) if len(np.unique(q)) >= _SOME_VALUES else 0.0
