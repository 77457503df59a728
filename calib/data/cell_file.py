"""The cell file: TOML with units in its keys or beside its numbers, into the values of a `calib.data.cell.Cell`.

One table of fields says of every key which attribute it gives and how its value is read into SI units.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.data.surroundings import Box, Reflector, Tracker, TrackerNoise, kept, parse_noise
from calib.errors import CalibError, FileError, choices, did_you_mean
from calib.files import read_bytes
from calib.model.families import FAMILIES
from calib.robot.robot import Payload
from calib.units import (
    ANGLE,
    COMPLIANCE,
    LENGTH,
    PLAIN,
    is_number,
    parse_joint_range,
    parse_joint_value,
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


def _form(must: str, convert: Callable[[Any], Any]) -> Read:
    """What reads values that ``must`` be something; None is none."""
    return lambda value, where: kept(value, where, must, convert)


def _number(per_si: float = 1.0) -> Read:
    """A number, so many of whose unit are one in SI."""
    return _form("a number", lambda value: value / per_si if is_number(value) else None)


def _three(convert: Callable[[Any], Any]) -> Read:
    """Three numbers."""

    def read(value: Any) -> Any:  # noqa: ANN401  TOML values are of any kind
        good = isinstance(value, list) and len(value) == 3 and all(map(is_number, value))
        return convert(value) if good else None

    return _form("three numbers", read)


def _one_of(*words: str) -> Read:
    """One of some words in quotes."""
    listed = [f"'{word}'" for word in words]
    must = f"{', '.join(listed[:-1])} or {listed[-1]}"
    return _form(must, lambda value: value if value in words else None)


def _names(value: Any) -> tuple[str, ...] | None:  # noqa: ANN401
    """A list of texts as a tuple."""
    good = isinstance(value, list) and all(isinstance(one, str) for one in value)
    return tuple(value) if good else None


def _frame(value: Any) -> Any:  # noqa: ANN401
    """What is said of the measurement frame."""
    return value if value in ("known", "estimate") else _names(value)


def _tie(value: Any) -> tuple[str, float] | None:  # noqa: ANN401
    """Another parameter, and a factor."""
    other, factor = (value, 1.0) if isinstance(value, str) else value
    return (other, float(factor)) if isinstance(other, str) and is_number(factor) else None


_TEXT = _form("a name in quotes", lambda value: value if isinstance(value, str) else None)
_DEGREES = _form("a number", lambda value: float(np.radians(value)) if is_number(value) else None)
_MM, _POINT = _number(1e3), _three(lambda value: np.array(value, dtype=np.float64) / 1e3)
_NUMBERS = _three(lambda value: np.array(value, dtype=np.float64))
#: Roll, pitch, yaw about fixed axes [deg], as a matrix, shape (3, 3).
_RPY = _three(lambda rpy: Rotation.from_euler("xyz", np.radians(rpy)).as_matrix())
_TABLE = _form("a table", lambda value: value if isinstance(value, dict) else None)


def _named(read: Read, header: str) -> Read:
    """A table whose keys are names that the user chose, each with a value that ``read`` reads."""
    return lambda value, where: {
        name: read(one, f"'{name}' in [{header}]") for name, one in _TABLE(value, where).items()
    }


def _table(header: str, fields: Mapping[str, Field], build: Callable[..., Any]) -> Read:
    """A table with keys of its own, whose values build something."""
    return lambda value, where: build(**_read(_TABLE(value, where), fields, f"[{header}]"))


def _tables(header: str, fields: Mapping[str, Field], build: Callable[..., Any]) -> Read:
    """A list of such tables."""

    def listed(value: Any) -> Any:  # noqa: ANN401
        good = isinstance(value, list) and all(isinstance(one, dict) for one in value)
        return value if good else None

    whole = _form(f"a list of tables, each headed [[{header}]]", listed)
    return lambda value, where: tuple(
        build(**_read(one, fields, f"[[{header}]] number {k}"))
        for k, one in enumerate(whole(value, where), 1)
    )


def _read(
    values: Mapping[str, Any], fields: Mapping[str, Field], where: str = ""
) -> dict[str, Any]:
    """The values of a table, headed ``where``, by the names of their fields."""
    found = {}
    for key, value in values.items():
        if key not in fields:
            own = f"{where} has an" if where else "there is an"
            raise CalibError(
                f"{own} unknown key '{key}'{did_you_mean(key, fields)}. It may have {choices(fields, limit=40)}."
            )
        place = f"'{key}' in {where}" if where else f"'{key}'"
        found[fields[key].name] = fields[key].read(value, place)
    missing = [key for key, field in fields.items() if field.needed and key not in values]
    if missing:
        raise CalibError(f"{where} lacks {choices(missing)}.")
    return found


def pose(
    xyz: NDArray[np.float64] | None = None, rotation: NDArray[np.float64] | None = None
) -> NDArray[np.float64]:
    """A pose, shape (4, 4), of a place and a rotation; what is left out is zero."""
    T = np.eye(4)
    T[:3, :3] = T[:3, :3] if rotation is None else rotation
    T[:3, 3] = 0.0 if xyz is None else xyz
    return T


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
    allowed = next((kinds for pattern, kinds in _PARAMETERS if re.fullmatch(pattern, name)), ())
    allowed = allowed or tuple(
        {
            unit.quantity: None
            for row in FAMILIES.values()
            for unit in (row.unit, row.sliding)
            if unit and name.rpartition(".")[2] in [factor.name for factor in row.factors]
        }
    )
    examples = " or ".join(_EXAMPLES[kind] for kind in (allowed or _EXAMPLES))
    try:
        change, kind = parse_quantity(value)
    except CalibError as error:
        raise CalibError(f"{where}: {error}. Write {examples}.") from error
    if kind not in (allowed or _EXAMPLES):
        raise CalibError(f"{where} is {value!r}, which is {kind}; write {examples}.")
    return change


def _bounds(value: Any, where: str) -> tuple[float, float]:  # noqa: ANN401
    """The least and the largest change of a parameter; one value is both ways."""
    if not isinstance(value, list):
        high = _change(value, where)
        return -high, high
    if len(value) != 2:
        raise CalibError(
            f"{where} is {value!r}; it must be one value, or the least and the largest."
        )
    return _change(value[0], where), _change(value[1], where)


def _noise(value: Any, where: str) -> TrackerNoise:  # noqa: ANN401
    """The noise of a tracker, with the usual repeatability of a robot."""
    text = _form(
        'a text such as "15 um + 6 um/m"', lambda given: given if isinstance(given, str) else None
    )(value, where)
    return parse_noise(text, where, TrackerNoise().repeatability)


def _tracker(
    noise: TrackerNoise | None = None,
    repeatability: float | None = None,
    **given: Any,  # noqa: ANN401
) -> Tracker:
    """Where the instrument stands, how far it sees and how well it measures."""
    found = noise or TrackerNoise()
    if repeatability is not None:
        found = replace(found, repeatability=repeatability)
    return Tracker(noise=found, **given)


_POSE = {"xyz_mm": Field("xyz", _POINT), "rpy_deg": Field("rotation", _RPY)}


def _named_frame(value: Any, where: str) -> Any:  # noqa: ANN401
    """The pose of the base in the frame of a group, a table ``[frames.name]``."""
    name = where[1 : where.rindex("' in [")]
    if not isinstance(value, dict):
        raise CalibError(
            f"{where} is {value!r}; write a table [frames.{name}] with xyz_mm and rpy_deg."
        )
    return pose(**_read(value, _POSE, f"[frames.{name}]"))


_PAYLOAD = {"mass_kg": Field("mass", _number(), needed=True), "com_mm": Field("com", _POINT)}
_DISTANCE = {
    "first": Field("first", _TEXT, needed=True),
    "second": Field("second", _TEXT, needed=True),
    "length_mm": Field("length", _MM, needed=True),
    "sigma_mm": Field("sigma", _MM, needed=True),
}
_TRACKER = {
    "xyz_mm": Field("position", _POINT, needed=True),
    "nearest_mm": Field("nearest", _MM),
    "farthest_mm": Field("farthest", _MM),
    "noise": Field("noise", _noise),
    "repeatability_mm": Field("repeatability", _MM),
}
_REFLECTOR = {
    "normal": Field("normal", _NUMBERS, needed=True),
    "acceptance_deg": Field("acceptance", _DEGREES),
}
_BOX = {
    "name": Field("name", _TEXT, needed=True),
    "size_mm": Field("size", _POINT, needed=True),
    "xyz_mm": Field("xyz", _POINT, needed=True),
    "rpy_deg": Field("rotation", _RPY),
}


def _box(name: str, size: Any, **where: Any) -> Box:  # noqa: ANN401
    """A box that the robot must not touch."""
    return Box(name, size, pose(**where))


def _payload(mass: float, com: Any = (0.0, 0.0, 0.0)) -> Payload:  # noqa: ANN401
    """What the tip carries."""
    return Payload(mass=float(mass), com=com)


_DIRECTED = '\'known\', \'estimate\' or a list of directions such as ["x", "y", "rz"]'
_TIED = 'another parameter\'s name, or that and a factor, ["a2", -1]'

#: The keys of a cell file: the attribute of a cell that each gives, and how its value is read.
FIELDS: dict[str, Field] = {
    **{key: Field(key, _TEXT) for key in ("base", "tip", "model", "kind")},
    "repeats": Field("repeats", _one_of("weighted", "average", "independent")),
    "freeze": Field("frozen", _form("a list of names", _names)),
    "target": Field("estimate_target", _one_of("known", "estimate")),
    "target_mm": Field("target", _POINT),
    "target_rpy_deg": Field("target_rotation", _RPY),
    "frame": Field("frame", _form(_DIRECTED, _frame)),
    "frame_xyz_mm": Field("xyz", _POINT),
    "frame_rpy_deg": Field("rotation", _RPY),
    "sigma_mm": Field("sigma", _MM),
    "sigma_angle_deg": Field("sigma_angle", _DEGREES),
    "priors": Field("sizes", _one_of("data", "given", "off")),
    "gravity_m_per_s2": Field("gravity", _NUMBERS),
    "targets_mm": Field("targets", _named(_POINT, "targets_mm")),
    "frames": Field("frames", _named(_named_frame, "frames")),
    "ties": Field("ties", _named(_form(_TIED, _tie), "ties")),
    "bounds": Field("bounds", _named(_bounds, "bounds")),
    "parameter_priors": Field("parameter_priors", _named(_change, "parameter_priors")),
    "payload": Field("payload", _table("payload", _PAYLOAD, _payload)),
    "held": Field("held", _named(parse_joint_value, "held")),
    "distances": Field("distances", _tables("distances", _DISTANCE, dict)),
    "tracker": Field("tracker", _table("tracker", _TRACKER, _tracker)),
    "reflector": Field("reflector", _table("reflector", _REFLECTOR, Reflector)),
    "boxes": Field("boxes", _tables("boxes", _BOX, _box)),
    "ranges": Field("ranges", _named(parse_joint_range, "ranges")),
}

#: The keys whose tables have names that the user chose.
_NAMED = ("targets_mm", "frames", "ties", "bounds", "parameter_priors", "held", "ranges")


def fields() -> dict[str, Field]:
    """Every key of a cell file: `FIELDS`, and the size of the prior of each family, such as ``prior_length_mm``."""
    priors = {}
    for name, row in FAMILIES.items():
        suffix, to_si = row.unit.cell
        priors[f"prior_{name}{suffix}"] = Field(f"prior_{name}", _number(1.0 / to_si))
    return FIELDS | priors


def read_cell_file(path: str | Path) -> dict[str, Any]:
    """The values that a cell file gives, by the names of a cell's attributes, in SI units.

    ``priors`` are the word and the sizes by family, ``distances`` dicts.

    Raises:
        FileError: The file cannot be read or is not TOML.
        CalibError: It has an unknown key, or a value of the wrong kind.
    """
    data = read_bytes(Path(path), "cell file")
    try:
        given = tomllib.loads(data.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:  # TOMLDecodeError is one
        raise FileError(f"{path}: this is not a TOML file: {error}") from error
    try:
        return _values(given)
    except CalibError as error:
        raise CalibError(f"{path}: {error}") from error


def _values(given: Mapping[str, Any]) -> dict[str, Any]:
    """The cell's values that a file gives; what it leaves out is left out here."""
    allowed = fields()
    given = {key: value for key, value in given.items() if key != "simulation"}
    for key in _NAMED:
        # TOML's own trap: what stands below a [table] belongs to it.
        own = given.get(key)
        strayed = [name for name in own if name in allowed] if isinstance(own, dict) else []
        if strayed:
            raise CalibError(
                f"'{strayed[0]}' stands in the table [{key}]; the cell's own keys must stand above the first line in "
                "brackets."
            )
    values = _read(given, allowed)
    frame = values.pop("frame", "known")
    values["estimate_target"] = values.get("estimate_target", "estimate") == "estimate"
    values["estimate_frame"] = frame != "known"
    if isinstance(frame, tuple):
        values["frame_directions"] = frame
    placed = {name: values.pop(name) for name in ("xyz", "rotation") if name in values}
    if placed:
        values["T_frame_base"] = pose(**placed)
    sizes = {name: values.pop(f"prior_{name}") for name in FAMILIES if f"prior_{name}" in values}
    values["priors"] = values.pop("sizes", "data"), sizes
    return values
