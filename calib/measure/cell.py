"""Cell: what stands around the robot while it is measured, and what of it is known.

The measurement frames, the targets on the tip, the instrument's noise, how large errors are expected to be, what the
tip carries, and which parameters are estimated. All of it can stand in a TOML file, ``--cell cell.toml``; see
docs/cell.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
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
        """Check each value, and what belongs together; keep read-only copies."""
        for name, kind in _TYPES.items():
            value = getattr(self, name)
            if not isinstance(value, kind) and (value is not None or name not in _OPTIONAL):
                raise CalibError(
                    f"A cell's {name} must be of type {kind.__name__}; {value!r} was given."
                )
        for name, check in _CHECKS.items():
            value = getattr(self, name)
            if value is not None or name not in _OPTIONAL:
                object.__setattr__(self, name, check(value))
        if self.target is None and not self.targets and not self.estimate_target:
            raise CalibError(
                'The target is said to be known but is not given. Give it (--target "x y z mm", or target_mm in the '
                "cell file) or let it be estimated."
            )
        for name, (other, _) in self.ties.items():
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
            raise CalibError(f"{path}: {error}") from error

    def with_target(self, target: ArrayLike, *, estimate: bool = True) -> Cell:
        """The cell with this target [m], shape (3,)."""
        return replace(self, target=read_only(np.asarray(target)), estimate_target=estimate)


def _cell(values: dict[str, Any]) -> Cell:
    """A cell from its values by name, see `Cell.__reduce__`."""
    return Cell(**values)


def _sigma(value: Any, what: str, unit: str) -> float:  # noqa: ANN401
    """A standard deviation that some instrument has."""
    if not parts.is_positive(value) or not SIGMAS[0] <= value <= SIGMAS[1]:
        raise CalibError(
            f"The noise {what} is {value!r} {unit}; it must be a positive number, from {SIGMAS[0]:g} to {SIGMAS[1]:g} "
            f"{unit}. Leave it out: it is found from the data."
        )
    return float(value)


def _directions(value: Any) -> tuple[str, ...]:  # noqa: ANN401
    """Some of the directions of a frame, in their order."""
    given = parts.words(value, "frame's directions")
    wrong = [d for d in given if d not in DIRECTIONS or given.count(d) > 1]
    if wrong or not given:
        said = f"{choices(dict.fromkeys(wrong))} was given" if wrong else "none was given"
        raise CalibError(
            f"The frame's directions are some of {choices(DIRECTIONS)}, each once; {said}."
        )
    return tuple(d for d in DIRECTIONS if d in given)


def _repeats(value: Any) -> str:  # noqa: ANN401
    """One of `REPEATS`."""
    if value not in REPEATS:
        raise CalibError(f"Repeats were asked for as {value!r}; choose one of {choices(REPEATS)}.")
    return str(value)


def _distances(value: Any) -> tuple[GroupDistance, ...]:  # noqa: ANN401
    """Known distances."""
    if not isinstance(value, (tuple, list)) or not all(isinstance(d, GroupDistance) for d in value):
        raise CalibError(f"The distances are a tuple of GroupDistance; {value!r} was given.")
    return tuple(value)


def _held(value: Any, what: str) -> float:  # noqa: ANN401
    """The value of a joint; one that knows its unit keeps it."""
    if not parts.is_number(value) or abs(value) > FARTHEST:
        raise CalibError(
            f"{what} is {value!r}; it must be a number [rad] or [m], not beyond {FARTHEST:g}."
        )
    return value if isinstance(value, float) else float(value)


def _prior(value: Any, what: str) -> float:  # noqa: ANN401
    """The standard deviation of a parameter."""
    if not parts.is_positive(value):
        raise CalibError(
            f"{what} is {value!r}; it must be a positive number. Freeze it to keep it."
        )
    parts.check_prior(value, what)
    return float(value)


#: What may be left out.
_OPTIONAL = (
    *("target", "T_frame_base", "sigma", "target_rotation", "sigma_angle", "payload", "tracker"),
    *("reflector", "kind", "base", "tip"),
)

#: The types of the attributes that need no other check.
_TYPES: Mapping[str, type] = {
    **dict.fromkeys(("model", "kind", "base", "tip"), str),
    **dict.fromkeys(("estimate_target", "estimate_frame"), bool),
    "priors": Priors,
    "payload": Payload,
    "tracker": Tracker,
    "reflector": Reflector,
}

#: The check of each other attribute, which gives the value that is kept.
_CHECKS: Mapping[str, Callable[[Any], Any]] = {
    "target": lambda v: parts.vector(v, "target"),
    "T_frame_base": lambda v: parts.pose(v, "T_frame_base"),
    "sigma": lambda v: _sigma(v, "sigma", "m"),
    "frozen": lambda v: parts.words(v, "frozen parameters"),
    "targets": lambda v: parts.each(v, "targets", parts.vector, "target '{}'"),
    "target_rotation": lambda v: parts.rotation(v, "target's orientation"),
    "frames": lambda v: parts.each(v, "frames", parts.pose, "The frame of '{}'"),
    "frame_directions": _directions,
    "sigma_angle": lambda v: _sigma(v, "sigma of angles", "rad"),
    "kind": lambda v: registry.get(v).name,
    "ties": parts.ties,
    "bounds": parts.bounds,
    "parameter_priors": lambda v: parts.each(
        v, "priors of single parameters", _prior, "The prior of '{}'"
    ),
    "gravity": lambda v: parts.vector(v, "gravity", "m/s^2"),
    "distances": _distances,
    "repeats": _repeats,
    "held": lambda v: parts.each(v, "held joints", _held, "The value of the held joint '{}'"),
    "boxes": checked_boxes,
    "ranges": checked_ranges,
}
