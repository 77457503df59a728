"""Doubts about a result besides its errors: given values, coverage of the poses, and residuals of its best model."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import compress

import numpy as np

from calib.basics.channels import RESIDUAL_UNITS
from calib.data.measurements import Measurements
from calib.diagnosis.augmented_fit import FEWEST_FREEDOM, thin
from calib.diagnosis.computed import ROUNDING_NOISE, computed_measurements
from calib.diagnosis.coverage import doubtful_views, partial_coverage, sole_postures, still_joints
from calib.diagnosis.judge import FAR_LESS
from calib.diagnosis.late_joints import late_joints
from calib.diagnosis.reasons import Reason, Why
from calib.diagnosis.residual_patterns import residual_patterns
from calib.diagnosis.stated_values import contradicted_values
from calib.diagnosis.stations import disagreeing_stations, flagged_station
from calib.diagnosis.usual_mistakes import doubtful_senses
from calib.diagnosis.variant import length_intervals, other_variant
from calib.fit.estimate.fitting import Fitted, fit
from calib.fit.estimate.special_cases.arm_size import measures_length
from calib.fit.estimate.special_cases.hands_alone import hands_alone
from calib.fit.registration.rows import Rows
from calib.model.families import FAMILIES, joint_families
from calib.numerics.errors import interval_factor
from calib.numerics.solvers import has_weights_and_priors
from calib.result.calibration import Calibration
from calib.robot.flange import is_flange_robot

#: The model lacks something if repeats scatter by less than this share of the noise.
_SCATTER_SHARE = 0.5

#: Noise more than so many times the one stated is not the instrument's, and one that is as much smaller was misstated.
CONTRADICTED = 5.0

#: A robot that stops no better than it does explains residuals up to so many times the stated noise: the best
#: instruments have a hundredth of a robot's repeatability.
_FAR_ABOVE = 100.0

#: So many rows tell the noise by a larger model to a few percent: if they show that it is not far less, no more are
#: fitted.
_TELLING_ROWS = 600

#: By this factor above the limit it surely is not.
_SURELY = 1.3

#: A target that is estimated farther than this from where it was given was given wrongly [m].
_ELSEWHERE = 5e-3


def find_doubts(result: Calibration, rows: Rows, patterns: tuple[Reason, ...]) -> Iterator[Reason]:
    """Find the reasons for doubt about a result besides its errors.

    They concern the fit of the non-geometric model if the result has one, else that of the geometry.

    Args:
        result: A result in memory, with its measurements and fits.
        rows: The rows that were fitted.
        patterns: Those in the residuals of that fit, see `patterns_in_table`.

    Yields:
        Reasons, each a code with the numbers of its sentence in SI units, in the order of the report.
    """
    m, cell = result.fit.measurements, result.fit.cell
    fitted = result.fit.non_geometric or result.fit.geometry

    # Targets that the user gave and that were estimated far from there.
    given, setup = result.nominal_setup, result.setup
    for t, name in enumerate(setup.targets):
        if setup.target_given[t] and setup.target_unknown[t]:
            change = setup.T_tip_target[t, :3, 3] - given.T_tip_target[t, :3, 3]
            distance = float(np.linalg.norm(change))
            if distance > _ELSEWHERE:
                yield Reason.of(Why.TARGET_FAR, target=name, far_m=distance)

    yield from late_in_table(result.fit.geometry, m)
    yield from computed_measurements(fitted)
    # Errors that a larger model explains move no lengths in it.
    scale = (result.non_geometric or result.geometry).scale
    corrected = fitted.kinematics.model.apply(result.nominal, fitted.estimate.x)
    intervals = partial(length_intervals, fitted, scale)
    yield from other_variant(result.nominal, corrected, intervals)

    few, _ = thin(fitted)
    if all(kind.of_joint for kind in rows.present):
        yield _stops_alone(result, m)
        yield from _agreeing_repeats(result, fitted)
        return
    yield from contradicted_values(few, scale)
    yield from doubtful_views(fitted)
    is_flange = is_flange_robot(result.nominal.joint_names)
    if not is_flange:
        yield from doubtful_senses(result.nominal, cell, m.select(m.estimation))
    yield from still_joints(fitted.task.robot, rows)
    if has_weights_and_priors(result.method.solver):
        images = list(compress(m.images, m.estimation))
        yield from sole_postures(result.fit.geometry, np.array(m.rows)[m.estimation], images)
    if _is_named_model(result) and not is_flange:
        yield from _missing_model(few)
    yield from partial_coverage(few)
    yield from patterns
    yield from disagreeing_stations(few)
    yield from flagged_station(fitted)
    yield from _agreeing_repeats(result, fitted)
    if not measures_length(rows, fitted.task.distances):
        alone = hands_alone(rows.present, result.nominal)
        yield Reason.of(Why.HANDS_ALONE if alone else Why.NO_LENGTH)


def _stops_alone(result: Calibration, measurements: Measurements) -> Reason:
    """Say that the rows are of joints at their stops alone, of which joints, and which others turn."""
    stopped = list(dict.fromkeys(measurements.targets))
    turning = [j.name for j in result.nominal.urdf.joints if j.type in ("revolute", "continuous")]
    others = [name for name in turning if name not in stopped]
    return Reason.of(Why.STOPS_ALONE, joints=", ".join(stopped), not_stopped=others)


def patterns_in_table(fitted: Fitted, measurements: Measurements) -> Iterator[Reason]:
    """Find the patterns in the residuals of a fit to the rows of a table, see `residual_patterns`.

    Args:
        fitted: A fit to the estimation rows; of many, some are looked at.
        measurements: The table. Joints moved to a row from the one before, whatever its set.

    Yields:
        A reason for each pattern.
    """
    few, chosen = thin(fitted)
    in_table = np.flatnonzero(measurements.estimation)[chosen]
    moves = measurements.moves_for(fitted.task.robot.joint_names)[in_table]
    yield from residual_patterns(few, np.array(measurements.rows)[in_table], moves)


def late_in_table(geometry: Fitted, measurements: Measurements) -> Iterator[Reason]:
    """Say if the joint values of a table are of another time than what was measured, see `late_joints`.

    Args:
        geometry: A fit of the geometry to the estimation rows; of many, some are looked at.
        measurements: The table.

    Yields:
        At most one reason.
    """
    few, chosen = thin(geometry)
    q = measurements.joints_for(geometry.task.robot.joint_names)
    yield from late_joints(few, q, np.flatnonzero(measurements.estimation)[chosen])


def _is_named_model(result: Calibration) -> bool:
    """Return whether the user of a result named its model, and the solver has priors: no larger model was tried."""
    return not result.method.candidates and has_weights_and_priors(result.method.solver)


def noise_doubts(
    result: Calibration, fitted: Fitted, doubts: tuple[Reason, ...]
) -> Iterator[Reason]:
    """Yield a reason for each channel whose estimated noise is far from the stated or, without one, above a usual one.

    Args:
        result: The result with its table and cell in memory, which may state the noise.
        fitted: One of its fits.
        doubts: Doubts so far. If a model lacks something, large residuals are not noise, and not named; nor if those of
            a named geometry follow a joint, or the non-geometric model leaves far smaller ones.

    Yields:
        A reason with the noise of a scalar as stated and as estimated, in the channel's unit [m], [rad] or [px], and
        their ratio if the latter is too large; if none is stated, the estimated noise alone.
    """
    codes = {doubt.why for doubt in doubts}
    # Residuals that follow a joint are not noise either, if no non-geometric model was tried.
    unexplained = _is_named_model(result) and result.non_geometric is None
    lacking = Why.MODEL_LACKS in codes or (unexplained and Why.JOINT_PATTERN in codes)

    m, rows = result.fit.measurements, fitted.estimate.problem.rows
    best = result.fit.non_geometric or fitted
    left = best.estimate.problem.noise_over_sigma.tolist()
    for c, ratio in enumerate(fitted.estimate.problem.noise_over_sigma.tolist()):
        of_channel, _ = np.nonzero(rows.channels.index == c)
        symbol = rows.channels.units[c]
        unit = RESIDUAL_UNITS[symbol]
        sigma = float(np.median(rows.sigma[symbol][of_channel]))
        noise = ratio * sigma
        is_explained = lacking or left[c] <= FAR_LESS * ratio

        stated = symbol in result.fit.cell.sigma
        if symbol in m.stated_sigma:
            by_row = m.stated_sigma[symbol][m.estimation][of_channel]
            stated |= bool(np.all(np.isfinite(by_row)))
        sizes = {f"before_{symbol}": sigma, f"after_{symbol}": noise}
        if not stated:
            if noise > unit.large_noise and not is_explained:
                yield Reason.of(Why.NOISE_LARGE, **{f"noise_{symbol}": noise})
        elif noise > CONTRADICTED * np.hypot(sigma, unit.repeatability):
            if not is_explained:
                yield Reason.of(Why.NOISE_ABOVE_SIGMA, **sizes, ratio=noise / sigma)
        elif sigma > CONTRADICTED * noise or noise > _FAR_ABOVE * sigma:
            yield Reason.of(Why.SIGMA_UNLIKELY, **sizes)


# What the model lacks


def _missing_model(fitted: Fitted) -> Iterator[Reason]:
    """Say if full placements, or these with non-geometric errors, would lower the noise of a fit to `FAR_LESS`.

    The reason has the name of the larger model that leaves the least noise, and the noise of the first channel by both
    models, such as ``noise_m`` and ``less_m`` [m].
    """
    rows, name = fitted.estimate.problem.rows, fitted.kinematics.model.name
    noise = least = float(fitted.estimate.problem.noise_over_sigma[0])
    lacking = ""
    not_loaded = [family for family in joint_families() if not FAMILIES[family].loaded]
    free = replace(fitted.task.cell, frozen=(), ties={}, bounds={}, parameter_priors={})
    for model in ("placement", "+".join(("placement", *not_loaded))):
        task = replace(fitted.task, model=model, cell=free, solver="lm", allow_absent=True)
        parameters = len(task.error_model())
        if name.startswith(model) or rows.count < 2 * parameters:
            continue
        some = rows.select(rows.evenly(_TELLING_ROWS))
        if len(some) < len(rows) and some.count >= 4 * parameters:
            by_some = fit(task, some, registered=fitted.setup).estimate.problem.noise_over_sigma[0]
            if by_some > _SURELY * FAR_LESS * least:
                continue
        larger = fit(task, rows, registered=fitted.setup)
        of_larger = float(larger.estimate.problem.noise_over_sigma[0])
        if of_larger <= FAR_LESS * least:
            least, lacking = of_larger, model
    if lacking:
        unit = rows.channels.units[0]
        sigma = float(np.median(rows.sigma[unit]))
        noises = {f"noise_{unit}": sigma * noise, f"less_{unit}": sigma * least}
        yield Reason.of(Why.MODEL_LACKS, model=name, non_geometric=lacking, **noises)


def negative_compliances(fitted: Fitted) -> Iterator[Reason]:
    """Find joints that a non-geometric model moves against their load.

    The errors of a joint in a family that cannot be negative, such as its compliance or its rotations by masses at
    several points, add up to what all of its load does: a mass beside these points is a combination of them whose
    shares add up to one, but may be negative. So their sum has to be positive.

    Args:
        fitted: The fit of the model.

    Yields:
        A reason for each joint and family whose sum is negative by more than twice its interval of 95 %: there are as
        many chances as joints.
    """
    estimate, model = fitted.estimate, fitted.kinematics.model
    joints: dict[tuple[str, str], list[int]] = {}
    for k, parameter in enumerate(model.parameters):
        family = FAMILIES.get(parameter.family)
        if family is not None and family.positive:
            joints.setdefault((parameter.place, family.name), []).append(k)
    for (place, name), columns in joints.items():
        if set(columns) & set(estimate.at_bound):  # the user's
            continue
        total = float(np.sum(estimate.x[columns]))
        std = float(np.sqrt(np.sum(estimate.covariance[np.ix_(columns, columns)])))
        if total + 2.0 * interval_factor(estimate.freedom) * std < 0.0:
            yield Reason.of(Why.COMPLIANCE_NEGATIVE, joint=place, family=name)


def _agreeing_repeats(result: Calibration, fitted: Fitted) -> Iterator[Reason]:
    """Say if repeats of a pose agree far better with each other than with the model, which then lacks something.

    With few repeats, or residuals that are rounding, nothing is said. The reason has the scatter and the noise of the
    first channel, such as ``within_m`` and ``noise_m`` [m].
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
