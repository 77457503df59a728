"""Set-ups that do not agree: those that a fit to the others does not predict, and those whose rows are flagged."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calib.diagnosis.patterns import prediction_square, unpredicted
from calib.diagnosis.reasons import Reason, Why
from calib.estimate.fitting import Fitted
from calib.numerics.likelihood import GaussianPriors
from calib.numerics.repeats import pose_means
from calib.registration.known_distances import joined_stations
from calib.selection.held_out import seen_only_by
from calib.units import Mask

#: With fewer degrees of freedom set-ups are not compared.
_FEWEST_FREEDOM = 10.0

#: The fewest flagged rows that show that a set-up is off, not single rows,
SOME_FLAGGED = 4

#: and the smallest share of its rows.
_SHARE_FLAGGED = 0.25


def disagreeing_stations(fitted: Fitted) -> tuple[Reason, ...]:
    """Find the set-ups that a fit to the others does not predict, the two surest of them."""
    estimate, problem, rows = fitted.estimate, fitted.estimate.problem, fitted.estimate.problem.rows
    labels = joined_stations(rows, fitted.task.distances)
    if labels.max() < 1 or estimate.freedom < _FEWEST_FREEDOM:
        return ()
    linear, of_fit = problem.linear(estimate.x), np.array([estimate.noise])
    priors, noise = GaussianPriors(problem.precision, problem.centre), linear.noise_of(of_fit)[0]
    counts = np.any(linear.used, axis=1) & (estimate.weights > 0.0)
    # Set-ups that only validation rows have are not among these.
    present = np.unique(labels[counts])
    tests = []
    for own in (labels == g for g in present):
        weights = np.where(own, 0.0, problem.weights)
        x, covariance, freedom = (
            f[0] for f in linear.fit(weights[None], problem.rho, of_fit, priors)
        )
        loose = seen_only_by(fitted, own)
        x = np.where(loose, estimate.x, x)
        rest = np.where(linear.used, linear.residual(x) / noise, 0.0)
        # Repeats count for one measurement where they share what the model lacks.
        chosen = own & counts
        at, alike = problem.weights[chosen], rows.poses[chosen]
        r, first = pose_means(rest[chosen], at, alike)
        A, _ = pose_means((linear.A / noise[:, :, None])[chosen], at, alike)
        there = linear.used[chosen][first]
        A, C = A[there], covariance[np.ix_(~loose, ~loose)]
        square, degrees = prediction_square(r[there], A[:, ~loose], C, A[:, loose])
        variance = float(weights @ np.sum(rest**2, axis=1)) / max(freedom, 1.0)
        tests.append((square, degrees, variance, max(freedom, 0.0)))
    return tuple(
        Reason.of(
            Why.SETUP_UNPREDICTED, setup=_setup_name(fitted, labels == present[i]), ratio=ratio
        )
        for i, ratio in unpredicted(*np.array(tests).T)[:2]
    )


def _setup_name(fitted: Fitted, own: Mask) -> str:
    """The groups of some rows."""
    frames = fitted.estimate.problem.rows.samples.frame[own]
    return " and ".join(dict.fromkeys(fitted.setup.groups[f] for f in frames))


def flagged_station(fitted: Fitted) -> Iterator[Reason]:
    """Find a set-up whose rows are flagged far more often than the others': it has moved, they have not."""
    flagged = fitted.estimate.outliers
    labels = joined_stations(fitted.estimate.problem.rows, fitted.task.distances)
    for g in np.unique(labels) if labels.max() > 0 else ():
        own = labels == g
        count, inside, others = int(flagged[own].sum()), flagged[own].mean(), flagged[~own].mean()
        if count >= SOME_FLAGGED and inside > max(_SHARE_FLAGGED, 3.0 * others):
            name = _setup_name(fitted, own)
            yield Reason.of(Why.SETUP_FLAGGED, flagged=count, rows=int(np.sum(own)), setup=name)
            return
