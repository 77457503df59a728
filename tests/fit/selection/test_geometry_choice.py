"""The choice of the geometry by evidence and by errors on held-out poses."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import ttest_1samp

from calib.fit.selection.geometry_choice import (
    p_value_of_improvement,
    pose_errors,
    preferred_geometry,
)
from calib.numerics.errors import CrossValidation, Errors
from tests.fit.selection.models import a_candidate


def errors_of(mean: float, spread: float, count: int = 25) -> np.ndarray:
    """Errors of poses with this mean, whose differences from others of the same spread are exact."""
    return mean + spread * np.linspace(-1.0, 1.0, count)


@pytest.mark.parametrize(
    ("evidence", "errors", "name"),
    [
        # As good on held-out rows: evidence decides.
        ((0.0, -1.0), (errors_of(1.0, 0.0), errors_of(1.0, 0.3)), "zeros"),
        # Smaller by a fifth, far beyond chance.
        ((0.0, -1.0), (errors_of(1.0, 0.0), errors_of(0.8, 0.1)), "dh"),
        # Whatever the evidence says.
        ((0.0, -90.0), (errors_of(1.0, 0.0), errors_of(0.8, 0.1)), "dh"),
        # Smaller beyond chance, but by too little.
        ((0.0, -1.0), (errors_of(1.0, 0.0), errors_of(0.97, 0.01)), "zeros"),
        # Smaller by a fifth; chance does that in 4 of 100 cases, which is too often against evidence of 20 to 1.
        ((0.0, -2.9), (errors_of(1.0, 0.0), errors_of(0.8, 0.91)), "dh"),
        ((0.0, -3.1), (errors_of(1.0, 0.0), errors_of(0.8, 0.91)), "zeros"),
        # In 20 of 100.
        ((0.0, -1.0), (errors_of(1.0, 0.0), errors_of(0.8, 2.0)), "zeros"),
        # A larger geometry does not win against a smaller one either.
        ((-2.0, 0.0), (errors_of(2.7, 0.5), errors_of(4.6, 0.4)), "zeros"),
        # Fewer than 16 poses say nothing against the evidence.
        ((0.0, -1.0), (errors_of(1.0, 0.0, 16), errors_of(0.8, 0.1, 16)), "dh"),
        ((0.0, -1.0), (errors_of(1.0, 0.0, 15), errors_of(0.8, 0.1, 15)), "zeros"),
    ],
)
def test_a_geometry_that_held_out_rows_contradict_does_not_win(evidence, errors, name):
    candidates = [a_candidate(n, e) for n, e in zip(("zeros", "dh"), evidence, strict=True)]
    assert preferred_geometry(candidates, errors) == name
    assert preferred_geometry(candidates[::-1], errors[::-1]) == name


def test_of_geometries_that_are_clearly_better_the_best_on_held_out_rows_wins():
    candidates = [
        a_candidate("zeros", 0.0),
        a_candidate("dh", -1.0),
        a_candidate("placement", -2.0),
    ]
    errors = [errors_of(1.0, 0.0), errors_of(0.8, 0.1), errors_of(0.75, 0.1)]
    assert preferred_geometry(candidates, errors) == "placement"


def test_the_error_of_a_pose_is_that_of_its_rows_in_units_of_the_noise():
    residual = np.array([[3e-3, 0.0, 4e-3], [0.0, 6e-3, 0.0], [9.0, 9.0, 9.0], [0.0, 0.0, 2e-3]])
    errors = Errors.of(residual)
    validation = CrossValidation("", 3, np.array([5, 5, 5, 2]), residual, errors, errors)
    kept = np.array([True, True, False, True])
    scales = np.full((4, 3), 1e-3)
    expected = [2.0, np.sqrt((25.0 + 36.0) / 2.0)]
    np.testing.assert_allclose(pose_errors(validation, scales, kept), expected)
    scales[:, 2] = 2e-3
    np.testing.assert_allclose(pose_errors(validation, scales, kept)[0], 1.0)


def test_the_p_value_of_an_improvement_is_student_s_one_sided():
    rng = np.random.default_rng(5)
    improvements = 0.3 + rng.normal(size=12)
    expected = ttest_1samp(improvements, 0.0, alternative="greater").pvalue
    assert p_value_of_improvement(improvements) == pytest.approx(expected, rel=1e-9)
    assert p_value_of_improvement(-improvements) == pytest.approx(1.0 - expected, rel=1e-9)
    assert p_value_of_improvement(np.array([1.0])) == 1.0
    assert p_value_of_improvement(np.zeros(4)) == 1.0
    assert p_value_of_improvement(np.ones(4)) == 0.0
