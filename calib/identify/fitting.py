"""One fit: register, estimate, and what the fit says of rows that it did not see.

This is what cross-validation repeats and what `calibrate` reports on.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from calib.errors import MeasurementError, ModelError, SolverError, choices
from calib.identify.estimate import Estimate, Solve, estimate, plain_estimate
from calib.identify.problem import Problem
from calib.identify.registration import register
from calib.identify.robust import scores
from calib.identify.solvers import (
    Solution,
    levenberg_marquardt,
    paper_levenberg_marquardt,
    scipy_least_squares,
)
from calib.identify.statistics import CrossValidation, Mask, cross_validate, folds, same_poses
from calib.measure.cell import Cell, Priors
from calib.measure.measurements import Measurements
from calib.model.error_model import ErrorModel, error_model
from calib.model.kinematics import Kinematics
from calib.model.observability import steps
from calib.model.robot import Robot, read_only

Array = NDArray[np.float64]

#: Called with the number of fits done and of fits in all.
Progress = Callable[[int, int], None]

#: A model that leaves this share of the noise explains what the other one lacks.
_FAR_LESS = 0.6

#: A row that is this many median distances off does not take part in a nominal robot's registration.
_GROSS = 5.0
_GROSS_ROUNDS = 5

#: The solvers' names.
SOLVERS = ("lm", "paper", "scipy")


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """The rows of one fit as arrays.

    Attributes:
        joints: shape (N, n), in the robot's order, [rad] or [m].
        points: shape (N, 3), measured target in the measurement frame [m].
        sigma: shape (N,), standard deviation of one coordinate, as given or the first guess [m].
    """

    joints: Array
    points: Array
    sigma: Array

    def select(self, mask: Mask) -> Rows:
        """Some of the rows."""
        return Rows(self.joints[mask], self.points[mask], self.sigma[mask])

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.points)


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """One fit: the registered start and the estimate from there."""

    cell: Cell
    kinematics: Kinematics
    estimate: Estimate

    def frames(self) -> tuple[Array, Array]:
        """T_frame_base and the target at the solution, shapes (4, 4) and (3,)."""
        displacement, _ = self.kinematics.model.displacements(self.estimate.x)
        target = self.kinematics.T_tip_target @ displacement[-1]
        return self.kinematics.T_frame_base @ displacement[0], target[:3, 3]


def fit(robot: Robot, cell: Cell, rows: Rows, *, solver: str, robust: bool) -> Fitted:
    """Register and estimate.

    Args:
        robot: The nominal robot.
        cell: What is known.
        rows: The rows to fit.
        solver: One of `SOLVERS`.
        robust: Whether outliers lose their weight.

    Raises:
        ModelError: Unknown solver, parameter set or parameter.
        MeasurementError: Too few rows.
        SolverError: No finite result.
    """
    if solver not in SOLVERS:
        message = f"There is no solver '{solver}'. Choose one of {choices(SOLVERS)}."
        raise ModelError(message)
    # The paper's algorithm starts where it was told to, if it was told.
    as_given = solver == "paper" and cell.target is not None
    started = register(
        robot,
        replace(cell, estimate_target=cell.estimate_target and not as_given),
        rows.joints,
        rows.points,
    )
    model = error_model(robot, cell.model, frame=cell.estimate_frame, target=cell.estimate_target)
    model = model.without(robot_parameters(cell.frozen))
    _check_enough(model, cell.priors, len(rows))
    assert started.T_frame_base is not None  # registration leaves neither out
    assert started.target is not None
    T_tip_target = np.eye(4)
    T_tip_target[:3, 3] = started.target
    kinematics = Kinematics(robot, model, started.T_frame_base, T_tip_target)
    ones, nothing = np.ones(len(rows)), np.zeros(len(model))
    problem = Problem(kinematics, rows.joints, rows.points, rows.sigma, ones, nothing)
    if solver == "paper":
        estimated = plain_estimate(problem, _solve_as_the_paper(problem, started))
    else:
        size = steps([p.unit for p in model.parameters])
        estimated = estimate(problem, _solver(solver, size), priors=cell.priors, robust=robust)
    if not np.all(np.isfinite(estimated.x)):
        message = "The solver ended at values that are not finite. Check the measurements, or keep the priors on."
        raise SolverError(message)
    return Fitted(started, kinematics, estimated)


def _solver(name: str, size: Array) -> Solve:
    """A solver by its name, with each parameter's step."""

    def solve(problem: Problem, x: Array, tolerance: float) -> Solution:
        if name == "scipy":
            return scipy_least_squares(problem.system, x, step_size=size)
        return levenberg_marquardt(problem.system, x, step_size=size, step_tolerance=tolerance)

    return solve


def _solve_as_the_paper(problem: Problem, cell: Cell) -> Solution:
    """The paper's algorithm in its own units, mm and rad, at absolute parameters; x in m and rad comes back."""
    parameters = problem.kinematics.model.parameters
    unit = np.array([1e3 if p.unit == "m" else 1.0 for p in parameters])
    assert cell.target is not None
    at_target = dict(zip(("target_x", "target_y", "target_z"), cell.target, strict=True))
    nominal = np.array([at_target.get(p.name, p.nominal) for p in parameters])
    solution = paper_levenberg_marquardt(
        partial(problem.paper_system, nominal, unit), nominal * unit
    )
    return replace(solution, x=solution.x / unit - nominal)


def robot_parameters(frozen: tuple[str, ...]) -> tuple[str, ...]:
    """The frozen names, refused where they are of target or frame, which registration places as a whole.

    Raises:
        ModelError: A coordinate of target or frame is among them.
    """
    placed = [name for name in frozen if name.startswith(("target_", "frame_"))]
    if placed:
        message = (
            f"{choices(placed)} cannot be frozen one by one: target and frame are known or estimated as a whole. Use "
            "--fix-target or --frame known, or target and frame in the cell file."
        )
        raise ModelError(message)
    return frozen


def _check_enough(model: ErrorModel, priors: Priors, rows: int) -> None:
    """Refuse fewer numbers than parameters where no prior holds the rest."""
    count = len(model)
    if priors.sizes == "off" and 3 * rows < count:
        message = (
            f"{rows} rows give {3 * rows} numbers for {count} parameters, and priors are off. Measure more "
            "poses, choose a smaller --model, or leave the priors on."
        )
        raise MeasurementError(message)
    if count == 0:
        message = f"The model '{model.name}' leaves nothing to estimate: every parameter is frozen or known."
        raise ModelError(message)


def check_one_setup(measurements: Measurements) -> None:
    """Refuse tables with several targets or set-ups, which would be taken for one.

    Raises:
        ModelError: The columns ``target`` or ``group`` have more than one value.
    """
    for what, names in (("targets", measurements.targets), ("groups", measurements.groups)):
        different = sorted(set(names))
        if len(different) > 1:
            message = (
                f"{measurements.source}: the table has {len(different)} {what}: {choices(different)}. One target and "
                f"one set-up are fitted at a time: split the table by its column '{what[:-1]}'."
            )
            raise ModelError(message)


def larger_model(robot: Robot, cell: Cell, rows: Rows, fitted: Fitted) -> str:
    """What the full placements would leave over, a sentence, if it is far less than this fit leaves; else nothing.

    Args:
        robot: The nominal robot.
        cell: What is known.
        rows: The rows of the fit.
        fitted: The fit.
    """
    if cell.model == "placement" or 3 * len(rows) < 2 * (6 * len(robot.joints) + 3):
        return ""
    full = replace(cell, model="placement", frozen=())
    other = fit(robot, full, rows, solver="lm", robust=True).estimate
    noise, less = fitted.estimate.noise_factor, other.noise_factor
    if less > _FAR_LESS * noise:
        return ""
    unit = 1e3 * float(np.median(rows.sigma))
    return (
        f"The model '{cell.model}' leaves {unit * noise:.3f} mm a coordinate, all placements would leave "
        f"{unit * less:.3f} mm: the robot has errors that this model lacks. Try --model placement."
    )


def nominal_cell(robot: Robot, cell: Cell, rows: Rows) -> Cell:
    """Frame and target as given; those that were not given as the nominal robot registers them."""
    asked = replace(
        cell,
        estimate_target=cell.target is None,
        estimate_frame=cell.estimate_frame and cell.T_frame_base is None,
    )
    return register_without_gross(robot, asked, rows)


def register_without_gross(robot: Robot, cell: Cell, rows: Rows) -> Cell:
    """The cell registered to a nominal robot, without the rows that lie far from the others.

    One gross row would move target and frame, and with them the errors of the nominal robot on every other row.

    Args:
        robot: The nominal robot.
        cell: What is known.
        rows: The rows.
    """
    kept = np.ones(len(rows), dtype=bool)
    registered = register(robot, cell, rows.joints, rows.points)
    for _ in range(_GROSS_ROUNDS):
        distance = np.linalg.norm(rows.points - predict(robot, registered, rows.joints), axis=1)
        near = distance <= _GROSS * np.median(distance)
        if np.array_equal(near, kept) or np.sum(near) < 0.6 * len(rows):
            break
        kept = near
        registered = register(robot, cell, rows.joints[kept], rows.points[kept])
    return registered


def predict(robot: Robot, cell: Cell, joints: Array) -> Array:
    """Where a robot puts the target, in the measurement frame, shape (N, 3), [m]."""
    assert cell.T_frame_base is not None
    assert cell.target is not None
    poses = cell.T_frame_base @ robot.poses(joints)
    result: Array = poses[:, :3, :3] @ cell.target + poses[:, :3, 3]
    return result


def unseen_scores(fitted: Fitted, rows: Rows) -> Array:
    """The scores of rows that the fit did not use, shape (N,); see `calib.identify.robust`."""
    if len(rows) == 0:
        return read_only(np.zeros(0))
    predicted, jacobian = fitted.kinematics.points_jacobian(fitted.estimate.x, rows.joints)
    scale = fitted.estimate.noise_factor * rows.sigma
    return read_only(
        scores(
            (rows.points - predicted) / scale[:, None],
            jacobian / scale[:, None, None],
            fitted.estimate.covariance,
            np.zeros(len(rows)),
        )
    )


def cross_validation(
    robot: Robot,
    cell: Cell,
    rows: Rows,
    flagged: Mask,
    fit_rows: Callable[[Rows], Fitted],
    progress: Progress | None = None,
) -> tuple[CrossValidation, CrossValidation]:
    """Cross-validation of the nominal robot and of the calibrated one, under the same treatment.

    The nominal robot gets frame and target registered to the rows that are not left out, gross ones aside, so that the
    two differ by the calibration alone.

    Args:
        robot: The nominal robot.
        cell: What is known.
        rows: All rows.
        flagged: shape (N,), outliers of the fit to all rows.
        fit_rows: Fits some rows from the beginning.
        progress: Called after each fit.

    Raises:
        MeasurementError: Too few rows to leave any out.
    """
    poses = same_poses(rows.joints)
    masks = folds(poses)[1]
    if len(masks) < 2:
        message = (
            f"{len(rows)} row{'s' * (len(rows) > 1)} of one pose cannot be cross-validated: none is left to fit. "
            "Measure more poses, or ask for a fit without validation (--no-validate)."
        )
        raise MeasurementError(message)
    done = 0

    def left_out(mask: Mask) -> Array:
        nonlocal done
        try:
            fold = fit_rows(rows.select(~mask))
        except MeasurementError as error:
            message = (
                f"Cross-validation leaves out {mask.sum()} of {len(rows)} rows at a time, and the others are too few: "
                f"{error} Or do without validation (--no-validate)."
            )
            raise MeasurementError(message) from error
        done += 1
        if progress is not None:
            progress(done, len(masks))
        result: Array = rows.points[mask] - fold.kinematics.points(
            fold.estimate.x, rows.joints[mask]
        )
        return result

    def left_out_nominal(mask: Mask) -> Array:
        registered = register_without_gross(robot, cell, rows.select(~mask))
        return rows.points[mask] - predict(robot, registered, rows.joints[mask])

    calibrated = cross_validate(poses, flagged, left_out)
    return cross_validate(poses, flagged, left_out_nominal), calibrated
