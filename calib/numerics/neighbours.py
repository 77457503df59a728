"""Rows of a moving arm that follow each other: their errors are correlated, so that they count as fewer rows.

Errors e_i of consecutive rows with the correlation rho_k between rows k apart tell as much as a share of independent
ones does,

    share = 1 / tau,    tau = 1 + 2 sum_k rho_k

the integrated time of the correlation: a mean of N rows has the variance tau sigma^2 / N, and so has each parameter if
its column changes more slowly than errors do. For errors that follow rho_k = phi^k it is tau = (1 + phi) / (1 - phi).
The sum ends where two neighbouring rho together are no longer above zero (C. J. Geyer: Practical Markov chain Monte
Carlo, 1992): beyond there it would add noise alone.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.basics.arrays import Array

#: Up to so many rows are counted as independent: with few rows the correlation is not known well enough, and tables of
#: single poses have no more.
MANY_ROWS = 10_000

#: A step is far shorter than a way if it is less than this share of it.
_NEAR = 0.1

#: A correlation of neighbours of less than so many standard deviations is chance, as which it is exceeded in one table
#: of 30,000. With `MANY_ROWS` it is then below 0.04: if it is real, and falls as phi^k, standard deviations are at most
#: 4 % too small.
_CERTAIN = 4.0


def along_path(q: Array) -> bool:
    """Return whether poses follow each other along a path, as those of a moving arm do.

    A usual step is far shorter than the way between two poses. Nor is it far shorter than the mean step, as where an
    arm stands and is measured many times before it drives on: such rows are repeats.

    Args:
        q: shape (N, m), joint values in the order of the rows [rad] or [m]; False for `MANY_ROWS` or less.
    """
    if len(q) <= MANY_ROWS:
        return False
    steps = np.abs(np.diff(q, axis=0)).max(axis=1)
    ways = np.abs(q[len(q) // 2 :] - q[: len(q) - len(q) // 2]).max(axis=1)
    usual = np.median(steps)
    return bool(_NEAR * np.mean(steps) < usual < _NEAR * np.median(ways))


def independent_share(runs: Sequence[tuple[Array, Array]]) -> float:
    """Estimate the share of rows that count, 1 / tau, from runs of consecutive rows.

    Args:
        runs: Of each run the errors of its n rows, shape (n, D), whose expectation is 0, and the weights of their
            squares, (n, D); 0 where nothing was measured.

    Returns:
        The share, above 0; 1 if neighbours are not correlated beyond chance.
    """
    longest = max(len(errors) for errors, _ in runs)
    lags = longest // 4
    products, counts = np.zeros(lags), np.zeros(lags)
    for errors, weights in runs:
        root = np.sqrt(weights)
        products += _products_at_lags(root * errors, lags)
        counts += _products_at_lags(root, lags)
    rho = (
        products * counts[0] / (products[0] * np.maximum(counts, 1.0))
        if products[0] > 0.0
        else products
    )
    if rho[1] * np.sqrt(counts[1]) < _CERTAIN:
        return 1.0
    pairs = rho[: lags // 2 * 2].reshape(-1, 2).sum(axis=1)
    ends = np.flatnonzero(pairs <= 0.0)
    last = int(ends[0]) if len(ends) else len(pairs)
    tau = 2.0 * float(np.sum(pairs[:last])) - 1.0
    return 1.0 / max(tau, 1.0)


def _products_at_lags(values: Array, lags: int) -> Array:
    """Return the sums of v_i v_(i + k), over rows and columns of values (n, D), for k from 0 to lags - 1."""
    spectrum = np.fft.rfft(values, 2 * len(values), axis=0)
    power = np.sum(np.abs(spectrum) ** 2, axis=1)
    sums = np.fft.irfft(power)[: min(lags, len(values))]
    return np.pad(sums, (0, lags - len(sums)))
