"""The choice of poses against what is true of every optimal design, and against trying all of them."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from calib.design.optimal import (
    Basis,
    _gains,
    choose,
    exchange,
    information,
    short_list,
)


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
    known = np.zeros((p, p)) if known is None else known
    if weight is None:
        weight = {"D": None, "A": np.eye(p), "V": information(A) / len(A)}[criterion]
    return Basis.of(information(A) / len(A), precision, weight, known)


def cost(M: np.ndarray, weight: np.ndarray | None) -> float:
    """The criterion from the full information matrix, in the parameters themselves."""
    if weight is None:
        return -float(np.linalg.slogdet(M)[1])
    return float(np.trace(weight @ np.linalg.inv(M)))


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
        gain = _gains(A @ basis.directions, C, basis.target)
        gain[start] = -1.0
        assert int(np.argmax(gain)) == best
        before = cost(M, weight)
        expected = np.exp(before - costs[best]) if weight is None else before - costs[best]
        assert gain[best] == pytest.approx(expected, rel=1e-4)


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


@pytest.mark.parametrize("criterion", ["D", "A", "V"])
@pytest.mark.parametrize("kind", ["zeros", "equal"])
def test_columns_that_no_candidate_tells_apart(criterion, kind):
    """With priors of different sizes: the unseen directions move with the seen ones."""
    for seed in range(5):
        A = pool(400 + seed, 10, 2, 6)
        A[:, :, 5] = 0.0 if kind == "zeros" else A[:, :, 0]
        precision = np.array([4.0, 0.1, 0.2, 0.3, 0.4, 0.5])
        size = {"D": None, "A": np.diag([1.0, 1.0, 1.0, 1.0, 1.0, 3.0]), "V": None}[criterion]
        weight = information(A) / len(A) if criterion == "V" else size
        basis = basis_of(A, criterion, precision, weight=weight)
        assert basis.directions.shape[1] == 5
        costs = {
            c: cost(np.diag(precision) + information(A[list(c)]), weight)
            for c in combinations(range(10), 3)
        }
        found = choose(A @ basis.directions, basis, 3, seed, restarts=20)
        best = min(costs.values())
        assert costs[tuple(sorted(found.tolist()))] <= best + 1e-9 * abs(best)


# What the cost is


def test_an_exchange_never_ends_worse_than_it_began_and_no_single_one_helps_then():
    for seed in range(10):
        A = pool(600 + seed, 60, 3, 7)
        for criterion in "DAV":
            basis = basis_of(A, criterion)
            weight = {"D": None, "A": np.eye(7), "V": information(A) / 60}[criterion]
            start = np.random.default_rng(seed).choice(60, 8, replace=False)
            chosen, _ = exchange(A @ basis.directions, basis, start)
            least = cost(information(A[chosen]), weight)
            assert least <= cost(information(A[start]), weight)
            for k in range(8):
                for y in sorted(set(range(60)) - set(chosen.tolist())):
                    other = chosen.copy()
                    other[k] = y
                    assert cost(information(A[other]), weight) >= least - 1e-6 * abs(least)


# Textbook designs: a quadratic on [-1, 1]


def quadratic(x: np.ndarray) -> np.ndarray:
    return np.stack([np.ones_like(x), x, x**2], axis=1)[:, None, :]


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


# Growing


# The short list


@pytest.mark.parametrize("criterion", ["D", "V"])
def test_the_short_list_keeps_what_an_endless_design_stands_on(criterion):
    x = np.linspace(-1.0, 1.0, 201)
    A = quadratic(x)
    basis = basis_of(A, criterion)
    short = short_list(A @ basis.directions, basis, 30)
    assert len(short) == len(set(short.tolist())) == 30
    assert (np.diff(short) > 0).all()
    assert {0, 100, 200} <= set(short.tolist())


def test_a_choice_by_the_short_list_is_as_good_as_one_without(monkeypatch):
    A = pool(11, 3000, 3, 9)
    basis = basis_of(A)
    whole = choose(A @ basis.directions, basis, 12, 0)
    monkeypatch.setattr("calib.design.optimal.SHORT", 400)
    quick = choose(A @ basis.directions, basis, 12, 0)
    assert cost(information(A[quick]), None) < cost(information(A[whole]), None) + 0.2


# Units


@pytest.mark.parametrize("criterion", ["D", "V"])
def test_units_do_not_matter(criterion):
    A = pool(13, 80, 3, 6)
    scaled = A * 10.0 ** np.array([-6, -3, 0, 3, 6, 1.5])
    found = []
    for one in (A, scaled):
        basis = basis_of(one, criterion)
        found.append(sorted(choose(one @ basis.directions, basis, 8, 0).tolist()))
    assert found[0] == found[1]


def test_a_column_of_rounding_is_no_direction():
    # A target on the last axis moves by 1e-17 m with that joint's angle: scaled up, the choice went on for ever.
    rng = np.random.default_rng(5)
    A = rng.normal(size=(40, 3, 5))
    A[:, :, 4] *= 1e-17
    precision = np.array([0.0, 0.0, 0.0, 0.0, 4444.0])
    basis = Basis.of(information(A) / 40, precision, np.eye(5), np.zeros((5, 5)))
    assert basis.directions.shape[1] == 4
    assert np.linalg.eigvalsh(basis.known).min() > 0.0
    chosen = choose(A @ basis.directions, basis, 6, 0)
    assert len(set(chosen.tolist())) == 6
