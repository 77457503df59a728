"""Workspace: where a target lies if the joints take all values in their ranges equally often (the paper, section 4.3).

`workspace_points` samples the positions; `workspace` finds the smallest region that holds a share of them.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from calib.basics.arguments import check_whole, finite_numbers
from calib.basics.arrays import Array
from calib.data.inputs import RobotInput, robot_of
from calib.numerics.geometry import position_in_tip
from calib.robot.ranges import joint_ranges, scrambled_sobol
from calib.robot.robot import Robot
from calib.verbs.workspace.region import Region

#: Samples by default, a power of two.
COUNT = 2**17

#: Samples whose poses are computed at once, a power of two.
_CHUNK = 2**15


def workspace(
    robot: RobotInput,
    target: ArrayLike = (0.0, 0.0, 0.0),
    ranges: ArrayLike | None = None,
    *,
    share: float = 0.95,
    voxel: float | None = None,
    count: int = COUNT,
    seed: int = 0,
) -> Region:
    """Return the smallest part of space that holds a target with a given probability.

    The joints take all values equally often, see `workspace_points`; the positions of the target are counted in voxels,
    see `calib.verbs.workspace.region.Density`.

    Args:
        robot: The robot, with m measured joints; or the path of its URDF or xacro, or its name such as ``"ur3"``, from
            the URDF's root to its farthest link.
        target: Position of the target in the tip, shape (3,), [m].
        ranges: Lowest and highest value of each joint, shape (m, 2), [rad] or for sliding joints [m], in the order of
            ``robot.joint_names``; None: those of `calib.robot.ranges.joint_ranges`.
        share: Probability that the target is in the region, greater than 0 and at most 1.
        voxel: Edge of a voxel [m]; None: chosen by the samples.
        count: Number of samples; a power of two is spread most evenly.
        seed: Seed of the samples: the same one gives the same region.

    Returns:
        The region.

    Raises:
        ArgumentError: An argument of another type.
        CalibError: Ranges of another shape, a share outside of that range, or too many voxels.
    """
    arm = robot_of(robot)
    points = workspace_points(arm, target, ranges, count, seed)
    return Region.of_points(points, share, voxel=voxel)


def workspace_points(
    robot: Robot,
    target: ArrayLike = (0.0, 0.0, 0.0),
    ranges: ArrayLike | None = None,
    count: int = COUNT,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Array:
    """Sample where a target lies if the joints take all values equally often, by a scrambled Sobol sequence.

    Args:
        robot: The robot, with m measured joints.
        target: Position of the target in the tip, shape (3,), [m].
        ranges: Lowest and highest value of each joint, shape (m, 2), [rad] or for sliding joints [m], in the order of
            ``robot.joint_names``; None: those of `calib.robot.ranges.joint_ranges`.
        count: Number of samples; a power of two is spread most evenly.
        seed: Seed of the sequence: the same one gives the same points.
        progress: Called with the number of samples done and of all; None: nothing is called.

    Returns:
        Positions of the target in the base frame, shape (count, 3), [m], read-only.

    Raises:
        ArgumentError: An argument of another type.
        CalibError: A target beyond any tool, ranges of another shape, a count below 1, or a seed below 0.
    """
    check_whole("count", count, 1)
    check_whole("seed", seed, 0)
    p_tip_target = position_in_tip(target, "target")
    limits = joint_ranges(robot)
    if ranges is not None:
        m = len(robot.inputs)
        limits = finite_numbers("ranges", ranges, (m, 2), f"of shape ({m}, 2), [rad] or [m]")
    low, high = limits.T
    points = np.empty((count, 3))
    starts = range(0, count, _CHUNK)
    own_seed = np.random.SeedSequence(seed).spawn(1)[0]  # another sequence than that of a plan
    for start, unit in zip(starts, scrambled_sobol(len(low), _CHUNK, own_seed), strict=False):
        end = min(start + _CHUNK, count)
        T_base_tip = robot.poses(robot.readings(low + unit[: end - start] * (high - low)))
        points[start:end] = T_base_tip[:, :3, :3] @ p_tip_target + T_base_tip[:, :3, 3]
        if progress is not None:
            progress(end, count)
    points.setflags(write=False)
    return points
