"""Labels of rows as numbers: merged labels, repeated poses, and stations that known distances join."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from calib.basics.arrays import Array, Integers
from calib.fit.registration.rows import Rows
from calib.fit.registration.setup import KnownDistance
from calib.numerics.moves import SAME_POSE


def joined_labels(labels: Integers, pairs: Sequence[tuple[int, int]]) -> Integers:
    """Merge the labels of pairs of entries.

    Args:
        labels: shape (N,), >= 0.
        pairs: Indices of entries whose labels become one.

    Returns:
        shape (N,), merged labels, numbered from 0 in the order of the smallest label of each.
    """
    if len(pairs):
        # Imported late, as few tables have any.
        from scipy.sparse import coo_matrix
        from scipy.sparse.csgraph import connected_components

        count = int(labels.max()) + 1
        first, second = labels[np.array(pairs)].T
        entries = np.ones(len(first))
        graph = coo_matrix((entries, (first, second)), shape=(count, count))
        # Components are numbered in the order of their smallest labels.
        _, component = connected_components(graph, directed=False)
        labels = component[labels]
    _, number = np.unique(labels, return_inverse=True)
    return number.reshape(-1)


def same_poses(joints: Array) -> Integers:
    """Number the poses at which rows were measured: joint values that are equal except for the controller's noise.

    The first row without a pose takes all rows near it that have none either, and so on.

    Args:
        joints: shape (N, n), joint values of each row [rad] or [m].

    Returns:
        shape (N,), pose of each row, numbered from 0 in the order of their first rows; repeats have one number.
    """
    unique, first, copy = np.unique(joints, axis=0, return_index=True, return_inverse=True)
    tree = cKDTree(unique)
    # Only those with a neighbour, about as near as repeats are, can be repeats. It is the second nearest point, as a
    # point is nearest to itself; infinitely far if none is within reach.
    reach = 1.01 * SAME_POSE
    distances, _ = tree.query(tree.data, k=[2], p=np.inf, distance_upper_bound=reach)
    near = distances[:, 0] < reach

    leader = first.copy()
    free = np.ones(len(unique), dtype=bool)
    order_of_rows = np.argsort(first[near])
    for i in np.flatnonzero(near)[order_of_rows].tolist():
        if not free[i]:
            continue
        # A leader takes its free neighbours.
        taken = np.array(tree.query_ball_point(unique[i], SAME_POSE, p=np.inf))
        taken = taken[free[taken]]
        leader[taken] = first[i]
        free[taken] = False
    leader_of_row = leader[copy.reshape(-1)]
    _, pose = np.unique(leader_of_row, return_inverse=True)
    return pose.reshape(-1)


def joined_stations(rows: Rows, distances: Sequence[KnownDistance]) -> Integers:
    """Number the station of each of N rows, shape (N,), from 0; stations with a known distance between them are one."""
    pairs = [(distance.first, distance.second) for distance in distances]
    # A distance may be to a frame that these rows do not see.
    highest = max((max(pair) for pair in pairs), default=0)
    highest = max(highest, int(rows.samples.frame.max()))
    return joined_labels(np.arange(highest + 1), pairs)[rows.samples.frame]
