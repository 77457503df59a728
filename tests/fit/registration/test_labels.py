"""Labels of rows as numbers, and labels that are merged."""

from __future__ import annotations

import numpy as np
import pytest

from calib.fit.registration.labels import joined_labels, same_poses


def test_labels_of_pairs_become_one():
    labels = np.array([0, 1, 2, 3, 3])
    np.testing.assert_array_equal(joined_labels(labels, []), [0, 1, 2, 3, 3])
    # Entries 0 and 2 have one label then, and with entry 2 so has entry 4, whose label entry 3 has too.
    np.testing.assert_array_equal(joined_labels(labels, [(0, 2), (2, 4)]), [0, 1, 0, 0, 0])


def test_labels_are_numbered_anew_from_zero():
    np.testing.assert_array_equal(joined_labels(np.array([7, 4, 7]), []), [1, 0, 1])


def by_brute_force(joints):
    """Each row that has no pose yet takes all rows near it that have none either."""
    labels = np.full(len(joints), -1)
    for i in range(len(joints)):
        if labels[i] < 0:
            near = np.all(np.abs(joints - joints[i]) <= 1e-3, axis=1) & (labels < 0)
            labels[near] = labels.max() + 1
    return labels


@pytest.mark.parametrize("seed", range(6))
def test_poses_as_by_brute_force(seed):
    rng = np.random.default_rng(seed)
    count, n = int(rng.integers(1, 300)), int(rng.integers(1, 9))
    q = rng.uniform(-3.0, 3.0, (count, n)) * (0.003 if seed % 3 == 0 else 1.0)
    if seed % 3 == 1:
        q = q[rng.integers(0, count, count)] + rng.uniform(-6e-4, 6e-4, (count, n))
    if seed % 4 == 0:
        q[:, 0] = 0.0
    if seed % 5 == 0:
        q = np.round(q, 1)  # a grid, with many rows twice
    np.testing.assert_array_equal(same_poses(q), by_brute_force(q))
