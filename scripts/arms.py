"""Arms that the studies calibrate: some of example-robot-data by name, and two that are described here."""

from __future__ import annotations

import functools
import importlib.metadata
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from calib.errors import UrdfError
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf

Vector = tuple[float, float, float]

#: Base and tip of arms of example-robot-data.
LINKS = {
    "ur3": ("base", "tool0"),
    "ur5": ("base_link", "tool0"),
    "ur10": ("base_link", "tool0"),
    "panda": ("panda_link0", "panda_link8"),
}


@dataclass(frozen=True, slots=True)
class Segment:
    """A revolute joint, and the link that it moves."""

    xyz: Vector  # Origin of the joint in the link before it [m]
    rpy: Vector  # Orientation of the joint in the link before it [rad]
    axis: Vector  # Axis of the joint in the joint's frame
    limit: float  # The joint turns from -limit to limit [rad]
    mass: float  # Of the link [kg]
    com: Vector  # Centre of mass in the link [m]


_X = (1.0, 0.0, 0.0)
_Y = (0.0, 1.0, 0.0)
_Z = (0.0, 0.0, 1.0)

#: Orientations of an iiwa's joints, and of a joint that is not turned [rad].
_STRAIGHT = (0.0, 0.0, 0.0)
_OUTWARDS = (np.pi / 2, 0.0, np.pi)
_FORWARDS = (np.pi / 2, 0.0, 0.0)
_BACK = (-np.pi / 2, np.pi, 0.0)

#: Limits of an iiwa's joints [rad].
_WIDE = np.deg2rad(170.0)
_NARROW = np.deg2rad(120.0)
_FLANGE = np.deg2rad(175.0)

#: An arm of the dimensions and masses of a KUKA LBR iiwa 14, which example-robot-data does not have.
_IIWA = (
    Segment((0.0, 0.0, 0.1575), _STRAIGHT, _Z, _WIDE, 4.0, (0.0, -0.03, 0.12)),
    Segment((0.0, 0.0, 0.2025), _OUTWARDS, _Z, _NARROW, 4.0, (0.0003, 0.059, 0.042)),
    Segment((0.0, 0.2045, 0.0), _OUTWARDS, _Z, _WIDE, 3.0, (0.0, 0.03, 0.13)),
    Segment((0.0, 0.0, 0.2155), _FORWARDS, _Z, _NARROW, 2.7, (0.0, 0.067, 0.034)),
    Segment((0.0, 0.1845, 0.0), _BACK, _Z, _WIDE, 1.7, (0.0001, 0.021, 0.076)),
    Segment((0.0, 0.0, 0.2155), _FORWARDS, _Z, _NARROW, 1.8, (0.0, 0.0006, 0.0004)),
    Segment((0.0, 0.081, 0.0), _BACK, _Z, _FLANGE, 0.3, (0.0, 0.0, 0.02)),
)

#: An ABB IRB 120 by its data sheet.
_IRB120 = (
    Segment((0.0, 0.0, 0.29), _STRAIGHT, _Z, 2.87, 3.07, (0.0, 0.0, -0.05)),
    Segment((0.0, 0.0, 0.0), _STRAIGHT, _Y, 1.9, 3.9, (0.0, 0.0, 0.1)),
    Segment((0.0, 0.0, 0.27), _STRAIGHT, _Y, 1.2, 2.94, (0.06, 0.0, 0.02)),
    Segment((0.0, 0.0, 0.07), _STRAIGHT, _X, 2.79, 1.33, (0.22, 0.0, 0.0)),
    Segment((0.302, 0.0, 0.0), _STRAIGHT, _Y, 2.09, 0.55, (0.0, 0.0, 0.0)),
    Segment((0.072, 0.0, 0.0), _STRAIGHT, _X, 3.1, 0.0, (0.0, 0.0, 0.0)),
)


@functools.cache
def load_arm(name: str) -> Robot:
    """Return the nominal robot of a name: one of `LINKS`, ``"iiwa"`` or ``"irb120"``."""
    if name == "iiwa":
        return _described_arm(name, _IIWA, flange=0.045)
    if name == "irb120":
        return _described_arm(name, _IRB120)
    base, tip = LINKS[name]
    return Robot.load(name, base=base, tip=tip)


@functools.cache
def example_urdfs() -> Mapping[str, str]:
    """Return the path of each URDF of example-robot-data with a chain of two joints or more, by a short name."""
    paths: dict[str, str] = {}
    for file in importlib.metadata.files("example-robot-data") or []:
        if file.suffix != ".urdf":
            continue
        path = str(file.locate())
        try:
            robot = Robot.load(path)
        except UrdfError as error:
            # Flying bases whose only joints are fixed, and files that are empty shells for xacro, hold no arm.
            if "has no <joint>" in str(error) or "no joint moves" in str(error):
                continue
            raise
        if len(robot.joints) >= 2:
            name = file.name.removesuffix(".urdf")
            if name in paths:
                name = f"{name} ({file.parts[-3]})"
            paths[name] = path
    return MappingProxyType(dict(sorted(paths.items())))


def without_masses(robot: Robot) -> Robot:
    """Return the robot of the same URDF without its <inertial> elements, as many URDFs are."""
    urdf = robot.urdf
    text = urdf.data.decode(urdf.encoding)
    text = re.sub(r"<inertial\b.*?</inertial>|<inertial\s*/>", "", text, flags=re.S)
    bare = Urdf.from_bytes(text.encode(urdf.encoding), "bare.urdf")
    return Robot.from_urdf(bare, robot.base, robot.tip)


def _described_arm(name: str, segments: Sequence[Segment], flange: float | None = None) -> Robot:
    """Return the robot of some segments.

    Args:
        name: Name of the robot.
        segments: The joints and links from link ``base`` on.
        flange: Distance of a link ``flange`` from the last joint along its axis [m]; None: the last link is the tip.
    """
    elements = [f'<robot name="{name}">', '<link name="base"/>']
    tip = "base"
    for number, segment in enumerate(segments, start=1):
        parent = tip
        tip = f"link_{number}"
        elements += [
            f'<link name="{tip}">{_inertial(segment)}</link>',
            f'<joint name="joint_{number}" type="revolute">',
            f'<parent link="{parent}"/><child link="{tip}"/>',
            f'<origin xyz="{_attribute(segment.xyz)}" rpy="{_attribute(segment.rpy)}"/>',
            f'<axis xyz="{_attribute(segment.axis)}"/>',
            f'<limit lower="{-segment.limit}" upper="{segment.limit}" effort="300" velocity="1"/>',
            "</joint>",
        ]
    if flange is not None:
        elements += [
            '<link name="flange"/>',
            '<joint name="flange_joint" type="fixed">',
            f'<parent link="{tip}"/><child link="flange"/><origin xyz="0 0 {flange}"/>',
            "</joint>",
        ]
        tip = "flange"
    elements.append("</robot>")
    urdf = Urdf.from_bytes("\n".join(elements).encode(), f"{name}.urdf")
    return Robot.from_urdf(urdf, "base", tip)


def _inertial(segment: Segment) -> str:
    """Return the <inertial> element of a segment's link, nothing of one without mass."""
    if not segment.mass:
        return ""
    origin = f'<origin xyz="{_attribute(segment.com)}"/>'
    inertia = '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/>'
    return f'<inertial>{origin}<mass value="{segment.mass}"/>{inertia}</inertial>'


def _attribute(values: Vector) -> str:
    """Return numbers as an attribute of a URDF holds them, with all digits."""
    return " ".join(repr(float(value)) for value in values)
