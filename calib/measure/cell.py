"""Cell: what stands around the robot while it is measured, and what of it is known.

The measurement frames, the targets on the tip, the instrument's noise, how large errors are expected to be, what the
tip carries, and which parameters are estimated. All of it can stand in a TOML file, ``--cell cell.toml``; see
docs/cell.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

import calib.kinds as registry
from calib.errors import CalibError, choices
from calib.measure import cell_parts as parts
from calib.measure.cell_file import read_cell_file
from calib.measure.cell_parts import PRIOR_SIZES, GroupDistance, Priors
from calib.measure.checks import FARTHEST, SIGMAS
from calib.measure.surroundings import Box, Reflector, Tracker, checked_boxes, checked_ranges
from calib.model.robot import read_only
from calib.model.torques import Payload

__all__ = ["DIRECTIONS", "PRIOR_SIZES", "REPEATS", "Cell", "GroupDistance", "Priors"]

#: The directions in which a measurement frame can be unknown, `Cell.frame_directions`.
DIRECTIONS = ("x", "y", "z", "rx", "ry", "rz")

#: The model that lets the data choose.
AUTO = "auto"

#: What `Cell.repeats` may be.
REPEATS = ("weighted", "average", "independent")

_PRIORS = Priors()

#: Standard gravity, downwards along z of the URDF's root [m/s^2].
_GRAVITY = read_only((0.0, 0.0, -9.81))


def _none() -> Mapping[str, Any]:
    """A mapping without entries that cannot be written to."""
    return MappingProxyType({})


@dataclass(frozen=True, slots=True, eq=False)
class Cell:
    """The set-up of a calibration.

    Parameters are named as `calib inspect` prints them. A change is what is added to a parameter's nominal value, in
    its unit: [m], [rad], [rad/Nm], [m/N], or [rad/rad] for a gain.

    Attributes:
        target: shape (3,), position of the target in the tip [m]; None where it is not known.
        estimate_target: Whether the targets are estimated with the robot (their start is found from the data).
        T_frame_base: shape (4, 4), pose of the base in the measurement frame [m]; None where it is not given: then it
            is estimated, or, if it is said to be known, the measurements are in the base frame itself.
        estimate_frame: Whether the measurement frames are estimated.
        sigma: Standard deviation of one measured coordinate or length [m]; None: found from the data.
        priors: How large the robot's errors are expected to be.
        model: What is estimated of the robot: ``"auto"``, as much as the measurements support, or a parameter set such
            as ``"dh"``, and families of errors behind it, ``"dh+gain+compliance"``.
        frozen: Names of parameters that stay at their nominal values.
        base: Base link; None: left to the command line or the URDF.
        tip: Tip link, likewise.
        targets: Positions, shape (3,) each, of targets by name [m]; they win over ``target``.
        target_rotation: shape (3, 3), R_tip_target, orientation of the targets in the tip; None where it is not known.
        frames: Poses T_frame_base, shape (4, 4) each, by group [m]; they win over ``T_frame_base``.
        frame_directions: Which of `DIRECTIONS`, the axes of the base, are estimated where frames are.
        sigma_angle: Standard deviation of one measured angle [rad]; None: found from the data.
        kind: Kind of all measurements; None: as the table says.
        ties: Parameters that follow others, ``x_name = factor * x_other``: for each name the other's and the factor.
        bounds: The least and the largest change of parameters by name; they contain 0.
        parameter_priors: Standard deviations of the changes of single parameters; they win over ``priors``.
        payload: What the tip carries; None: nothing.
        gravity: shape (3,), acceleration of gravity in the URDF's root frame [m/s^2].
        distances: Known distances between the fixed points of groups.
        repeats: How rows of one pose count: ``"weighted"``: as the noise between them and the one they share say;
            ``"average"``: as one row; ``"independent"``: each for itself.
        held: Values of joints that have no column in the table [rad] or [m].
        boxes: What the robot must not touch, and the beam not cross, where poses are planned.
        tracker: Where the instrument stands, how far it sees and how well it measures; None: not known.
        reflector: Where the reflector faces; None: it is turned by hand, and seen from everywhere.
        ranges: The least and the largest value of joints by name, within which poses are planned [rad] or [m].
    """

    target: NDArray[np.float64] | None = None
    estimate_target: bool = True
    T_frame_base: NDArray[np.float64] | None = None
    estimate_frame: bool = False
    sigma: float | None = None
    priors: Priors = _PRIORS
    model: str = AUTO
    frozen: tuple[str, ...] = ()
    base: str | None = None
    tip: str | None = None
    targets: Mapping[str, NDArray[np.float64]] = field(default_factory=_none)
    target_rotation: NDArray[np.float64] | None = None
    frames: Mapping[str, NDArray[np.float64]] = field(default_factory=_none)
    frame_directions: tuple[str, ...] = DIRECTIONS
    sigma_angle: float | None = None
    kind: str | None = None
    ties: Mapping[str, tuple[str, float]] = field(default_factory=_none)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=_none)
    parameter_priors: Mapping[str, float] = field(default_factory=_none)
    payload: Payload | None = None
    gravity: NDArray[np.float64] = field(default_factory=lambda: _GRAVITY)
    distances: tuple[GroupDistance, ...] = ()
    repeats: str = "weighted"
    held: Mapping[str, float] = field(default_factory=_none)
    boxes: tuple[Box, ...] = ()
    tracker: Tracker | None = None
    reflector: Reflector | None = None
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=_none)

    def __post_init__(self) -> None:
        """Check kinds, shapes and numbers; keep read-only copies."""
        for name, kind in (
            ("estimate_target", bool),
            ("estimate_frame", bool),
            ("priors", Priors),
            ("model", str),
            ("payload", (Payload, type(None))),
            ("kind", (str, type(None))),
            ("base", (str, type(None))),
            ("tip", (str, type(None))),
            ("tracker", (Tracker, type(None))),
            ("reflector", (Reflector, type(None))),
        ):
            if not isinstance(getattr(self, name), kind):
                wanted = kind[0] if isinstance(kind, tuple) else kind
                message = f"A cell's {name} must be of type {wanted.__name__}; {getattr(self, name)!r} was given."
                raise CalibError(message)
        for name, value in (
            *_places(self).items(),
            *_numbers(self).items(),
            *_parameters(self).items(),
        ):
            object.__setattr__(self, name, value)

    def __reduce__(self) -> tuple[Any, ...]:
        """To another process and back: read-only mappings travel as dicts, and are checked again there."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        plain = {k: dict(v) if isinstance(v, MappingProxyType) else v for k, v in values.items()}
        return _cell, (plain,)

    @classmethod
    def read(cls, path: str | Path) -> Cell:
        """Read a cell from a TOML file.

        Raises:
            FileError: The file cannot be read.
            CalibError: It is not TOML, has an unknown key, or a value of the wrong kind.
        """
        values = read_cell_file(path)
        try:
            return cls(**values)
        except CalibError as error:
            message = f"{path}: {error}"
            raise CalibError(message) from error

    def with_target(self, target: ArrayLike, *, estimate: bool = True) -> Cell:
        """The cell with this target [m], shape (3,)."""
        return replace(self, target=read_only(np.asarray(target)), estimate_target=estimate)


def _cell(values: dict[str, Any]) -> Cell:
    """A cell from its values by name, see `Cell.__reduce__`."""
    return Cell(**values)


def _places(cell: Cell) -> dict[str, Any]:
    """Targets and frames, checked."""
    target, frame, turned = cell.target, cell.T_frame_base, cell.target_rotation
    targets, frames = parts.by_name(cell.targets, "targets"), parts.by_name(cell.frames, "frames")
    if target is None and not targets and not cell.estimate_target:
        message = (
            'The target is said to be known but is not given. Give it (--target "x y z mm", or target_mm in the '
            "cell file) or let it be estimated."
        )
        raise CalibError(message)
    directions = parts.words(cell.frame_directions, "frame's directions")
    wrong = [d for d in directions if d not in DIRECTIONS or directions.count(d) > 1]
    if wrong or not directions:
        given = f"{choices(dict.fromkeys(wrong))} was given" if wrong else "none was given"
        message = f"The frame's directions are some of {choices(DIRECTIONS)}, each once; {given}."
        raise CalibError(message)
    return {
        "target": None if target is None else parts.vector(target, "target"),
        "T_frame_base": None if frame is None else parts.pose(frame, "T_frame_base"),
        "target_rotation": (
            None if turned is None else parts.rotation(turned, "target's orientation")
        ),
        "targets": MappingProxyType(
            {k: parts.vector(v, f"target '{k}'") for k, v in targets.items()}
        ),
        "frames": MappingProxyType(
            {k: parts.pose(v, f"The frame of '{k}'") for k, v in frames.items()}
        ),
        "frame_directions": tuple(d for d in DIRECTIONS if d in directions),
    }


def _as_float(value: float) -> float:
    """A float; one that knows its unit keeps it."""
    return value if isinstance(value, float) else float(value)


def _numbers(cell: Cell) -> dict[str, Any]:
    """Noise, kind, gravity, distances, repeats, held joints, boxes and ranges, checked."""
    for name, what, unit in (("sigma", "sigma", "m"), ("sigma_angle", "sigma of angles", "rad")):
        value = getattr(cell, name)
        if value is not None and not parts.is_positive(value):
            message = f"The noise {what} is {value} {unit}; it must be a positive number."
            raise CalibError(message)
        if value is not None and not SIGMAS[0] <= value <= SIGMAS[1]:
            message = (
                f"The noise {what} is {value:g} {unit}; no instrument has one below {SIGMAS[0]:g} or above "
                f"{SIGMAS[1]:g} {unit}. Leave it out: it is found from the data."
            )
            raise CalibError(message)
    if cell.kind is not None:
        registry.get(cell.kind)
    if cell.repeats not in REPEATS:
        message = f"Repeats were asked for as {cell.repeats!r}; choose one of {choices(REPEATS)}."
        raise CalibError(message)
    distances = cell.distances
    if not isinstance(distances, (tuple, list)) or not all(
        isinstance(d, GroupDistance) for d in distances
    ):
        message = f"The distances are a tuple of GroupDistance; {distances!r} was given."
        raise CalibError(message)
    held = parts.by_name(cell.held, "held joints")
    for name, value in held.items():
        if not parts.is_number(value):
            message = (
                f"The joint '{name}' is held at {value!r}; it must be a finite number, in rad or m."
            )
            raise CalibError(message)
        if abs(value) > FARTHEST:
            message = f"The joint '{name}' is held at {value:g} rad or m; no robot gets beyond {FARTHEST:g}."
            raise CalibError(message)
    return {
        "gravity": parts.vector(cell.gravity, "gravity", "m/s^2"),
        "distances": tuple(distances),
        "held": MappingProxyType({name: _as_float(value) for name, value in held.items()}),
        "boxes": checked_boxes(cell.boxes),
        "ranges": checked_ranges(cell.ranges),
    }


def _parameters(cell: Cell) -> dict[str, Any]:
    """What is said of single parameters, checked."""
    frozen = parts.words(cell.frozen, "frozen parameters")
    ties, bounds = parts.ties(cell.ties, frozen), parts.bounds(cell.bounds)
    priors = parts.by_name(cell.parameter_priors, "priors of single parameters")
    for name, value in priors.items():
        if not parts.is_positive(value):
            message = f"The prior of '{name}' is {value!r}; it must be a positive number. Freeze it to keep it."
            raise CalibError(message)
        parts.check_prior(value, f"The prior of '{name}'")
    for name in ties:
        for what, given in (("bounds", bounds), ("a prior", priors)):
            if name in given:
                message = f"'{name}' has {what} and is tied to '{ties[name][0]}'; give {what} to that one."
                raise CalibError(message)
    return {
        "frozen": frozen,
        "ties": ties,
        "bounds": bounds,
        "parameter_priors": MappingProxyType({k: float(v) for k, v in priors.items()}),
    }
