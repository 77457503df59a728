"""calibrate: a robot and measurements in, a result out.

The steps: fit the models (`calib.result.table_fits`), cross-validate the geometry, the nominal robot and the
non-geometric model, assemble the result, and judge it (`calib.result.collected_evidence`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from calib.basics.arguments import check_callable, check_flags
from calib.basics.arrays import Array, Mask, read_only
from calib.basics.channels import RESIDUAL_UNITS, Channels
from calib.basics.dates import date_text, now
from calib.basics.jobs import Progress, one_blas_thread
from calib.basics.progress import Stage, begin
from calib.data.cell import AUTO, Cell
from calib.data.inputs import CellInput, RobotInput, TableInput, cell_with, chain_of, inputs_of
from calib.data.measurements import Measurements
from calib.diagnosis.augmented_fit import PREDICTS
from calib.diagnosis.camera_changes import changes_between_pictures
from calib.diagnosis.coverage import outside
from calib.diagnosis.frame_drift import (
    WORLD,
    FrameDrift,
    find_frame_drift,
    shown_by_references,
    without_frame_drift,
)
from calib.diagnosis.judge import absurd_noise
from calib.diagnosis.picture_mistakes import mistakes_of_pictures
from calib.diagnosis.reasons import NO, Reason, Verdict, Why
from calib.diagnosis.usual_mistakes import find_usual_mistake
from calib.errors import ModelError
from calib.fit.estimate.fitting import Fitted, fit
from calib.fit.registration.board_ends import numbered_from_one_end
from calib.fit.registration.mounts import with_mounts_found
from calib.fit.registration.registration import nominal_setup, register_held_out
from calib.fit.registration.rows import Rows
from calib.fit.registration.table_rows import rows_and_setup
from calib.fit.selection.candidates import alternative_models, mark_chosen
from calib.fit.selection.cross_validation import cross_validation, nominal_cross_validation
from calib.fit.selection.row_weights import compare_weights
from calib.instruments.internals import with_starts
from calib.model.error_model import Parameter
from calib.numerics.errors import CrossValidation, rms
from calib.numerics.neighbours import along_path
from calib.numerics.repeats import scatter_of_repeats
from calib.numerics.scores import Limits
from calib.numerics.solvers import Solver
from calib.result.board_errors import BoardErrors, board_errors
from calib.result.calibration import Calibration
from calib.result.call import Call, file_hashes, plugin_hashes
from calib.result.collected_evidence import accidents, add_verdicts
from calib.result.doubts import late_in_table, patterns_in_table
from calib.result.fewer_corners import with_fewer_corners
from calib.result.fitted_model import FittedModel, NonGeometric
from calib.result.joint_zeros import joint_zeros
from calib.result.parts import FitInMemory, Method, Noise, Outlier, ResultRows, Source, Trust
from calib.result.result_optics import result_optics
from calib.result.table_fits import TableFits, fit_table
from calib.robot.flange import is_flange_robot
from calib.robot.robot import Robot


@one_blas_thread()
def calibrate(
    robot: RobotInput,
    measurements: TableInput,
    *,
    cell: CellInput = None,
    base: str | Sequence[str] | None = None,
    tip: str | Sequence[str] | None = None,
    target: str | None = None,
    frame: str | Sequence[str] | None = None,
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
        measurements: Rows of joint values and of what was measured of the target there, or the path of their table, or
            a frame of pandas or polars, or a dict of columns, as `Measurements.of` takes them.
            Rows of the set ``estimate`` are fitted, those of ``validate`` only predicted; rows that are copies of
            others are left out.
        cell: What is known of targets, frames, noise and priors, or the path of a cell file; None: the measurements are
            in the base frame, the target is estimated. Measurements in a tracker's own frame:
            ``Cell(estimate_frame=True)``.
        base: As ``--base`` on the command line, over the cell: link in whose frame the chain starts, of a robot that is
            given as a path or by name; ``"NAME=LINK"`` for the frame of a station, several in a list.
        tip: As ``--tip``: link that the target is mounted on.
        target: As ``--target``: stated position of the target in the tip, ``"70 -70 22.5 mm"``.
        frame: As ``--frame``: ``"known"``, ``"estimate"``, or the directions that are not known, ``"x,y,rz"``.
        model: Name of the parameter set, with families after it: ``"auto"`` (the data choose), ``"dh"``, ``"paper"``,
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
        with a verdict if it was cross-validated, a usual mistake explains the measurements better, a measurement
        frame was sought and not found, or the noise is beyond any arm and instrument.

    Raises:
        ArgumentError: Robot, measurements or cell are of another type.
        ModelError: An unknown parameter set, parameter or solver, or measurements that the model does not cover.
        MeasurementError: Too few rows, or columns that the robot needs are missing.
        SolverError: No finite result.
    """
    stated = cell_with(cell, robot, base=base, tip=tip, target=target, frame=frame)
    arm, measured, stated = inputs_of(robot, measurements, stated)
    check_flags(robust=robust, validate=validate)
    check_callable("progress", progress)
    if isinstance(model, str):
        stated, model = replace(stated, model=model), None
    named = [
        str(given) if isinstance(given, (str, Path)) else "" for given in (robot, measurements)
    ]
    further = [other.robot for other in stated.robots.values()]
    told = stated
    if isinstance(robot, Robot) and not (robot.branches or robot.parts):
        # The links of its chain, for a robot that is read from a file the next time.
        chain = chain_of(robot)
        told = replace(
            stated, base=chain.base, tip=chain.tip, held=chain.held, coupling=chain.coupling
        )
    call = Call(
        robot=named[0],
        table=named[1],
        cell=told,
        own_parameters=model is not None,
        solver=solver if isinstance(solver, str) else getattr(solver, "__name__", ""),
        robust=robust,
        validate=validate,
        files=file_hashes([*filter(None, named), *further]),
        plugins=plugin_hashes(),
    )
    result = _calibrated(
        arm,
        measured,
        stated,
        model=model,
        solver=solver,
        robust=robust,
        validate=validate,
        progress=progress,
    )
    return replace(result, method=replace(result.method, call=call))


def _calibrated(
    arm: Robot,
    measured: Measurements,
    stated: Cell,
    *,
    model: Sequence[Parameter] | None,
    solver: str | Solver,
    robust: bool,
    validate: bool,
    progress: Progress | None,
) -> Calibration:
    """Calibrate from inputs that were read and checked, see `calibrate`; a model of None is the cell's."""
    if is_flange_robot(arm.joint_names):
        stated, model = _of_flange_poses(stated, model), None
    measured = measured.without_copies()
    if arm.mounts or stated.cameras:
        rows, setup = rows_and_setup(arm, measured, stated)
        stated = with_starts(stated, measured, rows.samples.internals)
        if arm.mounts:
            arm = with_mounts_found(arm, setup, rows.select(measured.estimation))
    measured = numbered_from_one_end(arm, measured, stated)
    begin(Stage.MISTAKES)
    measured, found, wrong = without_mistakes_of_pictures(arm, stated, measured)
    measured, thinned = with_fewer_corners(measured)
    found += thinned
    as_measured = measured
    shown = find_frame_drift(as_measured, stated.references)
    if shown is not None:
        measured = without_frame_drift(as_measured, shown[1])
    fits = fit_table(
        arm,
        measured,
        stated,
        model=model,
        solver=solver,
        robust=robust,
        mistake=wrong,
        search=not np.all(measured.is_image),
    )
    if shown is not None and not fits.mistake:
        # The residuals tell more of what the references show: between which poses a step was.
        taken_out = shown[1]
        shown = find_frame_drift(as_measured, stated.references, fits.best, taken_out)
        assert shown is not None
        if not shown[1].same_as(taken_out):
            begin(Stage.MISTAKES)
            measured = without_frame_drift(as_measured, shown[1])
            fits = fit_table(arm, measured, stated, model=model, solver=solver, robust=robust)
    frame_drift = None if shown is None else shown[0]
    drift = patterns = None
    if validate and not fits.mistake:
        patterns = tuple(patterns_in_table(fits.best, measured))
        # References that stand still with the frame say that a drift of the residuals is the robot's.
        if frame_drift is None or all(one.link == WORLD for one in frame_drift.targets):
            drift = _found_drift(patterns, measured, fits)
    if drift is not None:
        begin(Stage.MISTAKES)
        measured = _without_drift(measured, drift)
        fits = fit_table(arm, measured, stated, model=model, solver=solver, robust=robust)
        patterns = None  # of the table before

    if fits.mistake or not validate:
        begin(Stage.VERDICT)
    if fits.mistake:  # or a frame that was not found: errors of either robot mean nothing
        return _with_verdict_against(_assemble(measured, fits, drift=frame_drift), fits.mistake)
    if not validate:
        result = _assemble(measured, fits, drift=frame_drift)
        absurd = absurd_noise(result.noise.sigma)
        return result if absurd is None else _with_verdict_against(result, absurd)
    before = [*found, *(() if frame_drift is None else shown_by_references(frame_drift))]
    if drift is not None:
        before.append(Reason.of(Why.DRIFT_REMOVED, drift_m=float(np.linalg.norm(drift))))
    return _assemble_validated(measured, fits, progress, tuple(before), patterns, frame_drift)


def without_mistakes_of_pictures(
    robot: Robot, cell: Cell, measurements: Measurements
) -> tuple[Measurements, tuple[Reason, ...], Reason | None]:
    """Leave out the pictures that a mistake explains.

    Args:
        robot: The nominal robot.
        cell: Cameras and boards as given.
        measurements: The table, in the order in which it was measured.

    Returns:
        The other rows, the mistakes of those that were left out, and a mistake of all rows; None if there is none.
    """
    found: list[Reason] = []
    for find in (mistakes_of_pictures, changes_between_pictures):
        if find is changes_between_pictures and np.all(measurements.is_image):
            # A quick fit to an input with a usual mistake would take long and mean nothing.
            estimation = measurements.select(measurements.estimation)
            mistake = find_usual_mistake(robot, cell, estimation, measurements)
            if mistake is not None:
                return measurements, tuple(found), mistake
        findings = find(robot, cell, measurements)
        for finding in findings:
            if not finding.rows:
                return measurements, tuple(found), finding.reason
            found.append(finding.reason)
        left_out = [row for finding in findings for row in finding.rows]
        if left_out:  # the other pictures tell the robot
            measurements = measurements.select(~np.isin(measurements.rows, left_out))
    return measurements, tuple(found), None


def _of_flange_poses(cell: Cell, model: Sequence[Parameter] | None) -> Cell:
    """Return the cell with the only model for poses of the flange in place of joint values, which is ``frames``.

    ModelError if another one is named: such poses know nothing of joints.
    """
    named = cell.model if model is None else model
    if named not in (AUTO, "frames"):
        raise ModelError(
            "The table has poses of the flange in place of joint values, which tell nothing of a joint's errors: the "
            "model is 'frames'. To correct a robot, compute its joint values first: calib joints ROBOT TABLE."
        )
    return replace(cell, model="frames")


def _found_drift(
    patterns: tuple[Reason, ...], measurements: Measurements, fits: TableFits
) -> Array | None:
    """Return the drift of the measured positions from the first fitted row to the last, (3,) [m], in their frame.

    None if it is not among the patterns of the best fit, predicts no held-out rows, or its vector cannot be told
    (`residual_patterns`); or if joint values are late, which along a path looks like a drift.
    """
    for reason in patterns:
        values = reason.values
        if reason.why is Why.DRIFT and "drift_xyz" in values and values["falls"] >= PREDICTS:
            is_late = any(late_in_table(fits.geometry, measurements))
            return None if is_late else np.array(values["drift_xyz"])
    return None


def _without_drift(measurements: Measurements, drift: Array) -> Measurements:
    """Take a drift, (3,) [m], out of measured positions: they become what they were at the first fitted row.

    It grows evenly from the first fitted row to the last, in the order of the table, and stays what it was beyond.
    """
    fitted_rows = np.flatnonzero(measurements.estimation)
    share = np.interp(
        np.arange(len(measurements)), fitted_rows, np.linspace(0.0, 1.0, len(fitted_rows))
    )
    return replace(measurements, points=measurements.points - share[:, None] * drift)


def _with_verdict_against(result: Calibration, why: Reason) -> Calibration:
    """Return a result with the verdict ``do not use`` on its geometry, for a reason that needs no held-out rows."""
    verdict = Verdict(NO, (why,))
    return replace(result, geometry=replace(result.geometry, verdict=verdict))


def _assemble_validated(
    measurements: Measurements,
    fits: TableFits,
    progress: Progress | None,
    found: tuple[Reason, ...] = (),
    patterns: tuple[Reason, ...] | None = None,
    drift: FrameDrift | None = None,
) -> Calibration:
    """Cross-validate the fits of a table, and assemble the result with its verdicts.

    ``found`` is what was found before the fit, such as a drift that was taken out of the measurements; ``patterns`` are
    those in the residuals of the best fit, None if they were not looked for; ``drift`` is what references show, None
    without any.

    A non-geometric model that the data chose stays only if it leaves smaller held-out squares than the geometry; else
    the next candidates are tried, and none stays if none does. One that the user named stays.
    """
    outliers = fits.geometry.estimate.outliers
    begin(Stage.FOLDS)

    def validate_poses(
        fitted: Fitted | None, of_fit: CrossValidation | None
    ) -> CrossValidation | None:
        """Hold out poses of a fit, where its cross-validation holds out whole stations; else None."""
        if fitted is None or of_fit is None or not of_fit.holds_out_stations:
            return None
        return cross_validation(fitted, outliers | fitted.estimate.outliers, by_poses=True)

    def validate(fitted: Fitted, part: int, parts: int) -> CrossValidation:
        """Cross-validate a fit, reported as one of several parts that have as many folds each."""

        def report(done: int, folds: int) -> None:
            if progress is not None:
                progress(part * folds + done, parts * folds)

        # Gross rows that only a non-geometric model shows are not what it is off by at a new point.
        return cross_validation(fitted, outliers | fitted.estimate.outliers, report)

    def squares(validation: CrossValidation) -> float:
        """Sum the squared held-out residuals in standard deviations of the geometry's noise, outliers aside."""
        whitened = validation.residual / fits.geometry.estimate.problem.scales
        return float(np.sum(whitened[~outliers] ** 2))

    chosen = fits.non_geometric
    of_geometry = validate(fits.geometry, 0, 1 if chosen is None else 2)
    of_non_geometric = None
    if chosen is not None and not fits.candidates:  # the user named it: it stays
        of_non_geometric = validate(chosen, 1, 2)
    elif chosen is not None:
        # It passed the cross-validation of the linearised problem. Refitted without each fold it has to leave smaller
        # squares than the geometry; else the models with the next highest evidence are tried.
        validation_rows = fits.all_rows.select(measurements.validation)
        confirmed = None
        names = (str(chosen.task.model), *alternative_models(fits.candidates))
        for part, name in enumerate(names, start=1):
            contender = chosen
            if part > 1:
                alternative = fit(replace(chosen.task, model=name), fits.fitted_rows)
                contender = alternative.with_held_out(fits.unseen, validation_rows)
            of_contender = validate(contender, part, part + 1)
            if squares(of_contender) < squares(of_geometry):
                confirmed, of_non_geometric = contender, of_contender
                break
        name = "" if confirmed is None else str(confirmed.task.model)
        candidates = mark_chosen(fits.candidates, str(fits.geometry.task.model), name)
        if confirmed is not chosen:  # the patterns are of another fit
            patterns = None
        fits = replace(fits, non_geometric=confirmed, candidates=candidates)
    of_nominal = nominal_cross_validation(fits.geometry.task, fits.fitted_rows, outliers)
    of_poses = (
        validate_poses(fits.geometry, of_geometry),
        validate_poses(fits.non_geometric, of_non_geometric),
    )

    begin(Stage.VERDICT)
    if patterns is None:
        patterns = tuple(patterns_in_table(fits.best, measurements))
    result = _assemble(
        measurements, fits, of_geometry, of_non_geometric, of_nominal, of_poses, drift
    )
    return add_verdicts(result, fits.fitted_rows, patterns, found)


def _assemble(
    measurements: Measurements,
    fits: TableFits,
    of_geometry: CrossValidation | None = None,
    of_non_geometric: CrossValidation | None = None,
    of_nominal: CrossValidation | None = None,
    of_poses: tuple[CrossValidation | None, CrossValidation | None] = (None, None),
    drift: FrameDrift | None = None,
) -> Calibration:
    """Assemble the result of fits and of their cross-validations (None: there was none), without verdicts.

    ``of_poses`` are those of both fits by poses, where stations were held out; ``drift`` is what the references show,
    None if there are none.
    """
    m, fitted, all_rows = measurements, fits.geometry, fits.all_rows
    task, estimate = fitted.task, fitted.estimate
    robot, cell = task.robot, task.cell

    # The nominal robot, its frames and targets as given, or registered: to the estimation rows if these see them.
    T_base_tip = robot.poses(all_rows.joints, all_rows.samples.chain)
    setup = nominal_setup(T_base_tip[m.estimation], task.setup, all_rows.select(m.estimation))
    setup = register_held_out(
        T_base_tip[m.validation],
        setup,
        fits.unseen.with_given_fixed(),
        all_rows.select(m.validation),
    )
    residual_nominal = all_rows.residual(setup.sightings(T_base_tip, all_rows.samples))
    if fits.mistake is not None and fits.mistake.why is Why.FRAME_NOT_FOUND:
        # Residuals of a frame in a wrong place say nothing about the robot.
        residual_nominal = np.where(all_rows.used, np.nan, 0.0)

    rows = _result_rows(m, fits, residual_nominal)
    suspects = np.isin(m.rows, [suspect.row for suspect in rows.suspects])
    of_validation = m.validation & ~accidents(m.validation, suspects)

    observability = estimate.problem.observability(estimate.x)
    noise = _noise(m, fitted)
    geometry = FittedModel.of(
        fitted,
        observability,
        of_geometry,
        noise,
        validation_board=_board_errors(fitted, all_rows.select(of_validation)),
        pose_validation=of_poses[0],
    )
    non_geometric = None
    if fits.non_geometric is not None:
        of_larger = fits.non_geometric.estimate
        non_geometric = NonGeometric.of(
            fits.non_geometric,
            of_larger.problem.observability(of_larger.x),
            of_non_geometric,
            noise,
            validation_board=_board_errors(fits.non_geometric, all_rows.select(of_validation)),
            pose_validation=of_poses[1],
            residual=read_only(fits.non_geometric.residual(all_rows)),
            payload=cell.payload,
            gravity=cell.gravity,
        )

    robustness = None
    if np.any(estimate.outliers) and task.has_weights_and_priors:
        robustness = compare_weights(fitted)
    candidates = []
    for candidate in fits.candidates:
        validation = candidate.cross_validation.without_rows()
        candidates.append(replace(candidate, cross_validation=validation))

    return Calibration(
        nominal=robot,
        robot=geometry.model.apply(robot, estimate.x),
        nominal_setup=setup,
        geometry=geometry,
        non_geometric=non_geometric,
        rows=rows,
        noise=noise,
        trust=Trust(
            nominal_cross_validation=of_nominal,
            observability=observability,
            robustness=robustness,
        ),
        method=Method(
            frame_estimated=cell.estimate_frame,
            frozen=cell.frozen,
            ties=cell.ties,
            prior_std_from=cell.priors.source,
            candidates=tuple(candidates),
            solver=task.solver if isinstance(task.solver, str) else task.solver.__name__,
            solution=estimate.solution,
            seconds=fits.seconds,
            time=date_text(now()),
        ),
        optics=result_optics(fitted, all_rows, geometry),
        drift=drift,
        zeros=joint_zeros(fits, m.validation, cross_validated=of_geometry is not None),
        source=Source(m.source, m.sha256, m.orientation),
        record=cell.record,
        stated_uncertainty=cell.uncertainty,
        fit_in_memory=FitInMemory(m, cell, fitted, fits.non_geometric),
    )


def _board_errors(fitted: Fitted, rows: Rows) -> BoardErrors | None:
    """Return the errors of the predicted poses of boards in rows that a fit has not seen; None without images."""
    sightings = fitted.kinematics.sightings(fitted.estimate.x, rows.samples)
    return board_errors(rows, sightings, fitted.residual(rows))


def _result_rows(
    measurements: Measurements, fits: TableFits, residual_nominal: Array
) -> ResultRows:
    """Return names, residuals, scores and weights of all N rows by the fit of the geometry.

    ``residual_nominal``, shape (N, D), is measured minus predicted by the nominal robot, in the units of the rows'
    channels. Flagged rows are listed apart for estimation and validation rows.
    """
    m, geometry, all_rows = measurements, fits.geometry, fits.all_rows
    robot, estimate = geometry.task.robot, geometry.estimate
    residual = geometry.residual(all_rows)
    scores, weights = np.empty(len(all_rows)), np.zeros(len(all_rows))
    weights[m.estimation] = estimate.weights
    scores[m.estimation] = estimate.scores
    scores[m.validation] = geometry.held_out_scores(all_rows.select(m.validation))

    # Each set has a limit of its own, because each has its own number of chances for a false alarm.
    suspect_limit = float(Limits.of(np.sum(m.validation), estimate.freedom).flagged)
    is_outlier = m.estimation & (scores > estimate.flag_limit)
    is_suspect = m.validation & (scores > suspect_limit)

    metres_per_pixel = None
    if np.any(all_rows.is_image):
        sightings = geometry.kinematics.sightings(estimate.x, all_rows.samples)
        metres_per_pixel = all_rows.lengths_per_unit(sightings)

    q = all_rows.joints
    low = q[weights > 0.0].min(axis=0, initial=np.inf)
    high = q[weights > 0.0].max(axis=0, initial=-np.inf)
    types = [joint.type for joint in robot.inputs]

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
        ranges=read_only(np.stack([low, high], axis=1)),
        outside=outside(q[m.estimation], q[m.validation], robot.joint_names, types),
        metres_per_pixel=metres_per_pixel,
    )


def _flagged(
    measurements: Measurements, channels: Channels, residual: Array, scores: Array, flagged: Mask
) -> tuple[Outlier, ...]:
    """List the rows that a mask, shape (N,), flags: number in the table, norm of the residual by unit, and score.

    ``residual``, shape (N, D), is measured minus predicted; ``scores``, shape (N,), are in standard deviations.
    """
    norms = {unit: channels.norms(residual, unit) for unit in channels.present}
    result = []
    for i in np.flatnonzero(flagged).tolist():
        by_unit = {unit: float(norm[i]) for unit, norm in norms.items() if np.isfinite(norm[i])}
        result.append(Outlier(measurements.rows[i], by_unit, float(scores[i])))
    return tuple(result)


def _noise(measurements: Measurements, fitted: Fitted) -> Noise:
    """Return the noise as a fit estimated it, as the table or else the cell states it, and the scatter of repeats.

    The scatter is None if no two rows with weight repeat a pose.
    """
    estimate = fitted.estimate
    rows = estimate.problem.rows

    # As the table states it for fitted rows, rms, else as the cell does.
    stated = dict(fitted.task.cell.sigma)
    for unit, by_row in measurements.stated_sigma.items():
        of_fitted = by_row[measurements.estimation & np.isfinite(by_row)]
        if len(of_fitted):  # the second row of a pair states none
            stated[unit] = rms(of_fitted)
        else:
            stated.pop(unit, None)

    repeats = None
    # Along a path rows where the arm was slow look like repeats, and are neighbours with much the same error.
    if not along_path(rows.joints) and len(np.unique(rows.poses)) < len(rows):
        # The scalars' worth of information that the parameters have taken.
        paid = float(np.sum(estimate.problem.weights @ rows.used)) - estimate.freedom
        residual = fitted.residual(rows)
        scatter = scatter_of_repeats(
            residual, rows.channels, rows.poses, estimate.weights, fitted=max(paid, 0.0)
        )
        # None if only rows without weight repeat a pose.
        repeats = scatter if scatter.freedom > 0 else None

    return Noise(
        sigma=estimate.sigma,
        sigma_given={unit: stated[unit] for unit in RESIDUAL_UNITS if unit in stated},
        freedom=estimate.freedom,
        repeats=repeats,
        pose_noise=estimate.pose_noise,
    )
