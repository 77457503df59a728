"""Variance components of repeats: by hand, without bias, and what they are for."""

from __future__ import annotations

import numpy as np
import pytest

from calib.identify.robust import pose_means, repeats


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


def test_robust_weights_do_not_bias():
    """Weights below 1 that have nothing to do with the errors change what is expected of the sums, exactly."""
    rng = np.random.default_rng(1)
    found = []
    for _ in range(60):
        e, poses = measured(rng, [4] * 150, shared=0.8, noise=0.6)
        used, _ = everything(e)
        result = repeats(e, used, poses, rng.choice([0.0, 0.3, 1.0], len(e)))
        found.append((result.rho, result.within[0] ** 2))
    np.testing.assert_allclose(np.mean(found, axis=0), [0.64, 0.36], rtol=0.03)


def test_rows_of_weight_0_are_left_out():
    rng = np.random.default_rng(2)
    e, poses = measured(rng, [3] * 40)
    weights = np.ones(len(e))
    weights[::3] = 0.0
    spoilt = e.copy()
    spoilt[::3] = 1e6
    used, _ = everything(e)
    a = repeats(spoilt, used, poses, weights)
    b = repeats(e[weights > 0], used[weights > 0], poses[weights > 0], weights[weights > 0])
    assert a.rho == pytest.approx(b.rho)
    assert a.within[0] == pytest.approx(b.within[0])
    assert a.freedom == pytest.approx(40 * 3.0)


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


def test_positions_and_orientations_have_scatters_of_their_own():
    rng = np.random.default_rng(4)
    e, poses = measured(rng, [4] * 300, shared=1.0, noise=1.0, columns=6)
    e = e * np.repeat([1e-4, 3e-3], 3)
    found = repeats(e, np.ones(e.shape, dtype=bool), poses, np.ones(len(e)))
    np.testing.assert_allclose(found.within, [1e-4, 3e-3], rtol=0.06)
    np.testing.assert_allclose(found.freedoms, [2700, 2700])
    # Units do not matter to what they share.
    assert found.rho == pytest.approx(0.5, abs=0.04)
    assert not found.within.flags.writeable


def test_without_repeats_there_is_nothing_to_say():
    e, poses = measured(np.random.default_rng(5), [1] * 20)
    found = repeats(e, np.ones(e.shape, dtype=bool), poses, np.ones(20))
    assert (found.rho, found.freedom) == (0.0, 0.0)
    assert np.isnan(found.within).all()


def test_a_kind_that_was_never_repeated_has_no_scatter():
    e, poses = measured(np.random.default_rng(5), [2] * 20, columns=6)
    used, weights = everything(e)
    used[::2, 3:] = False
    found = repeats(e, used, poses, weights)
    np.testing.assert_array_equal(found.freedoms, [60.0, 0.0])
    assert np.isnan(found.within[1])


def test_no_error_and_no_scatter():
    nothing = np.zeros((8, 3))
    found = repeats(nothing, np.ones((8, 3), dtype=bool), np.arange(8) // 2, np.ones(8))
    assert (found.rho, found.freedom, found.within[0]) == (0.0, 12.0, 0.0)


def test_copies_of_a_row_share_everything():
    e = np.random.default_rng(6).normal(size=(10, 3)).repeat(3, axis=0)
    found = repeats(e, np.ones(e.shape, dtype=bool), np.arange(30) // 3, np.ones(30))
    assert found.rho == pytest.approx(1.0)


def test_one_pose_alone_shows_scatter_but_no_correlation():
    e, poses = measured(np.random.default_rng(7), [30])
    found = repeats(e, np.ones(e.shape, dtype=bool), poses, np.ones(30))
    assert found.rho == 0.0
    assert found.freedom == pytest.approx(87.0)


def test_the_weights_give_the_best_mean():
    """Poses with 1 and with 20 repeats: the mean weighted by 1 / (1 + (n - 1) rho) scatters least."""
    rng = np.random.default_rng(8)
    counts = np.array([1] * 15 + [20] * 5)
    spread = {"right": [], "all alike": [], "poses alike": []}
    for _ in range(400):
        e, poses = measured(rng, counts, shared=np.sqrt(0.5), noise=np.sqrt(0.5))
        rho = repeats(e, np.ones(e.shape, dtype=bool), poses, np.ones(len(e))).rho
        n = counts[poses]
        for name, w in (
            ("right", 1 / (1 + (n - 1) * rho)),
            ("all alike", np.ones(len(n))),
            ("poses alike", 1 / n),
        ):
            spread[name].append(w @ e / w.sum())
    sizes = {name: np.std(means) for name, means in spread.items()}
    assert sizes["right"] < 0.8 * sizes["all alike"]
    assert sizes["right"] < 1.01 * sizes["poses alike"]


def test_means_of_poses_are_as_large_as_rows():
    """Whatever repeats share, the weights 1 / (1 + (n - 1) rho) make their mean a row of the same variance."""
    rng = np.random.default_rng(6)
    counts = rng.integers(1, 8, 4000)
    residual, poses = measured(rng, counts, shared=0.6, noise=0.8)
    weights = 1.0 / (1.0 + (counts - 1.0) * 0.36)
    means, first = pose_means(residual[:, :, None], weights[poses], poses)
    assert means.shape == (4000, 3, 1)
    assert poses[first].tolist() == list(range(4000))
    for n in (1, 4, 7):
        assert np.std(means[counts == n]) == pytest.approx(1.0, abs=0.05)


def test_the_mean_of_a_pose_measured_once_is_its_row():
    values = np.arange(6.0).reshape(3, 2)
    means, first = pose_means(values, np.ones(3), np.array([2, 0, 1]))
    np.testing.assert_allclose(means, values[[1, 2, 0]])
    assert first.tolist() == [1, 2, 0]
