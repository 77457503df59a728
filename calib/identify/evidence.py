"""What the verdict looks at besides errors: accidents among the validation rows, joints that stood still, runaways."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calib.identify.statistics import Errors, Mask
from calib.model.error_model import ANGLE, LENGTH, ErrorModel
from calib.model.robot import Robot

Array = NDArray[np.float64]

#: A joint that moves less than this over the rows tells little of itself [rad, m].
_STILL_RAD, _STILL_M = 0.35, 0.05

#: A share of validation rows up to which those that do not fit are set aside as accidents.
_FEW_SUSPECTS = 0.15


def validation_errors(
    validation: Mask, suspects: Mask, nominal: Array, calibrated: Array
) -> tuple[Errors, Errors, int]:
    """Errors on the validation rows, before and after, without suspects if they are few, and how many those are.

    One wild row would decide the comparison; many of them are no accidents but a robot that is not met.

    Args:
        validation: shape (N,), which rows validate.
        suspects: shape (N,), which of them the calibrated robot does not explain.
        nominal: shape (N, 3), residual of the nominal robot [m].
        calibrated: shape (N, 3), of the calibrated one [m].
    """
    few = np.sum(suspects) <= max(1, int(_FEW_SUSPECTS * np.sum(validation)))
    aside = (
        suspects & validation if few and np.any(validation & ~suspects) else np.zeros_like(suspects)
    )
    chosen = validation & ~aside
    return Errors.of(nominal[chosen]), Errors.of(calibrated[chosen]), int(np.sum(aside))


def still_joints(robot: Robot, joints: Array) -> tuple[str, ...]:
    """Joints that the rows hardly move, each with how far, in words.

    Args:
        robot: The robot.
        joints: shape (N, n), [rad] or [m].
    """
    words = []
    for joint, span in zip(robot.joints, np.ptp(joints, axis=0), strict=True):
        slides = joint.type == "prismatic"
        if span < (_STILL_M if slides else _STILL_RAD):
            amount = f"{1e3 * span:.0f} mm" if slides else f"{np.degrees(span):.0f} deg"
            words.append(f"'{joint.name}' ({amount})")
    return tuple(words)


def largest_change(model: ErrorModel, x: Array) -> float:
    """The largest change of a parameter of the robot itself, target and frame aside [m or rad]."""
    own = model.family(LENGTH) | model.family(ANGLE)
    return float(np.max(np.abs(x[own]), initial=0.0))
