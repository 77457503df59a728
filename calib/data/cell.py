"""Cell: what stands around the robot while it is measured, and what of it is known.

The measurement frames, the targets on the tip, the instrument's noise, how large errors are expected to be, what the
tip carries, and which parameters are estimated. All of it can stand in a TOML file, ``--cell cell.toml``; see
docs/cell.md.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

import calib.data.kinds as registry
from calib.data.cell_file import read_cell_file
from calib.data.kinds import DIRECTIONS, FARTHEST, SIGMAS
from calib.data.surroundings import (
    POSE,
    VECTOR,
    Array,
    Box,
    Reflector,
    Tracker,
    as_pose,
    as_rotation,
    as_vector,
    checked_boxes,
    kept,
)
from calib.errors import CalibError, choices
from calib.model.families import family_of
from calib.robot.robot import Payload, read_only
from calib.units import is_number

#: The model that lets the data choose.
AUTO = "auto"

#: What `Cell.repeats` may be.
REPEATS = ("weighted", "average", "independent")

#: What `Priors.sizes` may be.
PRIOR_SIZES = ("data", "given", "off")

#: A prior outside of these says nothing, or is a constraint; their squares would leave the range of numbers.
PRIORS = (1e-15, 1e6)


@dataclass(frozen=True, slots=True, init=False)
class Priors:
    """How large a robot's errors are expected to be: zero-mean normal distributions, a size for each family.

    Attributes:
        sizes: ``"data"``: the sizes are found from the measurements, starting at those given; ``"given"``: they are
            those given; ``"off"``: none, plain least squares, but for a leash on what no measurement determines.
        given: Standard deviations by family that are other than its row of the registry has, in the family's unit.

    Example:
        >>> Priors("given", length=1e-3).of("length")
        0.001
    """

    sizes: str
    given: tuple[tuple[str, float], ...]

    def __init__(self, sizes: str = "data", **given: float) -> None:
        """Sizes by name: ``Priors("given", length=1e-3, compliance=2e-6)``.

        Raises:
            CalibError: An unknown word or family, or a size that is no standard deviation.
        """
        if sizes not in PRIOR_SIZES:
            raise CalibError(
                f"Priors of the kind '{sizes}' were asked for; choose one of {choices(PRIOR_SIZES)}."
            )
        for name, value in given.items():
            if not PRIORS[0] <= value <= PRIORS[1]:
                raise CalibError(
                    f"The prior's {name} is {value:g} {family_of(name).unit.symbol}; it lies between {PRIORS[0]:g} "
                    f"and {PRIORS[1]:g}. Use sizes 'off' for none."
                )
        object.__setattr__(self, "sizes", sizes)
        others = {name: value for name, value in given.items() if value != family_of(name).prior}
        object.__setattr__(self, "given", tuple(sorted(others.items())))

    def with_sizes(self, sizes: str) -> Priors:
        """The same standard deviations, used otherwise: ``"data"``, ``"given"`` or ``"off"``."""
        return Priors(sizes, **dict(self.given))

    def of(self, family: str) -> float:
        """The standard deviation of a family's errors, in its unit: as given, or that of its row of the registry."""
        return dict(self.given).get(family, family_of(family).prior)


@dataclass(frozen=True, slots=True)
class GroupDistance:
    """A known distance between the fixed points of two groups, such as two sockets on one plate.

    Attributes:
        first: Name of a group. It may hold one ``*``, which then stands for any text.
        second: Name of another one; its ``*`` stands for the same text.
        length: [m].
        sigma: Standard deviation of the length [m].

    Example:
        >>> plate = GroupDistance("*/left", "*/right", length=0.2, sigma=1e-5)
        >>> plate.pairs(["1/left", "1/right", "2/left", "2/right"])
        (('1/left', '1/right'), ('2/left', '2/right'))
    """

    first: str
    second: str
    length: float
    sigma: float

    def __post_init__(self) -> None:
        """Refuse names that cannot be matched and lengths that are none."""
        said = f"The distance between the groups {self.first!r} and {self.second!r}"
        if (self.first.count("*"), self.second.count("*")) not in ((0, 0), (1, 1)):
            raise CalibError(
                f"{said}: '*' stands for the same text in both; write it once in each name, or in neither."
            )
        if self.first == self.second:
            raise CalibError(f"{said}: a group has one fixed point; name two different groups.")
        if not (self.length > 0.0 and self.sigma > 0.0):
            raise CalibError(
                f"{said} is {self.length!r} m, its sigma {self.sigma!r} m; both are greater than 0."
            )

    def pairs(self, groups: Iterable[str]) -> tuple[tuple[str, str], ...]:
        """The pairs of these groups that the distance is between, each once, in the groups' order."""
        present = tuple(dict.fromkeys(groups))
        if "*" not in self.first:
            both = self.first in present and self.second in present
            return ((self.first, self.second),) if both else ()
        before, _, after = self.first.partition("*")
        found = []
        for group in present:
            middle = group[len(before) : len(group) - len(after)]
            # Compared as a whole: the parts before and behind the star may not overlap.
            other = self.second.replace("*", middle)
            if group == f"{before}{middle}{after}" and other in present and other != group:
                found.append((group, other))
        return tuple(found)


def _between(low: float, high: float) -> Callable[[Any], float | None]:
    """A number in a range; one that knows its unit keeps it."""

    def convert(value: Any) -> float | None:  # noqa: ANN401
        """The number, or None."""
        if not is_number(value) or not low <= value <= high:
            return None
        return value if isinstance(value, float) else float(value)

    return convert


def _directions(value: Any) -> tuple[str, ...] | None:  # noqa: ANN401
    """Some of the directions of a frame, in their order."""
    good = value and set(value) <= set(DIRECTIONS) and len(set(value)) == len(value)
    return tuple(d for d in DIRECTIONS if d in value) if good else None


def _tie(value: Any) -> tuple[str, float] | None:  # noqa: ANN401
    """Another parameter and a factor."""
    name, factor = value
    return (name, float(factor)) if is_number(factor) and factor else None


def _bounds(value: Any) -> tuple[float, float] | None:  # noqa: ANN401
    """The least and the largest change; an infinite one is none."""
    low, high = (float(one) for one in value)
    return (low, high) if low <= 0.0 <= high and low != high else None


def _range(value: Any) -> tuple[float, float] | None:  # noqa: ANN401
    """The least and the largest value of a joint; numbers that know their unit keep it."""
    low, high = (one if isinstance(one, float) else float(one) for one in value)
    return (low, high) if is_number(low) and is_number(high) and low < high else None


_SIGMA = "a positive number, from {:g} to {:g} {}; without it, it is found from the data"

#: What an attribute of a cell must be, and what gives the value that is kept.
_FIELDS: Mapping[str, tuple[str, Callable[[Any], Any]]] = {
    "target": (f"{VECTOR} [m], none beyond {FARTHEST:g}", as_vector),
    "T_frame_base": (POSE, as_pose),
    "sigma": (_SIGMA.format(*SIGMAS, "m"), _between(*SIGMAS)),
    "sigma_angle": (_SIGMA.format(*SIGMAS, "rad"), _between(*SIGMAS)),
    "frozen": ("a tuple of names", tuple),
    "target_rotation": ("a 3 x 3 right-handed rotation", as_rotation),
    "frame_directions": (f"some of {choices(DIRECTIONS)}, each once", _directions),
    "gravity": (f"{VECTOR} [m/s^2]", as_vector),
    "kind": ("a kind of measurement", lambda value: registry.get(value).name),
    "repeats": (f"one of {choices(REPEATS)}", lambda v: v if v in REPEATS else None),
    "boxes": ("a tuple of Box", checked_boxes),
}

#: The same of each value of the attributes that are mappings from names.
_NAMED: Mapping[str, tuple[str, Callable[[Any], Any]]] = {
    "targets": _FIELDS["target"],
    "frames": _FIELDS["T_frame_base"],
    "ties": ("another parameter and a factor that is not zero, such as ('a2', 1.0)", _tie),
    "bounds": (
        "the least and the largest change from the nominal value, such as (-0.001, 0.001), with 0 between them. To "
        "keep a parameter at its nominal value, freeze it",
        _bounds,
    ),
    "parameter_priors": (
        f"a positive number, from {PRIORS[0]:g} to {PRIORS[1]:g}. Freeze a parameter to keep it",
        _between(*PRIORS),
    ),
    "held": (
        f"a number [rad] or [m], not beyond {FARTHEST:g}",
        _between(-FARTHEST, FARTHEST),
    ),
    "ranges": (
        "the least and the largest value [rad or m], the first less than the second. To keep a joint where it is, hold "
        "it (--hold)",
        _range,
    ),
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
    priors: Priors = field(
        default_factory=Priors
    )  #: How large the robot's errors are expected to be.
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
    kind: str | None = None  #: Kind of all measurements; None: as the table says.
    #: Parameters that follow others, ``x_name = factor * x_other``: for each name the other's and the factor.
    ties: Mapping[str, tuple[str, float]] = field(default_factory=_none)
    #: The least and the largest change of parameters by name; they contain 0.
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=_none)
    #: Standard deviations of the changes of single parameters; they win over ``priors``.
    parameter_priors: Mapping[str, float] = field(default_factory=_none)
    payload: Payload | None = None  #: What the tip carries; None: nothing.
    #: shape (3,), acceleration of gravity in the URDF's root frame [m/s^2].
    gravity: Array = field(default_factory=lambda: read_only((0.0, 0.0, -9.81)))
    distances: tuple[
        GroupDistance, ...
    ] = ()  #: Known distances between the fixed points of groups.
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
        for name, must in _NAMED.items():
            given = getattr(self, name).items()
            found = {k: kept(v, f"'{k}' in a cell's {name}", *must) for k, v in given}
            object.__setattr__(self, name, MappingProxyType(found))
        if self.target is None and not self.targets and not self.estimate_target:
            raise CalibError(
                'The target is said to be known but is not given. Give it (--target "x y z mm", or target_mm in the '
                "cell file) or let it be estimated."
            )
        for name, (other, _) in self.ties.items():
            if other == name or other in self.ties:
                raise CalibError(
                    f"'{name}' is tied to '{other}', which is tied itself; tie both to one that is not."
                )
            if name in self.frozen:
                raise CalibError(f"'{name}' is both frozen and tied to '{other}'; choose one.")
            for what, given in (("bounds", self.bounds), ("a prior", self.parameter_priors)):
                if name in given:
                    raise CalibError(
                        f"'{name}' has {what} and is tied to '{other}'; give {what} to that one."
                    )

    def __reduce__(self) -> tuple[Any, ...]:
        """To another process and back: read-only mappings travel as dicts, and are checked again there."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        plain: dict[str, Any] = {
            k: dict(v) if isinstance(v, MappingProxyType) else v for k, v in values.items()
        }
        return partial(Cell, **plain), ()

    @classmethod
    def read(cls, path: str | Path) -> Cell:
        """Read a cell from a TOML file.

        Raises:
            FileError: The file cannot be read.
            CalibError: It is not TOML, has an unknown key, or a value of the wrong kind.
        """
        values = read_cell_file(path)
        try:
            sizes, given = values.pop("priors")
            found = tuple(GroupDistance(**one) for one in values.pop("distances", ()))
            return cls(**values, priors=Priors(sizes, **given), distances=found)
        except CalibError as error:
            raise CalibError(f"{path}: {error}") from error

    def with_target(self, target: ArrayLike, *, estimate: bool = True) -> Cell:
        """The cell with this target [m], shape (3,)."""
        return replace(self, target=read_only(np.asarray(target)), estimate_target=estimate)
