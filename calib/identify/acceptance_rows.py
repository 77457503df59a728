"""Which rows a robot is judged by: not those that a calibration was fitted to, if others are left.

A row that a result was fitted to is known again by what was left over there: the residuals of the nominal and of the
calibrated robot, which hang on every digit of its joint values and of what was measured. So it is known in any file,
in any order, and under any number.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from calib.identify.evaluation import Evaluation
from calib.identify.result import Calibration
from calib.measure.measurements import Measurements
from calib.model.robot import read_only

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Residuals that differ by less are those of one row [m]: far above rounding, far below what repeats differ by.
_SAME = 1e-7

#: From this many poses on, rows are judged alone that the table itself does not set aside from the fitted ones.
FEWEST_APART = 5


@dataclass(frozen=True, slots=True, eq=False)
class FittedRows:
    """The rows that a result was fitted to, by what is left over in them.

    Attributes:
        residuals: By the number k of lengths that a row measures, shape (R, 2, k): of the nominal and of the
            calibrated robot [m].
    """

    residuals: Mapping[int, Array]

    @classmethod
    def of(cls, c: Calibration) -> FittedRows:
        """From a result."""
        found: dict[int, list[Array]] = {}
        for i in np.flatnonzero(c.rows.estimation):
            used = c.used[i, :3]
            both = (c.residual_nominal[i, :3][used], c.residual_calibrated[i, :3][used])
            if np.any(used):
                found.setdefault(int(used.sum()), []).append(np.array(both))
        return cls({k: read_only(np.array(values)) for k, values in found.items()})

    def among(self, nominal: Evaluation, calibrated: Evaluation) -> Mask:
        """Which rows of a table are some of these, shape (N,).

        Args:
            nominal: The errors of the nominal robot, with the result's own target and frame for it.
            calibrated: The errors of the robot with the result's joint origins, target and frame.
        """
        used = calibrated.used[:, :3]
        fitted = np.zeros(len(used), dtype=bool)
        both = [one.residual[:, :3] for one in (nominal, calibrated)]
        for k, stored in self.residuals.items():
            at = np.flatnonzero(used.sum(axis=1) == k)
            if not len(at):
                continue
            own = np.hstack([residual[at][used[at]].reshape(-1, k) for residual in both])
            tree = KDTree(stored.reshape(len(stored), -1))
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
