"""Evidence: all figures of a cross-validated result that its verdict is based on."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from calib.basics.arrays import Array, Integers, Mask
from calib.basics.channels import Channels
from calib.diagnosis.evidence import Evidence
from calib.diagnosis.reasons import NO, Reason, Why
from calib.fit.estimate.fitting import Fitted
from calib.fit.registration.rows import Rows
from calib.numerics.errors import Errors
from calib.numerics.rigid_motion import without_rigid_motion
from calib.result.calibration import Calibration
from calib.result.doubts import noise_doubts
from calib.result.prediction import FittedModel, NonGeometric
from calib.robot.ranges import spread_poses

#: A share of validation rows up to which those that do not fit are set aside as accidents.
_FEW_SUSPECTS = 0.15

#: Parameters of a full geometry for each joint.
_PER_JOINT = 4


def evidence_of(
    result: Calibration,
    part: FittedModel,
    rows: Rows,
    doubts: tuple[Reason, ...],
) -> Evidence:
    """Collect the evidence for the verdict on a part of a result.

    Args:
        result: A cross-validated result, with its measurements and fits in memory.
        part: Its geometry, or its non-geometric model: the one that the verdict is on.
        rows: The N rows that were fitted, as arrays; ``sole`` marks those of sole postures, which no other row can
            check and which count in no error.
        doubts: Reasons for doubt besides the errors, as of `doubts_of`.

    Returns:
        All figures that `verdict` weighs: held-out errors of the nominal and of the calibrated robot, noise of each
        scalar and its floor, errors on validation rows, size of the changes, expected errors over the joint limits [m],
        doubts and notes.
    """
    assert result.trust.nominal_cross_validation is not None
    assert part.cross_validation is not None
    of_non_geometric = isinstance(part, NonGeometric)
    fitted = _fit_of(result, part)
    of_robot = part.model.of_robot
    lengths_and_angles = of_robot & np.isin(part.model.units, ("m", "rad"))
    changes = np.abs(part.x[lengths_and_angles])
    expected, expected_of_nominal = _over_joint_limits(result, part)
    return Evidence(
        nominal=result.trust.nominal_cross_validation,
        calibrated=part.cross_validation,
        scales=fitted.estimate.problem.scales,
        used=rows.used & rows.checked[:, None],
        floor=_noise_floor(result, fitted, doubts),
        repeats=_measurements_of(rows),
        pairs=rows.partner >= 0,
        outliers=result.fit.geometry.estimate.outliers,
        validation=_validation_errors(result, part),
        validation_with_suspects=_errors_of(result, part)["validation"],
        doubts=(*noise_doubts(result, fitted, doubts), *doubts),
        notes=() if of_non_geometric else tuple(_notes(result)),
        images=rows.where(lambda kind: kind.optical),
        parameters=len(part.model) - len(part.model.optical),
        full_model_parameters=_full_model_parameters(result, fitted),
        changes=bool(np.any(part.x[of_robot])),
        largest=float(np.max(changes, initial=0.0)),
        noise=result.noise.sigma,
        expected=expected,
        expected_of_nominal=expected_of_nominal,
        non_geometric=None if of_non_geometric else _usable_non_geometric(result),
    )


def _measurements_of(rows: Rows) -> Integers:
    """Number rows so that repeats of one measurement, and the corners of one image, have one number; shape (N,)."""
    is_image = rows.where(lambda kind: kind.optical)
    labels = np.column_stack([is_image, np.where(is_image, rows.blocks, rows.poses)])
    return np.unique(labels, axis=0, return_inverse=True)[1].reshape(-1)


def _fit_of(result: Calibration, part: FittedModel) -> Fitted:
    """Return the fit of a part of a result.

    Args:
        result: A result with its fits in memory: of the geometry, and of the non-geometric model if there is one.
        part: Its geometry, or its non-geometric model.
    """
    fits = result.fit
    if isinstance(part, NonGeometric) and fits.non_geometric is not None:
        return fits.non_geometric
    return fits.geometry


def _full_model_parameters(result: Calibration, fitted: Fitted) -> int:
    """Return the number of parameters of a full geometry, with those of the frames and targets that are estimated.

    Args:
        result: The result: ``candidates`` are the models that its model was chosen from, empty where it was named.
        fitted: A fit of it: its robot, and ``setup.count``, the number of unknowns of its frames and targets.

    Returns:
        `_PER_JOINT` for each measured joint, and those of frames and targets; 0 where the model was named and not
        chosen.
    """
    if not result.method.candidates:
        return 0
    return _PER_JOINT * len(fitted.task.robot.inputs) + fitted.setup.count


def _usable_non_geometric(result: Calibration) -> tuple[str, Errors] | None:
    """Return name and held-out errors of the non-geometric model of a result if it may be used.

    Args:
        result: A cross-validated result, with the verdict on its non-geometric model, if it has one.

    Returns:
        The model's name, such as ``"dh+compliance"``, and its errors on held-out rows without outliers, [m] and [rad];
        None without such a model, its cross-validation or verdict, or where the verdict is not to use it.
    """
    model = result.non_geometric
    if model is None or model.cross_validation is None or model.verdict is None:
        return None
    if model.verdict.use == NO:
        return None
    return model.name, model.cross_validation.errors_without_outliers


def _noise_floor(result: Calibration, fitted: Fitted, doubts: tuple[Reason, ...]) -> Array:
    """Return the least noise by any model tried over that of a fit, for each scalar.

    What the noise of a fit exceeds it by is lack of model.

    Args:
        result: The result with its fits in memory, of the geometry and of the non-geometric model if there is one. The
            noise of each instrument (lengths of each kind of rows, then angles) is compared, as a multiple of the
            stated sigma.
        fitted: The fit to N rows whose noise is compared; ``rows.channels.index``, shape (N, D), is the index of each
            scalar's instrument, -1 for none.
        doubts: Reasons for doubt. That a larger model leaves less noise, ``Why.MODEL_LACKS``, has both noises of a
            length [m] as its values; their ratio then counts for the first instrument.

    Returns:
        shape (N, D), above 0 and at most 1; 1 for scalars that were not measured.
    """
    fits = (result.fit.geometry, result.fit.non_geometric)
    noise = fitted.estimate.problem.noise_over_sigma
    of_fits = [fit.estimate.problem.noise_over_sigma for fit in fits if fit is not None]
    least = np.min(of_fits, axis=0)
    share = np.minimum(least / noise, 1.0)
    for doubt in doubts:
        if doubt.why == Why.MODEL_LACKS:
            unit = fitted.estimate.problem.rows.channels.units[0]
            share_of_larger_model = doubt.values[f"less_{unit}"] / doubt.values[f"noise_{unit}"]
            share[0] = min(share[0], share_of_larger_model)
    # Scalars that were not measured have the instrument -1, the last one.
    by_instrument = np.append(share, 1.0)
    return np.asarray(by_instrument[fitted.estimate.problem.rows.channels.index])


def _notes(result: Calibration) -> Iterator[Reason]:
    """Yield reasons that only inform; they do not affect the verdict.

    Args:
        result: A result with its measurements in memory. Of these are used the rows' numbers and ``copies``, rows left
            out as copies of others; and ``outside``, the validation rows beyond the fitted joint ranges.

    Yields:
        As far as they hold: that there is a non-geometric model; the number of copied rows, with the first; and the
        number of validation rows outside, with the joint that is furthest out, its distance [m] or [rad] and the row's
        number in the table.
    """
    yield from _note_on_non_geometric(result)
    m = result.fit.measurements
    if m.copies:
        yield Reason.of(Why.ROWS_COPIED, rows=len(m.copies), row=m.copies[0])
    if result.rows.outside:
        farthest = max(result.rows.outside, key=lambda row: row.beyond[0].by)
        joint = farthest.beyond[0]
        number = int(np.array(m.rows)[m.validation][farthest.index])
        distance = {"by_m" if joint.prismatic else "by_rad": joint.by}
        images = np.array(m.images)[m.validation]
        outside = {image for image in images[[row.index for row in result.rows.outside]] if image}
        of_images = (
            {"images": len(outside), "image": str(images[farthest.index])} if outside else {}
        )
        yield Reason.of(
            Why.OUTSIDE,
            rows=len(result.rows.outside),
            row=number,
            joint=joint.joint,
            **distance,
            **of_images,
        )


def _note_on_non_geometric(result: Calibration) -> Iterator[Reason]:
    """Say if there is a non-geometric model, and if it predicts better than the geometry.

    Args:
        result: A result with the cross-validations of its geometry and of its non-geometric model, if it has one.

    Yields:
        One reason, with the model's name, its errors on held-out rows without outliers and its verdict:
        ``LARGER_NO_CLOSER`` if the rms error is not below the geometry's, else ``LARGER_MODEL``. None without such a
        model, its cross-validation or verdict.
    """
    model = result.non_geometric
    if model is None or model.cross_validation is None or model.verdict is None:
        return
    errors = model.cross_validation.errors_without_outliers
    closer = True
    if result.cross_validation is not None:
        of_geometry = result.cross_validation.errors_without_outliers
        closer = not errors.leading.rms >= of_geometry.leading.rms
    why = Why.LARGER_MODEL if closer else Why.LARGER_NO_CLOSER
    yield Reason.of(why, model=model.name, after=errors, use=model.verdict.use)


def _over_joint_limits(result: Calibration, part: FittedModel) -> tuple[float, float]:
    """Return the expected errors over the joint limits, rms [m], of a part of a result and of the nominal robot.

    With the variance v of a predicted position there, mean over 200 joint values, v_0 at the measured poses and the
    factor f by which extrapolated errors exceed their variance, the part is off by e^2 = v_0 + f (v - v_0). It is d
    away from the nominal robot, of which (f - 1) (v - v_0) is error of its own: the nominal robot is off by d^2 - (f -
    1) (v - v_0) + v, and by no less than the part. Where the frame was estimated, or no row determines where the base
    stands, rigid motions of all positions do not count.

    Args:
        result: The result: its nominal robot, that robot's frames and targets (``nominal_setup``), ``frame_estimated``,
            and whether a row determines where the base stands.
        part: Its geometry, or its non-geometric model, with f as ``extrapolation`` and the root of v_0 as
            ``expected_measured``.

    Returns:
        Expected errors of predicted positions of the first target in the first measurement frame, by the part and by
        the nominal robot.
    """
    samples = result.samples(spread_poses(result.nominal))
    # T_frame_target, (N, 4, 4), and the derivatives of its position by the p parameters, (N, 3, p).
    poses, columns = part.kinematics.twists(part.x, samples, rotation=False)
    T_base_tip = result.nominal.poses(samples.q)
    nominal_points = result.nominal_setup.target_poses(T_base_tip, samples)[:, :3, 3]
    points = poses[:, :3, 3]
    away = (nominal_points - points)[:, :, None]
    if result.method.frame_estimated or not result.rows.tells_place:
        away = without_rigid_motion(points, away)
        columns = without_rigid_motion(points, columns)
    d_square = float(np.mean(np.sum(away**2, axis=(1, 2))))
    v = _mean_variance(columns, part.covariance)
    v_0 = min(part.expected_measured**2, v)
    added = v - v_0
    of_part = v_0 + part.extrapolation * added
    of_nominal = max(d_square - (part.extrapolation - 1.0) * added + v, of_part)
    return float(np.sqrt(of_part)), float(np.sqrt(of_nominal))


def _mean_variance(J: Array, covariance: Array) -> float:
    """Return the variance of a predicted position, trace(J C J^T), mean over N positions [m^2].

    Args:
        J: Derivatives of N positions by p parameters, shape (N, 3, p), [m] a unit of each.
        covariance: Covariance C of the parameters, shape (p, p).
    """
    variances = np.einsum("nip,pq,niq->n", J, covariance, J, optimize=True)
    return float(np.mean(variances))


def _errors_of(result: Calibration, part: FittedModel) -> Mapping[str, Errors]:
    """Return the errors of a part of a result, its geometry or its non-geometric model, by set."""
    name = "non_geometric" if isinstance(part, NonGeometric) else "calibrated"
    return result.errors[name]


def _validation_errors(result: Calibration, part: FittedModel) -> tuple[Errors, Errors, int]:
    """Compare errors of the nominal robot and of a part of a result on the validation rows.

    Args:
        result: The result with its measurements in memory. For all N rows it has the residuals, measured minus
            predicted, shape (N, D), and their ``channels``; ``suspects`` are the validation rows
            whose score is beyond the limit, by their numbers in the table.
        part: Its geometry, or its non-geometric model.

    Returns:
        Errors of the nominal robot and by the part; and the number of suspects that were set aside, see
        `validation_errors`.
    """
    m = result.fit.measurements
    suspects = [suspect.row for suspect in result.rows.suspects]
    residual = part.residual if isinstance(part, NonGeometric) else result.rows.residual_calibrated
    return validation_errors(
        m.validation,
        np.isin(m.rows, suspects),
        result.rows.residual_nominal,
        residual,
        result.rows.channels,
    )


def validation_errors(
    validation: Mask,
    suspects: Mask,
    nominal: Array,
    calibrated: Array,
    channels: Channels,
) -> tuple[Errors, Errors, int]:
    """Compare errors on the validation rows, without suspects if they are few.

    One wild row would decide the comparison; many of them are no accidents, and count. Few are no more than one, or
    `_FEW_SUSPECTS` of the validation rows, but not all.

    Args:
        validation: True for validation rows, shape (N,).
        suspects: True for rows whose score is beyond the limit, shape (N,).
        nominal: Measured minus predicted by the nominal robot, shape (N, D).
        calibrated: The same by the calibrated robot.
        channels: The channels of the residuals.

    Returns:
        Errors of the nominal and of the calibrated robot, and the number of rows that were set aside.
    """
    aside = suspects & validation
    many = np.sum(suspects) > max(1, int(_FEW_SUSPECTS * np.sum(validation)))
    if many or np.array_equal(aside, validation):
        aside = np.zeros_like(suspects)
    chosen = validation & ~aside
    channels = channels.select(chosen)
    before = Errors.of(nominal[chosen], channels)
    after = Errors.of(calibrated[chosen], channels)
    return before, after, int(np.sum(aside))
