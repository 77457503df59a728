"""Doubts about a result besides its errors: given values, coverage of the poses, and residuals of its best model."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from calib.diagnosis.coverage import shares_of_ranges, spread_of
from calib.diagnosis.further_unknowns import (
    UNLIKELY,
    instrument_scale,
    motion_of_base,
    priors_from_data,
)
from calib.diagnosis.patterns import FALSE_ALARM
from calib.diagnosis.reasons import Reason, Why
from calib.diagnosis.residual_patterns import (
    FEWEST_FREEDOM,
    ROUNDING_NOISE,
    Order,
    residual_patterns,
)
from calib.diagnosis.stations import disagreeing_stations, flagged_station
from calib.estimate.fitting import Fitted, fit
from calib.estimate.gauge import measures_length
from calib.estimate.problem import Problem
from calib.estimate.task import PAPER
from calib.model.families import FAMILIES, joint_families
from calib.numerics.errors import LENGTHS
from calib.registration.registration import ENOUGH
from calib.registration.rows import Rows
from calib.result.calibration import CalibrationValues
from calib.robot.ranges import column_ranges, spread_poses
from calib.robot.robot import Robot
from calib.units import Array, Integers, Mask

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

#: Where none is stated, noise above this is not an instrument's [m].
_LARGE_NOISE = 1e-3

#: Repeatability of arms, which adds to the stated noise of a length [m].
_REPEATABILITY = 3e-5

#: The same for the noise of an angle [rad].
_REPEATABILITY_ANGLE = 1e-4

#: No arm is off by more than this share in all its lengths: a larger one is the instrument's scale error.
_SCALED = 2e-3

#: A base that has moved is named where its effect on the rows is more than this share of that of the arm's corrections.
_LIKE_THE_ARM = 0.5

#: A target that is estimated further than this from where it was given was given wrongly [m].
_ELSEWHERE = 5e-3

#: A joint was measured in a part of its range where it used less than this share of it.
_NARROW = 1.0 / 3.0


def doubts_of(result: CalibrationValues, rows: Rows) -> tuple[Reason, ...]:
    """List the reasons for doubt about a result besides its errors.

    They concern the fit of the non-geometric model where the result has one, else that of the geometry.

    Args:
        result: A result in memory, with its fits.
        rows: The rows that were fitted, those of sole postures marked.

    Returns:
        Reasons in the order of the report; empty where there is no doubt.
    """
    best = result.fit_in_memory.non_geometric or result.fitted
    return tuple(_doubts(result, best, rows))


def _doubts(result: CalibrationValues, fitted: Fitted, rows: Rows) -> Iterator[Reason]:
    """Yield the reasons of `doubts_of`; ``fitted`` is the fit of the result's best model."""
    few, chosen = thin(fitted)
    yield from _given_targets(result)
    if priors_from_data(few):
        yield from _given_frame(few)
        yield from _scale(few, certified=result.cell.scale_certified)
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


def _named_model(result: CalibrationValues) -> bool:
    """Tell if the model was named, so that no larger one was tried."""
    return not result.candidates and result.solver != PAPER


def _given_targets(result: CalibrationValues) -> Iterator[Reason]:
    """Doubt given targets that were estimated far from there."""
    given, estimated = result.nominal_setup, result.setup
    for t, name in enumerate(estimated.targets):
        if not (estimated.target_given[t] and estimated.target_unknown[t]):
            continue
        change = estimated.T_tip_target[t, :3, 3] - given.T_tip_target[t, :3, 3]
        distance = float(np.linalg.norm(change))
        if distance > _ELSEWHERE:
            yield Reason.of(Why.TARGET_FAR, target=name, far_m=distance)


def _given_frame(fitted: Fitted) -> Iterator[Reason]:
    """Doubt a known frame in which the base seems to stand elsewhere."""
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
    """Doubt the scale of the instrument, or say that it cannot be seen unless it is certified."""
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
    """Name joints that hardly moved."""
    still = np.flatnonzero(_hardly_moved(robot, rows))
    if len(still):
        yield Reason.of(Why.JOINTS_STILL, joints=", ".join(robot.joint_names[j] for j in still))


def _hardly_moved(robot: Robot, rows: Rows) -> Mask:
    """Find the joints that hardly moved over the rows, shape (m,)."""
    least = np.array([_STILL_M if j.type == "prismatic" else _STILL_RAD for j in robot.inputs])
    return np.asarray(np.ptp(rows.joints, axis=0) < least)


def _sole_postures(result: CalibrationValues, rows: Rows) -> Iterator[Reason]:
    """Name the first row of each sole posture, and the joint whose value there is furthest from all other rows'."""
    robot, m = result.nominal, result.measurements
    numbers = np.array(m.rows)[m.estimation]
    low, high = column_ranges(robot).T
    joints: dict[int, str] = {}  # by the row's number in the table
    for block in np.unique(rows.blocks[~rows.checked]).tolist():
        of_block = rows.blocks == block
        first = int(np.flatnonzero(of_block)[0])
        distances = np.abs(rows.joints[~of_block] - rows.joints[first])
        nearest = distances.min(axis=0) / (high - low)
        joints[int(numbers[first])] = robot.joint_names[int(np.argmax(nearest))]
    if joints:
        yield Reason.of(Why.SOLE_POSTURE, rows=list(joints), joints=list(joints.values()))


def _negative_compliances(result: CalibrationValues) -> Iterator[Reason]:
    """Name joints that would move against their load."""
    if result.non_geometric is None:
        return
    for parameter in result.non_geometric.parameters:
        if not parameter.name.endswith(".compliance"):
            continue
        # Twice as far as its interval reaches: there are as many chances as joints.
        if 2.0 * parameter.high < parameter.value:
            joint = parameter.name.removesuffix(".compliance")
            yield Reason.of(Why.COMPLIANCE_NEGATIVE, joint=joint)


def _agreeing_repeats(result: CalibrationValues, fitted: Fitted) -> Iterator[Reason]:
    """Say if repeats agree far better with each other than with the model."""
    repeats = result.repeats
    sigma = float(np.median(fitted.estimate.problem.rows.sigma))
    noise = float(fitted.estimate.noise[0]) * sigma
    if repeats is None or not len(repeats.within) or repeats.freedoms[0] < FEWEST_FREEDOM:
        return
    within = float(repeats.within[0])
    if within < _SCATTER_SHARE * noise and noise >= ROUNDING_NOISE:
        yield Reason.of(Why.REPEATS_AGREE, within_m=within, noise_m=noise)


def thin(fitted: Fitted) -> tuple[Fitted, Mask]:
    """Reduce a fit to about `ENOUGH` of its rows, evenly over frames and targets.

    Args:
        fitted: Fit to N rows.

    Returns:
        The same fit with fewer rows, and True for these rows, shape (N,).
    """
    problem, estimate = fitted.estimate.problem, fitted.estimate
    chosen = problem.rows.evenly(ENOUGH)
    if np.all(chosen):
        return fitted, chosen
    rows = problem.rows.select(chosen)
    reduced = replace(
        Problem.initial(problem.kinematics, rows, problem.distances),
        weights=problem.weights[chosen],
        scales=problem.scales[chosen][:, : rows.width],
        precision=problem.precision,
        centre=problem.centre,
        rho=problem.rho,
        gauge=problem.gauge,
    )
    thinned = replace(
        estimate,
        problem=reduced,
        scores=estimate.scores[chosen],
        weights=estimate.weights[chosen],
    )
    return replace(fitted, estimate=thinned), chosen


def _order(result: CalibrationValues, chosen: Mask) -> Order:
    """Return the order in which some fitted rows were measured, with the joints' moves to them in the whole table.

    Args:
        result: The result with its table.
        chosen: True for these rows among those that were fitted, shape (N,).
    """
    m = result.measurements
    q = m.joints_for(result.nominal.joint_names)
    moves = np.diff(q, axis=0, prepend=q[:1])
    rows = np.flatnonzero(m.estimation)[chosen]
    return Order(np.array(m.rows)[rows], moves[rows])


def _missing_model(fitted: Fitted) -> Iterator[Reason]:
    """Say if full placements, or these with non-geometric errors, would lower the noise far below that of this fit."""
    rows, name = fitted.estimate.problem.rows, fitted.kinematics.model.name
    noise = least = fitted.estimate.noise[0]
    lacking = ""
    not_loaded = [family for family in joint_families() if not FAMILIES[family].loaded]
    for model in ("placement", "+".join(("placement", *not_loaded))):
        if name.startswith(model):
            continue
        of_model = _noise_of(fitted, model)
        if of_model is not None and of_model <= _FAR_LESS * least:
            least, lacking = of_model, model
    if lacking:
        unit = float(np.median(rows.sigma))
        noises = {"noise_m": unit * noise, "less_m": unit * least}
        yield Reason.of(Why.MODEL_LACKS, model=name, non_geometric=lacking, **noises)


def _noise_of(fitted: Fitted, model: str) -> float | None:
    """Return the noise that another model leaves on the rows of a fit, of the first instrument, over its sigma.

    Args:
        fitted: The fit.
        model: Name of the other model, which is fitted without frozen or tied parameters, bounds, and own priors.

    Returns:
        None where the rows have less than two scalars for each parameter.
    """
    task, rows = fitted.task, fitted.estimate.problem.rows
    free = replace(task.cell, frozen=(), ties={}, bounds={}, parameter_priors={})
    full = replace(task, model=model, cell=free, solver="lm", allow_absent=True)
    if rows.count < 2 * len(full.error_model()):
        return None
    return fit(full, rows, registered=fitted.setup).estimate.noise[0]


def noise_doubts(
    result: CalibrationValues, fitted: Fitted, doubts: tuple[Reason, ...]
) -> Iterator[Reason]:
    """Yield a reason for each instrument whose noise exceeds the stated or, without one, a usual one.

    Args:
        result: The result with its table and cell.
        fitted: The fit. Its noise is the ratio of the estimated to the given standard deviation, for each instrument.
        doubts: Doubts so far; where a model lacks something, residuals are no noise, and nothing is yielded.
    """
    codes = {doubt.why for doubt in doubts}
    if Why.MODEL_LACKS in codes:
        return
    # Nor are residuals noise that follow a joint, where no non-geometric model was tried.
    if _named_model(result) and result.non_geometric is None and Why.JOINT_PATTERN in codes:
        return
    rows = fitted.estimate.problem.rows
    for instrument, ratio in enumerate(fitted.estimate.noise):
        of_instrument, columns = np.nonzero(rows.instruments == instrument)
        if columns[0] < LENGTHS:
            yield from _length_noise(result, rows, of_instrument, float(ratio))
        else:
            yield from _angle_noise(result, rows, of_instrument, float(ratio))


def _length_noise(
    result: CalibrationValues, rows: Rows, of_instrument: Integers, ratio: float
) -> Iterator[Reason]:
    """Doubt the noise of an instrument for lengths.

    Args:
        result: The result with its table and cell.
        rows: The rows that were fitted.
        of_instrument: Indices of those that the instrument measured, from 0.
        ratio: Estimated noise over the one stated or assumed.
    """
    m, sigma = result.measurements, float(np.median(rows.sigma[of_instrument]))
    noise = ratio * sigma
    by_row = m.sigma is not None and _all_stated(m.sigma[m.estimation][of_instrument])
    if result.cell.sigma is None and not by_row:
        if noise > _LARGE_NOISE:
            yield Reason.of(Why.NOISE_LARGE, noise_m=noise)
    elif noise > _ABOVE * np.hypot(sigma, _REPEATABILITY):
        yield Reason.of(Why.NOISE_ABOVE_SIGMA, before_m=sigma, after_m=noise, ratio=noise / sigma)


def _angle_noise(
    result: CalibrationValues, rows: Rows, of_instrument: Integers, ratio: float
) -> Iterator[Reason]:
    """Doubt the noise of an instrument for angles; the arguments are those of `_length_noise`."""
    m, sigma = result.measurements, float(np.median(rows.sigma_angle[of_instrument]))
    noise = ratio * sigma
    by_row = m.sigma_angle is not None and _all_stated(m.sigma_angle[m.estimation][of_instrument])
    if result.cell.sigma_angle is None and not by_row:
        return
    if noise > _ABOVE * np.hypot(sigma, _REPEATABILITY_ANGLE):
        yield Reason.of(
            Why.NOISE_ABOVE_SIGMA, before_rad=sigma, after_rad=noise, ratio=noise / sigma
        )


def _all_stated(sigma: Array) -> bool:
    """Tell if each of some rows states its noise."""
    return bool(np.all(np.isfinite(sigma)))


def _corner(fitted: Fitted) -> Iterator[Reason]:
    """Say if the poses cover only part of the joints' ranges, or a corner of the workspace, and which.

    Joints that hardly moved are named by themselves.
    """
    robot, rows = fitted.task.robot, fitted.estimate.problem.rows
    q = rows.joints[fitted.estimate.weights > 0.0]
    measured_tips = robot.poses(q)[:, :3, 3]
    possible_tips = robot.poses(spread_poses(robot))[:, :3, 3]
    spread = spread_of(measured_tips, possible_tips)
    shares = shares_of_ranges(q, column_ranges(robot), [j.type for j in robot.inputs])
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
        lows=[float(q[:, j].min()) for j in narrow],
        highs=[float(q[:, j].max()) for j in narrow],
        slides=[robot.inputs[j].type == "prismatic" for j in narrow],
    )
