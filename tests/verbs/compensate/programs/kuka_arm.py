"""An arm as KUKA's are: signs and zeros of its controller, axis 4 beside axis 3, the flange along axis 6."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from calib.robot.robot import Robot

#: Origins of the joints in the joint before, with the arm stretched out forwards at zero [m].
_ORIGINS = ("0 0 0.675", "0.35 0 0", "1.15 0 0", "0 0 -0.041", "1 0 0", "0.24 0 0")

_AXES = ("0 0 -1", "0 1 0", "0 1 0", "-1 0 0", "0 1 0", "-1 0 0")

#: Lowest and highest angle of each axis [deg].
LIMITS = ((-185, 185), (-140, 5), (-120, 155), (-350, 350), (-122, 122), (-350, 350))


def kuka_arm(folder: Path) -> Robot:
    """The arm, its URDF written into a folder."""
    links = "".join(f'<link name="link_{j}"/>' for j in range(1, 7))
    parent, joints = "base", ""
    for j, (xyz, axis, limit) in enumerate(zip(_ORIGINS, _AXES, LIMITS, strict=True), start=1):
        low, high = np.radians(limit)
        joints += (
            f'<joint name="joint_a{j}" type="revolute"><parent link="{parent}"/>'
            f'<child link="link_{j}"/><origin xyz="{xyz}" rpy="0 0 0"/><axis xyz="{axis}"/>'
            f'<limit lower="{low}" upper="{high}" effort="1" velocity="1"/></joint>'
        )
        parent = f"link_{j}"
    joints += (
        '<joint name="flange" type="fixed"><parent link="link_6"/><child link="tool0"/>'
        f'<origin xyz="0 0 0" rpy="0 {np.pi / 2} 0"/></joint>'
    )
    path = folder / "kuka.urdf"
    path.write_text(
        f'<robot name="kuka"><link name="base"/>{links}<link name="tool0"/>{joints}</robot>'
    )
    return Robot.load(path, base="base", tip="tool0")
