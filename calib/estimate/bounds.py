"""Bounds of parameters, by an active set: parameters beyond a bound are held there, and released at most once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from calib.estimate.estimate import Estimate
from calib.estimate.prior_terms import PriorTerms
from calib.estimate.problem import Problem
from calib.estimate.solving import estimate_with_priors
from calib.estimate.task import Task

#: A parameter at its bound is released where that lowers the sum of squares by more than this.
_WORTH_RELEASING = 1e-6

#: The most estimates, as a multiple of the number of parameters.
_ROUNDS = 3


def estimate_within_bounds(problem: Problem, task: Task, prior: PriorTerms) -> Estimate:
    """Estimate the parameters within their bounds.

    Args:
        problem: The problem, rows of sole postures marked.
        task: Its solver, and the treatment of repeats and outliers.
        prior: Priors and bounds of the parameters.

    Returns:
        The estimate; its `at_bound` names the parameters that are held at a bound.
    """
    low, high = prior.limits.T
    fixed: dict[int, float] = {}
    released: set[int] = set()
    estimate = estimate_with_priors(problem, task, prior)
    for _ in range(_ROUNDS * problem.size):
        beyond = np.flatnonzero((estimate.x < low) | (estimate.x > high)).tolist()
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
    """Numbers of the parameters at a bound whose release would lower the sum of squares, within the bounds.

    Args:
        estimate: The estimate with these parameters held.
        prior: Priors and bounds without any held.
        fixed: Number of each parameter that is held, from 0, and its value.
    """
    by_family = {} if prior.source == "off" else estimate.prior_std
    families = zip(prior.names, prior.start, strict=True)
    prior_std = np.array([by_family.get(name, start) for name, start in families])
    precision = prior.precision + (1.0 / prior_std**2) @ prior.families
    released = replace(estimate.problem, precision=precision, centre=prior.centre)
    residual, jacobian = released.system(estimate.x)
    slope = jacobian.T @ residual  # gradient of half the sum of squares
    curvature = np.sum(jacobian**2, axis=0)
    result = set()
    for k, value in fixed.items():
        at_low = value <= prior.limits[k, 0]
        inwards = -slope[k] if at_low else slope[k]
        if inwards > 0.0 and inwards**2 > _WORTH_RELEASING * curvature[k]:
            result.add(k)
    return result
