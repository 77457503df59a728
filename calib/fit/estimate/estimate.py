"""Estimate: the parameters of a fit with their covariance, and the weights, noise and priors that go with them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from calib.basics.arrays import Array, Mask, read_only
from calib.basics.values import Value, keep_read_only
from calib.fit.estimate.linear import LinearProblem
from calib.fit.estimate.problem import Problem
from calib.fit.estimate.special_cases.hands_alone import (
    added_covariance,
    hands_alone,
    missing_variance,
)
from calib.fit.estimate.stages import Stage
from calib.model.error_model import FRAME, MOUNT, TARGET
from calib.model.families import FAMILIES
from calib.numerics.correlated_noise import PoseNoise
from calib.numerics.scores import Limits
from calib.numerics.solvers import Solution

#: A change below this is set to zero: weak priors leave such traces on parameters that the target can replace [m, rad].
_NOTHING = 1e-8

#: So is one below this share of its standard deviation: the weak prior of an estimated frame leaves such a trace on the
#: first joint, which nothing distinguishes from the frame, and the joint's origin would be rewritten by 1e-8.
_TRACE = 3e-4

#: Singular values below this share of the largest are zero, when frames and targets make up for traces.
_RANK_TOLERANCE = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Estimate(Value):
    """Estimated parameters of one fit to N rows."""

    #: (p,), offsets from the nominal robot and the registered setup [m, rad, ...]
    x: Array
    #: The problem in its last form: weights, scales and prior precision as estimated
    problem: Problem
    #: The solver's: all stages one after the other; of a fit that is only compared where it was linearised last
    solution: Solution
    #: (p, p), of x
    covariance: Array
    #: (N,), deleted residual norm of each row: `calib.numerics.scores`
    scores: Array
    #: A row with a higher score is flagged as an outlier
    flag_limit: float
    #: Degrees of freedom left for the noise
    freedom: float
    #: (C,), estimated noise of each channel, in units of the given sigma
    noise: tuple[float, ...]
    #: Prior standard deviation of each family, SI units; empty without priors
    prior_std: Mapping[str, float]
    #: (N,), robust weights, repeats not shared out
    weights: Array
    #: Restricted log-likelihood at these prior standard deviations and noise, in units of the given sigma, except for a
    #: constant: the normalisation of the weak priors of flat parameters
    log_likelihood: float
    #: Indices of the parameters that are held at a bound, from 0
    at_bound: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        """Keep a read-only copy of the mapping."""
        keep_read_only(self, "prior_std")

    @property
    def sigma(self) -> dict[str, float]:
        """Estimated standard deviation of one scalar by the symbol of its unit, "m", "rad" or "px", in this unit.

        It is the median over all scalars that were measured.
        """
        scales, channels = self.problem.scales, self.problem.rows.channels
        return {unit: float(np.median(scales[channels.where(unit)])) for unit in channels.present}

    @property
    def pose_noise(self) -> PoseNoise | None:
        """Scale of the stated covariances of poses, and what the robot adds; None if none was stated."""
        rows = self.problem.rows
        return rows.pose_noise if np.any(rows.correlated) else None

    @property
    def outliers(self) -> Mask:
        """Rows that are flagged as outliers, shape (N,): those whose score is above the limit."""
        return self.scores > self.flag_limit


def problem_at_stage(problem: Problem, stage: Stage) -> Problem:
    """Return a problem with weights, noise, priors and shares of stops of a stage of one fit (B = 1).

    The weights are the effective ones, in which repeats are shared out.
    """
    priors = stage.priors
    return replace(
        problem,
        weights=stage.effective[0],
        noise=stage.noise[0],
        prior_precision=priors.precision[0],
        prior_mean=priors.centre,
        stop_shares=stage.stop_shares[0],
    )


def estimate_at_stage(
    problem: Problem,
    stage: Stage,
    solution: Solution,
    covariance_factor: float = 1.0,
    like: Estimate | None = None,
) -> Estimate:
    """Make the estimate from the last stage of a fit and the solution of its problem.

    Args:
        problem: The least-squares problem.
        stage: State of one fit (B = 1) as it settled.
        solution: The solver's result at this stage.
        covariance_factor: Covariance of the solver's estimator over that of least squares, which multiplies the
            variance of the noise, not that of the priors; 1 for least squares.
        like: Estimate of another model, whose scores this one has, and with which it is only compared: it has the
            solution of the linearised problem then, with traces of priors; None: neither.

    Returns:
        The estimate. Its x differs from the solution's if a parameter is a mere trace of its prior, which becomes 0
        (frames and targets make up for that), or is held at a bound, which it then meets.
    """
    linear, prior, priors = problem.linear(solution.x), stage.prior, stage.priors
    has_priors = prior.source != "off"
    means, covariance_for_scores, freedom = stage.scoring_fit(linear)
    if like is None:
        x = solution.x
        scores = linear.scores(x[None], covariance_for_scores, stage.effective, stage.noise)
        flag_limit = Limits.of(len(problem.rows), freedom[0]).flagged
    else:
        (x,), scores, flag_limit = means, like.scores[None], np.asarray(like.flag_limit)
    if like is None and linear.stops is not None:
        excess = stage.stop_excess(linear, solution.x[None])
        thrown = linear.stops.weights_of_stops(stage.effective) == 0.0
        of_stops = np.where(thrown, excess * flag_limit, 0.0)[:, linear.stops.stop_of_row]
        rows = linear.stops.rows
        scores[:, rows] = np.maximum(scores[:, rows], of_stops)

    equations = linear.normal_equations(stage.effective, stage.stop_shares)
    _, covariances = equations.posterior(np.sqrt(covariance_factor) * stage.noise, priors)
    covariance = covariances[0]
    if problem.gauge is not None:  # the arm's size is as uncertain as by its prior
        covariance = covariance + problem.gauge.covariance(priors.precision[0])
    family_precision = np.where(prior.flat, 0.0, priors.precision)
    log_likelihood = equations.log_likelihood(stage.noise, priors, family_precision)

    x = x.copy()
    if has_priors and like is None:  # without, nothing keeps small what the target can replace
        x = _without_traces(problem, linear, covariance)
    if prior.source == "data" and hands_alone(problem.rows.present, problem.kinematics.robot):
        covariance = covariance + _by_typical_errors(problem, stage, covariances[0])
    held = list(prior.fixed)
    x[held] = prior.mean[held]
    prior_std = dict(zip(prior.names, stage.prior_std[0].tolist(), strict=True))
    return Estimate(
        x=read_only(x),
        problem=problem_at_stage(problem, stage),
        solution=replace(solution, x=read_only(x)) if like is None else solution,
        covariance=read_only(covariance),
        scores=read_only(scores[0]),
        flag_limit=float(flag_limit),
        freedom=float(freedom[0]),
        noise=tuple(stage.noise[0].tolist()),
        prior_std=prior_std if has_priors else {},
        weights=read_only(stage.weights[0]),
        log_likelihood=float(log_likelihood[0]),
        at_bound=prior.fixed,
    )


def _by_typical_errors(problem: Problem, stage: Stage, covariance: Array) -> Array:
    """What errors of typical sizes add to a covariance, (p, p), by narrower priors, and to that of the arm's size."""
    prior, precision = stage.prior, stage.priors.precision[0]
    typical = np.array([FAMILIES[name].typical for name in prior.names])
    missing = missing_variance(prior.families, stage.prior_std[0], typical)
    added = added_covariance(covariance, precision, missing)
    if problem.gauge is not None:
        wider = np.where(missing > 0.0, precision / (1.0 + missing * precision), precision)
        added += problem.gauge.covariance(wider) - problem.gauge.covariance(precision)
    return added


def _without_traces(problem: Problem, linear: LinearProblem, covariance: Array) -> Array:
    """The solution, (p,), with changes of the robot that are mere traces of the priors set to zero.

    A trace is an offset of a length or angle of the robot below `_NOTHING`, or below the share `_TRACE` of its standard
    deviation, by the covariance of the solution, (p, p). Frames and targets change by least squares so that the
    predictions stay.
    """
    model, x = problem.kinematics.model, linear.x
    of_setup = model.family(FRAME, TARGET, MOUNT)
    of_placements = model.of_robot & np.isin(model.units, ("m", "rad"))
    std = np.sqrt(np.diagonal(covariance))
    least = np.maximum(_NOTHING, _TRACE * std)
    traces = of_placements & (np.abs(x) < least)
    result = np.where(traces, 0.0, x)
    if np.any(traces):
        A = linear.reduced_jacobian()
        removed = A[:, traces] @ x[traces]
        result[of_setup] += np.linalg.lstsq(A[:, of_setup], removed, rcond=_RANK_TOLERANCE)[0]
    return result
