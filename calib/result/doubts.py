"""Doubts about a result besides its errors: given values, coverage of the poses, and residuals of its best model."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from calib.basics.arrays import Array, Integers, Mask
from calib.basics.channels import RESIDUAL_UNITS
from calib.diagnosis.coverage import shares_of_ranges, spread_of
from calib.diagnosis.further_unknowns import (
    UNLIKELY,
    instrument_scale,
    motion_of_base,
    priors_from_data,
)
from calib.diagnosis.images.senses import doubtful_senses
from calib.diagnosis.images.stated import contradicted_statements
from calib.diagnosis.images.views import doubtful_views
from calib.diagnosis.patterns import FALSE_ALARM
from calib.diagnosis.reasons import Reason, Why
from calib.diagnosis.residual_patterns import (
    FEWEST_FREEDOM,
    ROUNDING_NOISE,
    Order,
    residual_patterns,
)
from calib.diagnosis.stated_covariances import idle_covariances
from calib.diagnosis.stations import disagreeing_stations, flagged_station
from calib.fit.estimate.fitting import Fitted, fit
from calib.fit.estimate.problem import Problem
from calib.fit.estimate.special_cases.arm_size import measures_length
from calib.fit.registration.registration import ENOUGH
from calib.fit.registration.rows import Rows
from calib.model.families import FAMILIES, joint_families
from calib.numerics.solvers import has_weights_and_priors
from calib.result.calibration import Calibration
from calib.robot.ranges import column_ranges, spread_poses
from calib.robot.robot import Robot

#: The rows hardly determine the errors of a turning joint that moves less than this [rad].
_STILL_RAD = 0.35

#: The same of a sliding joint [m].
_STILL_M = 0.05

#: Tips that spread less than this share of what the joints allow are a corner. Random poses reach 0.8 to 1.2, the
#: paper's 0.43, a 20 cm cube of a UR3's workspace 0.28.
_CORNER = 1.0 / 3.0

#: The model lacks something where a larger one lowers the noise to this share.
_FAR_LESS = 0.6

#: The model lacks something where repeats scatter by less than this share of the noise.
_SCATTER_SHARE = 0.5

#: Noise more than so many times the one stated is not the instrument's.
_ABOVE = 5.0

#: No arm is off by more than this share in all its lengths: a larger one is the instrument's scale error.
_SCALED = 2e-3

#: A base that has moved is named where its effect on the rows is more than this share of that of the arm's corrections.
_LIKE_THE_ARM = 0.5

#: A target that is estimated further than this from where it was given was given wrongly [m].
_ELSEWHERE = 5e-3

#: A joint was measured in a part of its range where it used less than this share of it.
_NARROW = 1.0 / 3.0


def doubts_of(result: Calibration, rows: Rows) -> tuple[Reason, ...]:
    """List the reasons for doubt about a result besides its errors.

    They concern the fit of the non-geometric model where the result has one, else that of the geometry.

    Args:
        result: A result in memory, with its measurements and fits.
        rows: The rows that were fitted, as arrays; ``sole`` marks those of sole postures, which no other row can check.

    Returns:
        Reasons, each a code with the numbers of its sentence in SI units, in the order of the report; empty where there
        is no doubt.
    """
    best = result.fit.non_geometric or result.fit.geometry
    return tuple(_doubts(result, best, rows))


def _doubts(result: Calibration, fitted: Fitted, rows: Rows) -> Iterator[Reason]:
    """Yield the reasons for doubt about a result besides its errors, in the order of the report.

    Args:
        result: A result in memory, with its measurements and fits.
        fitted: The fit of the result's best model: the non-geometric one if there is one, else the geometry. Many rows
            are thinned for most of the tests.
        rows: The rows that were fitted, as arrays; ``sole`` marks those of sole postures.

    Yields:
        Reasons on given targets and frame, the instrument's scale, joints that hardly moved, sole postures, a model
        that lacks something, the coverage of the workspace, patterns of the residuals, stations, compliances, repeats,
        and the lack of any measured length.
    """
    few, chosen = thin(fitted)
    yield from _given_targets(result)
    if priors_from_data(few):
        yield from _given_frame(few)
        yield from _scale(few, certified=result.fit.cell.scale_certified)
        yield from contradicted_statements(few)
    yield from idle_covariances(few)
    yield from doubtful_views(few)
    m = result.fit.measurements
    yield from doubtful_senses(result.nominal, result.fit.cell, m.select(m.estimation))
    yield from _still(fitted.task.robot, rows)
    yield from _sole_postures(result, rows)
    if _named_model(result):
        yield from _missing_model(few)
    yield from _corner(few)
    yield from residual_patterns(few, _order(result, chosen))
    yield from disagreeing_stations(few)
    yield from flagged_station(fitted)
    yield from _negative_compliances(result)
    yield from _agreeing_repeats(result, fitted)
    if not measures_length(rows, fitted.task.distances):
        yield Reason.of(Why.NO_LENGTH)


def _named_model(result: Calibration) -> bool:
    """Tell if the user named the model, so that no larger one was tried.

    Args:
        result: The result. True if its ``candidates``, the models of a choice, are empty, and its ``solver`` is not the
            paper's.
    """
    return not result.method.candidates and has_weights_and_priors(result.method.solver)


def _given_targets(result: Calibration) -> Iterator[Reason]:
    """Doubt targets that the user gave and that were estimated far from there.

    Args:
        result: The result: ``nominal_setup`` has T_tip_target of each target as given, shape (T, 4, 4), [m], ``setup``
            as estimated, and which targets were given and which estimated.

    Yields:
        A reason with the target's name and the distance ``far_m`` [m] for each target that is more than `_ELSEWHERE`
        away.
    """
    given, estimated = result.nominal_setup, result.setup
    for t, name in enumerate(estimated.targets):
        if not (estimated.target_given[t] and estimated.target_unknown[t]):
            continue
        change = estimated.T_tip_target[t, :3, 3] - given.T_tip_target[t, :3, 3]
        distance = float(np.linalg.norm(change))
        if distance > _ELSEWHERE:
            yield Reason.of(Why.TARGET_FAR, target=name, far_m=distance)


def _given_frame(fitted: Fitted) -> Iterator[Reason]:
    """Doubt a frame that was given as known, where the base seems to stand elsewhere in it.

    Args:
        fitted: A fit with prior standard deviations that were estimated from the data.

    Yields:
        One reason: displacement ``moved_m`` [m] and turn ``turned_rad`` [rad] of the base, the displacement of the
        measured positions by it, rms, ``effect_m`` [m], and that by the arm's corrections, ``arm_m`` [m]. None where no
        position was measured in a known frame, or the base's motion is not significant or small beside the arm's
        corrections.
    """
    base = motion_of_base(fitted)
    if base is None or not base.p < UNLIKELY:
        return
    if base.effect > _LIKE_THE_ARM * base.effect_of_arm:
        yield Reason.of(
            Why.BASE_MOVED,
            moved_m=base.moved,
            turned_rad=base.turned,
            effect_m=base.effect,
            arm_m=base.effect_of_arm,
        )


def _scale(fitted: Fitted, *, certified: bool) -> Iterator[Reason]:
    """Doubt the scale of the instrument, or say that it cannot be seen unless it is certified.

    Args:
        fitted: A fit with prior standard deviations that were estimated from the data.
        certified: Whether the user states that the scale was certified or checked.

    Yields:
        At most one reason. Either all measured lengths are too long by a share ``scale``, below 0 too short, with its
        standard deviation ``std`` and p-value ``p``, that no arm is off by; or ``scale`` is the largest share that
        lengths of the arm may hide, with its effect ``effect_m`` at ``reach_m``, the rms distance of the target from
        the base [m]. None where no length of the arm is estimated, nothing measures a length, or the scale is certified
        and not off.
    """
    scale = instrument_scale(fitted)
    if scale is None:
        return
    if abs(scale.share) > _SCALED and scale.p < FALSE_ALARM:
        yield Reason.of(Why.LENGTHS_SCALED, scale=scale.share, std=scale.std, p=scale.p)
    elif scale.measured and not certified:
        yield Reason.of(
            Why.SCALE_HIDDEN,
            scale=scale.hidden,
            reach_m=scale.reach,
            effect_m=scale.hidden * scale.reach,
        )


def _still(robot: Robot, rows: Rows) -> Iterator[Reason]:
    """Name joints that hardly moved, so that the rows hardly determine their errors.

    Args:
        robot: The robot, with m measured joints.
        rows: The N rows that were fitted, as arrays, with their joint values, shape (N, m), [rad] or [m].

    Yields:
        One reason with the joints' names; none where all moved.
    """
    still = np.flatnonzero(_hardly_moved(robot, rows))
    if len(still):
        yield Reason.of(Why.JOINTS_STILL, joints=", ".join(robot.joint_names[j] for j in still))


def _hardly_moved(robot: Robot, rows: Rows) -> Mask:
    """Find the joints that hardly moved over the rows.

    Args:
        robot: The robot, with m measured joints, each turning or sliding.
        rows: N rows as arrays, with their joint values, shape (N, m), [rad] or [m].

    Returns:
        True for a joint whose values span less than `_STILL_RAD`, or `_STILL_M` if it slides, shape (m,).
    """
    least = np.array([_STILL_M if j.type == "prismatic" else _STILL_RAD for j in robot.inputs])
    return np.asarray(np.ptp(robot.input_values(rows.joints), axis=0) < least)


def _sole_postures(result: Calibration, rows: Rows) -> Iterator[Reason]:
    """Name the first row of each sole posture, and the joint whose value there is furthest from all other rows'.

    A sole posture is one that no other row can check. Distances count as shares of the joint's range.

    Args:
        result: The result with its nominal robot and its table, for the numbers of the rows.
        rows: The N rows that were fitted, as arrays: ``checked``, shape (N,), False for rows of sole postures;
            ``blocks``, the same number for rows of one posture, shape (N,); and joint values, shape (N, m), [rad] or
            [m].

    Yields:
        One reason with the rows' numbers in the table and the joints' names; none without sole postures.
    """
    robot, m = result.nominal, result.fit.measurements
    numbers = np.array(m.rows)[m.estimation]
    values = robot.input_values(rows.joints)
    low, high = column_ranges(robot).T
    joints: dict[int, str] = {}  # by the row's number in the table
    for block in np.unique(rows.blocks[~rows.checked]).tolist():
        of_block = rows.blocks == block
        first = int(np.flatnonzero(of_block)[0])
        distances = np.abs(values[~of_block] - values[first])
        nearest = distances.min(axis=0) / (high - low)
        furthest_joint = int(np.argmax(nearest))
        joints[int(numbers[first])] = robot.joint_names[furthest_joint]
    if joints:
        yield Reason.of(Why.SOLE_POSTURE, rows=list(joints), joints=list(joints.values()))


def _negative_compliances(result: Calibration) -> Iterator[Reason]:
    """Name joints that would move against their load: an error that cannot be negative is, beyond its interval.

    Args:
        result: The result, with the parameters of its non-geometric model, if it has one. Of each parameter of a family
            whose errors are positive, such as compliances, value and upper end of the 95 % interval are used: it is
            named if twice the upper end is below the value.

    Yields:
        One reason for each such joint, with its name and that of the family.
    """
    if result.non_geometric is None:
        return
    model = result.non_geometric.model
    estimates = zip(model.parameters, result.non_geometric.parameters, strict=True)
    for parameter, estimate in estimates:
        family = FAMILIES.get(parameter.family)
        if family is None or not family.positive:
            continue
        # Twice as far as its interval reaches: there are as many chances as joints.
        if 2.0 * estimate.high < estimate.value:
            yield Reason.of(Why.COMPLIANCE_NEGATIVE, joint=parameter.place, family=family.name)


def _agreeing_repeats(result: Calibration, fitted: Fitted) -> Iterator[Reason]:
    """Say if repeats of a pose agree far better with each other than with the model, which then lacks something.

    Args:
        result: The result. Of ``repeats``, None where no pose was repeated, are used ``within``, the standard deviation
            of one scalar within the poses, and ``freedoms``, its degrees of freedom, of the first unit measured.
        fitted: The fit of its best model, with the noise of its first channel as a multiple of the stated sigma, which
            is ``rows.sigma``, median over rows.

    Yields:
        One reason with the scatter, such as ``within_m``, and the noise, such as ``noise_m`` [m]; none where they are
        alike, or the repeats are too few.
    """
    repeats = result.noise.repeats
    rows = fitted.estimate.problem.rows
    unit = rows.channels.units[0]
    sigma = float(np.median(rows.sigma[unit]))
    noise = float(fitted.estimate.problem.noise_over_sigma[0]) * sigma
    if repeats is None or repeats.freedoms.get(unit, 0.0) < FEWEST_FREEDOM:
        return
    within = repeats.within[unit]
    if within < _SCATTER_SHARE * noise and noise >= ROUNDING_NOISE:
        sizes = {f"within_{unit}": within, f"noise_{unit}": noise}
        yield Reason.of(Why.REPEATS_AGREE, **sizes)


def thin(fitted: Fitted) -> tuple[Fitted, Mask]:
    """Reduce a fit to about `ENOUGH` of its rows, evenly over frames, targets and kinds, without fitting again.

    It saves time in tests of large tables.

    Args:
        fitted: Fit to N rows.

    Returns:
        The same fit, with equal parameters, covariance and noise, of fewer rows; and True for these rows, shape (N,).
        The fit itself where it has no more rows.
    """
    problem, estimate = fitted.estimate.problem, fitted.estimate
    chosen = problem.rows.evenly(ENOUGH)
    if np.all(chosen):
        return fitted, chosen
    rows = problem.rows.select(chosen)
    reduced = replace(
        Problem.initial(problem.kinematics, rows, problem.distances),
        weights=problem.weights[chosen],
        noise=problem.noise,
        prior_precision=problem.prior_precision,
        prior_mean=problem.prior_mean,
        stop_shares=problem.stop_shares,
        gauge=problem.gauge,
    )
    thinned = replace(
        estimate,
        problem=reduced,
        scores=estimate.scores[chosen],
        weights=estimate.weights[chosen],
    )
    return replace(fitted, estimate=thinned), chosen


def _order(result: Calibration, chosen: Mask) -> Order:
    """Return the order in which some fitted rows were measured, with the joints' moves to them in the whole table.

    Args:
        result: The result with its table, whose rows stand in the order in which they were measured, validation rows
            too.
        chosen: True for n rows among the N that were fitted, shape (N,).

    Returns:
        ``numbers`` of the chosen rows in the table, shape (n,), and ``moves``, each joint's value less that in the
        table's row before, shape (n, m), [rad] or [m]; 0 in the table's first row.
    """
    m = result.fit.measurements
    q = m.joints_for(result.nominal.joint_names)
    moves = np.diff(q, axis=0, prepend=q[:1])
    rows = np.flatnonzero(m.estimation)[chosen]
    return Order(np.array(m.rows)[rows], moves[rows])


def _missing_model(fitted: Fitted) -> Iterator[Reason]:
    """Say if full placements, or these with non-geometric errors, would lower the noise far below that of a fit.

    Args:
        fitted: The fit of the model that was named: its model, its rows, and the noise of its first instrument (of a
            length, if any was measured) as a multiple of the stated sigma.

    Yields:
        One reason with the name of the larger model that leaves the least noise, and the noise in the first unit,
        such as ``noise_m`` by the named model and ``less_m`` by the larger one [m]; none where none lowers it
        to `_FAR_LESS`.
    """
    rows, name = fitted.estimate.problem.rows, fitted.kinematics.model.name
    noise = least = float(fitted.estimate.problem.noise_over_sigma[0])
    lacking = ""
    not_loaded = [family for family in joint_families() if not FAMILIES[family].loaded]
    with_families = "+".join(("placement", *not_loaded))
    for model in ("placement", with_families):
        if name.startswith(model):
            continue
        of_model = _noise_of(fitted, model)
        if of_model is not None and of_model <= _FAR_LESS * least:
            least, lacking = of_model, model
    if lacking:
        unit = rows.channels.units[0]
        sigma = float(np.median(rows.sigma[unit]))
        noises = {f"noise_{unit}": sigma * noise, f"less_{unit}": sigma * least}
        yield Reason.of(Why.MODEL_LACKS, model=name, non_geometric=lacking, **noises)


def _noise_of(fitted: Fitted, model: str) -> float | None:
    """Return the noise that another model leaves on the rows of a fit, of the first instrument, over its given sigma.

    Args:
        fitted: The fit: its task, its rows, and its registered frames and targets, from which the other one starts.
        model: Name of the other model, which is fitted without frozen or tied parameters, bounds, and own priors.

    Returns:
        Estimated over given standard deviation [1]; None where the rows have fewer than two scalars for each parameter.
    """
    task, rows = fitted.task, fitted.estimate.problem.rows
    free = replace(task.cell, frozen=(), ties={}, bounds={}, parameter_priors={})
    full = replace(task, model=model, cell=free, solver="lm", allow_absent=True)
    if rows.count < 2 * len(full.error_model()):
        return None
    refitted = fit(full, rows, registered=fitted.setup)
    return float(refitted.estimate.problem.noise_over_sigma[0])


def noise_doubts(
    result: Calibration, fitted: Fitted, doubts: tuple[Reason, ...]
) -> Iterator[Reason]:
    """Yield a reason for each channel whose noise exceeds the stated or, without one, a usual one.

    Args:
        result: The result with its table and cell in memory, which may state the noise.
        fitted: The fit, with the estimated over the stated standard deviation of each of the C channels of its rows.
        doubts: Doubts so far. Where a model lacks something, residuals are no noise, and nothing is yielded; nor where
            residuals of a named geometry follow a joint.

    Yields:
        A reason with the noise as stated or assumed and as estimated, in the channel's unit, and their ratio; where
        none is stated, the estimated noise alone.
    """
    codes = {doubt.why for doubt in doubts}
    if Why.MODEL_LACKS in codes:
        return
    # Nor are residuals noise that follow a joint, where no non-geometric model was tried.
    if _named_model(result) and result.non_geometric is None and Why.JOINT_PATTERN in codes:
        return
    rows = fitted.estimate.problem.rows
    for c, ratio in enumerate(fitted.estimate.problem.noise_over_sigma):
        of_channel, _ = np.nonzero(rows.channels.index == c)
        yield from _channel_noise(result, rows, c, of_channel, float(ratio))


def _channel_noise(
    result: Calibration,
    rows: Rows,
    c: int,
    of_channel: Integers,
    ratio: float,
) -> Iterator[Reason]:
    """Doubt the noise of a channel.

    Args:
        result: The result with its table and cell in memory, either of which may state the noise.
        rows: The N rows that were fitted, as arrays: ``sigma``, the standard deviation of one scalar as stated or
            assumed.
        c: Index of the channel, from 0.
        of_channel: Indices of the rows that have scalars of it, from 0; of a row once for each of these.
        ratio: Estimated noise over the stated or assumed one.

    Yields:
        One reason: such as ``before_m`` as stated, ``after_m`` as estimated [m] and their ratio, where the noise is far
        above the stated one; or ``noise_m`` [m], where none is stated and it is above that of usual instruments. Else
        none.
    """
    symbol = rows.channels.units[c]
    unit = RESIDUAL_UNITS[symbol]
    m, sigma = result.fit.measurements, float(np.median(rows.sigma[symbol][of_channel]))
    noise = ratio * sigma
    by_row = _all_stated(m.stated_sigma.get(symbol), m.estimation, of_channel)
    if symbol not in result.fit.cell.sigma and not by_row:
        if noise > unit.large_noise:
            yield Reason.of(Why.NOISE_LARGE, **{f"noise_{symbol}": noise})
    elif noise > _ABOVE * np.hypot(sigma, unit.repeatability):
        sizes = {f"before_{symbol}": sigma, f"after_{symbol}": noise}
        yield Reason.of(Why.NOISE_ABOVE_SIGMA, **sizes, ratio=noise / sigma)


def _all_stated(sigma: Array | None, estimation: Mask, chosen: Integers) -> bool:
    """Tell if a table states the noise of each of some fitted rows.

    Args:
        sigma: Standard deviation of each row of the table, shape (N,), [m] or [rad]; NaN where a row states none; None:
            the table has no such column.
        estimation: True for the rows that were fitted, shape (N,).
        chosen: Indices, from 0, of some of the fitted rows, counted among the fitted ones alone.

    Returns:
        False where any of these rows states none.
    """
    if sigma is None:
        return False
    return bool(np.all(np.isfinite(sigma[estimation][chosen])))


def _corner(fitted: Fitted) -> Iterator[Reason]:
    """Say if the poses cover only part of the joints' ranges, or a corner of the workspace, and which.

    Joints that hardly moved are named by another reason.

    Args:
        fitted: A fit: its robot, and the joint values and robust weights of its rows; those without weight do not count
            in spread and shares.

    Yields:
        At most one reason: ``spread``, the rms distance of the tips from their mean over that in the whole workspace,
        and of each narrow joint, the narrowest first, its name, the share of its range that it used, its lowest and
        highest value, [rad] or [m], and whether it slides.
    """
    robot, rows = fitted.task.robot, fitted.estimate.problem.rows
    q = rows.joints[fitted.estimate.weights > 0.0]
    measured_tips = robot.poses(q)[:, :3, 3]
    possible_tips = robot.poses(spread_poses(robot))[:, :3, 3]
    spread = spread_of(measured_tips, possible_tips)
    values = robot.input_values(q)
    shares = shares_of_ranges(values, column_ranges(robot), [j.type for j in robot.inputs])
    moved = ~_hardly_moved(robot, rows)
    narrow = np.flatnonzero((shares < _NARROW) & moved).tolist()
    if not np.any(moved) or (spread >= _CORNER and not narrow):
        return
    narrowest = int(np.argmin(np.where(moved, shares, np.inf)))
    narrow = sorted(narrow or [narrowest], key=lambda j: shares[j])
    yield Reason.of(
        Why.CORNER,
        spread=spread,
        joints=[robot.joint_names[j] for j in narrow],
        shares=[float(shares[j]) for j in narrow],
        lows=[float(values[:, j].min()) for j in narrow],
        highs=[float(values[:, j].max()) for j in narrow],
        slides=[robot.inputs[j].type == "prismatic" for j in narrow],
    )
