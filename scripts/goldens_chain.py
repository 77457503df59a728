"""Chains of a URDF and their forward kinematics, without calib: how goldens.py reads the URDFs that calib writes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Joint:
    """A joint of a URDF."""

    name: str
    kind: str  # The URDF's type: "revolute", "fixed"...
    axis: Array  # shape (3,), in the joint's frame
    origin: Array  # shape (4, 4), T_parent_joint [m]
    parent: str  # Link
    child: str  # Link


def read_joints(path: Path) -> dict[str, Joint]:
    """Return the joints of a URDF by the link behind them."""
    joints = {}
    for element in ElementTree.parse(path).iter("joint"):
        child = element.find("child")
        if child is not None:  # a <joint> of a <transmission> has none
            joint = _joint(element)
            joints[joint.child] = joint
    return joints


def chain_of(joints: Mapping[str, Joint], tip: str, base: str = "") -> list[Joint]:
    """Return the joints between two links, from the base on.

    Args:
        joints: Joints by the link behind them.
        tip: The last link.
        base: A link before it; by default the URDF's root.
    """
    chain: list[Joint] = []
    link = tip
    while link in joints and link != base:
        chain.insert(0, joints[link])
        link = joints[link].parent
    return chain


def forward(chain: Sequence[Joint], values: Mapping[str, float]) -> Array:
    """Return the pose of a chain's last link in its first, shape (4, 4), [m].

    Args:
        chain: The joints.
        values: Their values by name [rad] or [m]; 0 where none is given.
    """
    pose = np.eye(4)
    for joint in chain:
        motion = np.eye(4)
        q = values.get(joint.name, 0.0)
        if joint.kind == "prismatic":
            motion[:3, 3] = q * joint.axis
        elif joint.kind in ("revolute", "continuous"):
            rotation = q * joint.axis / np.linalg.norm(joint.axis)
            motion[:3, :3] = Rotation.from_rotvec(rotation).as_matrix()
        pose = pose @ joint.origin @ motion
    return pose


def _joint(element: ElementTree.Element) -> Joint:
    """Return the joint of an XML element."""
    T = np.eye(4)
    T[:3, 3] = _numbers(element, "origin", "xyz", "0 0 0")
    rpy = _numbers(element, "origin", "rpy", "0 0 0")
    T[:3, :3] = Rotation.from_euler("xyz", rpy).as_matrix()
    axis = _numbers(element, "axis", "xyz", "1 0 0")
    name, kind = element.attrib["name"], element.attrib["type"]
    return Joint(name, kind, axis, T, _link(element, "parent"), _link(element, "child"))


def _numbers(element: ElementTree.Element, tag: str, attribute: str, default: str) -> Array:
    """Return the numbers of an attribute of an element inside another, or those of a default text."""
    inner = element.find(tag)
    text = default if inner is None else inner.attrib.get(attribute, default)
    return np.array([float(word) for word in text.split()])


def _link(element: ElementTree.Element, tag: str) -> str:
    """Return the link that a joint's <parent> or <child> names."""
    inner = element.find(tag)
    return "" if inner is None else inner.attrib["link"]
