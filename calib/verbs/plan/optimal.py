"""Optimal design: a choice of candidates that determines parameters or predictions best, by exchange.

With the whitened derivative A_i (d x p) of what is measured at pose i, the poses of a design S and what is known before
give the information matrix, and its inverse is the covariance of the parameters:

    M = K + sum_(i in S) A_i^T A_i,    C = M^-1

- ``D``: largest log det M, the smallest confidence ellipsoid of all parameters together;
- ``A``: smallest tr(W C), W = 1 / step^2 of each parameter: the sum of their variances, in squares of their steps;
- ``V``: smallest tr(B C), B the mean of J^T J over the poses that matter: the mean variance of a predicted position.

With C of the design without one pose, G = A_x C A_x^T and E = A_x C W C A_x^T, adding x multiplies det M by det(I + G)
and lessens tr(W C) by tr((I + G)^-1 E). All candidates are tried at once, and each pose of the design in turn is
exchanged for the best until nothing gets better (V. Fedorov, 1972). Without priors no design of N poses has a largest
variance tr(A_i C A_i^T) over its candidates below rank / N (J. Kiefer, J. Wolfowitz, 1960).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib.basics.arrays import Array
from calib.robot.kernel import over_blocks
from calib.verbs.plan.forecast import information

Indices = NDArray[np.int_]

#: A direction whose information is less than this share of the strongest one's is unobservable [-].
_UNSEEN = 1e-10

#: A parameter whose effect on what is measured is less than this share of the strongest one's is rounding [-].
_ROUNDING = 1e-12

#: A gain below this, in log det M or relative to tr(W C), is rounding.
_LEAST_GAIN = 1e-7

#: Random starts of the exchange on the short list.
RESTARTS = 3

#: Candidates on the short list.
SHORT = 5000

#: Steps of the multiplicative algorithm that ranks candidates for the short list.
_RANKING_STEPS = 25

#: Information on each direction of the basis when nothing is known, in units of a mean candidate's. Its inverse square
#: times the rounding of a double is how exactly `_gains` compares candidates.
_LEASH = 1e-6


class Basis(NamedTuple):
    """Directions that a pool of candidates can tell apart, scaled so that a mean candidate's information is I."""

    #: Shape (p, r), a unit of each of the r coordinates as a change of the p parameters, in their units.
    directions: Array
    #: Shape (r, r), the information before the first pose is chosen, along the directions.
    known: Array
    #: Shape (r, r), W or B of the criterion, along the directions; None for ``D``.
    target: Array | None

    @classmethod
    def of(cls, mean_information: Array, known: Array, weight: Array | None) -> Basis:
        """Find the directions of the p parameters that a pool of candidates can tell apart.

        In these coordinates the information of a mean candidate is the identity, however different the parameters'
        units.

        Args:
            mean_information: Mean of A^T A over the candidates, shape (p, p), with the derivative A, shape (d, p), of
                the d scalars measured at one pose by the parameters, in standard deviations of the noise per unit of
                the parameter.
            known: Information of priors and of poses measured already, shape (p, p), in the same units.
            weight: T of a criterion tr(T C) with the covariance C of the parameters, shape (p, p): W of ``A`` or B of
                ``V``; None for ``D``, which maximises the determinant of the information.

        Returns:
            ``directions``, shape (p, r): columns are changes of the parameters, in their units, in which those that no
            candidate observes follow as ``known`` ties them. ``known`` along these, shape (r, r), plus 1e-6 I, so that
            it can be inverted. ``target``, T along these, shape (r, r), or None for ``D``.
        """
        observable, unobservable = _directions(mean_information)
        # What is known ties directions that the pool does not see to those that it sees: they follow.
        stiffness = np.linalg.pinv(unobservable.T @ known @ unobservable, hermitian=True)
        follow = stiffness @ (unobservable.T @ known @ observable)
        directions = observable - unobservable @ follow
        before = directions.T @ known @ directions + _LEASH * np.eye(directions.shape[1])
        if weight is None:
            return cls(directions, before, None)
        return cls(directions, before, directions.T @ weight @ directions)


def _directions(mean_information: Array) -> tuple[Array, Array]:
    """Split the space of p parameters into directions that a mean candidate observes, and those that it does not.

    Args:
        mean_information: Mean of A^T A over the candidates, shape (p, p), with the derivative A, shape (d, p), of the d
            scalars measured at one pose by the parameters, in standard deviations of the noise per unit of the
            parameter.

    Returns:
        Changes of the parameters, in their units, as columns: r directions in which the mean information is the
        identity, shape (p, r); and those with 1e-10 or less of the strongest one's information, each parameter scaled
        by its own, shape (p, p - r).
    """
    effect = np.sqrt(np.diag(mean_information))
    # What moves nothing but for rounding is not scaled up: a target on an axis does not tell that joint's angle.
    moves = effect > _ROUNDING * effect.max()
    scale = 1.0 / np.where(moves, effect, 1.0)
    scaled = np.where(np.outer(moves, moves), mean_information, 0.0) * np.outer(scale, scale)
    values, vectors = np.linalg.eigh(scaled)
    seen = values > _UNSEEN * values[-1]
    observable = scale[:, None] * vectors[:, seen] / np.sqrt(values[seen])
    return observable, scale[:, None] * vectors[:, ~seen]


def choose(
    blocks: Array,
    basis: Basis,
    count: int,
    seed: int,
    restarts: int = RESTARTS,
    rank: Array | None = None,
) -> Indices:
    """Choose the best design of different candidates that is found, by the criterion of a basis.

    Poses are exchanged within a short list, the 5000 candidates that `ranking` puts first, from several random starts;
    the best of these designs is then improved by exchanges with all candidates.

    Args:
        blocks: Whitened derivatives of the d scalars measured at each of n candidates, along the r directions of the
            basis, shape (n, d, r), [-].
        basis: The r directions, with ``known``, the information before the first pose, shape (r, r), and ``target``,
            the matrix T of the criterion tr(T C) with the covariance C, shape (r, r), or None for the determinant.
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
            # The determinant has fewer local optima: where poses are few, its design is the better start, as a rule.
            design, _ = exchange(few, basis._replace(target=None), design)
        design, cost = exchange(few, basis, design)
        if cost < least:
            best, least = design, cost
    design, _ = exchange(blocks, basis, short[best])
    return design


def exchange(blocks: Array, basis: Basis, start: Indices, count: int = 0) -> tuple[Indices, float]:
    """Exchange each pose of a design for the best candidate until nothing gets better.

    Args:
        blocks: Whitened derivatives of the d scalars measured at each of n candidates, along the r directions of the
            basis, shape (n, d, r), [-].
        basis: The r directions, with ``known``, the information before the first pose, shape (r, r), and ``target``,
            the matrix T of the criterion tr(T C) with the covariance C, shape (r, r), or None for the determinant.
        start: The design to begin with: indices of candidates, from 0, all different, shape (N,); N may be 0.
        count: Number of poses of the design: where ``start`` has fewer, the best ones are first added one by one; a
            longer start keeps its number.

    Returns:
        The design, indices of different candidates from 0, shape (max(N, count),); and its cost, less for a better one:
        -log det M with the information matrix M = C^-1 along the directions, or tr(T C).
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
        # By the cost, not the gain: without one of few poses little is known, and rounding would go in circles.
        if cost < least - least_gain:
            design, least, unchanged = trial, cost, 0
        else:
            unchanged += 1
        k = (k + 1) % len(design)
    return np.array(design, dtype=np.int_), least


def _best_addition(blocks: Array, basis: Basis, design: list[int], *likely: int) -> int:
    """Find the candidate that improves a design most, by the criterion of the basis.

    `_gains` are computed only of candidates whose upper bound `_most` is not below the gain of a good one.

    Args:
        blocks: Whitened derivatives of the d scalars measured at each of n candidates, along the r directions of the
            basis, shape (n, d, r), [-].
        basis: The r directions, with ``known``, the information before the first pose, shape (r, r), and ``target``,
            the matrix T of the criterion tr(T C) with the covariance C, shape (r, r), or None for the determinant.
        design: Indices of candidates, from 0, that are chosen already and not added again; it may be empty.
        likely: Indices of candidates, not in ``design``, that may well be the best: a first guess, which saves time and
            changes nothing.

    Returns:
        Index of the candidate, from 0.
    """
    C = np.linalg.inv(basis.known + information(blocks[design]))
    bound = _most(blocks, C, basis.target)
    bound[design] = -1.0
    first = [int(np.argmax(bound)), *likely]
    least = _gains(blocks[first], C, basis.target).max()
    bound[first] = np.inf  # the bound of the best one may round to less than its gain
    promising = np.flatnonzero(bound >= least)
    gains = _gains(blocks[promising], C, basis.target)
    return int(promising[np.argmax(gains)])


def ranking(blocks: Array, basis: Basis) -> Array:
    """Compute how much an optimal design with as many poses as it likes would rely on each candidate.

    The multiplicative algorithm (S. Silvey, D. Titterington, B. Torsney, 1978) moves the weights w of candidates, which
    add up to 1, towards the optimal ones, 25 times: w_i <- w_i (s_i / sum_j w_j s_j)^a, a = 1 for the determinant, else
    1/2. At the optimum the sensitivity s is largest on the support of w. What is known before does not count.

    Args:
        blocks: Whitened derivatives A of the d scalars measured at each of n candidates, along the r directions of the
            basis, shape (n, d, r), [-].
        basis: ``basis.target``, the matrix T of the criterion tr(T C) with the covariance C, shape (r, r), or None for
            the determinant.

    Returns:
        The sensitivity s of each candidate, shape (n,): tr(A C A^T), or tr(A C T C A^T), with C the inverse of the
        weighted mean of A^T A; the larger, the more the design relies on a candidate.
    """
    n, rows, r = blocks.shape
    flat = blocks.reshape(-1, r)
    power = 1.0 if basis.target is None else 0.5
    sensitivity = weights = np.full(n, 1.0 / n)
    for _ in range(_RANKING_STEPS):
        M = (flat * np.repeat(weights, rows)[:, None]).T @ flat
        C = np.linalg.inv(M + _LEASH * np.eye(r))
        if basis.target is not None:
            # A target without zero directions has a root; products round.
            leash = _LEASH * np.trace(basis.target)
            C = C @ (basis.target + leash * np.eye(r)) @ C
            C = 0.5 * (C + C.T)
        root = np.linalg.cholesky(C)
        sensitivity = np.sum((flat @ root).reshape(n, -1) ** 2, axis=1)
        weights = weights * (sensitivity / (weights @ sensitivity)) ** power
        weights /= weights.sum()
    return sensitivity


def short_list(rank: Array, count: int) -> Indices:
    """Return the candidates with the largest values of `ranking`.

    Args:
        rank: The `ranking` of n candidates, shape (n,), larger for those that matter more.
        count: Number of candidates to return.

    Returns:
        Indices of the candidates, from 0, in rising order, shape (count,), or (n,) where there are fewer.
    """
    return np.sort(np.argsort(-rank, kind="stable")[:count])


def _most(blocks: Array, C: NDArray[np.floating[Any]], target: Array | None) -> Array:
    """Bound from above what adding each candidate gains, at a fifth of the price of `_gains`.

        det(I + G) <= (1 + tr G / d)^d,    tr((I + G)^-1 E) <= tr E

    with G = A C A^T and E = A C T C A^T of a candidate's derivative A.

    Args:
        blocks: Whitened derivatives A of the d scalars measured at each of n candidates, along the r directions of a
            `Basis`, shape (n, d, r), [-].
        C: Covariance of the r coordinates by the design without them, shape (r, r).
        target: T of the criterion tr(T C), W or B along the directions, shape (r, r); None for ``D``, the determinant.

    Returns:
        Upper bound of what `_gains` returns of each candidate, shape (n,).
    """
    n, d, r = blocks.shape
    K = C if target is None else C @ target @ C

    def work(block: slice) -> Array:
        """Return the trace of A K A^T of each candidate of a slice of them, shape (part,), with K = C or C T C."""
        A = blocks[block].reshape(-1, r)
        AK = (A @ K).reshape(-1, d * r)
        return np.asarray(np.einsum("nk,nk->n", AK, A.reshape(-1, d * r)))

    trace = np.concatenate(over_blocks(work, n))
    if target is None:
        return np.asarray((1.0 + trace / d) ** d)
    return trace


def _gains(blocks: Array, C: NDArray[np.floating[Any]], target: Array | None) -> Array:
    """Compute what adding each candidate to a design gains.

    With G = A C A^T and E = A C T C A^T of a candidate's derivative A, the determinant of the information C^-1 is
    multiplied by det(I + G), and tr(T C) falls by tr((I + G)^-1 E).

    Args:
        blocks: Whitened derivatives A of the d scalars measured at each of n candidates, along the r directions of a
            `Basis`, shape (n, d, r), [-].
        C: Covariance of the r coordinates by the design without them, shape (r, r).
        target: T of the criterion tr(T C), W or B along the directions, shape (r, r); None for ``D``, the determinant.

    Returns:
        Shape (n,), larger for a better candidate: det(I + G) for ``D``, else how far tr(T C) falls.
    """
    n, d, r = blocks.shape
    both = C if target is None else np.hstack([C, C @ target @ C])
    # One product for G and E: their small matrices lie side by side, (n, d, 1 or 2, d).
    Y = (blocks.reshape(-1, r) @ both).reshape(n, -1, r)
    products = np.matmul(Y, blocks.transpose(0, 2, 1)).reshape(n, d, -1, d)
    I_plus_G = np.eye(d) + products[:, :, 0]
    if target is None:
        return np.asarray(np.linalg.det(I_plus_G))
    E = products[:, :, 1]
    return np.asarray(np.trace(np.linalg.solve(I_plus_G, E), axis1=1, axis2=2))


def _cost(M: Array, basis: Basis) -> float:
    """Compute the value of a criterion for a design; less is better.

    Args:
        M: Information matrix of the design and of what is known before, along the r directions of the basis, shape
            (r, r); its inverse C is their covariance.
        basis: ``basis.target``, the matrix T of the criterion tr(T C), W of ``A`` or B of ``V`` along the directions,
            shape (r, r); None for ``D``.

    Returns:
        -log det M for ``D``, else tr(T M^-1).
    """
    if basis.target is None:
        return -float(np.linalg.slogdet(M)[1])
    return float(np.trace(np.linalg.solve(M, basis.target)))
