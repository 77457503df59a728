"""Additional unknowns of a fit, such as the scale error of the instrument: estimated, and tested on held-out rows.

The problem linearised at the fit gets further columns Z; their unknowns b have no prior:

    y = A x + Z b + n,        x_k ~ N(0, tau^2),  n ~ N(0, sigma^2)

The prior standard deviations tau and the noise sigma are estimated again: corrections of the arm that only made up for
b shrink.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import fdtrc

from calib.basics.arrays import Array, Mask
from calib.fit.estimate.fitting import Fitted
from calib.fit.estimate.linear import LinearProblem
from calib.fit.estimate.prior_terms import PriorTerms
from calib.fit.estimate.problem import Problem
from calib.fit.estimate.stages import Stage
from calib.fit.registration.registration import ENOUGH
from calib.fit.registration.setup import Setup
from calib.model.families import FAMILIES
from calib.model.kinematics import Kinematics
from calib.model.parameter_sets import error_model
from calib.numerics.likelihood import GaussianPriors
from calib.robot.gravity import GRAVITY
from calib.robot.robot import Robot

#: Degrees of freedom of a fit below which its residuals and its noise say little.
FEWEST_FREEDOM = 10.0

#: A finding with a smaller p-value is not due to chance.
UNLIKELY = 1e-3

#: A pattern predicts rows if it lowers the error of held-out blocks by this share.
PREDICTS = 0.1

#: Number of held-out blocks of consecutive rows.
_BLOCKS = 8


@dataclass(frozen=True, slots=True, eq=False)
class AugmentedFit:
    """Additional unknowns b, estimated jointly with the p parameters of a fit."""

    #: Shape (k,), the additional unknowns
    b: Array
    #: Shape (k, k), of ``b``
    covariance: Array
    #: Shape (p,), the parameters of the fit, estimated jointly with ``b``
    x: Array
    #: Shape (p,), share (0 to 1) to which the measurements rather than the prior determine each parameter
    determined: Array
    #: Shape (p, k), change of the fit's own parameters with each additional unknown, if that is left out of the fit
    absorbed: Array
    #: Prior standard deviation of each family, estimated again
    prior_std: Mapping[str, float]

    def p_value(
        self, freedom: float, directions: Array | None = None, variance: float = 0.0
    ) -> float:
        """Test whether the additional unknowns b, with the covariance C, are zero, by F(k, freedom) of b^T C^-1 b / k.

        Args:
            freedom: Degrees of freedom of the prior standard deviations in C.
            directions: Test only b along these directions, shape (k', k); None for all of b.
            variance: That of errors of usual size along each direction, which is added to C: the test is then whether b
                is larger than these; 0 for none.

        Returns:
            The p-value: the probability of an F as large if these unknowns are zero, or errors of that size.
        """
        if directions is None:
            directions = np.eye(len(self.b))
        b = directions @ self.b
        C = directions @ self.covariance @ directions.T + variance * np.eye(len(b))
        square = float(b @ np.linalg.solve(C, b))
        return float(fdtrc(len(b), max(freedom, 1.0), square / len(b)))

    @property
    def std(self) -> Array:
        """Standard deviation of each additional unknown, shape (k,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))


def estimate_jointly(
    fitted: Fitted,
    columns: Array,
    of_distances: Array | None = None,
    held: Mask | None = None,
) -> AugmentedFit:
    """Estimate additional unknowns jointly with the parameters of a fit, whose linearisation and row weights stay.

    Args:
        fitted: A fit to N rows of D scalars, with priors of its p parameters.
        columns: Derivative of the predicted scalars by each of k unknowns, shape (N, D, k), in the units of the rows'
            channels.
        of_distances: Derivative of the K predicted known distances between frames [m], shape (K, k); None for zero.
        held: True for the parameters that b replaces, which are held at zero, shape (p,); None for none.

    Returns:
        The unknowns and their covariance, the parameters estimated with them, how far the rows rather than the priors
        determine each of these, and the prior standard deviation of each family, estimated again.
    """
    estimate = fitted.estimate
    augmented = augment(fitted, columns, of_distances)

    # The additional unknowns have no prior; parameters at their bounds stay there.
    prior = PriorTerms.of(fitted.task, fitted.kinematics.model, fitted.setup)
    fixed = {k: float(estimate.x[k]) for k in estimate.at_bound}
    if held is not None:
        fixed |= dict.fromkeys(np.flatnonzero(held).tolist(), 0.0)
    prior = prior.at_bounds(fixed)
    count = columns.shape[2]
    prior = replace(
        prior,
        families=np.pad(prior.families, ((0, 0), (0, count))),
        precision=np.pad(prior.precision, (0, count)),
        mean=np.pad(prior.mean, (0, count)),
    )

    weights = estimate.problem.weights[None]
    # A fit without priors is tested under those of usual arms.
    prior_std = [estimate.prior_std.get(name, FAMILIES[name].typical) for name in prior.names]
    stage = Stage(
        prior=prior,
        kept=weights > 0.0,
        weights=weights,
        repeat_factor=np.ones(weights.shape),
        row_share=np.ones((len(weights), 1)),
        noise=np.array([estimate.noise]),
        prior_std=np.array([prior_std]),
        stop_shares=estimate.problem.stop_shares[None],
    )
    # Left out of the fit, the unknowns b move its parameters by what these make up for, -C_xb C_bb^-1 b.
    p = len(estimate.x)
    C = stage.fit(augmented)[1][0]
    absorbed = -np.linalg.solve(C[p:, p:], C[p:, :p]).T
    stage = stage.by_likelihood(augmented, robust=False)
    fits = stage.fit(augmented)
    values, covariance = fits[0][0], fits[1][0]
    shares_of_prior = np.diag(covariance)[:p] * stage.priors.precision[0, :p]
    return AugmentedFit(
        b=values[p:],
        covariance=covariance[p:, p:],
        x=values[:p],
        determined=1.0 - shares_of_prior,
        absorbed=absorbed,
        prior_std=dict(zip(prior.names, stage.prior_std[0].tolist(), strict=True)),
    )


def augment(fitted: Fitted, columns: Array, of_distances: Array | None = None) -> LinearProblem:
    """Linearise the problem of a fit at its solution, with k additional unknowns, the last of p + k parameters.

    Args:
        fitted: A fit to N rows of D scalars.
        columns: Derivative of the predicted scalars by each unknown, shape (N, D, k), in the units of the rows'
            channels.
        of_distances: Derivative of the K predicted known distances between frames [m], shape (K, k); None for zero.

    Returns:
        The linear problem; the unknowns are zero at the solution.
    """
    problem = fitted.estimate.problem
    linear = problem.linear(fitted.estimate.x)
    count = columns.shape[2]
    of_known = np.zeros((len(linear.C), count))
    if of_distances is not None:
        sigma = np.array([known.sigma for known in problem.distances])
        of_known[: len(sigma)] = of_distances / sigma[:, None]
    standardised = problem.rows.standardise(columns)
    columns_before = linear.columns_of(slice(None))
    before, residual = columns_before[:-1], columns_before[-1:]
    return replace(
        linear,
        x=np.pad(linear.x, (0, count)),
        columns=np.concatenate([before, standardised.transpose(2, 1, 0), residual]),
        C=np.hstack([linear.C, of_known]),
        held=np.pad(linear.held, (0, count)),
    )


def nominal_under(name: str, fitted: Fitted) -> Kinematics:
    """Return the nominal robot under another error model, with frames and targets at the solution of a fit.

    Its derivatives at zero are those of further unknowns of the fit.

    Args:
        name: Name of a parameter set, with families after it: ``"zeros"``, ``"frames+compliance"``. All targets are
            parameters too, no frame is.
        fitted: The fit.
    """
    setup = fitted.estimated_setup()
    return robot_under(name, fitted.task.robot, setup, fitted.task.cell.gravity)


def robot_under(name: str, robot: Robot, setup: Setup, gravity: ArrayLike = GRAVITY) -> Kinematics:
    """Return a robot under the error model of a name, in which all targets are parameters and no frame is.

    Args:
        name: Name of a parameter set, with families after it.
        robot: The nominal robot.
        setup: Frames and targets.
        gravity: Shape (3,), acceleration in the URDF's root [m/s^2].
    """
    model = error_model(
        robot,
        name,
        frame=dict.fromkeys(setup.frame_unknowns, ()),
        targets=setup.target_names,
        gravity=gravity,
    )
    return Kinematics(robot, model, setup.T_frame_base, setup.T_tip_target)


def thin(fitted: Fitted) -> tuple[Fitted, Mask]:
    """Reduce a fit to about `ENOUGH` of its N rows, evenly over frames, targets and kinds, without fitting again.

    It saves time in tests of large tables.

    Args:
        fitted: A fit to N rows.

    Returns:
        The fit with the same parameters, covariance and noise, and which rows it has, shape (N,); itself if N is small.
    """
    problem, estimate = fitted.estimate.problem, fitted.estimate
    chosen = problem.rows.evenly(ENOUGH)
    if np.all(chosen):
        return fitted, chosen
    rows = problem.rows.select(chosen)
    reduced = replace(
        Problem.initial(problem.kinematics, rows, problem.distances),
        weights=problem.weights[chosen],
        noise=problem.noise,
        prior_precision=problem.prior_precision,
        prior_mean=problem.prior_mean,
        stop_shares=problem.stop_shares,
        gauge=problem.gauge,
    )
    thinned = replace(
        estimate,
        problem=reduced,
        scores=estimate.scores[chosen],
        weights=estimate.weights[chosen],
    )
    return replace(fitted, estimate=thinned), chosen


def gain_on_blocks(fitted: Fitted, columns: Array, weights: Array) -> float:
    """Cross-validate additional unknowns, which have no prior, on blocks of consecutive rows.

    Noise and prior standard deviations stay those of the fit. Only rows with a weight count, and whose frame and target
    other blocks see too.

    Args:
        fitted: A fit to N rows of D scalars.
        columns: Derivative of the predicted scalars by each of k unknowns, shape (N, D, k), in the units of the rows'
            channels.
        weights: Weights of the rows in the fits without a block, shape (N,).

    Returns:
        The share by which the rms error of held-out blocks falls with the unknowns; negative if it rises, 0 if it is 0
        without them or no row counts.
    """
    linear = fitted.estimate.problem.linear(fitted.estimate.x)
    before = _error_of_blocks(fitted, linear, weights)
    after = _error_of_blocks(fitted, augment(fitted, columns), weights)
    if not before > 0.0:
        return 0.0
    return 1.0 - after / before


def _error_of_blocks(fitted: Fitted, linear: LinearProblem, weights: Array) -> float:
    """Return the rms error of blocks of rows, each predicted by a fit to the others, over the noise (no unit).

    ``linear`` is the problem of the fit, perhaps with additional unknowns; ``weights``, shape (N,), are those of the
    rows. Rows without weight, or whose frame or target no other block sees, do not count; 0 if none counts.
    """
    rows = fitted.estimate.problem.rows
    block = np.arange(len(rows)) * _BLOCKS // len(rows)
    masks = block == np.unique(block)[:, None]
    residuals = _residuals_without_blocks(fitted, linear, weights, masks)
    weighted = weights > 0.0
    squares = []
    for mask, residual in zip(masks, residuals, strict=True):
        frames, targets = fitted.setup.seen_by(rows.samples.select(~mask & weighted))
        seen_by_others = frames[rows.samples.frame] & targets[rows.samples.target]
        predictable = mask & weighted & seen_by_others
        squares.append(residual[predictable[:, None] & rows.used] ** 2)
    every = np.concatenate(squares)
    return float(np.sqrt(np.mean(every))) if len(every) else 0.0


def _residuals_without_blocks(
    fitted: Fitted, linear: LinearProblem, weights: Array, masks: Mask
) -> Array:
    """Return the residuals of fits without one block of rows each, at noise and priors of the fit to all rows.

    ``linear`` is the problem of the fit, perhaps with additional unknowns, which have no prior; ``weights``, shape
    (N,), are those of the rows, and ``masks``, shape (B, N), the rows of each block. The residuals of all rows, over
    the noise of each scalar, are of the shape (B, N, D).
    """
    problem = fitted.estimate.problem
    additional = len(linear.x) - problem.size
    precision = np.pad(problem.prior_precision, (0, additional))
    mean = np.pad(problem.prior_mean, (0, additional))
    noise = np.tile(fitted.estimate.noise, (len(masks), 1))
    without_block = np.where(masks, 0.0, weights)
    fits = linear.fit(without_block, problem.stop_shares, noise, GaussianPriors(precision, mean))
    return np.asarray(linear.residual(fits[0]) / linear.noise_by_scalar(noise))
