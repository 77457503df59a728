"""Line of sight: whether a tracker measures a target at a pose, by its range and the reflector's cone."""

from __future__ import annotations

import numpy as np

from calib.basics.arrays import Array, Mask
from calib.data.cell import Reflector, Tracker
from calib.robot.robot import Robot


def target_positions(robot: Robot, T_tip_target: Array, q: Array) -> Array:
    """Predict where a target is in the base, by the nominal robot.

    Args:
        robot: The nominal robot; ``robot.poses(q)`` is the pose of its tip in its base, shape (N, 4, 4), [m].
        T_tip_target: Pose of the target in the tip, shape (4, 4), [m]; its orientation does not matter.
        q: Joint values of N poses, shape (N, m), [rad] or for sliding joints [m], columns as ``robot.joint_names``.

    Returns:
        Positions in the robot's base, shape (N, 3), [m].
    """
    return np.asarray((robot.poses(q) @ T_tip_target)[:, :3, 3])


def in_range(robot: Robot, T_tip_target: Array, tracker: Tracker, q: Array) -> Mask:
    """Test whether a tracker can measure a target at its distance.

    Args:
        robot: The nominal robot.
        T_tip_target: Pose of the target in the tip, shape (4, 4), [m]; its orientation does not matter.
        tracker: A laser tracker: ``position`` in the robot's base, shape (3,), and ``nearest`` and ``farthest``, the
            least and the largest distance that it measures [m].
        q: Joint values of N poses, shape (N, m), [rad] or for sliding joints [m], columns as ``robot.joint_names``.

    Returns:
        True where the distance is within the tracker's range, both ends included, shape (N,).
    """
    towards = tracker.position - target_positions(robot, T_tip_target, q)
    distance = np.linalg.norm(towards, axis=1)
    return np.asarray((distance >= tracker.nearest) & (distance <= tracker.farthest))


def in_cone(
    robot: Robot,
    T_tip_target: Array,
    tracker: Tracker,
    reflector: Reflector,
    q: Array,
) -> Mask:
    """Test whether the tracker is in the cone from which a reflector is seen.

    The angle from the reflector's normal to the direction from the target to the tracker must be at most its
    acceptance.

    Args:
        robot: The nominal robot.
        T_tip_target: Pose of the target, the reflector's centre, in the tip, shape (4, 4), [m]; its orientation does
            not matter.
        tracker: A laser tracker; ``position`` is in the robot's base, shape (3,), [m].
        reflector: ``normal``, the unit vector in the tip along which its opening faces, shape (3,), and ``acceptance``,
            the half angle of its cone [rad].
        q: Joint values of N poses, shape (N, m), [rad] or for sliding joints [m], columns as ``robot.joint_names``.

    Returns:
        True where the tracker is in the reflector's cone, shape (N,).
    """
    towards = tracker.position - target_positions(robot, T_tip_target, q)
    normal = robot.poses(q)[:, :3, :3] @ reflector.normal
    across = np.linalg.norm(np.cross(normal, towards), axis=1)
    along = np.einsum("ni,ni->n", normal, towards)
    return np.asarray(np.arctan2(across, along) <= reflector.acceptance)
