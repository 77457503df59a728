"""The nominal robot on the rows of a table: where frames and targets stand for it, and what it leaves over."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calib.identify.fitting import ENOUGH, nominal_setup, seen_from
from calib.identify.rows import Rows, thinned
from calib.identify.setup import Setup
from calib.identify.statistics import Mask
from calib.model.robot import Robot

Array = NDArray[np.float64]


def nominal_on(robot: Robot, setup: Setup, every: Rows, mask: Mask) -> tuple[Setup, Array]:
    """Frames and targets as given, or as the nominal robot registers them, and its residual on all rows.

    Args:
        robot: The nominal robot.
        setup: What is known.
        every: N rows.
        mask: shape (N,), the rows to register with.

    Returns:
        The set-up, and measured minus predicted, shape (N, D), [m] and [rad].
    """
    rows = thinned(every.select(mask), ENOUGH)
    placed = nominal_setup(robot.poses(rows.joints), setup, rows)
    return placed, residual_of(robot, placed, every)


def residual_of(robot: Robot, setup: Setup, rows: Rows) -> Array:
    """Measured minus what a robot predicts in a set-up, shape (N, D), [m] and [rad]."""
    return rows.residual(seen_from(setup, robot.poses(rows.joints), rows))
