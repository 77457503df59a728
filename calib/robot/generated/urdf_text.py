"""URDFs that calib makes itself: links of cylinders and joints, as text whose numbers read back exactly."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from xml.sax.saxutils import quoteattr

import numpy as np
import pinocchio as pin

from calib.basics.arrays import Array

#: A number below this is rounding of a product of rotations [m or rad].
_ROUNDING = 1e-15

#: Effort that every limit must state, and calib does not know [N or Nm].
_EFFORT = 1000.0

#: Speed, likewise [m/s or rad/s].
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
    #: Unit vector in its frame; of no meaning where it is fixed.
    axis: tuple[int, int, int] = (0, 0, 1)
    #: Least and largest value [rad or m]; None: it has none.
    limits: tuple[float, float] | None = None
    #: Bodies of the child link.
    bodies: tuple[Cylinder, ...] = ()


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
        lines += [*_link_lines(joint.child, joint.bodies), *_joint_lines(joint)]
    return "\n".join([*lines, "</robot>", ""]).encode()


def _link_lines(name: str, bodies: Sequence[Cylinder]) -> list[str]:
    """Return the lines of a link; each body is both seen and checked for collisions."""
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


def _joint_lines(joint: NewJoint) -> list[str]:
    """Return the lines of a joint."""
    lines = [
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
    return [*lines, "  </joint>"]


def _origin(T: Array) -> str:
    """Return the ``<origin/>`` of a pose (4, 4) [m]; Pinocchio's rpy is accurate at pitch = +-pi/2, too."""
    return f'<origin xyz="{_numbers(T[:3, 3])}" rpy="{_numbers(pin.rpy.matrixToRpy(T[:3, :3]))}"/>'


def _numbers(values: Array) -> str:
    """Return numbers that read back exactly, rounding of zero as zero."""
    return " ".join(repr(0.0 if abs(value) < _ROUNDING else float(value)) for value in values)
