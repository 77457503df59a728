"""Numbers of poses against a search by brute force."""

from __future__ import annotations

import numpy as np
import pytest

from calib.fit.registration.same_poses import same_poses


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
