"""Fits of measured poses with covariances: what the instrument's errors are multiplied by, and what the robot adds.

See `calib.numerics.correlated_noise`. The fit at given noise of the poses, and this noise from the residuals of the
fit, are estimated in turn until they settle.

`fit` gives rows what errors of joints do to them (`with_joint_errors`), and calls `settle_pose_noise` on its estimate.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.basics.arrays import Array
from calib.fit.estimate.estimate import Estimate
from calib.fit.estimate.prior_terms import PriorTerms
from calib.fit.estimate.problem import Problem
from calib.fit.estimate.solving import estimate_within_bounds
from calib.fit.estimate.special_cases.stops import twists_of_joints
from calib.fit.estimate.stages import FEWEST_FREEDOM
from calib.fit.estimate.task import Task
from calib.fit.registration.rows import USUAL_POSE_NOISE, Rows
from calib.model.kinematics import Kinematics
from calib.numerics.correlated_noise import (
    POSE,
    compare_with_equal,
    likeliest_noise,
    standardisers,
)

#: The most rounds of noise and fit.
_ROUNDS = 8

#: Covariances whose relative change is less, in every direction, have settled.
_SETTLED = 0.1


def with_joint_errors(rows: Rows, kinematics: Kinematics) -> Rows:
    """Return rows with ``by_joints`` set, (N, 6, 6) [m^2, m, 1]; themselves if none has a covariance.

    It is J_q J_q^T, what independent errors of the joints that turn, of a radian each, do to the target's pose.
    """
    if not np.any(rows.correlated):
        return rows
    J = twists_of_joints(kinematics, rows.samples)
    return replace(rows, by_joints=J @ J.transpose(0, 2, 1))


def settle_pose_noise(
    estimate: Estimate, problem: Problem, task: Task, prior: PriorTerms
) -> Estimate:
    """Estimate the noise of measured poses that have covariances, and all parameters again, in turn until it settles.

    Args:
        estimate: The estimate within bounds, with the noise of poses as it is in the problem.
        problem: The least-squares problem.
        task: The fit.
        prior: Priors of the parameters, none of them held.

    Returns:
        The estimate, whose ``problem.rows.pose_noise`` is the estimated one; the given one if no row has a covariance,
        if the rows come with weights, or if fewer than `FEWEST_FREEDOM` degrees of freedom are left.

    Raises:
        SolverError: The residual is not finite at the start.
    """
    if not np.any(problem.rows.correlated) or problem.rows.weights is not None:
        return estimate
    for _ in range(_ROUNDS):
        evidence = _evidence(estimate)
        if evidence is None:
            break
        noise = likeliest_noise(*evidence, USUAL_POSE_NOISE)

        # The relative change of the rows' covariances in every direction.
        rows = problem.rows
        assert rows.covariances is not None
        assert rows.by_joints is not None
        given = rows.covariances[rows.correlated], rows.by_joints[rows.correlated]
        W = standardisers(rows.pose_noise.covariances(*given))
        relative = W @ noise.covariances(*given) @ W.transpose(0, 2, 1)
        change = np.max(np.abs(np.linalg.eigvalsh(relative) - 1.0))

        problem = problem.with_rows(replace(rows, pose_noise=noise))
        estimate = estimate_within_bounds(problem, task, prior)
        if change <= _SETTLED:
            break
    return estimate


def covariance_support(estimate: Estimate) -> tuple[float, float] | None:
    """Return what a fit's residuals say for the stated covariances of its poses; see `calib.numerics.correlated_noise`.

    Args:
        estimate: The estimate of a fit.

    Returns:
        Log-likelihood with the stated covariances less that with equal, uncorrelated errors in all rows
        (`compare_with_equal`), and what it would be if residuals were as the covariances and a usual robot say; None if
        no pose that counts has a covariance, or too few degrees of freedom are left.
    """
    evidence = _evidence(estimate)
    if evidence is None:
        return None
    stated, by_joints, squares, weights = evidence
    as_stated = USUAL_POSE_NOISE.covariances(stated, by_joints)
    return (
        compare_with_equal(stated, by_joints, squares, weights, USUAL_POSE_NOISE),
        compare_with_equal(stated, by_joints, as_stated, weights, USUAL_POSE_NOISE),
    )


def _evidence(estimate: Estimate) -> tuple[Array, Array, Array, Array] | None:
    """Return C [m^2, m rad, rad^2], J_q J_q^T [m^2, m, 1] and S [as C], (n, 6, 6) each, and weights, (n,), of n poses.

    C is the stated covariance, J_q J_q^T what errors of the joints do, and S the product r r^T of the residual plus the
    covariance of the prediction; see `calib.numerics.correlated_noise`. The poses have a covariance and a weight above
    0; None if there are none, or too few degrees of freedom are left.
    """
    problem = estimate.problem
    rows = problem.rows
    chosen = rows.correlated & (problem.weights > 0.0)
    if estimate.freedom < FEWEST_FREEDOM or not np.any(chosen):
        return None
    assert rows.covariances is not None
    assert rows.by_joints is not None
    J = problem.prediction_jacobian(estimate.x)[chosen, :POSE]
    r = problem.residual(estimate.x)[chosen, :POSE]
    spread = J @ estimate.covariance @ J.transpose(0, 2, 1)
    squares = r[:, :, None] * r[:, None] + spread
    return rows.covariances[chosen], rows.by_joints[chosen], squares, problem.weights[chosen]
