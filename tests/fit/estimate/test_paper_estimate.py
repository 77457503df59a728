"""The paper's error against differences, and its estimate against known truth and another minimiser."""

from __future__ import annotations

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.errors import ModelError
from calib.fit.estimate.fitting import Fitted
from calib.fit.estimate.paper_estimate import paper_system
from tests.fit.estimate.differences import differences, problem_of
from tests.fit.estimate.scene_fits import FREE, errors, fitted


def test_jacobian_of_the_papers_error_against_differences(virtual):
    rng = np.random.default_rng(3)
    problem, _ = problem_of(virtual, rng, np.zeros(27))
    unit = np.where(virtual.is_length, 1e3, 1.0)
    nominal = np.array([p.nominal for p in virtual.kinematics.model.parameters])
    X = nominal * unit + rng.normal(size=27) * np.where(virtual.is_length, 1.0, 1e-3)
    e, J = paper_system(problem, nominal, unit, X)
    numeric = differences(lambda v: paper_system(problem, nominal, unit, v)[0], X, 1e-3)
    assert np.max(np.abs(J - numeric) / np.linalg.norm(J, axis=0)) < 1e-7
    residual_mm = 1e3 * problem.residual(X / unit - nominal)
    np.testing.assert_allclose(e, np.sum(residual_mm**2, axis=1))


@pytest.fixture(scope="module")
def noisy(make_scene) -> Fitted:
    """A fit to 80 points in the base with a noise of 0.05 mm, half the one assumed."""
    scene = make_scene(3, frames=[np.eye(4)], noise=5e-5, length=5e-4, angle=3e-3)
    return fitted(scene, scene.points(80), Cell(), solver="paper")[0]


@pytest.mark.parametrize("frames", ["known", "estimated"])
def test_without_noise_the_papers_estimate_is_the_truth(make_scene, frames):
    given = {"frames": [np.eye(4)]} if frames == "known" else {}
    scene = make_scene(5, length=5e-4, angle=3e-3, **given)
    cell = Cell() if frames == "known" else FREE
    found, rows = fitted(scene, scene.points(80), cell, solver="paper")
    assert np.abs(found.residual(rows)).max() < 5e-6
    assert np.abs(errors(scene, found)).max() < 2e-5
    # Fourth powers are flat near their minimum: what is left is under 1 um of a sigma of 0.1 mm.
    assert max(found.estimate.noise) < 1e-2


def test_noise_and_covariance_of_the_papers_estimate_by_hand(noisy):
    """Sum of squares over 3 N - 3/5 rank, and 7/5 of the covariance of least squares."""
    estimate = noisy.estimate
    problem = estimate.problem
    jacobian = problem.prediction_jacobian(estimate.x).reshape(-1, problem.size)
    U, s, _ = np.linalg.svd(jacobian / np.linalg.norm(jacobian, axis=0), full_matrices=False)
    rank = int(np.sum(s > 1e-9 * s[0]))
    assert rank < problem.size
    square = np.sum(problem.residual(estimate.x) ** 2)
    noise = np.sqrt(square / (3 * 80 - 0.6 * rank))
    assert 1e-4 * estimate.noise[0] == pytest.approx(noise, rel=1e-6)
    assert problem.scales == pytest.approx(np.full((80, 3), noise), rel=1e-6)
    assert noise == pytest.approx(5e-5, rel=0.3)
    # Along what the points observe well, without the directions that rounding makes.
    U = U[:, s > 1e-3 * s[0]]
    along = U.T @ jacobian @ estimate.covariance @ jacobian.T @ U
    np.testing.assert_allclose(along, 1.4 * noise**2 * np.eye(U.shape[1]), atol=1e-5 * noise**2)


def test_weights_priors_and_bounds_have_no_part_in_the_papers_estimate(make_scene, noisy):
    scene = make_scene(3, frames=[np.eye(4)], noise=5e-5, length=5e-4, angle=3e-3)
    cell = Cell(bounds={"a2": (-1e-6, 1e-6)}, parameter_priors={"a3": 1e-7}, sigma={"m": 3e-4})
    found, _ = fitted(scene, scene.points(80), cell, solver="paper")
    np.testing.assert_allclose(found.estimate.x, noisy.estimate.x, atol=1e-12)
    assert 3.0 * found.estimate.noise[0] == pytest.approx(noisy.estimate.noise[0])
    assert np.all(found.estimate.weights == 1.0)
    assert (found.estimate.at_bound, found.estimate.prior_std) == ((), {})


@pytest.mark.parametrize("rows", ["poses", "points and distances", "two targets"])
def test_the_paper_takes_points_of_one_target_alone(make_scene, join, rows):
    scene = make_scene(4, frames=[np.eye(4)], targets=2)
    table = {
        "poses": lambda: scene.poses(20),
        "points and distances": lambda: join(scene.points(20), scene.distances(9)),
        "two targets": lambda: join(scene.points(20), scene.points(20, target=1)),
    }[rows]()
    with pytest.raises(ModelError, match="positions of one target"):
        fitted(scene, table, Cell(), solver="paper")
