"""The verdicts on a result: all figures that they rest on are collected, and judged."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

import calib.data.kinds as registry
from calib.basics.arrays import Array, Mask
from calib.basics.channels import Channels
from calib.diagnosis.evidence import Evidence, ValidationErrors
from calib.diagnosis.judge import judge
from calib.diagnosis.judge_setup import judge_setup
from calib.diagnosis.reasons import NO, Reason, Role, Verdict, Why
from calib.fit.estimate.fitting import Fitted
from calib.fit.estimate.special_cases.hands_alone import hands_alone
from calib.fit.registration.rows import Rows
from calib.model.error_model import FRAME, MOUNT, TARGET
from calib.model.error_on_chain import model_on_chain
from calib.numerics.errors import Errors
from calib.numerics.moves import common_side
from calib.numerics.rigid_motion import without_rigid_motion
from calib.result.calibration import Calibration
from calib.result.chains import ChainResult, evidence_of_chain, result_of_chain, verdict_with_chains
from calib.result.doubts import find_doubts, negative_compliances, noise_doubts
from calib.result.fitted_model import FittedModel
from calib.robot.ranges import spread_poses

#: A share of validation rows up to which those that do not fit are set aside as accidents.
_FEW_SUSPECTS = 0.15

#: Parameters of a full geometry for each joint.
_PER_JOINT = 4


def add_verdicts(
    result: Calibration,
    rows: Rows,
    patterns: tuple[Reason, ...],
    found: tuple[Reason, ...] = (),
) -> Calibration:
    """Return a result with the verdicts on its geometry and on its non-geometric model.

    Args:
        result: A cross-validated result, with its measurements and fits in memory.
        rows: The rows that were fitted.
        patterns: Those in the residuals of its best fit, see `calib.result.doubts.patterns_in_table`.
        found: What was found before the fit: doubts, and what only informs, to be stated with the rest of the geometry.

    Returns:
        The same result, each fitted model with its verdict.
    """
    notes = tuple(reason for reason in found if reason.why.role is Role.INFORMATION)
    before = (reason for reason in found if reason.why.role is not Role.INFORMATION)
    doubts = (*before, *find_doubts(result, rows, patterns))
    larger, of_larger = result.non_geometric, result.fit.non_geometric
    usable = None
    if larger is not None and of_larger is not None:
        # A URDF holds no compliance: what is odd about one is no doubt about the geometry.
        of_bending = tuple(negative_compliances(of_larger))
        every_doubt = (*doubts, *of_bending)
        evidence = _collect_evidence(result, larger, of_larger, larger.residual, rows, every_doubt)
        verdict = judge(evidence)
        result = replace(result, non_geometric=replace(larger, verdict=verdict))
        if verdict.use != NO:
            usable = larger.name, evidence.after

    geometry, fitted = result.geometry, result.fit.geometry
    residual = result.rows.residual_calibrated
    evidence = _collect_evidence(result, geometry, fitted, residual, rows, doubts)
    every_note = (*notes, *without_explained(_notes(result), doubts))
    evidence = replace(evidence, notes=every_note, non_geometric=usable)
    if result.is_setup_only:
        verdict = _judge_setup(result, evidence)
        return replace(result, geometry=replace(geometry, verdict=verdict))
    chains = tuple(_chains(result, evidence, rows))
    verdict = verdict_with_chains(judge(evidence), chains)
    trust = replace(result.trust, chains=chains)
    return replace(result, geometry=replace(geometry, verdict=verdict), trust=trust)


def _chains(result: Calibration, evidence: Evidence, rows: Rows) -> Iterator[ChainResult]:
    """Yield what the geometry is worth for each chain of a robot that has several.

    ``evidence`` is that of all ``rows`` that were fitted.
    """
    robot, geometry = result.nominal, result.geometry
    if not robot.branches:
        return
    samples = rows.samples
    for number, chain in enumerate(robot.chains):
        first = samples.rows_of_chain(number)[:1]
        # Of validation rows alone, or of one joint at its stops, which is no arm.
        if not len(first) or rows.where(lambda kind: kind.of_joint)[first[0]]:
            continue
        seen = (int(samples.frame[first[0]]), int(samples.target[first[0]]))
        expected = _expected_over_limits(result, geometry, *seen)
        on_chain = model_on_chain(geometry.model, robot, chain)
        moves = geometry.model.of_robot & np.any(on_chain.mixing != 0.0, axis=0)
        of_chain = evidence_of_chain(evidence, rows, number, moves, geometry.x, expected)
        yield result_of_chain(chain.base, chain.tip, of_chain)


def _judge_setup(result: Calibration, evidence: Evidence) -> Verdict:
    """Judge frames and targets: collect which of their parameters the rows leave open, and how certain the others are.

    The uncertainty is the largest half-width of a 95 % interval, of a length [m] and of an angle [rad].
    """
    model = result.geometry.model
    of_setup = model.family(FRAME, TARGET, MOUNT)
    open_ones = of_setup & ~result.trust.observability.identifiable
    located = {}
    for unit in ("m", "rad"):
        halves = [
            0.5 * (estimate.high - estimate.low)
            for estimate, parameter, is_place in zip(
                result.geometry.parameters, model.parameters, of_setup, strict=True
            )
            if is_place and parameter.unit == unit
        ]
        if halves:
            located[f"located_{unit}"] = max(halves)
    m, rows = result.fit.measurements, result.rows
    chosen = m.estimation.copy()
    chosen[np.flatnonzero(chosen)[evidence.outliers]] = False
    return judge_setup(
        evidence,
        Errors.of(rows.residual_calibrated[chosen], rows.channels.select(chosen)),
        [name for name, is_open in zip(model.names, open_ones, strict=True) if is_open],
        Reason.of(
            Why.SETUP_LOCATED,
            **located,
            after=evidence.after,
            method=evidence.calibrated.method,
            outliers=evidence.flagged,
        ),
    )


def _collect_evidence(
    result: Calibration,
    model: FittedModel,
    fitted: Fitted,
    residual: Array,
    rows: Rows,
    doubts: tuple[Reason, ...],
) -> Evidence:
    """Collect the evidence on a model of a cross-validated result.

    ``fitted`` is the model's fit, ``residual``, shape (N, D), measured minus predicted by it at all rows of the table,
    ``rows`` are those that were fitted, and ``doubts`` the findings besides errors, to which those of noise are added.
    """
    assert result.trust.nominal_cross_validation is not None
    assert model.cross_validation is not None
    of_robot = model.model.of_robot
    lengths_and_angles = of_robot & np.isin(model.model.units, ("m", "rad"))
    changes = np.abs(model.x[lengths_and_angles])
    expected, expected_of_nominal, by_scale = _expected_over_limits(result, model)

    # Repeats of one measurement, and the corners of one image, have one number.
    labels = np.column_stack([rows.is_image, np.where(rows.is_image, rows.blocks, rows.poses)])
    _, repeats = np.unique(labels, axis=0, return_inverse=True)

    full_model_parameters = 0
    if result.method.candidates:  # the data chose the model
        full_model_parameters = _PER_JOINT * len(result.nominal.inputs) + fitted.setup.count

    m = result.fit.measurements
    suspects = [suspect.row for suspect in result.rows.suspects]
    validation = compare_validation_errors(
        m.validation,
        np.isin(m.rows, suspects),
        result.rows.residual_nominal,
        residual,
        result.rows.channels,
    )
    return Evidence(
        nominal=result.trust.nominal_cross_validation,
        calibrated=model.cross_validation,
        scales=fitted.estimate.problem.scales,
        used=rows.used,
        floor=_noise_floor(result, fitted, doubts),
        repeats=repeats.reshape(-1),
        pairs=rows.partner >= 0,
        outliers=result.fit.geometry.estimate.outliers,
        validation=validation,
        doubts=(*noise_doubts(result, fitted, doubts), *doubts),
        images=rows.is_image,
        parameters=len(model.model) - len(model.model.internals),
        full_model_parameters=full_model_parameters,
        changes=bool(np.any(model.x[of_robot])),
        largest=float(np.max(changes, initial=0.0)),
        noise=result.noise.sigma,
        expected=expected,
        expected_of_nominal=expected_of_nominal,
        by_scale=by_scale,
        scale=0.0 if model.scale is None else model.scale.size,
    )


def _noise_floor(result: Calibration, fitted: Fitted, doubts: tuple[Reason, ...]) -> Array:
    """Return the least noise by any model tried over that of a fit, for each scalar, shape (N, D), above 0, at most 1.

    Noise of each channel, as a multiple of the stated sigma, is compared. The part of a fit's noise that exceeds it is
    lack of model.
    """
    problem = fitted.estimate.problem
    fits = (result.fit.geometry, result.fit.non_geometric)
    of_fits = [fit.estimate.problem.noise_over_sigma for fit in fits if fit is not None]
    least = np.min(of_fits, axis=0)
    share = np.minimum(least / problem.noise_over_sigma, 1.0)
    for doubt in doubts:
        if doubt.why is Why.MODEL_LACKS:  # states the noise of the first channel by a larger model
            unit = problem.rows.channels.units[0]
            share_of_larger_model = doubt.values[f"less_{unit}"] / doubt.values[f"noise_{unit}"]
            share[0] = min(share[0], share_of_larger_model)
    # Scalars that were not measured have the channel -1, the last one.
    by_channel = np.append(share, 1.0)
    return np.asarray(by_channel[problem.rows.channels.index])


def _expected_over_limits(
    result: Calibration, model: FittedModel, frame: int = 0, target: int = 0
) -> tuple[float, float, float]:
    """Return expected errors over the joint limits, rms [m]: of a model, of the nominal robot, and the scale's part.

    They are those of one target seen from one frame, by their indices in the setup.

    The squares, mean over 200 joint values, are

        of the model:          v_0 + w + (m^2 + u) |J g|^2
        of the nominal robot:  max(d^2 - (w - (v - v_0)) + v, v_0 + w) + u |J g|^2

    with the variance v of a predicted position, v_0 at the measured poses, and the variance w that is added to this
    beyond them (`FittedModel.added_variance`). Both robots are d apart, of which w - (v - v_0) is error of the model
    that its covariance lacks. A scale error of the instrument, with the mean m and the variance u, changes the
    parameters by the growth g each; d is then that from the model less m g. If all of the model's changes are scale,
    the nominal robot is right, and off by less than the model.

    If the frame was estimated, or no row determines where the base stands, rigid motions of all positions do not count;
    but for hands that contacts alone relate, of which the pose of one in the other counts.
    """
    samples = result.samples(
        spread_poses(result.nominal),
        group=result.setup.groups[frame],
        target=result.setup.targets[target],
    )
    # T_frame_target, (N, 4, 4), and the derivatives of its position by the p parameters, (N, 3, p).
    poses, J = model.kinematics.twists(model.x, samples, rotation=False)
    T_base_tip = result.nominal.poses(samples.q, samples.chain)
    nominal_points = result.nominal_setup.target_poses(T_base_tip, samples)[:, :3, 3]
    points = poses[:, :3, 3]
    away = (nominal_points - points)[:, :, None]
    growth = np.zeros((len(points), 3, 1))
    mean = variance = 0.0
    if model.scale is not None:
        growth = J @ model.scale.growth[:, None]
        mean, variance = model.scale.mean, model.scale.variance
    kinds = [registry.get(name) for name in set(result.rows.kinds)]
    moves_freely = result.method.frame_estimated or not result.rows.tells_place
    if moves_freely and not hands_alone(kinds, result.nominal):
        away = without_rigid_motion(points, away)
        growth = without_rigid_motion(points, growth)
        J = without_rigid_motion(points, J)
    away = away + mean * growth
    growth_square = float(np.mean(np.sum(growth**2, axis=(1, 2))))
    d_square = float(np.mean(np.sum(away**2, axis=(1, 2))))
    v = float(np.mean(np.einsum("nip,pq,niq->n", J, model.covariance, J, optimize=True)))
    v_0 = min(model.noise_measured**2, v)
    added = model.added_variance(v - v_0)
    # Each without the scale error; only then may the nominal robot be the better one.
    of_model = v_0 + added
    of_nominal = max(d_square - (added - (v - v_0)) + v, of_model)
    by_scale = (mean**2 + variance) * growth_square
    return (
        float(np.sqrt(of_model + by_scale)),
        float(np.sqrt(of_nominal + variance * growth_square)),
        float(np.sqrt(by_scale)),
    )


def compare_validation_errors(
    validation: Mask, suspects: Mask, nominal: Array, calibrated: Array, channels: Channels
) -> ValidationErrors:
    """Compare errors on the validation rows, without suspects if they are few (`accidents`).

    Args:
        validation: True for validation rows, shape (N,).
        suspects: True for rows whose score is beyond the limit, shape (N,).
        nominal: Measured minus predicted by the nominal robot, shape (N, D).
        calibrated: The same by the calibrated robot.
        channels: The channels of the residuals.

    Returns:
        Errors of both robots without the rows that were set aside, the number of these, and the calibrated robot's
        errors on all validation rows.
    """
    aside = accidents(validation, suspects)
    chosen = validation & ~aside
    return ValidationErrors(
        before=Errors.of(nominal[chosen], channels.select(chosen)),
        after=Errors.of(calibrated[chosen], channels.select(chosen)),
        aside=int(np.sum(aside)),
        whole=Errors.of(calibrated[validation], channels.select(validation)),
    )


def accidents(validation: Mask, suspects: Mask) -> Mask:
    """Return which validation rows are set aside as accidents, shape (N,).

    One wild row would decide what the others show; many of them are not accidents, and count. Few are no more than one,
    or `_FEW_SUSPECTS` of the validation rows, but not all.

    Args:
        validation: True for validation rows, shape (N,).
        suspects: True for rows whose score is beyond the limit, shape (N,).
    """
    aside = suspects & validation
    many = np.sum(suspects) > max(1, int(_FEW_SUSPECTS * np.sum(validation)))
    if many or np.array_equal(aside, validation):
        return np.zeros_like(suspects)
    return aside


def _lags(model: FittedModel) -> Iterator[Reason]:
    """Yield a reason for each family of lost motion that a model has: the joint that lags most, and by how much.

    Joints whose interval contains zero do not count.
    """
    for why, family in ((Why.STOPS_SHORT, "lost_motion"), (Why.CREEPS, "creep")):
        suffix = f".{family}"
        found = [p for p in model.parameters if p.name.endswith(suffix) and p.low * p.high > 0.0]
        if found:
            # Radians of turning joints and metres of sliding ones: a radian moves the tip by about a metre.
            largest = max(found, key=lambda p: abs(p.value))
            size = {"rad": "lag_rad", "m": "lag_m"}.get(largest.unit, "lag_share")
            values = {size: largest.value, "others_short": len(found) - 1}
            yield Reason.of(why, joint=largest.name.removesuffix(suffix), **values)


def without_explained(notes: Iterable[Reason], doubts: Iterable[Reason]) -> tuple[Reason, ...]:
    """Leave out joints that creep if joint values are late: both look alike along a path, and the doubt is tested.

    Args:
        notes: Reasons that only inform.
        doubts: Findings besides errors.

    Returns:
        The other notes, in their order.
    """
    is_late = any(doubt.why is Why.JOINTS_LATE for doubt in doubts)
    return tuple(note for note in notes if not (is_late and note.why is Why.CREEPS))


def _notes(result: Calibration) -> Iterator[Reason]:
    """Yield reasons that only inform: a non-geometric model, its lost motion, rows left out or changed or far away.

    Of the rows outside of the fitted ranges it states how many there are, and joint and distance [rad] or [m] of the
    farthest; the non-geometric model is stated only if it has a verdict.
    """
    larger, validated = result.non_geometric, result.cross_validation
    if larger is not None and larger.cross_validation is not None and larger.verdict is not None:
        errors = larger.cross_validation.errors_without_outliers
        # Over all rows, as each model sets its own outliers aside.
        of_all = larger.cross_validation.errors.leading.rms
        no_closer = validated is not None and of_all >= validated.errors.leading.rms
        why = Why.LARGER_NO_CLOSER if no_closer else Why.LARGER_MODEL
        yield Reason.of(why, model=larger.name, after=errors, use=larger.verdict.use)
        yield from _lags(larger)

    m = result.fit.measurements
    names = result.nominal.joint_names
    side = common_side(m.moves_for(names)[m.estimation])
    if side is not None:
        falling = [name for name, sign in zip(names, side, strict=True) if sign < 0.0]
        rising = [name for name, sign in zip(names, side, strict=True) if sign > 0.0]
        yield Reason.of(Why.ONE_SIDED, rising=rising, falling=falling)
    if result.nominal.urdf.run:
        urdf = result.nominal.urdf
        yield Reason.of(Why.ALREADY_CORRECTED, run=urdf.run, verdict=urdf.verdict)
    if m.copies:
        yield Reason.of(Why.ROWS_COPIED, rows=len(m.copies), row=m.copies[0])
    if m.other_end:
        yield Reason.of(Why.OTHER_END, off=len(m.other_end), named=[m.other_end[0]])
    if m.turned:
        yield Reason.of(Why.READINGS_TURNED, joints=", ".join(m.turned))

    rows_outside = result.rows.outside
    if rows_outside:
        farthest = max(rows_outside, key=lambda row: row.beyond[0].by)
        joint = farthest.beyond[0]
        number = int(np.array(m.rows)[m.validation][farthest.index])
        values: dict[str, Any] = {"by_m" if joint.prismatic else "by_rad": joint.by}
        images = np.array(m.images)[m.validation]
        images_outside = {image for image in images[[row.index for row in rows_outside]] if image}
        if images_outside:
            values |= {"images": len(images_outside), "image": str(images[farthest.index])}
        yield Reason.of(
            Why.OUTSIDE, rows=len(rows_outside), row=number, joint=joint.joint, **values
        )
