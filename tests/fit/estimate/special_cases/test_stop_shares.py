"""The equations for the shares of a stop, against dense matrices and exact moments."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import block_diag

from calib.fit.estimate.special_cases.stop_shares import (
    PARTS,
    Moments,
    _InverseCovariance,
    _shares_of,
    extrapolated,
    unshared,
)

RHO = np.array([0.4, 0.2, 0.1])


@pytest.fixture
def bodies():
    """Derivatives J of nine scalars at each of five stops by a displacement, shape (5, 12, 8)."""
    return np.random.default_rng(1).normal(size=(5, 12, 8))


def covariance_parts(J):
    """K_i, the derivatives of the covariance of all scalars by the share that is independent and that of each part."""
    by_parts = [J[:, :, part] for part in PARTS]
    squares = [block_diag(*(by_part @ by_part.swapaxes(1, 2))) for by_part in by_parts]
    return [np.eye(squares[0].shape[0]), *squares]


def covariance(parts):
    """K at the shares RHO."""
    return sum(share * part for share, part in zip([unshared(RHO), *RHO], parts, strict=True))


def moments_of(J, squares):
    """Moments at stops whose residuals have the squares r r^T, a dense matrix of all scalars."""
    scalars = J.shape[1]
    R = []
    for number, J_of_stop in enumerate(J):
        of_stop = slice(number * scalars, (number + 1) * scalars)
        R.append(J_of_stop.T @ squares[of_stop, of_stop] @ J_of_stop)
    M = J.swapaxes(1, 2) @ J
    return Moments(M, np.array(R), float(np.trace(squares)), float(len(squares)))


def test_the_inverse_covariance_of_stops(bodies):
    parts = covariance_parts(bodies[:1])
    K = covariance(parts)
    J = bodies[0]
    inverse = _InverseCovariance.of(J.T[None] @ J, RHO)
    expected = np.linalg.inv(K)
    np.testing.assert_allclose(
        (np.eye(12) - J @ inverse.H[0] @ J.T) / inverse.kappa, expected, atol=1e-10
    )
    np.testing.assert_allclose(J @ inverse.T[0], expected @ J, atol=1e-10)


def test_the_equations_have_the_traces_of_dense_matrices(bodies):
    parts = covariance_parts(bodies)
    K = covariance(parts)
    r = np.random.default_rng(2).normal(size=len(K))
    moments = moments_of(bodies, np.outer(r, r))
    inverse = _InverseCovariance.of(moments.M, RHO)
    weighted = [np.linalg.solve(K, part) for part in parts]
    weighted_square = np.linalg.solve(K, np.outer(r, r))
    left = np.einsum("iab,jba->ij", weighted, weighted)
    right = np.einsum("iab,ba->i", weighted, weighted_square)
    np.testing.assert_allclose(moments._left_side(inverse), left, rtol=1e-9)
    np.testing.assert_allclose(moments._right_side(inverse), right, rtol=1e-9)


def test_exact_moments_give_the_shares_back(bodies):
    """Residuals whose squares are their expectation: any start leads to the shares that they have."""
    parts = covariance_parts(bodies)
    shares = moments_of(bodies, 4.0 * covariance(parts)).shares(np.zeros(3))
    assert shares == pytest.approx(RHO, abs=1e-9)


def test_moments_of_parts_are_joined_in_their_order(bodies):
    r = np.random.default_rng(3).normal(size=60)
    whole = moments_of(bodies, np.outer(r, r))
    first = moments_of(bodies[:2], np.outer(r[:24], r[:24]))
    second = moments_of(bodies[2:], np.outer(r[24:], r[24:]))
    joined = Moments.joined([first, second])
    np.testing.assert_array_equal(joined.M, whole.M)
    np.testing.assert_allclose(joined.R, whole.R, rtol=1e-12)
    assert joined.total == pytest.approx(whole.total)
    assert joined.count == 60.0


def test_shares_leave_some_of_the_variance_independent():
    assert _shares_of(np.array([1.0, 2.0, 1.0, 4.0])) == pytest.approx([0.25, 0.125, 0.5])
    # A negative variance of the independent errors: all is shared but for the least.
    shares = _shares_of(np.array([-1.0, 3.0, 1.0, 0.0]))
    assert np.sum(shares) == pytest.approx(1.0 - 1e-6, rel=1e-12)
    assert shares[0] / shares[1] == pytest.approx(3.0)
    assert unshared(np.array([0.9, 0.3])) == 1e-6


@pytest.mark.parametrize("ratio", [0.7, 0.3, -0.8])
def test_rounds_that_shrink_by_one_ratio_are_extrapolated_to_their_limit(ratio):
    """Two fits, of which the second approaches its limit from above."""
    limit = np.array([[[0.4, 0.2, 0.0]], [[0.1, 0.3, 0.2]]])
    away = np.array([[[-0.1, -0.05, 0.0]], [[0.05, 0.02, 0.04]]])
    began = [limit + away, limit + ratio * away]
    rounds = [(x, limit + ratio * (x - limit)) for x in began]
    np.testing.assert_allclose(extrapolated(*rounds), limit, atol=1e-12)


def test_an_extrapolation_leaves_shares_between_none_and_what_targets_need_for_themselves():
    """Slow rounds point below zero, or beyond one; there the last round counts."""
    fall = np.array([[[0.3, 0.02, 0.0]]])
    step = np.array([0.0, 0.01, 0.0])
    down = [(fall, fall - step), (fall - step, fall - 1.95 * step)]
    assert extrapolated(*down)[0, 0].min() == 0.0
    rise = np.array([[[0.8, 0.0, 0.0]]])
    step = np.array([0.05, 0.0, 0.0])
    up = [(rise, rise + step), (rise + step, rise + 1.9 * step)]
    np.testing.assert_array_equal(extrapolated(*up), up[1][1])
    still = np.zeros((1, 1, 3))
    np.testing.assert_array_equal(extrapolated((still, still), (still, still)), still)
