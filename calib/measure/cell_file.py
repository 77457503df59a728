"""The cell file: TOML with units in its keys or beside its numbers, into the values of a `calib.measure.cell.Cell`."""

from __future__ import annotations

import difflib
import re
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.errors import CalibError, FileError, choices
from calib.families import FAMILIES, Unit
from calib.measure import surroundings_file
from calib.measure.cell_parts import GroupDistance, Priors, is_number
from calib.measure.cell_values import (
    NAME,
    POSITIVE,
    TABLE,
    TABLES,
    THREE,
    fits,
    metres,
    pose,
    rotation,
)
from calib.measure.quantities import (
    ANGLE,
    COMPLIANCE,
    LENGTH,
    NUMBER,
    parse_joint_value,
    parse_quantity,
)
from calib.model.files import read_bytes
from calib.model.torques import Payload

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

# Dots in a line; the time that keys with dots take grows with the square of their number.
_MOST_DOTS = 1000

#: The keys of a cell file, each with what its value must be.
KEYS: dict[str, str] = {
    "base": NAME,
    "tip": NAME,
    "model": NAME,
    "kind": NAME,
    "repeats": "'weighted', 'average' or 'independent'",
    "freeze": "a list of names",
    "target": "'known' or 'estimate'",
    "target_mm": THREE,
    "target_rpy_deg": THREE,
    "frame": '\'known\', \'estimate\' or a list of directions such as ["x", "y", "rz"]',
    "frame_xyz_mm": THREE,
    "frame_rpy_deg": THREE,
    "sigma_mm": POSITIVE,
    "sigma_angle_deg": POSITIVE,
    "priors": "'data', 'given' or 'off'",
    "gravity_m_per_s2": THREE,
    "targets_mm": TABLE,
    "frames": TABLE,
    "ties": TABLE,
    "bounds": TABLE,
    "parameter_priors": TABLE,
    "payload": TABLE,
    "held": TABLE,
    "distances": f"{TABLES}[[distances]]",
    "tracker": TABLE,
    "reflector": TABLE,
    "boxes": f"{TABLES}[[boxes]]",
    "ranges": TABLE,
}

#: The keys of the tables whose keys are not names that the user chose; those marked with True must be there.
_INNER: dict[str, dict[str, tuple[str, bool]]] = {
    "frames": {"xyz_mm": (THREE, False), "rpy_deg": (THREE, False)},
    "payload": {"mass_kg": ("a number", True), "com_mm": (THREE, False)},
    "distances": {
        "first": (NAME, True),
        "second": (NAME, True),
        "length_mm": (POSITIVE, True),
        "sigma_mm": (POSITIVE, True),
    },
    **surroundings_file.INNER,
}

#: The tables with keys of their own, and lists of such tables.
_SINGLE, _LISTED = ("payload", "tracker", "reflector"), ("distances", "boxes")

_EXAMPLES = {LENGTH: '"0.5 mm"', ANGLE: '"1 mrad"', NUMBER: "1e-3", COMPLIANCE: '"1e-5 rad/Nm"'}

#: How parameters are named, and what they are; see docs/parameters.md. The first that fits is taken.
_PARAMETERS: tuple[tuple[str, tuple[str, ...]], ...] = (
    (r"[ad]\d+|(frame|target)_[xyz](\[.*\])?|.*\.[xyz]", (LENGTH,)),
    (r"(alpha|beta|theta)\d+|(frame|target)_r[xyz](\[.*\])?|.*\.r[xyz]", (ANGLE,)),
    (r".*\.zero", (LENGTH, ANGLE)),
)


def keys() -> dict[str, str]:
    """Every key of a cell file and what its value must be: `KEYS`, and the size of the prior of each family."""
    return KEYS | dict.fromkeys(_prior_keys(), POSITIVE)


def _prior_keys() -> dict[str, tuple[str, float]]:
    """The keys of the sizes of priors, such as ``prior_length_mm``: the family, and one of the key's unit in SI."""
    return {
        f"prior_{name}{row.unit.cell[0]}": (name, row.unit.cell[1])
        for name, row in FAMILIES.items()
    }


def _units_of_joint_error(suffix: str) -> list[Unit]:
    """The units that ``<joint>.<suffix>`` may have, at a joint that turns and one that slides; none if no family's."""
    return [
        unit
        for row in FAMILIES.values()
        for unit in (row.unit, row.sliding)
        if unit is not None and suffix in [factor.name for factor in row.factors]
    ]


def read_cell_file(path: str | Path) -> dict[str, Any]:
    """The values that a cell file gives, by the names of a cell's attributes, in SI units.

    Raises:
        FileError: The file cannot be read or is not TOML.
        CalibError: It has an unknown key, or a value of the wrong kind.
    """
    data = read_bytes(Path(path), "cell file")
    try:
        text = data.decode("utf-8-sig")
        _check_lines(text)
        table = tomllib.loads(text)
        _check_whole_numbers(table)
    except (
        ValueError,
        RecursionError,
    ) as error:  # TOMLDecodeError is one, and numbers of too many digits
        message = f"{path}: this is not a TOML file: {error}"
        raise FileError(message) from error
    try:
        _check_keys(table)
        return _values(table)
    except CalibError as error:
        message = f"{path}: {error}"
        raise CalibError(message) from error


def _check_lines(text: str) -> None:
    """Refuse lines with so many dots that the parser would take minutes for them.

    Raises:
        ValueError: There is one.
    """
    for number, line in enumerate(text.split("\n"), 1):
        if line.count(".") > _MOST_DOTS:
            message = f"line {number} has {line.count('.'):,} dots; at most {_MOST_DOTS} are read"
            raise ValueError(message)


def _check_whole_numbers(value: object) -> None:
    """Refuse whole numbers larger than TOML allows, anywhere.

    Raises:
        ValueError: There is one.
    """
    if isinstance(value, (dict, list)):
        for one in value.values() if isinstance(value, dict) else value:
            _check_whole_numbers(one)
    elif isinstance(value, int) and not -(2**63) <= value < 2**63:
        message = "a whole number is beyond 64 bits"
        raise ValueError(message)


def _check_keys(table: Mapping[str, Any]) -> None:
    """Refuse unknown keys and values of the wrong kind."""
    allowed = keys()
    for key, value in table.items():
        if key not in allowed:
            message = f"unknown key '{key}'.{_close(key, allowed)} A cell file may have {choices(allowed, limit=40)}."
            raise CalibError(message)
        if not fits(value, allowed[key]):
            message = f"'{key}' is {value!r}; it must be {allowed[key]}."
            raise CalibError(message)
        if allowed[key] == TABLE and key not in _SINGLE:
            # TOML's own trap: what stands below a [table] belongs to it.
            strayed = [name for name in value if name in allowed]
            if strayed:
                message = (
                    f"'{strayed[0]}' stands in the table [{key}]; the cell's own keys must stand above the first line "
                    "in brackets."
                )
                raise CalibError(message)
    _check_tables(table)


def _check_tables(table: Mapping[str, Any]) -> None:
    """The same for the tables in the file that have keys of their own."""
    for key in _SINGLE:
        _check_inner(f"[{key}]", table.get(key), key)
    for group, frame in table.get("frames", {}).items():
        if not isinstance(frame, dict):
            message = f"'{group}' in [frames] is {frame!r}; write a table [frames.{group}] with xyz_mm and rpy_deg."
            raise CalibError(message)
        _check_inner(f"[frames.{group}]", frame, "frames")
    for key in _LISTED:
        for k, one in enumerate(table.get(key, [])):
            _check_inner(f"[[{key}]] number {k + 1}", one, key)


def _check_inner(where: str, table: Mapping[str, Any] | None, kind: str) -> None:
    """The same for one table inside the file."""
    if table is None:
        return
    allowed = _INNER[kind]
    for key, value in table.items():
        if key not in allowed:
            above = (
                " The cell's own keys must stand above the first line in brackets."
                if key in keys()
                else _close(key, allowed)
            )
            message = f"{where} has an unknown key '{key}'.{above} It may have {choices(allowed)}."
            raise CalibError(message)
        if not fits(value, allowed[key][0]):
            message = f"'{key}' in {where} is {value!r}; it must be {allowed[key][0]}."
            raise CalibError(message)
    missing = [key for key, (_, needed) in allowed.items() if needed and key not in table]
    if missing:
        message = f"{where} lacks {choices(missing)}."
        raise CalibError(message)


def _close(key: str, allowed: Mapping[str, Any]) -> str:
    """The allowed key that is spelt most like an unknown one, as a question."""
    close = difflib.get_close_matches(key, allowed, n=1)
    return f" Did you mean '{close[0]}'?" if close else ""


def _values(table: Mapping[str, Any]) -> dict[str, Any]:
    """The cell's values that a checked table gives; what it leaves out is left out here."""
    frame = table.get("frame", "known")
    values: dict[str, Any] = {
        "estimate_target": table.get("target", "estimate") == "estimate",
        "estimate_frame": frame != "known",
        "priors": _priors(table),
    }
    if isinstance(frame, list):
        values["frame_directions"] = tuple(frame)
    if "frame_xyz_mm" in table or "frame_rpy_deg" in table:
        values["T_frame_base"] = pose(table.get("frame_xyz_mm"), table.get("frame_rpy_deg"))
    for key in ("base", "tip", "model", "kind", "repeats"):
        if key in table:
            values[key] = table[key]
    convert: dict[str, tuple[str, Callable[[Any], Any]]] = {
        "freeze": ("frozen", tuple),
        "target_mm": ("target", metres),
        "target_rpy_deg": ("target_rotation", rotation),
        "sigma_mm": ("sigma", lambda v: v / 1e3),
        "sigma_angle_deg": ("sigma_angle", lambda v: float(np.radians(v))),
        "gravity_m_per_s2": ("gravity", np.asarray),
        "targets_mm": ("targets", _targets),
        "frames": ("frames", _frames),
        "ties": ("ties", _ties),
        "bounds": ("bounds", _bounds),
        "parameter_priors": ("parameter_priors", _parameter_priors),
        "held": ("held", _held),
        "payload": ("payload", _payload),
        "distances": ("distances", _distances),
        "tracker": ("tracker", surroundings_file.read_tracker),
        "reflector": ("reflector", surroundings_file.read_reflector),
        "boxes": ("boxes", surroundings_file.read_boxes),
        "ranges": ("ranges", surroundings_file.read_ranges),
    }
    for key, (name, function) in convert.items():
        if key in table:
            values[name] = function(table[key])
    return values


def _priors(table: Mapping[str, Any]) -> Priors:
    """The sizes of priors."""
    sizes = {f: table[key] * unit for key, (f, unit) in _prior_keys().items() if key in table}
    return Priors(sizes=table.get("priors", "data"), **sizes)


def _targets(table: Mapping[str, Any]) -> dict[str, NDArray[np.float64]]:
    """Positions of targets by name, shape (3,) each [m]."""
    for name, value in table.items():
        if not fits(value, THREE):
            message = f"the target '{name}' in [targets_mm] is {value!r}; it must be {THREE} [mm]."
            raise CalibError(message)
    return {name: metres(value) for name, value in table.items()}


def _frames(table: Mapping[str, Any]) -> dict[str, NDArray[np.float64]]:
    """Poses of the base by group, shape (4, 4) each [m]."""
    return {name: pose(value.get("xyz_mm"), value.get("rpy_deg")) for name, value in table.items()}


def _ties(table: Mapping[str, Any]) -> dict[str, tuple[str, float]]:
    """Parameters that follow others; a name alone has the factor 1."""
    result = {}
    for name, value in table.items():
        pair = (value, 1.0) if isinstance(value, str) else value
        if not (
            isinstance(pair, (list, tuple))
            and len(pair) == 2
            and isinstance(pair[0], str)
            and is_number(pair[1])
        ):
            message = (
                f"the tie of '{name}' in [ties] is {value!r}; it must be another parameter's name, or that and a "
                'factor, ["a2", -1].'
            )
            raise CalibError(message)
        result[name] = (pair[0], float(pair[1]))
    return result


def _change(name: str, value: object, where: str) -> float:
    """The change of a parameter in SI units; its name tells what it can be."""
    allowed = next((kinds for pattern, kinds in _PARAMETERS if re.fullmatch(pattern, name)), ())
    allowed = allowed or tuple(
        {unit.quantity: None for unit in _units_of_joint_error(name.rpartition(".")[2])}
    )
    examples = " or ".join(_EXAMPLES[kind] for kind in (allowed or _EXAMPLES))
    try:
        number, kind = parse_quantity(value)
    except CalibError as error:
        message = f"'{name}' in {where}: {error}. Write {examples}."
        raise CalibError(message) from error
    if kind not in (allowed or _EXAMPLES):
        message = f"'{name}' in {where} is {value!r}, which is {kind}; write {examples}."
        raise CalibError(message)
    return number


def _bounds(table: Mapping[str, Any]) -> dict[str, tuple[float, float]]:
    """The least and the largest change of parameters; one value is both ways."""
    result = {}
    for name, value in table.items():
        if isinstance(value, list):
            if len(value) != 2:
                message = f"'{name}' in [bounds] is {value!r}; it must be one value, or the least and the largest."
                raise CalibError(message)
            low, high = (_change(name, one, "[bounds]") for one in value)
        else:
            high = _change(name, value, "[bounds]")
            low = -high
        result[name] = (low, high)
    return result


def _parameter_priors(table: Mapping[str, Any]) -> dict[str, float]:
    """Standard deviations of single parameters."""
    return {name: _change(name, value, "[parameter_priors]") for name, value in table.items()}


def _held(table: Mapping[str, Any]) -> dict[str, float]:
    """Values of held joints [rad] or [m]."""
    return {name: parse_joint_value(value, f"'{name}' in [held]") for name, value in table.items()}


def _payload(table: Mapping[str, Any]) -> Payload:
    """What the tip carries."""
    return Payload(mass=float(table["mass_kg"]), com=metres(table.get("com_mm", [0, 0, 0])))


def _distances(tables: list[Mapping[str, Any]]) -> tuple[GroupDistance, ...]:
    """Known distances between groups."""
    return tuple(
        GroupDistance(t["first"], t["second"], t["length_mm"] / 1e3, t["sigma_mm"] / 1e3)
        for t in tables
    )
