"""Scores and weights against their definitions and their distribution."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2, f as f_distribution

from calib.estimate.robust import Limits, cauchy_weights, median_noise, pose_means, repeats, scores


def linear_rows(rng, n=25, p=12, noise=0.3, d=3):
    A = rng.normal(size=(n, d, p))
    x = rng.normal(size=p)
    return A, A @ x + noise * rng.normal(size=(n, d)), noise


def every(A):
    return np.ones(A.shape[:2], dtype=bool)


def fit_rows(A, y, weights):
    root = np.sqrt(weights)[:, None]
    flat = (A * root[:, :, None]).reshape(-1, A.shape[2])
    x = np.linalg.lstsq(flat, (y * root).ravel())[0]
    return x, np.linalg.inv(flat.T @ flat)


@pytest.mark.parametrize("weight", [1.0, 0.4, 0.0])
def test_the_score_is_the_deleted_residual_over_its_covariance(weight):
    """Against the fit that really leaves the row out."""
    A, y, noise = linear_rows(np.random.default_rng(0))
    weights = np.ones(len(A))
    weights[4] = weight
    x, inverse = fit_rows(A, y, weights)
    found = scores((y - A @ x) / noise, A / noise, inverse * noise**2, weights, every(A))
    for row in (4, 9):
        left = np.arange(len(A)) != row
        x_left, inverse_left = fit_rows(A[left], y[left], weights[left])
        deleted = y[row] - A[row] @ x_left
        covariance = noise**2 * (np.eye(3) + A[row] @ inverse_left @ A[row].T)
        assert found[row] == pytest.approx(np.sqrt(deleted @ np.linalg.solve(covariance, deleted)))


def test_scores_of_clean_rows_follow_chi_square_whatever_their_leverage():
    rng = np.random.default_rng(1)
    squares = []
    for _ in range(200):
        A, y, noise = linear_rows(rng)
        x, inverse = fit_rows(A, y, np.ones(len(A)))
        row_scores = scores(
            (y - A @ x) / noise, A / noise, inverse * noise**2, np.ones(len(A)), every(A)
        )
        squares.append(row_scores**2)
    flat = np.concatenate(squares)
    for probability in (0.5, 0.9, 0.99):
        assert np.mean(flat < chi2.ppf(probability, 3)) == pytest.approx(probability, abs=0.015)


@pytest.mark.parametrize("d", [1, 2, 6])
@pytest.mark.parametrize("n", [60, 120])
def test_rows_of_any_number_of_scalars_are_told_as_points(d, n):
    """The same share of good rows lies beyond any score, whatever the rows hold."""
    rng = np.random.default_rng(3)
    found = []
    for _ in range(100):
        A, y, noise = linear_rows(rng, n=n, p=8, d=d)
        x, inverse = fit_rows(A, y, np.ones(n))
        found.append(
            scores((y - A @ x) / noise, A / noise, inverse * noise**2, np.ones(n), every(A))
        )
    flat = np.concatenate(found)
    for probability in (0.5, 0.9, 0.99):
        assert np.mean(flat**2 < chi2.ppf(probability, 3)) == pytest.approx(probability, abs=0.015)


def test_scores_of_several_kinds_beside_each_other():
    """Unused columns are zero; a row without any has the score 0."""
    rng = np.random.default_rng(4)
    used = np.array(
        [[1, 1, 1, 1, 1, 1], [1, 1, 1, 0, 0, 0], [1, 0, 0, 0, 0, 0], [0] * 6], dtype=bool
    )
    residual = 2.0 * rng.normal(size=(4, 6)) * used
    found = scores(residual, np.zeros((4, 6, 2)), np.eye(2), np.ones(4), used)
    squares = np.sum(residual**2, axis=1)
    for row, d in enumerate((6, 3, 1)):
        assert chi2.sf(found[row] ** 2, 3) == pytest.approx(chi2.sf(squares[row], d))
    assert found[3] == 0.0


@pytest.mark.parametrize("d", [1, 6])
def test_scores_keep_their_order_where_the_tail_cannot_be_computed(d):
    norms = np.geomspace(0.3, 1e6, 400)
    residual = np.zeros((400, d))
    residual[:, 0] = norms
    used = np.ones((400, d), dtype=bool)
    found = scores(residual, np.zeros((400, d, 1)), np.eye(1), np.ones(400), used)
    assert np.all(np.isfinite(found))
    assert np.all(np.diff(found) > 0.0)
    assert found[-1] == pytest.approx(1e6, rel=1e-3)


@pytest.mark.parametrize("d", [1, 3, 6])
def test_median_noise_does_not_see_outliers(d):
    rng = np.random.default_rng(2)
    clean = np.linalg.norm(rng.normal(size=(20000, d)), axis=1)
    used = np.ones((20000, d), dtype=bool)
    assert median_noise(2.5 * clean[None], used)[0] == pytest.approx(2.5, rel=0.02)
    spoilt = 2.5 * clean
    spoilt[:2000] = 1e6
    assert median_noise(spoilt[None], used)[0] < 3.2


def test_median_noise_of_kinds_beside_each_other():
    rng = np.random.default_rng(5)
    used = np.arange(3) < rng.choice([0, 1, 3], size=20000)[:, None]
    norms = 0.4 * np.linalg.norm(rng.normal(size=(20000, 3)) * used, axis=1)
    assert median_noise(norms[None], used)[0] == pytest.approx(0.4, rel=0.03)


def test_limits_are_quantiles_of_f_and_keep_the_false_alarm_for_the_whole_table():
    limits = Limits.of(30, 60.0)
    assert f_distribution.sf(limits.flagged**2 / 3, 3, 60) == pytest.approx(0.01 / 30)
    assert f_distribution.sf(limits.full**2 / 3, 3, 60) == pytest.approx(0.01)
    assert Limits.of(1000, 60.0).flagged > limits.flagged
    assert Limits.of(30, 3.0).flagged > limits.flagged


def test_weights_fall_from_one_to_zero_between_the_limits():
    limits = Limits.of(30, 60.0)
    grid = np.linspace(0, 2 * limits.flagged, 400)
    weights = limits.weights(grid)
    assert np.all(weights[grid <= limits.full] == 1.0)
    assert np.all(weights[grid >= limits.flagged] == 0.0)
    assert np.all(np.diff(weights) <= 0.0)


def test_cauchy_weights_are_never_zero():
    weights = cauchy_weights(np.array([0.0, 3.4, 1e4]))
    assert weights[0] == 1.0
    assert weights[1] == pytest.approx(0.5)
    assert 0.0 < weights[2] < 1e-6


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
