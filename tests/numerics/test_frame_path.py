"""Steps and a drift of a frame, in readings of targets that stand still, and in residuals of poses."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import f

from calib.numerics.frame_path import (
    LEVEL,
    Change,
    Evidence,
    Form,
    _p_value,
    find_path,
    interval_of_places,
)

#: Standard deviation of a coordinate.
NOISE = 1e-5


def source(places, displaced, rng, *, targets=0, noise=NOISE, span=60):
    """Readings of targets in turn, or poses, (K, 3); a target's place, or a constant, is in the base."""
    count = len(places)
    base = np.zeros((3 * count, 3 * max(targets, 1)))
    for i in range(count):
        for axis in range(3):
            base[3 * i + axis, 3 * (i % max(targets, 1)) + axis] = 1.0
    base /= np.linalg.norm(base, axis=0)
    values = displaced + noise * rng.normal(size=(count, 3))
    directions = np.tile(np.hstack([np.eye(3), np.zeros((3, 3))]), (count, 1))
    return Evidence(
        base=base,
        residual=(values / noise).ravel() if not targets else values.ravel(),
        places=np.repeat(np.asarray(places, dtype=float), 3),
        directions=directions / (1.0 if targets else noise),
        moved={"frame": np.ones(3 * count, dtype=bool)},
        readings=np.repeat(np.arange(count), 3) if targets else np.full(3 * count, -1),
        span=span,
    )


POSES = np.array([place for place in range(61) if place % 10])
VISITS = np.arange(0, 61, 10)
POSSIBLE = [
    Change(Form.DRIFT, 0, "frame", usual=True),
    *(Change(Form.STEP, place, "frame", usual=True) for place in range(1, 61)),
    *(Change(Form.READING, k, "reading") for k in range(7)),
]


def path_of(displacement, seed=1, *, with_poses=True, noise_of_poses=3e-5):
    """The path that is found of a displacement as a function of the place, (n,) -> (n, 3)."""
    rng = np.random.default_rng(seed)
    readings = source(VISITS, displacement(VISITS), rng, targets=1)
    poses = source(POSES, displacement(POSES), rng, noise=noise_of_poses)
    return find_path(readings, poses if with_poses else None, POSSIBLE)


def step_at(place, by):
    return lambda places: (np.asarray(places) >= place)[:, None] * np.asarray(by)


def test_a_step_is_placed_by_the_poses():
    by = np.array([6e-5, -3e-5, 5e-5])
    path = path_of(step_at(34, by))
    (change,) = path.changes
    assert change.form is Form.STEP
    median, first, last = interval_of_places(path.places[0])
    assert first <= 34 <= last
    assert abs(median - 34) <= 1
    assert last - first <= 4
    error = path.unknowns - by
    assert error @ np.linalg.solve(path.covariance, error) < 16.3  # chi-square with 3, p = 0.001
    assert path.p[0] < 1e-6


def test_readings_alone_leave_the_place_between_two_of_them():
    by = np.array([6e-5, -3e-5, 5e-5])
    path = path_of(step_at(34, by), with_poses=False)
    (change,) = path.changes
    assert change.form is Form.STEP
    places = path.places[0]
    assert list(places) == list(range(31, 41))
    np.testing.assert_allclose(list(places.values()), 0.1, atol=1e-9)
    np.testing.assert_allclose(path.shares(0, np.array([30.0, 35.0, 40.0]), 60), [0.0, 0.5, 1.0])
    # Three readings after it and four before.
    std = path.scatter * np.sqrt(1.0 / 3.0 + 1.0 / 4.0)
    np.testing.assert_allclose(np.sqrt(np.diag(path.covariance)), std, rtol=1e-9)
    assert path.freedom == 7 * 3 - 3 - 3


def test_a_drift():
    by = np.array([0.0, 9e-5, -4e-5])
    path = path_of(lambda places: np.asarray(places)[:, None] / 60.0 * by)
    (change,) = path.changes
    assert change.form is Form.DRIFT
    error = path.unknowns - by
    assert error @ np.linalg.solve(path.covariance, error) < 16.3
    np.testing.assert_allclose(path.shares(0, np.array([0.0, 15.0, 60.0]), 60), [0.0, 0.25, 1.0])


def test_a_drift_and_a_step():
    by, drift = np.array([0.0, 2e-4, 0.0]), np.array([3e-4, 0.0, 0.0])
    path = path_of(lambda t: step_at(22, by)(t) + np.asarray(t)[:, None] / 60.0 * drift)
    assert [change.form for change in path.changes] == [Form.DRIFT, Form.STEP]
    np.testing.assert_allclose(path.unknowns[path.slices()[0]], drift, atol=6e-5)
    np.testing.assert_allclose(path.unknowns[path.slices()[1]], by, atol=6e-5)


def test_a_reading_that_is_off_moves_no_pose():
    rng = np.random.default_rng(4)
    displaced = np.zeros((7, 3))
    displaced[3, 0] = 3e-4
    readings = source(VISITS, displaced, rng, targets=1)
    poses = source(POSES, np.zeros((54, 3)), rng, noise=3e-5)
    (change,) = find_path(readings, poses, POSSIBLE).changes
    assert (change.form, change.place) == (Form.READING, 3)


def test_poses_alone_show_nothing():
    rng = np.random.default_rng(5)
    readings = source(VISITS, np.zeros((7, 3)), rng, targets=1)
    poses = source(POSES, step_at(34, [1e-3, 0.0, 0.0])(POSES), rng, noise=3e-5)
    assert find_path(readings, poses, POSSIBLE).changes == ()


def test_the_test_of_the_readings_is_an_f_test():
    rng = np.random.default_rng(6)
    readings = source(VISITS, np.zeros((7, 3)), rng, targets=1)
    # By hand: regression of each coordinate on the place.
    y = readings.residual.reshape(7, 3)
    t = VISITS - VISITS.mean()
    slope = t @ y / (t @ t)
    left = y - y.mean(axis=0) - t[:, None] * slope
    F = (t @ t * np.sum(slope**2) / 3) / (np.sum(left**2) / (21 - 3 - 3))
    p = f.sf(F, 3, 15)
    # A third of the false alarms is for drifts.
    assert _p_value((readings,), POSSIBLE[0], POSSIBLE) == pytest.approx(min(3.0 * p, 1.0))


@pytest.mark.slow
def test_false_alarms_are_as_rare_as_stated():
    still = lambda places: np.zeros((len(places), 3))  # noqa: E731
    for with_poses in (False, True):
        alarms = sum(
            bool(path_of(still, seed, with_poses=with_poses).changes) for seed in range(500)
        )
        # 500 tables of probability LEVEL have more than this by chance once in a thousand.
        assert alarms <= 500 * LEVEL + 3.1 * np.sqrt(500 * LEVEL)


def test_intervals_of_places():
    assert interval_of_places({4: 0.01, 5: 0.02, 6: 0.9, 9: 0.07}) == (6, 5, 9)
    assert interval_of_places({7: 1.0}) == (7, 7, 7)
