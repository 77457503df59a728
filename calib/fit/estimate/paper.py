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
from calib.fit.estimate.linear import LinearProblem
from calib.fit.estimate.prior_terms import PriorTerms
from calib.fit.estimate.problem import Problem
from calib.fit.estimate.stages import Stage
from calib.fit.estimate.task import Task
from calib.fit.registration.setup import Setup
from calib.model.parameters import ErrorModel
from calib.numerics.solvers import Solution, paper_levenberg_marquardt

#: Covariance of the estimator that minimises fourth powers over that of least squares, for normal noise in 3-D.
_FOURTH_POWERS = 1.4

#: Millimetres in a metre.
_MM = 1e3


def paper_estimate(problem: Problem, task: Task, registered: Setup) -> Estimate:
    """Estimate the parameters by the paper's algorithm: the least sum of |r_i|^4 over the residuals r_i of points.

    All points count alike, and there are no priors.

    Args:
        problem: The least-squares problem before any estimate: N rows of measurements, and the robot as a function of p
            parameters, which are offsets [m, rad] from the nominal robot and the registered target.
        task: Robot, cell and options of the fit; its priors, bounds and weights have no part in it.
        registered: Measurement frames and targets at the start of the fit, from where their parameters count.

    Returns:
        The estimated parameters as offsets [m, rad], with covariance, noise (a multiple of the given sigma) and scores;
        every row has the weight 1.

    Raises:
        ModelError: Rows other than points, or several targets.
        SolverError: The residual is not finite at the start.
    """
    _check_rows(problem, registered)
    model = problem.kinematics.model
    solution = _solution(problem, _nominal_values(model, registered))
    stage = _stage_without_priors(problem, task, registered)
    noise = _noise(problem.linear(solution.x), stage)
    stage = replace(stage, noise=np.array([[noise]]))
    return estimate_at_stage(problem, stage, solution, covariance_factor=_FOURTH_POWERS)


def _check_rows(problem: Problem, registered: Setup) -> None:
    """Raise `ModelError` where the paper's algorithm does not apply.

    Args:
        problem: Its rows must be measured positions (points) alone.
        registered: The setup, which must have one target.

    Raises:
        ModelError: Rows other than points, or several targets.
    """
    only_points = all(kind.name == "point" for kind in problem.rows.present)
    if not only_points or len(registered.targets) > 1:
        raise ModelError("The solver 'paper' takes positions of one target. Choose --solver lm.")


def _solution(problem: Problem, nominal: Array) -> Solution:
    """Minimise the sum of |r_i|^4 over the residuals r_i of points, at absolute parameters in mm and rad.

    The solver sees e_i = |r_i|^2 [mm^2] as its residual, so that its cost is 1/2 sum_i |r_i|^4.

    Args:
        problem: The least-squares problem of N points and p parameters, whose weights and priors do not count.
        nominal: shape (p,), absolute values from which the parameters are offsets [m, rad]; the solve begins there.

    Returns:
        The solver's result; its x, shape (p,), are offsets [m, rad] again, its cost is in mm^4.
    """
    parameters = problem.kinematics.model.parameters
    unit = np.array([_MM if parameter.unit == "m" else 1.0 for parameter in parameters])
    system = partial(paper_system, problem, nominal, unit)
    absolute = paper_levenberg_marquardt(system, nominal * unit)
    return replace(absolute, x=absolute.x / unit - nominal)


def _stage_without_priors(problem: Problem, task: Task, registered: Setup) -> Stage:
    """The state of a fit in which each row has weight 1, the noise is as given, and only weak priors count.

    Args:
        problem: The least-squares problem of N rows and p parameters.
        task: The fit's task; its cell's priors and bounds are left out.
        registered: Measurement frames and targets at the start of the fit.

    Returns:
        One fit (B = 1): row weights 1, shape (1, N); noise 1 (the given sigma) of each of C instruments, shape (1, C);
        and priors of standard deviation 1 in each parameter's unit.
    """
    cell = replace(task.cell, priors=Priors("off"), bounds={}, parameter_priors={})
    without_priors = replace(task, cell=cell, allow_absent=True)
    prior = PriorTerms.of(without_priors, problem.kinematics.model, registered)
    every_row = np.ones((1, len(problem.rows)), dtype=bool)
    return Stage.initial(prior, every_row, len(problem.smallest_noise))


def _nominal_values(model: ErrorModel, registered: Setup) -> Array:
    """Absolute values from which the parameters are offsets.

    Args:
        model: The p parameters: of the robot, each with its nominal value (``nominal``: the DH table's, or 0), and of
            the target and frames, whose nominal value is 0 but for the target's position.
        registered: Frames and targets at the start of the fit; the first target's position in the tip [m], is the
            nominal value of ``target_x``, ``target_y`` and ``target_z``.

    Returns:
        shape (p,), [m] and [rad].
    """
    target = registered.T_tip_target[0, :3, 3]
    by_name = dict(zip(("target_x", "target_y", "target_z"), target, strict=True))
    values = [by_name.get(p.name, p.nominal) for p in model.parameters]
    return np.array(values)


def _noise(linear: LinearProblem, stage: Stage) -> float:
    """Noise of the points from the residuals where the sum of their fourth powers is least.

    The sum of squared residuals is expected to be sigma^2 (3 N - 3/5 rank), with the rank of the Jacobian.

    Args:
        linear: The problem of N points linearised at the solution: ``linear.residual(linear.x)``, shape (N, 3), in
            units of the given sigma; ``linear.smallest_noise``, noise that is mere rounding, likewise.
        stage: Weights of the points (B = 1), all 1.

    Returns:
        Standard deviation of one coordinate as a multiple of the given sigma; at least the smallest noise.
    """
    equations = linear.normal_equations(stage.effective, stage.rho)
    rank = np.linalg.matrix_rank(equations.H[0, 0], hermitian=True)
    scalars = float(equations.count[0, 0])
    freedom = max(scalars - (2.0 - _FOURTH_POWERS) * rank, 1.0)
    square = np.sum(np.square(linear.residual(linear.x)))
    noise = np.sqrt(square / freedom)
    return float(max(noise, linear.smallest_noise[0]))


def paper_system(problem: Problem, nominal: Array, unit: Array, X: Array) -> tuple[Array, Array]:
    """The paper's error e_i = |r_i|^2 of N points and its Jacobian, as a solver takes them.

    Args:
        problem: The least-squares problem of N rows of points, with residuals r_i measured minus predicted, and p
            parameters x, offsets from the nominal robot; its weights, noise and priors do not count.
        nominal: shape (p,), absolute values from which the parameters x are offsets [m, rad].
        unit: shape (p,), 1000 for lengths, 1 for angles.
        X: shape (p,), absolute parameters, (nominal + x) times ``unit`` [mm, rad].

    Returns:
        e, shape (N,), [mm^2], and de/dX, shape (N, p), [mm^2 per mm or rad].
    """
    x = X / unit - nominal
    residual = _MM * problem.rows.in_units(problem.linear(x).residual(x))
    jacobian = _MM * problem.jacobian(x) / unit
    error = np.sum(residual**2, axis=1)
    return error, -2.0 * np.einsum("ij,ijk->ik", residual, jacobian)
