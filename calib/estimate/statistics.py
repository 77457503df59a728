"""What a fit is worth: errors, cross-validation, intervals. Arrays in, values out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.special import stdtrit

from calib.robot.robot import read_only

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Rows whose joint values differ by less than this are repeats of a pose [rad or m].
_SAME_POSE = 1e-3

#: Side of a cell in which repeats are looked for, and where the cells begin: no step that tables are made in, and no
#: joint at zero, stands at a wall. A row near more walls than that is looked at by the tree.
_CELL, _SHIFT, _MOST_WALLS = 97.13 * _SAME_POSE, 0.3819, 3

#: What the number of each joint's cell is multiplied by.
_HASH = np.random.default_rng(0).integers(1, 2**63, 256, dtype=np.uint64) | np.uint64(1)


@dataclass(frozen=True, slots=True, eq=False)
class Errors:
    """Errors of a set of rows, as in the paper's Tables 4 and 5: of lengths, and of angles where there are any."""

    n: int  # Number of rows with a measured length
    # Largest error, the norm of measured minus predicted position, or the size of that of a distance [m]; NaN where n
    # = 0, as all that follows
    max: float
    mean: float  # Mean of the norms [m]
    rms: float  # Root mean square of the norms [m]
    # shape (3,), mean signed error along x, y, z [m]; NaN where not all rows have three coordinates
    mean_axis: Array
    rms_axis: Array  # shape (3,), likewise
    span_axis: Array  # shape (3,), largest minus smallest signed error along x, y, z, likewise
    n_angle: int = 0  # Number of rows with a measured orientation
    # Largest angle between measured and predicted orientation [rad]; NaN where n_angle = 0
    max_angle: float = np.nan
    mean_angle: float = np.nan  # Mean of these angles [rad]
    rms_angle: float = np.nan  # Their root mean square [rad]

    @classmethod
    def of(cls, residual: Array, used: Mask | None = None) -> Errors:
        """From residuals, measured minus predicted.

        Example:
            >>> errors = Errors.of(np.array([[3e-3, 4e-3, 0.0], [0.0, 0.0, 0.0]]))
            >>> round(errors.mean, 6), round(errors.rms, 6)
            (0.0025, 0.003536)
        """
        used = np.ones(residual.shape, dtype=bool) if used is None else used
        there = np.any(used[:, :3], axis=1)
        turned = np.any(used[:, 3:], axis=1)
        lengths, axes = residual[there, :3], [np.full(3, np.nan)] * 3
        if residual.shape[1] >= 3 and np.any(there) and np.all(used[there, :3]):
            mean, rms = lengths.mean(axis=0), np.sqrt(np.mean(lengths**2, axis=0))
            axes = [mean, rms, np.ptp(lengths, axis=0)]
        of_lengths, of_angles = (
            _of_norms(np.linalg.norm(one, axis=1)) for one in (lengths, residual[turned, 3:])
        )
        mean_axis, rms_axis, span_axis = map(read_only, axes)
        return cls(*of_lengths, mean_axis, rms_axis, span_axis, *of_angles)


def _of_norms(norms: Array) -> tuple[int, float, float, float]:
    """Number, largest, mean and root mean square; NaN where there are none."""
    if len(norms) == 0:
        return 0, np.nan, np.nan, np.nan
    rms = float(np.sqrt(np.mean(norms**2)))
    return len(norms), float(norms.max()), float(norms.mean()), rms


@dataclass(frozen=True, slots=True, eq=False)
class CrossValidation:
    """Errors on rows that the fit did not see."""

    # ``"leave-one-out"``, ``"leave-one-pose-out"`` where poses were repeated, ``"leave-one-set-up-out"`` or
    # ``"10-fold"``
    method: str
    folds: int  # Number of fits
    poses: NDArray[np.int_]  # shape (N,), the pose of each row, see `same_poses`
    # shape (N, D), measured minus predicted by the fit that had not seen the row [m], [rad]
    residual: Array
    errors: Errors  # Of all rows
    errors_without_outliers: Errors  # Of the rows that the fit to all rows did not flag


def same_poses(joints: Array) -> NDArray[np.int_]:
    """Which pose each row was measured at: repeats of a pose get the same number, from 0 on.

    joints has the shape (N, n), [rad] or [m]; rows within `_SAME_POSE` of another in every joint are repeats of it.

    Returns:
        shape (N,).
    """
    leader = np.arange(len(joints))
    others = np.flatnonzero(~_alone(joints))
    if len(others):
        # Rows that are the same to the bit, such as commanded values, are asked about once, in the table's order.
        unique, first, copy = np.unique(
            joints[others], axis=0, return_index=True, return_inverse=True
        )
        found, free = first.copy(), np.ones(len(unique), dtype=bool)
        tree = cKDTree(unique)
        for i in np.argsort(first).tolist():
            if free[i]:  # a leader takes its neighbours, and they are asked no more
                near = np.array(tree.query_ball_point(unique[i], _SAME_POSE, p=np.inf))
                near = near[free[near]]
                found[near], free[near] = first[i], False
        leader[others] = others[found[copy.reshape(-1)]]
    return np.unique(leader, return_inverse=True)[1].reshape(-1)


def _alone(joints: Array) -> Mask:
    """Rows that no other row can be a repeat of, shape (N,).

    Each row lies in one cell of a coarse grid, and near a wall in the next one too. Who has its cells to itself has no
    neighbour; two cells taken for one by their hash, or a row near many walls, only hide some of these rows. A sort
    takes far less time than to ask a tree for the neighbours of each row.
    """
    number = np.floor(joints / _CELL + _SHIFT)
    inside = joints - (number - _SHIFT) * _CELL
    before, behind = inside < 1.01 * _SAME_POSE, inside > _CELL - 1.01 * _SAME_POSE
    alone: Mask = np.sum(before | behind, axis=1) <= _MOST_WALLS
    factors = _HASH[np.arange(joints.shape[1]) % len(_HASH)]
    row = np.arange(len(joints))
    cell = (number.astype(np.int64).astype(np.uint64) * factors).sum(axis=1, dtype=np.uint64)
    for column, factor in enumerate(factors):
        low, high = (np.flatnonzero((wall[:, column] & alone)[row]) for wall in (before, behind))
        row = np.concatenate([row, row[low], row[high]])
        cell = np.concatenate([cell, cell[low] - factor, cell[high] + factor])
    _, entry, count = np.unique(cell, return_inverse=True, return_counts=True)
    alone[row[count[entry] > 1]] = False
    return alone


def interval_factor(freedom: float, level: float = 0.95) -> float:
    """How many standard deviations the two-sided interval reaches: Student's t.

    Args:
        freedom: Degrees of freedom of the noise's estimate.
        level: Probability that the interval holds the true value.

    Example:
        >>> round(interval_factor(1e6), 3)
        1.96
    """
    return float(stdtrit(max(freedom, 1.0), 0.5 + level / 2.0))
