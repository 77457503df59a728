"""The URDF of a robot that DH rows describe: each joint at the end of its row's d, and links drawn as cylinders.

With X_i the part of the rows along and about x (y) that lies before joint i, and Z_i = Rz(theta_i) Tz(d_i), the origins
are T_base_0 X_1 Z_1, X_2 Z_2, ... and X_(n+1) T_n_tip: a joint turns about, or slides along, z of its frame, or -z
where its direction is -1. Where a row is longer than any robot, because it lies between nearly parallel axes, the
joints' frames are moved along their axes instead, so that each is nearest to the one before it.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.basics.arrays import Array
from calib.robot.dh.description import DHRobot, link_names
from calib.robot.dh.json_file import robot_json
from calib.robot.dh.rows import MODIFIED, DHRow, DHTable, screw
from calib.robot.generated.cylinders import GREY, bar, joint_body, link_radii, rods
from calib.robot.generated.urdf_text import Cylinder, NewJoint, urdf_bytes

REMARK = "calib DH rows: "
"""Begins the comment of a URDF that holds the rows it was made from, as JSON."""

#: A row longer than this lies between nearly parallel axes [m].
_FAR = 20.0

#: Radius of the rail that a joint slides on, in radii of its link.
_RAIL = 0.5


def dh_urdf(robot: DHRobot) -> bytes:
    """Return the URDF of a robot, with its rows in a comment."""
    origins, corners = _origins(robot.table)
    radii = link_radii(origins)
    next_rows = [*robot.table.rows, None]
    bodies = []
    for row, origin, corner, radius in zip(
        next_rows, origins, corners, [radii[0], *radii], strict=True
    ):
        bodies.append((*rods(_path(origin, corner), radius), *_rail(row, origin, radius)))
    joints = _joints(robot, origins, [joint_body(radius) for radius in radii], bodies[1:])
    remarks = [
        f"A robot of DH rows, {robot.table.convention} convention, made by calib: its cylinders are not the robot's "
        "shape, and efforts and speeds are only there because a URDF must have them.",
        REMARK + _in_comment(json.dumps(robot_json(robot))),
    ]
    return urdf_bytes(robot.name, remarks, robot.base, joints, bodies[0])


def _joints(
    robot: DHRobot,
    origins: Sequence[Array],
    joint_bodies: Sequence[Cylinder],
    link_bodies: Sequence[tuple[Cylinder, ...]],
) -> list[NewJoint]:
    """Return the joints of the n rows, and the fixed one of the tip.

    Args:
        robot: The robot.
        origins: T_parent_joint of all these, n + 1 poses (4, 4), [m].
        joint_bodies: The body of each row's joint.
        link_bodies: The bodies of the link that it carries.
    """
    links = link_names(robot)
    joints = []
    for i, row in enumerate(robot.table.rows):
        joint = NewJoint(
            name=row.joint,
            type=_type(row),
            parent=links[i],
            child=links[i + 1],
            T_parent_joint=origins[i],
            axis=(0, 0, row.direction),
            limits=_limits(row),
            bodies=(joint_bodies[i], *link_bodies[i]),
        )
        joints.append(joint)
    joints.append(NewJoint(f"{robot.tip}_joint", "fixed", links[-2], robot.tip, origins[-1]))
    return joints


def _in_comment(text: str) -> str:
    """Return JSON without ``--``, which no comment may hold; it stands in names only."""
    return text.replace("--", "-\\u002d")


def _type(row: DHRow) -> str:
    """Return the URDF type of a row's joint."""
    if row.prismatic:
        return "prismatic"
    return "continuous" if row.lower is None else "revolute"


def _limits(row: DHRow) -> tuple[float, float] | None:
    """Return the limits of a row's joint [rad or m]; None without."""
    if row.lower is None or row.upper is None:
        return None
    return float(row.lower), float(row.upper)


def _origins(table: DHTable) -> tuple[list[Array], list[Array]]:
    """Return the origins of the n joints and of the tip, and the corner between each and the link before it.

    Returns:
        n + 1 poses (4, 4) in the frame of the joint before, and as many points (3,): the ends of X_i, [m].
    """
    before = [_along_x(row) for row in table.rows]
    last = np.eye(4)
    if table.convention != MODIFIED:
        before, last = [np.eye(4), *before[:-1]], before[-1]
    before[0] = table.T_base_0 @ before[0]
    turns = [_along_axis(row) for row in table.rows]
    origins = [X @ Z for X, Z in zip(before, turns, strict=True)] + [last @ table.T_n_tip]
    lengths = [abs(length) for row in table.rows for length in (row.a, row.d)]
    if max(lengths) > _FAR:
        origins = _nearer(origins)
        return origins, [0.0 * T[:3, 3] for T in origins]
    return origins, [X[:3, 3] for X in (*before, last)]


def _along_x(row: DHRow) -> Array:
    """Return the part of a row along and about x, and about y, (4, 4) [m]."""
    return np.asarray(screw(0, row.alpha, row.a) @ screw(1, row.beta, 0.0))


def _along_axis(row: DHRow) -> Array:
    """Return the part of a row along and about the joint's axis at the value zero, (4, 4) [m]."""
    if row.prismatic:
        return screw(2, row.theta, row.d + row.offset)
    return screw(2, row.theta + row.offset, row.d)


def _nearer(origins: Sequence[Array]) -> list[Array]:
    """Return the same chain with each joint's frame moved along its axis to where it is nearest to the one before."""
    result = []
    undo = np.eye(4)
    for i, origin in enumerate(origins):
        T = undo @ origin
        slide = 0.0 if i + 1 == len(origins) else -float(T[:3, 3] @ T[:3, 2])
        result.append(T @ screw(2, 0.0, slide))
        undo = screw(2, 0.0, -slide)
    return result


def _rail(row: DHRow | None, origin: Array, radius: float) -> tuple[Cylinder, ...]:
    """Return the rail of a sliding joint in the link before it; none for another joint.

    Args:
        row: The joint's row; None for the tip.
        origin: T_parent_joint, (4, 4), [m].
        radius: Radius of the link [m].
    """
    if row is None or not row.prismatic:
        return ()
    limits = _limits(row)
    if limits is None:
        return ()
    start, end = sorted(row.direction * limit for limit in limits)
    rail = bar(start, end, _RAIL * radius, GREY)
    return (replace(rail, T_link_cylinder=origin @ rail.T_link_cylinder),)


def _path(origin: Array, corner: Array) -> list[Array]:
    """Return the path of the link before a joint, for `rods`: from its own joint by the corner to the joint."""
    return [np.zeros(3), corner, origin[:3, 3]]
