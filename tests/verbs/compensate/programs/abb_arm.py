"""A small arm with the axes, zeros and flange of ABB's controllers."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from calib.robot.robot import Robot

#: Joints: origin in the frame of the last one [m], axis, and limits [deg].
_JOINTS = (
    ("0 0 0.29", "0 0 1", -165, 165),
    ("0 0 0", "0 1 0", -110, 110),
    ("0 0 0.27", "0 1 0", -110, 70),
    ("0 0 0.07", "1 0 0", -160, 160),
    ("0.302 0 0", "0 1 0", -120, 120),
    ("0.072 0 0", "1 0 0", -400, 400),
)

NAMES = tuple(f"joint_{j}" for j in range(1, 7))


def abb_urdf() -> str:
    """The URDF of the arm, from ``base`` to ``tool0``."""
    lines = ['<robot name="abb_like"><link name="base"/>']
    parent = "base"
    for name, (xyz, axis, low, high) in zip(NAMES, _JOINTS, strict=True):
        link = name.replace("joint", "link")
        lower, upper = np.deg2rad([low, high])
        lines.append(
            f'<link name="{link}"/><joint name="{name}" type="revolute"><parent link="{parent}"/>'
            f'<child link="{link}"/><origin xyz="{xyz}" rpy="0 0 0"/><axis xyz="{axis}"/>'
            f'<limit lower="{lower}" upper="{upper}" effort="1" velocity="1"/></joint>'
        )
        parent = link
    lines.append(
        f'<link name="tool0"/><joint name="flange" type="fixed"><parent link="{parent}"/><child link="tool0"/>'
        f'<origin xyz="0 0 0" rpy="0 {np.pi / 2} 0"/></joint></robot>'
    )
    return "\n".join(lines)


def abb_arm(folder: Path) -> Robot:
    """The arm, its URDF written into a folder."""
    path = folder / "abb.urdf"
    path.write_text(abb_urdf())
    return Robot.load(path, base="base", tip="tool0")
