"""Stations that do not agree with the others: not predicted by a fit to the others, or full of flagged rows.

A station is a place of an instrument, with one measurement frame. Let a fit to the rows of the other stations give the
parameters x with covariance C, for scalars whitened to variance 1. If nothing changed between stations, the residual
r = y - A x of this station has the covariance I + A C A^T, apart from what its own frame and target absorb.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.special import fdtrc

from calib.basics.arrays import Array, Mask
from calib.diagnosis.augmented_fit import FEWEST_FREEDOM
from calib.diagnosis.patterns import range_of
from calib.diagnosis.reasons import Reason, Why
from calib.fit.estimate.fitting import Fitted
from calib.fit.registration.labels import joined_stations
from calib.fit.selection.folds import seen_only_by
from calib.numerics.likelihood import GaussianPriors
from calib.numerics.repeats import pose_means

#: Probability that stations that do not differ give any finding; half a dozen stations are compared rarely.
_FALSE_ALARM = 0.01

#: A station is named only if its errors are this many times the noise: smaller ones do no harm.
_MATTERS = 1.5

#: Stations that are named, the surest first; the others follow from these.
_MOST_NAMED = 2

#: Flagged rows of a station below which single rows are off, not the station.
SOME_FLAGGED = 4

#: Share of a station's rows above which its flagged rows are no accidents.
_SHARE_FLAGGED = 0.25

#: How many times the share of flagged rows of the others that of a station must be.
_MORE_THAN_OTHERS = 3.0


def disagreeing_stations(fitted: Fitted) -> tuple[Reason, ...]:
    """Find the stations that a fit to the others does not predict.

    Args:
        fitted: A fit to the rows of all stations; each test fits its linearised problem again.

    Returns:
        A reason `Why.SETUP_UNPREDICTED` for each of the two surest such stations: the names of its groups, and its
        errors over those expected. Empty if all agree, if there is a single station, or if the fit has few degrees of
        freedom.
    """
    estimate, problem = fitted.estimate, fitted.estimate.problem
    station = joined_stations(problem.rows, fitted.task.distances)
    if station.max() < 1 or estimate.freedom < FEWEST_FREEDOM:
        return ()

    linear = problem.linear(estimate.x)
    noise = np.array([estimate.noise])
    noise_by_scalar = linear.noise_by_scalar(noise)[0]
    derivative = linear.A / noise_by_scalar[:, :, None]
    priors = GaussianPriors(problem.prior_precision, problem.prior_mean)
    counts = np.any(linear.used, axis=1) & (estimate.weights > 0.0)
    # Stations that only validation rows have are not among these.
    present = np.unique(station[counts])
    tests = []
    for number in present:
        inside = station == number
        # A fit without the station, at noise and priors of the fit to all rows, which also gives what only the station
        # determines.
        weights = np.where(inside, 0.0, problem.weights)
        fits = linear.fit(weights[None], problem.stop_shares, noise, priors)
        x, covariance, freedom = (values[0] for values in fits)
        station_only = seen_only_by(fitted, inside)
        x = np.where(station_only, estimate.x, x)
        residual = np.where(linear.used, linear.residual(x) / noise_by_scalar, 0.0)
        # About 1 if the model is complete.
        variance = float(weights @ np.sum(residual**2, axis=1)) / max(freedom, 1.0)

        # Repeats count for one measurement if they share what the model lacks.
        rows = inside & counts
        weights_inside, poses = problem.weights[rows], problem.rows.poses[rows]
        r, first = pose_means(residual[rows], weights_inside, poses)
        A, _ = pose_means(derivative[rows], weights_inside, poses)
        used = linear.used[rows][first]
        A = A[used]
        shared = ~station_only
        C = covariance[np.ix_(shared, shared)]
        square, degrees = prediction_square(r[used], A[:, shared], C, A[:, station_only])
        tests.append((square, degrees, variance, max(freedom, 0.0)))

    reasons = []
    for i, ratio in unpredicted(*np.array(tests).T)[:_MOST_NAMED]:
        name = _station_name(fitted, station == present[i])
        reasons.append(Reason.of(Why.SETUP_UNPREDICTED, setup=name, ratio=ratio))
    return tuple(reasons)


def unpredicted(
    squares: Array, freedoms: Array, noises: Array, noise_freedoms: Array
) -> list[tuple[int, float]]:
    """Find the stations whose errors exceed the noise, beyond chance and by the factor `_MATTERS`.

    Args:
        squares: Sum of squares of each of K stations, see `prediction_square`, shape (K,).
        freedoms: Its degrees of freedom, shape (K,).
        noises: Variance of a whitened scalar in the fit to the other stations, shape (K,).
        noise_freedoms: Degrees of freedom of that variance, shape (K,).

    Returns:
        Number, from 0, and ratio of errors to noise (no unit) of each such station, the surest first.
    """
    is_testable = (freedoms > 0.0) & (noise_freedoms > 0.0) & (noises > 0.0)
    testable = np.flatnonzero(is_testable)
    F = squares[testable] / freedoms[testable] / noises[testable]
    p = fdtrc(freedoms[testable], noise_freedoms[testable], F)
    sure = (p < _FALSE_ALARM / max(len(testable), 1)) & (F > _MATTERS**2)
    order = np.lexsort((-F, p))
    return [(int(testable[i]), float(np.sqrt(F[i]))) for i in order if sure[i]]


def prediction_square(r: Array, A: Array, covariance: Array, nuisance: Array) -> tuple[float, int]:
    """Sum the squares of a station's residual, in units of the uncertainty of its prediction.

    Args:
        r: Whitened residual, shape (M,): measured minus predicted by the fit to the others.
        A: Derivative of the prediction by parameters that the others determine, whitened, shape (M, p).
        covariance: Of these parameters, for scalars of variance 1, shape (p, p).
        nuisance: Whitened regressors of parameters that only this station has, shape (M, k).

    Returns:
        r^T W r with W the inverse of I + A C A^T, after projection on what is orthogonal to the nuisance; and its
        degrees of freedom, M minus the rank of the nuisance.
    """
    # The symmetric root of W is I + U ((1 + S^2)^(-1/2) - 1) U^T with A C^(1/2) = U S V^T, never made as a matrix.
    sizes, vectors = np.linalg.eigh(covariance)
    root_of_C = vectors * np.sqrt(np.maximum(sizes, 0.0))
    U, S, _ = np.linalg.svd(A @ root_of_C, full_matrices=False)
    change = 1.0 / np.sqrt(1.0 + S**2) - 1.0
    values = np.column_stack([r, nuisance])
    values = values + U @ (change[:, None] * (U.T @ values))

    residual = values[:, 0]
    base = range_of(values[:, 1:])
    remaining = residual - base @ (base.T @ residual)
    return float(remaining @ remaining), len(r) - base.shape[1]


def flagged_station(fitted: Fitted) -> Iterator[Reason]:
    """Find a station whose rows are flagged far more often than those of the others.

    Args:
        fitted: The fit to the rows of all stations.

    Yields:
        A reason `Why.SETUP_FLAGGED` for the first such station only: its name, the number of its rows, and how many are
        flagged. None if there is a single station.
    """
    flagged = fitted.estimate.outliers
    stations = joined_stations(fitted.estimate.problem.rows, fitted.task.distances)
    if stations.max() < 1:
        return
    for station in np.unique(stations):
        inside = stations == station
        count, share = int(flagged[inside].sum()), flagged[inside].mean()
        share_of_others = flagged[~inside].mean()
        limit = max(_SHARE_FLAGGED, _MORE_THAN_OTHERS * share_of_others)
        if count >= SOME_FLAGGED and share > limit:
            name = _station_name(fitted, inside)
            rows = int(np.sum(inside))
            yield Reason.of(Why.SETUP_FLAGGED, flagged=count, rows=rows, setup=name)
            return


def _station_name(fitted: Fitted, rows: Mask) -> str:
    """Name a station by the groups of its rows (N,), in their order, such as ``"1 and 2"``."""
    frames = fitted.estimate.problem.rows.samples.frame[rows]
    names = [fitted.setup.groups[frame] for frame in frames]
    return " and ".join(dict.fromkeys(names))
