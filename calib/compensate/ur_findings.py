"""What is to be said of an arm's calibration: how far it moves the flange, and what a file has no place for."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib.compensate.ur_dh import COLUMNS, ROUNDING, FullDH, chain_poses
from calib.compensate.ur_models import MODELS, TOLERANCE, Mount, UrModel
from calib.errors import FileError, choices
from calib.model.robot import Robot, read_only

Array = NDArray[np.float64]

#: No calibration moves a flange further than the one [m], the file is of another type of arm; the other is odd.
FARTHEST, ODD = 0.2, 0.02

#: Beyond this it is worth looking whether the file fits another arm [m].
SUSPECT = 0.01

#: Sets of joint values that are compared, and the seed that they are drawn with: the same every time.
_POSES, _SEED = 200, 20170401


def same(rows: FullDH, others: FullDH) -> bool:
    """Whether two sets of rows are those of one type of arm."""
    return all(
        np.abs(getattr(rows, name) - getattr(others, name)).max() < TOLERANCE for name in COLUMNS
    )


def joint_values() -> Array:
    """Joint values within one turn, shape (200, 6), [rad], the same every time."""
    return np.random.default_rng(_SEED).uniform(-np.pi, np.pi, (_POSES, 6))


def distance_from(chain: Array, arm: UrModel) -> float:
    """How far the flange lies from that of the nominal arm, at most [m]."""
    q = joint_values()
    moved = chain_poses(chain, q)[:, :3, 3] - arm.nominal.poses(q)[:, :3, 3]
    return float(np.linalg.norm(moved, axis=1).max())


def checked_distance(path: str | os.PathLike[str], chain: Array, arm: UrModel) -> float:
    """How far the calibration moves the flange [m].

    Raises:
        FileError: So far that it is of another type of arm.
    """
    moved = distance_from(chain, arm)
    if moved > FARTHEST:
        message = (
            f"{path}: these kinematics put the flange up to {moved:.2f} m from where that of a nominal {arm.name} is; "
            f"a calibration moves it by millimetres. Check that the file is of a {arm.name}, in metres and radians."
        )
        raise FileError(message)
    return moved


def check_arm(
    path: str | os.PathLike[str], arm: UrModel, moved_by: Callable[[UrModel], float]
) -> None:
    """Refuse the calibration of an arm of another size.

    The deltas of an arm move its own flange by some millimetres, and that of another one by centimetres: what nearly
    parallel axes 2 and 3 do to each other cancels for the right length of the upper arm only.

    Args:
        path: The file.
        arm: The arm that it is said to be of.
        moved_by: How far the file moves the flange of an arm [m].

    Raises:
        FileError: It fits another arm.
    """
    moved = moved_by(arm)
    if moved <= SUSPECT:
        return
    by_arm = {one: moved_by(one) for one in MODELS}
    nearest = min(by_arm.values())
    if 3.0 * nearest < moved:
        names = [one.name for one, distance in by_arm.items() if distance <= 1.5 * nearest]
        message = (
            f"{path}: this calibration moves the flange of a {arm.name} by up to {1e3 * moved:.0f} mm, and that of "
            f"{choices(names)} by {1e3 * nearest:.1f} mm only. A calibration moves it by millimetres: the file is of "
            "another arm. Name the right one with --ur-model, or give its URDF."
        )
        raise FileError(message)


def odd(path: str | os.PathLike[str], moved: float, arm: UrModel) -> tuple[str, ...]:
    """A sentence about a calibration that moves the flange further than one does."""
    if moved < ODD:
        return ()
    return (
        f"{path} moves the flange by up to {1e3 * moved:.0f} mm from the nominal {arm.name}, more than calibrations "
        "do: check that it is of this arm.",
    )


def name_remark(robot: Robot, arm: UrModel, mounted: Mount) -> tuple[str, ...]:
    """A sentence about a robot that is not nominal, whose base and flange were found by name."""
    if mounted.off == 0.0:
        return ()
    return (
        f"'{robot.name}' ({robot.urdf.source}) is not the nominal {arm.name}: its flange lies up to "
        f"{1e3 * mounted.off:.2g} mm off, because it was calibrated before or its numbers are rounded. Its base and "
        "its flange are taken to be where the names of its links say.",
    )


def tidy(T: Array) -> Array:
    """A displacement, the identity where it is rounding."""
    return read_only(np.eye(4) if np.abs(T - np.eye(4)).max() < ROUNDING else T)


def base_remark(path: Path, T: Array) -> tuple[str, ...]:
    """What to do with a displacement of the base."""
    if not (T - np.eye(4)).any():
        return ()
    return (
        f"Not in {path}: the first axis lies {_displacement(T)} from where the base has it, and DH rows begin on it. "
        "To put this right move the frame that poses are given in by as much.",
    )


def tool_remark(path: Path, T: Array) -> tuple[str, ...]:
    """What to do with a displacement of the flange."""
    if not (T - np.eye(4)).any():
        return ()
    return (
        f"Not in {path}: the flange lies {_displacement(T)} from where the last joint has it, and there is no place "
        "for that behind the joint. To put this right add it to the tool: T_flange_tcp becomes T_tool T_flange_tcp.",
    )


def _displacement(T: Array) -> str:
    """A small displacement in words: x, y, z in mm and the rotation vector in mrad."""
    shift = ", ".join(f"{1e3 * value:.4f}" for value in T[:3, 3])
    turn = ", ".join(f"{1e3 * value:.4f}" for value in pin.log3(T[:3, :3]))
    return f"({shift}) mm and ({turn}) mrad"
