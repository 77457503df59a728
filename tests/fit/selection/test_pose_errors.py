"""Held-out errors of poses, and the paired test of them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import ttest_1samp

from calib.fit.selection.pose_errors import p_value_of_improvement, pose_errors
from calib.numerics.errors import CrossValidation, Errors


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
