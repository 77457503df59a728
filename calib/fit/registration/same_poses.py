"""Repeated poses of a table: rows whose joint values are equal but for the controller's noise."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from calib.basics.arrays import Array, Integers, Mask

#: Rows whose joint values differ by no more than this are repeats of a pose [rad or m].
_SAME_POSE = 1e-3


def same_poses(joints: Array) -> Integers:
    """Number the poses at which rows were measured.

    The first row without a pose takes all rows near it that have none either, and so on.

    Args:
        joints: shape (N, n), joint values of each row [rad] or [m].

    Returns:
        shape (N,), pose of each row, numbered from 0 in the order of their first rows; repeats have one number.
    """
    unique, first, copy = np.unique(joints, axis=0, return_index=True, return_inverse=True)
    tree = cKDTree(unique)
    leader = first.copy()
    near = _has_neighbour(tree)
    free = np.ones(len(unique), dtype=bool)
    order_of_rows = np.argsort(first[near])
    for i in np.flatnonzero(near)[order_of_rows].tolist():
        if not free[i]:
            continue
        # A leader takes its free neighbours.
        taken = np.array(tree.query_ball_point(unique[i], _SAME_POSE, p=np.inf))
        taken = taken[free[taken]]
        leader[taken] = first[i]
        free[taken] = False
    leader_of_row = leader[copy.reshape(-1)]
    _, pose = np.unique(leader_of_row, return_inverse=True)
    return pose.reshape(-1)


def _has_neighbour(tree: cKDTree) -> Mask:
    """Mark the different points of a tree, n of them, that have another about as near as repeats are, shape (n,)."""
    reach = 1.01 * _SAME_POSE
    # To the second nearest, as a point is nearest to itself; infinite where none is within reach.
    distances, _ = tree.query(tree.data, k=[2], p=np.inf, distance_upper_bound=reach)
    return np.asarray(distances[:, 0] < reach)
