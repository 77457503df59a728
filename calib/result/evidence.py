"""What the verdict looks at besides errors: accidents, joints that stood still, patterns, set-ups that do not agree."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.special import stdtr

from calib.estimate.cross_validation import only_there
from calib.estimate.fitting import PAPER, Fitted, fit
from calib.estimate.problem import Priors, Problem
from calib.estimate.registration import ENOUGH
from calib.estimate.setup import LENGTHS, Rows, joined_setups
from calib.estimate.stages import PriorTerms, Stage
from calib.estimate.statistics import Errors, pose_means, rms
from calib.model.error_model import error_model
from calib.model.kinematics import FRAME, TARGET, ErrorModel, Kinematics
from calib.result.calibration import Calibration
from calib.result.patterns import (
    FALSE_ALARM,
    Stack,
    drift,
    joint_patterns,
    prediction_square,
    step,
    unpredicted,
)
from calib.result.prediction import Larger, Solved, without_rigid_motion
from calib.result.support import shares_of_ranges, spread_of
from calib.result.verdict import Evidence, Reason, Why
from calib.robot.readback import column_ranges, spread_poses
from calib.units import Array, Integers, Mask

#: A joint that moves less than this over the rows tells little of itself [rad, m].
_STILL_RAD, _STILL_M = 0.35, 0.05

#: Tips that spread less than this share of what the joints allow are a corner. Random poses reach 0.8 to 1.2, the
#: paper's 0.43, a 20 cm cube of a UR3's workspace 0.28.
_CORNER = 1.0 / 3.0

#: A share of validation rows up to which those that do not fit are set aside as accidents; flagged rows of a set-up, in
#: number and as a share, that show that the set-up and not the rows are off.
_FEW_SUSPECTS, _SOME_FLAGGED, _SHARE_FLAGGED = 0.15, 4, 0.25

#: The model lacks something where a larger one leaves this share of the noise, or repeats scatter by this share of it.
_FAR_LESS, _SCATTER_SHARE = 0.6, 0.5

#: Noise below this is rounding, in which any test finds patterns [m, rad]; a direction that moves the scalars by so
#: many standard deviations was fitted; with fewer degrees of freedom neither scatter nor patterns are told.
_ROUNDING_NOISE, _FITTED, _TELLING = 1e-6, 1.0, 10.0

#: Noise so many times as large as stated is not the instrument's; without a statement, none beyond the second [m]. And
#: what arms add to the one stated, for they do not repeat better [m, rad].
_ABOVE, _LARGE_NOISE = 5.0, 1e-3
_STEADY = ("sigma", "m", 3e-5), ("sigma_angle", "rad", 1e-4)

#: No arm is longer or shorter by more than this share, in all its lengths: it is the instrument's scale.
_SCALED = 2e-3

#: Steps of joint values that are looked for [deg], [0.1 rad], [0.1 m], in so many values; and which share of the noise
#: rounding to them explains where it matters: values to which the arm was sent, and which it reached, are as round.
_STEPS, _SOME_VALUES, _ROUNDED = np.array([10.0, 5.0, 1.0, 0.5, 0.1, 0.05, 0.01]), 4, (0.5, 3.0)


def evidence_of(
    result: Calibration,
    part: Solved,
    rows: Rows,
    doubts: tuple[Reason, ...],
    hint: Reason | None,
) -> Evidence:
    """All that the verdict on a part of a result is based on: the result itself for its URDF, or its larger model.

    The result is cross-validated, and the hint a set-up that explains more.
    """
    fits, m, model = result.in_memory, result.measurements, part.model
    larger = part if isinstance(part, Larger) else None
    fitted = fits.larger if larger is not None and fits.larger is not None else fits.geometry
    nominal, calibrated = result.nominal_cross_validation, part.cross_validation
    assert nominal is not None
    assert calibrated is not None
    suspects = {o.row for o in result.suspects}
    moved = ~model.family(FRAME, TARGET) & np.isin(model.units, ("m", "rad"))
    return Evidence(
        nominal=nominal,
        calibrated=calibrated,
        scales=fitted.estimate.problem.scales,
        used=rows.used,
        repeats=rows.poses,
        pairs=rows.partner >= 0,
        outliers=result.fitted.estimate.outliers,
        validation=validation_errors(
            m.validation,
            np.array([row in suspects for row in m.rows]),
            result.residual_nominal,
            result.residual_calibrated if larger is None else larger.residual,
            result.used,
        ),
        doubts=doubts,
        notes=tuple(_notes(result)) if larger is None else (),
        parameters=len(model),
        whole=(4 * len(fitted.task.robot.inputs) + fitted.setup.count) * bool(result.candidates),
        largest=float(np.max(np.abs(part.x[moved]), initial=0.0)),
        noise=result.sigma,
        expected=part.expected_everywhere,
        moved=_moved(result, larger=larger is not None),
        hint=hint,
    )


def _notes(result: Calibration) -> Iterator[Reason]:
    """What is told of the corrected robot besides, and decides nothing."""
    larger, m = result.larger, result.measurements
    if larger is not None and larger.cross_validation is not None and larger.verdict is not None:
        errors, own = larger.cross_validation.errors_without_outliers, result.cross_validation
        closer = own is None or not errors.rms >= own.errors_without_outliers.rms
        why = Why.LARGER_MODEL if closer else Why.LARGER_NO_CLOSER
        yield Reason.of(why, model=larger.name, after=errors, use=larger.verdict.use)
    if m.copies:
        yield Reason.of(Why.ROWS_COPIED, rows=len(m.copies), row=m.copies[0])
    if result.outside:
        one = max(result.outside, key=lambda row: row.beyond[0].by)
        far, number = one.beyond[0], int(np.array(m.rows)[m.validation][one.index])
        values = {"joint": far.joint, "by_m" if far.prismatic else "by_rad": far.by}
        yield Reason.of(Why.OUTSIDE, rows=len(result.outside), row=number, **values)


def _moved(result: Calibration, *, larger: bool) -> float:
    """How far the calibrated robot puts the target from where the nominal one does, over the joint limits, rms [m]."""
    robot, placed = result.nominal, result.nominal_setup
    q = spread_poses(robot)
    points = result.predict(q, larger=larger)
    T = robot.poses(q) @ placed.T_tip_target[0]
    if result.tells_place:
        return rms(np.linalg.norm((placed.T_frame_base[0] @ T)[:, :3, 3] - points, axis=1))
    moves = without_rigid_motion(points, (T[:, :3, 3] - points)[:, :, None])
    return rms(np.linalg.norm(moves[:, :, 0], axis=1))


def doubts_of(result: Calibration, rows: Rows) -> tuple[Reason, ...]:
    """What was found besides errors: in what the best model leaves over, and in how it was measured."""
    return tuple(_doubts(result, result.in_memory.larger or result.fitted, rows))


def _doubts(result: Calibration, fitted: Fitted, rows: Rows) -> Iterator[Reason]:
    """See `doubts_of`."""
    few, robot = thin(fitted), fitted.task.robot
    least = np.array([_STILL_M if j.type == "prismatic" else _STILL_RAD for j in robot.inputs])
    still = np.flatnonzero(np.ptp(rows.joints, axis=0) < least)
    if len(still):
        yield Reason.of(Why.JOINTS_STILL, joints=", ".join(robot.joint_names[j] for j in still))
    numbers = np.array(result.measurements.rows)[result.measurements.estimation]
    told = [*_patterns(few, numbers[rows.evenly(ENOUGH)])]
    named = not result.candidates and result.solver != PAPER
    # What follows a joint is no noise either, where no larger model had its chance.
    lacks = named and result.larger is None and any(one.why == Why.JOINT_PATTERN for one in told)
    yield from (named and [*_missing_model(few)]) or (() if lacks else _large_noise(result))
    yield from _corner(few)
    yield from told
    yield from disagreeing_setups(few)
    yield from _flagged_setup(fitted)
    for one in result.larger.parameters if result.larger else ():
        # Twice as far as its interval reaches: there are as many chances as joints.
        if one.name.endswith(".compliance") and 2.0 * one.high < one.value:
            yield Reason.of(Why.COMPLIANCE_NEGATIVE, joint=one.name.removesuffix(".compliance"))
    # Repeats that agree far better with each other than with the model.
    repeats, noise = result.repeats, float(fitted.estimate.noise[0] * np.median(rows.sigma))
    if repeats is not None and len(repeats.within) and repeats.freedoms[0] >= _TELLING:
        within = float(repeats.within[0])
        if within < _SCATTER_SHARE * noise and noise >= _ROUNDING_NOISE:
            yield Reason.of(Why.REPEATS_AGREE, within_m=within, noise_m=noise)
    if not fitted.task.distances and not any(kind.size for kind in rows.present):
        yield Reason.of(Why.NO_LENGTH)
    else:
        yield from _scaled_lengths(few)


def thin(fitted: Fitted) -> Fitted:
    """The fit with about so many of its rows, spread evenly over each frame and target; itself if it has no more."""
    problem, estimate = fitted.estimate.problem, fitted.estimate
    if len(problem.rows) <= ENOUGH:
        return fitted
    some = problem.rows.evenly(ENOUGH)
    rows = problem.rows.select(some)
    few = replace(
        Problem.first(problem.kinematics, rows, problem.distances),
        weights=problem.weights[some],
        scales=problem.scales[some][:, : rows.width],
        precision=problem.precision,
        centre=problem.centre,
    )
    scores, weights = estimate.scores[some], estimate.weights[some]
    return replace(fitted, estimate=replace(estimate, problem=few, scores=scores, weights=weights))


def validation_errors(
    validation: Mask, suspects: Mask, nominal: Array, calibrated: Array, used: Mask
) -> tuple[Errors, Errors, int]:
    """Errors on the validation rows, before and after, without suspects if they are few, and how many those are.

    One wild row would decide the comparison; many of them are no accidents. Residuals are of shape (N, D), masks (N,).
    """
    aside = suspects & validation
    many = np.sum(suspects) > max(1, int(_FEW_SUSPECTS * np.sum(validation)))
    if many or np.array_equal(aside, validation):
        aside = np.zeros_like(suspects)
    chosen = validation & ~aside
    before, after = (Errors.of(one[chosen], used[chosen]) for one in (nominal, calibrated))
    return before, after, int(np.sum(aside))


def _missing_model(fitted: Fitted) -> Iterator[Reason]:
    """That the full placements would leave over far less than this fit leaves."""
    task, rows, name = fitted.task, fitted.estimate.problem.rows, fitted.kinematics.model.name
    columns = 6 * len(task.robot.joints) + task.setup.count
    if name.startswith("placement") or rows.count < 2 * columns:
        return
    free = replace(task.cell, frozen=(), ties={}, bounds={}, parameter_priors={})
    full = replace(task, model="placement", cell=free, solver="lm")
    noise, less = (one.estimate.noise[0] for one in (fitted, fit(full, rows, started=fitted.setup)))
    if less <= _FAR_LESS * noise:
        unit = float(np.median(rows.sigma))
        yield Reason.of(Why.MODEL_LACKS, model=name, noise_m=unit * noise, less_m=unit * less)


def _large_noise(result: Calibration) -> Iterator[Reason]:
    """That the larger model too leaves more noise than is stated; where none is, more than instruments have."""
    rows, m = result.fitted.estimate.problem.rows, result.measurements
    fits = [one for one in (result.in_memory.geometry, result.in_memory.larger) if one is not None]
    for c, ratio in enumerate(np.min([one.estimate.noise for one in fits], axis=0)):
        own, columns = np.nonzero(rows.instruments == c)
        name, unit, steady = _STEADY[int(columns[0] >= LENGTHS)]
        by_row, sigma = getattr(m, name), float(np.median(getattr(rows, name)[own]))
        noise, stated = float(ratio) * sigma, getattr(result.cell, name) is not None
        stated |= by_row is not None and bool(np.all(np.isfinite(by_row[m.estimation][own])))
        if stated and noise > _ABOVE * np.hypot(sigma, steady):
            told = {f"before_{unit}": sigma, f"after_{unit}": noise, "ratio": noise / sigma}
            yield Reason.of(Why.NOISE_ABOVE_SIGMA, **told)
        elif not stated and unit == "m" and noise > _LARGE_NOISE:
            yield Reason.of(Why.NOISE_LARGE, noise_m=noise)


def _corner(fitted: Fitted) -> Iterator[Reason]:
    """That the poses cover a corner of the workspace only."""
    robot, rows = fitted.task.robot, fitted.estimate.problem.rows
    q = rows.joints[fitted.estimate.weights > 0.0]
    spread = spread_of(*(robot.poses(one)[:, :3, 3] for one in (q, spread_poses(robot))))
    if spread < _CORNER:
        used = shares_of_ranges(q, column_ranges(robot), [j.type for j in robot.inputs])
        least = int(np.argmin(used))
        name, share = robot.joint_names[least], float(used[least])
        yield Reason.of(Why.CORNER, spread=spread, joint=name, used=share)


def _patterns(fitted: Fitted, numbers: Integers) -> Iterator[Reason]:
    """Whether residuals are noise: rounded joints, targets that moved, a joint's pattern, a drift; rows by numbers."""
    rows, inputs = fitted.estimate.problem.rows, fitted.task.robot.inputs
    noise = np.median(fitted.estimate.problem.scales[rows.used])
    if fitted.estimate.freedom < _TELLING or noise < _ROUNDING_NOISE:
        return
    stack, model, moved = _stack(fitted)
    column = {name: k for k, name in enumerate(model.names)}
    tested = [i for i, joint in enumerate(inputs) if f"{joint.name}.zero" in column]
    slides = [inputs[i].type == "prismatic" for i in tested]
    along = [moved[:, [column[f"{inputs[i].name}.zero"]]] for i in tested]
    grids = np.array([_grid(rows.joints[:, i], one) for i, one in zip(tested, slides, strict=True)])
    rounding = grids**2 / 12.0 * [np.mean(one**2) for one in along]
    if _ROUNDED[0] < np.sum(rounding) < _ROUNDED[1]:
        worst = int(np.argmax(rounding))
        values = {"joint": inputs[tested[worst]].name, "share": min(float(np.sum(rounding)), 1.0)}
        values |= {"by_m" if slides[worst] else "by_rad": float(grids[worst])}
        yield Reason.of(Why.JOINTS_COARSE, **values)
    order, here = np.linspace(0.0, 1.0, len(rows)), np.isin(np.arange(len(rows)), stack.row_of)
    # Rows may be in the order of a joint's values: what follows those is no drift and no step.
    found = joint_patterns(stack, rows.joints[:, tested], slides, along)
    rest = stack.beyond(*(Z for *_, Z in found))
    drifts = drift(rest, order)
    for t, name in enumerate(fitted.setup.targets):
        own = [one.place == fitted.setup.places[1][t] for one in model.parameters]
        jump = step(rest, np.flatnonzero((rows.samples.target == t) & here), moved[:, own])
        if jump and (drifts is None or jump.test.share > drifts.share):
            values = {"target": name, "row": int(numbers[jump.row]), "moved_m": jump.size}
            yield Reason.of(Why.TARGET_STEP, **values, **jump.test.told)
            stack, rest = stack.beyond(jump.Z), rest.beyond(jump.Z)
            found = joint_patterns(stack, rows.joints[:, tested], slides, along)
            drifts = drift(rest, order)
    for i, one, _ in found[:1]:
        values = {"quantity": "position" if slides[i] else "angle", "joint": inputs[tested[i]].name}
        yield Reason.of(Why.JOINT_PATTERN, **values, **one.told)
    if drifts is not None:
        yield Reason.of(Why.DRIFT, **drifts.told)


def _stack(fitted: Fitted) -> tuple[Stack, ErrorModel, Array]:
    """The scalars of a fit, and what each zero of a joint and displacement of a target does to them, (M, p)."""
    estimate, setup, placed = fitted.estimate, fitted.setup, fitted.placed()
    problem, rows, names = estimate.problem, estimate.problem.rows, setup.target_names
    frames = dict.fromkeys(setup.frame_unknowns, ())
    model = error_model(fitted.task.robot, "zeros", frame=frames, target=names, targets=names)
    own = Kinematics(fitted.task.robot, model, placed.T_frame_base, placed.T_tip_target)
    moved = rows.derivative(*own.twists(np.zeros(len(model)), rows.samples))
    weights = np.where(_flagged_from_some_row_on(fitted), 1.0, estimate.weights)
    counts = rows.used & (weights > 0.0)[:, None]
    whiten = np.sqrt(weights)[:, None] / problem.scales
    row_of, component_of = np.nonzero(counts)
    # What the parameters did to the scalars. Directions in which an error of the size expected moves all of them by
    # less than their noise were not fitted: such a direction may be the residual itself, made larger or turned.
    A = (problem.jacobian(estimate.x) * whiten[:, :, None])[counts]
    A = A / np.sqrt(np.maximum(problem.precision, np.finfo(float).tiny))
    basis, effects, _ = np.linalg.svd(A, full_matrices=False)
    r = (problem.residual(estimate.x) * whiten)[counts]
    stack = Stack(basis[:, effects > _FITTED], r, row_of, component_of, whiten[counts], rows.poses)
    return stack, model, (moved * whiten[:, :, None])[counts]


def _flagged_from_some_row_on(fitted: Fitted) -> Mask:
    """Flagged rows of targets whose first or last rows are flagged, and hardly any other: these are no accidents."""
    flagged, target = fitted.estimate.outliers, fitted.estimate.problem.rows.samples.target
    result = np.zeros_like(flagged)
    for t in np.unique(target):
        for own in (np.flatnonzero(target == t), np.flatnonzero(target == t)[::-1]):
            before, k = np.cumsum(flagged[own]), np.arange(1, len(own) + 1)
            behind, rest = before[-1] - before, len(own) - k
            block = (behind >= _SOME_FLAGGED) & (behind > 0.5 * rest) & (before < 0.1 * k)
            result[own] |= flagged[own] & np.any(block)
    return result


def _grid(q: Array, slides: bool) -> float:
    """The largest step of which values (N,) of a joint are multiples, to 1 % [rad, m]; 0 where there is none."""
    steps = [*np.radians(_STEPS), *_STEPS / 10.0] if not slides else _STEPS / 10.0
    fits = [one for one in steps if np.all(np.abs(q / one - np.round(q / one)) < 0.01)]
    return max(fits, default=0.0) if len(np.unique(q)) >= _SOME_VALUES else 0.0


def _scaled_lengths(fitted: Fitted) -> Iterator[Reason]:
    """That all lengths are off by one share: an unknown beside their own corrections, whose size is found anew."""
    estimate, model, task = fitted.estimate, fitted.kinematics.model, fitted.task
    problem, rows, x = estimate.problem, estimate.problem.rows, estimate.x
    own = ~model.family(FRAME, TARGET) & (np.array(model.units) == "m")
    if task.solver == PAPER or task.cell.priors.sizes != "data" or not np.any(own):
        return
    T = fitted.kinematics.poses(x, rows.samples)
    grown = np.zeros((len(rows), 6, 1))
    grown[:, :3, 0] = T[:, :3, 3] - fitted.placed().T_frame_base[rows.samples.frame, :3, 3]
    linear, column = problem.linear(x), (rows.derivative(T, grown)[:, :, 0] / rows.scales).T
    columns = np.concatenate([linear.columns[:-1], column[None], linear.columns[-1:]])
    C = np.pad(linear.C, ((0, 0), (0, 1)))
    wider = replace(linear, x=np.append(x, 0.0), columns=columns, C=C)
    prior = PriorTerms.of(task.cell, model, task.setup, fitted.setup, lenient=task.lenient)
    prior = prior.at_bounds({k: float(x[k]) for k in estimate.at_bound})
    prior = replace(
        prior,
        families=np.pad(prior.families, ((0, 0), (0, 1))),
        precision=np.append(prior.precision, 0.0),
        centre=np.append(prior.centre, 0.0),
    )
    weights, noise = problem.weights[None], np.array([estimate.noise])
    sizes = np.array([[estimate.sizes[name] for name in prior.names]])
    stage = Stage(prior, weights > 0.0, weights, np.ones(weights.shape), noise, sizes)
    stage = stage.by_likelihood(wider, robust=False)
    found, covariance, _ = (one[0] for one in stage.fit(wider))
    # The error is mostly that of the corrections, which tell their size with few degrees of freedom.
    told = 1.0 - np.diag(covariance)[:-1] * stage.priors.precision[0, :-1]
    scale, std = float(found[-1]), float(np.sqrt(covariance[-1, -1]))
    p = 2.0 * float(stdtr(max(float(np.sum(told[own])) - 1.0, 1.0), -abs(scale) / std))
    if abs(scale) > _SCALED and p < FALSE_ALARM:
        yield Reason.of(Why.LENGTHS_SCALED, scale=scale, std=std, p=p)


def disagreeing_setups(fitted: Fitted) -> tuple[Reason, ...]:
    """Set-ups that a fit to the others does not predict, the surest two."""
    estimate, problem, rows = fitted.estimate, fitted.estimate.problem, fitted.estimate.problem.rows
    labels = joined_setups(rows, fitted.task.distances)
    if labels.max() < 1 or estimate.freedom < _TELLING:
        return ()
    linear, of_fit = problem.linear(estimate.x), np.array([estimate.noise])
    priors, noise = Priors(problem.precision, problem.centre), linear.noise_of(of_fit)[0]
    counts = np.any(linear.used, axis=1) & (estimate.weights > 0.0)
    # Set-ups that only rows for validation are of have nothing to predict here.
    present = np.unique(labels[counts])
    told = []
    for own in (labels == g for g in present):
        weights = np.where(own, 0.0, problem.weights)
        x, covariance, freedom = (f[0] for f in linear.fit(weights[None], of_fit, priors))
        loose = only_there(fitted, own)
        x = np.where(loose, estimate.x, x)
        rest = np.where(linear.used, linear.residual(x) / noise, 0.0)
        # Repeats count for one measurement where they share what the model lacks.
        chosen = own & counts
        at, alike = problem.weights[chosen], rows.poses[chosen]
        r, first = pose_means(rest[chosen], at, alike)
        A, _ = pose_means((linear.A / noise[:, :, None])[chosen], at, alike)
        there = linear.used[chosen][first]
        A, C = A[there], covariance[np.ix_(~loose, ~loose)]
        square, degrees = prediction_square(r[there], A[:, ~loose], C, A[:, loose])
        variance = float(weights @ np.sum(rest**2, axis=1)) / max(freedom, 1.0)
        told.append((square, degrees, variance, max(freedom, 0.0)))
    return tuple(
        Reason.of(
            Why.SETUP_UNPREDICTED, setup=_setup_name(fitted, labels == present[i]), ratio=ratio
        )
        for i, ratio in unpredicted(*np.array(told).T)[:2]
    )


def _setup_name(fitted: Fitted, own: Mask) -> str:
    """The groups of some rows."""
    frames = fitted.estimate.problem.rows.samples.frame[own]
    return " and ".join(dict.fromkeys(fitted.setup.groups[f] for f in frames))


def _flagged_setup(fitted: Fitted) -> Iterator[Reason]:
    """A set-up whose rows are flagged far more often than the others': it has moved, they have not."""
    flagged = fitted.estimate.outliers
    labels = joined_setups(fitted.estimate.problem.rows, fitted.task.distances)
    for g in np.unique(labels) if labels.max() > 0 else ():
        own = labels == g
        count, inside, others = int(flagged[own].sum()), flagged[own].mean(), flagged[~own].mean()
        if count >= _SOME_FLAGGED and inside > max(_SHARE_FLAGGED, 3.0 * others):
            name = _setup_name(fitted, own)
            yield Reason.of(Why.SETUP_FLAGGED, flagged=count, rows=int(np.sum(own)), setup=name)
            return
