"""Where an arm's base and flange are in a URDF, by the names of its links: for one that is calibrated already.

A nominal arm is recognised by its axes to a micrometre. Those of a calibrated one do not say where its base and its
flange are, and no axes show an error of the first joint's zero and height or of the last one's: the names of Universal
Robots' descriptions do.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from calib.errors import UrdfError
from calib.model.robot import Robot, rigid_inverse

Array = NDArray[np.float64]

JOINTS = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)
"""The joints of Universal Robots' descriptions; a prefix may stand before them."""

#: Links that are the controller's base, and whether they are turned by half a turn about z against it.
_BASES = (("base_link_inertia", False), ("base", False), ("base_link", True))

#: Links that are its flange. In the old descriptions the last link is not.
_FLANGES = ("tool0", "wrist_3_link")

_HALF_TURN = np.diag([-1.0, -1.0, 1.0, 1.0])


def named_frames(robot: Robot) -> Iterator[tuple[Array, Array]]:
    """The controller's base in the robot's base and the robot's tip in the flange, as the links' names have them.

    Yields:
        T_base_arm and T_flange_tip, shape (4, 4) each, [m]: every pair that the names allow, the likeliest first: the
        robot's own base and tip, where these are among the names.
    """
    names = [joint.name for joint in robot.joints]
    prefix = names[0].removesuffix(JOINTS[0])
    if names != [prefix + joint for joint in JOINTS] or robot.joint_names != tuple(names):
        return
    zero = np.zeros(len(names))
    here = robot.poses(zero)[0]
    flanges = sorted(_FLANGES, key=lambda link: prefix + link != robot.tip)
    bases = sorted(_BASES, key=lambda base: prefix + base[0] != robot.base)
    for flange in flanges:
        at_flange = _between(robot, robot.base, prefix + flange)
        for base, turned in bases:
            at_base = _between(robot, prefix + base, robot.tip)
            if at_flange is None or at_base is None:
                continue
            T_base_link = here @ rigid_inverse(at_base.poses(zero)[0])
            T_flange_tip = rigid_inverse(at_flange.poses(zero)[0]) @ here
            yield T_base_link @ _HALF_TURN if turned else T_base_link, T_flange_tip


def _between(robot: Robot, base: str, tip: str) -> Robot | None:
    """The robot between two links, None unless there are both with the same joints between them."""
    if base not in robot.urdf.links or tip not in robot.urdf.links:
        return None
    try:
        other = robot.rebuilt(base=base, tip=tip)
    except UrdfError:  # no joint between them
        return None
    same = [joint.name for joint in other.joints] == [joint.name for joint in robot.joints]
    return other if same and not other.base_moves else None
