"""Optimal design: the choice of candidates that determines parameters or predictions best, by exchange.

Let A_i (d x p) be the whitened derivative of what is measured at pose i. The poses of a design S and what is known
before give the information matrix M, whose inverse is the covariance C of the parameters:

    M = K + sum_(i in S) A_i^T A_i,    C = M^-1

- ``D``: largest log det M, the smallest confidence ellipsoid of all parameters together;
- ``A``: smallest tr(W C), W = 1 / step^2 of each parameter: the sum of their variances, in squares of their steps;
- ``V``: smallest tr(B C), B the mean of J^T J over the poses that matter: the mean variance of a predicted position.

With C of the design without one pose, G = A_x C A_x^T and E = A_x C W C A_x^T, adding the candidate x multiplies det M
by det(I + G) and reduces tr(W C) by tr((I + G)^-1 E). All candidates are tried at once, and each pose of the design in
turn is exchanged for the best one until nothing improves (V. Fedorov, 1972). Without priors, the largest variance
tr(A_i C A_i^T) over the candidates is at least rank / N for any design of N poses (J. Kiefer, J. Wolfowitz, 1960).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import dtrmm

from calib.basics.arrays import Array
from calib.robot.kernel import over_blocks, sum_over_blocks
from calib.verbs.plan.forecast import information

Indices = NDArray[np.int_]

#: A direction with less than this share of the information on the strongest one is unobservable [-].
_UNSEEN = 1e-10

#: A parameter with less than this share of the strongest one's effect on what is measured has none: rounding [-].
_ROUNDING = 1e-12

#: Least improvement that is not rounding, in log det M or relative to tr(W C).
_LEAST_GAIN = 1e-7

#: Random starts of the exchange on the short list.
RESTARTS = 3

#: Candidates on the short list.
SHORT = 5000

#: Steps of the multiplicative algorithm that ranks candidates for the short list.
_RANKING_STEPS = 25

#: Information on each direction of the basis if nothing is known, in units of a mean candidate's. `_gains` compares
#: candidates with the precision of a double divided by its square.
_LEASH = 1e-6


class Basis(NamedTuple):
    """Directions that a pool of candidates observes, scaled so that a mean candidate's information is I."""

    #: Shape (p, r), a unit of each of the r coordinates as a change of the p parameters, in their units.
    directions: Array
    #: Shape (r, r), the information before the first pose is chosen, along the directions.
    known: Array
    #: Shape (r, r), W or B of the criterion, along the directions; None for ``D``.
    target: Array | None

    @classmethod
    def of(cls, mean_information: Array, known: Array, weight: Array | None) -> Basis:
        """Find the directions of the p parameters that a pool of candidates observes.

        Args:
            mean_information: Mean of A^T A over the candidates, shape (p, p), with the derivative A, shape (d, p), of
                the d scalars measured at one pose by the parameters, in standard deviations of the noise per unit of
                the parameter.
            known: Information of priors and of poses measured already, shape (p, p), in the same units.
            weight: T of a criterion tr(T C) with the covariance C of the parameters, shape (p, p): W of ``A`` or B of
                ``V``; None for ``D``, which maximises the determinant of the information.
        """
        effect = np.sqrt(np.diag(mean_information))
        # A parameter without any effect is not scaled up, such as a joint's angle if the target is on its axis.
        moves = effect > _ROUNDING * effect.max()
        scale = 1.0 / np.where(moves, effect, 1.0)
        scaled = np.where(np.outer(moves, moves), mean_information, 0.0) * np.outer(scale, scale)
        values, vectors = np.linalg.eigh(scaled)
        is_seen = values > _UNSEEN * values[-1]
        observable = scale[:, None] * vectors[:, is_seen] / np.sqrt(values[is_seen])
        unobservable = scale[:, None] * vectors[:, ~is_seen]
        # Priors tie unobservable directions to observable ones, and so they follow these.
        stiffness = np.linalg.pinv(unobservable.T @ known @ unobservable, hermitian=True)
        follow = stiffness @ (unobservable.T @ known @ observable)
        directions = observable - unobservable @ follow
        before = directions.T @ known @ directions
        before += _LEASH * np.eye(directions.shape[1])  # so that it can be inverted
        if weight is None:
            return cls(directions, before, None)
        return cls(directions, before, directions.T @ weight @ directions)


def choose(
    blocks: Array,
    basis: Basis,
    count: int,
    seed: int,
    restarts: int = RESTARTS,
    rank: Array | None = None,
) -> Indices:
    """Choose a design of different candidates by the criterion of a basis, the best one that is found.

    Poses are exchanged within a short list, the `SHORT` candidates that `ranking` puts first, from several random
    starts; the best of these designs is then improved by exchanges with all candidates.

    Args:
        blocks: Whitened derivatives of the d scalars measured at each of n candidates, along the r directions of the
            basis, shape (n, d, r), [-].
        basis: The directions, and the criterion.
        count: Number of poses of the design, at most n.
        seed: Seed of the random starts.
        restarts: Number of random starts, 1 or more.
        rank: The `ranking` of the candidates, shape (n,), larger for those that matter more; None: it is computed.

    Returns:
        Indices of the chosen candidates, from 0, all different, shape (count,), in no particular order.
    """
    rng = np.random.default_rng(seed)
    if rank is None:
        rank = ranking(blocks, basis)
    short = short_list(rank, max(SHORT, count))
    few = blocks[short]
    best, least = np.arange(count), np.inf
    for start in range(restarts):
        design = rng.choice(len(few), count, replace=False)
        if basis.target is not None and start % 2 == 0:
            # The determinant has fewer local optima: if poses are few, its design is usually the better start.
            design, _ = exchange(few, basis._replace(target=None), design)
        design, cost = exchange(few, basis, design)
        if cost < least:
            best, least = design, cost
    design, _ = exchange(blocks, basis, short[best])
    return design


def exchange(blocks: Array, basis: Basis, start: Indices, count: int = 0) -> tuple[Indices, float]:
    """Exchange each pose of a design for the best candidate until nothing improves.

    Args:
        blocks: Whitened derivatives of the d scalars measured at each of n candidates, along the r directions of the
            basis, shape (n, d, r), [-].
        basis: The directions, and the criterion.
        start: The design to begin with: indices of candidates, from 0, all different, shape (N,); N may be 0.
        count: Number of poses of the design: if ``start`` has fewer, the best ones are first added one by one; a longer
            start keeps its number.

    Returns:
        The design, indices of different candidates from 0, shape (max(N, count),); and its cost: -log det M, or
        tr(T C).
    """
    design = start.tolist()
    while len(design) < count:
        design.append(_best_addition(blocks, basis, design))
    least = _cost(basis.known + information(blocks[design]), basis)
    k, unchanged = 0, 0
    while unchanged < len(design):
        others = design[:k] + design[k + 1 :]
        better = _best_addition(blocks, basis, others, design[k])
        trial = [*design[:k], better, *design[k + 1 :]]
        cost = least
        if trial != design:
            cost = _cost(basis.known + information(blocks[trial]), basis)
        least_gain = _LEAST_GAIN * (1.0 if basis.target is None else abs(least))
        # Compared by the cost, not the gain: without one of few poses little is known, and rounding errors of the gain
        # would lead in circles.
        if cost < least - least_gain:
            design, least, unchanged = trial, cost, 0
        else:
            unchanged += 1
        k = (k + 1) % len(design)
    return np.array(design, dtype=np.int_), least


def gains(blocks: Array, basis: Basis) -> Array:
    """Compute what each of n candidates gains by itself, beside what is known, shape (n,).

    It is det(I + G) without a target, else what tr(T C) falls by; see the module's text.
    """
    C = np.linalg.inv(basis.known)
    return _gains(blocks, C, None if basis.target is None else C @ basis.target @ C)


def without_least(blocks: Array, basis: Basis, design: Indices) -> Indices:
    """Return a design of two or more candidates without the one that is missed least."""
    total = basis.known + information(blocks[design])
    costs = [_cost(total - information(blocks[[k]]), basis) for k in design]
    return np.delete(design, int(np.argmin(costs)))


def _best_addition(blocks: Array, basis: Basis, design: list[int], *likely: int) -> int:
    """Return the index of the candidate outside a design that improves it most when it is added.

    The design are indices of candidates, and so are ``likely`` ones, guesses that save time and change nothing.

    `_gains` are computed only for candidates whose upper bound reaches the gain of a good one.
    """
    C = np.linalg.inv(basis.known + information(blocks[design]))
    CTC = None if basis.target is None else C @ basis.target @ C
    bound = _gain_bounds(blocks, C, CTC)
    bound[design] = -1.0
    first = [int(np.argmax(bound)), *likely]
    least = _gains(blocks[first], C, CTC).max()
    bound[first] = np.inf  # by rounding, the bound of the best one may be less than its gain
    promising = np.flatnonzero(bound >= least)
    gains = _gains(blocks[promising], C, CTC)
    return int(promising[np.argmax(gains)])


def ranking(blocks: Array, basis: Basis) -> Array:
    """Compute how much an optimal design with any number of poses would rely on each candidate.

    The multiplicative algorithm (S. Silvey, D. Titterington, B. Torsney, 1978) moves the weights w of the candidates,
    whose sum is 1, towards the optimal ones: w_i <- w_i (s_i / sum_j w_j s_j)^a, a = 1 for the determinant, else 1/2.
    At the optimum the sensitivity s is largest where w is not 0. What is known before does not count.

    Args:
        blocks: Whitened derivatives A of the d scalars measured at each of n candidates, along the r directions of the
            basis, shape (n, d, r), [-].
        basis: The criterion.

    Returns:
        The sensitivity s of each candidate, shape (n,): tr(A C A^T), or tr(A C T C A^T), with C the inverse of the
        weighted mean of A^T A; larger if the design relies more on the candidate.
    """
    n, _, r = blocks.shape

    def information_of(block: slice) -> Array:
        """Return sum w A^T A of a slice of the candidates."""
        A = blocks[block]
        return np.asarray((A * weights[block, None, None]).reshape(-1, r).T @ A.reshape(-1, r))

    def squares_of(block: slice) -> Array:
        """Return tr(A C A^T), C = root root^T, of each candidate of a slice."""
        changes = (blocks[block].reshape(-1, r) @ root).reshape(-1, blocks[0].size)
        return np.asarray(np.einsum("nk,nk->n", changes, changes))

    power = 1.0 if basis.target is None else 0.5
    sensitivity = weights = np.full(n, 1.0 / n)
    for _ in range(_RANKING_STEPS):
        M = sum_over_blocks(information_of, n)
        C = np.linalg.inv(M + _LEASH * np.eye(r))
        if basis.target is not None:
            # So that the target has a root, and is symmetric in spite of rounding.
            leash = _LEASH * np.trace(basis.target)
            C = C @ (basis.target + leash * np.eye(r)) @ C
            C = 0.5 * (C + C.T)
        root = np.linalg.cholesky(C)
        sensitivity = np.concatenate(over_blocks(squares_of, n))
        weights = weights * (sensitivity / (weights @ sensitivity)) ** power
        weights /= weights.sum()
    return sensitivity


def short_list(rank: Array, count: int) -> Indices:
    """Return the indices of the candidates with the largest values of `ranking` (n,), in rising order."""
    return np.sort(np.argsort(-rank, kind="stable")[:count])


def _gain_bounds(blocks: Array, C: NDArray[np.floating[Any]], CTC: Array | None) -> Array:
    """Bound from above what adding each of n candidates gains, (n,), as `_gains` computes it at five times the cost.

    det(I + G) <= (1 + tr G / d)^d without a target,    tr((I + G)^-1 E) <= tr E with one
    """
    n, d, r = blocks.shape
    K = C if CTC is None else CTC
    # K is symmetric: x^T K x = x^T U x with an upper triangle U, which halves the products.
    U = np.asfortranarray(np.triu(2.0 * K) - np.diag(np.diag(K)))

    def work(block: slice) -> Array:
        """Return tr(A K A^T) of each candidate of a slice."""
        A = blocks[block].reshape(-1, r)
        AU = dtrmm(1.0, U, A.T).T
        return np.asarray(np.einsum("nk,nk->n", AU.reshape(-1, d * r), A.reshape(-1, d * r)))

    trace = np.concatenate(over_blocks(work, n))
    if CTC is None:
        return np.asarray((1.0 + trace / d) ** d)
    return trace


def _gains(blocks: Array, C: NDArray[np.floating[Any]], CTC: Array | None) -> Array:
    """Compute what adding each of n candidates to a design of covariance C (r, r) gains, (n,).

    It is det(I + G) without a target (CTC is None), else what tr(T C) falls by with the target T (r, r),
    tr((I + G)^-1 E): G = A C A^T and E = A C T C A^T, A being a candidate's derivative in ``blocks`` (n, d, r).
    """
    n, d, r = blocks.shape
    both = C if CTC is None else np.hstack([C, CTC])
    # G and E by one product, side by side: shape (n, d, 1 or 2, d).
    Y = (blocks.reshape(-1, r) @ both).reshape(n, -1, r)
    products = np.matmul(Y, blocks.transpose(0, 2, 1)).reshape(n, d, -1, d)
    I_plus_G = np.eye(d) + products[:, :, 0]
    if CTC is None:
        return np.asarray(np.linalg.det(I_plus_G))
    E = products[:, :, 1]
    return np.asarray(np.trace(np.linalg.solve(I_plus_G, E), axis1=1, axis2=2))


def _cost(M: Array, basis: Basis) -> float:
    """Return the criterion of a design with the information M (r, r), less for a better one.

    It is -log det M if the basis has no target, else tr(T C) with C = M^-1.
    """
    if basis.target is None:
        return -float(np.linalg.slogdet(M)[1])
    return float(np.trace(np.linalg.solve(M, basis.target)))
