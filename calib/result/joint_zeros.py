"""The best joint zeros alone: the rows fitted with zeros as the robot's only errors, for controllers that take no more.

A joint with the zero offset x is at q + x, q its reading. The zeros of the whole calibration are not these: they are
the best beside its other parameters, and without those they may be worse than none.

A controller rounds zeros. With the change c of all zeros by rounding, e the residuals without it, measured minus
predicted, and J the derivative of the predictions by the readings, both of n rows,

    mean |e - J c|^2 = mean |e|^2 + s c + c H c,    s = -2 mean J^T e,    H = mean J^T J
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from calib.basics.arrays import Array, Mask, read_only
from calib.basics.values import Value, keep_read_only
from calib.errors import CalibError
from calib.fit.estimate.fitting import Fitted, fit
from calib.fit.registration.rows import Rows
from calib.fit.selection.linear_folds import linear_cross_validation
from calib.result.fits import TableFits
from calib.robot.robot import Robot

#: Names of the rows whose errors count: predicted by fits without them, of the set ``validate``, or fitted.
HELD_OUT = "held-out"
VALIDATION = "validation"
ESTIMATION = "estimation"

#: A zero that is not determined moves nothing if it is smaller than this [rad or m]; the priors make it 0.
_NOTHING = 1e-8

#: An entry of the matrix from joint offsets to offsets of readings that is smaller is none.
_NO_SHARE = 1e-9

#: Change of a reading for differences [rad or m]: errors of the third order in it are below 1e-9 of a prediction.
_STEP = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class SquaredErrors:
    """Mean squared error of rows in one unit, as a function of a further change of the zeros."""

    #: Number n of rows with a scalar of the unit
    n: int
    #: Mean over the rows of the squared norm of the residual [unit^2]
    mean_square: float
    #: Shape (m,), s: derivative of it by the zeros [unit^2 per rad or m]
    slope: Array
    #: Shape (m, m), H: half its second derivative [unit^2 per rad^2, rad m or m^2]
    curvature: Array

    def rms(self, change: Array | None = None) -> float:
        """Return the rms error after a further change of the zeros.

        Args:
            change: What is added to the m zeros, shape (m,), [rad] or [m]; None: nothing.

        Returns:
            The root of mean_square + s c + c H c, in the unit.
        """
        mean_square = self.mean_square
        if change is not None:
            mean_square += float(self.slope @ change + change @ self.curvature @ change)
        return float(np.sqrt(max(mean_square, 0.0)))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class JointZeros(Value):
    """Joint zeros, fitted as the robot's only errors, with the frames and targets that the calibration estimates."""

    #: Names of the m measured joints, as in `Robot.joint_names`
    joints: tuple[str, ...]
    #: Shape (m,), what the reading of each joint lacks: the joint is at reading + delta [rad] or [m]; 0 where it is not
    #: determined
    delta: Array
    #: Shape (m,), its standard deviation; NaN where it is not determined
    std: Array
    #: Shape (m,), False where the rows do not determine a joint's zero, or where it was frozen
    determined: Mask
    #: The rows of ``errors``: `HELD_OUT`, outliers aside; without cross-validation `VALIDATION`, or `ESTIMATION` where
    #: the table has no validation rows
    rows: str
    #: Errors of these rows with these zeros, in each unit that was measured
    errors: Mapping[str, SquaredErrors]

    def __post_init__(self) -> None:
        """Keep a read-only copy of the mapping."""
        keep_read_only(self, "errors")


def joint_zeros(fits: TableFits, validation: Mask, *, cross_validated: bool) -> JointZeros | None:
    """Fit the joint zeros alone to the estimation rows of a table.

    Weights of the rows are those of the fit of the geometry: what zeros cannot explain is no outlier.

    Args:
        fits: The fits of the table: that of the geometry, and its N rows as arrays.
        validation: True for the validation rows, shape (N,).
        cross_validated: Whether the errors are to be those of held-out rows, by cross-validation of the linearised
            problem.

    Returns:
        The zeros with their errors; None where they cannot be fitted, as where rows are too few and priors are off.
    """
    try:
        fitted, identifiable = _fit_zeros(fits.geometry)
    except CalibError:
        return None
    estimate = fitted.estimate
    offsets = _reading_offsets(fitted)
    determined = _determined(offsets, identifiable)
    variance = np.diag(offsets @ estimate.covariance @ offsets.T)
    rows, errors = _errors(fits, fitted, validation, cross_validated=cross_validated)
    return JointZeros(
        joints=fitted.task.robot.joint_names,
        delta=read_only(np.where(determined, offsets @ estimate.x, 0.0)),
        std=read_only(np.where(determined, np.sqrt(variance.clip(0.0)), np.nan)),
        determined=determined,
        rows=rows,
        errors=errors,
    )


# The fit


def _fit_zeros(geometry: Fitted) -> tuple[Fitted, Mask]:
    """Fit the zeros, those that are not determined held at their nominal values.

    Args:
        geometry: The fit of the geometry, whose rows, weights and registered frames and targets are taken over.

    Returns:
        The fit of the model ``"zeros"``, and True for its parameters that the rows determine, not in combinations only,
        shape (p,). Priors make zeros that are not determined 0. Where they do not, as where only a sum of zeros is
        determined, or without priors, one after the other is frozen at 0.

    Raises:
        CalibError: There is nothing to estimate, or too little to estimate it from.
    """
    task = replace(geometry.task, model="zeros", allow_absent=True)
    if not task.has_weights_and_priors:
        task = replace(task, solver="lm")
    while True:
        fitted = fit(task, geometry.estimate.problem.rows, reference=geometry)
        x = fitted.estimate.x
        identifiable = fitted.estimate.problem.observability(x).identifiable
        undetermined = _of_robot(fitted) & ~identifiable
        moved = np.flatnonzero(undetermined & (np.abs(x) > _NOTHING))
        if not len(moved):
            return fitted, identifiable
        name = fitted.kinematics.model.names[moved[0]]
        cell = replace(task.cell, frozen=(*task.cell.frozen, name))
        task = replace(task, cell=cell)


def _of_robot(fitted: Fitted) -> Mask:
    """Return True for the zeros among the p parameters, False for frames and targets, shape (p,)."""
    return np.asarray(fitted.kinematics.model.of_robot)


# From parameters to readings


def reading_offsets(robot: Robot) -> Array:
    """Return the matrix from offsets of the chain's joints to the offsets of the readings that move them so.

        q_chain = A C q + b,    q -> q + (A C)^+ d    moves the joints by d

    A says which joints mimic others (`Robot.mimic_matrix`), C which readings are coupled (`Robot.reading_matrix`).

    Args:
        robot: The robot, of n joints in its chain that follow m readings.

    Returns:
        The pseudo-inverse of A C, shape (m, n), [rad or m of the reading per rad or m of the joint]; the identity where
        no joint mimics another or is held, and no readings are coupled.
    """
    return np.asarray(np.linalg.pinv(robot.mimic_matrix @ robot.reading_matrix))


def _reading_offsets(fitted: Fitted) -> Array:
    """Return the matrix from the p parameters of a fit of the zeros to the offsets of the m readings, shape (m, p)."""
    model, robot = fitted.kinematics.model, fitted.task.robot
    numbers = {f"{joint.name}.zero": i for i, joint in enumerate(robot.joints)}
    of_joints = np.zeros((len(robot.joints), len(model)))
    for term, shares in zip(model.terms, model.mixing, strict=True):
        if term.name in numbers:
            of_joints[numbers[term.name]] = shares
    return np.asarray(reading_offsets(robot) @ of_joints)


def _determined(offsets: Array, identifiable: Mask) -> Mask:
    """Return True for the readings whose offset is estimated, of parameters that the rows determine, shape (m,).

    Args:
        offsets: From the p parameters to offsets of the readings, shape (m, p).
        identifiable: True for the parameters that the rows determine, shape (p,).
    """
    has_share = np.abs(offsets) > _NO_SHARE
    needs_unknown = np.any(has_share & ~identifiable, axis=1)
    determined: Mask = np.any(has_share, axis=1) & ~needs_unknown
    determined.setflags(write=False)
    return determined


# Errors


def _errors(
    fits: TableFits, fitted: Fitted, validation: Mask, *, cross_validated: bool
) -> tuple[str, dict[str, SquaredErrors]]:
    """Return the errors with the zeros, and of which rows they are.

    Args:
        fits: The fits of the table, with its N rows as arrays.
        fitted: The fit of the zeros.
        validation: True for the validation rows, shape (N,).
        cross_validated: Whether they are to be those of held-out rows.

    Returns:
        `HELD_OUT`, `VALIDATION` or `ESTIMATION`; and the errors by unit.
    """
    if cross_validated:
        outliers = fits.geometry.estimate.outliers
        rows = fitted.estimate.problem.rows
        residual = linear_cross_validation(fitted, outliers).residual
        return HELD_OUT, _squared_errors(fitted, rows, residual, rows.checked & ~outliers)
    name, chosen = ESTIMATION, ~validation
    if np.any(validation):
        name, chosen = VALIDATION, validation
        fitted = fitted.with_held_out(fits.unseen, fits.all_rows.select(validation))
    rows = fits.all_rows
    return name, _squared_errors(fitted, rows, fitted.residual(rows), chosen)


def _squared_errors(
    fitted: Fitted, rows: Rows, residual: Array, chosen: Mask
) -> dict[str, SquaredErrors]:
    """Return the errors of rows by unit, as functions of a further change of the zeros.

    Args:
        fitted: The fit of the zeros.
        rows: N rows of measurements.
        residual: Measured minus predicted at these rows, shape (N, D), in the units of their channels.
        chosen: True for the rows that count, shape (N,).
    """
    derivative = _derivative_by_readings(fitted, rows)
    errors = {}
    for unit in rows.channels.present:
        of_unit = rows.channels.where(unit) & chosen[:, None]
        count = int(np.sum(np.any(of_unit, axis=1)))
        if count:
            e, J = residual[of_unit], derivative[of_unit]
            errors[unit] = SquaredErrors(
                n=count,
                mean_square=float(e @ e) / count,
                slope=read_only(-2.0 * (e @ J) / count),
                curvature=read_only(J.T @ J / count),
            )
    return errors


def _derivative_by_readings(fitted: Fitted, rows: Rows) -> Array:
    """Return the derivative of the predictions by the readings, by differences.

    Args:
        fitted: A fit.
        rows: N rows, at whose m readings it is taken.

    Returns:
        Shape (N, D, m), in the units of the rows' channels per rad or m.
    """
    columns = []
    for step in _STEP * np.eye(rows.joints.shape[1]):
        ahead = _residual_at(fitted, rows, rows.joints + step)
        behind = _residual_at(fitted, rows, rows.joints - step)
        columns.append((behind - ahead) / (2.0 * _STEP))  # residuals are measured - predicted
    return np.stack(columns, axis=-1)


def _residual_at(fitted: Fitted, rows: Rows, q: Array) -> Array:
    """Return measured minus predicted with other readings, shape (N, m), [rad] or [m]."""
    samples = replace(rows.samples, q=q)
    T_frame_target = fitted.kinematics.poses(fitted.estimate.x, samples)
    return rows.residual(T_frame_target, fitted.kinematics.optics(fitted.estimate.x, samples))
