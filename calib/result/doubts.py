"""Doubts about a result besides its errors: what was given, how it was measured, the residuals of its best model."""

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
from calib.units import Mask

#: The rows hardly determine a joint's errors where it moves less than this [rad], [m].
_STILL_RAD = 0.35
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

#: The repeatability of arms, which adds to the stated noise: of the measurements' attribute, its unit [m], [rad].
_REPEATABILITY = ("sigma", "m", 3e-5), ("sigma_angle", "rad", 1e-4)

#: No arm is off by more than this share in all its lengths: a larger one is the instrument's scale error.
_SCALED = 2e-3

#: A base that has moved is named where its effect on the rows is more than this share of that of the arm's corrections.
_LIKE_THE_ARM = 0.5

#: A target found further than this from where it was given was given wrongly [m].
_ELSEWHERE = 5e-3

#: A joint was measured in a part of its range where it used less than this share of it.
_NARROW = 1.0 / 3.0


def doubts_of(result: CalibrationValues, rows: Rows) -> tuple[Reason, ...]:
    """List what speaks against a result besides its errors: see the module."""
    return tuple(_doubts(result, result.fit_in_memory.non_geometric or result.fitted, rows))


def _doubts(result: CalibrationValues, fitted: Fitted, rows: Rows) -> Iterator[Reason]:
    """See `doubts_of`."""
    few, chosen = thin(fitted)
    yield from _given(result, few)
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
    """Whether the model was named, so that a larger one was not tried."""
    return not result.candidates and result.solver != PAPER


def _given(result: CalibrationValues, fitted: Fitted) -> Iterator[Reason]:
    """Doubt a given target, a known frame, or the instrument's scale."""
    given, found = result.nominal_setup, result.setup
    for t, name in enumerate(found.targets):
        if not (found.target_given[t] and found.target_unknown[t]):
            continue
        far = float(np.linalg.norm(found.T_tip_target[t, :3, 3] - given.T_tip_target[t, :3, 3]))
        if far > _ELSEWHERE:
            yield Reason.of(Why.TARGET_FAR, target=name, far_m=far)
    if not priors_from_data(fitted):
        return
    base = motion_of_base(fitted)
    if base is not None and base.p < UNLIKELY and base.effect > _LIKE_THE_ARM * base.effect_of_arm:
        values = {"moved_m": base.moved, "turned_rad": base.turned}
        effects = {"effect_m": base.effect, "arm_m": base.effect_of_arm}
        yield Reason.of(Why.BASE_MOVED, **values, **effects)
    scale = instrument_scale(fitted)
    if scale is None:
        return
    if abs(scale.share) > _SCALED and scale.p < FALSE_ALARM:
        yield Reason.of(Why.LENGTHS_SCALED, scale=scale.share, std=scale.std, p=scale.p)
    elif scale.measured and not result.cell.scale_certified:
        values = {"scale": scale.hidden, "reach_m": scale.reach}
        yield Reason.of(Why.SCALE_HIDDEN, **values, effect_m=scale.hidden * scale.reach)


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
    names = np.array(m.rows)[m.estimation]
    low, high = column_ranges(robot).T
    sole, found = ~rows.checked, {}
    for block in np.unique(rows.blocks[sole]).tolist():
        own = rows.blocks == block
        i = int(np.flatnonzero(own)[0])
        apart = np.abs(rows.joints[~own] - rows.joints[i]).min(axis=0) / (high - low)
        found[int(names[i])] = robot.joint_names[int(np.argmax(apart))]
    if found:
        yield Reason.of(Why.SOLE_POSTURE, rows=list(found), joints=list(found.values()))


def _negative_compliances(result: CalibrationValues) -> Iterator[Reason]:
    """Name joints that would move against their load."""
    for one in result.non_geometric.parameters if result.non_geometric else ():
        # Twice as far as its interval reaches: there are as many chances as joints.
        if one.name.endswith(".compliance") and 2.0 * one.high < one.value:
            yield Reason.of(Why.COMPLIANCE_NEGATIVE, joint=one.name.removesuffix(".compliance"))


def _agreeing_repeats(result: CalibrationValues, fitted: Fitted) -> Iterator[Reason]:
    """Say if repeats agree far better with each other than with the model."""
    sigma = float(np.median(fitted.estimate.problem.rows.sigma))
    repeats, noise = result.repeats, float(fitted.estimate.noise[0]) * sigma
    if repeats is None or not len(repeats.within) or repeats.freedoms[0] < FEWEST_FREEDOM:
        return
    within = float(repeats.within[0])
    if within < _SCATTER_SHARE * noise and noise >= ROUNDING_NOISE:
        yield Reason.of(Why.REPEATS_AGREE, within_m=within, noise_m=noise)


def thin(fitted: Fitted) -> tuple[Fitted, Mask]:
    """Reduce a fit to about `ENOUGH` of its rows, evenly over frames and targets; also which these are, (N,)."""
    problem, estimate = fitted.estimate.problem, fitted.estimate
    some = problem.rows.evenly(ENOUGH)
    if np.all(some):
        return fitted, some
    rows = problem.rows.select(some)
    few = replace(
        Problem.initial(problem.kinematics, rows, problem.distances),
        weights=problem.weights[some],
        scales=problem.scales[some][:, : rows.width],
        precision=problem.precision,
        centre=problem.centre,
        rho=problem.rho,
        gauge=problem.gauge,
    )
    scores, weights = estimate.scores[some], estimate.weights[some]
    thinned = replace(estimate, problem=few, scores=scores, weights=weights)
    return replace(fitted, estimate=thinned), some


def _order(result: CalibrationValues, chosen: Mask) -> Order:
    """The order in which the chosen rows were measured, and the joints' moves to them in the whole table."""
    m = result.measurements
    q = m.joints_for(result.nominal.joint_names)
    moves = np.diff(q, axis=0, prepend=q[:1])
    rows = np.flatnonzero(m.estimation)[chosen]
    return Order(np.array(m.rows)[rows], moves[rows])


def _missing_model(fitted: Fitted) -> Iterator[Reason]:
    """Say if full placements, or these with non-geometric errors, would lower the noise far below that of this fit."""
    task, rows, name = fitted.task, fitted.estimate.problem.rows, fitted.kinematics.model.name
    free = replace(task.cell, frozen=(), ties={}, bounds={}, parameter_priors={})
    own = [f for f in joint_families() if not FAMILIES[f].loaded]
    least, lacking = fitted.estimate.noise[0], ""
    for model in ("placement", "+".join(("placement", *own))):
        full = replace(task, model=model, cell=free, solver="lm", allow_absent=True)
        if name.startswith(model) or rows.count < 2 * len(full.error_model()):
            continue
        noise = fit(full, rows, registered=fitted.setup).estimate.noise[0]
        if noise <= _FAR_LESS * least:
            least, lacking = noise, model
    if lacking:
        unit = float(np.median(rows.sigma))
        noises = {"noise_m": unit * fitted.estimate.noise[0], "less_m": unit * least}
        yield Reason.of(Why.MODEL_LACKS, model=name, non_geometric=lacking, **noises)


def noise_doubts(
    result: CalibrationValues, fitted: Fitted, doubts: tuple[Reason, ...]
) -> Iterator[Reason]:
    """Say if the noise of a fit is above the one stated, or, where none is stated, above that of instruments."""
    codes = {doubt.why for doubt in doubts}
    if Why.MODEL_LACKS in codes:
        return
    # Nor are residuals noise that follow a joint, where no non-geometric model was tried.
    if _named_model(result) and result.non_geometric is None and Why.JOINT_PATTERN in codes:
        return
    rows, m = fitted.estimate.problem.rows, result.measurements
    for c, ratio in enumerate(fitted.estimate.noise):
        own, columns = np.nonzero(rows.instruments == c)
        name, unit, repeatability = _REPEATABILITY[int(columns[0] >= LENGTHS)]
        by_row, sigma = getattr(m, name), float(np.median(getattr(rows, name)[own]))
        noise, stated = float(ratio) * sigma, getattr(result.cell, name) is not None
        stated |= by_row is not None and bool(np.all(np.isfinite(by_row[m.estimation][own])))
        if stated and noise > _ABOVE * np.hypot(sigma, repeatability):
            values = {f"before_{unit}": sigma, f"after_{unit}": noise, "ratio": noise / sigma}
            yield Reason.of(Why.NOISE_ABOVE_SIGMA, **values)
        elif not stated and unit == "m" and noise > _LARGE_NOISE:
            yield Reason.of(Why.NOISE_LARGE, noise_m=noise)


def _corner(fitted: Fitted) -> Iterator[Reason]:
    """Say if the poses cover only part of the joints' ranges, or a corner of the workspace, and which.

    Joints that hardly moved are named by themselves.
    """
    robot, rows = fitted.task.robot, fitted.estimate.problem.rows
    q = rows.joints[fitted.estimate.weights > 0.0]
    spread = spread_of(*(robot.poses(one)[:, :3, 3] for one in (q, spread_poses(robot))))
    shares = shares_of_ranges(q, column_ranges(robot), [j.type for j in robot.inputs])
    moved = ~_hardly_moved(robot, rows)
    narrow = np.flatnonzero((shares < _NARROW) & moved).tolist()
    if not np.any(moved) or (spread >= _CORNER and not narrow):
        return
    least = int(np.argmin(np.where(moved, shares, np.inf)))
    narrow = sorted(narrow or [least], key=lambda j: shares[j])
    yield Reason.of(
        Why.CORNER,
        spread=spread,
        joints=[robot.joint_names[j] for j in narrow],
        shares=[float(shares[j]) for j in narrow],
        lows=[float(q[:, j].min()) for j in narrow],
        highs=[float(q[:, j].max()) for j in narrow],
        slides=[robot.inputs[j].type == "prismatic" for j in narrow],
    )
