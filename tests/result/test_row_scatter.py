"""Scatter of rows about a model: what instrument, repeats and joints are of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.data.cell import Cell, StatedUncertainty, Tracker
from calib.data.measurements import Measurements
from calib.data.surroundings import TrackerNoise
from calib.result.calibrate import calibrate
from calib.result.row_scatter import instrument_variance, joint_twists
from calib.robot.ranges import random_joint_values
from calib.verbs.simulate.truth import draw_truth

#: Noise of a coordinate, and of an arrival of the arm [m].
NOISE, ARRIVAL = 4e-5, 8e-5


@pytest.fixture(scope="module")
def visited(ur3):
    """30 poses, three visits each, without cross-validation."""
    truth = draw_truth(ur3, "dh", {"length": 3e-4, "angle": 2e-3, "zero": 3e-3}, 3)
    q = np.tile(random_joint_values(ur3, 30, 5), (3, 1))
    rng = np.random.default_rng(8)
    points = truth.points(q) + np.hypot(NOISE, ARRIVAL) * rng.standard_normal((90, 3))
    table = Measurements(ur3.joint_names, q, points)
    return calibrate(ur3, table, cell=Cell(sigma={"m": NOISE}), model="dh", validate=False)


def with_cell(result, **changes):
    """The fit of a result with another cell."""
    fitted = result.fit.geometry
    return replace(fitted, task=replace(fitted.task, cell=replace(fitted.task.cell, **changes)))


def test_the_scatter_is_that_of_rows_and_repeats(visited):
    rows = visited.geometry.scatter
    both = NOISE**2 + ARRIVAL**2
    assert rows.total[0] == pytest.approx(both, rel=0.2)
    assert rows.within[0] == pytest.approx(both, rel=0.25)
    assert rows.within_freedom[0] == pytest.approx(3 * 60, abs=12)
    assert rows.freedom[0] == pytest.approx(visited.noise.freedom)
    assert rows.instrument[0] == pytest.approx(NOISE**2)
    assert np.isnan([rows.total[1], rows.within[1], rows.instrument[1]]).all()


def test_a_certificate_counts_before_what_is_stated_as_noise(visited):
    certificate = StatedUncertainty(
        instrument_limit=1e-5, instrument_limit_per_length=2e-5, instrument_limit_angle=3e-4
    )
    fitted = with_cell(visited, uncertainty=certificate)
    distance = np.sqrt(
        np.mean(np.sum(visited.predict(fitted.estimate.problem.rows.joints) ** 2, 1))
    )
    expected = (1e-5 + 2e-5 * distance) ** 2 / 3.0
    assert instrument_variance(fitted, "m", {"m": 1.0}) == pytest.approx(expected)
    assert instrument_variance(fitted, "rad", {}) == pytest.approx(9e-8 / 3.0)


def test_a_tracker_has_its_noise_at_the_distance_of_the_rows(visited):
    at = np.array([3.0, 0.0, 0.5])
    fitted = with_cell(visited, tracker=Tracker(at, noise=TrackerNoise(1e-5, 6e-6)))
    points = visited.predict(fitted.estimate.problem.rows.joints)
    distance = np.sqrt(np.mean(np.sum((points - at) ** 2, 1)))
    expected = (1e-5 + 6e-6 * distance) ** 2
    assert instrument_variance(fitted, "m", {}) == pytest.approx(expected)
    assert instrument_variance(fitted, "m", {"m": 2.0}) == 4.0
    assert np.isnan(instrument_variance(with_cell(visited), "m", {}))


def test_a_tracker_stands_where_it_is_on_the_base(ur3):
    frame = np.eye(4)
    frame[:3, :3] = np.diag([-1.0, -1.0, 1.0])
    frame[:3, 3] = (2.0, -0.5, 0.3)
    q = random_joint_values(ur3, 12, 5)
    points = ur3.poses(q)[:, :3, 3]
    at = np.array([0.4, 1.5, 0.5])
    cell = Cell(
        frames={"": frame}, tracker=Tracker(at, noise=TrackerNoise(0.0, 6e-6)), model="zeros"
    )
    table = Measurements(ur3.joint_names, q, points @ frame[:3, :3].T + frame[:3, 3])
    result = calibrate(ur3, table, cell=cell, validate=False)
    distance = np.sqrt(np.mean(np.sum((points - at) ** 2, 1)))
    found = instrument_variance(result.fit.geometry, "m", {})
    assert found == pytest.approx((6e-6 * distance) ** 2, rel=1e-3)


def test_joints_displace_poses_as_differences_of_predictions_do(visited):
    q = random_joint_values(visited.nominal, 5, 1)
    model, step = visited.geometry, 1e-4
    J = joint_twists(model.kinematics, model.x, visited.samples(q))
    for j in range(6):
        ahead = q.copy()
        ahead[:, j] += step
        moved = visited.predict(ahead) - visited.predict(q)
        assert J[:, :3, j] * step == pytest.approx(moved, abs=1e-8)
    assert np.linalg.norm(J[:, 3:], axis=1) == pytest.approx(np.ones((5, 6)), abs=1e-9)
    mean = np.mean(
        joint_twists(model.kinematics, model.x, visited.samples(visited.fit.measurements.joints))[
            :, :3
        ]
        ** 2,
        axis=(0, 1),
    )
    assert model.scatter.by_joints[0] == pytest.approx(mean)
