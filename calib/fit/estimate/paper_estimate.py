"""The paper's estimate: Levenberg-Marquardt on squared errors in mm^2, at absolute parameters, without priors.

It minimises the sum of |r_i|^4 over the residuals r_i of points; then the expected sum of squared residuals is
sigma^2 (3 N - 3/5 rank), with the rank of the Jacobian.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from calib.basics.arrays import Array
from calib.data.cell import Priors
from calib.errors import ModelError
from calib.fit.estimate.estimate import Estimate, estimate_at_stage
from calib.fit.estimate.prior_terms import PriorTerms
from calib.fit.estimate.problem import Problem
from calib.fit.estimate.stages import Stage
from calib.fit.estimate.task import Task
from calib.fit.registration.setup import Setup
from calib.numerics.solvers import paper_levenberg_marquardt

#: Covariance of the estimator that minimises fourth powers over that of least squares, for normal noise in 3-D.
_FOURTH_POWERS = 1.4

#: Millimetres in a metre.
_MM = 1e3


def paper_start(setup: Setup) -> Setup:
    """Return the setup to register for the paper's start: all targets are fixed where they were given, if all were."""
    keep = np.full(len(setup.targets), bool(np.all(setup.target_given)))
    return setup.with_fixed(np.zeros(len(setup.groups), dtype=bool), keep)


def paper_estimate(problem: Problem, task: Task, registered: Setup) -> Estimate:
    """Estimate the parameters by the paper's algorithm: the least sum of |r_i|^4 over the residuals r_i of points.

    All points count alike, and there are no priors and bounds.

    Args:
        problem: The least-squares problem before any estimate.
        task: The fit.
        registered: Measurement frames and targets at the start of the fit, from where their parameters count.

    Returns:
        The estimate, of which all rows have the weight 1 and which has no prior standard deviations.

    Raises:
        ModelError: Rows other than points, or several targets.
        SolverError: The residual is not finite at the start.
    """
    only_points = all(kind.name == "point" for kind in problem.rows.present)
    if not only_points or len(registered.targets) > 1:
        raise ModelError("The solver 'paper' takes positions of one target. Choose --solver lm.")

    # Absolute values from which the parameters are offsets: those of the DH table; those of target and frames are 0,
    # except for the target's position.
    parameters = problem.kinematics.model.parameters
    position = registered.T_tip_target[0, :3, 3]
    target = dict(zip(("target_x", "target_y", "target_z"), position, strict=True))
    nominal = np.array([target.get(p.name, p.nominal) for p in parameters])
    unit = np.array([_MM if parameter.unit == "m" else 1.0 for parameter in parameters])
    system = partial(paper_system, problem, nominal, unit)
    absolute = paper_levenberg_marquardt(system, nominal * unit)
    solution = replace(absolute, x=absolute.x / unit - nominal)

    cell = replace(task.cell, priors=Priors("off"), bounds={}, parameter_priors={})
    without_priors = replace(task, cell=cell, allow_absent=True)
    prior = PriorTerms.of(without_priors, problem.kinematics.model, registered)
    every_row = np.ones((1, len(problem.rows)), dtype=bool)
    stage = Stage.initial(prior, every_row, len(problem.smallest_noise))

    # The noise: the sum of squares is expected to be sigma^2 (3 N - 3/5 rank).
    linear = problem.linear(solution.x)
    equations = linear.normal_equations(stage.effective, stage.stop_shares)
    rank = np.linalg.matrix_rank(equations.H[0, 0], hermitian=True)
    scalars = float(equations.count[0, 0])
    freedom = max(scalars - (2.0 - _FOURTH_POWERS) * rank, 1.0)
    square = np.sum(np.square(linear.residual(linear.x)))
    noise = max(np.sqrt(square / freedom), linear.smallest_noise[0])
    stage = replace(stage, noise=np.array([[noise]]))
    return estimate_at_stage(problem, stage, solution, covariance_factor=_FOURTH_POWERS)


def paper_system(problem: Problem, nominal: Array, unit: Array, X: Array) -> tuple[Array, Array]:
    """The paper's error e_i = |r_i|^2 of N points and its Jacobian, as a solver takes them.

    The solver's cost is then 1/2 sum_i |r_i|^4.

    Args:
        problem: The least-squares problem, whose weights, noise and priors do not count.
        nominal: shape (p,), absolute values from which the parameters x are offsets [m, rad].
        unit: shape (p,), 1000 for lengths, 1 for angles.
        X: shape (p,), absolute parameters, (nominal + x) times ``unit`` [mm, rad].

    Returns:
        e, shape (N,), [mm^2], and de/dX, shape (N, p), [mm^2 per mm or rad].
    """
    x = X / unit - nominal
    residual = _MM * problem.rows.in_units(problem.linear(x).residual(x))
    jacobian = _MM * problem.prediction_jacobian(x) / unit
    error = np.sum(residual**2, axis=1)
    return error, -2.0 * np.einsum("ij,ijk->ik", residual, jacobian)
