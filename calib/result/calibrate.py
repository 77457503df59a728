"""calibrate: a robot and measurements in, a result out.

The order of the work: which model the data support, registration of targets and measurement frames, estimation, rank
and uncertainty, errors on rows that the fit did not see, the verdict.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.blas import one_blas_thread
from calib.data.cell import AUTO, Cell
from calib.data.measurements import Measurements
from calib.diagnosis.coverage import outside
from calib.diagnosis.reasons import NO, Reason, Verdict
from calib.diagnosis.usual_mistakes import check_positions, find_usual_mistake
from calib.diagnosis.verdict import verdict
from calib.estimate.extrapolation import extrapolation
from calib.estimate.fitting import Fitted, Task, fit
from calib.jobs import Progress
from calib.model.error_model import OWN, split_name
from calib.model.kinematics import Samples
from calib.model.observability import Observability
from calib.model.parameters import Parameter
from calib.numerics.errors import CrossValidation, rms
from calib.numerics.repeats import Repeats, scatter_of_repeats
from calib.numerics.scores import Limits
from calib.numerics.solvers import Solver
from calib.registration.joint_loads import joint_loads
from calib.registration.known_distances import known_distances
from calib.registration.registration import nominal_setup, register_held_out
from calib.registration.rows import Rows
from calib.registration.setup import Setup
from calib.registration.table_rows import rows_and_setup
from calib.result.calibration import CalibrationValues, Fit, RowNames, Source
from calib.result.doubts import doubts_of
from calib.result.evidence import evidence_of
from calib.result.prediction import (
    NonGeometric,
    Outlier,
    Solved,
    base_motion,
    parameter_estimates,
    tells_place,
)
from calib.result.robustness import compare_weights
from calib.robot.gravity import gravity_loads
from calib.robot.ranges import spread_poses
from calib.robot.robot import Robot, read_only
from calib.selection.candidates import Candidate, alternative_models, mark_chosen
from calib.selection.cross_validation import cross_validation, nominal_cross_validation
from calib.selection.ladder import check_parameter_names
from calib.selection.reference_fit import fit_with_all_families, with_better_weights
from calib.selection.selection import select
from calib.units import Array, Mask

#: A smaller share of outliers is not worth the time that a non-geometric model takes.
_FEW = 0.01

#: Of more rows a part this large is fitted first to confirm the outliers: a non-geometric model costs as much as
#: all else.
_MANY = 300


@one_blas_thread()
def calibrate(
    robot: Robot,
    measurements: Measurements,
    *,
    cell: Cell | None = None,
    model: str | Sequence[Parameter] | None = None,
    solver: str | Solver = "lm",
    robust: bool = True,
    validate: bool = True,
    progress: Progress | None = None,
) -> CalibrationValues:
    """Calibrate a robot from measurements of a target on its tip.

    Args:
        robot: The nominal robot.
        measurements: Rows of the set ``estimate`` are fitted, those of ``validate`` only predicted.
        cell: What is known of targets, frames, noise and priors; default: the measurements are in the base frame, the
            target is estimated. Measurements in a tracker's own frame: ``Cell(estimate_frame=True)``.
        model: Name of the parameter set, with families behind it: ``"auto"`` (the data choose), ``"dh"``, ``"paper"``,
            ``"hayati"``, ``"placement"``, ``"zeros"`` or ``"frames"``, such as ``"dh+compliance"``; default the
            cell's. See docs/parameters.md. Or the robot's parameters themselves, each a twist at a placement.
        solver: ``"lm"`` (default), ``"scipy"`` (the same problem by SciPy), or ``"paper"`` (the paper's algorithm,
            without priors and robust weights); or a function like those of `calib.numerics.solvers.SOLVERS`.
        robust: Whether outliers lose their weight; they are named either way.
        validate: Whether to cross-validate; one fold a row up to 60 rows, ten folds above.
        progress: Called after each fit of the cross-validation.

    Raises:
        ModelError: An unknown parameter set, parameter or solver, or measurements that the model does not cover.
        MeasurementError: Too few rows, or columns that the robot needs are missing.
        SolverError: No finite result.
    """
    cell, measurements = Cell() if cell is None else cell, measurements.without_copies()
    cell = replace(cell, model=model) if isinstance(model, str) else cell
    fits = fit_table(robot, measurements, cell, model=model, solver=solver, robust=robust)
    if validate and not fits.hint:
        return _validated(measurements, fits, progress)
    result = _assembled(measurements, fits)
    return replace(result, verdict=Verdict(NO, (fits.hint,))) if fits.hint else result


@dataclass(frozen=True, slots=True, eq=False)
class Fits:
    """What `calibrate` makes its result of."""

    fitted: Fitted  #: Of the geometry
    non_geometric: Fitted | None  #: Of the non-geometric model
    candidates: tuple[Candidate, ...]  #: The ladder they were chosen from
    every: Rows  #: All rows of the table
    rows: Rows  #: Those that were fitted
    unseen: Setup  #: Unknown are the frames and targets that only the other rows see
    hint: Reason | None  #: A set-up that would explain the measurements far better
    seconds: float


@one_blas_thread()
def fit_table(
    robot: Robot,
    measurements: Measurements,
    cell: Cell,
    *,
    model: str | Sequence[Parameter] | None = None,
    solver: str | Solver = "lm",
    robust: bool = True,
) -> Fits:
    """The fits alone, without what a result says of them; arguments and errors are those of `calibrate`."""
    every, setup = rows_and_setup(robot, measurements, cell)
    rows, others = (every.select(m) for m in (measurements.estimation, measurements.validation))
    check_positions(robot, rows, measurements.source)
    frames, targets = setup.seen_by(rows.samples)
    unseen = setup.with_fixed(frames, targets)
    began = time.perf_counter()
    model = cell.model if model is None else model
    hint = find_usual_mistake(robot, cell, measurements.select(measurements.estimation))
    told, distances = setup.with_fixed(~frames, ~targets), known_distances(cell, setup)
    task = Task(robot, cell, told, model, distances, solver, robust)
    if hint and model == AUTO:  # nothing that is told of such a fit means anything
        check_parameter_names(task)
        task = replace(task, model="zeros", lenient=True)
    fitted, non_geometric, candidates = _fitted(task, rows)
    if isinstance(model, str) and not (hint or non_geometric or candidates):
        fitted = _judged(fitted, measurements)
    fitted = fitted.with_unseen(unseen, others)
    non_geometric = non_geometric and non_geometric.with_unseen(unseen, others)
    rows = replace(rows, sole=fitted.estimate.problem.rows.sole)
    seconds = time.perf_counter() - began
    return Fits(fitted, non_geometric, candidates, every, rows, unseen, hint, seconds)


def _fitted(task: Task, rows: Rows) -> tuple[Fitted, Fitted | None, tuple[Candidate, ...]]:
    """The fit of the geometry, that of the non-geometric model if there is one, and the candidates."""
    if task.model == AUTO and task.solver == "paper":
        return fit(replace(task, model="dh", lenient=True), rows), None, ()
    if task.model == AUTO:
        chosen = select(task, rows)
        base, candidates, judge = chosen.geometry, chosen.candidates, chosen.reference
    else:
        base = split_name(task.model)[0] if isinstance(task.model, str) else OWN
        candidates, judge = (), fit(task, rows)
    if base == judge.kinematics.model.name:
        return judge, None, candidates
    rows = replace(rows, sole=judge.estimate.problem.rows.sole)
    own = fit(replace(task, model=base, lenient=True), rows, started=judge.setup)
    return with_better_weights(own, rows, judge), judge, candidates


def _judged(fitted: Fitted, m: Measurements) -> Fitted:
    """A named geometry's fit; where it has outliers, judged by a non-geometric model, which needs the joints' loads."""
    task, flagged = fitted.task, fitted.estimate.outliers
    if task.solver == "paper" or task.cell.priors.source == "off" or np.mean(flagged) < _FEW:
        return fitted
    m, rows = m.select(m.estimation), fitted.estimate.problem.rows
    if len(rows) > _MANY and _outliers_of_few(fitted, m):
        return fitted
    rows = _loaded(fitted, m, np.ones(len(rows), dtype=bool))
    judge = fit_with_all_families(fitted, rows)
    none_is_good = np.all(judge.estimate.outliers[flagged])
    return fitted if none_is_good else with_better_weights(fitted, rows, judge)


def _outliers_of_few(fitted: Fitted, m: Measurements) -> bool:
    """Confirm that a non-geometric model fitted to a part of the rows calls every outlier one too."""
    rows, flagged = fitted.estimate.problem.rows, fitted.estimate.outliers
    judge = fit_with_all_families(fitted, _loaded(fitted, m, rows.evenly(_MANY)))
    chosen = rows.with_partners(flagged)
    scores = judge.unseen_scores(_loaded(fitted, m, chosen))[flagged[chosen]]
    limit = Limits.of(len(rows), judge.estimate.freedom).flagged
    return bool(np.all(scores > limit))


def _loaded(fitted: Fitted, m: Measurements, chosen: Mask) -> Rows:
    """Some rows of a fit, of its measurements ``m``, with what loads the joints there."""
    task, rows = fitted.task, fitted.estimate.problem.rows.select(chosen)
    load = joint_loads(task.robot, m.select(chosen), task.cell, rows.joints)
    return replace(rows, samples=replace(rows.samples, load=load))


def _validated(m: Measurements, fits: Fits, progress: Progress | None) -> CalibrationValues:
    """The result with cross-validation, of the non-geometric model too, and the verdict."""
    task, rows, hint = fits.fitted.task, fits.rows, fits.hint
    outliers = fits.fitted.estimate.outliers

    def validated(fitted: Fitted, part: int) -> CrossValidation:
        parts = max(part + 1, 1 if fits.non_geometric is None else 2)

        def told(done: int, every: int) -> None:
            if progress is not None:
                progress(part * every + done, parts * every)

        return cross_validation(fitted, outliers, told)

    of_calibrated = validated(fits.fitted, 0)
    fits, of_non_geometric = _confirmed(m, fits, of_calibrated, validated)
    result = _assembled(m, fits)
    non_geometric = result.non_geometric and replace(
        result.non_geometric, cross_validation=of_non_geometric
    )
    result = replace(
        result,
        cross_validation=of_calibrated,
        nominal_cross_validation=nominal_cross_validation(task, rows, outliers),
        non_geometric=non_geometric,
    )
    doubts = doubts_of(result, rows)
    if non_geometric is not None:
        judged = verdict(evidence_of(result, non_geometric, rows, doubts, hint))
        result = replace(result, non_geometric=replace(non_geometric, verdict=judged))
    return replace(result, verdict=verdict(evidence_of(result, result, rows, doubts, hint)))


def _confirmed(
    m: Measurements,
    fits: Fits,
    of_geometry: CrossValidation,
    validated: Callable[[Fitted, int], CrossValidation],
) -> tuple[Fits, CrossValidation | None]:
    """The fits with the non-geometric model that refits confirm, and its cross-validation; None where none is.

    The one that was chosen passed the cross-validation of the linearised problem. Refitted without each fold it has to
    leave smaller squares than the geometry; else the next by evidence is tried. One that was given by name stays.

    Args:
        m: All rows.
        fits: With the model that was chosen.
        of_geometry: Cross-validation of the geometry.
        validated: Gives that of a fit, with the number of cross-validations before it.
    """
    if fits.non_geometric is None:
        return fits, None
    if not fits.candidates:
        return fits, validated(fits.non_geometric, 1)
    estimate = fits.fitted.estimate

    def squares(validation: CrossValidation) -> float:
        whitened = validation.residual / estimate.problem.scales
        return float(np.sum(whitened[~estimate.outliers] ** 2))

    for part, fitted in enumerate(_contenders(m, fits, fits.non_geometric), start=1):
        found = validated(fitted, part)
        if squares(found) < squares(of_geometry):
            return _with_non_geometric(fits, fitted), found
    return _with_non_geometric(fits, None), None


def _contenders(m: Measurements, fits: Fits, chosen: Fitted) -> Iterator[Fitted]:
    """The non-geometric model that was chosen, then the alternatives, each fitted when it is its turn."""
    yield chosen
    others = fits.every.select(m.validation)
    for name in alternative_models(fits.candidates):
        fitted = fit(replace(chosen.task, model=name), fits.rows)
        yield fitted.with_unseen(fits.unseen, others)


def _with_non_geometric(fits: Fits, non_geometric: Fitted | None) -> Fits:
    """The fits with another non-geometric model, or none; the candidates say so."""
    geometry, name = (
        str(fits.fitted.task.model),
        "" if non_geometric is None else str(non_geometric.task.model),
    )
    return replace(
        fits, non_geometric=non_geometric, candidates=mark_chosen(fits.candidates, geometry, name)
    )


def _solved(fitted: Fitted) -> tuple[dict[str, Any], Observability]:
    """The attributes of `calib.result.prediction.Solved`, the cross-validation aside, and what the rows determine."""
    estimated, rows = fitted.estimate, fitted.estimate.problem.rows
    observability = estimated.problem.observability(estimated.x)
    placed = tells_place(kind.name for kind in rows.present)
    motion = None if placed else base_motion(fitted.kinematics, estimated.x, rows.samples)
    task, samples = fitted.task, rows.samples
    q = spread_poses(task.robot)
    load = None
    if any(term.factor and term.factor.loaded for term in fitted.kinematics.model.terms):
        load = gravity_loads(task.robot, q, task.cell.payload, task.cell.gravity)
    solved: dict[str, Any] = {
        "kinematics": fitted.kinematics,
        "x": estimated.x,
        "covariance": estimated.covariance,
        "prior_std": estimated.prior_std,
        "parameters": parameter_estimates(fitted, observability),
        "setup": fitted.placed(),
        "base_motion": motion,
        "cross_validation": None,
    }
    solved["extrapolation"] = extrapolation(fitted)
    zero = Solved(**solved, expected_measured=0.0, expected_everywhere=0.0)
    solved["expected_measured"] = zero.expected_error(samples)
    solved["expected_everywhere"] = zero.expected_error(Samples.at(q, load))
    return solved, observability


def _assembled(m: Measurements, fits: Fits) -> CalibrationValues:
    """Everything that the fits say, as one value; cross-validation and verdict are still to come."""
    fitted, every, non_geometric = fits.fitted, fits.every, None
    task, estimated, problem = fitted.task, fitted.estimate, fitted.estimate.problem
    robot, cell, mask = task.robot, task.cell, m.estimation
    if fits.non_geometric is not None:
        non_geometric = NonGeometric(
            **_solved(fits.non_geometric)[0],
            residual=read_only(fits.non_geometric.residual(every)),
            payload=cell.payload,
            gravity=cell.gravity,
        )
    T_base_tip, joints = robot.poses(every.joints), every.joints
    placed = nominal_setup(T_base_tip[mask], task.setup, every.select(mask))
    unseen = fits.unseen.with_given_fixed()
    placed = register_held_out(T_base_tip[~mask], placed, unseen, every.select(~mask))
    residual = fitted.residual(every)
    scores, weights = np.empty(len(mask)), np.zeros(len(mask))
    weights[mask], scores[mask] = estimated.weights, estimated.scores
    scores[~mask] = fitted.unseen_scores(every.select(~mask))
    measured = np.any(every.used[:, :3], axis=1)
    lengths = np.where(measured, np.linalg.norm(residual[:, :3], axis=1), np.nan)

    def named(chosen: NDArray[np.bool_], beyond: float) -> tuple[Outlier, ...]:
        return tuple(
            Outlier(m.rows[i], float(lengths[i]), float(scores[i]))
            for i in np.flatnonzero(chosen & (scores > beyond))
        )

    # Each set has a limit of its own, because each has its own number of chances for a false alarm.
    limit, suspect = estimated.flag_limit, Limits.of(np.sum(~mask), estimated.freedom).flagged
    scales = np.where(problem.rows.used, problem.scales, np.nan)
    inside = joints[weights > 0.0]
    ranges = inside.min(axis=0, initial=np.inf), inside.max(axis=0, initial=-np.inf)
    types = [joint.type for joint in robot.inputs]
    solved, observability = _solved(fitted)
    no_poses, no_rows = np.zeros(0, dtype=int), read_only(np.zeros(0))
    lowered = np.any(estimated.outliers) and task.solver != "paper"
    return CalibrationValues(
        **solved,
        nominal=robot,
        robot=fitted.kinematics.model.apply(robot, estimated.x),
        source=Source(m.source, m.sha256),
        rows=RowNames(m.rows, m.sets, m.kinds, m.groups, m.targets),
        frame_estimated=cell.estimate_frame,
        frozen=cell.frozen,
        ties=cell.ties,
        prior_std_from=cell.priors.source,
        nominal_setup=placed,
        solver=task.solver if isinstance(task.solver, str) else task.solver.__name__,
        solution=estimated.solution,
        seconds=fits.seconds,
        freedom=estimated.freedom,
        sigma=_median(scales[:, :3]),
        sigma_angle=_median(scales[:, 3:]),
        sigma_given=_stated(m.sigma, cell.sigma, mask),
        sigma_angle_given=_stated(m.sigma_angle, cell.sigma_angle, mask),
        residual_nominal=read_only(every.residual(placed.target_poses(T_base_tip, every.samples))),
        residual_calibrated=read_only(residual),
        used=every.used,
        scores=read_only(scores),
        weights=read_only(weights),
        ranges=read_only(np.stack(ranges, axis=1)),
        flag_limit=limit,
        outliers=named(mask, limit),
        suspects=named(~mask, float(suspect)),
        robustness=compare_weights(fitted) if lowered else None,
        repeats=_repeats(fitted),
        outside=outside(joints[mask], joints[~mask], robot.joint_names, types),
        nominal_cross_validation=None,
        observability=observability,
        # With their errors, but without those of each row.
        candidates=tuple(
            replace(
                one,
                cross_validation=replace(one.cross_validation, poses=no_poses, residual=no_rows),
            )
            for one in fits.candidates
        ),
        non_geometric=non_geometric,
        verdict=None,
        fit=Fit(m, cell, fitted, fits.non_geometric),
    )


def _median(values: Array) -> float:
    """The median of what is no NaN; NaN of nothing."""
    there = values[~np.isnan(values)]
    return float(np.median(there)) if there.size else float("nan")


def _stated(by_row: Array | None, by_cell: float | None, fitted: NDArray[np.bool_]) -> float:
    """The noise of fitted rows as their table states it, rms, else as the cell does; NaN where neither does."""
    if by_row is None:
        return float("nan") if by_cell is None else by_cell
    stated = by_row[fitted & np.isfinite(by_row)]  # the second row of a pair states none
    return rms(stated) if len(stated) else float("nan")


def _repeats(fitted: Fitted) -> Repeats | None:
    """Scatter of rows that repeat a pose, in SI units; None where none does."""
    estimated = fitted.estimate
    rows = estimated.problem.rows
    if len(np.unique(rows.poses)) == len(rows):
        return None
    paid = float(np.sum(estimated.problem.weights @ rows.used)) - estimated.freedom
    found = scatter_of_repeats(
        fitted.residual(rows), rows.used, rows.poses, estimated.weights, fitted=max(paid, 0.0)
    )
    return found if found.freedom > 0 else None
