"""Universal Robots' own files into robots and back: ``calibration.conf`` and ``kinematics.yaml``."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calib.compensate.ur_models import UrModel
from calib.model.robot import Robot

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class UrSource:
    """What a file of Universal Robots says about an arm.

    Attributes:
        nominal: The arm as the data sheet has it: the robot given, or a bare one, ``base`` to ``tool0``.
        robot: The same chain, calibrated.
        hash: The ROS driver's name for the calibration, ``"calib_..."``; None where the yaml has none.
        model: Which arm it is.
        remarks: Sentences about what was read that its reader should know; most often none.
    """

    nominal: Robot
    robot: Robot
    hash: str | None
    model: UrModel
    remarks: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class UrWritten:
    """What was written, and what the file cannot hold.

    With the file's own kinematics K(q) from the controller's base to its flange, the arm is T_base K(q) T_tool.

    Attributes:
        path: The file.
        T_base: shape (4, 4), [m]: a displacement of the base that the file cannot hold; the identity if there is none.
        T_tool: shape (4, 4), [m]: the same of the flange, behind the last joint.
        remarks: What to tell the user about both and about what to do next, sentence by sentence.
    """

    path: Path
    T_base: Array
    T_tool: Array
    remarks: tuple[str, ...]


def read_ur_conf(
    path: str | os.PathLike[str],
    *,
    urcontrol: str | os.PathLike[str] | None = None,
    model: str | None = None,
    robot: Robot | None = None,
) -> UrSource:
    """The arm that a ``calibration.conf`` describes.

    Args:
        path: The file, with the deltas in ``[mounting]``.
        urcontrol: A ``urcontrol.conf`` with the nominal rows in ``[DH]``; default: those of the model.
        model: Name of the arm, such as ``"UR5e"``; default: what urcontrol or the robot is recognised as.
        robot: The nominal robot whose URDF is corrected; default: a bare one, see `ur_robot`.

    Raises:
        FileError: A file cannot be read, or its numbers are not those of a calibration of this arm.
        ModelError: The model is not known, or is not that of the robot, or is not given.
    """
    raise NotImplementedError


def read_ur_yaml(
    path: str | os.PathLike[str], *, model: str | None = None, robot: Robot | None = None
) -> UrSource:
    """The arm that a ``kinematics.yaml`` of the ROS driver describes.

    Args:
        path: The file.
        model: Name of the arm, such as ``"UR5e"``; default: what the robot is recognised as, or else the arm that the
            file's lengths are nearest to.
        robot: The nominal robot whose URDF is corrected; default: a bare one, see `ur_robot`.

    Raises:
        FileError: The file cannot be read, or its numbers are not those of a calibration of this arm.
        ModelError: The model is not known, or is not that of the robot.
    """
    raise NotImplementedError


def write_ur_yaml(
    robot: Robot,
    nominal: Robot,
    path: str | os.PathLike[str],
    *,
    hash: str,  # noqa: A002
    overwrite: bool = False,
) -> UrWritten:
    """Write a robot as the ``kinematics.yaml`` that the ROS driver and Universal Robots' description take.

    Args:
        robot: The calibrated robot.
        nominal: The same chain with the arm's nominal kinematics.
        path: File to write.
        hash: The robot's own, see `read_ur_hash`: the driver compares it with what the controller reports.
        overwrite: Whether a file that exists may be replaced.

    Raises:
        ModelError: The nominal robot is not a Universal Robots arm.
        FileError: The file cannot be written, or the hash is none.
    """
    raise NotImplementedError


def write_ur_conf(
    robot: Robot,
    nominal: Robot,
    path: str | os.PathLike[str],
    *,
    update: str | os.PathLike[str] | None = None,
    model: str | None = None,
    overwrite: bool = False,
) -> UrWritten:
    """Write a robot as the DH deltas of a ``calibration.conf``.

    Args:
        robot: The calibrated robot.
        nominal: The same chain with the arm's nominal kinematics.
        path: File to write.
        update: A ``calibration.conf`` whose other lines are kept; default: the deltas alone.
        model: Name of the arm, where the nominal robot's kinematics are those of several.
        overwrite: Whether a file that exists may be replaced.

    Raises:
        ModelError: The nominal robot is not a Universal Robots arm.
        FileError: A file cannot be read or written.
    """
    raise NotImplementedError


def read_ur_hash(
    path: str | os.PathLike[str],
    *,
    urcontrol: str | os.PathLike[str] | None = None,
    model: str | None = None,
) -> str:
    """The hash of a robot's own ``kinematics.yaml`` or ``calibration.conf``: what its controller's calibration is called.

    Args:
        path: The file; one that ends in ``.conf`` needs ``urcontrol`` or ``model``.
        urcontrol: A ``urcontrol.conf`` with the nominal rows.
        model: Name of the arm, such as ``"UR5e"``.

    Raises:
        FileError: The file cannot be read or has no hash.
        ModelError: The model is not known or not given.
    """
    raise NotImplementedError
