"""Measurements that the robot's controller computed: their residuals are nothing but the rounding of the table.

Positions from a pendant or a controller's interface are forward kinematics of the joint values beside them. A fit to
them finds the controller's own model, however wrong that is of the arm, and held-out rows agree. With steps g of the
coordinates and g_j of the joint values (the last decimal that the table has), and the derivative J_j of a coordinate
by a joint value, rounding alone leaves the variance

    r^2 = (g^2 + mean of sum_j (J_j g_j)^2) / 12

A real measurement has the errors of the instrument and of the robot's repeatability as well.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.special import chdtri

from calib.basics.arrays import Array
from calib.diagnosis.augmented_fit import FEWEST_FREEDOM, UNLIKELY, nominal_under
from calib.diagnosis.reasons import Reason, Why
from calib.fit.estimate.fitting import Fitted

#: Decimals of a table, in its units: 10 to the power of minus these.
_DECIMALS = 10.0 ** -np.arange(8.0)

#: Values are multiples of a step if they are so within this share of it.
_ON_GRID = 1e-5

#: A joint with fewer different values has no rounding that differs from row to row.
SOME_VALUES = 4

#: With coarser rounding, good instruments leave no more either [m].
_COARSE = 30e-6

#: Noise below this is rounding, in which any test finds patterns: no arm repeats a pose, and no instrument measures it,
#: as closely [m, rad].
ROUNDING_NOISE = 1e-6


def computed_measurements(fitted: Fitted) -> Iterator[Reason]:
    """Yield a reason if the residuals of measured positions are no larger than the rounding of the table.

    Joint values may be rounded too, or be commanded ones that are exact.

    Args:
        fitted: A fit, its noise estimated from the residuals.

    Yields:
        The reason with the noise of a coordinate and its rounding [m].
    """
    rows, freedom = fitted.estimate.problem.rows, fitted.estimate.freedom
    positions = rows.where(lambda kind: kind.position)
    if freedom < FEWEST_FREEDOM or not np.all(positions):
        return
    noise = float(np.median(fitted.estimate.problem.scales[:, :3]))
    of_coordinates = largest_step(rows.measured[:, :3], _DECIMALS, _ON_GRID) ** 2 / 12.0
    of_both = of_coordinates + _by_joints(fitted)

    # Squares of noise over rounding that are likely if there is nothing else: chi-square over its freedom.
    low, high = chdtri(freedom, [1.0 - UNLIKELY, UNLIKELY]) / freedom
    fits_coordinates = noise**2 < max(high * of_coordinates, ROUNDING_NOISE**2)
    fits_both = low * of_both < noise**2 < high * of_both
    rounding = float(np.sqrt(of_coordinates if fits_coordinates else of_both))
    if (fits_coordinates or fits_both) and rounding < _COARSE:
        yield Reason.of(Why.MEASUREMENTS_COMPUTED, noise_m=noise, rounding_m=rounding)


def _by_joints(fitted: Fitted) -> float:
    """Return the variance of a measured coordinate by the rounding of joint values, mean over rows and axes [m^2]."""
    rows, robot = fitted.estimate.problem.rows, fitted.task.robot
    nominal = nominal_under("zeros", fitted)
    names, zero = nominal.model.names, np.zeros(len(nominal.model))
    columns = rows.derivative(nominal.linearised(zero, rows.samples))[:, :3]
    total = 0.0
    for joint, q in zip(robot.inputs, rows.joints.T, strict=True):
        name = f"{joint.name}.zero"
        if name in names and len(np.unique(q)) >= SOME_VALUES:
            steps = _DECIMALS
            if joint.type != "prismatic":
                steps = np.concatenate([_DECIMALS, np.radians(1.0) * _DECIMALS])
            by_step = columns[:, :, names.index(name)] * largest_step(q, steps, _ON_GRID)
            total += float(np.mean(by_step**2)) / 12.0
    return total


def largest_step(values: Array, steps: Array, within: float) -> float:
    """Return the largest step of which all values are multiples, in their unit; 0 if there is none.

    Args:
        values: Of any shape.
        steps: Steps to try, shape (k,), in the same unit.
        within: Share of a step by which values may miss its multiples.
    """
    for step in np.sort(steps)[::-1].tolist():
        multiples = values / step
        if np.all(np.abs(multiples - np.round(multiples)) < within):
            return float(step)
    return 0.0
