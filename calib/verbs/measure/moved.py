"""Has something moved since a stop, or is a single stop far off? By all stops so far, as each one is added.

A target may have been knocked, or the base or the instrument stand elsewhere, from a stop on; or one reading is gross,
which may show only now that later stops tell what it should have been.

At the solution of the fit, with residuals r in units of their stated sigma, the derivative A by the parameters and
their priors P, a displacement u from stop k on adds E_k u to what is predicted. It lowers the sum Q of the squares by

    R_k = h^T (E_k^T E_k - D^T M^-1 D)^-1 h,    M = A^T A + P,  D = A^T E_k,  h = E_k^T r - D^T M^-1 g,

g = A^T r less the pull of the priors; a stop that is off alone has the displacement of its targets there. If nothing
has moved, R_k / (c s^2) follows F(c, nu - c) with the c numbers of u
that show and s^2 = (Q - R_k) / (nu - c): a displacement that the fit took for noise counts too. Sums from stop k to the
last one give all k at once. Two explanations are compared by their likelihood with the noise not known,
nu log (Q - R_k), with log n for each of their c numbers (G. Schwarz, 1978).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from scipy.special import fdtri

from calib.basics.arrays import Array
from calib.basics.values import Value
from calib.model.error_model import ErrorModel
from calib.model.kinematics import Kinematics
from calib.model.parameter_sets import DIRECTIONS, error_model
from calib.verbs.measure.running_fit import RunningFit

#: Probability with which a session in which nothing moves says at a stop that something has.
_FALSE_ALARM = 1e-4

#: Degrees of freedom of the noise from which on a displacement can be told.
_ENOUGH_FREEDOM = 6.0

#: Squares that a displacement explains at each stop before or after it, whichever are fewer: 4 standard deviations.
_EACH = 16.0

#: By how much -2 log of the likelihood of one explanation has to be less than another's for it to be named alone.
_DECIDED = 12.0

#: Median of chi-square over its degrees of freedom, of six.
_MEDIAN = 0.89

#: Least share of the squares that an explanation leaves.
_TINY = 1e-9

#: Directions of a displacement that show less than this share of what shows best are not seen.
_SEEN = 1e-6

#: Of a displacement whose whole information is 1, directions with less than this beside the parameters do not show.
_SHOWN = 1e-5


#: What may have moved.
What = Literal["target", "base", "stop"]


@dataclass(frozen=True, slots=True, eq=False)
class Moved(Value):
    """A displacement from a stop on, or at one stop alone."""

    #: What has moved; ``"stop"``: the targets at one stop alone
    what: What
    #: Name of the target, or of the station; empty for a stop
    name: str
    #: Index of the first stop after it, or of the stop, from 0
    first: int
    #: R_k over the noise: the squares that it explains
    gain: float
    #: -2 log of its likelihood: the least is the best explanation
    cost: float


def find_moved(fit: RunningFit, factor: float, first: int) -> tuple[Moved, ...]:
    """Find a displacement in the stops of a fit.

    Args:
        fit: The fit, to the stops in the order of their measurement.
        factor: Mean square of stops that are good, see `calib.verbs.measure.row_check.History`.
        first: Index of the first stop before which something may have moved, from 0.

    Returns:
        The likeliest explanation of each kind that is significant, the best first; () if nothing has moved. One alone
        if it is better than the others by far.
    """
    scans = [*_scans(fit)]
    of_pictures = bool(fit.rows.is_image.all())
    if of_pictures and fit.count <= first:
        return ()
    # Of the fit, with which others that are far off have no part.
    of_fit = float(np.mean(np.square(fit.fitted.estimate.noise)))
    least = _noise_of_places(scans[-1][2]) if of_pictures else 0.0
    found = []
    for what, name, scan in scans:
        for k, (gain, numbers, square, freedom) in enumerate(scan):
            left = freedom - numbers
            if (k < first and what != "stop") or not numbers or left < _ENOUGH_FREEDOM:
                continue
            noise = max(min(max(square - gain, 0.0) / left, of_fit), least) * factor
            limit = numbers * fdtri(numbers, left, 1.0 - _FALSE_ALARM / len(scan))
            if what != "stop":  # what the model lacks is alike in neighbouring poses, and small
                limit = max(limit, _EACH * min(k, len(scan) - k))
            if gain > limit * noise:
                cost = numbers * np.log(fit.rows.count)
                if of_pictures:  # many corners tell the noise
                    cost -= gain / noise
                else:
                    cost += freedom * np.log(max(square - gain, _TINY * square))
                found.append(Moved(what, name, k, gain / noise, float(cost)))
    best: dict[tuple[str, str, int], Moved] = {}
    for moved in sorted(found, key=lambda moved: moved.cost):
        # Each stop alone is an explanation of its own; of what moved, each place is.
        best.setdefault((moved.what, moved.name, moved.first if moved.what == "stop" else 0), moved)
    ranked = tuple(best.values())
    return tuple(moved for moved in ranked if moved.cost <= ranked[0].cost + _DECIDED)


@dataclass(frozen=True, slots=True, eq=False)
class LinearFit(Value):
    """A fit linearised at its solution, with errors of the robot as before any row."""

    #: Shape (N D, p), A
    A: Array
    #: Shape (N D,), r
    r: Array
    #: Shape (p, p), M^-1
    inverse: Array
    #: Shape (p,), g
    g: Array
    #: Q
    square: float
    #: nu
    freedom: float

    #: Of a column, a smaller share beside the parameters is rounding.
    ROUNDING: ClassVar[float] = 1e-9

    @classmethod
    def of(cls, fit: RunningFit) -> LinearFit:
        """Linearise a fit at its solution."""
        fitted, cell = fit.fitted, fit.fitted.task.cell
        estimate = fitted.estimate
        problem = estimate.problem
        linear = problem.linear(estimate.x)
        r = linear.residual(estimate.x).reshape(-1)
        # A fit that takes a displacement for noise makes errors of the robot too small.
        precision = np.array(problem.prior_precision)
        for k, parameter in enumerate(fitted.kinematics.model.parameters):
            is_own = parameter.name in cell.parameter_priors
            if parameter.family in estimate.prior_std and not is_own:
                precision[k] = 1.0 / cell.priors.of(parameter.family) ** 2
        pull = precision * (estimate.x - problem.prior_mean)
        A = linear.A.reshape(len(r), -1)
        M = A.T @ A + np.diag(precision)
        g = A.T @ r - pull
        scale = 1.0 / np.sqrt(np.maximum(np.diag(M), np.finfo(float).tiny))
        inverse = scale[:, None] * np.linalg.inv(M * np.outer(scale, scale)) * scale
        of_priors = precision * (estimate.x - problem.prior_mean) ** 2
        square = float(np.sum(r**2) + np.sum(of_priors) - g @ inverse @ g)
        freedom = float(fit.rows.used.sum() - np.trace(inverse @ A.T @ A))
        return cls(A, r, inverse, g, square, freedom)

    def beside(self, E: Array) -> tuple[Array, Array]:
        """Return h and E^T E - D^T M^-1 D of columns E (N D, c): what they explain, and tell, beside the parameters."""
        D = self.A.T @ E
        return E.T @ self.r - D.T @ self.inverse @ self.g, E.T @ E - D.T @ self.inverse @ D


def derivative_by(fit: RunningFit) -> tuple[ErrorModel, Array]:
    """Differentiate what is predicted by joints, stations and targets, (N, D, q), and return their q parameters."""
    fitted, rows = fit.fitted, fit.rows
    setup = fitted.setup
    model = error_model(
        fitted.task.robot,
        "zeros",
        frame=dict.fromkeys(setup.frame_unknowns, DIRECTIONS),
        target=dict.fromkeys(setup.target_names, DIRECTIONS),
        targets=setup.target_names,
    )
    now = fitted.estimated_setup()
    displaced = Kinematics(fitted.task.robot, model, now.T_frame_base, now.T_tip_target).linearised(
        np.zeros(len(model)), rows.samples
    )
    slopes = rows.standardise(rows.derivative(displaced))
    return model, np.where(rows.used[:, :, None], slopes, 0.0)


def _noise_of_places(scan: Sequence[tuple[float, int, float, float]]) -> float:
    """Return the mean square of what the place of a board explains in a picture, by the median over the pictures.

    An arm that does not repeat displaces all corners of a picture alike: they do not tell that noise.
    """
    shown = [gain / numbers for gain, numbers, *_ in scan if numbers]
    return float(np.median(shown)) / _MEDIAN if shown else 0.0


def _scans(
    fit: RunningFit,
) -> Iterator[tuple[What, str, list[tuple[float, int, float, float]]]]:
    """Yield what may have moved, and for its displacement from stop 0, 1, ... on, or there alone: R_k, c, Q and nu."""
    setup, stops = fit.fitted.setup, fit.stops
    linear = LinearFit.of(fit)
    inverse, g = linear.inverse, linear.g
    model, by_displacement = derivative_by(fit)
    of_rows = by_displacement.shape[:2]
    A, r = linear.A.reshape(*of_rows, -1), linear.r.reshape(of_rows)
    count = fit.count
    frames, targets = setup.places
    places: list[tuple[What, str, tuple[str, ...]]] = []
    places += [
        ("target", name, (place,)) for name, place in zip(setup.targets, targets, strict=True)
    ]
    places += [("base", name, (place,)) for name, place in zip(setup.groups, frames, strict=True)]
    places += [("stop", "", tuple(targets))]
    for what, name, of_place in places:
        columns = [k for k, parameter in enumerate(model.parameters) if parameter.place in of_place]
        E = by_displacement[:, :, columns]
        size = np.sqrt(np.sum(E**2, axis=(0, 1)))
        E = E[:, :, size > _SEEN * size.max()] / size[size > _SEEN * size.max()]
        c = E.shape[2]
        EE, AE, Er = np.zeros((count, c, c)), np.zeros((count, len(g), c)), np.zeros((count, c))
        for stop in range(count):
            of_stop = stops == stop
            e, a = E[of_stop].reshape(-1, c), A[of_stop].reshape(-1, len(g))
            EE[stop], AE[stop] = e.T @ e, a.T @ e
            Er[stop] = e.T @ r[of_stop].reshape(-1)
        if what != "stop":  # sums from each stop to the last one
            EE, AE, Er = (np.cumsum(part[::-1], axis=0)[::-1] for part in (EE, AE, Er))
        scan = []
        for k in range(count):
            D = AE[k]
            h = Er[k] - D.T @ inverse @ g
            S = EE[k] - D.T @ inverse @ D
            values, vectors = np.linalg.eigh(S)
            seen = values > _SHOWN * max(float(np.trace(EE[k])), 1.0 / count)
            along = vectors[:, seen].T @ h
            gain = float(np.sum(along**2 / values[seen]))
            scan.append((gain, int(seen.sum()), linear.square, linear.freedom))
        yield what, name, scan
