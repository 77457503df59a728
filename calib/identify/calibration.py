"""calibrate: a robot and measurements in, a result out.

The order of the work: which model the data support, registration of targets and measurement frames, estimation, rank
and uncertainty, errors on rows that the fit did not see, the verdict.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.errors import ModelError
from calib.identify.crossvalidation import (
    Progress,
    cross_validation,
    nominal_cross_validation,
)
from calib.identify.evidence import evidence_of
from calib.identify.fitting import Fitted, Task, fit, unseen_scores
from calib.identify.nominal import nominal_on
from calib.identify.prediction import (
    Larger,
    Outlier,
    base_motion,
    expected_error,
    parameter_estimates,
    tells_place,
)
from calib.identify.result import Calibration, Fit, RowNames, Source
from calib.identify.robust import Limits, Repeats, repeats
from calib.identify.rows import Rows
from calib.identify.selection import Candidate, select
from calib.identify.setup import known_distances, rows_of
from calib.identify.setup_check import better_setup
from calib.identify.solvers import Solver
from calib.identify.statistics import CrossValidation
from calib.identify.support import OutsideRow, compare, outside
from calib.identify.verdict import NO, Reason, Verdict, verdict
from calib.measure.cell import AUTO, Cell
from calib.measure.measurements import Measurements
from calib.model.error_model import split_name
from calib.model.kernel import one_blas_thread
from calib.model.kinematics import Samples
from calib.model.observability import Observability, analyse
from calib.model.readback import spread_poses
from calib.model.robot import Robot, read_only

__all__ = ["Calibration", "calibrate"]

Array = NDArray[np.float64]


@one_blas_thread()
def calibrate(
    robot: Robot,
    measurements: Measurements,
    *,
    cell: Cell | None = None,
    model: str | None = None,
    solver: str | Solver = "lm",
    robust: bool = True,
    validate: bool = True,
    progress: Progress | None = None,
) -> Calibration:
    """Calibrate a robot from measurements of a target on its tip.

    Args:
        robot: The nominal robot.
        measurements: Rows of the set ``estimate`` are fitted, those of ``validate`` only predicted.
        cell: What is known of targets, frames, noise and priors; default: the measurements are in the base frame, the
            target is estimated. Measurements in a tracker's own frame: ``Cell(estimate_frame=True)``.
        model: Name of the parameter set, with families behind it: ``"auto"`` (the data choose), ``"dh"``, ``"paper"``,
            ``"hayati"``, ``"placement"``, ``"zeros"`` or ``"frames"``, such as ``"dh+compliance"``; default the
            cell's. See docs/parameters.md.
        solver: ``"lm"`` (default), ``"scipy"`` (the same problem by SciPy), or ``"paper"`` (the paper's algorithm,
            without priors and robust weights); or a function like those of `calib.identify.solvers.SOLVERS`.
        robust: Whether outliers lose their weight; they are named either way.
        validate: Whether to cross-validate; one fold a row up to 60 rows, ten folds above.
        progress: Called after each fit of the cross-validation.

    Raises:
        ModelError: An unknown parameter set, parameter or solver, or measurements that the model does not cover.
        MeasurementError: Too few rows, or columns that the robot needs are missing.
        SolverError: No finite result.
    """
    for thing, kind in ((robot, Robot), (measurements, Measurements)):
        if not isinstance(thing, kind):
            raise ModelError(
                f"calibrate takes a {kind.__name__}; {thing!r} was given. Read it with calib.Robot.load(...) or "
                "calib.Measurements.read(...)."
            )
    cell = Cell() if cell is None else cell
    cell = cell if model is None else replace(cell, model=model)
    fits = fit_table(robot, measurements, cell, solver=solver, robust=robust)
    result = _assemble(measurements, fits.fitted, fits.every, fits.seconds)
    result = replace(result, candidates=tuple(map(_without_rows, fits.candidates)))
    if fits.larger is not None:
        result = _with_larger(result, fits.larger, fits.every)
    if not validate:
        return replace(result, verdict=Verdict(NO, (fits.hint,))) if fits.hint else result
    return _validated(result, fits.rows, fits.hint, progress)


@dataclass(frozen=True, slots=True, eq=False)
class Fits:
    """What `calibrate` makes its result of.

    Attributes:
        fitted: The fit of the geometry.
        larger: That of the larger model, if there is one.
        candidates: The ladder they were chosen from; empty for a model that was named.
        every: All rows of the table.
        rows: Those that were fitted.
        hint: What set-up would explain the measurements far better, if one does.
        seconds: How long the fits took.
    """

    fitted: Fitted
    larger: Fitted | None
    candidates: tuple[Candidate, ...]
    every: Rows
    rows: Rows
    hint: Reason | None
    seconds: float


@one_blas_thread()
def fit_table(
    robot: Robot,
    measurements: Measurements,
    cell: Cell,
    *,
    solver: str | Solver = "lm",
    robust: bool = True,
) -> Fits:
    """The fits alone, without what a result says of them; arguments and errors are those of `calibrate`."""
    every, setup = rows_of(robot, measurements, cell)
    rows = every.select(measurements.estimation)
    began = time.perf_counter()
    task = Task(robot, cell, setup, cell.model, known_distances(cell, setup), solver, robust)
    fitted, larger, candidates = _fitted(task, rows)
    seconds = time.perf_counter() - began
    hint = better_setup(robot, cell, setup, rows)
    return Fits(fitted, larger, candidates, every, rows, hint, seconds)


def _fitted(task: Task, rows: Rows) -> tuple[Fitted, Fitted | None, tuple[Candidate, ...]]:
    """The fit of the geometry, that of the larger model if there is one, and the ladder they were chosen from."""
    if task.model == AUTO and task.solver == "paper":
        return fit(replace(task, model="dh", lenient=True), rows), None, ()
    if task.model == AUTO:
        chosen = select(task, rows)
        task, common = replace(task, lenient=True), chosen.common
        fitted = common
        if chosen.geometry != common.task.model:
            fitted = fit(replace(task, model=chosen.geometry), rows, started=common.setup)
        larger = None
        if chosen.larger:
            larger = fit(replace(task, model=chosen.larger), rows, started=common.setup)
        return fitted, larger, chosen.candidates
    base, families = split_name(task.model)
    fitted = fit(replace(task, model=base, lenient=bool(families)), rows)
    return fitted, fit(task, rows) if families else None, ()


def _validated(
    result: Calibration, rows: Rows, hint: Reason | None, progress: Progress | None
) -> Calibration:
    """The result with cross-validation, of the larger model too, and the verdict."""
    task, outliers = result.fitted.task, result.fitted.estimate.outliers
    larger, fit = result.larger, result.fit
    assert fit is not None

    def of_part(part: int) -> Progress | None:
        if progress is None:
            return None
        parts = 1 if larger is None else 2
        return lambda done, every: progress(part * every + done, parts * every)

    of_calibrated = cross_validation(task, rows, outliers, of_part(0), fitted=result.fitted)
    candidates = result.candidates
    if larger is not None and fit.larger is not None:
        found = cross_validation(fit.larger.task, rows, outliers, of_part(1), fitted=fit.larger)
        larger = replace(larger, cross_validation=found)
        scales = result.fitted.estimate.problem.scales
        if candidates and not _predicts_better(found, of_calibrated, scales, outliers):
            # The ladder's quick cross-validation let it pass; refitted without each fold it does not.
            candidates = tuple(
                replace(c, chosen="") if c.name == larger.name else c for c in candidates
            )
            larger, fit = None, replace(fit, larger=None)
    result = replace(
        result,
        fit=fit,
        cross_validation=of_calibrated,
        nominal_cross_validation=nominal_cross_validation(task, rows, outliers),
        larger=larger,
        candidates=candidates,
    )
    return replace(result, verdict=verdict(evidence_of(result, rows, hint)))


def _predicts_better(
    one: CrossValidation, than: CrossValidation, scales: Array, outliers: NDArray[np.bool_]
) -> bool:
    """Whether a model's errors on left-out rows are smaller, in units of the noise, outliers aside."""
    squares = [float(np.sum((v.residual / scales)[~outliers] ** 2)) for v in (one, than)]
    return squares[0] < squares[1]


def _with_larger(result: Calibration, fitted: Fitted, every: Rows) -> Calibration:
    """The result with a larger model."""
    assert result.fit is not None
    larger = Larger(
        kinematics=fitted.kinematics,
        x=fitted.estimate.x,
        covariance=fitted.estimate.covariance,
        sizes=fitted.estimate.sizes,
        parameters=parameter_estimates(fitted, _observability(fitted)),
        setup=fitted.placed(),
        residual=read_only(fitted.residual(every)),
        cross_validation=None,
        base_motion=_motion(fitted),
        payload=fitted.task.cell.payload,
        gravity=fitted.task.cell.gravity,
    )
    return replace(result, larger=larger, fit=replace(result.fit, larger=fitted))


def _observability(fitted: Fitted) -> Observability:
    """What the rows that count determine, with every scalar in units of a length."""
    estimated, model = fitted.estimate, fitted.kinematics.model
    problem = estimated.problem
    known, alive = problem.known_slopes(estimated.x), problem.weights > 0.0
    counts = problem.rows.used & alive[:, None]
    # Angles as lengths, by the ratio of the two standard deviations.
    jacobian = (problem.linear(estimated.x).A * problem.rows.scales[:, :1, None])[counts]
    seen = np.concatenate([jacobian, known])
    return analyse(seen, model.names, model.units, int(np.sum(counts)) + len(known))


def _assemble(
    measurements: Measurements, fitted: Fitted, every: Rows, seconds: float
) -> Calibration:
    """Everything that one fit says, as one value; cross-validation and verdict are still to come."""
    task, estimated = fitted.task, fitted.estimate
    robot, model = task.robot, fitted.kinematics.model
    mask, problem = measurements.estimation, estimated.problem
    observability = _observability(fitted)
    placed, residual_nominal = nominal_on(robot, task.setup, every, mask)
    residual = fitted.residual(every)
    scores, weights = np.empty(len(mask)), np.zeros(len(mask))
    weights[mask] = estimated.weights
    scores[mask] = estimated.scores
    scores[~mask] = unseen_scores(fitted, every.select(~mask))
    limit = estimated.flag_limit

    # Each set has a limit of its own, because each has its own number of chances for a false alarm.
    suspect = float(Limits.of(np.sum(~mask), estimated.freedom).flagged)
    lengths = np.where(
        np.any(every.used[:, :3], axis=1), np.linalg.norm(residual[:, :3], axis=1), np.nan
    )

    def named(chosen: NDArray[np.bool_], beyond: float) -> tuple[Outlier, ...]:
        return tuple(
            Outlier(measurements.rows[i], float(lengths[i]), float(scores[i]))
            for i in np.flatnonzero(chosen & (scores > beyond))
        )

    used, scales = problem.rows.used, problem.scales
    m = measurements
    solved = fitted.kinematics, estimated.x, estimated.covariance
    motion = _motion(fitted)
    return Calibration(
        nominal=robot,
        robot=model.apply(robot, estimated.x),
        source=Source(m.source, m.sha256),
        rows=RowNames(m.rows, m.sets, m.kinds, m.groups, m.targets),
        frame_estimated=task.cell.estimate_frame,
        frozen=task.cell.frozen,
        ties=task.cell.ties,
        sizes_from=task.cell.priors.sizes,
        nominal_setup=placed,
        setup=fitted.placed(),
        kinematics=fitted.kinematics,
        solver=task.solver if isinstance(task.solver, str) else task.solver.__name__,
        solution=replace(estimated.solution, x=estimated.x),
        seconds=seconds,
        x=estimated.x,
        covariance=estimated.covariance,
        freedom=estimated.freedom,
        sigma=_median(scales[:, :3][used[:, :3]]),
        sigma_angle=_median(scales[:, 3:][used[:, 3:]]),
        sizes=estimated.sizes,
        parameters=parameter_estimates(fitted, observability),
        residual_nominal=read_only(residual_nominal),
        residual_calibrated=read_only(residual),
        used=every.used,
        scores=read_only(scores),
        weights=read_only(weights),
        base_motion=motion,
        ranges=_ranges(every.joints[weights > 0.0]),
        flag_limit=limit,
        outliers=named(mask, limit),
        suspects=named(~mask, suspect),
        robustness=compare(fitted)
        if np.any(estimated.outliers) and task.solver != "paper"
        else None,
        repeats=_repeats(fitted),
        outside=_outside(robot, every, mask),
        expected_measured=expected_error(*solved, problem.rows.samples, motion),
        expected_everywhere=expected_error(*solved, Samples.at(spread_poses(robot)), motion),
        cross_validation=None,
        nominal_cross_validation=None,
        observability=observability,
        candidates=(),
        larger=None,
        verdict=None,
        fit=Fit(measurements, task.cell, fitted),
    )


def _without_rows(one: Candidate) -> Candidate:
    """A candidate with its errors, and without those of each row."""
    nothing = read_only(np.zeros((0, 0)))
    found = replace(one.cross_validation, poses=np.zeros(0, dtype=int), residual=nothing)
    return replace(one, cross_validation=found)


def _motion(fitted: Fitted) -> Array | None:
    """What of a fit a motion of the base makes up for; None where its rows tell where the base stands."""
    rows = fitted.estimate.problem.rows
    if tells_place(kind.name for kind in rows.present):
        return None
    return base_motion(fitted.kinematics, fitted.estimate.x, rows.samples)


def _ranges(joints: Array) -> Array:
    """The smallest and the largest value of each joint, shape (m, 2); infinite where there are no rows."""
    low, high = joints.min(axis=0, initial=np.inf), joints.max(axis=0, initial=-np.inf)
    return read_only(np.stack([low, high], axis=1))


def _median(values: Array) -> float:
    """The median, NaN of nothing."""
    return float(np.median(values)) if values.size else float("nan")


def _repeats(fitted: Fitted) -> Repeats | None:
    """Scatter of rows that repeat a pose, in SI units; None where none does."""
    estimated = fitted.estimate
    rows = estimated.problem.rows
    if len(np.unique(rows.poses)) == len(rows):
        return None
    paid = float(np.sum(estimated.problem.weights @ rows.used)) - estimated.freedom
    found = repeats(
        fitted.residual(rows), rows.used, rows.poses, estimated.weights, fitted=max(paid, 0.0)
    )
    return found if found.freedom > 0 else None


def _outside(robot: Robot, every: Rows, mask: NDArray[np.bool_]) -> tuple[OutsideRow, ...]:
    """The validation rows outside of the range of the estimation rows."""
    types = [joint.type for joint in robot.inputs]
    return outside(every.joints[mask], every.joints[~mask], robot.joint_names, types)
