"""Evidence: all figures of a result that its verdict is based on."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calib.diagnosis.reasons import NO, Reason, Why
from calib.diagnosis.verdict import Evidence
from calib.estimate.fitting import Fitted
from calib.estimate.setup import Rows
from calib.estimate.statistics import Errors, rms
from calib.model.kinematics import FRAME, TARGET
from calib.result.calibration import Calibration
from calib.result.doubts import noise_doubts
from calib.result.prediction import Larger, Solved, without_rigid_motion
from calib.robot.readback import spread_poses
from calib.units import Array, Mask

#: A share of validation rows up to which those that do not fit are set aside as accidents.
_FEW_SUSPECTS = 0.15


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
    of_robot = ~model.family(FRAME, TARGET)
    moved = of_robot & np.isin(model.units, ("m", "rad"))
    return Evidence(
        nominal=nominal,
        calibrated=calibrated,
        scales=fitted.estimate.problem.scales,
        used=rows.used,
        floor=_noise_floor(result, fitted, doubts),
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
        doubts=(*noise_doubts(result, fitted, doubts), *doubts),
        notes=tuple(_notes(result)) if larger is None else (),
        parameters=len(model),
        whole=(4 * len(fitted.task.robot.inputs) + fitted.setup.count) * bool(result.candidates),
        changes=bool(np.any(part.x[of_robot])),
        largest=float(np.max(np.abs(part.x[moved]), initial=0.0)),
        noise=result.sigma,
        expected=part.expected_elsewhere,
        moved=_moved(result, larger=larger is not None),
        hint=hint,
        non_geometric=_non_geometric(result) if larger is None else None,
    )


def _non_geometric(result: Calibration) -> tuple[str, Errors] | None:
    """Name and held-out errors of the non-geometric model, unless it is not to be used itself."""
    model = result.larger
    if model is None or model.cross_validation is None or model.verdict is None:
        return None
    if model.verdict.use == NO:
        return None
    return model.name, model.cross_validation.errors_without_outliers


def _noise_floor(result: Calibration, fitted: Fitted, doubts: tuple[Reason, ...]) -> Array:
    """The least noise of each scalar that any model tried has left, over that of a fit, at most 1, shape (N, D)."""
    fits = (result.in_memory.geometry, result.in_memory.larger)
    noise = np.array(fitted.estimate.noise)
    least = np.min([one.estimate.noise for one in fits if one is not None], axis=0)
    share = np.minimum(least / noise, 1.0)
    for doubt in doubts:
        if doubt.why == Why.MODEL_LACKS:
            share[0] = min(share[0], doubt.values["less_m"] / doubt.values["noise_m"])
    return np.append(share, 1.0)[fitted.estimate.problem.rows.instruments]


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
