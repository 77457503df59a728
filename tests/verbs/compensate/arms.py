"""Robots whose true geometry is known, and results of calibrations of them."""

from __future__ import annotations

import numpy as np

from calib.model.parameter_sets import error_model
from calib.robot.robot import Robot

#: Errors of real arms: half a millimetre, two milliradians.
LENGTH, ANGLE = 0.5e-3, 2e-3


def off(robot: Robot, seed: int = 1, model: str = "placement", size: float = 1.0) -> Robot:
    """The robot with errors drawn, in all its placements that a URDF holds."""
    errors = error_model(robot, model, target=False)
    stds = np.where(np.array(errors.units) == "m", LENGTH, ANGLE) * size
    return errors.apply(robot, np.random.default_rng(seed).normal(size=len(errors)) * stds)


def turned(seed: int, size: float = 0.4) -> np.ndarray:
    """A pose, drawn."""
    import pinocchio as pin

    return pin.exp6(np.random.default_rng(seed).uniform(-size, size, 6)).homogeneous
