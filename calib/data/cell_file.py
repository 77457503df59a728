"""The cell file: TOML with units in its keys or beside its numbers, into the values of a `calib.data.cell.Cell`.

One table of fields says of every key which attribute it gives and how its value is read into SI units.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.errors import CalibError, FileError, choices, did_you_mean
from calib.files import read_bytes
from calib.model.error_model import DIRECTIONS
from calib.model.families import FAMILIES
from calib.units import (
    ANGLE,
    COMPLIANCE,
    LENGTH,
    PLAIN,
    is_number,
    parse_joint_range,
    parse_joint_value,
    parse_noise,
    parse_quantity,
)

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

#: Reads a value, given where it stands, into SI units.
Read = Callable[[Any, str], Any]


@dataclass(frozen=True, slots=True)
class Field:
    """A key of a table: the attribute that it gives, what reads its value, and whether it must be there."""

    name: str
    read: Read
    needed: bool = False


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


def read_table(
    values: Mapping[str, Any], fields: Mapping[str, Field], where: str = ""
) -> dict[str, Any]:
    """The values of a table, headed ``where``, by the names of their fields.

    Raises:
        CalibError: An unknown key, one that is missing, or a value of the wrong kind.
    """
    found = {}
    for key, value in values.items():
        place = f"'{key}' in {where}" if where else f"'{key}'"
        if key not in fields:
            raise CalibError(
                f"{place}: unknown key{did_you_mean(key, fields)}. It may be one of {choices(fields, limit=40)}."
            )
        found[fields[key].name] = fields[key].read(value, place)
    missing = [key for key, field in fields.items() if field.needed and key not in values]
    if missing:
        raise CalibError(f"{where} lacks {choices(missing)}.")
    return found


def _form(must: str, convert: Callable[[Any], Any]) -> Read:
    """What reads values that ``must`` be something."""
    return lambda value, where: kept(value, where, must, convert)


def _of_type(kind: type, must: str) -> Read:
    """What reads a value of a type."""
    return _form(must, lambda value: value if isinstance(value, kind) else None)


def numbers(count: int, to_si: Callable[[Any], Any] = lambda value: value) -> Read:
    """What reads a number, or a list of three, into SI units."""

    def convert(value: Any) -> Any:  # noqa: ANN401  TOML values are of any kind
        if count == 1:
            return float(to_si(value)) if is_number(value) else None
        good = len(value) == count and all(map(is_number, value))
        return to_si(np.array(value, dtype=np.float64)) if good else None

    return _form("a number" if count == 1 else "three numbers", convert)


def millimetres(value: Any) -> Any:  # noqa: ANN401
    """Lengths in mm as metres."""
    return value / 1e3


#: Texts, numbers, points, angles; roll, pitch, yaw about fixed axes [deg] as a matrix, shape (3, 3).
TEXT = _of_type(str, "a name in quotes")
MM, POINT = numbers(1, millimetres), numbers(3, millimetres)
DEGREES, NUMBERS = numbers(1, np.radians), numbers(3)
_RPY = numbers(3, lambda rpy: Rotation.from_euler("xyz", np.radians(rpy)).as_matrix())
_TABLE = _of_type(dict, "a table")


def _named(header: str, read: Read) -> Read:
    """A table whose keys are names that the user chose, each with a value that ``read`` reads."""
    return lambda value, where: {
        name: read(one, f"'{name}' in [{header}]") for name, one in _TABLE(value, where).items()
    }


def _table(header: str, fields: Mapping[str, Field]) -> Read:
    """A table with keys of its own."""
    return lambda value, where: read_table(_TABLE(value, where), fields, f"[{header}]")


def _tables(header: str, fields: Mapping[str, Field]) -> Read:
    """A list of such tables."""
    listed = _of_type(list, f"a list of tables, each headed [[{header}]]")
    return lambda value, where: [
        read_table(_TABLE(one, where), fields, f"[[{header}]] number {k}")
        for k, one in enumerate(listed(value, where), 1)
    ]


def pose(
    xyz: NDArray[np.float64] | None = None, rotation: NDArray[np.float64] | None = None
) -> NDArray[np.float64]:
    """A pose, shape (4, 4), of a place and a rotation; what is left out is zero."""
    T = np.eye(4)
    T[:3, :3] = T[:3, :3] if rotation is None else rotation
    T[:3, 3] = 0.0 if xyz is None else xyz
    return T


def frame(said: str | Sequence[str]) -> dict[str, Any]:
    """``known``, ``estimate``, or the directions that are estimated, such as ``x,y,rz``, as attributes of a cell."""
    if said in ("known", "estimate"):
        return {"estimate_frame": said == "estimate", "frame_directions": DIRECTIONS}
    words = said.replace(",", " ").split() if isinstance(said, str) else said
    if not words or not {*words} <= {*DIRECTIONS}:
        raise ValueError
    return {"estimate_frame": True, "frame_directions": tuple(words)}


_EXAMPLES = {LENGTH: '"0.5 mm"', ANGLE: '"1 mrad"', PLAIN: "1e-3", COMPLIANCE: '"1e-5 rad/Nm"'}

#: How parameters are named, and what they are; see docs/parameters.md. The first that fits is taken.
_PARAMETERS: tuple[tuple[str, tuple[str, ...]], ...] = (
    (r"[ad]\d+|(frame|target)_[xyz](\[.*\])?|.*\.[xyz]", (LENGTH,)),
    (r"(alpha|beta|theta)\d+|(frame|target)_r[xyz](\[.*\])?|.*\.r[xyz]", (ANGLE,)),
    (r".*\.zero", (LENGTH, ANGLE)),
)


def _change(value: Any, where: str) -> float:  # noqa: ANN401
    """The change of a parameter in SI units; its name, which ``where`` begins with, tells what it can be."""
    name = where[1 : where.rindex("' in [")]
    units = (
        unit.quantity
        for row in FAMILIES.values()
        for unit in (row.unit, row.sliding)
        if unit and name.rpartition(".")[2] in [factor.name for factor in row.factors]
    )
    fits = (kinds for pattern, kinds in _PARAMETERS if re.fullmatch(pattern, name))
    allowed = next(fits, tuple(dict.fromkeys(units))) or tuple(_EXAMPLES)
    examples = " or ".join(_EXAMPLES[kind] for kind in allowed)
    try:
        change, kind = parse_quantity(value)
    except CalibError as error:
        raise CalibError(f"{where}: {error}. Write {examples}.") from error
    if kind not in allowed:
        raise CalibError(f"{where} is {value!r}, which is {kind}; write {examples}.")
    return change


def _bounds(value: Any, where: str) -> tuple[float, ...]:  # noqa: ANN401
    """The least and the largest change of a parameter; one value is both ways."""
    if isinstance(value, list):
        return tuple(_change(one, where) for one in value)
    high = _change(value, where)
    return -high, high


def _fields(**rows: tuple[str, Read]) -> dict[str, Field]:
    """Fields by key; a name that ends in ``!`` is of one that must be there."""
    return {
        k: Field(name.rstrip("!"), read, name.endswith("!")) for k, (name, read) in rows.items()
    }


_PLACE = _fields(xyz_mm=("xyz", POINT), rpy_deg=("rotation", _RPY))
_PAYLOAD = _fields(mass_kg=("mass!", numbers(1)), com_mm=("com", POINT))
_DISTANCE = _fields(
    first=("first!", TEXT),
    second=("second!", TEXT),
    length_mm=("length!", MM),
    sigma_mm=("sigma!", MM),
)
_TRACKER = _fields(
    xyz_mm=("position!", POINT),
    nearest_mm=("nearest", MM),
    farthest_mm=("farthest", MM),
    noise=("noise", lambda value, where: parse_noise(str(value), where)),
    repeatability_mm=("repeatability", MM),
)
_REFLECTOR = _fields(normal=("normal!", NUMBERS), acceptance_deg=("acceptance", DEGREES))
_BOX = _PLACE | _fields(name=("name!", TEXT), size_mm=("size!", POINT), xyz_mm=("xyz!", POINT))


def _place(value: Any, where: str) -> Any:  # noqa: ANN401
    """The pose of a measurement frame."""
    return pose(**read_table(_TABLE(value, where), _PLACE, where))


#: The measurement frame, in a file or on the line; where it stands has keys of its own.
FRAME = _form(
    f"'known', 'estimate' or some of {', '.join(DIRECTIONS)}; its place is frame_xyz_mm and frame_rpy_deg",
    frame,
)
_KNOWN = _form("'known' or 'estimate'", {"known": False, "estimate": True}.get)


#: The keys of a cell file: the attribute of a cell that each gives, and how its value is read.
FIELDS: dict[str, Field] = {
    **{key: Field(key, TEXT) for key in ("base", "tip", "model", "kind", "repeats")},
    "freeze": Field("frozen", _of_type(list, "a list of names")),
    "target": Field("estimate_target", _KNOWN),
    "target_mm": Field("target", POINT),
    "target_rpy_deg": Field("target_rotation", _RPY),
    "frame": Field("frame", FRAME),
    "frame_xyz_mm": Field("xyz", POINT),
    "frame_rpy_deg": Field("rotation", _RPY),
    "sigma_mm": Field("sigma", MM),
    "sigma_angle_deg": Field("sigma_angle", DEGREES),
    "scale_certified": Field("scale_certified", _of_type(bool, "true or false")),
    "priors": Field("source", TEXT),
    "gravity_m_per_s2": Field("gravity", NUMBERS),
    "targets_mm": Field("targets", _named("targets_mm", POINT)),
    "frames": Field("frames", _named("frames", _place)),
    "ties": Field(
        "ties", _named("ties", lambda one, _: (one, 1.0) if isinstance(one, str) else one)
    ),
    "bounds": Field("bounds", _named("bounds", _bounds)),
    "parameter_priors": Field("parameter_priors", _named("parameter_priors", _change)),
    "payload": Field("payload", _table("payload", _PAYLOAD)),
    "held": Field("held", _named("held", parse_joint_value)),
    "distances": Field("distances", _tables("distances", _DISTANCE)),
    "tracker": Field("tracker", _table("tracker", _TRACKER)),
    "reflector": Field("reflector", _table("reflector", _REFLECTOR)),
    "boxes": Field("boxes", _tables("boxes", _BOX)),
    "ranges": Field("ranges", _named("ranges", parse_joint_range)),
}


def _in_si(to_si: float, value: float) -> float:
    """A number in a unit, so much in SI, as SI has it."""
    return value / (1.0 / to_si)


def fields() -> dict[str, Field]:
    """Every key of a cell file: `FIELDS`, and the size of the prior of each family, such as ``prior_length_mm``."""
    priors = {}
    for name, row in FAMILIES.items():
        suffix, to_si = row.unit.cell
        priors[f"prior_{name}{suffix}"] = Field(f"prior_{name}", numbers(1, partial(_in_si, to_si)))
    return FIELDS | priors


def read_toml(path: str | Path) -> dict[str, Any]:
    """The whole of a cell file.

    Raises:
        FileError: The file cannot be read or is not TOML.
    """
    try:
        found: dict[str, Any] = tomllib.loads(read_bytes(path, "cell file").decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:  # TOMLDecodeError is one
        raise FileError(f"{path}: this is not a TOML file: {error}") from error
    return found


def read_cell_file(path: str | Path) -> dict[str, Any]:
    """The values that a cell file gives, by the names of a cell's attributes, in SI units.

    ``priors`` are the word and the sizes by family; what has a class of its own is a dict of its attributes.

    Raises:
        FileError: The file cannot be read or is not TOML.
        CalibError: It has an unknown key, or a value of the wrong kind.
    """
    given = read_toml(path)
    given.pop("simulation", None)
    values = read_table(given, fields())
    values |= values.pop("frame", {})
    placed = {name: values.pop(name) for name in ("xyz", "rotation") if name in values}
    if placed:
        values["T_frame_base"] = pose(**placed)
    prior_std = {f: values.pop(f"prior_{f}") for f in FAMILIES if f"prior_{f}" in values}
    values["priors"] = {"source": values.pop("source", "data"), **prior_std}
    return values
