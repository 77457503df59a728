"""Probabilities of conformity and risks, against SciPy's distributions and against drawn robots."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm, t

from calib.uncertainty.coverage import PROBABILITY
from calib.verbs.certificate.conformity import (
    conformance_probability,
    coverage_quantile,
    global_risks,
)


def test_the_quantile_is_two_or_students():
    assert coverage_quantile(np.inf) == pytest.approx(2.0)
    nu = np.array([1.0, 5.0, 10.0, 50.0])
    # JCGM 100, table G.2, in the column of 95.45 %.
    np.testing.assert_allclose(coverage_quantile(nu), [13.97, 2.65, 2.28, 2.05], atol=0.005)


def test_the_probability_of_conformity_is_that_of_a_normal_or_of_students_distribution():
    y, U = np.array([0.2, 0.45, 0.5, 0.6]), np.array([0.1, 0.1, 0.1, 0.05])
    known = conformance_probability(y, 0.5, U, np.full(4, np.inf))
    np.testing.assert_allclose(known, norm.cdf((0.5 - y) / (U / 2.0)), rtol=1e-9)
    few = conformance_probability(y, 0.5, U, np.full(4, 7.0))
    u = U / t(7).ppf((1.0 + PROBABILITY) / 2.0)
    np.testing.assert_allclose(few, t(7).cdf((0.5 - y) / u), rtol=1e-9)
    # At the limit of acceptance, a guard band of U below the tolerance, 2.3 % are left, whatever the freedom.
    at_limit = conformance_probability([0.4, 0.4], 0.5, [0.1, 0.1], [np.inf, 4.0])
    np.testing.assert_allclose(1.0 - at_limit, 0.5 * (1.0 - PROBABILITY), rtol=1e-9)


def test_without_uncertainty_it_is_the_plain_comparison():
    likely = conformance_probability([0.4, 0.5, 0.6], 0.5, [0.0, 0.0, 0.0], [np.inf, np.inf, 3.0])
    np.testing.assert_array_equal(likely, [1.0, 1.0, 0.0])


@pytest.mark.parametrize("band", [0.0, 0.05, 0.1])
@pytest.mark.parametrize("prior", [(0.3, 0.1), (0.45, 0.02), (0.7, 0.3)])
def test_global_risks_are_those_of_two_normal_variables(prior: tuple[float, float], band: float):
    tolerance, u = 0.5, 0.025
    mean, std = prior
    risks = global_risks(prior, tolerance, u, band)
    of_measured = std**2 + u**2
    both = multivariate_normal([mean, mean], [[std**2, std**2], [std**2, of_measured]])
    limit = tolerance - band
    right_accepted = both.cdf([tolerance, limit])
    accepted = norm(mean, np.sqrt(of_measured)).cdf(limit)
    assert risks.consumer == pytest.approx(accepted - right_accepted, rel=1e-5, abs=1e-12)
    right = norm(mean, std).cdf(tolerance)
    assert risks.producer == pytest.approx(right - right_accepted, rel=1e-5, abs=1e-12)


def test_global_risks_are_shares_of_drawn_robots():
    random = np.random.default_rng(3)
    true = random.normal(0.4, 0.1, 1_000_000)
    measured = true + 0.05 * random.normal(size=len(true))
    risks = global_risks((0.4, 0.1), 0.5, 0.05, 0.02)
    accepted = measured <= 0.5 - 0.02
    assert risks.consumer == pytest.approx(np.mean((true > 0.5) & accepted), abs=5e-4)
    assert risks.producer == pytest.approx(np.mean((true <= 0.5) & ~accepted), abs=1.5e-3)
