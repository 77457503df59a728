"""calibrate: a robot and measurements in, a `Calibration` out.

The order of the work: registration of target and measurement frame, estimation, rank and uncertainty, errors on rows
that the fit did not see, the verdict. `Calibration` is the whole result as immutable values.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.errors import ModelError, UrdfError
from calib.identify.estimate import FIRST_SIGMA
from calib.identify.evidence import largest_change, still_joints, validation_errors
from calib.identify.findings import Outlier, ParameterEstimate, parameter_estimates
from calib.identify.fitting import (
    Fitted,
    Progress,
    Rows,
    check_one_setup,
    cross_validation,
    fit,
    larger_model,
    nominal_cell,
    predict,
    unseen_scores,
)
from calib.identify.robust import Limits
from calib.identify.setup_check import better_setup
from calib.identify.solvers import Solution
from calib.identify.statistics import CrossValidation, Errors
from calib.identify.verdict import NO, Evidence, Verdict, verdict
from calib.measure.cell import Cell
from calib.measure.measurements import Measurements
from calib.model.error_model import ErrorModel
from calib.model.kinematics import Kinematics
from calib.model.observability import Observability, analyse
from calib.model.readback import check_written, random_joint_values, spread_poses
from calib.model.robot import Robot, read_only, rigid_inverse
from calib.model.urdf import Urdf

Array = NDArray[np.float64]

#: Poses over which expected errors are averaged; more do not change them.
_MOST_EXPECTED = 1000

#: Name of the link that carries the target in a corrected URDF, when asked for.
TARGET_LINK = "calib_target"


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """The result of `calibrate`.

    Attributes:
        nominal: The robot as it came in.
        robot: The calibrated robot, its URDF corrected.
        measurements: All rows.
        cell: As given.
        nominal_cell: The cell with target and frame that the nominal robot's errors are computed with: as given, and
            registered where they were not.
        T_frame_base: shape (4, 4), pose of the base in the measurement frame, as estimated or given [m].
        target: shape (3,), the target in the tip, as estimated or given [m].
        model: The error model.
        solver: Name of the solver.
        solution: Where it stopped, with its history.
        seconds: Time that registration and estimation took.
        x: shape (p,), offsets from the registered start [m, rad].
        covariance: shape (p, p), of ``x``.
        freedom: Degrees of freedom left for the noise.
        sigma: Estimated standard deviation of one coordinate of a good row (median over rows) [m].
        prior_length: Size of errors in length that the data showed [m]; None without priors.
        prior_angle: Size of errors in angle [rad]; None without priors.
        parameters: One entry for each element of ``x``.
        residual_nominal: shape (N, 3), measured minus predicted by the nominal robot, all rows [m].
        residual_calibrated: shape (N, 3), by the calibrated robot [m].
        scores: shape (N,), of all rows; see `calib.identify.robust`.
        weights: shape (N,), of all rows in the fit, between 0 and 1; 0 for validation rows.
        flag_limit: The score above which a row is flagged.
        outliers: The estimation rows flagged; they have no weight where the fit was robust.
        suspects: The validation rows beyond such a limit, for their number; they never have a weight.
        cross_validation: Errors on left-out estimation rows; None where it was not asked for.
        nominal_cross_validation: The same of the nominal robot, with target (and frame, if it is estimated) fitted to
            the other rows.
        expected_measured: Standard deviation of the predicted point at the measured poses, rms [m]; from the
            covariance, so it knows nothing of errors that the model lacks.
        expected_everywhere: The same over joint values spread over the limits [m].
        observability: Rank, and what the measured poses cannot tell apart.
        verdict: Whether to use the result; None without cross-validation, unless the set-up is plainly wrong.
    """

    nominal: Robot
    robot: Robot
    measurements: Measurements
    cell: Cell
    nominal_cell: Cell
    T_frame_base: Array
    target: Array
    model: ErrorModel
    solver: str
    solution: Solution
    seconds: float
    x: Array
    covariance: Array
    freedom: float
    sigma: float
    prior_length: float | None
    prior_angle: float | None
    parameters: tuple[ParameterEstimate, ...]
    residual_nominal: Array
    residual_calibrated: Array
    scores: Array
    weights: Array
    flag_limit: float
    outliers: tuple[Outlier, ...]
    suspects: tuple[Outlier, ...]
    cross_validation: CrossValidation | None
    nominal_cross_validation: CrossValidation | None
    expected_measured: float
    expected_everywhere: float
    observability: Observability
    verdict: Verdict | None

    def __repr__(self) -> str:
        """In one line; `summary` has the rest."""
        verdict = "no verdict" if self.verdict is None else self.verdict.use
        return f"Calibration({self.nominal!r}, {len(self.measurements)} rows, {verdict})"

    @property
    def errors(self) -> dict[str, dict[str, Errors]]:
        """``errors["nominal" | "calibrated"]["estimation" | "validation"]``."""
        m = self.measurements
        return {
            who: {
                "estimation": Errors.of(residual[m.estimation]),
                "validation": Errors.of(residual[m.validation]),
            }
            for who, residual in (
                ("nominal", self.residual_nominal),
                ("calibrated", self.residual_calibrated),
            )
        }

    def parameter(self, name: str) -> ParameterEstimate:
        """One parameter by its exact name.

        Raises:
            ModelError: No such parameter.
        """
        return self.parameters[self.model.index(name)]

    def predict(self, q: ArrayLike) -> Array:
        """Where the calibrated robot puts the target, in the measurement frame.

        Args:
            q: shape (N, n) or (n,), joint values in the robot's order, [rad] or [m].

        Returns:
            shape (N, 3), [m].
        """
        found = replace(self.cell, target=self.target, T_frame_base=self.T_frame_base)
        return predict(self.robot, found, np.atleast_2d(np.asarray(q, dtype=np.float64)))

    def summary(self) -> str:
        """The result as text, without colours."""
        from calib.identify.summary import summary

        return summary(self)

    def write_urdf(
        self, path: str | Path, *, overwrite: bool = False, target_link: bool = False
    ) -> Path:
        """Write the corrected URDF, after reading it back with Pinocchio and yourdfpy.

        Args:
            path: Where to.
            overwrite: Whether an existing file may be replaced.
            target_link: Whether to add a link ``calib_target`` at the target, fixed to the tip.

        Raises:
            UrdfError: A reader disagrees with the model in memory by more than 1e-9 m or rad.
            FileError: The file exists, or cannot be written.
        """
        robot = self.robot
        if target_link:
            T = np.eye(4)
            T[:3, 3] = self.target
            robot = replace(robot, urdf=_with_target_link(robot, T))
        q = random_joint_values(robot)
        # Straight from the parameters, by the path that the fit took, not through the corrected robot.
        in_memory = Kinematics(self.nominal, self.model, np.eye(4), np.eye(4)).poses(self.x, q)
        displacement, _ = self.model.displacements(self.x)
        expected = rigid_inverse(displacement[0]) @ in_memory @ rigid_inverse(displacement[-1])
        check_written(robot, expected, q)
        return robot.urdf.write(path, overwrite=overwrite)

    def write_json(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write the result as JSON; the keys are documented in docs/result-json.md.

        Raises:
            FileError: The file exists, or cannot be written.
        """
        from calib.identify.result_file import write_result

        return write_result(self, path, overwrite=overwrite)


def calibrate(
    robot: Robot,
    measurements: Measurements,
    *,
    cell: Cell | None = None,
    model: str | None = None,
    solver: str = "lm",
    robust: bool = True,
    validate: bool = True,
    progress: Progress | None = None,
) -> Calibration:
    """Calibrate a robot from measurements of a target on its tip.

    Args:
        robot: The nominal robot.
        measurements: Rows of the set ``estimate`` are fitted, those of ``validate`` only predicted.
        cell: What is known of target, frame, noise and priors; default: the measurements are in the base frame, the
            target is estimated. Measurements in a tracker's own frame: ``Cell(estimate_frame=True)``.
        model: Name of the parameter set, ``"dh"``, ``"paper"``, ``"hayati"``, ``"placement"``, ``"zeros"`` or
            ``"frames"``; default the cell's, ``"dh"``. See docs/parameters.md.
        solver: ``"lm"`` (default), ``"scipy"`` (the same problem by SciPy), or ``"paper"`` (the paper's algorithm,
            without priors and robust weights).
        robust: Whether outliers lose their weight; they are named either way.
        validate: Whether to cross-validate; it takes one fit a row up to 60 rows, ten fits above.
        progress: Called after each fit of the cross-validation.

    Raises:
        ModelError: An unknown parameter set, parameter or solver, or measurements that the model does not cover.
        MeasurementError: Too few rows, or columns that the robot needs are missing.
        SolverError: No finite result.
    """
    for thing, kind in ((robot, Robot), (measurements, Measurements)):
        if not isinstance(thing, kind):
            message = (
                f"calibrate takes a {kind.__name__}; {thing!r} was given. Read it with calib.Robot.load(...) or "
                "calib.Measurements.read(...)."
            )
            raise ModelError(message)
    cell = Cell() if cell is None else cell
    cell = cell if model is None else replace(cell, model=model)
    check_one_setup(measurements)
    every = Rows(
        measurements.joints_for(robot.joint_names),
        measurements.points,
        _row_sigma(measurements, cell),
    )
    rows = every.select(measurements.estimation)
    fit_rows = partial(fit, robot, cell, solver=solver, robust=robust)

    began = time.perf_counter()
    fitted = fit_rows(rows)
    seconds = time.perf_counter() - began

    result = _assemble(robot, measurements, cell, solver, seconds, fitted, every)
    hint = better_setup(robot, cell, rows)
    if not validate:
        return replace(result, verdict=Verdict(NO, (hint,))) if hint else result
    flagged = fitted.estimate.outliers
    of_nominal, of_calibrated = cross_validation(robot, cell, rows, flagged, fit_rows, progress)
    suspects = {o.row for o in result.suspects}
    before, after, aside = validation_errors(
        measurements.validation,
        np.array([row in suspects for row in measurements.rows]),
        result.residual_nominal,
        result.residual_calibrated,
    )
    evidence = Evidence(
        nominal=of_nominal,
        calibrated=of_calibrated,
        outliers=flagged,
        validation_nominal=before,
        validation_calibrated=after,
        validation_aside=aside,
        still=still_joints(robot, rows.joints),
        larger=larger_model(robot, cell, rows, fitted) if solver != "paper" else "",
        parameters=len(result.model),
        largest=largest_change(result.model, result.x),
        noise=result.sigma,
        hint=hint,
    )
    return replace(
        result,
        cross_validation=of_calibrated,
        nominal_cross_validation=of_nominal,
        verdict=verdict(evidence),
    )


def _expected(fitted: Fitted, joints: Array) -> float:
    """Predicted standard deviation of the target's position, rms over poses [m]."""
    _, jacobian = fitted.kinematics.points_jacobian(fitted.estimate.x, joints[:_MOST_EXPECTED])
    spread = np.einsum("nij,jk,nik->n", jacobian, fitted.estimate.covariance, jacobian)
    return float(np.sqrt(np.mean(spread)))


def _with_target_link(robot: Robot, T_tip_target: Array) -> Urdf:
    """The robot's URDF with a link at the target; one that an earlier calibration added is moved there."""
    if TARGET_LINK not in robot.urdf.links:
        return robot.urdf.with_link(TARGET_LINK, robot.tip, T_tip_target)
    joint = next(joint for joint in robot.urdf.joints if joint.child == TARGET_LINK)
    if joint.parent != robot.tip or joint.type != "fixed":
        message = (
            f"The URDF has a link '{TARGET_LINK}' already, and it is not fixed to the tip '{robot.tip}' but hangs on "
            f"'{joint.parent}' by a joint of type '{joint.type}'. Rename it, or do without the target link."
        )
        raise UrdfError(message)
    return robot.urdf.with_origins({joint.name: T_tip_target})


def _row_sigma(measurements: Measurements, cell: Cell) -> Array:
    """The standard deviation of one coordinate of each row as given, or the first guess [m], shape (N,)."""
    if measurements.sigma is not None:
        return measurements.sigma
    return np.full(len(measurements), FIRST_SIGMA if cell.sigma is None else cell.sigma)


def _assemble(
    robot: Robot,
    measurements: Measurements,
    cell: Cell,
    solver: str,
    seconds: float,
    fitted: Fitted,
    every: Rows,
) -> Calibration:
    """Everything that one fit says, as one value; cross-validation and verdict are still to come."""
    estimated, model = fitted.estimate, fitted.kinematics.model
    mask, problem = measurements.estimation, estimated.problem
    _, jacobian = fitted.kinematics.points_jacobian(
        estimated.x, problem.joints[problem.weights > 0.0]
    )
    observability = analyse(
        jacobian.reshape(-1, len(model)), model.names, [p.unit for p in model.parameters]
    )
    placed = nominal_cell(robot, cell, every.select(mask))
    residual = every.points - fitted.kinematics.points(estimated.x, every.joints)
    scores, weights = np.empty(len(mask)), np.zeros(len(mask))
    weights[mask] = problem.weights
    scores[mask] = estimated.scores
    scores[~mask] = unseen_scores(fitted, every.select(~mask))
    limit = estimated.limits.flagged

    # Each set has a limit of its own, because each has its own number of chances for a false alarm.
    suspect = Limits.of(int(np.sum(~mask)), estimated.freedom).flagged

    def named(chosen: NDArray[np.bool_], beyond: float) -> tuple[Outlier, ...]:
        return tuple(
            Outlier(measurements.rows[i], float(np.linalg.norm(residual[i])), float(scores[i]))
            for i in np.flatnonzero(chosen & (scores > beyond))
        )

    T_frame_base, target = fitted.frames()
    return Calibration(
        nominal=robot,
        robot=model.apply(robot, estimated.x),
        measurements=measurements,
        cell=cell,
        nominal_cell=placed,
        T_frame_base=read_only(T_frame_base),
        target=read_only(target),
        model=model,
        solver=solver,
        solution=estimated.solution,
        seconds=seconds,
        x=estimated.x,
        covariance=estimated.covariance,
        freedom=estimated.freedom,
        sigma=float(np.median(problem.sigma)),
        prior_length=estimated.prior_length,
        prior_angle=estimated.prior_angle,
        parameters=parameter_estimates(fitted, cell, observability),
        residual_nominal=read_only(every.points - predict(robot, placed, every.joints)),
        residual_calibrated=read_only(residual),
        scores=read_only(scores),
        weights=read_only(weights),
        flag_limit=limit,
        outliers=named(mask, limit),
        suspects=named(~mask, suspect),
        cross_validation=None,
        nominal_cross_validation=None,
        expected_measured=_expected(fitted, problem.joints),
        expected_everywhere=_expected(fitted, spread_poses(robot)),
        observability=observability,
        verdict=None,
    )
