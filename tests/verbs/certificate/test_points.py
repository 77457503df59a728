"""Deviations at points and their uncertainty: by what was measured, against drawn errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.robot.robot import Robot
from calib.uncertainty.at_poses import Source
from calib.uncertainty.coverage import PROBABILITY
from calib.verbs.certificate.certificate import Certificate
from calib.verbs.certificate.points import MEASURING, PARTS, reading_noise, standard_uncertainty
from tests.verbs.certificate.certificates import fresh_rows, own


@pytest.fixture(scope="module")
def paper(ur3: Robot, table: Measurements, default_result: Calibration) -> Certificate:
    return own(ur3, table, default_result, sigma={"m": 2e-5})


def test_deviations_are_those_of_the_result_file_at_its_validation_rows(
    paper: Certificate, default_result: Calibration
):
    rows = default_result.rows
    chosen = rows.validation
    assert [point.rows for point in paper.points] == [(n,) for n in (31, 32, 33, 34, 35)]
    for name, residual in (
        ("found", rows.residual_nominal),
        ("left", rows.residual_calibrated),
    ):
        sizes = [getattr(one, name) for one in paper.of("m")]
        np.testing.assert_allclose(sizes, np.linalg.norm(residual[chosen], axis=1), rtol=1e-9)


def test_places_are_those_of_the_target_in_the_base(paper: Certificate):
    result = paper.calibration
    q = np.array([point.joints for point in paper.points])
    T = result.robot.poses(q) @ result.setup.T_tip_target[0]
    np.testing.assert_allclose([p.position for p in paper.points], T[:, :3, 3], atol=1e-12)


def test_the_sources_of_the_robot_are_what_is_measured():
    robot = {Source.INSTRUMENT, Source.REPEATABILITY, Source.LOST_MOTION, Source.MODEL}
    robot |= {Source.UNDETERMINED, Source.RESOLUTION}
    assert set(MEASURING) == set(Source) - robot


def test_u_is_the_length_that_drawn_errors_stay_below(paper: Certificate):
    result = paper.calibration
    q = np.array([point.joints for point in paper.points])
    uncertainty = result.uncertainty(q)
    random = np.random.default_rng(4)
    for k, one in enumerate(paper.of("m")):
        shared = [c.covariance[k][PARTS["m"], PARTS["m"]] for c in uncertainty.contributions
                  if c.source in MEASURING]  # fmt: skip
        V = sum(shared, 2e-5**2 * np.eye(3))
        drawn = random.multivariate_normal(np.zeros(3), V, size=200_000)
        quantile = np.quantile(np.linalg.norm(drawn, axis=1), PROBABILITY)
        assert one.uncertainty == pytest.approx(quantile, rel=0.06)
        assert one.factor == pytest.approx(one.uncertainty / np.sqrt(np.trace(V)), rel=1e-9)
        assert one.of_pose == pytest.approx(uncertainty.position[k], rel=1e-9)


def test_u_holds_at_drawn_readings(ruled: Certificate):
    """400 points whose true deviations are known: errors of the mean vector, and of its length."""
    left = ruled.assessment.evaluations["calibration"]
    true = np.linspace(1e-4, 2e-4, 400)
    errors = left.residual - np.outer(true, [1.0, 0.0, 0.0])
    U = np.array([one.uncertainty for one in ruled.of("m")])
    held = np.mean(np.linalg.norm(errors, axis=1) <= U)
    assert 0.93 < held < 0.99
    sizes = np.array([one.left for one in ruled.of("m")])
    assert np.mean(np.abs(sizes - true) <= U) > 0.98


@pytest.fixture(scope="module")
def ruled(ur3: Robot, table: Measurements, paper_cell: Cell) -> Certificate:
    """By an instrument whose lengths are right, for a target that is known: the readings alone are uncertain."""
    cell = replace(paper_cell, scale_certified=True, estimate_target=False, model="zeros")
    result = calibrate(ur3, table, cell=cell, validate=False)
    rows = fresh_rows(result, 1, 1e-5, kind="point", count=400)
    return own(ur3, rows, result, sigma={"m": 1e-5}, tolerance={"m": 1.5e-4})


def test_probabilities_of_conformity_are_shares_of_points(ruled: Certificate):
    """Half of the true deviations are within; where P(within) says so, they are."""
    within = np.linspace(1e-4, 2e-4, 400) <= 1.5e-4
    likely = np.array([one.conformance for one in ruled.of("m")])
    assert np.mean(within[likely > 0.9]) > 0.9
    assert np.mean(within[likely < 0.1]) < 0.2


def test_more_readings_of_a_pose_are_less_noise(ur3: Robot, default_result: Calibration):
    """Sixteen repeats that scatter as stated: a quarter of the noise; scale, frame and target are the same."""
    alone, often = (
        own(
            ur3, fresh_rows(default_result, n, 5e-5), default_result, sigma={"m": 1e-4, "rad": 1e-3}
        )
        for n in (1, 16)
    )
    for one, many in zip(alone.of("rad"), often.of("rad"), strict=True):
        assert one.freedom > 50
        # About an axis each; the angles of frame and target are the same in both.
        u, v = one.uncertainty / one.factor, many.uncertainty / many.factor
        assert u**2 - v**2 == pytest.approx(3 * 1e-3**2 * (1 - 1 / 16), rel=1e-6)
    for one, many in zip(alone.of("m"), often.of("m"), strict=True):
        u, v = one.uncertainty / one.factor, many.uncertainty / many.factor
        assert u**2 - v**2 == pytest.approx(3 * 1e-4**2 * (1 - 1 / 16), rel=1e-6)


def test_repeats_that_scatter_more_than_stated_count(ur3: Robot, default_result: Calibration):
    rows = fresh_rows(default_result, 10, 1e-4)
    c = own(ur3, rows, default_result, sigma={"m": 1e-5, "rad": 1e-4})
    left = c.assessment.evaluations["calibration"]
    poses = c.assessment.accuracies["calibration"].poses
    reading = reading_noise(default_result, Cell(sigma={"m": 1e-5}), left, poses, "m")
    assert reading.freedom == 8 * 9 * 3
    assert reading.sigma[0] == pytest.approx(1e-4, rel=0.15)
    low, high = chi2(reading.freedom).ppf([0.001, 0.999]) / reading.freedom
    assert low < (reading.sigma[0] / 1e-4) ** 2 < high
    assert reading.is_stated


def test_noise_that_nothing_states_is_what_the_calibration_left(
    ur3: Robot, table: Measurements, default_result: Calibration
):
    c = own(ur3, table, default_result)
    left = c.assessment.evaluations["calibration"]
    poses = c.assessment.accuracies["calibration"].poses
    reading = reading_noise(default_result, Cell(), left, poses, "m")
    assert not reading.is_stated
    assert reading.sigma[0] == default_result.noise.sigma["m"]
    assert reading.freedom == default_result.noise.freedom


def test_a_stated_uncertainty_is_that_of_all_points(
    ur3: Robot, table: Measurements, default_result: Calibration
):
    c = own(ur3, table, default_result, uncertainty={"m": 5e-5})
    for one in c.of("m"):
        assert (one.uncertainty, one.factor, one.freedom) == (5e-5, 2.0, np.inf)
        assert standard_uncertainty(one) == pytest.approx(2.5e-5)
