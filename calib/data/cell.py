"""Cell: what stands around the robot while it is measured, and what of it is known.

The measurement frames, the targets on the tip, the instrument and its noise, what must not be touched, how large errors
are expected to be, what the tip carries, and which parameters are estimated. All of it can stand in a TOML file,
``--cell cell.toml``; see docs/cell.md.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

import calib.data.kinds as registry
from calib.data.cell_file import kept, pose, read_cell_file
from calib.data.kinds import FARTHEST, SIGMAS, no_rotation
from calib.errors import CalibError, FileError, choices
from calib.model.error_model import DIRECTIONS
from calib.model.families import family_of
from calib.robot.gravity import GRAVITY
from calib.robot.payload import Payload
from calib.robot.robot import read_only
from calib.units import Array, is_number

Distance = TypeVar("Distance", float, Array)

#: The model that lets the data choose.
AUTO = "auto"

#: What `Cell.repeats` and `Priors.source` may be.
REPEATS, PRIOR_SOURCES = ("weighted", "average", "independent"), ("data", "given", "off")

#: A prior outside of these says nothing, or is a constraint; their squares would leave the range of numbers.
PRIORS = (1e-15, 1e6)

_POSE = "a 4 x 4 pose with a right-handed rotation [m]"


def vector(value: ArrayLike, what: str) -> Array:
    """Three numbers, none so large that its digits no longer tell a position, shape (3,), read-only.

    Raises:
        CalibError: Anything else.
    """
    array = np.asarray(value, dtype=np.float64)
    if array.shape != (3,) or not (np.abs(array) <= FARTHEST).all():
        raise CalibError(
            f"The {what} is {array.tolist()}; it must be three finite numbers x, y, z, none beyond {FARTHEST:g}."
        )
    return read_only(array)


def _rotation(value: ArrayLike) -> Array | None:
    """An orthonormal right-handed rotation, shape (3, 3); None for anything else."""
    R = np.asarray(value, dtype=np.float64)
    return read_only(R) if R.shape == (3, 3) and not no_rotation(R[None]).any() else None


def _pose(value: ArrayLike) -> Array | None:
    """A pose, shape (4, 4): such a rotation and such a vector; None for anything else."""
    T = np.asarray(value, dtype=np.float64)
    good = T.shape == (4, 4) and T[3].tolist() == [0, 0, 0, 1] and _rotation(T[:3, :3]) is not None
    return read_only(T) if good and (np.abs(T) <= FARTHEST).all() else None


@dataclass(frozen=True, slots=True, init=False)
class Priors:
    """How large a robot's errors are expected to be: zero-mean normal distributions, a size for each family.

    Example:
        >>> Priors("given", length=1e-3).of("length")
        0.001
    """

    #: ``"data"``: the sizes are found from the measurements, starting at those given; ``"given"``: they are those
    #: given; ``"off"``: none, plain least squares, but for a leash on what no measurement determines.
    source: str
    #: Standard deviations by family that are other than its row of the registry has, in the family's unit.
    given: tuple[tuple[str, float], ...]

    def __init__(self, source: str = "data", **given: float) -> None:
        """Sizes by name: ``Priors("given", length=1e-3, compliance=2e-6)``.

        Raises:
            CalibError: An unknown word or family, or a size that is no standard deviation.
        """
        if source not in PRIOR_SOURCES:
            raise CalibError(
                f"Priors of the kind '{source}' were asked for; choose one of {choices(PRIOR_SOURCES)}."
            )
        for name, value in given.items():
            if not PRIORS[0] <= value <= PRIORS[1]:
                raise CalibError(
                    f"The prior's {name} is {value:g} {family_of(name).unit.symbol}; it lies between {PRIORS[0]:g} "
                    f"and {PRIORS[1]:g}. Use the source 'off' for none."
                )
        object.__setattr__(self, "source", source)
        others = [(name, v) for name, v in given.items() if v != family_of(name).prior]
        object.__setattr__(self, "given", tuple(sorted(others)))

    def with_source(self, source: str) -> Priors:
        """The same standard deviations, used otherwise: ``"data"``, ``"given"`` or ``"off"``."""
        return Priors(source, **dict(self.given))

    def of(self, family: str) -> float:
        """The standard deviation of a family's errors, in its unit: as given, or that of its row of the registry."""
        return dict(self.given).get(family, family_of(family).prior)


@dataclass(frozen=True, slots=True)
class GroupDistance:
    """A known distance between the fixed points of two groups, such as two sockets on one plate.

    Example:
        >>> plate = GroupDistance("*/left", "*/right", length=0.2, sigma=1e-5)
        >>> plate.pairs(["1/left", "1/right", "2/left", "2/right"])
        (('1/left', '1/right'), ('2/left', '2/right'))
    """

    first: str  #: Name of a group. It may hold one ``*``, which then stands for any text.
    second: str  #: Name of another one; its ``*`` stands for the same text.
    length: float  #: [m].
    sigma: float  #: Standard deviation of the length [m].

    def __post_init__(self) -> None:
        """Refuse names that cannot be matched and lengths that are none."""
        stars = self.first.count("*"), self.second.count("*")
        if (
            stars not in ((0, 0), (1, 1))
            or self.first == self.second
            or min(self.length, self.sigma) <= 0.0
        ):
            raise CalibError(
                f"A distance is {self.length:g} m, its sigma {self.sigma:g} m, between the groups '{self.first}' and "
                f"'{self.second}'; it must be between two groups, with '*' once in both names or in neither, and "
                "length and sigma above 0."
            )

    def pairs(self, groups: Iterable[str]) -> tuple[tuple[str, str], ...]:
        """The pairs of these groups that the distance is between, each once, in the groups' order."""
        present = dict.fromkeys(groups)
        pattern = re.escape(self.first).replace(r"\*", "(.*)")
        found = []
        for match in filter(None, (re.fullmatch(pattern, group, re.DOTALL) for group in present)):
            other = self.second.replace("*", "".join(match.groups()))
            if other in present and other != match[0]:
                found.append((match[0], other))
        return tuple(found)


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
        if not min(values) >= 0.0 or not any(values):
            raise CalibError(f"A noise is {values} m; none may be below 0, and not all 0.")

    def std(self, distance: Distance) -> Distance:
        """Standard deviation of one coordinate at a distance from the instrument, a float or an array [m]."""
        return (  # type: ignore[no-any-return]
            (self.constant + self.per_length * distance) ** 2 + self.repeatability**2
        ) ** 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Box:
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
        T = kept(self.T_base_box, f"The pose of the box '{self.name}'", _POSE, _pose)
        object.__setattr__(self, "size", size)
        object.__setattr__(self, "T_base_box", T)


@dataclass(frozen=True, slots=True, eq=False)
class Tracker:
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
                f"The tracker measures from {self.nearest:g} m to {self.farthest:g} m; give a range from 0 or more."
            )


@dataclass(frozen=True, slots=True, eq=False)
class Reflector:
    """A reflector that is fixed to the tip and is seen from within a cone only."""

    #: shape (3,), unit vector in the tip: where the reflector's opening faces; it is made one if it is not.
    normal: Array
    #: Largest angle between it and the direction to the tracker [rad]; a corner cube's, if nothing else is said.
    acceptance: float = math.radians(30.0)

    def __post_init__(self) -> None:
        """Check and keep a read-only unit vector."""
        normal = vector(self.normal, "reflector's normal")
        length = float(np.linalg.norm(normal))
        if not (length > 1e-100 and 0.0 < self.acceptance <= math.pi):
            raise CalibError(
                f"The reflector's normal is {normal.tolist()}, its acceptance {np.degrees(self.acceptance):g} deg; "
                "give a direction, such as [0, 0, 1], and a half angle above 0 and at most 180 deg."
            )
        object.__setattr__(self, "normal", read_only(normal / length))


def _check_boxes(boxes: Iterable[Box]) -> None:
    """Refuse boxes of one name."""
    names = [box.name for box in boxes]
    if twice := dict.fromkeys(name for name in names if names.count(name) > 1):
        raise CalibError(f"Each box needs a name of its own; more than one is {choices(twice)}.")


def _within(low: float, high: float, unit: str) -> tuple[str, Callable[[Any], float | None]]:
    """A number in a range; one that knows its unit keeps it."""

    def convert(value: Any) -> float | None:  # noqa: ANN401
        """The number, or None."""
        return value if is_number(value) and low <= value <= high else None

    return f"a number from {low:g} to {high:g} {unit}", convert


def _directions(value: Iterable[str]) -> tuple[str, ...] | None:
    """Some of the directions of a frame, in their order."""
    found = tuple(d for d in DIRECTIONS if d in value)
    return found if found and sorted(found) == sorted(value) else None


def _tie(value: tuple[str, float]) -> tuple[str, float] | None:
    """Another parameter and a factor."""
    name, factor = value
    return (name, float(factor)) if is_number(factor) and factor else None


def _interval(value: tuple[float, float]) -> tuple[float, float] | None:
    """Two numbers, the first less than the second; those that know their unit keep it."""
    low, high = value
    return (low, high) if low < high else None


def _bounds(value: tuple[float, float]) -> tuple[float, float] | None:
    """The least and the largest change; an infinite one is none."""
    return _interval(value) if value[0] <= 0.0 <= value[1] else None


#: What an attribute of a cell must be, and what gives the value that is kept, or None.
_FIELDS: Mapping[str, tuple[str, Callable[[Any], Any]]] = {
    "T_frame_base": (_POSE, _pose),
    "sigma": _within(*SIGMAS, "m"),
    "sigma_angle": _within(*SIGMAS, "rad"),
    "target_rotation": ("a 3 x 3 right-handed rotation", _rotation),
    "frame_directions": (f"some of {choices(DIRECTIONS)}, each once", _directions),
    "frozen": ("names", tuple),
    "repeats": (f"one of {choices(REPEATS)}", lambda v: v if v in REPEATS else None),
}

#: The same of each value of the attributes that are mappings from names.
_NAMED: Mapping[str, tuple[str, Callable[[Any], Any]]] = {
    "targets": ("three numbers [m]", lambda value: vector(value, "target")),
    "frames": _FIELDS["T_frame_base"],
    "ties": ("another parameter and a factor that is not zero, such as ('a2', 1.0)", _tie),
    "bounds": ("the least and the largest change, with 0 between them, (-0.001, 0.001)", _bounds),
    "parameter_priors": _within(*PRIORS, "of the parameter's unit"),
    "held": _within(-FARTHEST, FARTHEST, "rad or m"),
    "ranges": ("the least and the largest value [rad or m]", _interval),
}


def _none() -> Mapping[str, Any]:
    """A mapping without entries that cannot be written to."""
    return MappingProxyType({})


@dataclass(frozen=True, slots=True, eq=False)
class Cell:
    """The set-up of a calibration.

    Parameters are named as `calib inspect` prints them. A change is what is added to a parameter's nominal value, in
    its unit: [m], [rad], [rad/Nm], [m/N], or [rad/rad] for a gain.
    """

    #: shape (3,), position of the target in the tip [m]; None where it is not known.
    target: Array | None = None
    #: Whether the targets are estimated with the robot (their start is found from the data).
    estimate_target: bool = True
    #: shape (4, 4), pose of the base in the measurement frame [m]; None where it is not given: then it is estimated,
    #: or, if it is said to be known, the measurements are in the base frame itself.
    T_frame_base: Array | None = None
    estimate_frame: bool = False  #: Whether the measurement frames are estimated.
    #: Standard deviation of one measured coordinate or length [m]; None: found from the data.
    sigma: float | None = None
    #: How large the robot's errors are expected to be.
    priors: Priors = field(default_factory=Priors)
    #: What is estimated of the robot: ``"auto"``, as much as the measurements support, or a parameter set such as
    #: ``"dh"``, and families of errors behind it, ``"dh+gain+compliance"``.
    model: str = AUTO
    frozen: tuple[str, ...] = ()  #: Names of parameters that stay at their nominal values.
    base: str | None = None  #: Base link; None: left to the command line or the URDF.
    tip: str | None = None  #: Tip link, likewise.
    #: Positions, shape (3,) each, of targets by name [m]; they win over ``target``.
    targets: Mapping[str, Array] = field(default_factory=_none)
    #: shape (3, 3), R_tip_target, orientation of the targets in the tip; None where it is not known.
    target_rotation: Array | None = None
    #: Poses T_frame_base, shape (4, 4) each, by group [m]; they win over ``T_frame_base``.
    frames: Mapping[str, Array] = field(default_factory=_none)
    #: Which of `DIRECTIONS`, the axes of the base, are estimated where frames are.
    frame_directions: tuple[str, ...] = DIRECTIONS
    #: Standard deviation of one measured angle [rad]; None: found from the data.
    sigma_angle: float | None = None
    #: Whether the instrument's scale was certified or checked against a known length; else lengths of the arm may
    #: hide an error of it.
    scale_certified: bool = False
    kind: str | None = None  #: Kind of all measurements; None: as the table says.
    #: Parameters that follow others, ``x_name = factor * x_other``: for each name the other's and the factor.
    ties: Mapping[str, tuple[str, float]] = field(default_factory=_none)
    #: The least and the largest change of parameters by name; they contain 0.
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=_none)
    #: Standard deviations of the changes of single parameters; they win over ``priors``.
    parameter_priors: Mapping[str, float] = field(default_factory=_none)
    payload: Payload | None = None  #: What the tip carries; None: nothing.
    #: shape (3,), acceleration of gravity in the URDF's root frame [m/s^2].
    gravity: Array = field(default_factory=lambda: read_only(GRAVITY))
    #: Known distances between the fixed points of groups.
    distances: tuple[GroupDistance, ...] = ()
    #: How rows of one pose count: ``"weighted"``: as the noise between them and the one they share say; ``"average"``:
    #: as one row; ``"independent"``: each for itself.
    repeats: str = "weighted"
    #: Values of joints that have no column in the table [rad] or [m].
    held: Mapping[str, float] = field(default_factory=_none)
    #: What the robot must not touch, and the beam not cross, where poses are planned.
    boxes: tuple[Box, ...] = ()
    #: Where the instrument stands, how far it sees and how well it measures; None: not known.
    tracker: Tracker | None = None
    #: Where the reflector faces; None: it is turned by hand, and seen from everywhere.
    reflector: Reflector | None = None
    #: The least and the largest value of joints by name, within which poses are planned [rad] or [m].
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=_none)

    def __post_init__(self) -> None:
        """Check each value, and what belongs together; keep read-only copies."""
        for name, must in _FIELDS.items():
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, kept(value, f"A cell's {name}", *must))
        for name in ("target", "gravity"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, vector(getattr(self, name), name))
        for name, must in _NAMED.items():
            given = getattr(self, name).items()
            found = {k: kept(v, f"'{k}' in a cell's {name}", *must) for k, v in given}
            object.__setattr__(self, name, MappingProxyType(found))
        if self.kind is not None:
            registry.get(self.kind)
        _check_boxes(self.boxes)
        if self.target is None and not self.targets and not self.estimate_target:
            raise CalibError(
                "The target is said to be known but is not given; give it (--target, target_mm) or let it be estimated."
            )
        for name, (other, _) in self.ties.items():
            if other in self.ties or name in {*self.frozen, *self.bounds, *self.parameter_priors}:
                raise CalibError(
                    f"'{name}' is tied to '{other}': it must not be frozen, have bounds or a prior as well, nor "
                    f"'{other}' be tied itself."
                )

    def __reduce__(self) -> tuple[Any, ...]:
        """To another process and back: read-only mappings travel as dicts, and are checked again there."""
        values = [getattr(self, f.name) for f in fields(self)]
        return Cell, tuple(dict(v) if isinstance(v, MappingProxyType) else v for v in values)

    @classmethod
    def read(cls, path: str | Path) -> Cell:
        """Read a cell from a TOML file.

        Raises:
            FileError: The file cannot be read.
            CalibError: It is not TOML, has an unknown key, or a value of the wrong kind.
        """
        try:
            values = read_cell_file(path)
            values["priors"] = Priors(**values["priors"])
            if "tracker" in values:
                tracker, usual = values["tracker"], TrackerNoise()
                noise = tracker.pop("noise", (usual.constant, usual.per_length))
                repeated = tracker.pop("repeatability", usual.repeatability)
                values["tracker"] = Tracker(
                    **tracker, noise=TrackerNoise(noise[0], noise[1], repeated)
                )
            boxes = (
                Box(one["name"], one["size"], pose(one["xyz"], one.get("rotation")))
                for one in values.get("boxes", ())
            )
            values["boxes"] = tuple(boxes)
            values["distances"] = tuple(GroupDistance(**d) for d in values.get("distances", ()))
            for name, one in (("payload", Payload), ("reflector", Reflector)):
                if name in values:
                    values[name] = one(**values[name])
            return cls(**values)
        except CalibError as error:
            raise (
                error if isinstance(error, FileError) else CalibError(f"{path}: {error}")
            ) from error

    def with_target(self, target: ArrayLike, *, estimate: bool = True) -> Cell:
        """The cell with this target [m], shape (3,)."""
        return replace(self, target=read_only(np.asarray(target)), estimate_target=estimate)
