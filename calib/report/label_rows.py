"""The rows of a calibration as pictures show them: which do not fit, how large errors are, where targets were."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calib.data.measurements import Measurements
from calib.estimate.setup import Setup
from calib.result.calibration import Calibration
from calib.robot.robot import rigid_inverse

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def flagged_rows(c: Calibration) -> Mask:
    """The rows of either set that do not belong to the others, shape (N,)."""
    doubtful = {one.row for one in (*c.outliers, *c.suspects)}
    return np.array([row in doubtful for row in c.measurements.rows], dtype=np.bool_)


def lengths_of(residual: Array, used: Mask) -> Array:
    """Size of each row's error of length, shape (N,), [m]; NaN where none was measured."""
    return _norms(residual[:, :3], used[:, :3])


def angles_of(residual: Array, used: Mask) -> Array:
    """Size of each row's error of orientation, shape (N,), [rad]; NaN where none was measured."""
    return _norms(residual[:, 3:], used[:, 3:])


def placed(setup: Setup, m: Measurements) -> tuple[Array, Array]:
    """T_frame_base and T_tip_target of each row, shapes (N, 4, 4), [m]."""
    frames = np.array([setup.groups.index(group) for group in m.groups], dtype=np.int_)
    targets = np.array([setup.targets.index(target) for target in m.targets], dtype=np.int_)
    return setup.T_frame_base[frames], setup.T_tip_target[targets]


def measured_in_base(m: Measurements, T_frame_base: Array) -> Array:
    """Where the target was seen, in the base, shape (N, 3), [m]; NaN where that is not known.

    A target in a socket was where its set-up's frame stands. Distances and planes tell no place.
    """
    T_base_frame = rigid_inverse(T_frame_base)
    points = np.einsum("nij,nj->ni", T_base_frame[:, :3, :3], np.nan_to_num(m.points))
    known = m.where(lambda kind: kind.coordinates)
    return np.where(known[:, None], points + T_base_frame[:, :3, 3], np.nan)


def target_places(c: Calibration, q: Array, T_tip_target: Array) -> Array:
    """Where the calibrated robot puts the target at q of shape (N, m), in the base, shape (N, 3), [m]."""
    T = c.robot.poses(q)
    return np.asarray(np.einsum("nij,nj->ni", T[:, :3, :3], T_tip_target[:, :3, 3]) + T[:, :3, 3])


def _norms(values: Array, used: Mask) -> Array:
    """Norms of rows, NaN where nothing is used."""
    size = np.linalg.norm(np.where(used, values, 0.0), axis=1)
    return np.where(np.any(used, axis=1), size, np.nan)


#: The robots, and what was measured.
NOMINAL = "#45709c"
CALIBRATED = "#ee8420"
MEASURED = "#16202a"

#: The rows: those that the fit has seen, those that it has not, and those that do not belong to the others.
ESTIMATION = "#16202a"
VALIDATION = "#009e73"
OUTLIER = "#c8323c"

#: Lines of sight, and what they come from.
BEAM = "#a0569a"

#: From little to much, from pale to dark: how often the target is somewhere, how badly a position is known.
LITTLE_TO_MUCH = ("#fbe3b0", "#f5b13a", "#d6602a", "#8c2a4f")

#: Text and axes, what stands behind them, and lines of a grid.
INK = "#16202a"
SOFT = "#5a6875"
GRID = "#d8dee4"
