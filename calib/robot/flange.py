"""The robot of a table with poses of the flange instead of joint values: three joints that slide, three that turn.

    T_base_flange = Tx(x) Ty(y) Tz(z) Rz(yaw) Ry(pitch) Rx(roll)

Any pose is reached exactly, so the poses that a controller shows are joint values of this robot, and mount, board and
camera are estimated as with any other. It has no errors of its own: the model is ``frames``.
"""

from __future__ import annotations

from collections.abc import Collection

#: Its name, as ROBOT of a command.
NAME = "flange-poses"

#: Links: the frame in which the controller gives poses, and the one that they are of.
BASE, FLANGE = "base", "flange"

#: Joints from base to flange: three that slide along x, y, z, then three that turn about z, y, x.
JOINTS = ("flange_x", "flange_y", "flange_z", "flange_yaw", "flange_pitch", "flange_roll")

#: Axes of these joints.
_AXES = ("1 0 0", "0 1 0", "0 0 1", "0 0 1", "0 1 0", "1 0 0")

#: How many of them slide.
SLIDING = 3

#: Limits to either side: those that slide as far as most arms reach [m], those that turn by half a turn [rad].
_REACH, _HALF_TURN = 1.5, 3.141592653589793


def is_flange_robot(joint_names: Collection[str]) -> bool:
    """Return True if these are the joints of the robot that stands for poses of the flange, in any order."""
    return len(joint_names) == len(JOINTS) and {*joint_names} == {*JOINTS}


def flange_urdf() -> bytes:
    """Return the robot as a URDF, whose root is `BASE` and whose last link is `FLANGE`."""
    links = [BASE, *(f"after_{name}" for name in JOINTS[:-1]), FLANGE]
    lines = [f'<robot name="{NAME}">', *(f'  <link name="{link}"/>' for link in links)]
    for k, (name, axis) in enumerate(zip(JOINTS, _AXES, strict=True)):
        kind, limit = ("prismatic", _REACH) if k < SLIDING else ("revolute", _HALF_TURN)
        lines += [
            f'  <joint name="{name}" type="{kind}">',
            f'    <parent link="{links[k]}"/>',
            f'    <child link="{links[k + 1]}"/>',
            '    <origin xyz="0 0 0" rpy="0 0 0"/>',
            f'    <axis xyz="{axis}"/>',
            f'    <limit lower="{-limit!r}" upper="{limit!r}" effort="1" velocity="1"/>',
            "  </joint>",
        ]
    return "\n".join([*lines, "</robot>", ""]).encode()
