"""What tells a result's data from its priors: how wide these are, and how hard the data push against them."""

from __future__ import annotations

import numpy as np

from calib.identify.result import Calibration


def prior_stds(c: Calibration) -> list[float]:
    """What the priors, or the holds where there is none, let each parameter change; of the same order."""
    precision = c.fitted.estimate.problem.precision
    return [float(1.0 / np.sqrt(one)) if one > 0.0 else np.nan for one in precision]


def pushes(c: Calibration) -> list[float]:
    """How hard the data push each parameter against its prior: minus the derivative of half their squares, [1/unit].

    At the least of all squares that is the prior's pull, (x - mean) / std^2. Where a prior is next to nothing wide, x
    is too, and only this still tells what the data say.
    """
    estimate = c.fitted.estimate
    problem, x = estimate.problem, estimate.x
    if c.solver == "paper":  # not at the least of squares, and without priors
        return [float(one) for one in problem.precision * (x - problem.centre)]
    between, slope = problem.constraints(x)
    if problem.passes is None:
        residual, jacobian = problem.residual_and_jacobian(x)
        used = problem.rows.used
        weights = np.where(used, problem.weights[:, None] / problem.scales**2, 0.0)
        push = np.einsum("nd,ndp->p", weights * np.where(used, residual, 0.0), jacobian)
    else:
        precise = 1.0 / np.square(problem.passes.noise_of(problem.scales))
        push = np.tensordot(precise, problem.passes.normal(x, problem.weights), 1)[:-1, -1]
    return [float(one) for one in push + between @ slope]
