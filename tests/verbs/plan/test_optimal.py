"""The choice of poses against what is true of every optimal design, and against trying all of them."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from calib.verbs.plan.optimal import Basis, _gain_bounds, _gains, choose, exchange, information


def pool(seed: int, n: int, d: int, p: int, spread: float = 0.0) -> np.ndarray:
    """Derivatives of n candidates, the columns of very different sizes."""
    rng = np.random.default_rng(seed)
    return rng.normal(size=(n, d, p)) * 10.0 ** rng.uniform(-spread, spread, p)


def basis_of(
    A: np.ndarray,
    criterion: str = "D",
    precision: np.ndarray | None = None,
    known: np.ndarray | None = None,
    weight: np.ndarray | None = None,
) -> Basis:
    """The basis of a pool; the criterion V is that of the pool itself."""
    p = A.shape[2]
    precision = np.zeros(p) if precision is None else precision
    known = np.diag(precision) + (0.0 if known is None else known)
    if weight is None:
        weight = {"D": None, "A": np.eye(p), "V": information(A) / len(A)}[criterion]
    return Basis.of(information(A) / len(A), known, weight)


def cost(M: np.ndarray, weight: np.ndarray | None) -> float:
    """The criterion from the full information matrix, in the parameters themselves."""
    if weight is None:
        return -float(np.linalg.slogdet(M)[1])
    return float(np.trace(weight @ np.linalg.inv(M)))


def with_target(C: np.ndarray, basis: Basis) -> np.ndarray | None:
    """C T C, or None without a target T."""
    return None if basis.target is None else C @ basis.target @ C


# The gain of a candidate


@pytest.mark.parametrize("d", [1, 3, 6])
@pytest.mark.parametrize("criterion", ["D", "A", "V"])
def test_the_candidate_added_is_the_one_that_a_recomputation_likes_best(d, criterion):
    for seed in range(10):
        A = pool(seed, 40, d, 5, spread=2.0)
        precision = np.full(5, 0.1)
        basis = basis_of(A, criterion, precision)
        weight = {"D": None, "A": np.eye(5), "V": information(A) / 40}[criterion]
        start = np.arange(6)
        M = np.diag(precision) + information(A[start])
        costs = [np.inf if k in start else cost(M + A[k].T @ A[k], weight) for k in range(len(A))]
        best = int(np.argmin(costs))
        C = np.linalg.inv(basis.known + information(A[start] @ basis.directions))
        gain = _gains(A @ basis.directions, C, with_target(C, basis))
        gain[start] = -1.0
        assert int(np.argmax(gain)) == best
        before = cost(M, weight)
        expected = np.exp(before - costs[best]) if weight is None else before - costs[best]
        assert gain[best] == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("d", [1, 3, 6])
@pytest.mark.parametrize("criterion", ["D", "A", "V"])
def test_no_candidate_gains_more_than_its_bound(d, criterion):
    A = pool(20 + d, 1100, d, 5, spread=2.0)  # more than one block
    basis = basis_of(A, criterion, np.full(5, 0.1))
    blocks = A @ basis.directions
    C = np.linalg.inv(basis.known + information(blocks[:4]))
    CTC = with_target(C, basis)
    gains, most = _gains(blocks, C, CTC), _gain_bounds(blocks, C, CTC)
    assert np.all(most >= gains * (1.0 - 1e-9))
    assert np.median(most / gains) < (1.0 + 1e-9 if d == 1 and criterion == "D" else 20.0)


@pytest.mark.parametrize("criterion", ["D", "A", "V"])
def test_an_exchange_ends_where_no_other_candidate_is_better(criterion):
    A = pool(50, 60, 2, 6, spread=1.0)
    basis = basis_of(A, criterion, np.full(6, 0.01))
    blocks = A @ basis.directions
    chosen, least = exchange(blocks, basis, np.arange(5))
    for k in range(5):
        others = np.delete(chosen, k)
        M = basis.known + information(blocks[others])
        costs = [
            cost(M + blocks[x].T @ blocks[x], basis.target)
            for x in set(range(60)) - set(others.tolist())
        ]
        assert min(costs) >= least - 1e-6 * abs(least)


# Against all designs of small pools


@pytest.mark.parametrize("criterion", ["D", "A", "V"])
@pytest.mark.parametrize(
    ("prior", "taken"), [(False, 0), (True, 0), (False, 3), (True, 3)], ids=str
)
def test_the_best_of_all_designs_is_found(criterion, prior, taken):
    for seed in range(5):
        A = pool(100 + seed, 10, 2, 6, spread=1.0)
        measured = pool(200 + seed, taken, 2, 6)
        known = information(measured)
        size = np.sqrt(np.diag(information(A) / len(A)))
        precision = (0.3 * size * np.arange(1, 7)) ** 2 if prior else np.zeros(6)
        weight = {"D": None, "A": np.diag(size**2), "V": information(A) / len(A)}[criterion]
        basis = basis_of(A, criterion, precision, known, weight)
        K = np.diag(precision) + known
        costs = {c: cost(K + information(A[list(c)]), weight) for c in combinations(range(10), 4)}
        found = choose(A @ basis.directions, basis, 4, seed, restarts=20)
        assert len(set(found.tolist())) == 4
        best = min(costs.values())
        assert costs[tuple(sorted(found.tolist()))] <= best + 1e-9 * abs(best)


# Kiefer and Wolfowitz


@pytest.mark.parametrize("seed", range(2))
def test_no_design_beats_rank_over_n(seed):
    A = pool(700 + seed, 300, 3, 9, spread=2.0)
    basis = basis_of(A)
    blocks = A @ basis.directions
    for chosen in (choose(blocks, basis, 12, seed), np.arange(12)):
        C = np.linalg.inv(information(A[chosen]))
        variance = np.einsum("ndi,ij,ndj->n", A, C, A)
        assert variance.max() >= 9 / 12
        assert variance[chosen].sum() == pytest.approx(9.0, rel=1e-6)
    best = choose(blocks, basis, 60, seed)
    variance = np.einsum("ndi,ij,ndj->n", A, np.linalg.inv(information(A[best])), A)
    drawn = np.einsum("ndi,ij,ndj->n", A, np.linalg.inv(information(A[:60])), A)
    assert variance.max() < drawn.max()
    assert variance.max() < 1.5 * 9 / 60


def test_a_column_of_rounding_is_no_direction():
    # A target on the last axis moves by 1e-17 m with that joint's angle: scaled up, the choice went on for ever.
    rng = np.random.default_rng(5)
    A = rng.normal(size=(40, 3, 5))
    A[:, :, 4] *= 1e-17
    precision = np.array([0.0, 0.0, 0.0, 0.0, 4444.0])
    basis = Basis.of(information(A) / 40, np.diag(precision), np.eye(5))
    assert basis.directions.shape[1] == 4
    assert np.linalg.eigvalsh(basis.known).min() > 0.0
    chosen = choose(A @ basis.directions, basis, 6, 0)
    assert len(set(chosen.tolist())) == 6
