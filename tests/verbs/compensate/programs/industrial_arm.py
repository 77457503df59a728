"""An arm as FANUC's and Yaskawa's are, with axes and zeros of their controllers, its base at the height of axis 2."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from calib.robot.robot import Robot

#: From axis 1 to 2, from there to 3, to 4, along axis 4 to 5, and to the flange [m].
LENGTHS = (0.15, 0.6, 0.12, 0.65, 0.1)

#: Largest angle of each joint, to both sides [deg].
_LIMITS = (180, 150, 260, 360, 140, 400)

_AXES = ("0 0 1", "0 1 0", "0 -1 0", "-1 0 0", "0 -1 0", "-1 0 0")

#: FANUC's reading of joint 3 counts from the horizontal.
FROM_HORIZONTAL = {"joint_3": {"joint_2": 1.0}}

NAMES = tuple(f"joint_{j}" for j in range(1, 7))


def industrial_arm(
    folder: Path,
    coupling: dict[str, dict[str, float]] | None = None,
    lengths: tuple[float, ...] = LENGTHS,
) -> Robot:
    """The arm, its URDF written into a folder."""
    a1, l2, a3, l4, l6 = lengths
    origins = ("0 0 0", f"{a1} 0 0", f"0 0 {l2}", f"0 0 {a3}", f"{l4} 0 0", f"{l6} 0 0")
    links = "".join(f'<link name="link_{j}"/>' for j in range(1, 7))
    parent, joints = "base", ""
    for j, (xyz, axis, limit) in enumerate(zip(origins, _AXES, _LIMITS, strict=True), start=1):
        end = np.radians(limit)
        joints += (
            f'<joint name="joint_{j}" type="revolute"><parent link="{parent}"/><child link="link_{j}"/>'
            f'<origin xyz="{xyz}" rpy="0 0 0"/><axis xyz="{axis}"/>'
            f'<limit lower="{-end}" upper="{end}" effort="1" velocity="1"/></joint>'
        )
        parent = f"link_{j}"
    joints += (
        '<joint name="flange" type="fixed"><parent link="link_6"/><child link="tool0"/>'
        f'<origin xyz="0 0 0" rpy="{np.pi} {-np.pi / 2} 0"/></joint>'
    )
    path = folder / "arm.urdf"
    path.write_text(
        f'<robot name="arm"><link name="base"/>{links}<link name="tool0"/>{joints}</robot>'
    )
    return Robot.load(path, base="base", tip="tool0", coupling=coupling)
