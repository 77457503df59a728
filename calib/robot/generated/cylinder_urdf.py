"""URDFs of robots of which only the kinematics are known: links drawn as cylinders, numbers that read back exactly."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from xml.sax.saxutils import quoteattr

import numpy as np
import pinocchio as pin

from calib.basics.arrays import Array
from calib.robot import kernel
from calib.robot.dh.rows import screw

#: Radius of the first and of the last link, over the length of the stretched robot.
_FIRST_RADIUS = 0.035
_LAST_RADIUS = 0.018

#: Radius and length of a joint, over the radius of its link.
_JOINT_RADIUS = 1.3
_JOINT_LENGTH = 2.8

#: A stretch of a link shorter than this, over the radius of the link, is inside its joints and is not drawn.
_SHORTEST_ROD = 0.5

#: The links of a shorter robot are drawn as thick as those of a robot of this length [m].
_SHORTEST_ROBOT = 0.1

GREY = (0.75, 0.77, 0.8)
"""Colour of links: red, green, blue."""

#: Colour of joints.
_ORANGE = (0.9, 0.5, 0.15)

#: A number below this is rounding of a product of rotations [m or rad].
_ROUNDING = 1e-15

#: Effort [N or Nm] and speed [m/s or rad/s] that every limit must state, although they are not known.
_EFFORT = 1000.0
_SPEED = np.pi


@dataclass(frozen=True, slots=True, eq=False)
class Cylinder:
    """A cylinder of a link, along z of its own frame and with its origin in the middle."""

    #: Shape (4, 4), [m], its pose in the link.
    T_link_cylinder: Array
    #: Radius [m].
    radius: float
    #: Length [m].
    length: float
    #: Red, green and blue, from 0 to 1.
    colour: tuple[float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class NewJoint:
    """A joint with the link that it carries."""

    #: Name of the joint.
    name: str
    #: ``revolute``, ``continuous``, ``prismatic`` or ``fixed``.
    type: str
    #: Name of the link that carries it.
    parent: str
    #: Name of the link that it carries.
    child: str
    #: Shape (4, 4), [m], its origin.
    T_parent_joint: Array
    #: Unit vector in its frame; ignored if it is fixed.
    axis: tuple[int, int, int] = (0, 0, 1)
    #: Least and largest value [rad or m]; None for no limits.
    limits: tuple[float, float] | None = None
    #: Bodies of the child link.
    bodies: tuple[Cylinder, ...] = ()


def link_radii(origins: Sequence[Array]) -> Array:
    """Return the radius of each moving link, which falls from the first to the last.

    Args:
        origins: T_parent_joint of the n joints and of the tip after them, n + 1 poses (4, 4), [m].

    Returns:
        Shape (n,), [m].
    """
    length = sum(float(np.linalg.norm(T[:3, 3])) for T in origins)
    shares = np.linspace(_FIRST_RADIUS, _LAST_RADIUS, len(origins) - 1)
    return np.asarray(max(length, _SHORTEST_ROBOT) * shares)


def joint_body(radius: float) -> Cylinder:
    """Return the body of a joint along z of its frame.

    Args:
        radius: Radius of the link that it carries [m].
    """
    half = 0.5 * _JOINT_LENGTH * radius
    return bar(-half, half, _JOINT_RADIUS * radius, _ORANGE)


def rods(path: Sequence[Array], radius: float) -> Iterator[Cylinder]:
    """Yield the cylinders of a link along a path.

    Args:
        path: Points (3,) in the link's frame, [m], in order.
        radius: Radius of the cylinders [m].
    """
    for start, end in pairwise(path):
        length = float(np.linalg.norm(end - start))
        if length > _SHORTEST_ROD * radius:
            T = np.eye(4)
            T[:3, :3] = kernel.turns_to(((end - start) / length)[None])[0]
            T[:3, 3] = (start + end) / 2.0
            yield Cylinder(T, radius, length, GREY)


def bar(start: float, end: float, radius: float, colour: tuple[float, float, float]) -> Cylinder:
    """Return a cylinder along z of its link's frame.

    Args:
        start: Its lower end on z [m].
        end: Its upper end on z [m].
        radius: Its radius [m].
        colour: Red, green and blue, from 0 to 1.
    """
    return Cylinder(screw(2, 0.0, (start + end) / 2.0), radius, end - start, colour)


def urdf_bytes(
    name: str,
    remarks: Iterable[str],
    root: str,
    joints: Iterable[NewJoint],
    bodies: Sequence[Cylinder] = (),
) -> bytes:
    """Return a URDF in UTF-8.

    Args:
        name: Name of the robot.
        remarks: Lines of comment before ``<robot>``, without ``--``.
        root: Name of the root link.
        joints: The joints, each after the one that carries its parent link.
        bodies: Bodies of the root link.
    """
    lines = ['<?xml version="1.0" encoding="utf-8"?>']
    lines += [f"<!-- {remark} -->" for remark in remarks]
    lines.append(f"<robot name={quoteattr(name)}>")
    lines += _link_lines(root, bodies)
    for joint in joints:
        lines += [
            *_link_lines(joint.child, joint.bodies),
            f'  <joint name={quoteattr(joint.name)} type="{joint.type}">',
            f"    {_origin(joint.T_parent_joint)}",
            f"    <parent link={quoteattr(joint.parent)}/>",
            f"    <child link={quoteattr(joint.child)}/>",
        ]
        if joint.type != "fixed":
            lines.append(f'    <axis xyz="{" ".join(map(str, joint.axis))}"/>')
        if joint.limits is not None:
            lower, upper = joint.limits
            lines.append(
                f'    <limit lower="{lower!r}" upper="{upper!r}" effort="{_EFFORT:g}" velocity="{_SPEED}"/>'
            )
        lines.append("  </joint>")
    return "\n".join([*lines, "</robot>", ""]).encode()


def _link_lines(name: str, bodies: Sequence[Cylinder]) -> list[str]:
    """Return the lines of a link; each body is both a visual and a collision shape."""
    if not bodies:
        return [f"  <link name={quoteattr(name)}/>"]
    lines = [f"  <link name={quoteattr(name)}>"]
    for tag in ("visual", "collision"):
        for body in bodies:
            lines += [f"    <{tag}>", f"      {_origin(body.T_link_cylinder)}"]
            shape = f'<cylinder radius="{body.radius:.6g}" length="{float(body.length)!r}"/>'
            lines.append(f"      <geometry>{shape}</geometry>")
            if tag == "visual":
                rgba = " ".join(f"{part:g}" for part in (*body.colour, 1.0))
                lines.append(f'      <material name=""><color rgba="{rgba}"/></material>')
            lines.append(f"    </{tag}>")
    return [*lines, "  </link>"]


def _origin(T: Array) -> str:
    """Return the ``<origin/>`` of a pose (4, 4) [m]; Pinocchio's rpy is accurate also at pitch = +-pi/2."""
    return f'<origin xyz="{_numbers(T[:3, 3])}" rpy="{_numbers(pin.rpy.matrixToRpy(T[:3, :3]))}"/>'


def _numbers(values: Array) -> str:
    """Return numbers that read back exactly, rounding of zero as zero."""
    return " ".join(repr(0.0 if abs(value) < _ROUNDING else float(value)) for value in values)
