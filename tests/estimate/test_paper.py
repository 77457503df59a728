"""The paper's error against differences."""

from __future__ import annotations

import numpy as np

from calib.estimate.paper import paper_system
from tests.estimate.differences import differences, problem_of


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
