"""Workspace: where a target lies when the joints take all their values equally often (the paper, section 4.3)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from calib.numerics.geometry import vector
from calib.robot.ranges import joint_ranges
from calib.robot.robot import Robot
from calib.units import Array

#: Samples by default, a power of two.
COUNT = 2**17

#: Samples whose poses are computed at once, a power of two.
_CHUNK = 2**15


def workspace(
    robot: Robot,
    target: ArrayLike = (0.0, 0.0, 0.0),
    ranges: ArrayLike | None = None,
    count: int = COUNT,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Array:
    """Sample where a target lies when the joints take all their values equally often.

    Joint values are drawn evenly by a scrambled Sobol sequence.

    Args:
        robot: The robot.
        target: shape (3,), the target in the tip [m].
        ranges: shape (m, 2), lowest and highest value of each joint [rad] or [m]; None: those of
            `calib.robot.readback.joint_ranges`.
        count: Number of samples; a power of two is spread the most evenly.
        seed: The same seed gives the same points.
        progress: Called with the samples done and all.

    Returns:
        Positions of the target in the base frame [m], shape (count, 3), read-only.
    """
    # Not above: SciPy's distributions take as long to import as the rest of calib.
    from scipy.stats import qmc

    p_tip_target = vector(target, "target's position in the tip")
    limits = joint_ranges(robot) if ranges is None else np.asarray(ranges)
    low, high = limits.T
    sequence = qmc.Sobol(len(low), scramble=True, seed=np.random.default_rng(seed))
    points = np.empty((count, 3))
    for start in range(0, count, _CHUNK):
        # The first piece is a power of two long, as SciPy asks.
        unit = sequence.random(_CHUNK)[: count - start]
        T_base_tip = robot.poses(low + unit * (high - low))
        positions = T_base_tip[:, :3, :3] @ p_tip_target + T_base_tip[:, :3, 3]
        points[start : start + _CHUNK] = positions
        if progress is not None:
            progress(start + len(unit), count)
    points.setflags(write=False)
    return points
