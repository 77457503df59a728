"""Set-ups that are alike raise no alarms; one that differs is named."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from calib.identify.unpredicted import prediction_square, unpredicted_setup

NAMES = ("front", "left", "back", "right")


def judged(rng, *, changed=0.0, poses=15, parameters=24, sigma=1.0):
    """Four set-ups with a frame each, measured on one arm; the third with other parameters by so much.

    Each is predicted from the three others, whose parameters and noise come from their own least squares fit.
    """
    rows = 3 * poses
    A = [rng.normal(size=(rows, parameters)) for _ in NAMES]
    B = [rng.normal(size=(rows, 6)) for _ in NAMES]
    x = [rng.normal(size=parameters)] * 4
    x[2] = x[2] + changed * rng.normal(size=parameters)
    y = [
        a @ v + b @ rng.normal(size=6) + sigma * rng.normal(size=rows)
        for a, b, v in zip(A, B, x, strict=True)
    ]
    squares, freedoms, noises, noise_freedoms = [], [], [], []
    for g in range(4):
        others = [k for k in range(4) if k != g]
        frames = np.zeros((3 * rows, 18))
        for i, k in enumerate(others):
            frames[i * rows : (i + 1) * rows, 6 * i : 6 * i + 6] = B[k]
        full = np.hstack([np.vstack([A[k] for k in others]), frames])
        target = np.concatenate([y[k] for k in others])
        solution = np.linalg.lstsq(full, target, rcond=None)[0]
        covariance = np.linalg.inv(full.T @ full)[:parameters, :parameters]
        freedom = len(target) - full.shape[1]
        noises.append(np.sum((target - full @ solution) ** 2) / freedom)
        noise_freedoms.append(freedom)
        r = y[g] - A[g] @ solution[:parameters]
        square, left = prediction_square(r, A[g], covariance, B[g])
        squares.append(square)
        freedoms.append(left)
    arrays = [np.array(v, dtype=float) for v in (squares, freedoms, noises, noise_freedoms)]
    return unpredicted_setup(NAMES, *arrays), arrays


def test_the_ratio_of_alike_set_ups_is_fishers():
    rng = np.random.default_rng(0)
    p = []
    for _ in range(300):
        _, (squares, freedoms, noises, noise_freedoms) = judged(rng, sigma=0.3)
        F = squares[0] / freedoms[0] / noises[0]
        p.append(stats.f.sf(F, freedoms[0], noise_freedoms[0]))
    assert freedoms[0] == 45 - 6
    assert stats.kstest(p, "uniform").pvalue > 0.01


def test_alike_set_ups_raise_no_alarms():
    rng = np.random.default_rng(1)
    alarms = sum(bool(judged(rng, poses=8)[0]) for _ in range(300))
    assert alarms <= stats.binom.ppf(0.999, 300, 0.01)


def test_the_one_that_differs_is_named_first():
    rng = np.random.default_rng(2)
    for _ in range(20):
        found, _ = judged(rng, changed=1.0)
        assert found[0].name == "back"
        assert found[0].ratio > 1.5
        assert found[0].ratio ** 2 == pytest.approx(found[0].F)
    text = found[0].sentence()
    assert text.startswith("The other set-ups do not predict set-up 'back'")
    assert f"{found[0].ratio:.1f} times those expected" in text


def test_certain_but_small_differences_do_not_matter():
    squares, freedoms = np.array([1.0, 1.4**2, 1.6**2]) * 1e5, np.full(3, 1e5)
    found = unpredicted_setup(("a", "b", "c"), squares, freedoms, np.array(1.0), np.array(1e5))
    assert [s.name for s in found] == ["c"]


def test_large_but_uncertain_differences_are_chance():
    found = unpredicted_setup(
        ("a", "b"), np.array([20.0, 4.0]), np.array([4.0, 4.0]), np.array(1.0), np.array(3.0)
    )
    assert found == ()


def test_what_cannot_be_tested_is_not():
    squares, freedoms = np.array([1e9, 1e9, 900.0]), np.array([0.0, 10.0, 10.0])
    noise, noise_freedom = np.array([1.0, 0.0, 1.0]), np.array([50.0, 50.0, 50.0])
    found = unpredicted_setup(("a", "b", "c"), squares, freedoms, noise, noise_freedom)
    assert [s.name for s in found] == ["c"]


def test_the_nuisance_of_a_set_up_does_not_count():
    """However wrong the frame is that was taken, and whatever columns it has twice."""
    rng = np.random.default_rng(3)
    A, B, r = rng.normal(size=(30, 4)), rng.normal(size=(30, 6)), rng.normal(size=30)
    B = np.hstack([B, B[:, :2]])
    square, freedom = prediction_square(r, A, 0.5 * np.eye(4), B)
    moved, _ = prediction_square(r + B @ rng.normal(size=8) * 100.0, A, 0.5 * np.eye(4), B)
    assert freedom == 24
    assert moved == pytest.approx(square, rel=1e-8)


def test_the_square_is_that_of_the_whole_covariance():
    rng = np.random.default_rng(4)
    A, nuisance, r = rng.normal(size=(50, 7)), rng.normal(size=(50, 3)), rng.normal(size=50)
    root = rng.normal(size=(7, 5))  # a covariance that is singular
    whole = np.eye(50) + A @ root @ root.T @ A.T
    white = np.linalg.solve(np.linalg.cholesky(whole), np.column_stack([r, nuisance]))
    left = white[:, 0] - white[:, 1:] @ np.linalg.lstsq(white[:, 1:], white[:, 0], rcond=None)[0]
    square, degrees = prediction_square(r, A, root @ root.T, nuisance)
    assert square == pytest.approx(float(left @ left), rel=1e-10)
    assert degrees == 47


def test_a_large_set_up_needs_no_matrix_of_all_by_all():
    rng = np.random.default_rng(5)
    A = rng.normal(size=(60_000, 6))
    square, degrees = prediction_square(
        rng.normal(size=60_000), A, 1e-3 * np.eye(6), np.zeros((60_000, 0))
    )
    assert degrees == 60_000
    assert square == pytest.approx(60_000, rel=0.03)
