"""Sending poses: what a controller with the nominal model makes of them, and which pose to send so that it arrives.

The controller's own inverse kinematics q = q_nominal(T_send) is taken to stay near the joint values that it has for the
wanted pose. A robot without a redundant joint then comes to the joint values that were meant. One with a redundant
joint chooses where its elbow goes, and the pose is corrected for that choice, a few times over:

    T_send <- T_send exp(e),   e: what the true robot still misses, along the tool's axes
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib.compensate.inverse import Solved, solve
from calib.compensate.matching import POSE, Matching
from calib.compensate.pair import Pair
from calib.compensate.starts import Starts
from calib.measure.ranges import column_limits
from calib.model.robot import read_only

Array = NDArray[np.float64]

#: The nominal model differs from the true one by a hundredth at most, so that each time two digits are won.
_TIMES = 6

#: The length that an angle counts as with another controller [m].
_SHORT = 0.01

#: Below this there is nothing to correct [m].
_ENOUGH = 1e-12


def poses_to_send(
    pair: Pair, T_wanted: Array, starts: Starts, solved: Solved, matching: Matching
) -> tuple[Array, Array]:
    """The poses to send, and how far the true robot misses with what the controller makes of them.

    Args:
        pair: The two models.
        T_wanted: shape (N, 4, 4), poses of the tool in the base [m].
        starts: Joint values of the nominal robot, near which the controller stays.
        solved: Joint values that bring the true robot there.
        matching: What is matched.

    Returns:
        shape (N, 4, 4), in the base [m]; and shape (N, 2), position [m] and angle [rad].
    """
    controller, another = (Matching(POSE, lever) for lever in (pair.reach, _SHORT))
    limits = column_limits(pair.believed.robot)
    T_send = pair.believed.poses(solved.q)
    arrived = np.empty_like(T_send)
    rows = np.arange(len(T_send))
    for _ in range(_TIMES):
        q = solve(pair.believed, T_send[rows], starts.q[rows], controller, limits).q
        arrived[rows] = pair.true.poses(q)
        error = matching.error(arrived[rows], T_wanted[rows])
        elsewhere = np.abs(q - solved.q[rows]).max(axis=1) > _ENOUGH
        worth = elsewhere & (np.linalg.norm(error, axis=1) > _ENOUGH)
        if not (worth.any() and len(pair.believed.robot.joint_names) > controller.rows):
            break
        rows = rows[worth]
        T_send[rows] = T_send[rows] @ _steps(error[worth], matching)
    # Next to a singularity it is up to the controller where it ends: one that weighs angles otherwise may differ.
    q = solve(pair.believed, T_send, starts.q, another, limits).q
    misses = (matching.misses(T, T_wanted) for T in (arrived, pair.true.poses(q)))
    return T_send, read_only(np.maximum(*misses))


def _steps(error: Array, matching: Matching) -> Array:
    """The displacements that make errors good, shape (N, 4, 4), [m]; what is not matched stays."""
    twists = np.zeros((len(error), 6))
    twists[:, :3] = error[:, :3]
    twists[:, 3 : error.shape[1]] = error[:, 3:] / matching.lever
    return np.array([pin.exp6(twist).homogeneous for twist in twists]).reshape(-1, 4, 4)
