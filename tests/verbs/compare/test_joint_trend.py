"""What one figure does over time, beside NumPy's and SciPy's fits, and how often chance is taken for a trend."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import curve_fit

from calib.verbs.compare.joint_trend import LEVEL, joint_trend

TIMES = np.array([0.0, 1.0, 2.1, 3.0, 4.2, 5.0])
STDS = np.array([0.05, 0.06, 0.05, 0.04, 0.05, 0.06])


def noise(seed: int) -> np.ndarray:
    return STDS * np.random.default_rng(seed).normal(size=len(TIMES))


def test_a_drift_has_the_slope_of_numpys_weighted_line():
    values = 0.3 * TIMES + noise(1)
    trend = joint_trend(TIMES, values, STDS)
    assert trend.shape == "drift"
    (slope, _), covariance = np.polyfit(TIMES, values, 1, w=1.0 / STDS, cov="unscaled")
    left = values - np.polyval(np.polyfit(TIMES, values, 1, w=1.0 / STDS), TIMES)
    scatter = max(float(np.sum((left / STDS) ** 2)) / 4.0, 1.0)
    assert trend.rate == pytest.approx(slope)
    assert trend.rate_std == pytest.approx(np.sqrt(scatter * covariance[0, 0]))
    assert abs(trend.rate - 0.3) < 4.0 * trend.rate_std


def test_a_step_has_the_height_of_scipys_fit_and_its_place():
    values = np.where(TIMES >= 3.0, 0.4, 0.0) + noise(2)
    trend = joint_trend(TIMES, values, STDS)
    assert (trend.shape, trend.step_at) == ("step", 3)

    def stepped(t, a, h):
        return a + h * (t >= 3.0)

    (_, height), covariance = curve_fit(
        stepped, TIMES, values, (0.0, 0.0), STDS, absolute_sigma=True
    )
    left = values - stepped(TIMES, *curve_fit(stepped, TIMES, values, (0.0, 0.0), STDS)[0])
    scatter = max(float(np.sum((left / STDS) ** 2)) / 4.0, 1.0)
    assert trend.step == pytest.approx(height, rel=1e-5)
    assert trend.step_std == pytest.approx(np.sqrt(scatter * covariance[1, 1]), rel=1e-4)


def test_of_steady_figures_one_in_a_hundred_is_called_otherwise():
    count = 1000
    shapes = [joint_trend(TIMES, noise(k), STDS).shape for k in range(count)]
    called = sum(shape != "steady" for shape in shapes)
    # Steps at neighbouring dates are much alike, so that fewer are called than their bound allows.
    assert called <= LEVEL * count + 3.0 * np.sqrt(LEVEL * count)
    assert called >= 0.2 * LEVEL * count


def test_scatter_beyond_the_noise_is_no_drift():
    values = np.array([0.0, 1.0, -1.0, 1.0, -1.0, 0.2])
    trend = joint_trend(TIMES, values, STDS)
    assert trend.shape == "unsteady"
    assert trend.rate_std > 5.0 * joint_trend(TIMES, 0.02 * values, STDS).rate_std


def test_of_two_dates_a_change_is_neither_drift_nor_step():
    trend = joint_trend(np.array([0.0, 2.0]), np.array([0.0, 1.0]), np.array([0.1, 0.1]))
    assert (trend.shape, trend.step_at) == ("change", 1)
    assert trend.rate == pytest.approx(0.5)
    assert trend.rate_std == pytest.approx(0.1 * np.sqrt(2.0) / 2.0)
    assert trend.step_std == pytest.approx(0.1 * np.sqrt(2.0))


def test_results_of_one_date_have_no_trend_and_no_step_between_them():
    trend = joint_trend(np.zeros(3), np.array([0.0, 5.0, 9.0]), np.full(3, 0.1))
    assert (trend.shape, trend.rate, trend.rate_std) == ("steady", 0.0, np.inf)
    times = np.array([0.0, 0.0, 1.0, 1.0])
    trend = joint_trend(times, np.array([0.0, 0.1, 5.0, 5.1]), np.full(4, 0.1))
    assert (trend.shape, trend.step_at) == ("change", 2)
