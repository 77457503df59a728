"""Sole postures: poses that alone determine a direction of the parameters, so that no other row can check them.

Let A_b be the derivative of what is predicted at a pose b, which has one row or several, in units of the noise. From
the other rows, and priors as wide as they are given, the prediction at b has the covariance

    K_b = A_b C A_b^T

where C is the covariance of the parameters estimated without b. Where the largest eigenvalue of K_b is far above 1, and
far above those of the other poses, b is a sole posture: because a joint moves there alone, say. Its leverage
K / (1 + K) is close to one (D. A. Belsley, E. Kuh, R. E. Welsch: Regression Diagnostics, 1980).

The other rows cannot show whether the measurement at such a pose is an outlier, and one pose is not a sample from which
to estimate a prior standard deviation. So the other rows o alone determine noise, prior standard deviations, and the
estimate x_o with its covariance C. Rows s of sole postures then move x_o along the directions that o leaves open:

    minimise  |r_s(x)|^2 / sigma^2 + |r_o(x) - r_o(x_o)|^2 / (epsilon sigma)^2 + |x - x_o|^2 / tau^2

with residuals r, noise sigma, prior standard deviations tau that are wide, and a small epsilon, which keeps what the
others determine. This is minimised by Gauss-Newton steps, not linearised once, because a single posture may need large
angles. With the gain G, the derivative of the solution by r_s,

    C <- (I - G A_s) C (I - G A_s)^T + sigma^2 G G^T

A row of a sole posture loses its weight only if r_s(x_o), along the open directions, is larger than wide priors allow.

The whole rule has two call sites: `fit` marks such rows before the estimate (`mark_sole_postures`), which leaves them
out (`Rows.checked`), and `estimate_with_priors` adds them to what came out (`add_sole_postures`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from calib.basics.arrays import Array, Integers, Mask, read_only
from calib.fit.estimate.estimate import Estimate
from calib.fit.estimate.linear import LinearProblem
from calib.fit.estimate.prior_terms import PriorTerms
from calib.fit.estimate.problem import Problem
from calib.fit.estimate.stages import Stage
from calib.fit.registration.rows import Rows
from calib.numerics.scores import Limits, point_scores
from calib.robot.kernel import over_blocks

#: A pose is a sole posture if the standard deviation of its prediction from the others is so many times the noise,
_UNPREDICTED = 10.0

#: and so many times that of the typical pose: if rows are too few, all are predicted badly.
_ABOVE_TYPICAL = 10.0

#: A frame or target that fewer scalars of other rows observe is not determined without the pose, whatever joints do.
_FEWEST_SCALARS = 18

#: A pose whose leverage is bounded by less than this is not a sole posture, and the bound stands for the leverage.
_WORTH_A_LOOK = 0.5

#: Leverages are below one; larger values are rounding.
_HIGHEST_LEVERAGE = 1.0 - 1e-9

#: Sole postures are judged with priors so many times as wide as given: as one sample each, they cannot be checked.
_WIDE = 3.0

#: The factor epsilon on the noise of the other rows, which keeps what they determine.
_NOISE_OF_OTHERS = 0.05

#: A direction is open where the standard deviation of its prediction is at least this share of the largest one.
_OPEN = 1.0 / 3.0

#: A rise of the residual's norm by less, as a share of it, is rounding: the order of the rows would decide on a step.
_ROUNDING = 1e-12

#: The most Gauss-Newton steps of an update.
_UPDATES = 20

#: A Gauss-Newton step shorter than this has converged [m, rad].
_SETTLED = 1e-9


def mark_sole_postures(problem: Problem, prior: PriorTerms) -> Problem:
    """Return the problem with the rows of sole postures marked, unless they are already.

    A sole posture is a pose that alone determines a direction of the parameters, so that the others predict it badly.
    The standard deviation of a pose's prediction from the other rows, over the noise, is sqrt(k / (1 - k)) with the
    pose's leverage k: the largest eigenvalue of A C A^T, where A is the Jacobian of its scalars and C the covariance of
    the parameters by all rows, at the first stage. Rows whose frame or target few rows of other poses observe are not
    marked.

    Args:
        problem: The least-squares problem before any estimate.
        prior: Priors as given, at whose means the problem is linearised.

    Returns:
        The problem whose ``rows.sole`` is the mask of these rows, shape (N,).
    """
    rows = problem.rows
    if rows.sole is not None:
        return problem
    linear = problem.linear(prior.mean)
    every_row = np.ones((1, len(rows)), dtype=bool)
    first = Stage.initial(prior, every_row, len(problem.smallest_noise))
    _, covariances, _ = first.fit(linear)
    covariance = covariances[0]
    block = np.unique(rows.blocks, return_inverse=True)[1].reshape(-1)

    def traces(part: slice) -> Array:
        """The trace of A_i C A_i^T of each row i of a part, which bounds its largest eigenvalue."""
        A = linear.A[part]
        return np.asarray(np.einsum("ndp,ndp->n", A @ covariance, A))

    # Bounds first: a pose whose bound is low needs no eigenvalues.
    leverage = np.bincount(block, np.concatenate(over_blocks(traces, len(linear))))
    for b in np.flatnonzero(leverage > _WORTH_A_LOOK).tolist():
        mask = block == b
        A = linear.A[mask][rows.used[mask]]
        leverage[b] = np.linalg.eigvalsh(A @ covariance @ A.T)[-1]
    leverage = np.clip(leverage, 0.0, _HIGHEST_LEVERAGE)
    unpredicted = np.sqrt(leverage / (1.0 - leverage))
    typical = float(np.median(unpredicted))
    is_sole = unpredicted > max(_UNPREDICTED, _ABOVE_TYPICAL * typical)
    sole = is_sole[block] & _seen_by_others(rows, block)
    return replace(problem, rows=replace(rows, sole=sole))


def add_sole_postures(estimate: Estimate, problem: Problem, stage: Stage) -> Estimate:
    """Update an estimate by the rows of sole postures, which had no part in it: poses that no other row can check.

    Such a row is weighted by its score: how far it lies from what wide priors predict, along the directions in which
    the other rows do not predict it.

    Args:
        estimate: The estimate by all other rows.
        problem: The least-squares problem, with its rows of sole postures marked.
        stage: State of the estimate's fit (B = 1) as it settled.

    Returns:
        The estimate with parameters and covariance by all rows, and the scores and weights of the rows of sole postures
        set; itself if there are none. Noise and prior standard deviations stay.
    """
    sole = ~problem.rows.checked
    if not np.any(sole):
        return estimate
    linear = problem.linear(estimate.x)
    projections = _open_directions(linear, stage, sole)
    scores_of_sole = _open_scores(linear, estimate.x, stage, projections)
    scores = np.where(sole, scores_of_sole, estimate.scores)
    by_scores = Limits.of(len(sole), estimate.freedom).weights(scores)
    weights_of_sole = np.where(sole, by_scores, 0.0)

    update = _Update.of(linear, stage, weights_of_sole, projections)
    linear = update.solved(problem.linear)
    A = update.derivative(linear)
    scalars_of_a_row = update.reference.shape[1]
    of_sole = np.flatnonzero(np.repeat(weights_of_sole > 0.0, scalars_of_a_row))
    gain = np.asarray(np.linalg.pinv(A)[:, of_sole])
    x = read_only(linear.x)
    return replace(
        estimate,
        x=x,
        solution=replace(estimate.solution, x=x),
        covariance=read_only(_joseph_update(estimate.covariance, gain, A[of_sole])),
        scores=read_only(scores),
        weights=read_only(np.where(sole, by_scores, estimate.weights)),
    )


def _seen_by_others(rows: Rows, block: Integers) -> Mask:
    """Rows, (N,), whose frame and target are determined by rows of other poses, numbered by ``block``, (N,)."""
    scalars = np.sum(rows.used, axis=1)
    result = np.ones(len(rows), dtype=bool)
    for places in (rows.samples.frame, rows.samples.target):
        pairs = np.column_stack([places, block])
        pair = np.unique(pairs, axis=0, return_inverse=True)[1].reshape(-1)
        others = np.bincount(places, scalars)[places] - np.bincount(pair, scalars)[pair]
        result &= others >= _FEWEST_SCALARS
    return result


def _with_wide_priors(stage: Stage) -> Stage:
    """Return a stage with the prior std of families `_WIDE` times as given, or as estimated if that is wider still."""
    start = np.array(stage.prior.start, dtype=np.float64)
    return replace(stage, prior_std=np.maximum(stage.prior_std, _WIDE * start))


def _wide_covariance(linear: LinearProblem, stage: Stage) -> Array:
    """Covariance of the parameters, (p, p), by one linear fit (B = 1) with wide priors."""
    _, covariances, _ = _with_wide_priors(stage).fit(linear)
    covariance: Array = covariances[0]
    return covariance


def _open_directions(linear: LinearProblem, stage: Stage, sole: Mask) -> Array:
    """Find the directions of their scalars in which other rows and wide priors do not predict sole postures, (N,).

    They are the eigenvectors of the covariance of the prediction, in units of the noise, whose standard deviation is at
    least a share (`_OPEN`) of the largest. Returned is the orthogonal projection of a row's scalars on them,
    (N, D, D); of all other rows the identity.
    """
    covariance = _wide_covariance(linear, stage)
    noise = linear.noise_by_scalar(stage.noise)[0]
    result = np.tile(np.eye(noise.shape[1]), (len(linear), 1, 1))
    for i in np.flatnonzero(sole).tolist():
        A = linear.A[i] / noise[i][:, None]
        variances, vectors = np.linalg.eigh(A @ covariance @ A.T)
        wide = vectors[:, variances >= _OPEN**2 * np.max(variances)]
        result[i] = wide @ wide.T
    return result


def _open_scores(linear: LinearProblem, x: Array, stage: Stage, projections: Array) -> Array:
    """Score, (N,), how far rows of sole postures lie from what wide priors predict, along the open directions.

    With the projection P of a row's scalars, the residual r (measured minus predicted) and the Jacobian A in units of
    the noise, and the covariance C of the parameters by wide priors, the squared score is
    r^T P (I + P A C A^T P)^-1 P r, converted from the rank of P to three degrees of freedom. The fit (B = 1) is at the
    parameters x, (p,); the projections are those of `_open_directions`, (N, D, D).
    """
    covariance = _wide_covariance(linear, stage)
    noise = linear.noise_by_scalar(stage.noise)[0]
    residual = projections @ (linear.residual(x) / noise)[:, :, None]
    A = projections @ (linear.A / noise[:, :, None])
    predicted = np.eye(noise.shape[1]) + A @ covariance @ A.swapaxes(1, 2)
    # By eigenvalues, which are at least 1: of a fit that is far off, rounding would make the matrix singular.
    variances, vectors = np.linalg.eigh(predicted)
    along = vectors.swapaxes(1, 2) @ residual
    squares = np.sum(along[:, :, 0] ** 2 / np.maximum(variances, 1.0), axis=1)
    directions = np.rint(np.trace(projections, axis1=1, axis2=2)).astype(np.int_)
    return point_scores(np.sqrt(squares), directions)


@dataclass(frozen=True, slots=True, eq=False)
class _Update:
    """Least squares by which rows of sole postures move an estimate x_o, see the module's text; B = 1.

    Its residual stacks the whitened scalars of all rows, the constraints, and x_o - x over wide priors. All but the
    rows of sole postures keep what x_o makes of them, with a share (`_NOISE_OF_OTHERS`) of their noise.
    """

    #: Linearised at x_o
    start: LinearProblem
    #: (N, D, D), maps residuals in units of sigma to whitened ones along the open directions
    whiten: Array
    #: (N, D), residuals of the other rows at x_o, which they keep, in units of sigma; 0 for rows of sole postures
    reference: Array
    #: (p,), 1 / tau, where tau is the standard deviation of wide priors
    prior: Array

    @classmethod
    def of(cls, start: LinearProblem, stage: Stage, weights: Array, projections: Array) -> _Update:
        """Set up the update of x_o, where the problem is linearised, by the sole rows: those of weights, (N,), above 0.

        The other rows have the weights of the stage (B = 1). All are projected on their open directions, (N, D, D).
        """
        is_sole = weights > 0.0
        factor = np.where(is_sole, 1.0, _NOISE_OF_OTHERS)
        noise = factor[:, None] * start.noise_by_scalar(stage.noise)[0]
        root_weights = np.sqrt(np.where(is_sole, weights, stage.effective[0]))
        wide_precision = _with_wide_priors(stage).priors.precision[0]
        return cls(
            start=start,
            whiten=root_weights[:, None, None] * projections / noise[:, None],
            reference=np.where(is_sole[:, None], 0.0, start.residual(start.x)),
            prior=np.sqrt(wide_precision),
        )

    def residual(self, linear: LinearProblem) -> Array:
        """The whitened residual, (N D + K + p,), at the parameters x where a problem is linearised."""
        change = self.start.x - linear.x
        rows = (linear.residual(linear.x) - self.reference)[:, :, None]
        whitened = (self.whiten @ rows).ravel()
        constraints = linear.C @ change / _NOISE_OF_OTHERS
        return np.concatenate([whitened, constraints, self.prior * change])

    def derivative(self, linear: LinearProblem) -> Array:
        """Minus the derivative of `residual` by the parameters, (N D + K + p, p)."""
        rows = (self.whiten @ linear.A).reshape(-1, len(linear.x))
        return np.vstack([rows, linear.C / _NOISE_OF_OTHERS, np.diag(self.prior)])

    def solved(self, linear_at: Callable[[Array], LinearProblem]) -> LinearProblem:
        """The problem linearised at the minimum, which Gauss-Newton steps find, halved until the squares do not rise.

        ``linear_at`` linearises the problem at parameters x, (p,).
        """
        linear = self.start
        for _ in range(_UPDATES):
            residual = self.residual(linear)
            step = np.linalg.lstsq(self.derivative(linear), residual)[0]
            norm = np.linalg.norm(residual)
            while np.linalg.norm(step) >= _SETTLED:
                trial = self.residual(linear_at(linear.x + step))
                if not np.linalg.norm(trial) > (1.0 + _ROUNDING) * norm:
                    break
                step = 0.5 * step
            if np.linalg.norm(step) < _SETTLED:
                break
            linear = linear_at(linear.x + step)
        return linear


def _joseph_update(covariance: Array, gain: Array, A: Array) -> Array:
    """Covariance of an estimate that M further, whitened scalars move: (I - G A) C (I - G A)^T + G G^T, (p, p).

    The Joseph form, with the covariance C before, (p, p), the gain G, (p, M), and the Jacobian A, (M, p), of the
    scalars' prediction.
    """
    kept = np.eye(len(covariance)) - gain @ A
    return np.asarray(kept @ covariance @ kept.T + gain @ gain.T)
