"""Which poses to measure: optimal choice out of a pool of candidates, by exchange, and what it will reach.

With the whitened derivative A_i (d x p) of what is measured at pose i, the poses of a design S and what is known before
give the information matrix, and its inverse is the covariance of the parameters:

    M = K + sum_(i in S) A_i^T A_i,    C = M^-1

- ``D``: largest log det M, the smallest confidence ellipsoid of all parameters together;
- ``A``: smallest tr(W C), W = 1 / step^2 of each parameter: their mean variance;
- ``V``: smallest tr(B C), B the mean of J^T J over the poses that matter: the mean variance of a predicted position.

With C of the design without one pose, G = A_x C A_x^T and E = A_x C W C A_x^T, adding x multiplies det M by det(I + G)
and lessens tr(W C) by tr((I + G)^-1 E). All candidates are tried at once, and each pose of the design in turn is
exchanged for the best until nothing gets better (V. Fedorov, 1972). Without priors no design of N poses has a largest
variance tr(A_i C A_i^T) over its candidates below rank / N (J. Kiefer, J. Wolfowitz, 1960).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.design.candidates import Pool
from calib.design.forecast import Forecast, Sensitivity, Workspace, information
from calib.errors import ModelError
from calib.jobs import Progress
from calib.model.observability import steps
from calib.robot.kernel import over_blocks
from calib.robot.robot import read_only
from calib.units import Array

Indices = NDArray[np.int_]

#: A direction that moves what is measured by less than this share of the strongest one is none [-], squared; and a
#: parameter that moves it by less than the second does so by rounding.
_UNSEEN, _ROUNDING = 1e-10, 1e-12

#: A gain below this, in log det M or relative to tr(W C), is rounding.
_LEAST_GAIN = 1e-7

#: Random starts of the exchange on the short list; one start for more poses than this: many choices are as good.
RESTARTS, _MANY = 3, 100

#: Candidates on the short list, and on that of the ladder: enough to show where more poses stop paying.
SHORT, _LADDER_POOL = 5000, 2000

#: Steps of the multiplicative algorithm that ranks candidates for the short list.
_RANKING_STEPS = 25

#: What is known of each direction of the basis when nothing is, in units of a mean candidate's information. Its
#: inverse square times the rounding of a double is how exactly `_gains` compares candidates.
_LEASH = 1e-6

#: Draws of random poses, of which the median is shown.
_RANDOM = 9

#: Poses that differ by less than this in every joint are the same one [rad or m].
_SAME = 1e-3

#: Poses of a plan at most: exchanging thousands takes hours, and nothing is gained that random ones do not have.
MOST_POSES = 300

#: Steps of the ladder by default, in poses of the plan.
_RUNGS = (0.5, 0.67, 0.83, 1.0, 1.33, 1.67, 2.0, 3.0)


@dataclass(frozen=True, slots=True, eq=False)
class PlanRequest:
    """Which poses are wanted."""

    count: int = 30  #: Poses to fit.
    validation: int = 5  #: Poses to validate with, drawn at random from the same candidates.
    #: ``"V"``: least mean variance of predicted positions; ``"D"``: largest determinant of the information; ``"A"``:
    #: least mean variance of the parameters.
    criterion: str = "V"
    candidates: int = 20_000  #: Poses among which is chosen.
    margin: float = math.radians(5.0)  #: Distance to the joint limits of the URDF [rad].
    #: shape (m,), where the robot stands before it begins [rad] or [m]; None: it begins at any pose.
    start: ArrayLike | None = None
    #: Whether other numbers of poses, from half to three times ``count``, are forecast too.
    ladder: bool = True
    seed: int = 0  #: The same seed makes the same plan.

    def check(self, candidates: int) -> None:
        """Refuse an unknown criterion, and numbers of poses that cannot be."""
        if self.criterion not in ("V", "D", "A"):
            raise ModelError(f"There is no criterion '{self.criterion}'. Choose V, D or A.")
        wanted, most = self.count + self.validation, min(candidates, MOST_POSES)
        if self.count < 1 or self.validation < 0 or wanted > most:
            raise ModelError(
                f"{self.count} poses and {self.validation} validation poses were asked for, of {candidates} candidates "
                f"that can be measured; it takes 1 pose or more and {most} or fewer in all. Draw more candidates, ask "
                "for fewer poses, or drop a condition."
            )


class Choice(NamedTuple):
    """What was chosen out of a pool, as in `calib.design.plan.Plan`."""

    planned: Array
    validation: Array
    forecast: Forecast
    before: Forecast | None
    at_random: Forecast
    ladder: tuple[tuple[int, Forecast], ...]


def choose_poses(
    sensitivity: Sensitivity,
    pool: Pool,
    request: PlanRequest,
    taken: Array | None = None,
    *,
    restarts: int = RESTARTS,
    progress: Progress | None = None,
) -> Choice:
    """Choose poses from a pool of candidates.

    ``taken``, shape (T, m), were measured already; they count, and are not planned again. One random start of the
    exchange in place of several ``restarts`` is a few percent worse.
    """
    taken = pool.q[:0] if taken is None else taken
    gaps = (np.remainder(pool.q - pose + np.pi, 2.0 * np.pi) - np.pi for pose in taken)
    again = [np.all(np.abs(gap) < _SAME, axis=1) for gap in gaps]
    q = pool.q[~np.any(again, axis=0)] if again else pool.q
    request.check(len(q))
    count, seed = request.count, request.seed
    measured = sensitivity.measured(q)
    workspace = Workspace.of(sensitivity, pool.workspace)
    d = measured.shape[1]
    fewest = max(1, -(-workspace.rank // d) - len(taken))
    wanted = {count, *(round(share * count) for share in _RUNGS)} if request.ladder else ()
    rungs = sorted(n for n in wanted if fewest <= n <= min(len(q), MOST_POSES))
    if count < fewest:
        before = f" with the {len(taken)} measured already" if len(taken) else ""
        raise ModelError(
            f"{count} poses give {d * (count + len(taken))} numbers{before}, and the model "
            f"'{sensitivity.kinematics.model.name}' has {workspace.rank} identifiable parameters: at least {fewest} "
            "poses are needed, twice as many are better. Ask for more poses, or choose a smaller --model."
        )

    def foreseen(indices: Indices) -> Forecast:
        return Forecast.of(sensitivity, workspace, np.concatenate([taken, q[indices]]))

    # The mean over poses and targets of J^T J.
    B = information(workspace.located) / (workspace.located[:, :, 0].size // 3)
    weights = {"D": None, "A": np.diag(1.0 / steps(sensitivity.units) ** 2), "V": B}
    known = np.diag(sensitivity.precision)
    known += information(sensitivity.measured(taken)) if len(taken) else 0.0
    basis = Basis.of(information(measured) / len(measured), known, weights[request.criterion])
    blocks = measured @ basis.directions
    rank = ranking(blocks, basis)
    chosen = choose(blocks, basis, count, seed, restarts if count <= _MANY else 1, rank)
    rng = np.random.default_rng([seed, 1])
    others = rng.permutation(np.setdiff1d(np.arange(len(q)), chosen))
    plan = foreseen(chosen)
    found: list[tuple[int, Forecast]] = []
    short = short_list(rank, max(_LADDER_POOL, *rungs, 0))
    few, at = blocks[short], np.zeros(0, dtype=np.int_)
    for number in rungs:
        if number != count:
            at = exchange(few, basis, at, number)[0]
        found.append((number, plan if number == count else foreseen(short[at])))
        if progress is not None:
            progress(len(found), len(rungs))
    drawn = [foreseen(rng.choice(len(q), count, replace=False)) for _ in range(_RANDOM)]
    return Choice(
        planned=read_only(q[chosen]),
        validation=read_only(q[others[: request.validation]]),
        forecast=plan,
        before=foreseen(chosen[:0]) if len(taken) else None,
        at_random=sorted(drawn, key=lambda one: one.rms)[_RANDOM // 2],
        ladder=tuple(found),
    )


class Basis(NamedTuple):
    """The directions that a pool of candidates can tell apart, scaled so that a mean candidate's information is I.

    ``directions``, shape (p, r), are a unit of each coordinate in the parameters; ``known``, shape (r, r), is the
    information before the first pose, ``target``, shape (r, r), W or B of the criterion, None for ``D``.
    """

    directions: Array
    known: Array
    target: Array | None

    @classmethod
    def of(cls, mean_information: Array, known: Array, weight: Array | None) -> Basis:
        """From the mean A^T A of the pool, the information of priors and poses taken, and W or B, shape (p, p)."""
        scale = np.sqrt(np.diag(mean_information))
        # What moves nothing but for rounding is not scaled up: a target on an axis does not tell that joint's angle.
        moves = scale > _ROUNDING * scale.max()
        scale = 1.0 / np.where(moves, scale, 1.0)
        mean_information = np.where(np.outer(moves, moves), mean_information, 0.0)
        values, vectors = np.linalg.eigh(mean_information * np.outer(scale, scale))
        seen = values > _UNSEEN * values[-1]
        directions = scale[:, None] * vectors[:, seen] / np.sqrt(values[seen])
        unseen = scale[:, None] * vectors[:, ~seen]
        # What is known ties directions that the pool does not see to those that it sees: they follow.
        follow = np.linalg.pinv(unseen.T @ known @ unseen, hermitian=True)
        directions = directions - unseen @ (follow @ (unseen.T @ known @ directions))
        before = directions.T @ known @ directions + _LEASH * np.eye(directions.shape[1])
        return cls(
            directions, before, None if weight is None else directions.T @ weight @ directions
        )


def choose(
    blocks: Array,
    basis: Basis,
    count: int,
    seed: int,
    restarts: int = RESTARTS,
    rank: Array | None = None,
) -> Indices:
    """The best found design of ``count`` different candidates.

    Exchanges on a short list from several random starts; the best of these is then exchanged with all candidates.

    Args:
        blocks: shape (n, d, r), the derivatives of the pool along the basis.
        basis: The basis.
        count: The number of poses.
        seed: Of the random starts.
        restarts: Their number.
        rank: shape (n,), the pool's `ranking`; None: not known.

    Returns:
        shape (count,), the places of the candidates in the pool.
    """
    rng = np.random.default_rng(seed)
    rank = ranking(blocks, basis) if rank is None else rank
    short = short_list(rank, max(SHORT, count))
    few = blocks[short]
    best, least = np.arange(count), np.inf
    for start in range(restarts):
        found = rng.choice(len(few), count, replace=False)
        if basis.target is not None and start % 2 == 0:
            # The determinant has fewer local optima: where poses are few, what it likes is the better start, as a rule.
            found, _ = exchange(few, basis._replace(target=None), found)
        found, cost = exchange(few, basis, found)
        if cost < least:
            best, least = found, cost
    return exchange(blocks, basis, short[best])[0]


def exchange(blocks: Array, basis: Basis, start: Indices, count: int = 0) -> tuple[Indices, float]:
    """Exchange each pose of a design for the best candidate until nothing gets better; also its cost.

    To fewer poses than ``count`` the best ones are added before.
    """

    def best(others: list[int], *likely: int) -> int:
        """The candidate that gains most beside the others; the likely ones are a first guess."""
        C = np.linalg.inv(basis.known + information(blocks[others]))
        most = _most(blocks, C, basis.target)
        most[others] = -1.0
        first = [int(np.argmax(most)), *likely]
        least = _gains(blocks[first], C, basis.target).max()
        most[first] = np.inf  # the bound of the best one may round to less than its gain
        worth = np.flatnonzero(most >= least)
        return int(worth[np.argmax(_gains(blocks[worth], C, basis.target))])

    chosen = start.tolist()
    while len(chosen) < count:
        chosen.append(best(chosen))
    least = _cost(basis.known + information(blocks[chosen]), basis)
    k, unchanged = 0, 0
    while unchanged < len(chosen):
        others = chosen[:k] + chosen[k + 1 :]
        trial = [*chosen[:k], best(others, chosen[k]), *chosen[k + 1 :]]
        cost = _cost(basis.known + information(blocks[trial]), basis) if trial != chosen else least
        # By the cost, not the gain: without one of few poses little is known, and rounding would go in circles.
        if cost < least - _LEAST_GAIN * (1.0 if basis.target is None else abs(least)):
            chosen, least, unchanged = trial, cost, 0
        else:
            unchanged += 1
        k = (k + 1) % len(chosen)
    return np.array(chosen, dtype=np.int_), least


def ranking(blocks: Array, basis: Basis) -> Array:
    """How much a design without end would lean on each candidate: its sensitivity there, shape (n,).

    The multiplicative algorithm (S. Silvey, D. Titterington, B. Torsney, 1978) moves the weights of candidates
    towards the optimal ones, w_i <- w_i s_i / mean(s); there, s is largest on the support.
    """
    n, rows, r = blocks.shape
    flat, power = blocks.reshape(-1, r), 1.0 if basis.target is None else 0.5
    s = weights = np.full(n, 1.0 / n)
    for _ in range(_RANKING_STEPS):
        information = (flat * np.repeat(weights, rows)[:, None]).T @ flat
        C = np.linalg.inv(information + _LEASH * np.eye(r))
        if basis.target is not None:
            # A target without zero directions has a root; products round.
            size = _LEASH * np.trace(basis.target)
            C = C @ (basis.target + size * np.eye(r)) @ C
            C = 0.5 * (C + C.T)
        root = np.linalg.cholesky(C)
        s = np.sum((flat @ root).reshape(n, -1) ** 2, axis=1)
        weights = weights * (s / (weights @ s)) ** power
        weights /= weights.sum()
    return s


def short_list(rank: Array, count: int) -> Indices:
    """The candidates with the largest values of `ranking`, in the pool's order."""
    return np.sort(np.argsort(-rank, kind="stable")[:count])


def _most(blocks: Array, C: NDArray[np.floating[Any]], target: Array | None) -> Array:
    """What adding each candidate gains at most, at a fifth of the price of `_gains`.

        det(I + G) <= (1 + tr G / d)^d,    tr((I + G)^-1 E) <= tr E

    Args:
        blocks: shape (n, d, r), the derivatives of the candidates along the basis.
        C: shape (r, r), the covariance of the design without them.
        target: shape (r, r), W or B, None for ``D``.

    Returns:
        shape (n,), in the unit of `_gains`.
    """
    n, d, r = blocks.shape
    K = C if target is None else C @ target @ C

    def work(block: slice) -> Array:
        """The traces of A K A^T of a part of the candidates A."""
        A = blocks[block].reshape(-1, r)
        return np.asarray(np.einsum("nk,nk->n", (A @ K).reshape(-1, d * r), A.reshape(-1, d * r)))

    trace = np.concatenate(over_blocks(work, n))
    return np.asarray((1.0 + trace / d) ** d if target is None else trace)


def _gains(blocks: Array, C: NDArray[np.floating[Any]], target: Array | None) -> Array:
    """What adding each candidate gains, shape (n,): det(I + G), or by how much tr(W C) falls."""
    n, d, r = blocks.shape
    both = C if target is None else np.hstack([C, C @ target @ C])
    # One product for G and E: their small matrices lie side by side, (n, d, 1 or 2, d).
    Y = (blocks.reshape(-1, r) @ both).reshape(n, -1, r)
    found = np.matmul(Y, blocks.transpose(0, 2, 1)).reshape(n, d, -1, d)
    known = np.eye(d) + found[:, :, 0]
    if target is None:
        return np.asarray(np.linalg.det(known))
    return np.asarray(np.trace(np.linalg.solve(known, found[:, :, 1]), axis1=1, axis2=2))


def _cost(M: Array, basis: Basis) -> float:
    """The criterion's value: less is better."""
    if basis.target is None:
        return -float(np.linalg.slogdet(M)[1])
    return float(np.trace(np.linalg.solve(M, basis.target)))
