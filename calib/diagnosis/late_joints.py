"""Joint values that belong to another time than the measurement, of an arm that moves while it is measured.

Row i is measured at the time t_i, and its joint values are those of t_i - tau. Along a path, on which an arm changes
direction little from row to row, the joints go about

    c_i = (q_(i+1) - q_(i-1)) / 2

in the time T between two rows, and the residual is J c_i s, with one share s = tau / T for all joints and rows. An arm
that creeps at each stop of a path, all joints alike, was moving too: its joint values are ahead (s < 0).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calib.basics.arrays import Array, Integers
from calib.diagnosis.augmented_fit import (
    FEWEST_FREEDOM,
    PREDICTS,
    UNLIKELY,
    estimate_jointly,
    gain_on_blocks,
)
from calib.diagnosis.computed import ROUNDING_NOISE
from calib.diagnosis.reasons import Reason, Why
from calib.diagnosis.residuals import displacements_of
from calib.fit.estimate.fitting import Fitted
from calib.numerics.errors import rms

#: Late joints share one delay: shares of their own would change its effect by less than this part of it, a quarter of
#: its square. Joints that lag each for itself, or have other errors, need shares that differ.
_ALIKE = 0.5


def late_joints(fitted: Fitted, q: Array, rows: Integers) -> Iterator[Reason]:
    """Say if the joint values of a moving arm are of another time than what was measured.

    Args:
        fitted: A fit of the geometry to N rows: a larger model may make up for the delay.
        q: Joint values of all rows of the table, in the order of the measured joints of the robot, shape (T, m), [rad]
            or [m].
        rows: Places of the N rows in the table, from 0, shape (N,).

    Yields:
        At most one reason: the delay as a share of the time from row to row, positive if the joint values are too old,
        the share by which it lowers the error of held-out blocks, and its effect on the measured scalars over that of
        all corrections of the arm.
    """
    problem, estimate = fitted.estimate.problem, fitted.estimate
    used, scales = problem.rows.used, problem.scales
    noise = np.median(scales[used])
    if len(q) < 3 or estimate.freedom < FEWEST_FREEDOM or noise < ROUNDING_NOISE:
        return

    # An arm on its way hardly changes direction from row to row; poses in any order do.
    way = np.gradient(q, axis=0)
    turn = np.diff(q, n=2, axis=0)
    if rms(turn) >= rms(way[1:-1]):
        return

    model, columns = displacements_of(fitted)
    joints, zeros = [], []
    for number, joint in enumerate(fitted.task.robot.inputs):
        if f"{joint.name}.zero" in model.names:
            joints.append(number)
            zeros.append(model.index(f"{joint.name}.zero"))
    # J c of each joint, (N, D, joints), and of all together, (N, D, 1).
    of_joints = columns[:, :, zeros] * way[rows][:, None, joints]
    of_all = np.sum(of_joints, axis=2, keepdims=True)
    with_one_share = estimate_jointly(fitted, of_all)
    if with_one_share.p_value(estimate.freedom) >= UNLIKELY:
        return

    by_one_share = of_all @ with_one_share.b
    by_own_shares = of_joints @ estimate_jointly(fitted, of_joints).b
    of_robot = fitted.kinematics.model.of_robot
    by_arm = problem.prediction_jacobian(estimate.x)[:, :, of_robot] @ with_one_share.x[of_robot]
    effect, difference, of_arm = (
        rms((by / scales)[used]) for by in (by_one_share, by_own_shares - by_one_share, by_arm)
    )
    if difference >= _ALIKE * effect:
        return

    falls = gain_on_blocks(fitted, of_all, estimate.weights)
    if falls >= PREDICTS:
        share = float(with_one_share.b[0])
        over_arm = effect / max(of_arm, np.finfo(float).tiny)
        yield Reason.of(Why.JOINTS_LATE, of_step=share, over_arm=over_arm, falls=falls)
