"""Stations that do not agree with the others: not predicted by a fit to the others, or full of flagged rows.

A station is a place of an instrument, with one measurement frame. Let a fit to the rows of the other stations give the
parameters x with covariance C, for scalars whitened to variance 1. If nothing changed between stations, the residual
r = y - A x of this station has the covariance I + A C A^T, apart from what its own frame and target absorb.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc

from calib.diagnosis.patterns import range_of
from calib.diagnosis.reasons import Reason, Why
from calib.estimate.fitting import Fitted
from calib.estimate.linear import LinearProblem
from calib.numerics.likelihood import GaussianPriors
from calib.numerics.repeats import pose_means
from calib.registration.known_distances import joined_stations
from calib.selection.held_out import seen_only_by
from calib.units import Array, Integers, Mask

#: Degrees of freedom of a fit below which its stations are not compared: its noise is not known well enough.
_FEWEST_FREEDOM = 10.0

#: Probability that stations that do not differ give any finding; half a dozen stations are compared rarely.
_FALSE_ALARM = 0.01

#: A station is named only where its errors are this many times the noise: smaller ones do no harm.
_MATTERS = 1.5

#: Stations that are named, the surest first; the others follow from these.
_MOST_NAMED = 2

#: Flagged rows of a station below which single rows are off, not the station.
SOME_FLAGGED = 4

#: Share of a station's rows above which its flagged rows are no accidents.
_SHARE_FLAGGED = 0.25

#: How many times the share of flagged rows elsewhere that of a station must be.
_MORE_THAN_ELSEWHERE = 3.0


def disagreeing_stations(fitted: Fitted) -> tuple[Reason, ...]:
    """Find the stations that a fit to the others does not predict.

    Args:
        fitted: A fit to the rows of all stations; each test fits its linearised problem again.

    Returns:
        A reason `Why.SETUP_UNPREDICTED` for each of the two surest stations: the names of its groups, and its errors
        over those expected. None if there is a single station or the fit has few degrees of freedom.
    """
    station = joined_stations(fitted.estimate.problem.rows, fitted.task.distances)
    if station.max() < 1 or fitted.estimate.freedom < _FEWEST_FREEDOM:
        return ()
    comparison = _Comparison.of(fitted, station)
    # Stations that only validation rows have are not among these.
    present = np.unique(station[comparison.counts])
    tests = np.array([comparison.test(number) for number in present])
    reasons = []
    for i, ratio in unpredicted(*tests.T)[:_MOST_NAMED]:
        name = _station_name(fitted, station == present[i])
        reasons.append(Reason.of(Why.SETUP_UNPREDICTED, setup=name, ratio=ratio))
    return tuple(reasons)


@dataclass(frozen=True, slots=True, eq=False)
class _Comparison:
    """A fit to N rows of up to D scalars whose stations are compared; p parameters."""

    #: The fit to all rows
    fitted: Fitted
    #: The problem linearised there
    linear: LinearProblem
    #: (1, C), noise of each instrument over its sigma, as estimated by the fit
    noise: Array
    #: (N,), number of each row's station; those that known distances join are one
    station: Integers
    #: (N,), rows with a weight and a measured scalar
    counts: Mask

    @classmethod
    def of(cls, fitted: Fitted, station: Integers) -> _Comparison:
        """Linearise a fit.

        Args:
            fitted: The fit to N rows.
            station: Number of each row's station, shape (N,).
        """
        estimate = fitted.estimate
        linear = estimate.problem.linear(estimate.x)
        return cls(
            fitted=fitted,
            linear=linear,
            noise=np.array([estimate.noise]),
            station=station,
            counts=np.any(linear.used, axis=1) & (estimate.weights > 0.0),
        )

    def test(self, station: int) -> tuple[float, float, float, float]:
        """Predict a station from the others.

        Args:
            station: Its number.

        Returns:
            The arguments of `unpredicted` for it: sum of squares of its residual in units of its uncertainty, the
            degrees of freedom of this sum, the variance of a whitened scalar in the fit to the others, and its
            degrees of freedom.
        """
        problem = self.fitted.estimate.problem
        inside = self.station == station
        weights = np.where(inside, 0.0, problem.weights)
        priors = GaussianPriors(problem.precision, problem.centre)
        fits = self.linear.fit(weights[None], problem.rho, self.noise, priors)
        x, covariance, freedom = (values[0] for values in fits)
        station_only = seen_only_by(self.fitted, inside)
        x = np.where(station_only, self.fitted.estimate.x, x)
        scale = self.linear.noise_by_scalar(self.noise)[0]
        residual = np.where(self.linear.used, self.linear.residual(x) / scale, 0.0)
        square, degrees = self._square(inside & self.counts, residual, covariance, station_only)
        variance = float(weights @ np.sum(residual**2, axis=1)) / max(freedom, 1.0)
        return square, degrees, variance, max(freedom, 0.0)

    def _square(
        self, rows: Mask, residual: Array, covariance: Array, station_only: Mask
    ) -> tuple[float, int]:
        """Sum of squares of a station's residual over its own uncertainty, and its degrees of freedom.

        Args:
            rows: Its rows that count, shape (N,).
            residual: Whitened residual of all rows with the parameters of the fit to the others, shape (N, D).
            covariance: Of these parameters, shape (p, p), for scalars of variance 1.
            station_only: Parameters of frames and targets that no other station sees, shape (p,).
        """
        problem = self.fitted.estimate.problem
        scale = self.linear.noise_by_scalar(self.noise)[0]
        derivative = (self.linear.A / scale[:, :, None])[rows]
        # Repeats count for one measurement where they share what the model lacks.
        weights, poses = problem.weights[rows], problem.rows.poses[rows]
        r, first = pose_means(residual[rows], weights, poses)
        A, _ = pose_means(derivative, weights, poses)
        used = self.linear.used[rows][first]
        A = A[used]
        C = covariance[np.ix_(~station_only, ~station_only)]
        return prediction_square(r[used], A[:, ~station_only], C, A[:, station_only])


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
        Number, from 0, and ratio of errors to noise of each such station, the surest first.
    """
    testable = np.flatnonzero((freedoms > 0.0) & (noise_freedoms > 0.0) & (noises > 0.0))
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
    # A symmetric root of W: with A C^(1/2) = U S V^T it is I + U ((1 + S^2)^(-1/2) - 1) U^T, never made as a matrix.
    sizes, vectors = np.linalg.eigh(covariance)
    moved = A @ (vectors * np.sqrt(np.maximum(sizes, 0.0)))
    U, S, _ = np.linalg.svd(moved, full_matrices=False)
    values = np.column_stack([r, nuisance])
    values = values + U @ ((1.0 / np.sqrt(1.0 + S**2) - 1.0)[:, None] * (U.T @ values))
    base = range_of(values[:, 1:])
    remaining = values[:, 0] - base @ (base.T @ values[:, 0])
    return float(remaining @ remaining), len(r) - base.shape[1]


def flagged_station(fitted: Fitted) -> Iterator[Reason]:
    """Find a station whose rows are flagged far more often than those of the others.

    Args:
        fitted: The fit to the rows of all stations.

    Yields:
        A reason `Why.SETUP_FLAGGED` for the first such station: its rows, and how many are flagged.
    """
    flagged = fitted.estimate.outliers
    stations = joined_stations(fitted.estimate.problem.rows, fitted.task.distances)
    if stations.max() < 1:
        return
    for station in np.unique(stations):
        inside = stations == station
        count, share = int(flagged[inside].sum()), flagged[inside].mean()
        limit = max(_SHARE_FLAGGED, _MORE_THAN_ELSEWHERE * flagged[~inside].mean())
        if count >= SOME_FLAGGED and share > limit:
            name, rows = _station_name(fitted, inside), int(np.sum(inside))
            yield Reason.of(Why.SETUP_FLAGGED, flagged=count, rows=rows, setup=name)
            return


def _station_name(fitted: Fitted, rows: Mask) -> str:
    """Name a station by the groups of its rows, a mask of shape (N,)."""
    frames = fitted.estimate.problem.rows.samples.frame[rows]
    return " and ".join(dict.fromkeys(fitted.setup.groups[frame] for frame in frames))
