"""calibrate: a robot and measurements in, a result out.

The steps: fit the models (`calib.result.fits`), cross-validate the geometry, the nominal robot and the non-geometric
model, assemble the result, and judge it (`doubts_of`, `evidence_of`, `verdict`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calib.basics.arguments import check_callable, check_flags
from calib.basics.arrays import Array, Mask, read_only
from calib.basics.channels import RESIDUAL_UNITS, Channels
from calib.basics.jobs import Progress, one_blas_thread
from calib.data.cell import Cell
from calib.data.inputs import CellInput, RobotInput, TableInput, inputs_of
from calib.data.measurements import Measurements
from calib.diagnosis.coverage import OutsideRow, outside
from calib.diagnosis.extrapolation import extrapolation
from calib.diagnosis.reasons import NO, Verdict, Why
from calib.diagnosis.verdict import verdict
from calib.fit.estimate.fitting import Fitted, fit
from calib.fit.registration.registration import nominal_setup, register_held_out
from calib.fit.registration.rows import Rows
from calib.fit.registration.setup import Setup
from calib.fit.selection.candidates import Candidate, alternative_models, mark_chosen
from calib.fit.selection.cross_validation import cross_validation, nominal_cross_validation
from calib.fit.selection.robustness import Robustness, compare_weights
from calib.model.kinematics import Samples
from calib.model.observability import Observability
from calib.model.parameters import Parameter
from calib.numerics.errors import CrossValidation, rms
from calib.numerics.repeats import Repeats, scatter_of_repeats
from calib.numerics.scores import Limits
from calib.numerics.solvers import Solver
from calib.result.calibration import Calibration
from calib.result.cameras import result_optics
from calib.result.doubts import doubts_of
from calib.result.evidence import evidence_of
from calib.result.fits import TableFits, fit_table
from calib.result.image_errors import metres_per_pixel
from calib.result.joint_zeros import joint_zeros
from calib.result.parts import FitInMemory, Method, Noise, Outlier, ResultRows, Source, Trust
from calib.result.prediction import (
    FittedModel,
    NonGeometric,
    compensating_base_motion,
    expected_error,
    parameter_estimates,
    tells_place,
)
from calib.robot.gravity import gravity_loads
from calib.robot.ranges import spread_poses


@one_blas_thread()
def calibrate(
    robot: RobotInput,
    measurements: TableInput,
    *,
    cell: CellInput = None,
    model: str | Sequence[Parameter] | None = None,
    solver: str | Solver = "lm",
    robust: bool = True,
    validate: bool = True,
    progress: Progress | None = None,
) -> Calibration:
    """Calibrate a robot from measurements of a target on its tip.

    Args:
        robot: The nominal robot, a chain of the URDF from base to tip; or the path of a URDF or xacro, or a name such
            as ``"ur3"``: base and tip are then the cell's, or the URDF's root and the end of the longest chain whose
            joints are all in the table.
        measurements: Rows of joint values and of what was measured of the target there, or the path of their table.
            Rows of the set ``estimate`` are fitted, those of ``validate`` only predicted; rows that are copies of
            others are left out.
        cell: What is known of targets, frames, noise and priors, or the path of a cell file; None: the measurements are
            in the base frame, the target is estimated. Measurements in a tracker's own frame:
            ``Cell(estimate_frame=True)``.
        model: Name of the parameter set, with families behind it: ``"auto"`` (the data choose), ``"dh"``, ``"paper"``,
            ``"hayati"``, ``"placement"``, ``"zeros"`` or ``"frames"``, such as ``"dh+compliance"``; default the cell's.
            See docs/parameters.md. Or the robot's parameters themselves, each a twist at a placement.
        solver: ``"lm"`` (default), ``"scipy"`` (the same problem by SciPy), or ``"paper"`` (the paper's algorithm,
            without priors and robust weights); or a function like those of `calib.numerics.solvers.SOLVERS`.
        robust: Whether outliers lose their weight; they are named either way.
        validate: Whether to cross-validate; one fold a row or pose up to 60, ten folds above.
        progress: Called after each fold of the cross-validations with the number of folds done and of all; None:
            nothing is called.

    Returns:
        The calibration: parameters with covariance, corrected robot, frames and targets, and residuals of all rows;
        with a verdict if it was cross-validated, a usual mistake explains the measurements better, or a measurement
        frame was sought and not found.

    Raises:
        ArgumentError: Robot, measurements or cell are of another type.
        ModelError: An unknown parameter set, parameter or solver, or measurements that the model does not cover.
        MeasurementError: Too few rows, or columns that the robot needs are missing.
        SolverError: No finite result.
    """
    arm, table, setup = inputs_of(robot, measurements, cell)
    check_flags(robust=robust, validate=validate)
    check_callable("progress", progress)
    if isinstance(model, str):
        setup = replace(setup, model=model)
    table = table.without_copies()
    fits = fit_table(arm, table, setup, model=model, solver=solver, robust=robust)
    if fits.mistake:  # or a frame that was not found: errors of either robot mean nothing
        return _assembled(table, fits, verdict=Verdict(NO, (fits.mistake,)))
    if not validate:
        return _assembled(table, fits)
    return _validated(table, fits, progress)


# Cross-validation and verdict


@dataclass(frozen=True, slots=True, eq=False)
class _Validations:
    """Cross-validations of one calibration; None where there is none."""

    nominal: CrossValidation | None = None
    geometry: CrossValidation | None = None
    non_geometric: CrossValidation | None = None


def _validated(
    measurements: Measurements, fits: TableFits, progress: Progress | None
) -> Calibration:
    """Cross-validate the fits of a table, and assemble the result with its verdict.

    Args:
        measurements: All rows of the table, of the sets ``estimate`` and ``validate``.
        fits: The fits of its estimation rows: ``geometry``, and ``non_geometric``, that of the model that was chosen or
            named, or None; a chosen one is replaced where refits without each fold reject it. ``fitted_rows`` are the
            estimation rows as arrays.
        progress: Called after each fold with the number of folds done and of all; None: nothing is called.

    Returns:
        The result with the cross-validations of the nominal robot, of the geometry and of the non-geometric model, and
        with verdicts.
    """
    outliers = fits.geometry.estimate.outliers
    parts = 1 if fits.non_geometric is None else 2
    of_geometry = cross_validation(fits.geometry, outliers, _part_of(progress, 0, parts))
    fits, of_non_geometric = _confirmed(measurements, fits, of_geometry, progress)
    of_nominal = nominal_cross_validation(fits.geometry.task, fits.fitted_rows, outliers)
    validations = _Validations(of_nominal, of_geometry, of_non_geometric)
    return _judged(_assembled(measurements, fits, validations), fits.fitted_rows)


def _part_of(progress: Progress | None, part: int, parts: int) -> Progress | None:
    """Return a progress callback for one of several cross-validations that are reported as one.

    Args:
        progress: Called with the number of folds done and of all folds, over all parts; None: nothing is called.
        part: Number of this cross-validation, from 0.
        parts: Number of cross-validations as far as it is known; each counts as many folds as this one.

    Returns:
        A function to be called with the folds done and all folds of this part; None where ``progress`` is.
    """
    if progress is None:
        return None

    def report(done: int, folds: int) -> None:
        """Report the folds of this part, behind those of the parts before it, to ``progress``.

        Args:
            done: Number of folds of this part that are done.
            folds: Number of all folds of this part.
        """
        progress(part * folds + done, parts * folds)

    return report


def _confirmed(
    measurements: Measurements,
    fits: TableFits,
    of_geometry: CrossValidation,
    progress: Progress | None,
) -> tuple[TableFits, CrossValidation | None]:
    """Confirm the non-geometric model by refits without each fold, or replace it.

    The chosen model passed the cross-validation of the linearised problem. Refitted without each fold it has to leave
    smaller squares than the geometry; else the models with the next highest evidence are tried. A model that was named
    by the user stays.

    Args:
        measurements: All rows of the table.
        fits: The fits of its estimation rows: ``geometry``; ``non_geometric``, or None; and ``candidates``, the models
            that it was chosen from, empty where it was named.
        of_geometry: Cross-validation of the fit of the geometry, residuals of the same rows.
        progress: Called after each fold with the number of folds done and of all; None: nothing is called.

    Returns:
        The fits with the confirmed model, and its cross-validation. Where none is confirmed, the fits without a
        non-geometric model, and None.
    """
    if fits.non_geometric is None:
        return fits, None
    outliers = fits.geometry.estimate.outliers
    if not fits.candidates:
        progress_of_part = _part_of(progress, 1, 2)
        return fits, cross_validation(fits.non_geometric, outliers, progress_of_part)
    limit = _squares(fits, of_geometry)
    contenders = _contenders(measurements, fits, fits.non_geometric)
    for part, contender in enumerate(contenders, start=1):
        progress_of_part = _part_of(progress, part, part + 1)
        validation = cross_validation(contender, outliers, progress_of_part)
        if _squares(fits, validation) < limit:
            return _with_non_geometric(fits, contender), validation
    return _with_non_geometric(fits, None), None


def _squares(fits: TableFits, validation: CrossValidation) -> float:
    """Return the sum of squared held-out residuals in standard deviations of the geometry's noise, outliers aside.

    Args:
        fits: The fits of a table. Of the geometry's ``estimate`` are used ``problem.scales``, the estimated standard
            deviation of each scalar of the N fitted rows, shape (N, D), [m] and [rad], and ``outliers``, True for
            flagged rows, shape (N,).
        validation: Cross-validation of any model on these N rows: ``residual``, measured minus predicted by fits
            without the row, shape (N, D), [m] and [rad]; 0 where nothing was measured.

    Returns:
        The sum over all scalars of rows that are no outliers [1].
    """
    estimate = fits.geometry.estimate
    whitened = validation.residual / estimate.problem.scales
    return float(np.sum(whitened[~estimate.outliers] ** 2))


def _contenders(measurements: Measurements, fits: TableFits, chosen: Fitted) -> Iterator[Fitted]:
    """Yield fits of non-geometric models: the one that was chosen, then the alternatives by falling evidence.

    Args:
        measurements: All rows of the table, which say which of them are for validation.
        fits: The fits of its estimation rows: ``candidates``, the models that were tried; ``all_rows`` and
            ``fitted_rows``, the rows of the table and of its estimation set as arrays; and ``unseen``, the measurement
            setup in which only frames and targets that no estimation row sees are unknown.
        chosen: Fit of the non-geometric model that was chosen; the alternatives are fitted with its options.

    Yields:
        At most four fits to the estimation rows, each made when it is its turn; frames and targets that only validation
        rows see are registered to these.
    """
    yield chosen
    validation_rows = fits.all_rows.select(measurements.validation)
    for name in alternative_models(fits.candidates):
        fitted = fit(replace(chosen.task, model=name), fits.fitted_rows)
        yield fitted.with_held_out(fits.unseen, validation_rows)


def _with_non_geometric(fits: TableFits, non_geometric: Fitted | None) -> TableFits:
    """Return the fits of a table with another non-geometric model, and the candidates marked accordingly.

    Args:
        fits: The fits: of the geometry, of a non-geometric model, and the candidates that these were chosen from.
        non_geometric: Fit of the model to take; None: the fits are left without any.

    Returns:
        The fits with that model. Its candidate is marked ``"non_geometric"``, that of the geometry ``"geometry"``, all
        others ``""``.
    """
    geometry = str(fits.geometry.task.model)
    name = "" if non_geometric is None else str(non_geometric.task.model)
    candidates = mark_chosen(fits.candidates, geometry, name)
    return replace(fits, non_geometric=non_geometric, candidates=candidates)


def _judged(result: Calibration, rows: Rows) -> Calibration:
    """Return a cross-validated result with the verdicts on its geometry and on its non-geometric model.

    Args:
        result: The result without verdicts, with its measurements and fits in memory.
        rows: The rows that were fitted, as arrays; ``sole`` marks those of sole postures, which no other row can check.

    Returns:
        The same result with its verdict, and that of its non-geometric model if it has one.
    """
    doubts = doubts_of(result, rows)
    if result.non_geometric is not None:
        evidence = evidence_of(result, result.non_geometric, rows, doubts)
        non_geometric = replace(result.non_geometric, verdict=verdict(evidence))
        result = replace(result, non_geometric=non_geometric)
    evidence = evidence_of(result, result.geometry, rows, doubts)
    return replace(result, trust=replace(result.trust, verdict=verdict(evidence)))


# The result


def _assembled(
    measurements: Measurements,
    fits: TableFits,
    validations: _Validations | None = None,
    verdict: Verdict | None = None,
) -> Calibration:
    """Assemble the result of fits as one value.

    Args:
        measurements: All N rows of the table.
        fits: Fits of its estimation rows: of the geometry, and of the non-geometric model if there is one; the N rows
            as arrays; and the time that the fits took [s].
        validations: Cross-validations of the nominal robot and of these fits; None: there are none.
        verdict: The verdict on the geometry, where it is known already, as with a usual mistake in the table; None: it
            is not.

    Returns:
        The result, with residuals, scores and weights of all N rows, fitted or not, and the fits themselves.
    """
    validations = _Validations() if validations is None else validations
    m, fitted = measurements, fits.geometry
    robot, cell, estimate = fitted.task.robot, fitted.task.cell, fitted.estimate
    observability = estimate.problem.observability(estimate.x)
    nominal_places = _nominal_places(m, fits)
    geometry = FittedModel(**_model_values(fitted, observability, validations.geometry))
    return Calibration(
        nominal=robot,
        robot=geometry.model.apply(robot, estimate.x),
        nominal_setup=nominal_places,
        geometry=geometry,
        non_geometric=_non_geometric(fits, validations.non_geometric),
        rows=_result_rows(m, fits, _nominal_residual(fits, nominal_places)),
        noise=Noise(
            sigma=estimate.sigma,
            sigma_given=_stated_sigma(m, cell),
            freedom=estimate.freedom,
            repeats=_repeats(fitted),
            pose_noise=estimate.pose_noise,
        ),
        trust=Trust(
            verdict=verdict,
            nominal_cross_validation=validations.nominal,
            observability=observability,
            robustness=_robustness(fitted),
        ),
        method=Method(
            frame_estimated=cell.estimate_frame,
            frozen=cell.frozen,
            ties=cell.ties,
            prior_std_from=cell.priors.source,
            candidates=_without_rows(fits.candidates),
            solver=_solver_name(fitted.task.solver),
            solution=estimate.solution,
            seconds=fits.seconds,
        ),
        optics=result_optics(fitted, fits.all_rows, geometry),
        zeros=joint_zeros(fits, m.validation, cross_validated=validations.geometry is not None),
        source=Source(m.source, m.sha256, m.orientation),
        record=cell.record,
        fit_in_memory=FitInMemory(m, cell, fitted, fits.non_geometric),
    )


def _robustness(geometry: Fitted) -> Robustness | None:
    """Fit once more without robust weights if the fit has them, else with them, and compare the two.

    Args:
        geometry: Fit of the geometry: which rows are outliers, and its options.

    Returns:
        The distance between the predictions of both fits at the measured poses [m], and the held-out errors of both.
        None where no row is an outlier, and for the paper's solver, which has no robust weights.
    """
    has_outliers = np.any(geometry.estimate.outliers)
    if not has_outliers or not geometry.task.has_weights_and_priors:
        return None
    return compare_weights(geometry)


def _outside(measurements: Measurements, fits: TableFits) -> tuple[OutsideRow, ...]:
    """List the validation rows with joint values outside of those of the estimation rows.

    Args:
        measurements: All N rows of the table: which are for estimation, which for validation.
        fits: The fits of the table: the robot, and ``all_rows.joints``, joint values of these N rows, shape (N, m),
            [rad] or [m].

    Returns:
        These rows in their order, each by its index among the validation rows, from 0, with the joints that are outside
        and by how much, [rad] or [m].
    """
    robot, q = fits.geometry.task.robot, fits.all_rows.joints
    types = [joint.type for joint in robot.inputs]
    return outside(q[measurements.estimation], q[measurements.validation], robot.joint_names, types)


def _model_values(
    fitted: Fitted, observability: Observability, validation: CrossValidation | None
) -> dict[str, Any]:
    """Return the attributes of `calib.result.prediction.FittedModel` by their names.

    Args:
        fitted: The fit of the model, geometric or not, of p parameters: task, kinematics, and estimate with its rows.
        observability: Which of the p parameters the fitted rows determine.
        validation: Cross-validation of the fit; None: there was none.

    Returns:
        ``"kinematics"``, the nominal robot under its error model, with registered frames and targets; ``"x"``, shape
        (p,), the parameters, offsets from there in their units; ``"covariance"``, shape (p, p), of x; ``"prior_std"``,
        prior standard deviation by the name of a family of parameters; ``"parameters"``, value, interval and prior of
        each; ``"setup"``, frames and targets at the solution; ``"base_motion"``, shape (6, p), velocity of the base's
        origin [m] then turn [rad] along the base's axes, the rigid motion that is nearest to what a unit of each
        parameter does to the measured positions and is subtracted from it, None where the rows determine where the base
        stands; ``"cross_validation"``, as given; ``"expected_measured"``, standard deviation of the predicted position
        of the target by the covariance, rms over the fitted rows, in the base without ``base_motion`` if there is one
        [m]; ``"expected_everywhere"``, the same over joint values spread over the joint limits [m];
        ``"extrapolation"``, squared error of extrapolated predictions over their variance, 1 or more.
    """
    kinematics, x = fitted.kinematics, fitted.estimate.x
    covariance = fitted.estimate.covariance
    rows = fitted.estimate.problem.rows
    base_motion = None
    if not tells_place(kind.name for kind in rows.present):
        base_motion = compensating_base_motion(kinematics, x, rows.samples)
    everywhere = _spread_samples(fitted)
    return {
        "kinematics": kinematics,
        "x": x,
        "covariance": covariance,
        "prior_std": fitted.estimate.prior_std,
        "parameters": parameter_estimates(fitted, observability),
        "setup": fitted.estimated_setup(),
        "base_motion": base_motion,
        "cross_validation": validation,
        "expected_measured": expected_error(kinematics, x, covariance, rows.samples, base_motion),
        "expected_everywhere": expected_error(kinematics, x, covariance, everywhere, base_motion),
        "extrapolation": extrapolation(fitted),
    }


def _spread_samples(fitted: Fitted) -> Samples:
    """Return 200 sets of joint values spread over the joint limits, over which expected errors are averaged.

    Args:
        fitted: A fit: its robot, its error model, and its cell with payload and gravity.

    Returns:
        Samples of the first measurement frame and target, always the same ones; with the loads of gravity and payload
        on the joints if a parameter of the model is multiplied by them, else without loads.
    """
    robot, cell = fitted.task.robot, fitted.task.cell
    q = spread_poses(robot)
    terms = fitted.kinematics.model.terms
    if any(term.factor and term.factor.loaded for term in terms):
        loads = gravity_loads(robot, q, cell.payload, cell.gravity)
        return Samples.at(q, loads)
    return Samples.at(q)


def _non_geometric(fits: TableFits, validation: CrossValidation | None) -> NonGeometric | None:
    """Return the non-geometric model of the result; None if none was fitted.

    Args:
        fits: The fits of a table: ``non_geometric``, the fit of that model, or None; and all N rows as arrays.
        validation: Cross-validation of the non-geometric fit; None: it was not run.

    Returns:
        The fitted model with its residuals of all rows, measured minus predicted, shape (N, D), [m] and [rad], and the
        payload and gravity that loaded the joints; without a verdict.
    """
    fitted = fits.non_geometric
    if fitted is None:
        return None
    observability = fitted.estimate.problem.observability(fitted.estimate.x)
    cell = fitted.task.cell
    return NonGeometric(
        **_model_values(fitted, observability, validation),
        residual=read_only(fitted.residual(fits.all_rows)),
        payload=cell.payload,
        gravity=cell.gravity,
    )


def _nominal_places(measurements: Measurements, fits: TableFits) -> Setup:
    """Place frames and targets for the nominal robot: as given, or registered to the estimation rows.

    Those that only validation rows see are registered to these.

    Args:
        measurements: All N rows of the table: which are for estimation, which for validation.
        fits: The fits of the table: the nominal robot, frames and targets as given (``geometry.task.setup``), and the N
            rows as arrays. In ``unseen`` only frames and targets that no estimation row sees are unknown.

    Returns:
        T_frame_base, the pose of the base in each measurement frame, and T_tip_target, that of each target in the tip
        [m], with which the nominal robot predicts.
    """
    task, rows = fits.geometry.task, fits.all_rows
    T_base_tip = task.robot.poses(rows.joints)
    estimation, validation = measurements.estimation, measurements.validation
    placed = nominal_setup(T_base_tip[estimation], task.setup, rows.select(estimation))
    unseen = fits.unseen.with_given_fixed()
    return register_held_out(T_base_tip[validation], placed, unseen, rows.select(validation))


def _nominal_residual(fits: TableFits, places: Setup) -> Array:
    """Return measured minus predicted by the nominal robot, shape (N, D), in the units of the rows' channels.

    Args:
        fits: The fits of the table, with its N rows as arrays.
        places: Frames and targets of the nominal robot.

    Returns:
        0 where nothing was measured; NaN elsewhere if a measurement frame was not found: residuals at a wrong place say
        nothing of the robot.
    """
    rows = fits.all_rows
    if fits.mistake is not None and fits.mistake.why == Why.FRAME_NOT_FOUND:
        return np.where(rows.used, np.nan, 0.0)
    T_base_tip = fits.geometry.task.robot.poses(rows.joints)
    return rows.residual(places.target_poses(T_base_tip, rows.samples))


def _result_rows(
    measurements: Measurements, fits: TableFits, residual_nominal: Array
) -> ResultRows:
    """Return the names, residuals, scores and weights of all rows by the fit of the geometry.

    Args:
        measurements: All N rows of the table: which are for estimation, which for validation.
        fits: The fits of the table: that of the geometry, with scores and weights of the estimation rows, and the N
            rows as arrays.
        residual_nominal: Measured minus predicted by the nominal robot, shape (N, D), in the units of the rows'
            channels.
    """
    m, geometry, all_rows = measurements, fits.geometry, fits.all_rows
    estimate = geometry.estimate
    residual = geometry.residual(all_rows)
    scores, weights = np.empty(len(all_rows)), np.zeros(len(all_rows))
    weights[m.estimation] = estimate.weights
    scores[m.estimation] = estimate.scores
    scores[m.validation] = geometry.held_out_scores(all_rows.select(m.validation))

    # Each set has a limit of its own, because each has its own number of chances for a false alarm.
    suspect_limit = float(Limits.of(np.sum(m.validation), estimate.freedom).flagged)
    is_outlier = m.estimation & (scores > estimate.flag_limit)
    is_suspect = m.validation & (scores > suspect_limit)

    return ResultRows(
        numbers=m.rows,
        sets=m.sets,
        kinds=m.kinds,
        groups=m.groups,
        targets=m.targets,
        images=m.images if any(m.images) else (),
        residual_nominal=read_only(residual_nominal),
        residual_calibrated=read_only(residual),
        channels=all_rows.channels,
        scores=read_only(scores),
        weights=read_only(weights),
        flag_limit=estimate.flag_limit,
        outliers=_flagged(m, all_rows.channels, residual, scores, is_outlier),
        suspects=_flagged(m, all_rows.channels, residual, scores, is_suspect),
        ranges=_fitted_ranges(all_rows.joints[weights > 0.0]),
        outside=_outside(m, fits),
        metres_per_pixel=metres_per_pixel(geometry, all_rows),
    )


def _flagged(
    measurements: Measurements, channels: Channels, residual: Array, scores: Array, flagged: Mask
) -> tuple[Outlier, ...]:
    """List flagged rows in the table's order, each with the norm of its residual in each unit that it measures."""
    norms = {unit: channels.norms(residual, unit) for unit in channels.present}
    result = []
    for i in np.flatnonzero(flagged).tolist():
        by_unit = {unit: float(norm[i]) for unit, norm in norms.items() if np.isfinite(norm[i])}
        result.append(Outlier(measurements.rows[i], by_unit, float(scores[i])))
    return tuple(result)


def _fitted_ranges(joints: Array) -> Array:
    """Return the smallest and the largest value of each joint.

    Args:
        joints: Joint values of the n rows with weight in the fit, shape (n, m), [rad] or [m].

    Returns:
        Smallest and largest, shape (m, 2), [rad] or [m], read-only; infinity and minus infinity where n is 0.
    """
    low = joints.min(axis=0, initial=np.inf)
    high = joints.max(axis=0, initial=-np.inf)
    return read_only(np.stack([low, high], axis=1))


def _without_rows(candidates: Iterable[Candidate]) -> tuple[Candidate, ...]:
    """Return candidates with the figures of their cross-validations, but without the residuals of each row.

    Args:
        candidates: Models that were fitted when the model was chosen, each with its cross-validation.

    Returns:
        The same candidates; ``residual`` and ``poses`` of their cross-validations, one entry a row, are empty.
    """
    result = []
    for candidate in candidates:
        validation = candidate.cross_validation.without_rows()
        result.append(replace(candidate, cross_validation=validation))
    return tuple(result)


def _solver_name(solver: str | Solver) -> str:
    """Return the name of a solver for the result.

    Args:
        solver: Its name, such as ``"lm"``, which is returned as it is; or the solver itself, a function.
    """
    return solver if isinstance(solver, str) else solver.__name__


def _stated_sigma(measurements: Measurements, cell: Cell) -> dict[str, float]:
    """Return the noise of one scalar of fitted rows as their table states it, rms, else as the cell does, by unit.

    Args:
        measurements: Table of N rows; NaN stands for rows that state none.
        cell: May state it for all rows.
    """
    stated = dict(cell.sigma)
    for unit, by_row in measurements.stated_sigma.items():
        of_fitted = by_row[measurements.estimation & np.isfinite(by_row)]
        if len(of_fitted):  # the second row of a pair states none
            stated[unit] = rms(of_fitted)
        else:
            stated.pop(unit, None)
    return {unit: stated[unit] for unit in RESIDUAL_UNITS if unit in stated}


def _repeats(fitted: Fitted) -> Repeats | None:
    """Return the scatter of rows that repeat a pose.

    Args:
        fitted: A fit to N rows: its residuals, ``weights`` of the rows, robust ones and those of the problem with
            repeats shared out, and ``problem.rows.poses``, the same number for repeats of a pose.

    Returns:
        Standard deviation of one scalar within the poses, by unit, with degrees of freedom, and the intraclass
        correlation of repeats; None where no pose is repeated, or only by rows without
        weight.
    """
    estimate = fitted.estimate
    rows = estimate.problem.rows
    if len(np.unique(rows.poses)) == len(rows):
        return None
    # The scalars' worth of information that the parameters have taken.
    paid = float(np.sum(estimate.problem.weights @ rows.used)) - estimate.freedom
    scatter = scatter_of_repeats(
        fitted.residual(rows), rows.channels, rows.poses, estimate.weights, fitted=max(paid, 0.0)
    )
    return scatter if scatter.freedom > 0 else None
