"""An MJCF of the paper's UR3 by its DH rows, so that its bodies' frames are not those of the URDF."""

from __future__ import annotations

from pathlib import Path

NAMES = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")

#: d, a [m] and alpha [deg] of the rows.
ROWS = (
    (0.1519, 0.0, 90.0),
    (0.0, -0.24365, 0.0),
    (0.0, -0.21325, 0.0),
    (0.11235, 0.0, 90.0),
    (0.08535, 0.0, -90.0),
    (0.0819, 0.0, 0.0),
)


def ur3_mjcf(path: Path, longer: tuple[float, float] = (0.0, 0.0)) -> Path:
    """Write it, with arms longer by lengths [m]; body i stands at the end of row i - 1, the flange at that of row 6."""
    text = ["<mujoco>", "<worldbody>", '<body name="stand" pos="0.3 0.2 0.7" euler="0 0 90">']
    pose = ""
    for name, (d, a, alpha), extra in zip(NAMES, ROWS, (0.0, *longer, 0.0, 0.0, 0.0), strict=True):
        text.append(f'<body name="{name}"{pose}><geom size="0.03"/>')
        text.append(f'<joint name="{name}_joint"/>')
        pose = f' pos="{a + extra} 0 {d}" euler="{alpha} 0 0"'
    text.append(f'<body name="flange"{pose}/>')
    text += ["</body>"] * 7 + ["</worldbody>", "</mujoco>"]
    path.write_text("\n".join(text))
    return path
