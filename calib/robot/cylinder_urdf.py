"""URDFs of robots whose kinematics alone are known, such as DH rows: links drawn as cylinders.

Their numbers read back exactly. In the URDF of DH rows, with X_i the part of the rows along and about x (y) that comes
before joint i, and Z_i = Rz(theta_i) Tz(d_i), the origins are T_base_0 X_1 Z_1, X_2 Z_2, ... and X_(n+1) T_n_tip: a
joint turns about, or slides along, z of its frame, or -z if its direction is -1. If a row is longer than any robot,
because it is between nearly parallel axes, the joints' frames are moved along their axes instead, so that each is
nearest to the one before it.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from xml.sax.saxutils import quoteattr

import numpy as np
import pinocchio as pin

from calib.basics.arrays import Array
from calib.robot import kernel
from calib.robot.dh_file import robot_json
from calib.robot.dh_rows import MODIFIED, DHRobot, DHRow, DHTable, link_names, screw

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
    """Yield the cylinders of a link along a path, without those of stretches so short that joints hide them.

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
    """Return a URDF in UTF-8; every body is seen and checked for collisions, efforts and speeds are placeholders.

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
            f"    {origin_tag(joint.T_parent_joint)}",
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
            lines += [f"    <{tag}>", f"      {origin_tag(body.T_link_cylinder)}"]
            shape = f'<cylinder radius="{body.radius:.6g}" length="{float(body.length)!r}"/>'
            lines.append(f"      <geometry>{shape}</geometry>")
            if tag == "visual":
                rgba = " ".join(f"{part:g}" for part in (*body.colour, 1.0))
                lines.append(f'      <material name=""><color rgba="{rgba}"/></material>')
            lines.append(f"    </{tag}>")
    return [*lines, "  </link>"]


def origin_tag(T: Array) -> str:
    """Return the ``<origin/>`` of a pose (4, 4) [m]; Pinocchio's rpy is accurate also at pitch = +-pi/2."""
    return f'<origin xyz="{_numbers(T[:3, 3])}" rpy="{_numbers(pin.rpy.matrixToRpy(T[:3, :3]))}"/>'


def _numbers(values: Array) -> str:
    """Return numbers (k,) as a text that reads back exactly, with those that are rounding of zero as zero."""
    return " ".join(repr(0.0 if abs(value) < _ROUNDING else float(value)) for value in values)


# DH rows

REMARK = "calib DH rows: "
"""Begins the comment of a URDF that holds the rows it was made from, as JSON."""

#: A row longer than this is between nearly parallel axes [m].
_FAR = 20.0

#: Radius of the rail that a joint slides on, over the radius of its link.
_RAIL = 0.5


def dh_urdf(robot: DHRobot) -> bytes:
    """Return the URDF of a robot of DH rows in UTF-8; its links are cylinders, seen and checked for collisions.

    A comment holds the rows and the coupling of readings as JSON, from which `Urdf.dh` reads them back: a URDF has no
    place for coupled readings, so its joints take the joints' values.
    """
    rows = robot.table.rows
    origins, corners = _origins_and_corners(robot.table)
    radii = link_radii(origins)

    # Of the links from the base's to the one before the tip: rods from the link's joint by the corner to the next, and
    # the rail of a joint that slides.
    bodies = []
    for row, origin, corner, radius in zip(
        [*rows, None], origins, corners, [radii[0], *radii], strict=True
    ):
        of_link = [*rods([np.zeros(3), corner, origin[:3, 3]], radius)]
        limits = None if row is None else _limits(row)
        if row is not None and row.prismatic and limits is not None:
            start, end = sorted(row.direction * limit for limit in limits)
            rail = bar(start, end, _RAIL * radius, GREY)
            of_link.append(replace(rail, T_link_cylinder=origin @ rail.T_link_cylinder))
        bodies.append(tuple(of_link))

    links = link_names(robot)
    joints = []
    for i, row in enumerate(rows):
        kind = "continuous" if row.lower is None else "revolute"
        joint = NewJoint(
            name=row.joint,
            type="prismatic" if row.prismatic else kind,
            parent=links[i],
            child=links[i + 1],
            T_parent_joint=origins[i],
            axis=(0, 0, row.direction),
            limits=_limits(row),
            bodies=(joint_body(radii[i]), *bodies[i + 1]),
        )
        joints.append(joint)
    joints.append(NewJoint(f"{robot.tip}_joint", "fixed", links[-2], robot.tip, origins[-1]))

    # No comment may hold --, which is in names only.
    rows_json = json.dumps(robot_json(robot)).replace("--", "-\\u002d")
    remarks = [
        f"A robot of DH rows, {robot.table.convention} convention, made by calib: its cylinders are not the robot's "
        "shape, and efforts and speeds are only there because a URDF must have them.",
        REMARK + rows_json,
    ]
    return urdf_bytes(robot.name, remarks, robot.base, joints, bodies[0])


def _limits(row: DHRow) -> tuple[float, float] | None:
    """Return the limits of a row's joint [rad or m]; None if it has none."""
    if row.lower is None or row.upper is None:
        return None
    return float(row.lower), float(row.upper)


def _origins_and_corners(table: DHTable) -> tuple[list[Array], list[Array]]:
    """Return the origins of the n joints and the tip, n + 1 poses (4, 4), and the end points (3,) of their X_i, [m].

    Both are in the frame of the joint before. X_i is the part of the rows along and about x (y) before joint i. If a
    row is too long to be drawn, the frames are moved along their axes to where each is nearest to the one before it,
    and the end points are zeros.
    """
    before = [screw(0, row.alpha, row.a) @ screw(1, row.beta, 0.0) for row in table.rows]  # X_i
    last = np.eye(4)
    if table.convention != MODIFIED:
        before, last = [np.eye(4), *before[:-1]], before[-1]
    before[0] = table.T_base_0 @ before[0]
    origins = []
    for row, X in zip(table.rows, before, strict=True):
        theta, d = row.theta, row.d
        if row.prismatic:
            d = d + row.offset
        else:
            theta = theta + row.offset
        origins.append(X @ screw(2, theta, d))
    origins.append(last @ table.T_n_tip)
    lengths = [abs(length) for row in table.rows for length in (row.a, row.d)]
    if max(lengths) <= _FAR:
        return origins, [X[:3, 3] for X in (*before, last)]

    # The same chain with each joint's frame moved along its axis to where it is nearest to the one before.
    moved = []
    undo = np.eye(4)
    for i, origin in enumerate(origins):
        T = undo @ origin
        slide = 0.0 if i + 1 == len(origins) else -float(T[:3, 3] @ T[:3, 2])
        moved.append(T @ screw(2, 0.0, slide))
        undo = screw(2, 0.0, -slide)
    return moved, [0.0 * T[:3, 3] for T in moved]
