"""The paper's estimate: Levenberg-Marquardt on squared errors in mm^2, at absolute parameters, without priors.

It minimises the sum of |r_i|^4 over the residuals r_i of points; then the expected sum of squared residuals is
sigma^2 (3 N - 3/5 rank), with the rank of the Jacobian.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from calib.data.cell import Priors
from calib.errors import ModelError
from calib.estimate.estimate import Estimate, estimate_at_stage
from calib.estimate.linear import LinearProblem
from calib.estimate.prior_terms import PriorTerms
from calib.estimate.problem import Problem
from calib.estimate.stages import Stage
from calib.estimate.task import Task
from calib.model.parameters import ErrorModel
from calib.numerics.solvers import paper_levenberg_marquardt
from calib.registration.setup import Setup
from calib.units import Array

#: Covariance of the estimator that minimises fourth powers over that of least squares, for normal noise in 3-D.
_FOURTH_POWERS = 1.4

#: Millimetres in a metre.
_MM = 1e3


def paper_estimate(problem: Problem, task: Task, registered: Setup) -> Estimate:
    """Estimate the parameters by the paper's algorithm.

    Args:
        problem: The problem before any estimate.
        task: The task; its priors, bounds and weights have no part in it.
        registered: Frames and targets at the start.

    Raises:
        ModelError: Rows other than points of one target.
    """
    only_points = all(kind.name == "point" for kind in problem.rows.present)
    if not only_points or len(registered.targets) > 1:
        raise ModelError("The solver 'paper' takes positions of one target. Choose --solver lm.")
    model = problem.kinematics.model
    unit = np.array([_MM if parameter.unit == "m" else 1.0 for parameter in model.parameters])
    nominal = _nominal_values(model, registered)
    system = partial(paper_system, problem, nominal, unit)
    solution = paper_levenberg_marquardt(system, nominal * unit)
    solution = replace(solution, x=solution.x / unit - nominal)
    without_priors = replace(
        task,
        cell=replace(task.cell, priors=Priors("off"), bounds={}, parameter_priors={}),
        allow_absent=True,
    )
    prior = PriorTerms.of(without_priors, model, registered)
    every = np.ones((1, len(problem.rows)), dtype=bool)
    stage = Stage.initial(prior, every, len(problem.smallest_noise))
    noise = _noise(problem.linear(solution.x), stage)
    stage = replace(stage, noise=np.array([[noise]]))
    return estimate_at_stage(problem, stage, solution, covariance_factor=_FOURTH_POWERS)


def _nominal_values(model: ErrorModel, registered: Setup) -> Array:
    """Absolute values from which the parameters are offsets, shape (p,), [m] and [rad]."""
    target = registered.T_tip_target[0, :3, 3]
    by_name = dict(zip(("target_x", "target_y", "target_z"), target, strict=True))
    values = [by_name.get(p.name, p.nominal) for p in model.parameters]
    return np.array(values)


def _noise(linear: LinearProblem, stage: Stage) -> float:
    """Noise of the points from their residuals, in units of the given sigma."""
    equations = linear.normal_equations(stage.effective, stage.rho)
    rank = np.linalg.matrix_rank(equations.H[0, 0], hermitian=True)
    freedom = max(float(equations.count[0, 0]) - (2.0 - _FOURTH_POWERS) * rank, 1.0)
    noise = np.sqrt(np.sum(np.square(linear.residual(linear.x))) / freedom)
    return float(max(noise, linear.smallest_noise[0]))


def paper_system(problem: Problem, nominal: Array, unit: Array, X: Array) -> tuple[Array, Array]:
    """The paper's error e_i = |r_i|^2 of N points and its Jacobian, as a solver takes them.

    Args:
        problem: Rows of points.
        nominal: shape (p,), absolute values from which the parameters x are offsets [m, rad].
        unit: shape (p,), 1000 for lengths, 1 for angles.
        X: shape (p,), absolute parameters (nominal + x) unit [mm, rad].

    Returns:
        e, shape (N,), [mm^2], and de/dX, shape (N, p).
    """
    x = X / unit - nominal
    residual = _MM * problem.linear(x).residual(x) * problem.rows.scales
    jacobian = _MM * problem.jacobian(x) / unit
    error = np.sum(residual**2, axis=1)
    return error, -2.0 * np.einsum("ij,ijk->ik", residual, jacobian)
