"""Evidence: all figures of a result that its verdict is based on."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calib.diagnosis.reasons import NO, Reason, Why
from calib.diagnosis.verdict import Evidence
from calib.estimate.fitting import Fitted
from calib.model.parameters import FRAME, TARGET
from calib.numerics.errors import Errors
from calib.numerics.rigid_motion import without_rigid_motion
from calib.registration.rows import Rows
from calib.result.calibration import CalibrationValues
from calib.result.doubts import noise_doubts
from calib.result.prediction import FittedModel, NonGeometric
from calib.robot.ranges import spread_poses
from calib.units import Array, Mask

#: A share of validation rows up to which those that do not fit are set aside as accidents.
_FEW_SUSPECTS = 0.15


def evidence_of(
    result: CalibrationValues,
    part: FittedModel,
    rows: Rows,
    doubts: tuple[Reason, ...],
) -> Evidence:
    """All that the verdict on a part of a result is based on: its URDF or its non-geometric model.

    The result is cross-validated, and the hint a set-up that explains more.
    """
    fits, m, model = result.fit_in_memory, result.measurements, part.model
    non_geometric = part if isinstance(part, NonGeometric) else None
    fitted = (
        fits.non_geometric
        if non_geometric is not None and fits.non_geometric is not None
        else fits.geometry
    )
    nominal, calibrated = result.nominal_cross_validation, part.cross_validation
    assert nominal is not None
    assert calibrated is not None
    suspects = {o.row for o in result.suspects}
    of_robot = ~model.family(FRAME, TARGET)
    geometry = of_robot & np.isin(model.units, ("m", "rad"))
    expected, expected_of_nominal = _over_joint_limits(result, part)
    return Evidence(
        nominal=nominal,
        calibrated=calibrated,
        scales=fitted.estimate.problem.scales,
        used=rows.used & rows.checked[:, None],
        floor=_noise_floor(result, fitted, doubts),
        repeats=rows.poses,
        pairs=rows.partner >= 0,
        outliers=result.fitted.estimate.outliers,
        validation=validation_errors(
            m.validation,
            np.array([row in suspects for row in m.rows]),
            result.residual_nominal,
            result.residual_calibrated if non_geometric is None else non_geometric.residual,
            result.used,
        ),
        doubts=(*noise_doubts(result, fitted, doubts), *doubts),
        notes=tuple(_notes(result)) if non_geometric is None else (),
        parameters=len(model),
        full_model_parameters=(4 * len(fitted.task.robot.inputs) + fitted.setup.count)
        * bool(result.candidates),
        changes=bool(np.any(part.x[of_robot])),
        largest=float(np.max(np.abs(part.x[geometry]), initial=0.0)),
        noise=result.sigma,
        expected=expected,
        expected_of_nominal=expected_of_nominal,
        non_geometric=_non_geometric(result) if non_geometric is None else None,
    )


def _non_geometric(result: CalibrationValues) -> tuple[str, Errors] | None:
    """Name and held-out errors of the non-geometric model, unless it is not to be used itself."""
    model = result.non_geometric
    if model is None or model.cross_validation is None or model.verdict is None:
        return None
    if model.verdict.use == NO:
        return None
    return model.name, model.cross_validation.errors_without_outliers


def _noise_floor(result: CalibrationValues, fitted: Fitted, doubts: tuple[Reason, ...]) -> Array:
    """The least noise of each scalar that any model tried has left, over that of a fit, at most 1, shape (N, D)."""
    fits = (result.fit_in_memory.geometry, result.fit_in_memory.non_geometric)
    noise = np.array(fitted.estimate.noise)
    least = np.min([one.estimate.noise for one in fits if one is not None], axis=0)
    share = np.minimum(least / noise, 1.0)
    for doubt in doubts:
        if doubt.why == Why.MODEL_LACKS:
            share[0] = min(share[0], doubt.values["less_m"] / doubt.values["noise_m"])
    return np.append(share, 1.0)[fitted.estimate.problem.rows.instruments]


def _notes(result: CalibrationValues) -> Iterator[Reason]:
    """What is told of the corrected robot besides, and decides nothing."""
    non_geometric, m = result.non_geometric, result.measurements
    if (
        non_geometric is not None
        and non_geometric.cross_validation is not None
        and non_geometric.verdict is not None
    ):
        errors, own = (
            non_geometric.cross_validation.errors_without_outliers,
            result.cross_validation,
        )
        closer = own is None or not errors.rms >= own.errors_without_outliers.rms
        why = Why.LARGER_MODEL if closer else Why.LARGER_NO_CLOSER
        yield Reason.of(why, model=non_geometric.name, after=errors, use=non_geometric.verdict.use)
    if m.copies:
        yield Reason.of(Why.ROWS_COPIED, rows=len(m.copies), row=m.copies[0])
    if result.outside:
        one = max(result.outside, key=lambda row: row.beyond[0].by)
        far, number = one.beyond[0], int(np.array(m.rows)[m.validation][one.index])
        values = {"joint": far.joint, "by_m" if far.prismatic else "by_rad": far.by}
        yield Reason.of(Why.OUTSIDE, rows=len(result.outside), row=number, **values)


def _over_joint_limits(result: CalibrationValues, part: FittedModel) -> tuple[float, float]:
    """What a part of a result and the nominal robot are expected to be off by over the joint limits, rms [m].

    With the variance v of a prediction there, v_0 at the measured poses and the factor f by which extrapolated errors
    exceed their variance, the part is off by e^2 = v_0 + f (v - v_0). It is d away from the nominal robot, of which
    (f - 1) (v - v_0) is error of its own: the nominal robot is off by d^2 - (f - 1) (v - v_0) + v. Where the frame is
    registered anew for each table, motions of the base do not count.
    """
    robot, nominal = result.nominal, result.nominal_setup
    samples = result.samples(spread_poses(robot))
    poses, twists = part.kinematics.twists(part.x, samples, rotation=False)
    T_nominal = nominal.target_poses(robot.poses(samples.q), samples)
    points, columns = poses[:, :3, 3], twists
    away = (T_nominal[:, :3, 3] - points)[:, :, None]
    if result.frame_estimated or not result.tells_place:
        away, columns = (without_rigid_motion(points, moves) for moves in (away, columns))
    d = float(np.mean(np.sum(away**2, axis=(1, 2))))
    v = float(np.mean(np.einsum("nip,pq,niq->n", columns, part.covariance, columns, optimize=True)))
    v_0 = min(part.expected_measured**2, v)
    beyond = v - v_0
    expected = v_0 + part.extrapolation * beyond
    off = max(d - (part.extrapolation - 1.0) * beyond + v, expected)
    return float(np.sqrt(expected)), float(np.sqrt(off))


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
