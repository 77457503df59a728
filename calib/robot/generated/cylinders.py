"""Cylinders that draw the links and joints of a robot of which only the kinematics are known."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from calib.basics.arrays import Array
from calib.robot import kernel
from calib.robot.dh.rows import screw
from calib.robot.generated.urdf_text import Cylinder

#: Radius of the first link, in lengths of the stretched robot.
_FIRST_RADIUS = 0.035

#: Radius of the last link, in the same.
_LAST_RADIUS = 0.018

#: Radius of a joint, in radii of its link.
_JOINT_RADIUS = 1.3

#: Length of a joint, in the same.
_JOINT_LENGTH = 2.8

#: A stretch of a link shorter than this lies inside its joints and is not drawn; in radii of the link.
_SHORTEST_ROD = 0.5

#: The links of a shorter robot are drawn as thick as those of one of this length [m].
_SHORTEST_ROBOT = 0.1

GREY = (0.75, 0.77, 0.8)
"""Colour of links: red, green, blue."""

#: Colour of joints.
_ORANGE = (0.9, 0.5, 0.15)


def link_radii(origins: Sequence[Array]) -> Array:
    """Return the radius of each moving link, which falls from the first to the last.

    Args:
        origins: T_parent_joint of the n joints and of the tip behind them, n + 1 poses (4, 4), [m].

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
        path: Points (3,) in the link's frame, [m], one after the other.
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
