"""What stands around the robot and limits where it can be measured: boxes, the tracker and its noise, the reflector.

All of them are given in the frame of the robot's base link; the reflector's direction in that of its tip. And `kept`,
by which whatever is given of a cell is checked.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, fields
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.data.kinds import FARTHEST, no_rotation
from calib.errors import CalibError, choices
from calib.robot.robot import read_only
from calib.units import LENGTH, parse_quantity, symbols

Array = NDArray[np.float64]
Distance = TypeVar("Distance", float, Array)

#: Half angle of the cone that a corner-cube reflector is seen in, if nothing else is said [rad].
ACCEPTANCE = math.radians(30.0)


def kept(value: Any, what: str, must: str, convert: Callable[[Any], Any]) -> Any:  # noqa: ANN401
    """A value as it is kept: ``convert`` gives it, or refuses it by None, a TypeError or a ValueError; ``what`` is it.

    Raises:
        CalibError: It is refused.
    """
    try:
        found = convert(value)
    except (TypeError, ValueError):
        found = None
    if found is None:
        written = value.tolist() if isinstance(value, np.ndarray) else value
        raise CalibError(f"{what} is {written!r}; it must be {must}.")
    return found


def as_vector(value: ArrayLike) -> Array | None:
    """Three numbers, none so large that its digits no longer tell a position, shape (3,); None for anything else."""
    array = np.asarray(value, dtype=np.float64)
    good = array.shape == (3,) and bool((np.abs(array) <= FARTHEST).all())
    return read_only(array) if good else None


def as_rotation(value: ArrayLike) -> Array | None:
    """An orthonormal right-handed rotation, shape (3, 3); None for anything else."""
    R = np.asarray(value, dtype=np.float64)
    return read_only(R) if R.shape == (3, 3) and not no_rotation(R[None]).any() else None


def as_pose(value: ArrayLike) -> Array | None:
    """A pose, shape (4, 4): such a rotation and such a vector; None for anything else."""
    T = np.asarray(value, dtype=np.float64)
    if T.shape != (4, 4) or T[3].tolist() != [0, 0, 0, 1] or as_vector(T[:3, 3]) is None:
        return None
    return None if as_rotation(T[:3, :3]) is None else read_only(T)


VECTOR = "three finite numbers x, y, z"
POSE = "a 4 x 4 pose with a right-handed rotation [m]"


def vector(value: ArrayLike, what: str, unit: str = "m") -> Array:
    """Three finite numbers, shape (3,).

    Raises:
        CalibError: Anything else.
    """
    found: Array = kept(
        value, f"The {what}", f"{VECTOR} [{unit}], none beyond {FARTHEST:g}", as_vector
    )
    return found


class _Resent:
    """A value that is checked, and its arrays made read-only, again in another process."""

    __slots__ = ()

    def __reduce__(self) -> tuple[Any, ...]:
        """To another process and back."""
        return type(self), tuple(getattr(self, f.name) for f in fields(self))  # type: ignore[arg-type]


@dataclass(frozen=True, slots=True)
class TrackerNoise:
    """The noise of a laser tracker and of the robot that it looks at: the standard deviation of one coordinate.

    At a distance d sigma^2 = (constant + per_length d)^2 + repeatability^2. Data sheets print largest errors; what
    follows from them here is on the safe side. The default is a Leica AT901's 15 um + 6 um/m and a robot's 0.02 mm (the
    paper, section 2).
    """

    constant: float = 15e-6  #: [m].
    per_length: float = 6e-6  #: [m/m].
    repeatability: float = 20e-6  #: Of the robot, [m].

    def __post_init__(self) -> None:
        """Refuse what is no standard deviation, and three zeros."""
        values = (self.constant, self.per_length, self.repeatability)
        if not all(v >= 0.0 for v in values) or not any(values):
            raise CalibError(
                f"The noise is {self.constant!r} m + {self.per_length!r} m/m, the repeatability {self.repeatability!r} "
                "m; none may be below 0, and not all 0."
            )

    def std(self, distance: Distance) -> Distance:
        """Standard deviation of one coordinate at a distance from the instrument, a float or an array [m]."""
        result: Distance = (
            (self.constant + self.per_length * distance) ** 2 + self.repeatability**2
        ) ** 0.5
        return result


def parse_noise(text: str, what: str, repeatability: float = 0.0) -> TrackerNoise:
    """``15 um + 6 um/m``, or ``0.05 mm``, as a noise; ``what`` was given it, for the message.

    Raises:
        CalibError: Anything else.
    """
    match = re.fullmatch(r"(.+?[A-Za-zµμ])\s*(?:\+(.+)/\s*m\s*)?", text)
    try:
        found = [parse_quantity(part) for part in match.groups() if part] if match else []
    except CalibError:
        found = []
    if not found or any(kind != LENGTH or value < 0.0 for value, kind in found):
        raise CalibError(
            f'{what} was given as "{text}"; it must be a length, such as "0.05 mm", or a length and one for each metre '
            f'of distance, such as "15 um + 6 um/m". The units are {choices(symbols("length"))}.'
        )
    values = [value for value, _ in found]
    return TrackerNoise(values[0], values[1] if len(values) > 1 else 0.0, repeatability)


@dataclass(frozen=True, slots=True, eq=False)
class Box(_Resent):
    """A box that the robot must not touch and the beam must not cross."""

    name: str  #: For messages; each box of a cell has its own.
    size: Array  #: shape (3,), lengths of the edges along x, y, z of the box [m].
    T_base_box: Array  #: shape (4, 4), pose of the box's centre in the robot's base [m].

    def __post_init__(self) -> None:
        """Check and keep read-only copies."""
        size = vector(self.size, f"size of the box '{self.name}'")
        if not (size > 0.0).all():
            raise CalibError(
                f"The box '{self.name}' has the edges {size.tolist()} m; each must be longer than 0."
            )
        pose = kept(self.T_base_box, f"The pose of the box '{self.name}'", POSE, as_pose)
        object.__setattr__(self, "size", size)
        object.__setattr__(self, "T_base_box", pose)


@dataclass(frozen=True, slots=True, eq=False)
class Tracker(_Resent):
    """A laser tracker: where it stands, how far it sees, how well it measures."""

    position: Array  #: shape (3,), the point that its beam turns about, in the robot's base [m].
    nearest: float = 0.0  #: Least distance that it measures [m].
    farthest: float = 80.0  #: Largest distance that it measures [m].
    #: Standard deviation of a coordinate, by distance.
    noise: TrackerNoise = field(default_factory=TrackerNoise)

    def __post_init__(self) -> None:
        """Check and keep a read-only copy."""
        object.__setattr__(self, "position", vector(self.position, "tracker's position"))
        if not 0.0 <= self.nearest < self.farthest:
            raise CalibError(
                f"The tracker measures from {self.nearest!r} m to {self.farthest!r} m; the first must not be below 0 "
                "and less than the second."
            )


@dataclass(frozen=True, slots=True, eq=False)
class Reflector(_Resent):
    """A reflector that is fixed to the tip and is seen from within a cone only."""

    #: shape (3,), unit vector in the tip: where the reflector's opening faces; it is made one if it is not.
    normal: Array
    # Largest angle between it and the direction to the tracker [rad].
    acceptance: float = ACCEPTANCE

    def __post_init__(self) -> None:
        """Check and keep a read-only unit vector."""
        normal = vector(self.normal, "reflector's normal", "-")
        length = float(np.linalg.norm(normal))
        if not length > 1e-100:
            raise CalibError(
                f"The reflector's normal is {normal.tolist()}; it must be a direction, such as [0, 0, 1]."
            )
        object.__setattr__(self, "normal", read_only(normal / length))
        if not 0.0 < self.acceptance <= math.pi:
            raise CalibError(
                f"The reflector's acceptance is {self.acceptance!r} rad; it must be a half angle above 0 and at most "
                "pi (180 deg)."
            )


def checked_boxes(boxes: Iterable[Box]) -> tuple[Box, ...]:
    """Boxes as a tuple, each with a name of its own.

    Raises:
        CalibError: A name twice.
    """
    names = [box.name for box in boxes]
    twice = dict.fromkeys(name for name in names if names.count(name) > 1)
    if twice:
        raise CalibError(
            f"Each box needs a name of its own; given more than once: {choices(twice)}."
        )
    return tuple(boxes)


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
