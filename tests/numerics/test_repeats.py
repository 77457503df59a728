"""Scatter and correlation of repeats against the textbook, and without bias on drawn errors."""

from __future__ import annotations

import numpy as np
import pytest

from calib.numerics.repeats import scatter_of_repeats


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
    found = scatter_of_repeats(y, used, poses, weights)
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
        result = scatter_of_repeats(np.where(used, e, np.nan), used, poses, np.ones(len(e)))
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
        naive.append(scatter_of_repeats(*arguments).rho)
        right.append(scatter_of_repeats(*arguments, fitted=36).rho)
    assert np.mean(naive) < 0.5
    assert np.mean(right) == pytest.approx(0.6, abs=0.02)


def test_correlation_does_not_depend_on_the_units_of_lengths_and_angles():
    rng = np.random.default_rng(5)
    e, poses = measured(rng, [3] * 20, shared=1.0, noise=0.5, columns=6)
    units = np.array([1e-3, 1e-3, 1e-3, 20.0, 20.0, 20.0])
    used, weights = everything(e)
    one_unit = scatter_of_repeats(e / np.sqrt(_mean_squares(e)), used, poses, weights)
    two_units = scatter_of_repeats(e * units, used, poses, weights)
    assert two_units.rho == pytest.approx(one_unit.rho)
    np.testing.assert_allclose(
        two_units.within, scatter_of_repeats(e, used, poses, weights).within * units[[0, 3]]
    )


def _mean_squares(e):
    """Of lengths in the first three columns, and of angles in the others."""
    return np.repeat([np.mean(e[:, :3] ** 2), np.mean(e[:, 3:] ** 2)], 3)
