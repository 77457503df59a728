"""Whether the order of the rows matters: the gain by lost motion against the gain that shuffled orders bring.

Errors that depend on a joint's last move are determined by the order in which the poses were measured. If it does not
matter, any other order explains the residuals as well. Evidence alone does not show this if residuals are not white
noise: what a joint does at random reaches all rows through the same arm. So a model with such errors is believed only
if the measured order beats every one of `_ORDERS` orders drawn at random: a permutation test, whose level is about
1 / (`_ORDERS` + 1) whatever the noise, if the poses were not ordered by what disturbs them.

With whitened columns F of these errors, B of all other parameters, and the residual r, the gain in log-likelihood by
errors with prior standard deviations s is, with everything projected off B,

    gain = 1/2 b^T (S + s^-2)^-1 b - 1/2 log det(1 + s S s),    S = F^T F,  b = F^T r
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.basics.arrays import Array, Mask
from calib.fit.estimate.fitting import Fitted
from calib.fit.registration.labels import same_poses
from calib.model.families import family_of
from calib.numerics.moves import last_moves
from calib.numerics.solvers import triangle

#: Orders drawn at random: one in fifty beats all of them by chance.
_ORDERS = 49

#: Seed of these orders.
_SEED = 0

#: Prior standard deviations that are tried, in estimated ones: each order has the one that suits it best.
_SCALES = 2.0 ** np.arange(-4, 3)


def order_matters(fitted: Fitted, families: tuple[str, ...]) -> bool:
    """Return whether the measured order explains the residuals better than every order drawn at random.

    Arrivals are shuffled, not rows: rows of one pose with one last move, such as those of several targets, stay
    together, and a pose that was reached from both sides is two arrivals.

    Args:
        fitted: Fit of a model with such errors.
        families: Names of the families whose errors depend on the last moves.
    """
    problem = fitted.estimate.problem
    model = fitted.kinematics.model
    of_order = model.family(*families)
    prior_std = []
    for parameter in model.parameters:
        if parameter.family in families:
            estimated = fitted.estimate.prior_std.get(parameter.family)
            prior_std.append(estimated or family_of(parameter.family).prior)
    # The residual is that without these errors, all of which is then to be gained.
    x = np.where(of_order, 0.0, fitted.estimate.x)

    def gain(moves: Array) -> float:
        """Return the gain in log-likelihood if these were the last moves, (N, m) [rad] or [m]."""
        rows = problem.rows
        moved = replace(rows, samples=replace(rows.samples, moves=moves))
        residual, jacobian = problem.with_rows(moved).system(x)
        return _gain(np.column_stack([jacobian, residual]), of_order, np.array(prior_std))

    samples = problem.rows.samples
    assert samples.moves is not None
    labels = same_poses(np.hstack([samples.q, samples.moves]))
    leaders, arrival = np.unique(labels, return_inverse=True)
    q = samples.q[leaders]
    measured = gain(samples.moves)
    rng = np.random.default_rng(_SEED)
    for _ in range(_ORDERS):
        order = rng.permutation(len(q))
        moves = np.empty(q.shape)
        moves[order] = last_moves(q[order])
        if not measured > gain(moves[arrival]):
            return False
    return True


def _gain(system: Array, of_order: Mask, prior_std: Array) -> float:
    """Return the gain in log-likelihood by some of the p parameters of a whitened system [J r], (rows, p + 1).

    They are True in (p,), and have these prior standard deviations, times that of `_SCALES` which suits best.
    """
    is_column = np.append(of_order, False)
    # Rows without an entry elsewhere are the priors of these parameters, in whose place `_SCALES` are tried.
    rows = system[np.any(system[:, ~is_column] != 0.0, axis=1)]
    F, B, r = rows[:, is_column], rows[:, :-1][:, ~of_order], rows[:, -1:]
    # The last rows and columns of the triangle are F and r, projected off B.
    R = triangle(np.column_stack([B, F, r]))
    below = B.shape[1]
    F, r = R[below:, below:-1], R[below:, -1]
    S, b = F.T @ F, F.T @ r
    best = 0.0
    for scale in _SCALES:
        std = scale * prior_std
        shrunk = np.eye(len(std)) + std[:, None] * S * std
        _, log_det = np.linalg.slogdet(shrunk)
        scaled = std * b
        best = max(best, 0.5 * float(scaled @ np.linalg.solve(shrunk, scaled) - log_det))
    return best
