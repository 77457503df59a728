"""The cell file: TOML with units in its keys or beside its numbers, into the values of a `calib.data.cell.Cell`.

One table of fields says of every key which attribute it gives and how its value is read into SI units.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import calib.basics.plugins as plugins
from calib.basics.arrays import Array
from calib.basics.channels import RESIDUAL_UNITS
from calib.basics.files import read_bytes
from calib.basics.units import (
    ANGLE,
    COMPLIANCE,
    LENGTH,
    PLAIN,
    UNITS,
    is_number,
    parse_joint_range,
    parse_joint_value,
    parse_noise,
    parse_quantity,
)
from calib.data.optics_tables import boards_of_tables, cameras_of_tables
from calib.data.record import TEXTS
from calib.errors import CalibError, FileError, choices, did_you_mean
from calib.model.error_model import DIRECTIONS
from calib.model.families import FAMILIES
from calib.numerics.geometry import pose_of

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

#: Reads a TOML value into SI units: (value, where it stands, for messages) to what is kept.
#: Raises `CalibError` for a value of the wrong kind.
Read = Callable[[Any, str], Any]


@dataclass(frozen=True, slots=True)
class Field:
    """A key of a TOML table: the attribute that it gives, and how its value is read."""

    #: The attribute, such as ``"target"`` for the key ``target_mm``.
    name: str
    #: Reads the value.
    read: Read
    #: Whether a table must have the key.
    needed: bool = False


def checked(value: Any, what: str, must: str, convert: Callable[[Any], Any]) -> Any:  # noqa: ANN401
    """Return a given value as it is kept.

    Args:
        value: The value as given.
        what: Where it stands or what it is, for the message: ``"'target_mm'"``.
        must: What it must be, for the message: ``"three numbers"``.
        convert: Gives the value that is kept; refuses by None, a TypeError or a ValueError.

    Returns:
        What ``convert`` gives.

    Raises:
        CalibError: ``convert`` refuses the value.
    """
    try:
        result = convert(value)
    except (TypeError, ValueError):
        result = None
    if result is None:
        written = value.tolist() if isinstance(value, np.ndarray) else value
        raise CalibError(f"{what} is {written!r}; it must be {must}.")
    return result


def read_table(
    values: Mapping[str, Any], fields: Mapping[str, Field], where: str = ""
) -> dict[str, Any]:
    """Read the values of a TOML table.

    Args:
        values: The table, by its keys.
        fields: The fields of the keys that it may have, by key.
        where: Heading of the table, for messages; empty for the outermost one.

    Returns:
        The values in SI units, by the attributes' names.

    Raises:
        CalibError: An unknown key, one that is missing, or a value of the wrong kind.
    """
    result = {}
    for key, value in values.items():
        place = f"'{key}' in {where}" if where else f"'{key}'"
        if key not in fields:
            raise CalibError(_unknown_key(key, fields, place, where))
        field = fields[key]
        result[field.name] = field.read(value, place)
    missing = [key for key, field in fields.items() if field.needed and key not in values]
    if missing:
        raise CalibError(f"{where} lacks {choices(missing)}.")
    return result


def _unknown_key(key: str, known: Mapping[str, Field], place: str, where: str) -> str:
    """Word that a table has no such key.

    Args:
        key: The key.
        known: The keys that it may have.
        place: The key and its table, as messages name it.
        where: Heading of the table; empty for the outermost one.
    """
    if where and key in fields():
        return f"{place}: this key is not of that table; write it at the top of the file, before the first table."
    return f"{place}: unknown key{did_you_mean(key, known)}. It may be one of {choices(known, limit=40)}."


# Readers of values


def _form(must: str, convert: Callable[[Any], Any]) -> Read:
    """Return a reader by a conversion; ``must`` says what a value must be, see `checked`."""
    return lambda value, where: checked(value, where, must, convert)


def _of_type(kind: type, must: str) -> Read:
    """Return a reader that keeps values of a type and refuses others."""
    return _form(must, lambda value: value if isinstance(value, kind) else None)


def numbers(count: int, to_si: Callable[[Any], Any] = lambda value: value) -> Read:
    """Return a reader of one number or of a list of three.

    Args:
        count: 1 or 3.
        to_si: Conversion of the number, or of an array of shape (3,), into SI units.

    Returns:
        A reader that gives a float, or an array of shape (3,).
    """

    def convert_one(value: Any) -> float | None:  # noqa: ANN401  TOML values are of any kind
        return float(to_si(value)) if is_number(value) else None

    def convert_list(value: Any) -> Any:  # noqa: ANN401
        if len(value) != count or not all(map(is_number, value)):
            return None
        return to_si(np.array(value, dtype=np.float64))

    if count == 1:
        return _form("a number", convert_one)
    return _form("three numbers", convert_list)


def millimetres(value: Any) -> Any:  # noqa: ANN401
    """Convert lengths from mm to m."""
    return value / 1e3


def _rpy_matrix(rpy: Array) -> Array:
    """Return Rz(yaw) Ry(pitch) Rx(roll), shape (3, 3), of roll, pitch, yaw [deg]."""
    matrix: Array = Rotation.from_euler("xyz", np.radians(rpy)).as_matrix()
    return matrix


#: A name.
TEXT = _of_type(str, "a name in quotes")
#: A length in mm, as [m].
MM = numbers(1, millimetres)
#: A position in mm, as an array (3,) [m].
POINT = numbers(3, millimetres)
#: An angle in deg, as [rad].
DEGREES = numbers(1, np.radians)
#: Three numbers as they are, as an array (3,).
NUMBERS = numbers(3)
#: Roll, pitch, yaw about fixed axes in deg, as a rotation matrix (3, 3).
_RPY = numbers(3, _rpy_matrix)
#: A nested TOML table, as a dict.
_TABLE = _of_type(dict, "a table")
#: Factors of joints' readings by name, which `calib.data.cell.Cell` checks.
_FACTORS = _of_type(dict, "a table of joints and factors, such as { joint_2 = 1.0 }")
#: A list of names.
_NAMES = _of_type(list, "a list of names")
#: A truth value.
_TRUTH = _of_type(bool, "true or false")


def _named(header: str, read: Read) -> Read:
    """Return a reader of the table ``[header]``, whose keys are names that the user chose.

    ``read`` reads each value; the result is a dict by name.
    """

    def read_named(value: Any, where: str) -> dict[str, Any]:  # noqa: ANN401
        entries = _TABLE(value, where).items()
        return {name: read(entry, f"'{name}' in [{header}]") for name, entry in entries}

    return read_named


def _table(header: str, fields: Mapping[str, Field]) -> Read:
    """Return a reader of the table ``[header]`` with these keys, see `read_table`."""
    return lambda value, where: read_table(_TABLE(value, where), fields, f"[{header}]")


def _tables(header: str, fields: Mapping[str, Field]) -> Read:
    """Return a reader of tables ``[[header]]`` with these keys; the result is a list of dicts."""
    read_list = _of_type(list, f"a list of tables, each headed [[{header}]]")

    def read_tables(value: Any, where: str) -> list[dict[str, Any]]:  # noqa: ANN401
        tables = []
        for k, entry in enumerate(read_list(value, where), 1):
            heading = f"[[{header}]] number {k}"
            tables.append(read_table(_TABLE(entry, where), fields, heading))
        return tables

    return read_tables


def frame_attributes(value: str | Sequence[str]) -> dict[str, Any]:
    """Return what the key ``frame`` gives, as attributes of a cell.

    Args:
        value: ``"known"``, ``"estimate"`` (in all directions), or the directions of the base that
            are estimated, as a list or a text such as ``"x,y,rz"``.

    Returns:
        ``estimate_frame`` and ``frame_directions``.

    Raises:
        ValueError: Anything else.
    """
    if value in ("known", "estimate"):
        return {"estimate_frame": value == "estimate", "frame_directions": DIRECTIONS}
    words = value.replace(",", " ").split() if isinstance(value, str) else value
    if not words or not {*words} <= {*DIRECTIONS}:
        raise ValueError
    return {"estimate_frame": True, "frame_directions": tuple(words)}


#: Reads the measurement frame, in a file or on the command line; its pose has keys of its own.
FRAME = _form(
    f"'known', 'estimate' or some of {', '.join(DIRECTIONS)}; its place is frame_xyz_mm and "
    "frame_rpy_deg",
    frame_attributes,
)

#: Reads whether the target is estimated.
_IS_ESTIMATED = _form("'known' or 'estimate'", {"known": False, "estimate": True}.get)


# Changes of parameters, with units

#: An example of a change of each quantity, for messages.
_EXAMPLES = {LENGTH: '"0.5 mm"', ANGLE: '"1 mrad"', PLAIN: "1e-3", COMPLIANCE: '"1e-5 rad/Nm"'}

#: Quantities of geometric parameters by a pattern of their names, see docs/parameters.md; the
#: first that fits is taken.
_PARAMETERS: tuple[tuple[str, tuple[str, ...]], ...] = (
    (r"[ad]\d+|(frame|target)_[xyz](\[.*\])?|.*\.[xyz]", (LENGTH,)),
    (r"(alpha|beta|theta)\d+|(frame|target)_r[xyz](\[.*\])?|.*\.r[xyz]", (ANGLE,)),
    (r".*\.zero", (LENGTH, ANGLE)),
)


def _quantities_of(parameter: str) -> tuple[str, ...]:
    """Return the quantities that a parameter may be of, by its name; all if none is known."""
    for pattern, quantities in _PARAMETERS:
        if re.fullmatch(pattern, parameter):
            return quantities
    factor_name = parameter.rpartition(".")[2]
    quantities_of_families = []
    for family in FAMILIES.values():
        if factor_name in [factor.name for factor in family.factors]:
            units = (family.unit, family.sliding)
            quantities_of_families += [unit.quantity for unit in units if unit]
    return tuple(dict.fromkeys(quantities_of_families)) or tuple(_EXAMPLES)


def _change(value: Any, where: str) -> float:  # noqa: ANN401
    """Read the change of a parameter from its nominal value, in SI units.

    ``where`` begins with the parameter's name, ``"'a2' in [bounds]"``, which tells its quantity.
    """
    parameter = where[1 : where.rindex("' in [")]
    allowed = _quantities_of(parameter)
    examples = " or ".join(_EXAMPLES[quantity] for quantity in allowed)
    try:
        change, quantity = parse_quantity(value)
    except CalibError as error:
        raise CalibError(f"{where}: {error}. Write {examples}.") from error
    if quantity not in allowed:
        raise CalibError(f"{where} is {value!r}, which is {quantity}; write {examples}.")
    return change


def _bounds(value: Any, where: str) -> tuple[float, ...]:  # noqa: ANN401
    """Read the least and the largest change of a parameter; one value stands for both signs."""
    if isinstance(value, list):
        return tuple(_change(bound, where) for bound in value)
    largest = _change(value, where)
    return -largest, largest


def _tie(value: Any, _where: str) -> Any:  # noqa: ANN401
    """Read what a parameter is tied to: another one's name, or (name, factor)."""
    return (value, 1.0) if isinstance(value, str) else value


# The keys


def _fields(**rows: tuple[str, Read]) -> dict[str, Field]:
    """Return fields by key, from (attribute, reader); an attribute that ends in ``!`` is needed."""
    result = {}
    for key, (name, read) in rows.items():
        result[key] = Field(name.rstrip("!"), read, needed=name.endswith("!"))
    return result


def _noise(value: Any, where: str) -> Any:  # noqa: ANN401
    """Read an instrument's noise, ``"15 um + 6 um/m"``, as [m] and [m/m]."""
    return parse_noise(str(value), where)


_POSE = _fields(xyz_mm=("xyz", POINT), rpy_deg=("rotation", _RPY))
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
    noise=("noise", _noise),
    repeatability_mm=("repeatability", MM),
)
_REFLECTOR = _fields(normal=("normal!", NUMBERS), acceptance_deg=("acceptance", DEGREES))
_BOX = _POSE | _fields(name=("name!", TEXT), size_mm=("size!", POINT), xyz_mm=("xyz!", POINT))


def _entry(value: Any) -> str | None:  # noqa: ANN401
    """Return an entry of a record: a text, a whole number such as a serial number, or a date; None for others."""
    if isinstance(value, date):
        return value.isoformat()
    is_count = isinstance(value, int) and not isinstance(value, bool)
    return str(value) if is_count or isinstance(value, str) else None


def _temperatures(value: Any) -> tuple[Any, ...] | None:  # noqa: ANN401
    """Return one temperature or a list of two as a tuple; None for others."""
    values = value if isinstance(value, list) else [value]
    return tuple(values) if all(map(is_number, values)) else None


def _record_fields() -> dict[str, Field]:
    """Return the fields of the table ``[record]``, whose keys are the names of a record's entries."""
    read = _form("a text in quotes, a whole number or a date", _entry)
    result = {name: Field(name, read) for name in TEXTS}
    read_temperatures = _form("a number, or a list of two: [21.5, 23.0]", _temperatures)
    return result | {"temperature_C": Field("temperature_C", read_temperatures)}


def _frame_pose(value: Any, where: str) -> Array:  # noqa: ANN401
    """Read the pose of the base in a measurement frame, T_frame_base, shape (4, 4) [m]."""
    return pose_of(**read_table(_TABLE(value, where), _POSE, where))


#: The keys of a cell file: the attribute of a cell that each gives, and how its value is read.
#: `read_cell_file` joins ``frame``, ``xyz``, ``rotation`` and ``source`` into attributes, and reads the tables of
#: cameras and boards, which may name files beside the cell file.
FIELDS: dict[str, Field] = {
    "plugins": Field("plugins", _NAMES),
    "base": Field("base", TEXT),
    "tip": Field("tip", TEXT),
    "model": Field("model", TEXT),
    "kind": Field("kind", TEXT),
    "repeats": Field("repeats", TEXT),
    "freeze": Field("frozen", _NAMES),
    "target": Field("estimate_target", _IS_ESTIMATED),
    "target_mm": Field("target", POINT),
    "target_rpy_deg": Field("target_rotation", _RPY),
    "frame": Field("frame", FRAME),
    "frame_xyz_mm": Field("xyz", POINT),
    "frame_rpy_deg": Field("rotation", _RPY),
    "scale_certified": Field("scale_certified", _TRUTH),
    "priors": Field("source", TEXT),
    "gravity_m_per_s2": Field("gravity", NUMBERS),
    "targets_mm": Field("targets", _named("targets_mm", POINT)),
    "frames": Field("frames", _named("frames", _frame_pose)),
    "ties": Field("ties", _named("ties", _tie)),
    "bounds": Field("bounds", _named("bounds", _bounds)),
    "parameter_priors": Field("parameter_priors", _named("parameter_priors", _change)),
    "payload": Field("payload", _table("payload", _PAYLOAD)),
    "held": Field("held", _named("held", parse_joint_value)),
    "coupling": Field("coupling", _named("coupling", _FACTORS)),
    "distances": Field("distances", _tables("distances", _DISTANCE)),
    "tracker": Field("tracker", _table("tracker", _TRACKER)),
    "reflector": Field("reflector", _table("reflector", _REFLECTOR)),
    "boxes": Field("boxes", _tables("boxes", _BOX)),
    "ranges": Field("ranges", _named("ranges", parse_joint_range)),
    "camera": Field("camera", _TABLE),
    "cameras": Field("cameras", _named("cameras", _TABLE)),
    "board": Field("board", _TABLE),
    "boards": Field("boards", _named("boards", _TABLE)),
    "record": Field("record", _table("record", _record_fields())),
}


def _in_si(to_si: float, value: float) -> float:
    """Convert a number to SI, where one of its unit is ``to_si``.

    Division by the inverse, such as 1000, gives the double nearest to the decimal value in SI.
    """
    return value / (1.0 / to_si)


def fields() -> dict[str, Field]:
    """Return the fields of all keys of a cell file.

    These are `FIELDS`; one for the standard deviation of scalars in each unit of residuals, such as ``sigma_mm`` with
    the attribute ``sigma_m``; and one for the prior standard deviation of each registered family, such as
    ``prior_length_mm`` with the attribute ``prior_length``.
    """
    sigma_fields = {}
    for symbol, unit in RESIDUAL_UNITS.items():
        read = numbers(1, partial(_in_si, UNITS[unit.shown].to_si))
        sigma_fields[unit.sigma_key] = Field(f"sigma_{symbol}", read)
    prior_fields = {}
    for name, family in FAMILIES.items():
        suffix, to_si = family.unit.cell
        read = numbers(1, partial(_in_si, to_si))
        prior_fields[f"prior_{name}{suffix}"] = Field(f"prior_{name}", read)
    return FIELDS | sigma_fields | prior_fields


# The file


def read_toml(path: str | Path) -> dict[str, Any]:
    """Read a TOML file as nested tables, without a check of its keys.

    Args:
        path: The file, in UTF-8.

    Returns:
        The outermost table.

    Raises:
        FileError: The file cannot be read or is not TOML.
    """
    data = read_bytes(path, "cell file")
    try:
        table: dict[str, Any] = tomllib.loads(data.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:  # TOMLDecodeError is a ValueError
        raise FileError(f"{path}: this is not a TOML file: {error}") from error
    return table


def _load_plugins(table: Mapping[str, Any], folder: Path) -> None:
    """Load the plugins that a cell file names; those of the other keys' names that they register exist from then on.

    Args:
        table: The file's outermost table.
        folder: The file's, where paths of plugins begin.
    """
    for given in _NAMES(table.get("plugins", []), "'plugins'"):
        name = TEXT(given, "A plugin in 'plugins'")
        plugins.load(folder / name if name.endswith(".py") else name)


def read_cell_file(path: str | Path) -> dict[str, Any]:
    """Read a cell file, and load the plugins that it names.

    Args:
        path: The TOML file; its table ``[simulation]`` is not read here.

    Returns:
        The values by the names of a cell's attributes, in SI units. Attributes with a class of
        their own are dicts of its arguments; ``priors`` has the ``source`` and the prior standard
        deviations by family.

    Raises:
        FileError: The file cannot be read or is not TOML.
        CalibError: It has an unknown key, or a value of the wrong kind.
        PluginError: A plugin cannot be loaded.
    """
    table = read_toml(path)
    table.pop("simulation", None)
    _load_plugins(table, Path(path).parent)
    values = read_table(table, fields())
    values.pop("plugins", None)
    values["cameras"] = cameras_of_tables(
        values.pop("camera", None), values.pop("cameras", {}), Path(path)
    )
    values["boards"] = boards_of_tables(
        values.pop("board", None), values.pop("boards", {}), Path(path)
    )
    values |= values.pop("frame", {})
    frame_pose = {name: values.pop(name) for name in ("xyz", "rotation") if name in values}
    if frame_pose:
        values["T_frame_base"] = pose_of(**frame_pose)
    sigma = {}
    for symbol in RESIDUAL_UNITS:
        if f"sigma_{symbol}" in values:
            sigma[symbol] = values.pop(f"sigma_{symbol}")
    values["sigma"] = sigma
    priors = {"source": values.pop("source", "data")}
    for family in FAMILIES:
        key = f"prior_{family}"
        if key in values:
            priors[family] = values.pop(key)
    values["priors"] = priors
    return values
