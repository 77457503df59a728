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
from calib.fit.selection.cross_validation import linear_cross_validation
from calib.result.table_fits import TableFits
from calib.robot.robot import Robot

#: Names of the rows whose errors count: predicted by fits without them, of the set ``validate``, or fitted.
HELD_OUT = "held-out"
VALIDATION = "validation"
ESTIMATION = "estimation"

#: A zero that is not determined moves nothing if it is smaller than this [rad or m]; the priors make it 0.
_NOTHING = 1e-8

#: A smaller entry of the matrix from joint offsets to offsets of readings is rounding.
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
            The root of mean_square + s c + c H c, in the unit of the errors: [m], [rad] or [px].
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
    #: Shape (m,), what the reading of each joint lacks: the joint is at reading + delta [rad] or [m]; 0 if it is not
    #: determined
    delta: Array
    #: Shape (m,), its standard deviation; NaN if it is not determined
    std: Array
    #: Shape (m,), False if the rows do not determine a joint's zero, or if it was frozen
    determined: Mask
    #: The rows of ``errors``: `HELD_OUT`, outliers aside; without cross-validation `VALIDATION`, or `ESTIMATION` if
    #: the table has no validation rows
    rows: str
    #: Errors of these rows with these zeros, in each unit that was measured
    errors: Mapping[str, SquaredErrors]

    def __post_init__(self) -> None:
        """Keep a read-only copy of the mapping."""
        keep_read_only(self, "errors")


def joint_zeros(fits: TableFits, validation: Mask, *, cross_validated: bool) -> JointZeros | None:
    """Fit the joint zeros to the estimation rows of a table as the robot's only errors, with frames and targets.

    Weights of the rows are those of the fit of the geometry: what zeros cannot explain is not an outlier.

    Args:
        fits: The fits of the table.
        validation: True for the validation rows, shape (N,).
        cross_validated: Whether the errors are to be those of held-out rows, outliers aside, by cross-validation of
            the linearised problem; else those of the validation rows, or of the fitted ones if there are none.

    Returns:
        The zeros with their errors; None if they cannot be fitted, as if rows are too few and priors are off.
    """
    try:
        fitted, identifiable = _fit_zeros(fits.geometry)
    except CalibError:
        return None
    estimate, model, robot = fitted.estimate, fitted.kinematics.model, fitted.task.robot

    # From the p parameters to offsets of the n joints, and of the m readings.
    offsets = np.zeros((len(robot.joint_names), len(model)))
    for limb in robot.limbs:
        numbers = {f"{joint.name}.zero": i for i, joint in enumerate(limb.joints)}
        of_joints = np.zeros((len(limb.joints), len(model)))
        for term, shares in zip(model.terms, model.mixing, strict=True):
            if term.name in numbers:
                of_joints[numbers[term.name]] = shares
        # What several limbs pass together has the same offset in each.
        of_limb = reading_offsets(limb) @ of_joints
        is_open = ~np.any(offsets, axis=1)
        offsets[is_open] = of_limb[is_open]
    has_share = np.abs(offsets) > _NO_SHARE
    needs_unknown = np.any(has_share & ~identifiable, axis=1)
    determined: Mask = np.any(has_share, axis=1) & ~needs_unknown
    determined.setflags(write=False)
    variance = np.diag(offsets @ estimate.covariance @ offsets.T)

    if cross_validated:
        name, rows = HELD_OUT, estimate.problem.rows
        outliers = fits.geometry.estimate.outliers
        residual = linear_cross_validation(fitted, outliers).residual
        chosen = ~outliers
    else:
        name, rows, chosen = ESTIMATION, fits.all_rows, ~validation
        if np.any(validation):
            name, chosen = VALIDATION, validation
            fitted = fitted.with_held_out(fits.unseen, rows.select(validation))
        residual = fitted.residual(rows)

    return JointZeros(
        joints=robot.joint_names,
        delta=read_only(np.where(determined, offsets @ estimate.x, 0.0)),
        std=read_only(np.where(determined, np.sqrt(variance.clip(0.0)), np.nan)),
        determined=determined,
        rows=name,
        errors=_squared_errors(fitted, rows, residual, chosen),
    )


def _fit_zeros(geometry: Fitted) -> tuple[Fitted, Mask]:
    """Fit the zeros to the rows of the geometry, with its weights; and mark parameters that the rows determine, (p,).

    Priors make zeros that are not determined 0. If they do not, as when only a sum of zeros is determined, or without
    priors, one after the other is frozen at 0. A solver without priors is replaced by ``"lm"``. Raises CalibError if
    the zeros cannot be fitted.
    """
    task = replace(geometry.task, model="zeros", allow_absent=True)
    if not task.has_weights_and_priors:
        task = replace(task, solver="lm")
    while True:
        rows = geometry.estimate.problem.rows
        fitted = fit(task, rows, reference=geometry, near=geometry.near)
        x, model = fitted.estimate.x, fitted.kinematics.model
        identifiable = fitted.estimate.problem.observability(x).identifiable
        undetermined = model.of_robot & ~identifiable
        moved = np.flatnonzero(undetermined & (np.abs(x) > _NOTHING))
        if not len(moved):
            return fitted, identifiable
        cell = replace(task.cell, frozen=(*task.cell.frozen, model.names[moved[0]]))
        task = replace(task, cell=cell)


def reading_offsets(robot: Robot) -> Array:
    """Return the matrix from offsets of the chain's joints to the offsets of the readings that move them so.

        q_chain = A C q + b,    q -> q + (A C)^+ d    moves the joints by d

    A says which joints mimic others (`Robot.mimic_matrix`), C which readings are coupled (`Robot.reading_matrix`).

    Args:
        robot: The robot, of n joints in its chain that follow m readings.

    Returns:
        The pseudo-inverse of A C, shape (m, n), [rad or m of the reading per rad or m of the joint]; the identity if
        no joint mimics another or is held, and no readings are coupled.
    """
    return np.asarray(np.linalg.pinv(robot.mimic_matrix @ robot.reading_matrix))


def _squared_errors(
    fitted: Fitted, rows: Rows, residual: Array, chosen: Mask
) -> dict[str, SquaredErrors]:
    """Return the errors of chosen rows by unit, as functions of a further change of the zeros of a fit.

    ``residual``, shape (N, D), is measured minus predicted without that change; ``chosen``, shape (N,), marks the rows.
    A unit that none of them measures is missing.
    """

    def residual_at(q: Array) -> Array:
        """Return measured minus predicted with other readings, shape (N, m), [rad] or [m]."""
        samples, x = replace(rows.samples, q=q), fitted.estimate.x
        return rows.residual(fitted.kinematics.sightings(x, samples))

    columns = []
    for step in _STEP * np.eye(rows.joints.shape[1]):
        ahead, behind = residual_at(rows.joints + step), residual_at(rows.joints - step)
        columns.append((behind - ahead) / (2.0 * _STEP))  # residuals are measured - predicted
    derivative = np.stack(columns, axis=-1)

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
