"""Bounds of parameters, by an active set: parameters beyond a bound are held there, and released at most once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from calib.fit.estimate.estimate import Estimate
from calib.fit.estimate.prior_terms import PriorTerms
from calib.fit.estimate.problem import Problem
from calib.fit.estimate.solving import estimate_with_priors
from calib.fit.estimate.task import Task

#: A parameter at its bound is released if that lowers the sum of squares by more than this.
_WORTH_RELEASING = 1e-6

#: The most estimates, as a multiple of the number of parameters.
_ROUNDS = 3


def estimate_within_bounds(problem: Problem, task: Task, prior: PriorTerms) -> Estimate:
    """Estimate the parameters within their bounds, by an active set.

    A parameter that comes out beyond a bound is held at this bound, and all others are estimated again. When none is
    beyond, those held parameters are released that the measurements pull inwards, each at most once. It ends when none
    is beyond or released, or after `_ROUNDS` p further estimates.

    Args:
        problem: The least-squares problem, with its rows of sole postures marked.
        task: The fit.
        prior: Priors and bounds of the p parameters, none of them held.

    Raises:
        SolverError: The residual is not finite at the start.
    """
    low, high = prior.limits.T
    fixed: dict[int, float] = {}
    released: set[int] = set()
    estimate = estimate_with_priors(problem, task, prior)
    for _ in range(_ROUNDS * problem.size):
        is_beyond = (estimate.x < low) | (estimate.x > high)
        beyond = np.flatnonzero(is_beyond).tolist()
        to_release: set[int] = set()
        if fixed and not beyond:
            to_release = _pulled_inwards(estimate, prior, fixed) - released
        if not beyond and not to_release:
            break
        for k in beyond:
            fixed[k] = float(np.clip(estimate.x[k], low[k], high[k]))
        for k in to_release:
            del fixed[k]
        released |= to_release
        estimate = estimate_with_priors(problem, task, prior.at_bounds(fixed))
    return estimate


def _pulled_inwards(estimate: Estimate, prior: PriorTerms, fixed: Mapping[int, float]) -> set[int]:
    """Indices of parameters at a bound whose release would lower the sum of squares, within the bounds.

    A Gauss-Newton step of one parameter alone lowers the sum of squares by slope^2 / curvature.
    """
    residual, jacobian = _without_holds(estimate, prior).system(estimate.x)
    slope = jacobian.T @ residual  # gradient of half the sum of squares
    curvature = np.sum(jacobian**2, axis=0)
    result = set()
    for k, value in fixed.items():
        at_low = value <= prior.limits[k, 0]
        inwards = -slope[k] if at_low else slope[k]
        if inwards > 0.0 and inwards**2 > _WORTH_RELEASING * curvature[k]:
            result.add(k)
    return result


def _without_holds(estimate: Estimate, prior: PriorTerms) -> Problem:
    """The estimate's problem in which parameters that are held at a bound have their usual priors again.

    Families of parameters have the prior standard deviation that was estimated; the one as given if all parameters of a
    family were held, or priors are off.
    """
    estimated_std = {} if prior.source == "off" else estimate.prior_std
    prior_std = []
    for family, given_std in zip(prior.names, prior.start, strict=True):
        prior_std.append(estimated_std.get(family, given_std))
    family_precision = 1.0 / np.array(prior_std) ** 2
    precision = prior.precision + family_precision @ prior.families
    return replace(estimate.problem, prior_precision=precision, prior_mean=prior.mean)
