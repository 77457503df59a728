"""Cell: what stands around the robot while it is measured, and what of it is known.

The measurement frame, the target on the tip, the instrument's noise, how large errors are expected to be, and
which parameters are estimated. All of it can stand in a TOML file, ``--cell cell.toml``; see docs/cell.md.
"""

from __future__ import annotations

import difflib
import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from calib.errors import CalibError, FileError, choices
from calib.model.files import read_bytes
from calib.model.robot import read_only

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

#: What `Priors.sizes` may be.
PRIOR_SIZES = ("data", "given", "off")


def _is_positive(value: object) -> bool:
    """Whether a value is a positive finite number."""
    return isinstance(value, (int, float, np.number)) and bool(np.isfinite(value) and value > 0)


@dataclass(frozen=True, slots=True)
class Priors:
    """How large a robot's errors are expected to be: zero-mean normal distributions.

    Attributes:
        sizes: ``"data"``: the sizes are found from the measurements, starting at the two below; ``"given"``: they are
            the two below; ``"off"``: none, plain least squares, but for a leash of 1 m and 1 rad on what no
            measurement determines.
        length: Standard deviation of an error in length [m].
        angle: Standard deviation of an error in angle [rad].
    """

    sizes: str = "data"
    length: float = 3e-3
    angle: float = 15e-3

    def __post_init__(self) -> None:
        """Refuse an unknown word and sizes that are no standard deviations."""
        if self.sizes not in PRIOR_SIZES:
            message = f"Priors of the kind '{self.sizes}' were asked for; choose one of {choices(PRIOR_SIZES)}."
            raise CalibError(message)
        for name, value, unit in (("length", self.length, "m"), ("angle", self.angle, "rad")):
            if not _is_positive(value):
                message = f"The prior's {name} is {value} {unit}; it must be positive. Use sizes 'off' for none."
                raise CalibError(message)


@dataclass(frozen=True, slots=True, eq=False)
class Cell:
    """The set-up of a calibration.

    Attributes:
        target: shape (3,), position of the target in the tip [m]; None where it is not known.
        estimate_target: Whether the target is estimated with the robot (its start is found from the data).
        T_frame_base: shape (4, 4), pose of the base in the measurement frame [m]; None where it is not given: then it
            is estimated, or, if it is said to be known, the measurements are in the base frame itself.
        estimate_frame: Whether the measurement frame is estimated.
        sigma: Standard deviation of one measured coordinate [m]; None: found from the data.
        priors: How large the robot's errors are expected to be.
        model: Name of the parameter set.
        frozen: Names of parameters that stay at their nominal values.
        base: Base link; None: left to the command line or the URDF.
        tip: Tip link, likewise.
    """

    target: NDArray[np.float64] | None = None
    estimate_target: bool = True
    T_frame_base: NDArray[np.float64] | None = None
    estimate_frame: bool = False
    sigma: float | None = None
    priors: Priors = Priors()
    model: str = "dh"
    frozen: tuple[str, ...] = ()
    base: str | None = None
    tip: str | None = None

    def __post_init__(self) -> None:
        """Check kinds, shapes and numbers."""
        for name, kind in (
            ("estimate_target", bool),
            ("estimate_frame", bool),
            ("priors", Priors),
            ("model", str),
        ):
            if not isinstance(getattr(self, name), kind):
                message = f"A cell's {name} must be of type {kind.__name__}; {getattr(self, name)!r} was given."
                raise CalibError(message)
        if self.target is not None:
            object.__setattr__(self, "target", _vector(self.target, "target"))
        elif not self.estimate_target:
            message = (
                'The target is said to be known but is not given. Give it (--target "x y z mm", or target_mm in the '
                "cell file) or let it be estimated."
            )
            raise CalibError(message)
        if self.T_frame_base is not None:
            object.__setattr__(self, "T_frame_base", _pose(self.T_frame_base))
        if self.sigma is not None and not _is_positive(self.sigma):
            message = f"The noise sigma is {self.sigma} m; it must be a positive number."
            raise CalibError(message)
        names = self.frozen
        if not isinstance(names, (tuple, list)) or not all(isinstance(name, str) for name in names):
            message = f"The frozen parameters are a tuple of names; {names!r} was given."
            raise CalibError(message)
        object.__setattr__(self, "frozen", tuple(self.frozen))

    @classmethod
    def read(cls, path: str | Path) -> Cell:
        """Read a cell from a TOML file.

        Raises:
            FileError: The file cannot be read.
            CalibError: It is not TOML, has an unknown key, or a value of the wrong kind.
        """
        data = read_bytes(Path(path), "cell file", 1_000_000)
        try:
            table = tomllib.loads(data.decode("utf-8-sig"))
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            message = f"{path}: this is not a TOML file: {error}"
            raise FileError(message) from error
        return _from_table(table, str(path))

    def with_target(self, target: ArrayLike, *, estimate: bool = True) -> Cell:
        """The cell with this target [m]."""
        return replace(self, target=read_only(np.asarray(target)), estimate_target=estimate)


def _vector(value: ArrayLike, name: str) -> NDArray[np.float64]:
    """Three finite numbers."""
    vector = _floats(value)
    if vector is None or vector.shape != (3,) or not np.all(np.isfinite(vector)):
        given = value.tolist() if isinstance(value, np.ndarray) else value
        message = f"The {name} must be three finite numbers x, y, z [m]; {given!r} was given."
        raise CalibError(message)
    return read_only(vector)


def _pose(value: ArrayLike) -> NDArray[np.float64]:
    """A pose: an orthonormal right-handed rotation and a translation."""
    T = _floats(value)
    if (
        T is None
        or T.shape != (4, 4)
        or not np.all(np.isfinite(T))
        or not np.array_equal(T[3], [0, 0, 0, 1])
        or np.abs(T[:3, :3] @ T[:3, :3].T - np.eye(3)).max() > 1e-6
        or np.linalg.det(T[:3, :3]) < 0
    ):
        given = value.tolist() if isinstance(value, np.ndarray) else value
        message = f"T_frame_base must be a 4 x 4 pose with a right-handed rotation [m]; {given!r} was given."
        raise CalibError(message)
    return read_only(T)


def _floats(value: ArrayLike) -> NDArray[np.float64] | None:
    """An array of numbers, or None where the value is none."""
    try:
        return np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        return None


#: The keys of a cell file, each with what its value must be.
_KEYS: dict[str, str] = {
    "base": "a name in quotes",
    "tip": "a name in quotes",
    "model": "a name in quotes",
    "freeze": "a list of names",
    "target": "'known' or 'estimate'",
    "target_mm": "three numbers",
    "frame": "'known' or 'estimate'",
    "frame_xyz_mm": "three numbers",
    "frame_rpy_deg": "three numbers",
    "sigma_mm": "a positive number",
    "priors": "'data', 'given' or 'off'",
    "prior_length_mm": "a positive number",
    "prior_angle_mrad": "a positive number",
}


def _from_table(table: Mapping[str, Any], source: str) -> Cell:
    """The cell that a TOML table describes."""
    for key, value in table.items():
        if key not in _KEYS:
            close = difflib.get_close_matches(key, _KEYS, n=1)
            hint = f" Did you mean '{close[0]}'?" if close else ""
            message = f"{source}: unknown key '{key}'.{hint} A cell file may have {choices(_KEYS, limit=40)}."
            raise CalibError(message)
        if not _fits(value, _KEYS[key]):
            message = f"{source}: '{key}' is {value!r}; it must be {_KEYS[key]}."
            raise CalibError(message)
    default = Priors()
    frame = None
    if "frame_xyz_mm" in table or "frame_rpy_deg" in table:
        frame = np.eye(4)
        angles = np.radians(table.get("frame_rpy_deg", [0.0, 0.0, 0.0]))
        frame[:3, :3] = Rotation.from_euler("xyz", angles).as_matrix()
        frame[:3, 3] = np.asarray(table.get("frame_xyz_mm", [0.0, 0.0, 0.0])) / 1e3
    try:
        return Cell(
            target=read_only(np.asarray(table["target_mm"]) / 1e3)
            if "target_mm" in table
            else None,
            estimate_target=table.get("target", "estimate") == "estimate",
            T_frame_base=frame,
            estimate_frame=table.get("frame", "known") == "estimate",
            sigma=table["sigma_mm"] / 1e3 if "sigma_mm" in table else None,
            priors=Priors(
                sizes=table.get("priors", default.sizes),
                length=table.get("prior_length_mm", 1e3 * default.length) / 1e3,
                angle=table.get("prior_angle_mrad", 1e3 * default.angle) / 1e3,
            ),
            model=table.get("model", "dh"),
            frozen=tuple(table.get("freeze", ())),
            base=table.get("base"),
            tip=table.get("tip"),
        )
    except CalibError as error:
        message = f"{source}: {error}"
        raise CalibError(message) from error


def _fits(value: Any, kind: str) -> bool:  # noqa: ANN401  TOML values are of any kind
    """Whether a TOML value is of the kind that its key wants."""

    def is_number(v: Any) -> bool:  # noqa: ANN401
        return isinstance(v, (int, float)) and not isinstance(v, bool) and math.isfinite(v)

    if kind == "a positive number":
        return is_number(value) and value > 0
    if kind == "three numbers":
        return isinstance(value, list) and len(value) == 3 and all(is_number(v) for v in value)
    if kind == "a list of names":
        return isinstance(value, list) and all(isinstance(v, str) for v in value)
    if kind == "a name in quotes":
        return isinstance(value, str)
    return isinstance(value, str) and f"'{value}'" in kind
