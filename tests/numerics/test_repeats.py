"""Errors against the paper's own tables, folds, intervals."""

from __future__ import annotations

import numpy as np
import pytest

from calib.numerics.errors import Errors
from calib.numerics.intervals import interval_factor
from calib.numerics.repeats import repeats
from calib.numerics.scores import Limits
from calib.registration.same_poses import same_poses

# The paper's Table 4: errors of rows 31 to 35 before and after calibration [mm].
BEFORE = np.array(
    [
        [0.83, -2.71, -0.88],
        [-0.91, 0.89, 0.08],
        [-0.96, -0.56, -1.04],
        [3.12, -0.97, -1.28],
        [3.39, 1.09, 0.16],
    ]
)
AFTER = np.array(
    [
        [-1.10, 0.44, 0.39],
        [-1.46, 0.99, 0.90],
        [-0.93, -0.16, -0.39],
        [1.02, 1.37, 0.69],
        [-0.58, 1.43, 1.06],
    ]
)


def test_lengths_and_angles_of_several_kinds():
    """A pose, a point and a distance: what a row lacks does not count as an error of nothing."""
    residual = np.array(
        [[3.0, 0, 4.0, 0, 0.1, 0], [0, 2.0, 0, 0, 0, 0], [-1.0, 0, 0, 0, 0, 0], [0] * 6]
    )
    used = np.array([[1] * 6, [1, 1, 1, 0, 0, 0], [1, 0, 0, 0, 0, 0], [0] * 6], dtype=bool)
    errors = Errors.of(residual, used)
    assert (errors.n, errors.n_angle) == (3, 1)
    assert errors.mean == pytest.approx(8 / 3)
    assert errors.rms == pytest.approx(np.sqrt(30 / 3))
    assert (errors.max, errors.max_angle) == pytest.approx((5.0, 0.1))
    assert np.all(np.isnan(errors.mean_axis))  # not all have axes
    whole = Errors.of(residual[:2], used[:2])
    np.testing.assert_allclose(whole.mean_axis, [1.5, 1.0, 2.0])


@pytest.mark.parametrize(
    ("freedom", "factor"), [(1.0, 12.706), (10.0, 2.228), (63.0, 1.998), (1e9, 1.960)]
)
def test_interval_factor_is_students(freedom, factor):
    assert interval_factor(freedom) == pytest.approx(factor, abs=1e-3)


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


def measured(rng, counts, *, shared=1.0, noise=1.0, columns=3):
    """Residuals of poses with so many repeats each, what they share and what they do not."""
    poses = np.repeat(np.arange(len(counts)), counts)
    b = shared * rng.normal(size=(len(counts), columns))
    return b[poses] + noise * rng.normal(size=(len(poses), columns)), poses


def everything(residual):
    return np.ones(residual.shape, dtype=bool), np.ones(len(residual))


def test_the_textbook_s_anova_with_unequal_groups():
    """One component, by the formulas: MSW, MSB and n0 = (N - sum n^2 / N) / (k - 1)."""
    groups = [[1.0, 2.0, 3.0], [5.0, 7.0], [4.0], [0.0, 1.0, 1.0, 2.0]]
    y = np.concatenate(groups)[:, None]
    poses = np.repeat([3, 1, 7, 0], [len(g) for g in groups])
    used, weights = everything(y)
    grand = y.mean()
    msw = sum(np.sum((np.array(g) - np.mean(g)) ** 2) for g in groups) / (10 - 4)
    msb = sum(len(g) * (np.mean(g) - grand) ** 2 for g in groups) / 3
    n0 = (10 - (9 + 4 + 1 + 16) / 10) / 3
    shared = (msb - msw) / n0
    found = repeats(y, used, poses, weights)
    assert found.within[0] == pytest.approx(np.sqrt(msw))
    assert found.freedom == pytest.approx(6.0)
    assert found.rho == pytest.approx(shared / (shared + msw))


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
def test_no_bias_with_unequal_repeats(share):
    rng = np.random.default_rng(0)
    counts = rng.integers(1, 7, 200)
    found = []
    for _ in range(60):
        e, poses = measured(rng, counts, shared=np.sqrt(share), noise=np.sqrt(1 - share))
        used = rng.random(e.shape) < 0.9
        result = repeats(np.where(used, e, np.nan), used, poses, np.ones(len(e)))
        found.append((result.rho, result.within[0]))
    rho, within = np.mean(found, axis=0)
    # At 0 half of the estimates are cut off below.
    assert rho == pytest.approx(share, abs=0.015)
    assert within == pytest.approx(np.sqrt(1 - share), rel=0.02)


def test_parameters_of_the_fit_are_allowed_for():
    """30 poses and 36 parameters: without their number rho is far too small."""
    rng = np.random.default_rng(3)
    naive, right = [], []
    for _ in range(100):
        e, poses = measured(rng, [5] * 30, shared=np.sqrt(0.6), noise=np.sqrt(0.4))
        A = np.repeat(rng.normal(size=(30, 3, 36)), 5, axis=0).reshape(-1, 36)
        r = e.ravel() - A @ np.linalg.lstsq(A, e.ravel(), rcond=None)[0]
        arguments = (r.reshape(-1, 3), np.ones(e.shape, dtype=bool), poses, np.ones(len(e)))
        naive.append(repeats(*arguments).rho)
        right.append(repeats(*arguments, fitted=36).rho)
    assert np.mean(naive) < 0.5
    assert np.mean(right) == pytest.approx(0.6, abs=0.02)


def test_weights_fall_in_a_straight_line_between_the_limits():
    limits = Limits(np.array(2.0), np.array(4.0))
    scores = np.array([0.0, 1.9, 2.0, 2.2, 2.5, 3.0, 3.5, 3.9, 4.0, 40.0])
    expected = [1.0, 1.0, 1.0, 0.9, 0.75, 0.5, 0.25, 0.05, 0.0, 0.0]
    np.testing.assert_allclose(limits.weights(scores), expected, atol=1e-12)
    # Of two tables at once, each by its own.
    both = Limits(np.array([[2.0], [1.0]]), np.array([[4.0], [5.0]]))
    np.testing.assert_allclose(both.weights(np.array([[3.0], [2.0]])), [[0.5], [0.75]])
