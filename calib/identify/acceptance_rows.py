"""Which rows a robot is judged by: not those that a calibration was fitted to, if others are left.

A row that a result was fitted to is known again by what was left over there: the residuals of the nominal and of the
calibrated robot, which hang on every digit of its joint values and of what was measured. So it is known in any file,
in any order, and under any number.
"""

from __future__ import annotations

import contextlib

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from calib.errors import CalibError
from calib.identify.evaluation import Evaluation, evaluate
from calib.identify.result import Calibration
from calib.measure.cell import Cell
from calib.measure.measurements import Measurements
from calib.model.robot import Robot

Mask = NDArray[np.bool_]

#: Residuals that differ by less are those of one row [m]: far above rounding, far below what repeats differ by.
_SAME = 1e-7

#: From this many poses on, rows are judged alone that the table itself does not set aside from the fitted ones.
FEWEST_APART = 5


def fitted_rows(c: Calibration, robot: Robot, measurements: Measurements, cell: Cell) -> Mask:
    """Which rows of a table a result was fitted to, shape (N,): by its own frames and targets, whatever is judged.

    In the very file these are the estimation rows where none is known again.

    Args:
        c: The result.
        robot: The robot, nominal or corrected.
        measurements: The rows.
        cell: The set-up.
    """
    both = ((c.uncorrected(robot), c.nominal_setup), (c.corrected(robot), c.setup))
    found = np.zeros(len(measurements), dtype=bool)
    # A set-up that the result does not know has none of its rows.
    with contextlib.suppress(CalibError):
        found = known_again(
            c, *(evaluate(one, measurements, cell, known=known) for one, known in both)
        )
    same = bool(c.source.sha256) and c.source.sha256 == measurements.sha256
    return measurements.estimation if same and not np.any(found) else found


def known_again(c: Calibration, nominal: Evaluation, calibrated: Evaluation) -> Mask:
    """Which rows of a table are some of those that a result was fitted to, shape (N,), by what is left over in them.

    Args:
        c: The result.
        nominal: The errors of its nominal robot in the table, with the result's own target and frame for it.
        calibrated: The errors of the robot with the result's joint origins, target and frame.
    """
    fitted = np.zeros(len(calibrated.used), dtype=bool)
    residuals = [one.residual[:, :3] for one in (nominal, calibrated)]
    stored = [c.residual_nominal[:, :3], c.residual_calibrated[:, :3]]
    ours, theirs = calibrated.used[:, :3], c.used[:, :3]
    for k in range(1, 4):  # by the number of lengths that a row measures
        at = np.flatnonzero(ours.sum(axis=1) == k)
        seen = np.flatnonzero(c.rows.estimation & (theirs.sum(axis=1) == k))
        if not (len(at) and len(seen)):
            continue
        tree = KDTree(np.hstack([one[seen][theirs[seen]].reshape(-1, k) for one in stored]))
        own = np.hstack([one[at][ours[at]].reshape(-1, k) for one in residuals])
        fitted[at] = tree.query(own, p=np.inf, distance_upper_bound=_SAME)[0] <= _SAME
    return fitted


def fitted_of(m: Measurements, told: Mask, seen: bool | Mask) -> Mask:
    """Which of the rows that measure something a calibration was fitted to, shape (N,).

    Args:
        m: The rows.
        told: Which rows measure something.
        seen: Whether it was fitted to the estimation rows (to all where there are none); or to which rows.
    """
    if isinstance(seen, np.ndarray):
        return np.asarray(told & seen)
    return np.asarray(told & estimated(m) if seen else np.zeros_like(told))


def estimated(m: Measurements) -> Mask:
    """The rows that something is registered to: the estimation rows, or all where there are none."""
    return m.estimation if np.any(m.estimation) else np.ones(len(m), dtype=bool)


def judged_rows(
    m: Measurements, told: Mask, fitted: Mask, poses: NDArray[np.int_], *, registered: bool
) -> Mask:
    """Which rows a robot is judged by, shape (N,).

    Those that the calibration was not fitted to, if the table sets some of them aside or they are of five poses; and of
    these the validation rows, if there are any and something was registered to the others. Otherwise all.

    Args:
        m: The rows.
        told: Which rows measure something.
        fitted: Which of them the calibration was fitted to.
        poses: The number of each row's pose.
        registered: Whether something was registered to the estimation rows.
    """
    fresh = told & ~fitted
    aside = fresh & m.validation & np.any(m.estimation)
    enough = np.any(aside) or len(np.unique(poses[fresh])) >= FEWEST_APART
    if np.any(fitted) and not enough:
        return told
    return np.asarray(aside if registered and np.any(aside) else fresh)
