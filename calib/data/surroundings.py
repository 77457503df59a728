"""Surroundings of the robot while it is measured: instrument with its noise, reflector, obstacles, known distances."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from calib.basics.arrays import Array, read_only
from calib.basics.records import embedded, keep_checked, key, keys
from calib.basics.units import noise_text, parse_noise
from calib.basics.value_forms import (
    DEGREES,
    MM,
    POINT_MM,
    Form,
    Place,
    checked,
    one_of,
    text,
    three_numbers,
)
from calib.basics.values import Value
from calib.data.cell_keys import IS_POSE, pose_keys, write_pose
from calib.errors import CalibError, choices
from calib.numerics.geometry import pose_of, vector

Distance = TypeVar("Distance", float, Array)

#: A given direction that is shorter has none: its squares leave the range of doubles.
_SHORTEST_NORMAL = 1e-100


def _read_robot(value: Any, place: Place) -> str:  # noqa: ANN401
    """Return a robot as `calib.robot.urdf.read_urdf` takes it: a file that exists beside the cell file as its path."""
    if not isinstance(value, str) or not value:
        raise CalibError(f"{place} is {value!r}; it must be the path of a URDF, or a robot's name.")
    beside = place.folder / value
    return str(beside) if beside.is_file() else value


#: The form of a robot: the path of its file, or its name.
def _write_robot(robot: str) -> str:
    """Return a robot as a file in any folder names it: by the whole path of its file."""
    path = Path(robot)
    return str(path.resolve()) if path.is_file() else robot


_ROBOT = Form("the path of a URDF, or the name of a robot", _read_robot, _write_robot)


def _noise_form(part: int) -> Form:
    """Return the form of an instrument's noise, of which part 0, the constant [m], or 1, the slope [m/m], is read."""

    def read(value: Any, place: Place) -> float:  # noqa: ANN401
        return parse_noise(str(value), str(place))[part]

    return Form('a noise with its unit, "15 um + 6 um/m"', read)


@dataclass(frozen=True, slots=True)
class TrackerNoise:
    """Noise of a laser tracker and of the robot's repeatability: standard deviation of one coordinate.

    At a distance d [m], sigma^2 = (constant + per_length d)^2 + repeatability^2. Data sheets print
    largest errors; taking them for standard deviations is on the safe side. The default is a Leica
    AT901's 15 um + 6 um/m and a robot's 0.02 mm (the paper, section 2).
    """

    #: Standard deviation at no distance [m].
    constant: float = key(
        "noise",
        _noise_form(0),
        "Standard deviation of one coordinate: a constant, plus a part for each metre of distance.",
        default=15e-6,
        absent="15 um + 6 um/m",
        of_record=lambda noise: noise_text(noise.constant, noise.per_length),
    )
    #: Increase with the distance [m/m].
    per_length: float = key("noise", _noise_form(1), "", default=6e-6)
    #: Standard deviation of the robot's position, one coordinate [m].
    repeatability: float = key(
        "repeatability_mm",
        MM,
        "Repeatability of the robot, as a standard deviation of one coordinate; added in quadrature.",
        default=20e-6,
    )

    def __post_init__(self) -> None:
        """Check that no part is negative, and that not all are zero; raises `CalibError`."""
        parts = (self.constant, self.per_length, self.repeatability)
        if not min(parts) >= 0.0 or not any(parts):
            raise CalibError(f"A noise is {parts} m; none may be below 0, and not all 0.")

    def std(self, distance: Distance) -> Distance:
        """Return the standard deviation of one measured coordinate.

        Args:
            distance: Distance from the instrument to the target, a number or an array [m].

        Returns:
            The standard deviation, of the same shape [m].
        """
        instrument = self.constant + self.per_length * distance
        return (instrument**2 + self.repeatability**2) ** 0.5  # type: ignore[no-any-return]


@dataclass(frozen=True, slots=True, eq=False)
class Box(Value):
    """A box that the robot must not touch and the tracker's beam must not cross."""

    #: For messages; each box of a cell has its own.
    name: str = key("name", text("a name"), "Name of the box, its own.")
    #: Shape (3,), lengths of the edges along x, y, z of the box [m].
    size: Array = key("size_mm", POINT_MM, "Lengths of the edges along x, y, z of the box.")
    #: Shape (4, 4), pose of the box's centre in the robot's base [m].
    T_base_box: Array = keys(
        lambda: pose_keys("", "the box's centre in the robot's base", needed=True),
        pose_of,
        write=write_pose(""),
    )

    def __post_init__(self) -> None:
        """Check size and pose (`CalibError`), and keep read-only copies."""
        size = vector(self.size, f"size of the box '{self.name}'")
        if not (size > 0.0).all():
            raise CalibError(
                f"The box '{self.name}' has the edges {size.tolist()} m; each must be longer "
                "than 0."
            )
        what = f"The pose of the box '{self.name}'"
        T_base_box = checked(self.T_base_box, what, IS_POSE.must, IS_POSE.convert)
        object.__setattr__(self, "size", size)
        object.__setattr__(self, "T_base_box", T_base_box)


@dataclass(frozen=True, slots=True, eq=False)
class FurtherRobot(Value):
    """A robot of the cell besides the first one, and where it stands."""

    #: Path of a URDF, a xacro or DH rows, or a robot's name, as of the first robot.
    robot: str = key(
        "robot",
        _ROBOT,
        "URDF, xacro or DH rows of the robot, relative to the cell file, or the name of a robot.",
    )
    #: Pose of its root link in the first robot's, shape (4, 4), [m]; None: not stated.
    T_root_base: Array | None = keys(
        lambda: pose_keys("", "its root link in that of the first robot"),
        pose_of,
        default=None,
        check=IS_POSE,
        write=write_pose(""),
    )
    #: True if that pose is estimated.
    estimated: bool = key(
        "mount",
        one_of({"known": False, "estimate": True}),
        "Whether the pose is known or estimated.",
        default=True,
    )

    def __post_init__(self) -> None:
        """Check the values; raises `CalibError`."""
        keep_checked(self, "further robot")
        if self.T_root_base is None and not self.estimated:
            raise CalibError(
                f"The pose of the robot '{self.robot}' is marked as known, but is not given; give xyz_mm and rpy_deg, "
                "or let it be estimated."
            )


def check_box_names(boxes: Iterable[Box]) -> None:
    """Check that each box has a name of its own.

    Raises:
        CalibError: Several boxes have one name; the message lists such names.
    """
    names = [box.name for box in boxes]
    repeated = dict.fromkeys(name for name in names if names.count(name) > 1)
    if repeated:
        raise CalibError(f"Each box needs a name of its own; more than one is {choices(repeated)}.")


@dataclass(frozen=True, slots=True, eq=False)
class Tracker(Value):
    """A laser tracker: its position, its range and its noise."""

    #: Shape (3,), point that its beam turns about, in the robot's base [m].
    position: Array = key(
        "xyz_mm", POINT_MM, "Centre of rotation of the beam, in the robot's base."
    )
    #: Least distance that it measures [m].
    nearest: float = key("nearest_mm", MM, "Smallest distance that it measures.", default=0.0)
    #: Largest distance that it measures [m].
    farthest: float = key("farthest_mm", MM, "Largest distance that it measures.", default=80.0)
    #: Standard deviation of a coordinate, as a function of the distance.
    noise: TrackerNoise = embedded(TrackerNoise, default_factory=TrackerNoise)

    def __post_init__(self) -> None:
        """Check position and range (`CalibError`), and keep a read-only copy."""
        object.__setattr__(self, "position", vector(self.position, "tracker's position"))
        if not 0.0 <= self.nearest < self.farthest:
            raise CalibError(
                f"The tracker measures from {self.nearest:g} m to {self.farthest:g} m; give a "
                "range from 0 or more."
            )


@dataclass(frozen=True, slots=True, eq=False)
class Reflector(Value):
    """A reflector that is fixed to the tip and is seen from within a cone only."""

    #: shape (3,), direction in the tip that the reflector's opening faces; kept as a unit vector.
    normal: Array = key(
        "normal", three_numbers(), "Viewing direction of the reflector, in the tip."
    )
    #: Half angle of the cone [rad]. The default is that of a corner cube.
    acceptance: float = key(
        "acceptance_deg",
        DEGREES,
        "Largest angle between the normal and the direction to the tracker.",
        default=math.radians(30.0),
    )

    def __post_init__(self) -> None:
        """Check direction and angle (`CalibError`), and keep a read-only unit vector."""
        normal = vector(self.normal, "reflector's normal")
        length = float(np.linalg.norm(normal))
        has_direction = length > _SHORTEST_NORMAL
        if not (has_direction and 0.0 < self.acceptance <= math.pi):
            raise CalibError(
                f"The reflector's normal is {normal.tolist()}, its acceptance "
                f"{np.degrees(self.acceptance):g} deg; give a direction, such as [0, 0, 1], and a "
                "half angle above 0 and at most 180 deg."
            )
        object.__setattr__(self, "normal", read_only(normal / length))


@dataclass(frozen=True, slots=True)
class GroupDistance:
    """A known distance between the fixed points of two groups, such as two sockets on one plate.

    Example:
        >>> plate = GroupDistance("*/left", "*/right", length=0.2, sigma=1e-5)
        >>> plate.pairs(["1/left", "1/right", "2/left", "2/right"])
        (('1/left', '1/right'), ('2/left', '2/right'))
    """

    #: Name of a group. It may hold one ``*``, which then stands for any text.
    first: str = key("first", text("a name"), "Name of a group; `*` stands for any text.")
    #: Name of another one; its ``*`` stands for the same text.
    second: str = key("second", text("a name"), "Name of another group; `*` stands for the same.")
    #: Known distance [m].
    length: float = key("length_mm", MM, "Known distance.")
    #: Standard deviation of the length [m].
    sigma: float = key("sigma_mm", MM, "Standard deviation of the distance.")

    def __post_init__(self) -> None:
        """Check the names, the length and its standard deviation; raises `CalibError`."""
        stars = (self.first.count("*"), self.second.count("*"))
        are_names = stars in ((0, 0), (1, 1)) and self.first != self.second
        if not are_names or min(self.length, self.sigma) <= 0.0:
            raise CalibError(
                f"A distance is {self.length:g} m, its sigma {self.sigma:g} m, between the groups "
                f"'{self.first}' and '{self.second}'; it must be between two groups, with '*' once "
                "in both names or in neither, and length and sigma above 0."
            )

    def pairs(self, groups: Iterable[str]) -> tuple[tuple[str, str], ...]:
        """Return the pairs of groups that the distance is between.

        Args:
            groups: Names of groups, such as one for each row of a table.

        Returns:
            Names that match ``first`` and ``second``, each pair once, in the order of ``groups``.
        """
        present = dict.fromkeys(groups)
        pattern = re.escape(self.first).replace(r"\*", "(.*)")
        result = []
        for group in present:
            match = re.fullmatch(pattern, group, re.DOTALL)
            if match is None:
                continue
            partner = self.second.replace("*", "".join(match.groups()))
            if partner in present and partner != group:
                result.append((group, partner))
        return tuple(result)
