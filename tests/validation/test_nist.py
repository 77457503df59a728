"""Levenberg-Marquardt on all non-linear sets of NIST's Statistical Reference Datasets, from both starts."""

from __future__ import annotations

import numpy as np
import pytest

from calib.numerics.solvers import levenberg_marquardt, scipy_least_squares
from tests.validation.nist_sets import digits, read_sets

SETS = read_sets()

#: Eight thousand steps along a canyon: a second and a half.
LONG = {("MGH10", 1)}

CASES = [
    pytest.param(name, start, marks=[pytest.mark.slow] if (name, start) in LONG else [])
    for name in SETS
    for start in (1, 2)
]


def solution_of(name, start):
    """The solution with steps no longer than the start, to the last digits."""
    x0 = SETS[name].starts[start - 1]
    return levenberg_marquardt(
        SETS[name].system(),
        x0,
        step_size=np.abs(x0),
        step_tolerance=1e-13,
        tolerance=0.0,
        longest_step=1.0,
        iterations=10000,
    )


def test_all_27_sets_are_there():
    assert len(SETS) == 27
    assert sum(len(one.y) for one in SETS.values()) == 2176
    assert [one.level for one in SETS.values()].count("higher") == 8


@pytest.mark.parametrize("name", SETS)
def test_models_give_the_certified_sum_of_squares_at_the_certified_values(name):
    """So that a model that is not NIST's is not taken for a solver that fails."""
    one = SETS[name]
    r = one.residual(one.certified)
    if name == "Lanczos1":  # eleven digits of b are not enough: it is 1e-25
        assert r @ r < 1e-19
        return
    assert r @ r == pytest.approx(one.sum_of_squares, rel=1e-6)
    freedom = len(r) - len(one.certified)
    assert np.sqrt(r @ r / freedom) == pytest.approx(one.residual_standard_deviation, rel=1e-6)


@pytest.mark.parametrize(("name", "start"), CASES)
def test_certified_values_are_reached_from_both_starts(name, start):
    solution, one = solution_of(name, start), SETS[name]
    assert solution.status == "converged"
    assert digits(solution.x, one.certified) >= 8.0
    assert digits(one.standard_errors(solution.x), one.standard_deviations) >= 6.0
    if name != "Lanczos1":  # whose residuals are rounding
        assert 2.0 * solution.cost == pytest.approx(one.sum_of_squares, rel=1e-9)


@pytest.mark.parametrize("start", [1, 2])
@pytest.mark.parametrize("name", SETS)
def test_with_its_usual_arguments_the_solver_does_not_claim_what_it_has_not_reached(name, start):
    one = SETS[name]
    x0 = one.starts[start - 1]
    solution = levenberg_marquardt(one.system(), x0, step_size=np.abs(x0))
    if solution.status == "converged":
        assert digits(solution.x, one.certified) >= 4.5


def test_a_parameter_that_has_lost_its_effect_is_not_converged():
    """The first step from the start 1 of BoxBOD goes to where b1 (1 - exp(-b2 x)) is b1."""
    one = SETS["BoxBOD"]
    solution = levenberg_marquardt(one.system(), one.starts[0], step_size=one.starts[0])
    assert solution.status == "stopped"
    assert "parameter 2" in solution.message
    assert solution.iterations < 100


@pytest.mark.parametrize("start", [1, 2])
@pytest.mark.parametrize("name", [name for name in SETS if SETS[name].level == "lower"])
def test_scipy_reaches_the_same_values(name, start):
    one = SETS[name]
    x0 = one.starts[start - 1]
    solution = scipy_least_squares(one.system(), x0, step_size=np.abs(x0))
    assert solution.status == "converged"
    assert digits(solution.x, one.certified) >= 5.0
