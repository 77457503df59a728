"""Poses of a table: rows whose joint values are the same but for the controller's noise."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from calib.units import Array, Integers

#: Rows whose joint values differ by less than this are repeats of a pose [rad or m].
_SAME_POSE = 1e-3


def same_poses(joints: Array) -> Integers:
    """Which pose each row (N, n), [rad] or [m], was measured at: repeats get the number of their first row's."""
    unique, first, copy = np.unique(joints, axis=0, return_index=True, return_inverse=True)
    tree, leader = cKDTree(unique), first.copy()
    reach = 1.01 * _SAME_POSE
    near = tree.query(unique, k=[2], p=np.inf, distance_upper_bound=reach)[0][:, 0] < reach
    free = np.ones(len(unique), dtype=bool)
    for i in np.flatnonzero(near)[np.argsort(first[near])].tolist():
        if free[i]:  # a leader takes its neighbours, which are then done with
            found = np.array(tree.query_ball_point(unique[i], _SAME_POSE, p=np.inf))
            found = found[free[found]]
            leader[found], free[found] = first[i], False
    return np.unique(leader[copy.reshape(-1)], return_inverse=True)[1].reshape(-1)
