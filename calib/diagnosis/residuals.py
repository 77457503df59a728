"""Residuals of a fit, whitened, with their derivatives by displacements: where patterns are looked for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.basics.arrays import Array, Integers, Mask
from calib.diagnosis.augmented_fit import nominal_under
from calib.diagnosis.patterns import Explained, Stack, joint_patterns
from calib.diagnosis.stations import SOME_FLAGGED
from calib.fit.estimate.fitting import Fitted
from calib.model.error_model import ErrorModel

#: A direction was fitted if an error of the expected size moves the scalars by so many standard deviations.
_FITTED = 1.0

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

    def whiten(self, columns: Array) -> Array:
        """Whiten derivatives of the predicted scalars, (N, D, k), in the units of the rows' channels, shape (M, k)."""
        return _whiten(self.fitted, columns, self.weights)

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
