"""Additional unknowns beside those of a fit: the motion of the base, and patterns that held-out blocks confirm."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.data.cell import Cell
from calib.diagnosis.augmented_fit import (
    _residuals_without_blocks,
    estimate_jointly,
    gain_on_blocks,
)
from calib.model.error_model import FRAME
from calib.model.kinematics import Sightings
from calib.robot.ranges import random_joint_values
from tests.judged import arm, fit_to, moved, table_of


@pytest.fixture(scope="module")
def clean(make_scene):
    """A wrong UR3 and forty points of it in its base frame."""
    scene = arm(make_scene, 7)
    q = random_joint_values(scene.robot, 40, 7)
    return scene, table_of(scene, q, np.random.default_rng(7))


def test_unknowns_beside_are_those_of_a_fit_that_has_them(clean):
    """Six motions of the base beside a fit in a known frame: what a fit with an unknown frame finds."""
    scene, table = clean
    table = moved(table, (3e-3, -2e-3, 0.0), (4e-3, -3e-3, 0.0))
    free = fit_to(scene, table, Cell(model="dh", estimate_frame=True))
    known = fit_to(scene, table)
    rows = known.estimate.problem.rows
    T = known.kinematics.poses(known.estimate.x, rows.samples)
    columns = np.zeros((len(rows), 6, 6))
    columns[:, :3, :3], columns[:, 3:, 3:] = np.eye(3), np.eye(3)
    columns[:, :3, 3:] = np.cross(np.eye(3), T[:, :3, 3][:, :, None], axis=1)
    beside = estimate_jointly(known, rows.derivative(Sightings(T, columns)))
    found = free.estimated_setup().T_frame_base[0]
    np.testing.assert_allclose(beside.b[:3], found[:3, 3], atol=2e-5)
    np.testing.assert_allclose(
        beside.b[3:], Rotation.from_matrix(found[:3, :3]).as_rotvec(), atol=5e-5
    )
    std = np.sqrt(np.diag(free.estimate.covariance)[free.kinematics.model.family(FRAME)])
    np.testing.assert_allclose(beside.std, std, rtol=0.15)
    assert beside.prior_std["zero"] == pytest.approx(free.estimate.prior_std["zero"], rel=0.1)
    # The priors have the same part in each parameter.
    of_robot = ~free.kinematics.model.family(FRAME)
    estimate = free.estimate
    determined = 1.0 - np.diag(estimate.covariance) * estimate.problem.prior_precision
    np.testing.assert_allclose(beside.determined, determined[of_robot], atol=0.05)
    assert np.min(determined) < 0.2
    assert np.max(determined) > 0.95


def test_what_predicts_held_out_blocks_and_what_does_not(clean):
    """A drift of 0.4 mm over the table, and a column of noise."""
    scene, table = clean
    order = np.linspace(0.0, 1.0, len(table))[:, None]
    drifting = fit_to(scene, replace(table, points=table.points + 4e-4 * order))
    weights, columns = np.ones(len(table)), order[:, :, None] * np.eye(3)
    assert gain_on_blocks(drifting, columns, weights) > 0.4
    assert gain_on_blocks(fit_to(scene, table), columns, weights) < 0.05
    noise = np.random.default_rng(1).normal(size=(len(table), 3, 2))
    assert gain_on_blocks(drifting, noise, weights) < 0.05


def test_residuals_without_a_block_are_those_of_a_fit_to_the_others_with_the_same_priors(clean):
    """Normal equations by hand; a prior of its own holds the target, 1 mm beside where the rows put it."""
    scene, table = clean
    given = scene.kinematics.T_tip_target[0, :3, 3] + [1e-3, 0.0, 0.0]
    cell = Cell(model="zeros", target=given, parameter_priors={"target_x": 1e-5})
    found = fit_to(scene, table, cell)
    problem = found.estimate.problem
    linear = problem.linear(found.estimate.x)
    masks = np.arange(len(table))[None] < 8
    weights = np.linspace(0.2, 1.0, len(table))
    residuals = _residuals_without_blocks(found, linear, weights, masks)[0]
    noise = found.estimate.noise[0]
    # In units of the noise, without the block.
    root = np.sqrt(np.where(masks[0], 0.0, weights))[:, None] / noise
    A = (root[:, :, None] * linear.A).reshape(-1, problem.size)
    y = (root * linear.residual(np.zeros(problem.size))).ravel()
    H = A.T @ A + np.diag(problem.prior_precision)
    x = np.linalg.solve(H, A.T @ y + problem.prior_precision * problem.prior_mean)
    np.testing.assert_allclose(residuals, linear.residual(x) / noise, atol=1e-6)
    assert np.any(problem.prior_mean)
