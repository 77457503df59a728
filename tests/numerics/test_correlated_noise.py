"""Correlated errors of poses: made independent, and their noise against SciPy's likelihood and known sizes."""

from __future__ import annotations

from dataclasses import astuple, replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from calib.numerics.correlated_noise import PoseNoise, likeliest_noise, standardisers
from tests.covariances import draw, random_covariances

TRUE = PoseNoise(scale=0.4, position=1.5e-4, orientation=8e-4, joint=3e-4)
START = PoseNoise(scale=1.0, position=3e-5, orientation=1e-4, joint=1e-4)


def by_joints(rng, count):
    """What errors of six joints do to a pose half a metre away."""
    J = rng.normal(size=(count, 6, 6)) * np.repeat([0.5, 1.0], 3)[:, None]
    return J @ J.transpose(0, 2, 1)


def test_errors_become_independent_of_variance_one():
    V = random_covariances(np.random.default_rng(1), 40)
    W = standardisers(V)
    np.testing.assert_allclose(
        W @ V @ W.transpose(0, 2, 1), np.tile(np.eye(6), (40, 1, 1)), atol=1e-9
    )


def test_the_position_is_taken_as_the_orientation_predicts_it():
    """A standardised orientation has no part of the position; a position is what the orientation does not predict."""
    V = random_covariances(np.random.default_rng(2), 1)[0]
    W = standardisers(V[None])[0]
    np.testing.assert_array_equal(W[3:, :3], 0.0)
    regression = V[:3, 3:] @ np.linalg.inv(V[3:, 3:])
    np.testing.assert_allclose(W[:3, 3:], -W[:3, :3] @ regression, rtol=1e-8)
    left = V[:3, :3] - regression @ V[3:, :3]
    np.testing.assert_allclose(W[:3, :3] @ left @ W[:3, :3].T, np.eye(3), atol=1e-9)


def test_a_covariance_that_is_none_is_refused():
    with pytest.raises(np.linalg.LinAlgError):
        standardisers(-np.eye(6)[None])


def test_the_covariance_has_all_four_parts():
    stated, of_joints = np.full((1, 6, 6), 2.0), np.full((1, 6, 6), 5.0)
    V = PoseNoise(3.0, 10.0, 100.0, 7.0).covariances(stated, of_joints)[0]
    assert V[0, 1] == V[0, 4] == V[4, 5] == 9.0 * 2.0 + 49.0 * 5.0
    np.testing.assert_allclose(np.diagonal(V) - V[0, 1], [1e2, 1e2, 1e2, 1e4, 1e4, 1e4])


def test_the_noise_of_many_poses_is_found():
    rng = np.random.default_rng(3)
    stated, of_joints = random_covariances(rng, 4000), by_joints(rng, 4000)
    e = draw(rng, TRUE.covariances(stated, of_joints))
    squares = e[:, :, None] * e[:, None]
    found = likeliest_noise(stated, of_joints, squares, np.ones(4000), START)
    assert astuple(found) == pytest.approx(astuple(TRUE), rel=0.05)


@pytest.mark.parametrize("name", ["scale", "position", "orientation", "joint"])
def test_no_other_noise_is_likelier(name):
    """By SciPy's densities of the errors, with the prior of the scale: a factor of ten either way."""
    rng = np.random.default_rng(4)
    stated, of_joints = random_covariances(rng, 60), by_joints(rng, 60)
    e = draw(rng, TRUE.covariances(stated, of_joints))
    weights = rng.choice([0.5, 1.0], 60)
    squares = e[:, :, None] * e[:, None]
    found = likeliest_noise(stated, of_joints, squares, weights, START)

    def log_density(noise):
        V = noise.covariances(stated, of_joints)
        of_rows = [multivariate_normal(cov=v).logpdf(row) for v, row in zip(V, e, strict=True)]
        return weights @ of_rows - 0.5 * (np.log(noise.scale) / np.log(10.0)) ** 2

    best = log_density(found)
    for factor in (0.98, 1.02):
        other = replace(found, **{name: factor * getattr(found, name)})
        assert log_density(other) < best


def test_rows_without_weight_do_not_count():
    rng = np.random.default_rng(5)
    stated, of_joints = random_covariances(rng, 50), by_joints(rng, 50)
    squares = TRUE.covariances(stated, of_joints)
    weights = np.repeat([1.0, 0.0], 25)
    wrong = squares.copy()
    wrong[25:] *= 100.0
    found = likeliest_noise(stated, of_joints, wrong, weights, START)
    same = likeliest_noise(stated[:25], of_joints[:25], squares[:25], np.ones(25), START)
    assert astuple(found) == pytest.approx(astuple(same), rel=1e-6)


def test_a_robot_without_turning_joints_has_no_noise_of_theirs():
    rng = np.random.default_rng(6)
    stated, none = random_covariances(rng, 500), np.zeros((500, 6, 6))
    true = replace(TRUE, joint=0.0)
    e = draw(rng, true.covariances(stated, none))
    found = likeliest_noise(stated, none, e[:, :, None] * e[:, None], np.ones(500), START)
    assert found.joint == 0.0
    assert astuple(found)[:3] == pytest.approx(astuple(true)[:3], rel=0.15)
