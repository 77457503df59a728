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

#: A parameter at its bound is released where that lowers the sum of squares by more than this.
_WORTH_RELEASING = 1e-6

#: The most estimates, as a multiple of the number of parameters.
_ROUNDS = 3


def estimate_within_bounds(problem: Problem, task: Task, prior: PriorTerms) -> Estimate:
    """Estimate the parameters within their bounds, by an active set.

    A parameter that comes out beyond a bound is held at this bound, and all others are estimated again. When none is
    beyond, those held parameters are released that the measurements pull inwards, each at most once. It ends where none
    is beyond or released, or after 3 p (`_ROUNDS`) further estimates.

    Args:
        problem: The least-squares problem: N rows of measurements, and the robot as a function of p parameters, which
            are offsets from the nominal robot and the registered frames and targets [m, rad, ...]. Its rows of sole
            postures (poses that alone determine a direction of the parameters, which no other row can check) are
            marked.
        task: Robot, cell and options of the fit; used are the solver, and the treatment of repeats and outliers.
        prior: Priors of the p parameters, none of them held, and ``prior.limits``, shape (p, 2), the lowest and highest
            value of each [m, rad, ...]; infinite without a bound.

    Returns:
        The estimated parameters with covariance, noise, scores and weights of the rows. Its ``at_bound`` has the
        indices, from 0, of the parameters that are held at a bound.

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
    """Parameters at a bound whose release would lower the sum of squares, within the bounds.

    A Gauss-Newton step of one parameter alone lowers the sum of squares by slope^2 / curvature; it must exceed 1e-6
    (`_WORTH_RELEASING`).

    Args:
        estimate: The estimate of the p parameters with these held at their bounds: ``estimate.x``, shape (p,), and its
            problem with weights and noise as estimated.
        prior: Priors and bounds of the p parameters, none of them held; ``prior.limits``, shape (p, 2), has the lowest
            and highest value of each.
        fixed: Index, from 0, of each parameter that is held, and the value that it is held at [m, rad, ...].

    Returns:
        Indices of those parameters, from 0.
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
    """The problem in which parameters that an estimate holds at a bound have their usual priors again.

    Args:
        estimate: The estimate of the p parameters with some held; ``estimate.problem`` has the weights and noise as
            estimated, ``estimate.prior_std`` the estimated prior standard deviation by the name of its family, SI
            units.
        prior: Priors of the p parameters, none of them held: names, members and given standard deviations of K
            families, and 1 / variance (``precision``) and mean (``centre``), shape (p,), of parameters besides these.

    Returns:
        The estimate's problem with other precisions and means. Families of parameters have the prior standard deviation
        that was estimated; the one as given where all parameters of a family were held, or priors are off.
    """
    estimated_std = {} if prior.source == "off" else estimate.prior_std
    prior_std = []
    for family, given_std in zip(prior.names, prior.start, strict=True):
        prior_std.append(estimated_std.get(family, given_std))
    family_precision = 1.0 / np.array(prior_std) ** 2
    precision = prior.precision + family_precision @ prior.families
    return replace(estimate.problem, precision=precision, centre=prior.centre)
