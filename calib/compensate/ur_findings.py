"""What is to be said of an arm's calibration: of a robot that is not nominal, and of what a file has no place for."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib.compensate.ur_dh import ROUNDING, FullDH
from calib.compensate.ur_models import UrModel
from calib.compensate.ur_mount import Mount
from calib.model.robot import Robot, read_only

Array = NDArray[np.float64]

#: Decimals of mm and mrad in which 1e-9 m and rad can be seen.
_DECIMALS = 6

#: A d is longer than an arm where a common normal stands far away [m].
_LONG = 10.0


def name_remark(robot: Robot, arm: UrModel, mounted: Mount) -> tuple[str, ...]:
    """A sentence about a robot that is not nominal, whose base and flange were found by name."""
    if mounted.off == mounted.turned == 0.0:
        return ()
    return (
        f"'{robot.name}' ({robot.urdf.source}) is not the nominal {arm.name}: its flange lies up to "
        f"{1e3 * mounted.off:.2g} mm and {1e3 * mounted.turned:.2g} mrad off, because it was calibrated before or its "
        "numbers are rounded. Its base and its flange are taken to be where the names of its links say.",
    )


def rows_remark(rows: FullDH, missed: float) -> str:
    """Why rows hold a robot less well than usual: ``missed`` [m and rad]."""
    longest = float(np.abs(rows.d).max())
    if longest > _LONG:
        reason = f"d is {longest:.2g} m where two axes are almost parallel, and no more digits fit"
    else:
        reason = "two axes that are less than 0.01 microradians from parallel are taken as parallel"
    return f"The rows hold the robot to {missed:.1e} m: {reason}."


def status_remark(path: str | os.PathLike[str], status: str) -> tuple[str, ...]:
    """A sentence about a calibration that the controller does not use; ``status`` is empty for one that it does."""
    if not status:
        return ()
    return (
        f"{path} has calibration_status = {status}, which is not 2, linearised: the controller may not use these "
        "deltas. They were taken as they are; check that the robot is calibrated.",
    )


def tidy(T: Array) -> Array:
    """A displacement, the identity where it is rounding."""
    return read_only(np.eye(4) if np.abs(T - np.eye(4)).max() < ROUNDING else T)


def base_remark(path: Path, T: Array) -> tuple[str, ...]:
    """What to do with a displacement of the base."""
    lies = _displacement(T)
    if not lies:
        return ()
    return (
        f"Not in {path}: the first axis lies {lies}, along and about the axes of the controller's base "
        "(link 'base'), from where the base has it, and DH rows begin on it. To put this right move the frame that "
        "poses are given in: T_base_frame becomes T_base^-1 T_base_frame, where T_base is this displacement.",
    )


def tool_remark(path: Path, T: Array) -> tuple[str, ...]:
    """What to do with a displacement of the flange."""
    lies = _displacement(T)
    if not lies:
        return ()
    return (
        f"Not in {path}: the flange lies {lies}, along and about the axes of the controller's flange "
        "(link 'tool0'), from where the last joint has it, and there is no place for that behind the joint. To put "
        "this right add it to the tool: T_flange_tcp becomes T_tool T_flange_tcp, where T_tool is this displacement.",
    )


def _displacement(T: Array) -> str:
    """A small displacement in words: x, y, z in mm and the rotation vector in mrad; empty below 1e-9 m and rad."""
    vectors = (T[:3, 3], pin.log3(T[:3, :3]))
    # Rounded first, so that nothing is said to be -0.
    rounded = [
        [round(1e3 * float(value), _DECIMALS) + 0.0 for value in vector] for vector in vectors
    ]
    if not any(map(any, rounded)):
        return ""
    shift, turn = (", ".join(f"{value:.{_DECIMALS}f}" for value in vector) for vector in rounded)
    return f"({shift}) mm and ({turn}) mrad"
