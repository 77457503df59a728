"""Cylinders that draw the links and joints of a robot of which only the kinematics are known."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from calib.robot import kernel
from calib.robot.dh.rows import screw
from calib.robot.generated.urdf_text import Cylinder
from calib.units import Array

#: Radius of the first link, and of the last, in lengths of the stretched robot.
_THICK, _THIN = 0.035, 0.018

#: Radius of a joint in radii of its link, and its length in the same.
_JOINT, _JOINT_LENGTH = 1.3, 2.8

#: A stretch of a link shorter than this share of its radius lies inside its joints, and is not drawn.
_SHORT = 0.5

GREY = (0.75, 0.77, 0.8)
"""Colour of links: red, green, blue."""

#: Colour of joints.
_ORANGE = (0.9, 0.5, 0.15)


def link_radii(origins: Sequence[Array]) -> Array:
    """Return the radius of each moving link, shape (n,), [m], less and less towards the tip."""
    length = sum(float(np.linalg.norm(T[:3, 3])) for T in origins)
    shares = np.linspace(_THICK, _THIN, len(origins) - 1)
    return np.asarray(max(length, 0.1) * shares)


def joint_body(radius: float) -> Cylinder:
    """Return the body of a joint along z of its frame.

    Args:
        radius: Radius of the link that it carries [m].
    """
    half = 0.5 * _JOINT_LENGTH * radius
    return bar(-half, half, _JOINT * radius, _ORANGE)


def rods(path: Sequence[Array], radius: float) -> Iterator[Cylinder]:
    """Yield the cylinders between the points of a path."""
    for start, end in pairwise(path):
        length = float(np.linalg.norm(end - start))
        if length > _SHORT * radius:
            T = np.eye(4)
            T[:3, :3] = kernel.turns_to(((end - start) / length)[None])[0]
            T[:3, 3] = (start + end) / 2.0
            yield Cylinder(T, radius, length, GREY)


def bar(start: float, end: float, radius: float, colour: tuple[float, float, float]) -> Cylinder:
    """Return a cylinder along z from start to end [m]."""
    return Cylinder(screw(2, 0.0, (start + end) / 2.0), radius, end - start, colour)
