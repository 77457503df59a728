"""Pose accuracy and repeatability of a robot as ISO 9283 defines them.

A pose was commanded once or n times. With e_j what was measured in its repeat j, minus what the robot's model predicts
for the joint values of that row, in the axes of the base,

    AP = |mean e_j|                                 pose accuracy: from the commanded pose to the barycentre
    l_j = |e_j - mean e|,  RP = mean l + 3 S_l      pose repeatability
    AP_a, AP_b, AP_c = mean e_j about x, y, z       of orientations
    RP_a, RP_b, RP_c = 3 S_a, 3 S_b, 3 S_c

where S are the standard deviations over n - 1. These are the figures of a controller with this model. Rows that measure
one length have AP = |mean e_j| along it, as ISO 9283's distance accuracy, and RP = 3 S.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.errors import CalibError, MeasurementError
from calib.numerics.errors import LENGTHS
from calib.registration.rows import Rows
from calib.registration.setup import Setup
from calib.registration.table_rows import rows_and_setup
from calib.result.calibration import CalibrationValues
from calib.result.evaluation import Evaluation, evaluate, registration_rows
from calib.robot.robot import Robot, read_only
from calib.units import Array, Integers, Mask

#: Rows that are judged: all of a table, its validation rows, or those that nothing was fitted or registered to.
JudgedRows = Literal["all", "validation", "fresh"]

#: Fewer repeats than this have no RP: of two, both lie equally far from their mean, and S is 0 whatever the robot does.
FEWEST_REPEATS = 3

#: From this many poses on, rows are judged alone that the table itself does not set aside from the fitted ones.
FEWEST_APART = 5

#: Residuals that differ by less are those of one row [m]: far above rounding, far below the difference of repeats.
_SAME = 1e-7


@dataclass(frozen=True, slots=True, eq=False)
class PoseAccuracy:
    """Accuracy and repeatability at one pose of one target at one station; NaN for what was not measured."""

    #: Numbers of the rows in the table: the repeats of the pose
    rows: tuple[int, ...]
    #: Kind of measurement
    kind: str
    #: Their station
    group: str
    #: Their target
    target: str
    #: Pose accuracy [m]
    ap: float
    #: Shape (3,), its components along the base's axes [m]; NaN where one length was measured
    ap_xyz: Array
    #: Pose repeatability [m]; NaN below three repeats
    rp: float
    #: Largest error of a single repeat [m]
    single: float
    #: Angle between the commanded and the mean attained orientation [rad]
    ap_angle: float
    #: Shape (3,), its components about the base's axes [rad]
    ap_abc: Array
    #: Shape (3,), repeatability about them [rad]; NaN below three repeats
    rp_abc: Array
    #: Largest angle of a single repeat [rad]
    single_angle: float

    @property
    def rp_angle(self) -> float:
        """The largest of the repeatabilities about axes [rad]."""
        return float(np.max(self.rp_abc))


@dataclass(frozen=True, slots=True, eq=False)
class Accuracy:
    """Accuracy of a robot over the poses that it is judged by."""

    #: The poses in the order of the table
    poses: tuple[PoseAccuracy, ...]
    #: ``"all"``; where something was registered to the others, ``"validation"``, the table's validation rows, or
    #: ``"fresh"``, others that nothing was fitted or registered to
    rows: JudgedRows
    #: Where some rows alone are judged, the use of the others: ``"calibration"``, ``"target"``, ``"frame"``
    others: tuple[str, ...]
    #: Number of rows that hold a measurement
    measured: int
    #: Number of those that the calibration was fitted to
    fitted: int
    #: Whether some of these are judged
    seen: bool
    #: Some of ``"target"`` and ``"frame"``, registered to the judged rows
    registered: tuple[str, ...]
    #: Number of unknowns of targets and frames that were not given
    unknowns: int
    #: Number of scalars that these were registered to, repeats counted once
    numbers: int

    @property
    def factor(self) -> float:
        """Random errors before something was registered to the same rows, over those after it.

        With n numbers and u unknowns sqrt(n / (n - u)); infinite where no degree of freedom remains.
        """
        if not self.registered:
            return 1.0
        freedom = self.numbers - self.unknowns
        return float(np.sqrt(self.numbers / freedom)) if freedom > 0 else np.inf

    def of(self, name: str) -> Array:
        """Return one figure of all poses that have it.

        Args:
            name: ``"ap"``, ``"rp"``, ``"single"`` [m], or ``"ap_angle"``, ``"rp_angle"``, ``"single_angle"`` [rad].

        Returns:
            shape (k,), in the order of the poses.
        """
        values = np.array([getattr(pose, name) for pose in self.poses])
        return np.asarray(values[np.isfinite(values)])

    def figures(self, *, angle: bool = False) -> dict[str, float]:
        """Return the largest and mean AP and RP and the largest single error; NaN where there are none.

        Args:
            angle: Of orientations [rad], and not of positions [m].

        Returns:
            By ``"ap_max"``, ``"ap_mean"``, ``"rp_max"``, ``"rp_mean"`` and ``"single_max"``.
        """
        suffix = "_angle" if angle else ""
        figures = {}
        for name, statistic in (
            ("ap", "max"),
            ("ap", "mean"),
            ("rp", "max"),
            ("rp", "mean"),
            ("single", "max"),
        ):
            values = self.of(name + suffix)
            value = getattr(values, statistic)() if len(values) else np.nan
            figures[f"{name}_{statistic}"] = float(value)
        return figures

    @property
    def repeats(self) -> tuple[int, int]:
        """The smallest and the largest number of repeats of a pose."""
        counts = [len(pose.rows) for pose in self.poses]
        return min(counts), max(counts)


def accuracy(evaluation: Evaluation, *, seen: bool | Mask = False) -> Accuracy:
    """Return pose accuracy and repeatability of an evaluated robot.

    Where a target or a frame was registered to the estimation rows, the validation rows are judged alone, if there are
    any; where a calibration was fitted to some rows, the others, see `judged_rows`.

    Args:
        evaluation: The errors of the robot at N rows.
        seen: The rows that a calibration of this robot was fitted to, shape (N,); or whether it was fitted to the
            estimation rows.

    Raises:
        MeasurementError: No row measures anything.
    """
    m, setup, used = evaluation.measurements, evaluation.setup, evaluation.used
    measured = np.any(used, axis=1)
    if not np.any(measured):
        raise MeasurementError(f"{m.source or 'Measurements'}: no row measures anything.")
    # Repeats have the same joint values: frames, targets and loads of a cell have no part in it.
    rows, _ = rows_and_setup(evaluation.robot, m, Cell())
    registration = _registered_to(m, setup, rows)
    fitted = measured & (seen if isinstance(seen, np.ndarray) else registration & seen)
    judged = judged_rows(m, measured, fitted, rows.poses, registered=bool(evaluation.registered))

    apart = not np.any(judged & registration)
    others: tuple[str, ...] = ()
    if np.any(fitted & ~judged):
        others += ("calibration",)
    if apart:
        others += evaluation.registered
    _, first = np.unique(rows.poses[measured & registration], return_index=True)
    one_per_pose = np.flatnonzero(measured & registration)[first]
    return Accuracy(
        poses=_poses(evaluation, rows, judged),
        rows=_name_of(judged, measured, m.validation),
        others=others,
        measured=int(np.sum(measured)),
        fitted=int(np.sum(fitted)),
        seen=bool(np.any(fitted & judged)),
        registered=() if apart else evaluation.registered,
        unknowns=_unknowns(setup),
        numbers=int(np.sum(rows.used[one_per_pose])),
    )


def _registered_to(measurements: Measurements, setup: Setup, rows: Rows) -> Mask:
    """Return the rows that frames and targets were registered to, if they were, shape (N,)."""
    usual = registration_rows(measurements)
    seen_by_others = setup.with_given_fixed(rows.samples.select(usual))
    return usual | seen_by_others.unknown_at(rows.samples)


def _unknowns(setup: Setup) -> int:
    """Return the number of unknowns of targets and frames that were not given."""
    targets = int(np.sum(setup.target_unknown & ~setup.target_given))
    frames = zip(setup.unknown, setup.frame_given, strict=True)
    of_frames = sum(len(directions) for directions, given in frames if not given)
    return (6 if setup.rotation else 3) * targets + of_frames


def _name_of(judged: Mask, measured: Mask, validation: Mask) -> JudgedRows:
    """Return the name of the judged rows; all arguments have the shape (N,)."""
    if np.array_equal(judged, measured):
        return "all"
    if np.array_equal(judged, measured & validation):
        return "validation"
    return "fresh"


def _poses(evaluation: Evaluation, rows: Rows, judged: Mask) -> tuple[PoseAccuracy, ...]:
    """Return the accuracy at each pose of the judged rows, in the order of their first rows."""
    residual = _in_base_axes(evaluation, rows)
    chosen = np.flatnonzero(judged)
    order = chosen[np.argsort(rows.poses[chosen], kind="stable")]
    repeats = np.split(order, np.flatnonzero(np.diff(rows.poses[order])) + 1)
    repeats.sort(key=lambda indices: int(indices[0]))
    return tuple(_of_pose(evaluation, residual, indices) for indices in repeats)


def _in_base_axes(evaluation: Evaluation, rows: Rows) -> Array:
    """Return the residual with three components turned from the frame's axes into the base's, shape (N, D).

    The frame's axes are those that R of T_frame_base turns the base's into, so that this is R^T e.
    """
    residual = evaluation.residual.copy()
    R = evaluation.setup.T_frame_base[rows.samples.frame, :3, :3]
    for first in range(0, residual.shape[1] // 3 * 3, 3):
        columns = slice(first, first + 3)
        vector = np.all(rows.used[:, columns], axis=1)
        residual[vector, columns] = np.einsum("nji,nj->ni", R[vector], residual[vector, columns])
    return np.asarray(residual)


def _of_pose(evaluation: Evaluation, residual: Array, repeats: NDArray[np.intp]) -> PoseAccuracy:
    """Return the accuracy at one pose.

    Args:
        evaluation: The errors.
        residual: Of all rows, three components along the base's axes, shape (N, D), [m] and [rad].
        repeats: Indices of the pose's rows, from 0, shape (n,).
    """
    m, first = evaluation.measurements, repeats[0]
    used = evaluation.used[first]
    e = residual[repeats][:, :LENGTHS][:, used[:LENGTHS]]
    w = residual[repeats][:, LENGTHS:]
    turned = bool(np.any(used[LENGTHS:]))
    nothing = np.full(3, np.nan)
    mean_e = e.mean(axis=0)
    mean_w = w.mean(axis=0) if turned else nothing
    enough = len(repeats) >= FEWEST_REPEATS
    rp_abc = 3.0 * w.std(axis=0, ddof=1) if turned and enough else nothing
    return PoseAccuracy(
        rows=tuple(int(m.rows[i]) for i in repeats),
        kind=m.kinds[first],
        group=m.groups[first],
        target=m.targets[first],
        ap=float(np.linalg.norm(mean_e)),
        ap_xyz=read_only(mean_e if len(mean_e) == LENGTHS else nothing),
        rp=_repeatability(e) if enough else np.nan,
        single=float(np.linalg.norm(e, axis=1).max()),
        ap_angle=float(np.linalg.norm(mean_w)),
        ap_abc=read_only(mean_w),
        rp_abc=read_only(rp_abc),
        single_angle=float(np.linalg.norm(w, axis=1).max()) if turned else np.nan,
    )


def _repeatability(e: Array) -> float:
    """Return the repeatability RP [m] of errors of n repeats, shape (n, 3), or (n, 1) of one length."""
    if e.shape[1] == 1:
        return float(3.0 * e[:, 0].std(ddof=1))
    distances = np.linalg.norm(e - e.mean(axis=0), axis=1)
    return float(distances.mean() + 3.0 * distances.std(ddof=1))


def judged_rows(
    measurements: Measurements,
    measured: Mask,
    fitted: Mask,
    poses: Integers,
    *,
    registered: bool,
) -> Mask:
    """Choose the rows that a robot is judged by.

    Rows that the calibration was not fitted to, if the table sets some of them aside or they are of five poses; and of
    these the validation rows, if there are any and something was registered to the others. Otherwise all.

    Args:
        measurements: The N rows.
        measured: True for rows that hold a measurement, shape (N,).
        fitted: True for rows that the calibration was fitted to, shape (N,).
        poses: Number of the pose of each row; repeats have the same, shape (N,).
        registered: Whether a frame or target was registered to these rows.

    Returns:
        True for the rows to judge by, shape (N,).
    """
    fresh = measured & ~fitted
    aside = fresh & measurements.validation & np.any(measurements.estimation)
    enough = np.any(aside) or len(np.unique(poses[fresh])) >= FEWEST_APART
    if np.any(fitted) and not enough:
        return measured
    return np.asarray(aside if registered and np.any(aside) else fresh)


def fitted_rows(
    calibration: CalibrationValues, robot: Robot, measurements: Measurements, cell: Cell
) -> Mask:
    """Find the rows of a table that a result was fitted to, in any file, in any order and under any number.

    A row is recognised by its residuals with the nominal and with the corrected robot, which depend on every digit of
    its joint values and of what was measured. In the very file these are the estimation rows where none is recognised.

    Args:
        calibration: The result.
        robot: The robot with which the table is evaluated, nominal or corrected.
        measurements: The N rows.
        cell: As of `evaluate`.

    Returns:
        True for these rows, shape (N,).
    """
    fitted = np.zeros(len(measurements), dtype=bool)
    # Of a station that the result does not know no row was fitted.
    with contextlib.suppress(CalibError):
        fitted = _recognised(calibration, robot, measurements, cell)
    same_file = bool(calibration.source.sha256)
    same_file = same_file and calibration.source.sha256 == measurements.sha256
    if same_file and not np.any(fitted):
        return measurements.estimation
    return fitted


def _recognised(c: CalibrationValues, robot: Robot, measurements: Measurements, cell: Cell) -> Mask:
    """Find the rows whose residuals are those of a row that the result was fitted to, shape (N,).

    The arguments are those of `fitted_rows`.
    """
    nominal = evaluate(c.uncorrected(robot), measurements, cell, known=c.nominal_setup)
    calibrated = evaluate(c.corrected(robot), measurements, cell, known=c.setup)
    used = calibrated.used[:, :LENGTHS]
    stored_used = c.used[:, :LENGTHS]
    fitted = np.zeros(len(measurements), dtype=bool)
    for lengths in range(1, LENGTHS + 1):  # by the number of lengths that a row measures
        rows = np.flatnonzero(used.sum(axis=1) == lengths)
        stored_rows = np.flatnonzero(c.rows.estimation & (stored_used.sum(axis=1) == lengths))
        if not len(rows) or not len(stored_rows):
            continue
        measured = _lengths_of(used, rows, nominal.residual, calibrated.residual)
        stored = _lengths_of(stored_used, stored_rows, c.residual_nominal, c.residual_calibrated)
        tree = KDTree(stored)
        distance, _ = tree.query(measured, p=np.inf, distance_upper_bound=_SAME)
        fitted[rows] = distance <= _SAME
    return fitted


def _lengths_of(used: Mask, rows: Integers, nominal: Array, calibrated: Array) -> Array:
    """Return the signed residuals in length of some rows by both robots, side by side, shape (n, 2 k), [m].

    Args:
        used: True for the k lengths that each row measures, shape (N, 3).
        rows: Indices of n rows with the same k, from 0.
        nominal: Residual of the nominal robot, shape (N, D), [m].
        calibrated: Residual of the corrected robot, shape (N, D), [m].
    """
    both = []
    for residual in (nominal, calibrated):
        lengths = residual[rows, :LENGTHS][used[rows]]
        both.append(lengths.reshape(len(rows), -1))
    return np.hstack(both)
