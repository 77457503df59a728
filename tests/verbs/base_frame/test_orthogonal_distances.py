"""Distances from planes and circles, their derivatives, and the minimum of their weighted squares."""

import numpy as np
import pytest

from calib.verbs.base_frame.orthogonal_distances import (
    circle_residuals,
    nearest_circle,
    nearest_plane,
)
from tests.verbs.base_frame.test_fits import CENTER, arc, basis_of, disc


def test_the_jacobian_is_that_of_finite_differences():
    rng = np.random.default_rng(1)
    points = arc(80.0) + 0.02 * rng.normal(size=(40, 3))
    basis, center, radius = basis_of(9), CENTER + 0.01, 0.28

    def at(x: np.ndarray) -> np.ndarray:
        n = basis @ np.array([x[3], x[4], 1.0])
        n, moved = n / np.linalg.norm(n), center + basis @ x[:3]
        axial = (points - moved) @ n
        radial = np.linalg.norm(points - moved - axial[:, None] * n, axis=1) - radius - x[5]
        return np.stack([radial, axial], axis=1)

    residuals, J = circle_residuals(points, center, basis, radius)
    assert residuals == pytest.approx(at(np.zeros(6)), abs=1e-14)
    for k in range(6):
        step = 1e-6 * np.eye(6)[k]
        assert J[..., k] == pytest.approx((at(step) - at(-step)) / 2e-6, abs=1e-9)


@pytest.mark.parametrize("fit", [nearest_circle, nearest_plane])
def test_weighted_squares_are_least(fit):
    """No displacement of the figure lowers them: the gradient J^T W e vanishes, with the points used alone."""
    rng = np.random.default_rng(8)
    points = (arc(120.0) if fit is nearest_circle else disc(40)) + 1e-3 * rng.normal(size=(40, 3))
    weights = rng.uniform(0.5, 2.0, 40)
    used = rng.random(40) < 0.8
    figure = fit(points, weights, used)
    gradient = np.einsum(
        "n,nk,nkp->p", weights[used], figure.residuals[used], figure.jacobian[used]
    )
    scale = np.linalg.norm(figure.residuals[used])
    assert gradient == pytest.approx(np.zeros(len(gradient)), abs=1e-6 * scale)
