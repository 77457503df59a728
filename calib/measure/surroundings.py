"""What stands around the robot and limits where it can be measured: boxes, the tracker, the reflector.

All of them are given in the frame of the robot's base link; the reflector's direction in that of its tip.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.errors import CalibError, choices
from calib.measure.cell_parts import by_name, is_number, pose, vector
from calib.measure.noise import TrackerNoise
from calib.model.robot import read_only

Array = NDArray[np.float64]

#: Half angle of the cone that a corner-cube reflector is seen in, if nothing else is said [rad].
ACCEPTANCE = math.radians(30.0)

_NOISE = TrackerNoise()


@dataclass(frozen=True, slots=True, eq=False)
class Box:
    """A box that the robot must not touch and the beam must not cross.

    Attributes:
        name: For messages; each box of a cell has its own.
        size: shape (3,), lengths of the edges along x, y, z of the box [m].
        T_base_box: shape (4, 4), pose of the box's centre in the robot's base [m].
    """

    name: str
    size: Array
    T_base_box: Array

    def __post_init__(self) -> None:
        """Check and keep read-only copies."""
        if not isinstance(self.name, str) or not self.name.strip():
            raise CalibError(f"A box needs a name; {self.name!r} was given.")
        size = vector(self.size, f"size of the box '{self.name}'")
        if not (size > 0.0).all():
            raise CalibError(
                f"The box '{self.name}' has the edges {size.tolist()} m; each must be longer than 0."
            )
        object.__setattr__(self, "size", size)
        object.__setattr__(
            self, "T_base_box", pose(self.T_base_box, f"The pose of the box '{self.name}'")
        )

    def __reduce__(self) -> tuple[Any, ...]:
        """To another process and back: checked, and its arrays made read-only, again there."""
        return Box, (self.name, self.size, self.T_base_box)


@dataclass(frozen=True, slots=True, eq=False)
class Tracker:
    """A laser tracker: where it stands, how far it sees, how well it measures.

    Attributes:
        position: shape (3,), the point that its beam turns about, in the robot's base [m].
        nearest: Least distance that it measures [m].
        farthest: Largest distance that it measures [m].
        noise: Standard deviation of a coordinate, by distance.
    """

    position: Array
    nearest: float = 0.0
    farthest: float = 80.0
    noise: TrackerNoise = field(default_factory=lambda: _NOISE)

    def __post_init__(self) -> None:
        """Check and keep a read-only copy."""
        object.__setattr__(self, "position", vector(self.position, "tracker's position"))
        near, far = self.nearest, self.farthest
        if not is_number(near) or not is_number(far) or not 0.0 <= near < far:
            raise CalibError(
                f"The tracker measures from {near!r} m to {far!r} m; these must be two numbers, the first not below 0 "
                "and less than the second."
            )
        if not isinstance(self.noise, TrackerNoise):
            raise CalibError(
                f"The tracker's noise must be of type TrackerNoise; {self.noise!r} was given."
            )

    def __reduce__(self) -> tuple[Any, ...]:
        """To another process and back."""
        return Tracker, (self.position, self.nearest, self.farthest, self.noise)


@dataclass(frozen=True, slots=True, eq=False)
class Reflector:
    """A reflector that is fixed to the tip and is seen from within a cone only.

    Attributes:
        normal: shape (3,), unit vector in the tip: where the reflector's opening faces; it is made one if
            it is longer or shorter.
        acceptance: Largest angle between it and the direction to the tracker [rad].
    """

    normal: Array
    acceptance: float = ACCEPTANCE

    def __post_init__(self) -> None:
        """Check and keep a read-only unit vector."""
        normal = vector(self.normal, "reflector's normal", "-")
        length = float(np.linalg.norm(normal))
        if not 1e-100 < length < 1e100:
            raise CalibError(
                f"The reflector's normal is {normal.tolist()}; it must be a direction, such as [0, 0, 1]."
            )
        object.__setattr__(self, "normal", read_only(normal / length))
        if not is_number(self.acceptance) or not 0.0 < self.acceptance <= math.pi:
            raise CalibError(
                f"The reflector's acceptance is {self.acceptance!r} rad; it must be a half angle above 0 and at most "
                "pi (180 deg)."
            )

    def __reduce__(self) -> tuple[Any, ...]:
        """To another process and back."""
        return Reflector, (self.normal, self.acceptance)


def checked_boxes(boxes: Iterable[Box]) -> tuple[Box, ...]:
    """Boxes as a tuple, each with a name of its own.

    Raises:
        CalibError: Something else than boxes, or a name twice.
    """
    if not isinstance(boxes, (tuple, list)) or not all(isinstance(box, Box) for box in boxes):
        raise CalibError(f"The boxes are a tuple of Box; {boxes!r} was given.")
    names = [box.name for box in boxes]
    twice = dict.fromkeys(name for name in names if names.count(name) > 1)
    if twice:
        raise CalibError(
            f"Each box needs a name of its own; given more than once: {choices(twice)}."
        )
    return tuple(boxes)


def checked_ranges(ranges: object) -> Mapping[str, tuple[float, float]]:
    """Ranges of joints [rad] or [m] by name, the least and the largest value of each.

    Raises:
        CalibError: Not two finite numbers, or the first not less than the second.
    """
    result = {}
    for name, given in by_name(ranges, "joints' ranges").items():
        pair = tuple(given) if isinstance(given, (tuple, list)) else ()
        if len(pair) != 2 or not all(map(is_number, pair)) or not pair[0] < pair[1]:
            raise CalibError(
                f"The range of the joint '{name}' is {given!r}; it must be the least and the largest value [rad or m], "
                "the first less than the second. To keep a joint where it is, hold it (--hold)."
            )
        # A number that knows its unit keeps it.
        low, high = (one if isinstance(one, float) else float(one) for one in pair)
        result[name] = (low, high)
    return MappingProxyType(result)


def check_outside(tracker: Tracker, boxes: Iterable[Box]) -> None:
    """Refuse a tracker inside a box: it sees nothing from there.

    Raises:
        CalibError: It is; the text says in which.
    """
    for box in boxes:
        inside = box.T_base_box[:3, :3].T @ (tracker.position - box.T_base_box[:3, 3])
        if (np.abs(inside) <= 0.5 * box.size).all():
            x, y, z = (f"{1e3 * v:g}" for v in tracker.position)
            raise CalibError(
                f"The tracker, at ({x}, {y}, {z}) mm of the base, stands inside the box '{box.name}', and sees nothing "
                "from there. Move one of the two, or leave out a box that is the tracker's own stand."
            )
