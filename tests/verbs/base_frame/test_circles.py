"""Planes and circles by orthogonal distances: exact, with the right derivatives, covariance, bias and robustness."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from calib.verbs.base_frame.circles import (
    Circle,
    circle_residuals,
    fit_circle,
    fit_plane,
    nearest_circle,
    nearest_plane,
)

CENTER = np.array([1.0, -2.0, 0.5])
SIGMA = 33e-6


def basis_of(seed: int) -> np.ndarray:
    B = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    return B * [1.0, 1.0, np.linalg.det(B)]


B = basis_of(3)


def arc(degrees: float, count: int = 40, radius: float = 0.3, basis: np.ndarray = B) -> np.ndarray:
    t = np.radians(np.linspace(-degrees / 2, degrees / 2, count))
    return CENTER + radius * (np.cos(t)[:, None] * basis[:, 0] + np.sin(t)[:, None] * basis[:, 1])


def disc(count: int = 20, seed: int = 0) -> np.ndarray:
    xy = np.random.default_rng(seed).uniform(-0.25, 0.25, size=(count, 2))
    return CENTER + xy @ B[:, :2].T


def local_errors(circle: Circle, basis: np.ndarray) -> np.ndarray:
    """Errors along a basis, the normal's sense being free: centre, tilt towards u and v, radius."""
    normal = circle.normal * np.sign(circle.normal @ basis[:, 2])
    return np.concatenate(
        [basis.T @ (circle.point - CENTER), basis[:, :2].T @ normal, [circle.radius - 0.3]]
    )


@settings(max_examples=10, deadline=None)
@given(
    st.integers(0, 10_000),
    st.floats(20.0, 360.0),
    st.floats(0.02, 3.0),
    st.integers(5, 60),
)
def test_exact_points_give_the_circle(seed: int, degrees: float, radius: float, count: int):
    basis = basis_of(seed)
    circle = fit_circle(arc(degrees, count, radius, basis))
    assert circle.point == pytest.approx(CENTER, abs=1e-9)
    assert circle.radius == pytest.approx(radius, abs=1e-9)
    assert abs(circle.normal @ basis[:, 2]) == pytest.approx(1.0, abs=1e-12)
    assert np.abs(circle.residuals).max() < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("degrees", [30.0, 60.0, 270.0])
def test_the_covariance_is_the_scatter_of_many_fits(degrees: float):
    rng = np.random.default_rng(2)
    exact = arc(degrees)
    own = fit_circle(exact, np.full(40, SIGMA))
    runs = 400
    fits = [fit_circle(exact + SIGMA * rng.normal(size=(40, 3))) for _ in range(runs)]
    errors = np.array([local_errors(circle, own.basis) for circle in fits])
    L = np.linalg.inv(np.linalg.cholesky(own.covariance))
    whitened = L @ (errors.T @ errors / runs) @ L.T
    assert np.linalg.eigvalsh(whitened) == pytest.approx(np.ones(6), abs=0.35)


def test_noise_is_found_from_the_residuals_or_taken_as_given():
    rng = np.random.default_rng(6)
    points = arc(200.0, 500) + SIGMA * rng.normal(size=(500, 3))
    found = fit_circle(points)
    assert found.noise == pytest.approx(SIGMA, rel=0.08)
    assert (found.dof, found.given) == (994.0, None)
    given = fit_circle(points, np.full(500, SIGMA))
    assert (given.given, given.dof) == (pytest.approx(SIGMA), np.inf)
    assert given.covariance * (found.noise / SIGMA) ** 2 == pytest.approx(found.covariance)
    wrong = fit_circle(points, np.full(500, SIGMA / 2))
    assert (wrong.given, wrong.dof) == (pytest.approx(SIGMA / 2), 994.0)
    assert wrong.covariance == pytest.approx(found.covariance)


@pytest.mark.slow
@pytest.mark.parametrize("sigma", [SIGMA, 3e-4])
def test_on_a_short_arc_the_center_has_no_bias_to_speak_of(sigma: float):
    rng = np.random.default_rng(8)
    exact = arc(30.0)
    centers = []
    for _ in range(150):
        e = sigma * rng.normal(size=exact.shape)
        both = (exact + e, exact - e)  # the first order cancels
        centers += [fit_circle(points, robust=False).point @ B[:, 0] for points in both]
    # A tenth of the bias of the least squares of A = 1 (I. Kasa, 1976), 29 um at 33 um of noise.
    assert abs(np.mean(centers) - CENTER @ B[:, 0]) < 2.9e-6 * (sigma / SIGMA) ** 2


@pytest.mark.parametrize("degrees", [30.0, 270.0])
def test_one_gross_point_is_left_out(degrees: float):
    rng = np.random.default_rng(9)
    points = arc(degrees) + SIGMA * rng.normal(size=(40, 3))
    gross = points.copy()
    gross[17] += 1e-3 * (B[:, 0] + B[:, 2])
    circle = fit_circle(gross)
    assert np.flatnonzero(~circle.used).tolist() == [17]
    without = fit_circle(np.delete(points, 17, axis=0))
    assert circle.point == pytest.approx(without.point, abs=1e-10)
    assert np.linalg.norm(circle.residuals[17]) > 5e-4
    assert fit_circle(gross, robust=False).used.all()
    touched = disc() + SIGMA * rng.normal(size=(20, 3))
    touched[3] += 1e-3 * B[:, 2]
    assert np.flatnonzero(~fit_plane(touched).used).tolist() == [3]


# Orthogonal distances


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
