"""The three solvers on problems whose answers are known."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from calib.errors import SolverError
from calib.numerics.solvers import (
    levenberg_marquardt,
    paper_levenberg_marquardt,
    scipy_least_squares,
    upper_root,
)


def rosenbrock(x):
    r = np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]])
    return r, np.array([[-20.0 * x[0], 10.0], [-1.0, 0.0]])


SOLVERS = {
    "lm": lambda system, x0: levenberg_marquardt(system, x0, step_size=np.abs(x0) + 1e-3),
    "paper": lambda system, x0: paper_levenberg_marquardt(
        system, x0, epsilon=1e-14, iterations=5000
    ),
    "scipy": lambda system, x0: scipy_least_squares(system, x0, step_size=np.abs(x0) + 1e-3),
}


@pytest.mark.parametrize("name", SOLVERS)
def test_rosenbrock_is_solved(name):
    solution = SOLVERS[name](rosenbrock, np.array([-1.2, 1.0]))
    assert solution.status == "converged"
    np.testing.assert_allclose(solution.x, [1.0, 1.0], atol=1e-7)


def test_linear_problem_takes_the_least_squares_solution():
    rng = np.random.default_rng(0)
    A, b = rng.normal(size=(20, 5)), rng.normal(size=20)
    solution = levenberg_marquardt(lambda x: (A @ x - b, A), np.zeros(5), step_size=np.ones(5))
    np.testing.assert_allclose(solution.x, np.linalg.lstsq(A, b)[0], atol=1e-7)


def test_damping_falls_with_the_gain_and_rises_faster_with_each_failure():
    """A tenth where the gain is 0.9 or more, else 1 - (2 gain - 1)^3; and 2, 4, 8, ... times."""
    factors, gains = [], []
    for start in ([-1.2, 1.0], [-3.0, 2.0], [-1.9, 2.0]):
        solution = levenberg_marquardt(rosenbrock, np.array(start), step_size=np.ones(2))
        failures = 0
        for entry, following in pairwise(solution.history):
            failures = 0 if entry.accepted else failures + 1
            if not entry.accepted:
                expected = 2.0**failures
            elif entry.gain >= 0.9:
                expected = 0.1
            else:
                expected = 1.0 - (2.0 * entry.gain - 1.0) ** 3
            assert following.mu == pytest.approx(max(expected * entry.mu, 1e-15), rel=1e-9)
            factors.append(expected)
            gains.append(entry.gain)
    # Each of the rules is met.
    assert {0.1, 2.0, 4.0, 8.0} < set(factors)
    assert min(gain for gain in gains if gain > 0.0) < 0.5


@pytest.mark.parametrize("longest", [np.inf, 0.5])
@pytest.mark.parametrize("start", [[-1.2, 1.0], [-3.0, 2.0], [-1.9, 2.0]])
def test_each_step_is_the_one_with_the_stated_damping(start, longest):
    """It solves (J^T J + mu D^2) dx = -J^T r, with the largest column norms of J so far in D."""
    trials, step_size = [], np.array([1.0, 0.5])

    def recorded(x):
        trials.append(x)
        return rosenbrock(x)

    found = levenberg_marquardt(recorded, np.array(start), step_size, longest_step=longest)
    x, largest = trials[0], np.zeros(2)
    for entry, trial in zip(found.history, trials[1:], strict=True):
        r, J = rosenbrock(x)
        largest = np.maximum(largest, np.sum(J**2, axis=0))
        dx = -np.linalg.solve(J.T @ J + entry.mu * np.diag(largest), J.T @ r)
        np.testing.assert_allclose(trial - x, dx, rtol=1e-6, atol=1e-12)
        assert entry.step == pytest.approx(np.linalg.norm(dx / step_size), rel=1e-6)
        if entry.accepted:
            x = trial
    assert max(entry.mu for entry in found.history) > 1e-4
    np.testing.assert_array_equal(found.x, x)


def test_papers_damping_follows_the_gain():
    solution = paper_levenberg_marquardt(rosenbrock, np.array([-1.2, 1.0]), mu=0.01, nu=2.5)
    assert solution.history[0].mu == 0.01
    assert {entry.accepted for entry in solution.history} == {True, False}
    for entry, following in pairwise(solution.history):
        assert entry.accepted == (entry.gain > 0)
        factor = 1 / 2.5 if entry.gain > 0 else 2.5
        assert following.mu == pytest.approx(entry.mu * factor)


@pytest.mark.parametrize(("share", "steps"), [(0.9e-6, 1), (1.1e-6, 2)])
def test_a_step_of_a_millionth_has_converged_for_the_papers_solver(share, steps):
    """Of r = x - 1 a step takes 1 / (1 + mu) of the way; the damping of the second one is 0.01 / 2.5."""
    second = 1.004 * share
    start = np.array([1.0 + second * 1.01 / 0.01])
    solution = paper_levenberg_marquardt(lambda x: (x - 1.0, np.eye(1)), start)
    assert solution.status == "converged"
    assert solution.iterations == steps


@pytest.mark.parametrize("iterations", [1, 4, 5000])
def test_evaluations_of_the_papers_solver_are_counted(iterations):
    """At its limit as where it converges."""
    seen = []

    def counted(x):
        seen.append(x)
        return rosenbrock(x)

    solution = paper_levenberg_marquardt(counted, np.array([-1.2, 1.0]), iterations=iterations)
    assert solution.status == ("converged" if iterations == 5000 else "stopped")
    assert solution.evaluations == len(seen)


def test_steps_of_scipy_are_measured_from_the_best_point_so_far():
    seen, step_size = [], np.array([0.1, 0.5])

    def recorded(x):
        r, J = rosenbrock(x)
        if not seen or not np.array_equal(x, seen[-1]):
            seen.append(x.copy())
        return r, J

    x0 = np.array([-1.2, 1.0])
    solution = scipy_least_squares(recorded, x0, step_size=step_size)
    expected = np.linalg.norm((seen[1] - x0) / step_size)
    assert solution.history[0].step == pytest.approx(expected)


def test_papers_gain_is_the_usual_one_although_both_signs_are_turned():
    """The printed quotient has the signs of numerator and denominator turned: they cancel."""
    solution = paper_levenberg_marquardt(rosenbrock, np.array([-1.2, 1.0]))
    x = np.array([-1.2, 1.0])
    e, J = rosenbrock(x)
    mu = 0.01
    dx = -np.linalg.solve(J.T @ J + mu * np.eye(2), J.T @ e)
    after, _ = rosenbrock(x + dx)
    decrease = 0.5 * (e @ e - after @ after)
    usual = 2.0 * decrease / (dx @ (mu * dx - J.T @ e))
    assert solution.history[0].gain == pytest.approx(usual, rel=1e-9)
    linear = e + J @ dx
    predicted = 0.5 * (e @ e - linear @ linear)
    assert 0.5 * dx @ (mu * dx - J.T @ e) == pytest.approx(predicted, rel=1e-9)


def test_a_trial_that_is_not_finite_is_not_taken():
    def log_system(x):
        with np.errstate(invalid="ignore"):
            return np.array([np.log(x[0])]), np.array([[1.0 / x[0]]])

    # The full step from 10 goes to a negative number, where the logarithm is none.
    solution = levenberg_marquardt(log_system, np.array([10.0]), step_size=np.ones(1))
    assert solution.x[0] == pytest.approx(1.0, abs=1e-8)
    assert any(not entry.accepted for entry in solution.history)


@pytest.mark.parametrize("name", ["lm", "scipy"])
def test_a_start_without_finite_residual_and_derivative_is_refused(name):
    def without_derivative(x):
        return x - 1.0, np.full((1, 1), np.nan)

    def without_residual(_):
        return np.full(1, np.inf), np.ones((1, 1))

    for system in (without_derivative, without_residual):
        with pytest.raises(SolverError):
            SOLVERS[name](system, np.array([2.0]))


def test_scipy_stops_where_its_evaluations_are_used_up():
    """An exponential falls by the same share with each step, and has no minimum."""

    def exponential(x):
        r = 1e40 * np.exp(-x)
        return r, -r[:, None]

    solution = SOLVERS["scipy"](exponential, np.zeros(1))
    assert solution.status == "stopped"
    assert solution.evaluations == 100


def test_steps_that_a_large_residual_makes_too_short_become_longer():
    """E = 1/2 (x^2 + y^2 + (c - b x^2)^2) curves by 1 - 2 b c = 0.05 at x = 0, where r + J dx has 1."""

    def system(xy):
        x, y = xy
        residual = np.array([x, y - 0.1 * x**2, 9.5 - 0.05 * x**2])
        return residual, np.array([[1.0, 0.0], [-0.2 * x, 1.0], [-0.1 * x, 0.0]])

    found = levenberg_marquardt(system, np.array([1.0, 2.0]), np.ones(2), 1e-9)
    # The rounding of the cost, 45 eps, decides on 1e-4 of the gain of the last long step of 3e-4.
    np.testing.assert_allclose(found.x, 0.0, atol=2e-6)
    assert found.status == "converged"
    assert found.evaluations < 25  # each plain step leaves 95 % of x: some 330
    assert any(step.accepted and step.gain > 1.9 for step in found.history)


def test_no_step_is_longer_than_the_longest():
    """Lengths are in units of step_size, and the first step is far longer without the limit."""
    x0, step_size = np.array([-1.2, 1.0]), np.array([1.0, 0.5])
    free = levenberg_marquardt(rosenbrock, x0, step_size)
    short = levenberg_marquardt(rosenbrock, x0, step_size, longest_step=0.5)
    assert free.history[0].step > 5.0
    lengths = [entry.step for entry in short.history]
    assert max(lengths) <= 0.5
    assert max(lengths) > 0.1  # a quarter of it, squared: damping grows by 4
    np.testing.assert_allclose(short.x, [1.0, 1.0], atol=1e-7)


def test_x_is_told_beyond_what_the_cost_tells():
    """E is (1 + (x - 2)^2 + ...)/2: for |x - 2| < 1e-8 it is 1/2 to the last bit."""

    def system(x):
        return np.array([1.0, x[0] ** 2 - 4.0, 1e-3 * (x[0] - 2.0)]), np.array(
            [[0.0], [2 * x[0]], [1e-3]]
        )

    rough = levenberg_marquardt(system, np.array([3.0]), np.ones(1))
    fine = levenberg_marquardt(system, np.array([3.0]), np.ones(1), 1e-14, tolerance=0.0)
    assert abs(fine.x[0] - 2.0) < 1e-15
    assert abs(rough.x[0] - 2.0) < 1e-5
    assert fine.history[-1].gain is None
    assert fine.status == "converged"


@pytest.mark.parametrize("scale", [np.ones(2), np.array([1e-5, 1e4])])
def test_nearly_singular_products_have_no_root(scale):
    """The root's last entry is the sine of the angle between two columns."""

    def products(sine):
        cosine = np.sqrt(1.0 - sine**2)
        return np.outer(scale, scale) * [[1.0, cosine], [cosine, 1.0]]

    root = upper_root(products(2e-6))
    assert root is not None
    np.testing.assert_allclose(root / scale, [[1.0, 1.0], [0.0, 2e-6]], rtol=1e-4)
    assert upper_root(products(5e-7)) is None
    assert upper_root(products(0.0)) is None
    assert upper_root(np.diag([1.0, 0.0])) is None
