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

from calib.basics.arrays import Array, Integers, Mask
from calib.diagnosis.patterns import range_of
from calib.diagnosis.reasons import Reason, Why
from calib.fit.estimate.fitting import Fitted
from calib.fit.estimate.linear import LinearProblem
from calib.fit.registration.known_distances import joined_stations
from calib.fit.selection.held_out import seen_only_by
from calib.numerics.likelihood import GaussianPriors
from calib.numerics.repeats import pose_means

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

    @property
    def noise_by_scalar(self) -> Array:
        """Noise of each scalar, in units of its given sigma, shape (N, D)."""
        return np.asarray(self.linear.noise_by_scalar(self.noise)[0])

    def test(self, station: int) -> tuple[float, float, float, float]:
        """Predict a station from the others.

        Args:
            station: Its number.

        Returns:
            The arguments of `unpredicted` for it: sum of squares of its residual in units of its uncertainty, the
            degrees of freedom of this sum, the variance of a whitened scalar in the fit to the others, and its
            degrees of freedom.
        """
        inside = self.station == station
        others = self._fit_to_others(inside)
        square, degrees = self._square(inside & self.counts, others)
        return square, degrees, others.variance, max(others.freedom, 0.0)

    def _fit_to_others(self, inside: Mask) -> _FitToOthers:
        """Fit the linearised problem without a station, at noise and priors of the fit to all rows.

        Args:
            inside: True for the rows of the station, shape (N,).
        """
        estimate = self.fitted.estimate
        problem = estimate.problem
        weights = np.where(inside, 0.0, problem.weights)
        priors = GaussianPriors(problem.prior_precision, problem.prior_mean)
        fits = self.linear.fit(weights[None], problem.stop_shares, self.noise, priors)
        x, covariance, freedom = (values[0] for values in fits)
        station_only = seen_only_by(self.fitted, inside)
        x = np.where(station_only, estimate.x, x)
        whitened = self.linear.residual(x) / self.noise_by_scalar
        return _FitToOthers(
            weights=weights,
            residual=np.where(self.linear.used, whitened, 0.0),
            covariance=covariance,
            freedom=freedom,
            station_only=station_only,
        )

    def _square(self, rows: Mask, others: _FitToOthers) -> tuple[float, int]:
        """Sum the squares of a station's residual over its uncertainty, and count its degrees of freedom.

        Args:
            rows: True for the rows of the station that count, shape (N,).
            others: The fit to the other stations.

        Returns:
            The sum of squares, in units of the uncertainty of the prediction, and its degrees of freedom.
        """
        problem = self.fitted.estimate.problem
        derivative = (self.linear.A / self.noise_by_scalar[:, :, None])[rows]
        # Repeats count for one measurement where they share what the model lacks.
        weights, poses = problem.weights[rows], problem.rows.poses[rows]
        r, first = pose_means(others.residual[rows], weights, poses)
        A, _ = pose_means(derivative, weights, poses)
        used = self.linear.used[rows][first]
        A = A[used]
        shared = ~others.station_only
        C = others.covariance[np.ix_(shared, shared)]
        return prediction_square(r[used], A[:, shared], C, A[:, others.station_only])


@dataclass(frozen=True, slots=True, eq=False)
class _FitToOthers:
    """A fit to the N rows without those of one station; up to D scalars a row, p parameters."""

    #: (N,), weights of the rows; 0 at the station
    weights: Array
    #: (N, D), whitened residual of all rows, measured minus predicted; 0 where nothing was measured
    residual: Array
    #: (p, p), covariance of the parameters, for scalars of variance 1
    covariance: Array
    #: Degrees of freedom that it leaves for the noise
    freedom: float
    #: (p,), True for the parameters of frames and targets that only the station sees: those of the fit to all rows
    station_only: Mask

    @property
    def variance(self) -> float:
        """Variance of a whitened scalar about this fit: about 1 where the model is complete."""
        square_by_row = np.sum(self.residual**2, axis=1)
        return float(self.weights @ square_by_row) / max(self.freedom, 1.0)


def unpredicted(
    squares: Array,
    freedoms: Array,
    noises: Array,
    noise_freedoms: Array,
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
    values = _over_uncertainty(np.column_stack([r, nuisance]), A, covariance)
    residual = values[:, 0]
    base = range_of(values[:, 1:])
    remaining = residual - base @ (base.T @ residual)
    return float(remaining @ remaining), len(r) - base.shape[1]


def _over_uncertainty(values: Array, A: Array, covariance: Array) -> Array:
    """Multiply by the symmetric root of W, the inverse of I + A C A^T.

    With A C^(1/2) = U S V^T this root is I + U ((1 + S^2)^(-1/2) - 1) U^T, never made as a matrix.

    Args:
        values: Columns to multiply, shape (M, k).
        A: Shape (M, p).
        covariance: C, shape (p, p), symmetric and positive semidefinite.

    Returns:
        The products, shape (M, k).
    """
    sizes, vectors = np.linalg.eigh(covariance)
    root_of_C = vectors * np.sqrt(np.maximum(sizes, 0.0))
    U, S, _ = np.linalg.svd(A @ root_of_C, full_matrices=False)
    change = 1.0 / np.sqrt(1.0 + S**2) - 1.0
    return np.asarray(values + U @ (change[:, None] * (U.T @ values)))


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
        share_elsewhere = flagged[~inside].mean()
        limit = max(_SHARE_FLAGGED, _MORE_THAN_ELSEWHERE * share_elsewhere)
        if count >= SOME_FLAGGED and share > limit:
            name = _station_name(fitted, inside)
            rows = int(np.sum(inside))
            yield Reason.of(Why.SETUP_FLAGGED, flagged=count, rows=rows, setup=name)
            return


def _station_name(fitted: Fitted, rows: Mask) -> str:
    """Name a station by the groups of its rows, in their order, such as ``"1 and 2"``.

    Args:
        fitted: The fit to N rows.
        rows: True for the rows of the station, shape (N,).
    """
    frames = fitted.estimate.problem.rows.samples.frame[rows]
    names = [fitted.setup.groups[frame] for frame in frames]
    return " and ".join(dict.fromkeys(names))
