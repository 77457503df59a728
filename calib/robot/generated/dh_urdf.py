"""The URDF of a robot that DH rows describe: each joint at the end of its row's d, and links drawn as cylinders.

With X_i the part of the rows along and about x (y) that comes before joint i, and Z_i = Rz(theta_i) Tz(d_i), the
origins are T_base_0 X_1 Z_1, X_2 Z_2, ... and X_(n+1) T_n_tip: a joint turns about, or slides along, z of its frame, or
-z if its direction is -1. If a row is longer than any robot, because it is between nearly parallel axes, the joints'
frames are moved along their axes instead, so that each is nearest to the one before it.
"""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np

from calib.basics.arrays import Array
from calib.robot.dh.json_file import robot_json
from calib.robot.dh.rows import MODIFIED, DHRobot, DHRow, DHTable, link_names, screw
from calib.robot.generated.cylinder_urdf import (
    GREY,
    NewJoint,
    bar,
    joint_body,
    link_radii,
    rods,
    urdf_bytes,
)

REMARK = "calib DH rows: "
"""Begins the comment of a URDF that holds the rows it was made from, as JSON."""

#: A row longer than this is between nearly parallel axes [m].
_FAR = 20.0

#: Radius of the rail that a joint slides on, over the radius of its link.
_RAIL = 0.5


def dh_urdf(robot: DHRobot) -> bytes:
    """Return the URDF of a robot, with its rows in a comment."""
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
    """Return the origins of the n joints and the tip, n + 1 poses (4, 4), and the ends (3,) of their X_i, [m]."""
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
