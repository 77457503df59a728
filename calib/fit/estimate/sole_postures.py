"""Sole postures: poses that alone determine a direction of the parameters, so that no other row can check them.

Let A_b be the derivative of what is predicted at a pose b, which has one row or several, in units of the noise. From
the other rows, and priors as wide as they are given, the prediction at b has the covariance

    K_b = A_b C A_b^T

where C is the covariance of the parameters estimated without b. Where the largest eigenvalue of K_b is far above 1, and
far above those of the other poses, b is a sole posture: because a joint moves there alone, say. Its leverage
K / (1 + K) is close to one (D. A. Belsley, E. Kuh, R. E. Welsch: Regression Diagnostics, 1980).

The other rows cannot tell whether the measurement at such a pose is an outlier, and one pose is no sample from which to
estimate a prior standard deviation. So the other rows o alone determine noise, prior standard deviations, and the
estimate x_o with its covariance C. Rows s of sole postures then move x_o along the directions that o leaves open:

    minimise  |r_s(x)|^2 / sigma^2 + |r_o(x) - r_o(x_o)|^2 / (epsilon sigma)^2 + |x - x_o|^2 / tau^2

with residuals r, noise sigma, prior standard deviations tau that are wide, and a small epsilon, which keeps what the
others determine. This is minimised by Gauss-Newton steps, not linearised once, because a single posture may need large
angles. With the gain G, the derivative of the solution by r_s,

    C <- (I - G A_s) C (I - G A_s)^T + sigma^2 G G^T

A row of a sole posture loses its weight only where r_s(x_o), along the open directions, is larger than wide priors
allow.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from calib.basics.arrays import Array, Integers, Mask
from calib.fit.estimate.linear import LinearProblem
from calib.fit.estimate.stages import Stage
from calib.fit.registration.rows import Rows
from calib.numerics.scores import point_scores
from calib.robot.kernel import over_blocks

#: A pose is a sole posture where the standard deviation of its prediction from the others is so many times the noise,
_UNPREDICTED = 10.0

#: and so many times that of the typical pose: where rows are too few, all are predicted badly.
_ABOVE_TYPICAL = 10.0

#: A frame or target that fewer scalars of other rows observe is not determined without the pose, whatever joints do.
_FEWEST_SCALARS = 18

#: A pose whose leverage is bounded by less than this is no sole posture, and the bound stands for the leverage.
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


def sole_postures(linear: LinearProblem, rows: Rows, first: Stage) -> Mask:
    """Find the rows of sole postures: poses that alone determine a direction of the parameters.

    A pose is a sole posture where, along some direction, the standard deviation of its prediction from the other rows
    is above 10 times the noise (`_UNPREDICTED`), and above 10 times that of the median pose (`_ABOVE_TYPICAL`). Over
    the noise it is sqrt(k / (1 - k)) with the pose's leverage k, the largest eigenvalue of A C A^T, where A is the
    Jacobian of its scalars and C the covariance of the parameters by all rows.

    Args:
        linear: The least-squares problem linearised at the registered start: N rows of D scalars by p parameters, in
            units of each scalar's given sigma.
        rows: The same N rows of measurements; rows of one number in ``rows.blocks``, shape (N,), are of one pose of the
            robot, and ``rows.used``, shape (N, D), are the scalars that were measured.
        first: Row weights, noise and priors of the first stage of one fit (B = 1): every row has weight one, noise and
            prior standard deviations are as given.

    Returns:
        Mask of the rows of sole postures, shape (N,). Rows whose measurement frame or target few rows of other poses
        observe are none.
    """
    _, covariances, _ = first.fit(linear)
    covariance = covariances[0]
    block = np.unique(rows.blocks, return_inverse=True)[1].reshape(-1)
    # Bounds first: the largest eigenvalue is at most the trace.
    leverage = np.bincount(block, _traces(linear, covariance))
    for b in np.flatnonzero(leverage > _WORTH_A_LOOK).tolist():
        mask = block == b
        A = linear.A[mask][rows.used[mask]]
        leverage[b] = np.linalg.eigvalsh(A @ covariance @ A.T)[-1]
    leverage = np.clip(leverage, 0.0, _HIGHEST_LEVERAGE)
    unpredicted = np.sqrt(leverage / (1.0 - leverage))
    typical = float(np.median(unpredicted))
    sole = unpredicted > max(_UNPREDICTED, _ABOVE_TYPICAL * typical)
    return np.asarray(sole[block] & _seen_by_others(rows, block))


def _traces(linear: LinearProblem, covariance: Array) -> Array:
    """The trace of A_i C A_i^T of each row i, where A_i is the Jacobian of its prediction.

    It is the sum of the variances of a row's predicted scalars, and bounds the largest eigenvalue of A_i C A_i^T.

    Args:
        linear: The linearised problem: ``linear.A``, shape (N, D, p), is the Jacobian of D scalars of each of N rows by
            p parameters, in units of each scalar's given sigma.
        covariance: shape (p, p), C, of the parameters [m, rad, ...].

    Returns:
        shape (N,), in units of the given sigma squared.
    """

    def work(rows: slice) -> Array:
        """The traces of some of the rows.

        Args:
            rows: Slice of the N rows.

        Returns:
            shape (n,), of the n rows of this slice.
        """
        A = linear.A[rows]
        return np.asarray(np.einsum("ndp,ndp->n", A @ covariance, A))

    return np.concatenate(over_blocks(work, len(linear)))


def _seen_by_others(rows: Rows, block: Integers) -> Mask:
    """Rows whose measurement frame and target are determined by rows of other poses.

    Args:
        rows: N rows of measurements, each of one target from one frame: ``rows.samples.frame`` and
            ``rows.samples.target``, shape (N,), their indices from 0; ``rows.used``, shape (N, D), which of its scalars
            were measured.
        block: shape (N,), index of each row's pose of the robot, from 0.

    Returns:
        Mask of these rows, shape (N,): rows of other poses have at least 18 scalars (`_FEWEST_SCALARS`) of the same
        frame, and as many of the same target.
    """
    scalars = np.sum(rows.used, axis=1)
    result = np.ones(len(rows), dtype=bool)
    for places in (rows.samples.frame, rows.samples.target):
        pairs = np.column_stack([places, block])
        pair = np.unique(pairs, axis=0, return_inverse=True)[1].reshape(-1)
        others = np.bincount(places, scalars)[places] - np.bincount(pair, scalars)[pair]
        result &= others >= _FEWEST_SCALARS
    return result


def with_wide_priors(stage: Stage) -> Stage:
    """Return a stage with priors three times (`_WIDE`) as wide as given, but where the estimated ones are wider still.

    Rows of sole postures, which alone determine a direction of the parameters, are judged and used with these priors.

    Args:
        stage: State of B fits: ``stage.prior_std``, shape (B, K), estimated prior standard deviations of K families of
            parameters, in their unit; ``stage.prior.start``, shape (K,), those as given or assumed before the fit.

    Returns:
        The same row weights and noise with the wider prior standard deviations.
    """
    start = np.array(stage.prior.start, dtype=np.float64)
    return replace(stage, prior_std=np.maximum(stage.prior_std, _WIDE * start))


def _wide_covariance(linear: LinearProblem, stage: Stage) -> Array:
    """Covariance of the parameters by one linear fit with wide priors.

    Args:
        linear: The linearised problem of N rows by p parameters.
        stage: Row weights, noise and prior standard deviations of the fit (B = 1); its priors are widened to
            three times the given ones.

    Returns:
        shape (p, p), in the products of the parameters' units [m, rad, ...].
    """
    _, covariances, _ = with_wide_priors(stage).fit(linear)
    covariance: Array = covariances[0]
    return covariance


def open_directions(linear: LinearProblem, stage: Stage, sole: Mask) -> Array:
    """Find the directions of their scalars in which the other rows do not predict sole postures.

    Such a row is predicted from the other rows, and priors three times as wide as given. Its open directions are the
    eigenvectors of the covariance of the prediction, in units of the noise, whose standard deviation is at least 1/3
    (`_OPEN`) of the largest.

    Args:
        linear: The problem linearised at the estimate by all other rows: N rows of D scalars by p parameters, in units
            of each scalar's given sigma.
        stage: Row weights, noise (a multiple of that sigma) and prior standard deviations of that fit (B = 1), in which
            sole postures have no weight.
        sole: shape (N,), which rows are of sole postures: poses that alone determine a direction of the parameters.

    Returns:
        shape (N, D, D): of rows of sole postures the orthogonal projection of their scalars, in units of the noise, on
        these directions; of all other rows the identity.
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


def open_scores(linear: LinearProblem, x: Array, stage: Stage, projections: Array) -> Array:
    """Score how far rows of sole postures lie from what wide priors predict, along the open directions.

    With the projection P of a row's scalars, the residual r (measured minus predicted) and the Jacobian A in units of
    the noise, and the covariance C of the parameters by priors three times as wide as given, the squared score is
    r^T P (I + P A C A^T P)^-1 P r, converted from the rank of P to three degrees of freedom.

    Args:
        linear: The problem linearised: N rows of D scalars by p parameters, in units of each scalar's given sigma.
        x: shape (p,), the estimate by all other rows [m, rad, ...].
        stage: Row weights, noise (a multiple of that sigma) and prior standard deviations of that fit (B = 1), in which
            sole postures have no weight: poses that alone determine a direction of the parameters.
        projections: shape (N, D, D), orthogonal projections P of each row's scalars, in units of the noise, on the
            directions in which the other rows do not predict it; see `open_directions`.

    Returns:
        shape (N,), >= 0, in standard deviations; comparable with scores of three scalars, see `calib.numerics.scores`.
        Only those of rows of sole postures have a meaning.
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
    rows of sole postures keep what x_o makes of them, with 0.05 (`_NOISE_OF_OTHERS`) of their noise.
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
        """Set up the update of an estimate x_o by the rows of sole postures, which had no part in it.

        All other rows keep their residuals at x_o, with 0.05 (`_NOISE_OF_OTHERS`) of their noise.

        Args:
            start: The problem linearised at x_o: N rows of D scalars by p parameters, in units of the given sigma.
            stage: State of the fit to the other rows (B = 1): ``stage.effective``, shape (1, N), row weights;
                ``stage.noise``, shape (1, C), of each instrument as a multiple of the given sigma; and prior standard
                deviations, which are widened.
            weights: shape (N,), > 0 for rows of sole postures (poses that alone determine a direction of the
                parameters); rows with 0 have the stage's weights, and residuals that are to stay.
            projections: shape (N, D, D), of each row's scalars, in units of the noise, on the directions in which the
                other rows do not predict it; see `open_directions`.

        Returns:
            The least-squares problem whose minimum is the updated estimate; the noise of the other rows is multiplied
            by 0.05 in it.
        """
        is_sole = weights > 0.0
        factor = np.where(is_sole, 1.0, _NOISE_OF_OTHERS)
        noise = factor[:, None] * start.noise_by_scalar(stage.noise)[0]
        root_weights = np.sqrt(np.where(is_sole, weights, stage.effective[0]))
        wide_precision = with_wide_priors(stage).priors.precision[0]
        return cls(
            start=start,
            whiten=root_weights[:, None, None] * projections / noise[:, None],
            reference=np.where(is_sole[:, None], 0.0, start.residual(start.x)),
            prior=np.sqrt(wide_precision),
        )

    def residual(self, linear: LinearProblem) -> Array:
        """The residual, at the parameters x where a problem is linearised, of the update by sole postures.

        Rows of sole postures (poses that alone determine a direction of the parameters) update the estimate x_o by all
        other rows. Uses ``start``, the problem at x_o; ``whiten``, shape (N, D, D), a map from units of the given sigma
        to whitened scalars; ``reference``, shape (N, D), residuals of the other rows at x_o in units of the given
        sigma, 0 for sole postures; and ``prior``, shape (p,), 1 / tau, where tau is the standard deviation of wide
        priors.

        Args:
            linear: The problem linearised at x, shape (p,): N rows of D scalars (measured minus predicted, in units of
                the given sigma), K constraints with the Jacobian ``linear.C``, shape (K, p), whitened.

        Returns:
            shape (N D + K + p,), whitened: the rows' residuals less ``reference``, then C (x_o - x) / 0.05, the change
            of the constraints, then (x_o - x) / tau.
        """
        change = self.start.x - linear.x
        rows = (linear.residual(linear.x) - self.reference)[:, :, None]
        whitened = (self.whiten @ rows).ravel()
        constraints = linear.C @ change / _NOISE_OF_OTHERS
        return np.concatenate([whitened, constraints, self.prior * change])

    def derivative(self, linear: LinearProblem) -> Array:
        """Minus the derivative of `residual` by the parameters.

        Uses ``whiten``, shape (N, D, D), a map from units of the given sigma to whitened scalars, which are weighted
        and in units of the noise, and ``prior``, shape (p,), 1 / tau, where tau is the standard deviation of wide
        priors.

        Args:
            linear: The problem linearised at the parameters x, shape (p,): Jacobian ``linear.A``, shape (N, D, p), of
                the prediction of N rows in units of the given sigma, and ``linear.C``, shape (K, p), of K whitened
                constraints.

        Returns:
            shape (N D + K + p, p), per unit of each parameter: of the rows' whitened predictions, of the constraints (C
            / 0.05), and 1 / tau on the diagonal.
        """
        rows = (self.whiten @ linear.A).reshape(-1, len(linear.x))
        return np.vstack([rows, linear.C / _NOISE_OF_OTHERS, np.diag(self.prior)])

    def solved(self, linear_at: Callable[[Array], LinearProblem]) -> LinearProblem:
        """The problem linearised at the minimum: Gauss-Newton steps, halved until the sum of squares does not rise.

        Begins at ``start``, the problem linearised at the estimate x_o by all other rows. ``residual`` and
        ``derivative`` give the stacked residual of rows, constraints and x_o - x, and minus its derivative by the
        parameters x.

        Args:
            linear_at: Maps parameters x, shape (p,), [m, rad, ...], to the problem linearised there.

        Returns:
            The problem linearised where a step is shorter than 1e-9 (`_SETTLED`), or after the most steps (`_UPDATES`).
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


def update_by_sole_postures(
    estimate: tuple[Array, Array],
    stage: Stage,
    linear_at: Callable[[Array], LinearProblem],
    weights: Array,
    projections: Array,
) -> tuple[Array, Array]:
    """Update an estimate by the rows of sole postures: poses that alone determine a direction of the parameters.

    These rows move the estimate along what the other rows leave open, by least squares with priors three times as wide
    as given. The other rows, with 0.05 of their noise, keep their residuals.

    Args:
        estimate: x, shape (p,), by all other rows [m, rad, ...], and its covariance, shape (p, p).
        stage: Row weights, noise (a multiple of each scalar's given sigma) and prior standard deviations of that fit
            (B = 1), in which sole postures have no weight.
        linear_at: Maps x, shape (p,), to the problem linearised there: N rows of D scalars, in units of each scalar's
            given sigma.
        weights: shape (N,), of the rows of sole postures, from 0 (outlier) to 1; 0 for all others.
        projections: shape (N, D, D), orthogonal projections of each row's scalars, in units of the noise, on the
            directions in which the other rows do not predict it; see `open_directions`.

    Returns:
        x, shape (p,), and its covariance, shape (p, p), updated, in the same units.
    """
    x, covariance = estimate
    update = _Update.of(linear_at(x), stage, weights, projections)
    linear = update.solved(linear_at)
    A = update.derivative(linear)
    scalars_of_a_row = update.reference.shape[1]
    of_sole = np.flatnonzero(np.repeat(weights > 0.0, scalars_of_a_row))
    gain = np.asarray(np.linalg.pinv(A)[:, of_sole])
    return linear.x, _joseph_update(covariance, gain, A[of_sole])


def _joseph_update(covariance: Array, gain: Array, A: Array) -> Array:
    """Covariance of an estimate that M further scalars move: (I - G A) C (I - G A)^T + G G^T, the Joseph form.

    Args:
        covariance: shape (p, p), C, before, in the products of the parameters' units.
        gain: shape (p, M), G, the derivative of the estimate by the scalars.
        A: shape (M, p), Jacobian of the scalars' prediction. The scalars are whitened: their errors have the variance
            1, and are independent of each other and of the estimate before.

    Returns:
        shape (p, p), in the same units.
    """
    kept = np.eye(len(covariance)) - gain @ A
    return np.asarray(kept @ covariance @ kept.T + gain @ gain.T)
