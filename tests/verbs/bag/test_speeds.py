"""Velocities, means and runs, of motions whose own are known."""

from __future__ import annotations

import numpy as np

from calib.verbs.bag.speeds import means, runs, velocities

T = np.arange(0.0, 10.0, 0.01)
GRID = np.arange(1.0, 9.0, 0.25)


def test_the_velocity_of_a_line_is_its_slope_and_that_of_a_wave_its_mean_difference():
    values = np.column_stack([3.0 * T - 1.0, np.sin(2.0 * T)])
    found = velocities(T, values, GRID, 0.1)
    np.testing.assert_allclose(found[:, 0], 3.0, atol=1e-9)
    # Means over 0.1 s of a wave, 0.1 s apart: its derivative times sinc^2 of half the phase.
    damped = 2.0 * np.cos(2.0 * GRID) * (np.sin(0.1) / 0.1) ** 2
    np.testing.assert_allclose(found[:, 1], damped, atol=1e-3)


def test_means_are_over_the_time_before_and_after():
    np.testing.assert_allclose(means(T, T**2, GRID, 0.1), GRID**2 + 0.1**2 / 3.0, atol=1e-4)


def test_runs_begin_and_end_where_it_holds():
    assert runs(np.array([True, False, True, True, False, True])) == [(0, 0), (2, 3), (5, 5)]
    assert runs(np.zeros(3, dtype=bool)) == []
