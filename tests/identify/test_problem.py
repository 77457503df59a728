"""The whitened system of a problem, against differences and against its own definition."""

from __future__ import annotations

import numpy as np

from calib.identify.problem import Problem


def differences(function, x, step):
    """Central differences with one step of Richardson extrapolation."""
    columns = []
    for k in range(len(x)):
        e = np.zeros(len(x))
        e[k] = step
        near = (function(x + e) - function(x - e)) / (2 * step)
        far = (function(x + 2 * e) - function(x - 2 * e)) / (4 * step)
        columns.append((4 * near - far) / 3)
    return np.stack(columns, axis=-1)


def problem_of(virtual, rng, precision):
    x = virtual.offsets(rng, 1e-3, 5e-3)
    rows = virtual.rows(rng, x, 12, 1e-3)
    sigma = rng.uniform(1e-4, 3e-4, 12)
    weights = rng.uniform(0, 1, 12)
    return Problem(virtual.kinematics, rows.joints, rows.points, sigma, weights, precision), x


def test_system_is_weighted_residual_over_sigma_with_a_row_for_each_prior(virtual):
    rng = np.random.default_rng(1)
    precision = np.zeros(27)
    precision[[2, 5]] = [4.0e6, 1.0e4]
    problem, x = problem_of(virtual, rng, precision)
    r, J = problem.system(x)
    assert r.shape == (38,)
    assert J.shape == (38, 27)
    measured_minus_predicted = problem.points - virtual.kinematics.points(x, problem.joints)
    by_hand = measured_minus_predicted * (np.sqrt(problem.weights) / problem.sigma)[:, None]
    np.testing.assert_allclose(r[:36], by_hand.ravel())
    np.testing.assert_allclose(r[36:], [-2e3 * x[2], -1e2 * x[5]])


def test_jacobian_of_the_system_against_differences(virtual):
    rng = np.random.default_rng(2)
    problem, x = problem_of(virtual, rng, rng.uniform(0, 1e5, 27))
    _, J = problem.system(x)
    numeric = differences(lambda v: problem.system(v)[0], x, 1e-3)
    scale = np.linalg.norm(J, axis=0)
    assert np.max(np.abs(J - numeric) / scale) < 1e-7


def test_jacobian_of_the_papers_error_against_differences(virtual):
    rng = np.random.default_rng(3)
    problem, _ = problem_of(virtual, rng, np.zeros(27))
    unit = np.where(virtual.is_length, 1e3, 1.0)
    nominal = np.array([p.nominal for p in virtual.kinematics.model.parameters])
    X = nominal * unit + rng.normal(size=27) * np.where(virtual.is_length, 1.0, 1e-3)
    e, J = problem.paper_system(nominal, unit, X)
    numeric = differences(lambda v: problem.paper_system(nominal, unit, v)[0], X, 1e-3)
    assert np.max(np.abs(J - numeric) / np.linalg.norm(J, axis=0)) < 1e-7
    residual_mm = 1e3 * problem.residual(X / unit - nominal)
    np.testing.assert_allclose(e, np.sum(residual_mm**2, axis=1))


def test_reweighting_changes_nothing_but_the_weights(virtual):
    rng = np.random.default_rng(4)
    problem, x = problem_of(virtual, rng, np.zeros(27))
    before, _ = problem.system(x)
    other = problem.reweighted(np.ones(12), problem.sigma, np.zeros(27))
    np.testing.assert_allclose(other.residual(x), problem.residual(x))
    np.testing.assert_array_equal(problem.system(x)[0], before)
    assert not np.allclose(other.system(x)[0], before)


def test_the_remembered_prediction_is_that_of_the_x_asked_for(virtual):
    rng = np.random.default_rng(5)
    problem, x = problem_of(virtual, rng, np.zeros(27))
    first = problem.system(x)[0]
    moved = problem.system(x + 1e-3)[0]
    assert not np.allclose(first, moved)
    np.testing.assert_array_equal(problem.system(x)[0], first)
    # The caller may go on to change its own x.
    y = x.copy()
    problem.system(y)
    y += 1e-3
    np.testing.assert_array_equal(problem.system(y)[0], moved)
