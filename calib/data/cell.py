"""Cell: what stands around the robot while it is measured, and what of it is known.

The measurement frames, the targets on the tip, the instrument and its noise, obstacles, prior standard deviations of
the robot's errors, the payload, and which parameters are estimated. All of it can stand in a TOML file,
``--cell cell.toml``; see docs/cell.md.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

import calib.data.kinds as registry
from calib.basics.arguments import check_mapping, check_path, check_type
from calib.basics.arrays import Array, read_only
from calib.basics.channels import RESIDUAL_UNITS
from calib.basics.units import is_number
from calib.basics.values import ReadOnlyMapping, Value, one_line
from calib.boards.board import Board
from calib.camera.camera import Camera
from calib.data.cell_file import checked, read_cell_file
from calib.data.kinds import SIGMAS
from calib.data.priors import PRIOR_STD_RANGE, Priors
from calib.data.record import Record
from calib.data.surroundings import (
    POSE,
    Box,
    Reflector,
    Tracker,
    TrackerNoise,
    check_box_names,
)
from calib.errors import CalibError, FileError, choices
from calib.model.error_model import DIRECTIONS
from calib.numerics.geometry import (
    FARTHEST,
    pose_of,
    pose_or_none,
    position_in_tip,
    rotation_or_none,
    vector,
)
from calib.robot.gravity import GRAVITY, Payload

__all__ = [
    "AUTO",
    "Box",
    "Cell",
    "GroupDistance",
    "Priors",
    "Record",
    "Reflector",
    "Tracker",
    "TrackerNoise",
]

#: The value of `Cell.model` that lets the data choose the model.
AUTO = "auto"

#: What `Cell.repeats` may be.
REPEATS = ("weighted", "average", "independent")


@dataclass(frozen=True, slots=True)
class GroupDistance:
    """A known distance between the fixed points of two groups, such as two sockets on one plate.

    Example:
        >>> plate = GroupDistance("*/left", "*/right", length=0.2, sigma=1e-5)
        >>> plate.pairs(["1/left", "1/right", "2/left", "2/right"])
        (('1/left', '1/right'), ('2/left', '2/right'))
    """

    #: Name of a group. It may hold one ``*``, which then stands for any text.
    first: str
    #: Name of another one; its ``*`` stands for the same text.
    second: str
    #: Known distance [m].
    length: float
    #: Standard deviation of the length [m].
    sigma: float

    def __post_init__(self) -> None:
        """Check the names, the length and its standard deviation."""
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


# Checks of a cell's values


@dataclass(frozen=True, slots=True)
class _Check:
    """A check of a value of a cell."""

    #: For the message: ``"three numbers [m]"``.
    must: str
    #: Gives the value that is kept; refuses by None, a TypeError or a ValueError.
    convert: Callable[[Any], Any]

    def __call__(self, value: Any, what: str) -> Any:  # noqa: ANN401
        """Return the value that is kept; `CalibError` where it is refused, see `checked`."""
        return checked(value, what, self.must, self.convert)


def _within(low: float, high: float, unit: str) -> _Check:
    """Return the check of a number from ``low`` to ``high``; it stays an `Angle` or a `Length`."""

    def convert(value: Any) -> float | None:  # noqa: ANN401
        return value if is_number(value) and low <= value <= high else None

    return _Check(f"a number from {low:g} to {high:g} {unit}", convert)


def _directions(value: Iterable[str]) -> tuple[str, ...] | None:
    """Return given directions of a frame in the order of `DIRECTIONS`; None if others are given."""
    directions = tuple(d for d in DIRECTIONS if d in value)
    if not directions or sorted(directions) != sorted(value):
        return None
    return directions


def _tie(value: tuple[str, float]) -> tuple[str, float] | None:
    """Return another parameter's name and a factor; None if the factor is no number or zero."""
    name, factor = value
    if not is_number(factor) or factor == 0.0:
        return None
    return name, float(factor)


def _interval(value: tuple[float, float]) -> tuple[float, float] | None:
    """Return two increasing numbers, else None; they stay `Angle` or `Length`."""
    low, high = value
    return (low, high) if low < high else None


def _bounds(value: tuple[float, float]) -> tuple[float, float] | None:
    """Return the least and the largest change of a parameter; None unless 0 is between them."""
    low, high = value
    return _interval(value) if low <= 0.0 <= high else None


def _factors(value: Mapping[str, float]) -> ReadOnlyMapping[str, float] | None:
    """Return the factors of joints' readings by name, else None."""
    if not isinstance(value, Mapping) or not all(isinstance(name, str) for name in value):
        return None
    if not value or not all(is_number(factor) and factor for factor in value.values()):
        return None
    return ReadOnlyMapping({name: float(factor) for name, factor in value.items()})


def _repeats(value: str) -> str | None:
    """Return one of `REPEATS`, else None."""
    return value if value in REPEATS else None


def _sigma(value: Mapping[str, float]) -> ReadOnlyMapping[str, float] | None:
    """Return standard deviations by unit, else None."""
    if not isinstance(value, Mapping) or not value.keys() <= RESIDUAL_UNITS.keys():
        return None
    if not all(is_number(std) and SIGMAS[0] <= std <= SIGMAS[1] for std in value.values()):
        return None
    return ReadOnlyMapping({unit: float(std) for unit, std in value.items()})


def _target(value: ArrayLike) -> Array:
    """Return a target's position in the tip, shape (3,) [m]."""
    return position_in_tip(value, "target")


_POSE_CHECK = _Check(POSE, pose_or_none)

#: Checks of attributes of a cell, by their names; None is always allowed.
_ATTRIBUTES: Mapping[str, _Check] = {
    "T_frame_base": _POSE_CHECK,
    "sigma": _Check(
        f"standard deviations from {SIGMAS[0]:g} to {SIGMAS[1]:g} by unit, such as {{'m': 1e-05}}; units are "
        f"{choices(RESIDUAL_UNITS)}",
        _sigma,
    ),
    "target_rotation": _Check("a 3 x 3 right-handed rotation", rotation_or_none),
    "frame_directions": _Check(f"some of {choices(DIRECTIONS)}, each once", _directions),
    "frozen": _Check("names", tuple),
    "repeats": _Check(f"one of {choices(REPEATS)}", _repeats),
}

#: Checks of each value of the attributes that map names to values.
_MAPPINGS: Mapping[str, _Check] = {
    "targets": _Check("three numbers [m]", _target),
    "frames": _POSE_CHECK,
    "ties": _Check("another parameter and a factor that is not zero, such as ('a2', 1.0)", _tie),
    "bounds": _Check(
        "the least and the largest change, with 0 between them, (-0.001, 0.001)", _bounds
    ),
    "parameter_priors": _within(*PRIOR_STD_RANGE, "of the parameter's unit"),
    "held": _within(-FARTHEST, FARTHEST, "rad or m"),
    "coupling": _Check(
        "factors of other joints' readings by name, none of them zero, such as {'joint_2': 1.0}",
        _factors,
    ),
    "ranges": _Check("the least and the largest value [rad or m]", _interval),
}


#: Other attributes of a cell, their types, and what messages call these.
_TYPES = (
    ("estimate_target", (bool, np.bool_), "True or False"),
    ("estimate_frame", (bool, np.bool_), "True or False"),
    ("scale_certified", (bool, np.bool_), "True or False"),
    ("model", str, "the name of a model"),
    ("base", str, "the name of a link, or None"),
    ("tip", str, "the name of a link, or None"),
    ("kind", str, "the name of a kind of measurement, or None"),
    ("priors", Priors, "Priors"),
    ("record", Record, "a Record"),
    ("payload", Payload, "a Payload, or None"),
    ("tracker", Tracker, "a Tracker, or None"),
    ("reflector", Reflector, "a Reflector, or None"),
)

#: Those of them that may be None.
_OPTIONAL = ("base", "tip", "kind", "payload", "tracker", "reflector")

#: Attributes with several objects, their type, and what messages call these.
_SEQUENCES = (
    ("boxes", Box, "a sequence of Boxes"),
    ("distances", GroupDistance, "a sequence of GroupDistances"),
    ("frozen", str, "a sequence of names, which are texts"),
)


def _no_entries() -> Mapping[str, Any]:
    """Return a read-only mapping without entries."""
    return ReadOnlyMapping()


@dataclass(frozen=True, slots=True, eq=False)
class Cell(Value):
    """The measurement setup of a calibration: frames, targets, instrument, priors and surroundings.

    Parameters are named as `calib inspect` prints them. A change is what is added to a parameter's nominal value, in
    its unit: [m], [rad], [rad/Nm], [m/N], or [rad/rad] for a gain.

    Raises:
        CalibError: A value is of the wrong kind or out of range, or two of them contradict.
        MeasurementError: ``kind`` is not registered.
    """

    #: shape (3,), position of the target in the tip [m]; None: not known.
    target: Array | None = None
    #: Whether the targets are estimated with the robot. A fit registers them first; ``target`` is then one of several
    #: starts where that is not linear, the nominal robot is judged with it, and the estimate is checked against it.
    estimate_target: bool = True
    #: shape (4, 4), pose of the base in the measurement frame [m]. None: not given; then it is
    #: estimated if ``estimate_frame``, else the measurements are in the base frame itself.
    T_frame_base: Array | None = None
    #: Whether the measurement frames are estimated.
    estimate_frame: bool = False
    #: Standard deviation of one measured scalar by its unit: ``"m"`` of a coordinate or length [m], ``"rad"`` of an
    #: angle [rad], ``"px"`` of an image coordinate [px]; of a unit that is missing it is estimated from the data.
    sigma: Mapping[str, float] = field(default_factory=_no_entries)
    #: Prior standard deviations of the robot's errors, by family.
    priors: Priors = field(default_factory=Priors)
    #: What is estimated of the robot: ``"auto"``, as much as the measurements support, or a parameter set such as
    #: ``"dh"``, with families of errors appended, ``"dh+gain+compliance"``.
    model: str = AUTO
    #: Names of parameters that stay at their nominal values.
    frozen: tuple[str, ...] = ()
    #: Base link; None: left to the command line or the URDF.
    base: str | None = None
    #: Tip link; None: left to the command line or the URDF.
    tip: str | None = None
    #: Positions of targets in the tip by name, shape (3,) each [m]; they override ``target``.
    targets: Mapping[str, Array] = field(default_factory=_no_entries)
    #: shape (3, 3), R_tip_target, orientation of the targets in the tip; None: not known.
    target_rotation: Array | None = None
    #: Poses T_frame_base by group, shape (4, 4) each [m]; they override ``T_frame_base``.
    frames: Mapping[str, Array] = field(default_factory=_no_entries)
    #: Which of `DIRECTIONS`, along the axes of the base, are estimated where frames are.
    frame_directions: tuple[str, ...] = DIRECTIONS
    #: Whether the instrument's scale was certified or checked against a known length; else lengths of the arm may
    #: hide an error of it.
    scale_certified: bool = False
    #: Kind of all measurements, by its name; None: as the table's columns say.
    kind: str | None = None
    #: Parameters that follow others, ``x_name = factor * x_other``: (other, factor) by name.
    ties: Mapping[str, tuple[str, float]] = field(default_factory=_no_entries)
    #: The least and the largest change of parameters by name; 0 is between them.
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=_no_entries)
    #: Prior standard deviations of the changes of single parameters, by name; they override ``priors``.
    parameter_priors: Mapping[str, float] = field(default_factory=_no_entries)
    #: What the tip carries; None: nothing.
    payload: Payload | None = None
    #: shape (3,), acceleration of gravity in the URDF's root frame [m/s^2].
    gravity: Array = field(default_factory=lambda: read_only(GRAVITY))
    #: Known distances between the fixed points of groups.
    distances: tuple[GroupDistance, ...] = ()
    #: Weighting of repeated poses: ``"weighted"``: by the estimated correlation of rows of one pose; ``"average"``: as
    #: one row; ``"independent"``: as rows of different poses.
    repeats: str = "weighted"
    #: Values of joints that have no column in the table, by name [rad] or [m].
    held: Mapping[str, float] = field(default_factory=_no_entries)
    #: Of joints whose readings are coupled, by name, the factors of other joints' readings: the joint's value is its
    #: reading plus the sum of factor times reading; [rad/rad], [m/m], or [m/rad] and [rad/m] between turn and slide.
    coupling: Mapping[str, Mapping[str, float]] = field(default_factory=_no_entries)
    #: Obstacles to the robot and to the tracker's beam, where poses are planned.
    boxes: tuple[Box, ...] = ()
    #: Position, range and noise of the instrument; None: not known.
    tracker: Tracker | None = None
    #: Direction and opening of the reflector; None: it is turned by hand, and seen from everywhere.
    reflector: Reflector | None = None
    #: The least and the largest value of the URDF's joints by name, within which poses are planned [rad] or [m].
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=_no_entries)
    #: Cameras by the name of their station; ``""`` is that of a table without stations.
    cameras: Mapping[str, Camera] = field(default_factory=_no_entries)
    #: Printed boards by the name of their target; ``""`` is that of a table without targets.
    boards: Mapping[str, Board] = field(default_factory=_no_entries)
    #: Who measured what for whom, where, when and with what; for reports.
    record: Record = field(default_factory=Record)

    def __post_init__(self) -> None:
        """Check each value, and that they agree; keep read-only copies."""
        self._check_types()
        for name, check in _ATTRIBUTES.items():
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, check(value, f"A cell's {name}"))
        if self.target is not None:
            object.__setattr__(self, "target", _target(self.target))
        object.__setattr__(self, "gravity", vector(self.gravity, "gravity"))
        for name, check in _MAPPINGS.items():
            given = getattr(self, name)
            values = {key: check(v, f"'{key}' in a cell's {name}") for key, v in given.items()}
            object.__setattr__(self, name, ReadOnlyMapping(values))
        if self.kind is not None:
            registry.get(self.kind)
        check_box_names(self.boxes)
        self._check_optics()
        self._check_target()
        self._check_ties()

    def __repr__(self) -> str:
        """Return one line: the model, and the names of the other attributes that are not the default ones."""
        given = []
        for attribute in fields(self):
            value = getattr(self, attribute.name)
            default: Any = attribute.default
            if attribute.default_factory is not MISSING:
                default = attribute.default_factory()
            if attribute.name != "model" and not np.array_equal(value, default):
                given.append(attribute.name)
        return one_line(
            "Cell", f"model '{self.model}'", f"given: {', '.join(given)}" if given else ""
        )

    def _check_types(self) -> None:
        """Refuse values of another type."""
        for name, types, allowed in _TYPES:
            given = getattr(self, name)
            if given is not None or name not in _OPTIONAL:
                check_type(name, given, types, allowed)
        for name in _MAPPINGS:
            check_mapping(name, getattr(self, name))
        for name, kind, allowed in _SEQUENCES:
            check_type(name, getattr(self, name), Sequence, allowed)
            for entry in getattr(self, name):
                check_type(name, entry, kind, allowed)

    def _check_optics(self) -> None:
        """Refuse cameras and boards of another type; keep read-only copies."""
        for name, kind, allowed in (("cameras", Camera, "a Camera"), ("boards", Board, "a Board")):
            given = getattr(self, name)
            check_mapping(name, given)
            for entry in given.values():
                check_type(name, entry, kind, f"a mapping from names to {allowed} each")
            object.__setattr__(self, name, ReadOnlyMapping(given))

    def _check_target(self) -> None:
        """Refuse a target that is known and not given."""
        is_given = self.target is not None or self.targets
        if not is_given and not self.estimate_target:
            raise CalibError(
                "The target is marked as known, but its position is not given; give it (--target, "
                "target_mm) or let it be estimated."
            )

    def _check_ties(self) -> None:
        """Refuse chains of ties, and tied parameters that are frozen, bounded or have a prior."""
        constrained = {*self.frozen, *self.bounds, *self.parameter_priors}
        for name, (other, _) in self.ties.items():
            if other in self.ties or name in constrained:
                raise CalibError(
                    f"'{name}' is tied to '{other}': it must not be frozen, have bounds or a "
                    f"prior as well, nor '{other}' be tied itself."
                )

    @classmethod
    def read(cls, path: str | Path) -> Cell:
        """Read a cell from a TOML file, see docs/cell.md.

        Args:
            path: The file.

        Returns:
            The cell; what the file does not give has its default.

        Raises:
            FileError: The file cannot be read or is not TOML.
            CalibError: It has an unknown key, or a value of the wrong kind.
        """
        check_path("path", path)
        try:
            values = read_cell_file(path)
            return cls(**_with_classes(values))
        except FileError:
            raise
        except CalibError as error:
            raise CalibError(f"{path}: {error}") from error

    def with_target(self, target: ArrayLike, *, estimate: bool = True) -> Cell:
        """Return the cell with another target.

        Args:
            target: Position of the target in the tip, shape (3,) [m].
            estimate: Whether the target is estimated, starting there; False: it is known.

        Returns:
            The cell.
        """
        return replace(self, target=read_only(np.asarray(target)), estimate_target=estimate)


def _with_classes(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of a cell file with objects in place of the dicts of their arguments."""
    result = dict(values)
    result["priors"] = Priors(**values["priors"])
    if "tracker" in values:
        result["tracker"] = _tracker(values["tracker"])
    result["boxes"] = tuple(map(_box, values.get("boxes", ())))
    result["distances"] = tuple(GroupDistance(**d) for d in values.get("distances", ()))
    result["record"] = Record(**values.get("record", {}))
    if "payload" in values:
        result["payload"] = Payload(**values["payload"])
    if "reflector" in values:
        result["reflector"] = Reflector(**values["reflector"])
    return result


def _tracker(values: Mapping[str, Any]) -> Tracker:
    """Return a tracker from the values of ``[tracker]``; parts of the noise have their defaults."""
    default = TrackerNoise()
    arguments = dict(values)
    noise = arguments.pop("noise", (default.constant, default.per_length))
    repeatability = arguments.pop("repeatability", default.repeatability)
    return Tracker(**arguments, noise=TrackerNoise(noise[0], noise[1], repeatability))


def _box(values: Mapping[str, Any]) -> Box:
    """Return a box from the values of one ``[[boxes]]``."""
    T_base_box = pose_of(values["xyz"], values.get("rotation"))
    return Box(values["name"], values["size"], T_base_box)
