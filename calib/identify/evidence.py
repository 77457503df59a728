"""What the verdict looks at besides errors: accidents, joints that stood still, patterns, set-ups that do not agree."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib.identify.coverage import coverage, outside_sentence
from calib.identify.crossvalidation import only_there
from calib.identify.fitting import Fitted, fit
from calib.identify.nominal import ENOUGH
from calib.identify.patterns import drift, joint_patterns
from calib.identify.problem import Problem
from calib.identify.result import Calibration
from calib.identify.robust import pose_means
from calib.identify.rows import Rows, evenly
from calib.identify.setup import joined_setups
from calib.identify.statistics import Errors, Mask
from calib.identify.unpredicted import prediction_square, unpredicted_setup
from calib.identify.verdict import Evidence
from calib.model.error_model import error_model
from calib.model.kinematics import Kinematics
from calib.model.parameters import FRAME, TARGET, ErrorModel
from calib.model.readback import column_ranges, spread_poses
from calib.model.robot import Robot

Array = NDArray[np.float64]

#: A joint that moves less than this over the rows tells little of itself [rad, m].
_STILL_RAD, _STILL_M = 0.35, 0.05

#: A share of validation rows up to which those that do not fit are set aside as accidents.
_FEW_SUSPECTS = 0.15

#: A model that leaves this share of the noise explains what the other one lacks.
_FAR_LESS = 0.6

#: Noise below this is rounding, in which any test finds patterns [m, rad].
_ROUNDING_NOISE = 1e-6

#: Flagged rows of a set-up, in number and as a share, that show that the set-up and not the rows are off.
_SOME_FLAGGED, _SHARE_FLAGGED = 4, 0.25

#: Repeats that scatter by less than this share of what the model leaves over show that the model lacks something.
_SCATTER_SHARE = 0.5

#: A direction that moves the scalars by this many standard deviations, all together, was fitted.
_FITTED = 1.0

#: Degrees of freedom below which neither scatter nor patterns are told.
_TELLING = 10.0


def evidence_of(result: Calibration, rows: Rows, hint: str) -> Evidence:
    """All that the verdict is based on.

    Args:
        result: The calibration, cross-validated.
        rows: The rows that were fitted.
        hint: What would explain the measurements better, a sentence; or nothing.
    """
    fitted, m = result.fitted, result.measurements
    assert result.cross_validation is not None
    assert result.nominal_cross_validation is not None
    suspects = {o.row for o in result.suspects}
    before, after, aside = validation_errors(
        m.validation,
        np.array([row in suspects for row in m.rows]),
        result.residual_nominal,
        result.residual_calibrated,
        result.used,
    )
    larger, few = result.larger, thin(fitted)
    return Evidence(
        nominal=result.nominal_cross_validation,
        calibrated=result.cross_validation,
        larger_validation=None if larger is None else larger.cross_validation,
        larger_name="" if larger is None else larger.name,
        scales=fitted.estimate.problem.scales,
        used=rows.used,
        repeats=rows.poses,
        pairs=rows.partner >= 0,
        outliers=fitted.estimate.outliers,
        validation_nominal=before,
        validation_calibrated=after,
        validation_aside=aside,
        still=still_joints(fitted.task.robot, rows.joints),
        missing=""
        if result.candidates or result.solver == "paper"
        else missing_model(few, few.estimate.problem.rows),
        findings=(
            *patterns(few),
            *disagreeing_setups(few),
            *_outliers_of_one_setup(fitted),
            *_scatter(result),
            *_no_scale(fitted),
        ),
        corner=_corner(few, few.estimate.problem.rows),
        outside=_outside(result),
        parameters=len(result.model),
        largest=largest_change(result.model, result.x),
        noise=result.sigma,
        hint=hint,
    )


def thin(fitted: Fitted, most: int = ENOUGH) -> Fitted:
    """The fit with about so many of its rows, spread evenly over each frame and target; itself if it has no more.

    What is left over is searched for patterns with all derivatives at hand; twenty thousand rows show any that matters.

    Args:
        fitted: The fit.
        most: How many rows.
    """
    problem, estimate = fitted.estimate.problem, fitted.estimate
    if len(problem.rows) <= most:
        return fitted
    some = np.flatnonzero(evenly(problem.rows, most))
    rows = problem.rows.select(np.isin(np.arange(len(problem.rows)), some))
    few = replace(
        Problem.first(problem.kinematics, rows, problem.distances),
        weights=problem.weights[some],
        scales=problem.scales[some][:, : rows.width],
        precision=problem.precision,
        centre=problem.centre,
    )
    return replace(
        fitted,
        estimate=replace(
            estimate,
            problem=few,
            scores=estimate.scores[some],
            weights=estimate.weights[some],
        ),
    )


def validation_errors(
    validation: Mask, suspects: Mask, nominal: Array, calibrated: Array, used: Mask
) -> tuple[Errors, Errors, int]:
    """Errors on the validation rows, before and after, without suspects if they are few, and how many those are.

    One wild row would decide the comparison; many of them are no accidents but a robot that is not met.

    Args:
        validation: shape (N,), which rows validate.
        suspects: shape (N,), which of them the calibrated robot does not explain.
        nominal: shape (N, D), residual of the nominal robot [m], [rad].
        calibrated: shape (N, D), of the calibrated one.
        used: shape (N, D), which scalars were measured.
    """
    few = np.sum(suspects) <= max(1, int(_FEW_SUSPECTS * np.sum(validation)))
    aside = (
        suspects & validation if few and np.any(validation & ~suspects) else np.zeros_like(suspects)
    )
    chosen = validation & ~aside
    return (
        Errors.of(nominal[chosen], used[chosen]),
        Errors.of(calibrated[chosen], used[chosen]),
        int(np.sum(aside)),
    )


def still_joints(robot: Robot, joints: Array) -> tuple[str, ...]:
    """Joints that the rows hardly move, each with how far, in words.

    Args:
        robot: The robot.
        joints: shape (N, m), [rad] or [m].
    """
    words = []
    for joint, span in zip(robot.inputs, np.ptp(joints, axis=0), strict=True):
        slides = joint.type == "prismatic"
        if span < (_STILL_M if slides else _STILL_RAD):
            amount = f"{1e3 * span:.0f} mm" if slides else f"{np.degrees(span):.0f} deg"
            words.append(f"'{joint.name}' ({amount})")
    return tuple(words)


def largest_change(model: ErrorModel, x: Array) -> float:
    """The largest change of a length or angle of the robot itself, target and frame aside [m or rad]."""
    own = ~model.family(FRAME, TARGET) & np.isin(model.units, ("m", "rad"))
    return float(np.max(np.abs(x[own]), initial=0.0))


def missing_model(fitted: Fitted, rows: Rows) -> str:
    """What the full placements would leave over, a sentence, if it is far less than this fit leaves; else nothing.

    Args:
        fitted: The fit.
        rows: The rows of the fit.
    """
    task = fitted.task
    columns = 6 * len(task.robot.joints) + task.setup.count
    if task.model.startswith("placement") or rows.count < 2 * columns:
        return ""
    full = replace(
        task,
        model="placement",
        cell=replace(task.cell, frozen=(), ties={}, bounds={}, parameter_priors={}),
        solver="lm",
    )
    other = fit(full, rows, started=fitted.setup).estimate
    noise, less = fitted.estimate.noise[0], other.noise[0]
    if less > _FAR_LESS * noise:
        return ""
    unit = 1e3 * float(np.median(rows.sigma))
    return (
        f"The model '{task.model}' leaves {unit * noise:.3f} mm a coordinate, all placements would leave "
        f"{unit * less:.3f} mm: the robot has errors that this model lacks. Try --model auto or --model placement."
    )


def patterns(fitted: Fitted) -> tuple[str, ...]:
    """Sentences on residuals that are not noise: that follow a joint's value, or the order of the rows."""
    estimate = fitted.estimate
    problem, rows = estimate.problem, estimate.problem.rows
    quiet = float(np.median(problem.scales[rows.used]))
    if estimate.freedom < _TELLING or quiet < _ROUNDING_NOISE:
        return ()
    residual, jacobian = problem.residual_and_jacobian(estimate.x)
    own = Kinematics(
        fitted.task.robot,
        error_model(
            fitted.task.robot,
            "zeros",
            frame=dict.fromkeys(fitted.setup.frame_unknowns, ()),
            target=(),
            targets=fitted.setup.target_names,
        ),
        fitted.placed().T_frame_base,
        fitted.placed().T_tip_target,
    )
    turned = rows.derivative(*own.twists(np.zeros(len(own.model)), rows.samples))
    counts = rows.used & (estimate.weights > 0.0)[:, None]
    whiten = np.sqrt(estimate.weights)[:, None] / problem.scales
    row_of, component_of = np.nonzero(counts)
    A = _fitted_range((jacobian * whiten[:, :, None])[counts], problem.precision)
    r = (residual * whiten)[counts]
    scale = whiten[counts]
    by_name = dict(zip(own.model.names, range(len(own.model)), strict=True))
    inputs = fitted.task.robot.inputs
    names = [joint.name for joint in inputs if f"{joint.name}.zero" in by_name]
    columns = [rows.samples.q[:, i] for i, j in enumerate(inputs) if j.name in names]
    moved = (turned * whiten[:, :, None])[counts]
    found = joint_patterns(
        A,
        r,
        row_of,
        component_of,
        np.column_stack(columns) if columns else np.zeros((len(rows), 0)),
        names,
        [joint.type == "prismatic" for joint in inputs if joint.name in names],
        directions=[moved[:, [by_name[f"{name}.zero"]]] for name in names],
        poses=rows.poses,
        scale=scale,
    )
    drifts = drift(
        A, r, row_of, component_of, np.linspace(0.0, 1.0, len(rows)), poses=rows.poses, scale=scale
    )
    sentences = [one.sentence() for one in found[:1]]
    return (*sentences, *([] if drifts is None else [drifts.sentence()]))


def _fitted_range(A: Array, precision: Array) -> Array:
    """An orthonormal basis of what the parameters did to the scalars, shape (M, rank).

    Directions in which an error of the size expected moves all scalars together by less than their noise were not
    fitted, and they must not count as if they were: where the data tell no scale and no turn of the base, such a
    direction is the residual itself, made larger or turned.

    Args:
        A: shape (M, p), whitened.
        precision: shape (p,), 1 / tau^2 of each parameter.
    """
    moved = A / np.sqrt(np.maximum(precision, np.finfo(float).tiny))
    basis, effects, _ = np.linalg.svd(moved, full_matrices=False)
    return np.asarray(basis[:, effects > _FITTED])


def disagreeing_setups(fitted: Fitted) -> tuple[str, ...]:
    """Sentences on set-ups that a fit to the others does not predict."""
    estimate = fitted.estimate
    problem, rows = estimate.problem, estimate.problem.rows
    labels = joined_setups(rows, fitted.task.distances)
    count = int(labels.max()) + 1
    if count < 2 or estimate.freedom < _TELLING:
        return ()
    linear = problem.linear(estimate.x)
    known = linear.known(problem.precision, problem.centre)
    noise = linear.noise_of(estimate.noise)
    counts = np.any(linear.used, axis=1) & (estimate.weights > 0.0)
    names, squares, freedoms, variances, left = [], [], [], [], []
    for g in range(count):
        own = labels == g
        weights = np.where(own, 0.0, problem.weights)
        data = linear.data(weights)
        x, covariance = data.posterior(estimate.noise, known)
        loose = only_there(fitted.kinematics.model, fitted.setup, rows, own)
        x = np.where(loose, estimate.x, x)
        paid = float(np.sum(np.einsum("cij,ji->c", data.H, covariance) / np.square(estimate.noise)))
        freedom = float(np.sum(data.count)) - paid
        rest = np.where(linear.used, linear.residual(x) / noise, 0.0)
        # Repeats count for one measurement where they share what the model lacks.
        chosen = own & counts
        at, alike = problem.weights[chosen], rows.poses[chosen]
        r, first = pose_means(rest[chosen], at, alike)
        A, _ = pose_means((linear.A / noise[:, :, None])[chosen], at, alike)
        there = linear.used[chosen][first]
        A = A[there]
        square, degrees = prediction_square(
            r[there], A[:, ~loose], covariance[np.ix_(~loose, ~loose)], A[:, loose]
        )
        groups = dict.fromkeys(fitted.setup.groups[f] for f in rows.samples.frame[own])
        names.append(" and ".join(groups))
        squares.append(square)
        freedoms.append(degrees)
        variances.append(float(weights @ np.sum(rest**2, axis=1)) / max(freedom, 1.0))
        left.append(max(freedom, 0.0))
    found = unpredicted_setup(
        names, np.array(squares), np.array(freedoms), np.array(variances), np.array(left)
    )
    return tuple(one.sentence() for one in found[:2])


def _outliers_of_one_setup(fitted: Fitted) -> tuple[str, ...]:
    """A sentence on a set-up whose rows are flagged far more often than the others': it has moved, they have not."""
    rows, flagged = fitted.estimate.problem.rows, fitted.estimate.outliers
    labels = joined_setups(rows, fitted.task.distances)
    for g in np.unique(labels) if len(np.unique(labels)) > 1 else ():
        own = labels == g
        inside, outside = float(np.mean(flagged[own])), float(np.mean(flagged[~own]))
        if np.sum(flagged[own]) >= _SOME_FLAGGED and inside > max(_SHARE_FLAGGED, 3.0 * outside):
            groups = dict.fromkeys(fitted.setup.groups[f] for f in rows.samples.frame[own])
            return (
                f"{int(np.sum(flagged[own]))} of the {int(np.sum(own))} rows of set-up '{' and '.join(groups)}' are "
                "flagged as outliers: it does not agree with the others. Did the arm, its tool or the instrument "
                "change in between?",
            )
    return ()


def _no_scale(fitted: Fitted) -> tuple[str, ...]:
    """A sentence where nothing that was measured is a length."""
    if fitted.task.distances or any(kind.size for kind in fitted.estimate.problem.rows.present):
        return ()
    return (
        "Nothing that was measured is a length, so the size of the arm is the nominal one's, and the priors decide: "
        "measure a distance between two sockets, and give it in the cell file ([[distances]]).",
    )


def _scatter(result: Calibration) -> tuple[str, ...]:
    """A sentence on repeats that agree far better with each other than with the model."""
    repeats = result.repeats
    if repeats is None or not len(repeats.within) or repeats.freedoms[0] < _TELLING:
        return ()
    within = float(repeats.within[0])
    if not within < _SCATTER_SHARE * result.sigma or result.sigma < _ROUNDING_NOISE:
        return ()
    return (
        f"Repeats of a pose scatter by {1e3 * within:.3f} mm a coordinate, the model leaves "
        f"{1e3 * result.sigma:.3f} mm: "
        "what is left over is not the instrument's noise but errors that the model lacks.",
    )


def _corner(fitted: Fitted, rows: Rows) -> str:
    """A sentence if the poses cover a corner of the workspace only."""
    robot = fitted.task.robot
    kept = rows.joints[fitted.estimate.weights > 0.0]
    return coverage(
        robot.poses(kept)[:, :3, 3],
        robot.poses(spread_poses(robot))[:, :3, 3],
        kept,
        column_ranges(robot),
        robot.joint_names,
        [joint.type for joint in robot.inputs],
    ).sentence()


def _outside(result: Calibration) -> str:
    """A sentence on validation rows outside of the measured joint range."""
    m = result.measurements
    numbers = np.array([m.rows[i] for i in np.flatnonzero(m.validation)], dtype=np.int_)
    return outside_sentence(result.outside, numbers)
