"""Fits of poses with covariances: against dense least squares, known noise, and drawn anew many times."""

from __future__ import annotations

from dataclasses import astuple, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.data.cell import Cell
from calib.fit.estimate.fitting import fit
from calib.fit.estimate.problem import Problem
from calib.fit.estimate.special_cases.pose_covariances import with_joint_errors
from calib.fit.estimate.task import Task
from calib.fit.registration.rows import USUAL_POSE_NOISE
from calib.fit.registration.table_rows import rows_and_setup
from calib.numerics.correlated_noise import PoseNoise
from tests.covariances import draw, random_covariances
from tests.fit.estimate.scene_fits import OFF, errors

CELL = Cell(estimate_frame=True)

#: Nothing besides the stated covariances.
NOTHING = PoseNoise(scale=1.0, position=1e-9, orientation=1e-9, joint=1e-9)


def table_with(scene, count, stated, true, rng):
    """Poses of a scene with errors of the covariances `true`, and covariances `stated`."""
    return with_errors(scene.poses(count), stated, true, rng)


def with_errors(exact, stated, true, rng):
    e = draw(rng, true)
    turned = Rotation.from_rotvec(e[:, 3:]).as_matrix()
    return replace(
        exact,
        points=exact.points + e[:, :3],
        rotations=turned @ exact.rotations,
        covariances=stated,
    )


def fitted(scene, table, noise=None, cell=CELL):
    """A fit; with the noise of poses given, if any."""
    rows, setup = rows_and_setup(scene.robot, table, cell)
    if noise is not None:
        rows = replace(rows, pose_noise=noise, weights=np.ones(len(rows)))
    return fit(Task(scene.robot, cell, setup, "dh"), rows)


def test_independent_scalars_of_a_covariance_are_as_standard_deviations(make_scene):
    rng = np.random.default_rng(1)
    scene = make_scene(1)
    sizes = np.repeat([1e-4, 1e-3], 3)
    stated = np.tile(np.diag(sizes**2), (30, 1, 1))
    table = table_with(scene, 30, stated, stated, rng)
    by_sigma = replace(
        table, covariances=None, sigma={"m": np.full(30, 1e-4), "rad": np.full(30, 1e-3)}
    )
    first, second = fitted(scene, table, NOTHING), fitted(scene, by_sigma, NOTHING)
    np.testing.assert_allclose(first.estimate.x, second.estimate.x, atol=1e-9)
    np.testing.assert_allclose(first.estimate.noise, second.estimate.noise, rtol=1e-5)


def test_the_fit_is_generalised_least_squares(make_scene):
    """Against the normal equations with the inverse of each covariance, in the units of the measurement."""
    rng = np.random.default_rng(2)
    scene = make_scene(2, length=1e-4, angle=1e-4)
    stated = random_covariances(rng, 40)
    table = table_with(scene, 40, stated, stated, rng)
    found = fitted(scene, table, NOTHING, replace(CELL, priors=OFF))
    problem = found.estimate.problem
    x = found.estimate.x
    problem = replace(problem, noise=np.ones(2))
    V = problem.rows.pose_noise.covariances(stated, problem.rows.by_joints)
    J, r = problem.prediction_jacobian(x), problem.residual(x)
    H = np.einsum("nip,nij,njq->pq", J, np.linalg.inv(V), J)
    g = np.einsum("nip,nij,nj->p", J, np.linalg.inv(V), r)
    residual, slope = problem.system(x)
    np.testing.assert_allclose(slope.T @ slope, H, rtol=1e-6, atol=1e-6 * np.abs(H).max())
    np.testing.assert_allclose(-slope.T @ residual, g, atol=1e-6 * np.sqrt(np.diag(H)).max())


def test_derivatives_of_whitened_poses(make_scene):
    rng = np.random.default_rng(3)
    scene = make_scene(3)
    stated = random_covariances(rng, 12)
    found = fitted(scene, table_with(scene, 12, stated, stated, rng))
    problem, x = found.estimate.problem, found.estimate.x
    _, slope = problem.system(x)
    for k in range(problem.size):
        h = 1e-5 * np.eye(problem.size)[k]
        near = problem.system(x + h)[0] - problem.system(x - h)[0]
        far = problem.system(x + 2 * h)[0] - problem.system(x - 2 * h)[0]
        expected = (8.0 * near - far) / 12e-5
        np.testing.assert_allclose(slope[:, k], expected, atol=1e-7 * np.abs(slope).max())


def test_residuals_come_back_in_their_units(make_scene):
    rng = np.random.default_rng(4)
    scene = make_scene(4)
    stated = random_covariances(rng, 15)
    rows, _ = rows_and_setup(scene.robot, table_with(scene, 15, stated, stated, rng), CELL)
    problem = Problem.initial(scene.kinematics, with_joint_errors(rows, scene.kinematics))
    x = np.zeros(problem.size)
    linear = problem.linear(x)
    residual = problem.residual(x)
    np.testing.assert_allclose(problem.rows.in_units(linear.residual(x)), residual, atol=1e-15)


@pytest.mark.parametrize("factor", [0.1, 3.0])
def test_the_scale_of_stated_covariances_does_not_matter(make_scene, factor):
    rng = np.random.default_rng(5)
    scene = make_scene(5)
    stated = random_covariances(rng, 60)
    table = table_with(scene, 60, stated, stated, rng)
    as_stated = fitted(scene, table)
    scaled = fitted(scene, replace(table, covariances=factor**2 * stated))
    apart = errors(scene, scaled) - errors(scene, as_stated)
    assert np.sqrt(np.mean(apart**2)) < 0.05 * np.sqrt(np.mean(errors(scene, as_stated) ** 2))
    scales = [one.estimate.problem.rows.pose_noise.scale for one in (scaled, as_stated)]
    assert scales[0] * factor == pytest.approx(scales[1], rel=0.03)
    sigma = [np.median(one.estimate.problem.scales, axis=0) for one in (scaled, as_stated)]
    np.testing.assert_allclose(sigma[0], sigma[1], rtol=0.03)


def test_what_the_robot_adds_is_estimated(make_scene):
    """Much poorer joints than covariances say: their errors are found, and the fit is better than without them."""
    rng = np.random.default_rng(6)
    scene = make_scene(6)
    stated = 0.01 * random_covariances(rng, 150)
    exact = scene.poses(150)
    rows, _ = rows_and_setup(scene.robot, exact, CELL)
    of_joints = with_joint_errors(replace(rows, covariances=stated), scene.kinematics).by_joints
    true = replace(USUAL_POSE_NOISE, joint=4e-4, position=2e-4, orientation=1e-6)
    table = with_errors(exact, stated, true.covariances(stated, of_joints), rng)
    found = fitted(scene, table)
    noise = found.estimate.problem.rows.pose_noise
    assert noise.joint == pytest.approx(true.joint, rel=0.15)
    assert noise.position == pytest.approx(true.position, rel=0.3)
    np.testing.assert_allclose(found.estimate.noise, 1.0, atol=0.1)
    alone = fitted(scene, table, NOTHING)
    of_both = [np.sqrt(np.mean(errors(scene, one) ** 2)) for one in (found, alone)]
    assert of_both[0] < 0.8 * of_both[1]


@pytest.mark.slow
def test_parameters_scatter_as_their_covariance_says(make_scene):
    """Of 100 tables drawn anew, x' C^-1 x has the mean p over the robot's parameters."""
    rng = np.random.default_rng(7)
    squares = []
    for seed in range(100):
        scene = make_scene(seed, length=5e-4, angle=3e-3)
        stated = random_covariances(rng, 60)
        table = table_with(scene, 60, stated, stated, rng)
        found = fitted(scene, table)
        model = found.kinematics.model
        fresh = scene.poses(1)
        rows, _ = rows_and_setup(scene.robot, fresh, CELL)
        error = found.residual(rows)[0]
        J = Problem.initial(found.kinematics, rows).prediction_jacobian(found.estimate.x)[0]
        C = J @ found.estimate.covariance @ J.T
        assert len(model) == len(found.estimate.x)
        squares.append(error @ np.linalg.solve(C, error))
    # The mean of 100 values with 6 degrees of freedom is uncertain by 0.35.
    assert np.mean(squares) == pytest.approx(6.0, abs=1.2)


def test_fresh_rows_are_scored_by_the_noise_that_was_found(make_scene):
    rng = np.random.default_rng(8)
    scene = make_scene(8)
    stated = random_covariances(rng, 80)
    # Four times the errors that the covariances say.
    found = fitted(scene, table_with(scene, 80, stated, 16.0 * stated, rng))
    of_fresh = random_covariances(rng, 200)
    fresh = table_with(scene, 200, of_fresh, 16.0 * of_fresh, rng)
    rows, _ = rows_and_setup(scene.robot, fresh, CELL)
    scores = found.held_out_scores(rows)
    # The norm of three standard normal numbers has the median 1.54.
    assert np.median(scores) == pytest.approx(1.54, abs=0.2)


def test_noise_of_several_sorts_of_rows(make_scene):
    """Poses with and without covariance, and points: only the first have a noise of poses."""
    rng = np.random.default_rng(9)
    scene = make_scene(9, noise=1e-4, noise_angle=1e-3)
    stated = random_covariances(rng, 40)
    stated[25:] = np.nan
    table = replace(scene.poses(40), covariances=stated)
    rows, _ = rows_and_setup(scene.robot, table, CELL)
    assert np.sum(rows.correlated) == 25
    found = fitted(scene, table)
    assert np.all(np.isfinite(found.estimate.x))
    ratio = found.estimate.problem.noise_over_sigma
    assert ratio.shape == (2,)
    without = fitted(scene, replace(table, covariances=None))
    assert without.estimate.problem.rows.pose_noise == USUAL_POSE_NOISE
    np.testing.assert_array_equal(without.estimate.problem.noise_over_sigma, without.estimate.noise)


def test_a_reference_hands_its_noise_on(make_scene):
    rng = np.random.default_rng(10)
    scene = make_scene(10)
    stated = random_covariances(rng, 40)
    table = table_with(scene, 40, stated, 9.0 * stated, rng)
    reference = fitted(scene, table)
    rows, setup = rows_and_setup(scene.robot, table, CELL)
    smaller = fit(Task(scene.robot, CELL, setup, "zeros"), rows, reference=reference)
    noises = [one.estimate.problem.rows.pose_noise for one in (smaller, reference)]
    assert astuple(noises[0]) == astuple(noises[1])


def test_noise_over_the_stated_one_is_of_whole_positions_and_orientations(make_scene):
    """However different the axes are: the root of the mean variance over that of the stated covariance."""
    rng = np.random.default_rng(15)
    scene = make_scene(15)
    std = np.array([1e-5, 1e-5, 1e-4, 2e-4, 2e-4, 2e-5])
    stated = np.tile(np.diag(std**2), (60, 1, 1))
    table = table_with(scene, 60, stated, 4.0 * stated, rng)
    for noise in (NOTHING, None):
        ratio = fitted(scene, table, noise).estimate.problem.noise_over_sigma
        np.testing.assert_allclose(ratio, 2.0, rtol=0.15)


def test_exact_poses_are_fitted_exactly(make_scene):
    scene = make_scene(11)
    stated = random_covariances(np.random.default_rng(11), 40)
    table = replace(scene.poses(40), covariances=stated)
    found = fitted(scene, table)
    assert np.max(np.abs(errors(scene, found))) < 1e-7
    assert not found.estimate.outliers.any()


def test_a_pose_that_is_far_off_has_no_weight(make_scene):
    rng = np.random.default_rng(12)
    scene = make_scene(12)
    stated = random_covariances(rng, 60)
    table = table_with(scene, 60, stated, stated, rng)
    points = table.points.copy()
    points[17, 1] += 5e-3
    found = fitted(scene, replace(table, points=points))
    assert np.flatnonzero(found.estimate.outliers).tolist() == [17]
    assert found.estimate.weights[17] == 0.0
    assert found.estimate.problem.rows.pose_noise.scale == pytest.approx(1.0, abs=0.25)


def test_a_few_poses_keep_the_usual_noise(make_scene):
    rng = np.random.default_rng(13)
    scene = make_scene(13)
    stated = random_covariances(rng, 3)
    found = fitted(scene, table_with(scene, 3, stated, stated, rng))
    assert found.estimate.problem.rows.pose_noise == USUAL_POSE_NOISE


def test_the_order_of_poses_does_not_matter(make_scene):
    rng = np.random.default_rng(14)
    scene = make_scene(14)
    stated = random_covariances(rng, 50)
    table = table_with(scene, 50, stated, stated, rng)
    order = rng.permutation(50)
    shuffled = replace(
        table,
        joints=table.joints[order],
        points=table.points[order],
        rotations=table.rotations[order],
        covariances=stated[order],
    )
    first, second = (errors(scene, fitted(scene, one)) for one in (table, shuffled))
    np.testing.assert_allclose(first, second, atol=1e-9)
