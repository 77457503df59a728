"""The evidence against SciPy's multivariate t, the level against fresh draws, the estimate against least squares."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_t, norm

from calib.verbs.check.evidence import (
    LEVEL,
    SIZES,
    Directions,
    EvidenceTest,
    estimate,
    log_weights,
)

RNG = np.random.default_rng(1)
WIDE = 1e4 * RNG.standard_normal((9, 6))
NARROW = 1e4 * RNG.standard_normal((9, 1))


@pytest.mark.parametrize("freedom", [4.0, 60.0])
def test_weights_are_ratios_of_multivariate_t(freedom: float):
    y = RNG.standard_normal((9, 3)) * 4.0
    causes = [Directions.of(WIDE, 1.0), Directions.of(NARROW, 0.1)]
    weights = log_weights(causes, y, freedom)
    assert weights.shape == (2, len(SIZES), 3)
    for k, (derivative, prior) in enumerate(((WIDE, 1.0), (NARROW, 0.1))):
        for i, size in enumerate(SIZES):
            moved = multivariate_t(
                shape=np.eye(9) + size**2 * derivative @ derivative.T, df=freedom
            )
            still = multivariate_t(shape=np.eye(9), df=freedom)
            expected = moved.logpdf(y.T) - still.logpdf(y.T) + np.log(prior / len(SIZES))
            np.testing.assert_allclose(weights[k, i], expected, rtol=1e-9)


def test_directions_without_effect_are_left_out():
    derivative = np.column_stack([NARROW, np.zeros(9)])
    shown = Directions.of(derivative, 1.0)
    assert shown.singular == pytest.approx([np.linalg.norm(NARROW)])
    assert len(Directions.of(np.zeros((9, 3)), 1.0).singular) == 0


@pytest.mark.parametrize("freedom", [6.0, np.inf])
def test_the_level_is_that_of_fresh_draws(freedom: float):
    causes = [Directions.of(WIDE, 1.0), Directions.of(NARROW, 1.0)]
    test = EvidenceTest.of(causes, 9, freedom)
    rng = np.random.default_rng(7)
    y = rng.standard_normal((9, 20_000))
    if np.isfinite(freedom):
        y /= np.sqrt(rng.chisquare(freedom, 20_000) / freedom)
    evidence = logsumexp(log_weights(causes, y, freedom), axis=(0, 1))
    assert np.mean(evidence > test.limit) == pytest.approx(LEVEL, abs=0.0015)
    p = np.array([test.p_value(one) for one in evidence[:2000]])
    assert np.mean(p < 0.1) == pytest.approx(0.1, abs=0.02)
    assert test.p_value(np.inf) == 1.0 / 20_001
    assert test.p_value(-np.inf) == 1.0


def test_what_is_noticed_of_a_single_direction_is_that_of_a_normal_number():
    causes = [Directions.of(NARROW, 1.0)]
    test = EvidenceTest.of(causes, 9, np.inf)
    # One direction alone: the evidence rises with its square, so that the test is one of a normal number.
    expected = norm.isf(LEVEL / 2.0) + norm.isf(0.05)
    direction = NARROW[:, 0] / np.linalg.norm(NARROW)
    assert test.detected_length(direction) == pytest.approx(expected, rel=0.04)


def test_a_large_displacement_is_estimated_as_by_least_squares():
    x = np.array([2e-3, -1e-3, 3e-3, 1e-3, -2e-3, 2e-3])
    y = WIDE @ x + np.random.default_rng(3).standard_normal(9)
    mean, covariance = estimate(Directions.of(WIDE, 1.0), y, np.inf)
    least_squares, *_ = np.linalg.lstsq(WIDE, y, rcond=None)
    inverse = np.linalg.inv(WIDE.T @ WIDE)
    np.testing.assert_allclose(mean, least_squares, atol=0.1 * np.sqrt(np.diag(inverse)).max())
    np.testing.assert_allclose(np.diag(covariance), np.diag(inverse), rtol=0.1)


def test_what_does_not_show_keeps_its_prior():
    derivative = np.column_stack([NARROW, np.zeros(9)])
    cause = Directions.of(derivative, 1.0)
    _, covariance = estimate(cause, np.zeros(9), np.inf)
    by_size = log_weights([cause], np.zeros((9, 1)), np.inf)[0, :, 0]
    share = np.exp(by_size - logsumexp(by_size))
    assert covariance[1, 1] == pytest.approx(share @ np.array(SIZES) ** 2)
