"""Arms whose makers name their joints ``joint1``, ``joint2``, ...: how a robot's URDF is such an arm, and which one."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from calib.errors import ModelError, choices
from calib.robot.arm_models import ARMS, ArmModel, arm_urdf
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf
from calib.robot.urdf_tree import UrdfJoint

#: A robot within this of a nominal arm is nominal [m and 1].
_SAME = 1e-6

#: A robot within this of a nominal arm is that arm, calibrated [m and 1].
_CALIBRATED = 0.05


class NumberedJoints(NamedTuple):
    """The joints of a robot that are called ``joint1``, ``joint2``, ... to the end of its chain."""

    #: What stands before these names; may be empty.
    prefix: str
    #: The joints.
    joints: tuple[UrdfJoint, ...]

    @classmethod
    def of(cls, robot: Robot) -> NumberedJoints | None:
        """Return those of a robot, other joints before them passed over; None if it ends in other joints."""
        joints = robot.joints
        for i, joint in enumerate(joints):
            prefix = joint.name.removesuffix("joint1")
            numbered = [f"{prefix}joint{k + 1}" for k in range(len(joints) - i)]
            if [other.name for other in joints[i:]] == numbered:
                return cls(prefix, tuple(joints[i:]))
        return None


def arm_robot(arm: ArmModel) -> Robot:
    """Return the nominal robot of an arm, from a URDF whose links are cylinders, to its flange."""
    urdf = Urdf.from_bytes(arm_urdf(arm), f"the nominal {arm.name}")
    return Robot.from_urdf(urdf, base=arm.maker.base, tip=arm.maker.flange)


def check_arm(robot: Robot, arm: ArmModel) -> None:
    """Raise `ModelError` if a robot, nominal or calibrated, does not have the joints of an arm near their places."""
    if not _distance(robot, arm) <= _CALIBRATED:
        raise ModelError(
            f"The robot '{robot.name}' from '{robot.base}' to '{robot.tip}' is not the {arm.maker.name} {arm.name}: "
            f"that arm ends in the joints {choices(arm.joints[:-1])}, after any prefix, with origins near the nominal "
            "ones. Leave --arm out, or give the right URDF."
        )


def known_arm(robot: Robot) -> ArmModel | None:
    """Return the known arm with the joints of a robot, nominal or calibrated, and the nearest origins, or None."""
    nearest = min(ARMS, key=lambda arm: _distance(robot, arm))
    return nearest if _distance(robot, nearest) <= _CALIBRATED else None


def is_nominal(robot: Robot) -> bool:
    """Return True if a robot has the joints of a known arm as on its data sheet."""
    return any(_distance(robot, arm) <= _SAME for arm in ARMS)


def flange_distance(robot: Robot, other: Robot) -> float:
    """Return the largest distance of the tips of two robots with the same joints [m], over poses in their limits."""
    q = random_joint_values(robot)
    apart = (robot.poses(q) - other.poses(q))[:, :3, 3]
    return float(np.linalg.norm(apart, axis=1).max())


def _distance(robot: Robot, arm: ArmModel) -> float:
    """Return the largest difference of the joints' axes and origins from an arm's [m, 1]; inf for other joints."""
    numbered = NumberedJoints.of(robot)
    if numbered is None or len(numbered.joints) != len(arm.axes):
        return np.inf
    axes = np.array([joint.axis for joint in numbered.joints])
    differences = [np.abs(axes - arm.axes).max()]
    stated = {joint.name: joint for joint in robot.urdf.joints}
    for name, T in zip(arm.joints, arm.origins, strict=True):
        if numbered.prefix + name in stated:  # a URDF may end before the flange
            origin = stated[numbered.prefix + name].T_parent_joint
            differences.append(np.abs(origin - T).max())
    return float(max(differences))
