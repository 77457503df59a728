"""The corrected URDF of a result, read back before it is written."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib.errors import ModelError, UrdfError, choices
from calib.identify.prediction import tip_poses
from calib.identify.result import Calibration
from calib.model.kinematics import Samples
from calib.model.readback import check_written, random_joint_values
from calib.model.robot import Robot
from calib.model.urdf import Urdf

Array = NDArray[np.float64]

#: Name of the link that carries the target in a corrected URDF, when asked for.
TARGET_LINK = "calib_target"


def checked_urdf(c: Calibration, *, target_link: bool = False) -> Urdf:
    """The corrected URDF, the geometry alone, read back with Pinocchio and yourdfpy.

    Args:
        c: The result.
        target_link: Whether to add a link ``calib_target`` at the target, fixed to the tip.

    Raises:
        UrdfError: A reader disagrees with the model in memory by more than 1e-9 m or rad.
        ModelError: Several targets, which one link cannot stand for.
    """
    robot = c.robot
    if target_link:
        if len(c.setup.targets) > 1:
            raise ModelError(
                f"There are {len(c.setup.targets)} targets, {choices(c.setup.targets)}; a target link can "
                "be written for one. Do without it."
            )
        robot = replace(robot, urdf=_with_target_link(robot, c.setup.T_tip_target[0]))
    q = random_joint_values(robot)
    # Straight from the parameters, by the path that the fit took, not through the corrected robot.
    check_written(robot, tip_poses(c, Samples.at(q)), q)
    return robot.urdf


def _with_target_link(robot: Robot, T_tip_target: Array) -> Urdf:
    """The robot's URDF with a link at the target; one that an earlier calibration added is moved there."""
    if TARGET_LINK not in robot.urdf.links:
        return robot.urdf.with_link(TARGET_LINK, robot.tip, T_tip_target)
    joint = next(joint for joint in robot.urdf.joints if joint.child == TARGET_LINK)
    if joint.parent != robot.tip or joint.type != "fixed":
        raise UrdfError(
            f"The URDF has a link '{TARGET_LINK}' already, and it is not fixed to the tip '{robot.tip}' but hangs on "
            f"'{joint.parent}' by a joint of type '{joint.type}'. Rename it, or do without the target link."
        )
    return robot.urdf.with_origins({joint.name: T_tip_target})
