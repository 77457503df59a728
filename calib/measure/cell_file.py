"""The cell file: TOML with units in its keys or beside its numbers, into the values of a `calib.measure.cell.Cell`."""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from calib.errors import CalibError, FileError
from calib.families import FAMILIES
from calib.measure.cell_parts import GroupDistance, Priors, is_number
from calib.measure.forms import (
    DEGREES,
    NAMES,
    ROLL_PITCH_YAW,
    TEXT,
    Field,
    Form,
    form,
    is_names,
    named,
    number,
    one_of,
    pose,
    read_fields,
    table,
    tables,
    three,
)
from calib.measure.noise import TrackerNoise, parse_noise
from calib.measure.quantities import (
    ANGLE,
    COMPLIANCE,
    LENGTH,
    NUMBER,
    parse_joint_range,
    parse_joint_value,
    parse_quantity,
)
from calib.measure.surroundings import Box, Reflector, Tracker
from calib.model.files import read_bytes
from calib.model.torques import Payload

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

_EXAMPLES = {LENGTH: '"0.5 mm"', ANGLE: '"1 mrad"', NUMBER: "1e-3", COMPLIANCE: '"1e-5 rad/Nm"'}

#: How parameters are named, and what they are; see docs/parameters.md. The first that fits is taken.
_PARAMETERS: tuple[tuple[str, tuple[str, ...]], ...] = (
    (r"[ad]\d+|(frame|target)_[xyz](\[.*\])?|.*\.[xyz]", (LENGTH,)),
    (r"(alpha|beta|theta)\d+|(frame|target)_r[xyz](\[.*\])?|.*\.r[xyz]", (ANGLE,)),
    (r".*\.zero", (LENGTH, ANGLE)),
)


def _change(value: Any, where: str) -> float:  # noqa: ANN401  TOML values are of any kind
    """The change of a parameter in SI units; its name, which ``where`` begins with, tells what it can be."""
    name = where[1 : where.rindex("' in [")]
    allowed = next((kinds for pattern, kinds in _PARAMETERS if re.fullmatch(pattern, name)), ())
    suffix = name.rpartition(".")[2]
    allowed = allowed or tuple(
        {
            unit.quantity: None
            for row in FAMILIES.values()
            for unit in (row.unit, row.sliding)
            if unit is not None and suffix in [factor.name for factor in row.factors]
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


def _is_tie(value: object) -> bool:
    """Whether a value says which parameter another one follows."""
    if isinstance(value, str):
        return True
    pair = value if isinstance(value, list) and len(value) == 2 else (None, None)
    return isinstance(pair[0], str) and is_number(pair[1])


_TIE = form(
    'another parameter\'s name, or that and a factor, ["a2", -1]',
    _is_tie,
    lambda value: (value, 1.0) if isinstance(value, str) else (value[0], float(value[1])),
)

_FRAME = form(
    '\'known\', \'estimate\' or a list of directions such as ["x", "y", "rz"]',
    lambda value: value in ("known", "estimate") or is_names(value),
)


def _payload(mass: float, com: Any = (0.0, 0.0, 0.0)) -> Payload:  # noqa: ANN401
    """What the tip carries."""
    return Payload(mass=float(mass), com=com)


def _noise(value: Any, where: str) -> TrackerNoise:  # noqa: ANN401
    """The noise of a tracker, with the usual repeatability of a robot."""
    return parse_noise(_NOISE.read(value, where), where, TrackerNoise().repeatability)


_NOISE = form('a text such as "15 um + 6 um/m"', lambda value: isinstance(value, str))


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


def _box(name: str, size: Any, xyz: Any, rotation: Any = None) -> Box:  # noqa: ANN401
    """A box that the robot must not touch."""
    return Box(name, size, pose(xyz, rotation))


_POSE = {"xyz_mm": Field("xyz", three(1e3)), "rpy_deg": Field("rotation", ROLL_PITCH_YAW)}
_MM, _POINT = number(1e3), three(1e3)


def _named_frame(value: Any, where: str) -> Any:  # noqa: ANN401
    """The pose of the base in the frame of a group, a table ``[frames.name]``."""
    name = where[1 : where.rindex("' in [")]
    if not isinstance(value, dict):
        raise CalibError(
            f"{where} is {value!r}; write a table [frames.{name}] with xyz_mm and rpy_deg."
        )
    return pose(**read_fields(value, _POSE, f"[frames.{name}]"))


#: The keys of a cell file: the attribute of a cell that each gives, what its value must be, and how it is read.
FIELDS: dict[str, Field] = {
    "base": Field("base", TEXT),
    "tip": Field("tip", TEXT),
    "model": Field("model", TEXT),
    "kind": Field("kind", TEXT),
    "repeats": Field("repeats", one_of("weighted", "average", "independent")),
    "freeze": Field("frozen", NAMES),
    "target": Field("estimate_target", one_of("known", "estimate")),
    "target_mm": Field("target", _POINT),
    "target_rpy_deg": Field("target_rotation", ROLL_PITCH_YAW),
    "frame": Field("frame", _FRAME),
    "frame_xyz_mm": Field("xyz", _POINT),
    "frame_rpy_deg": Field("rotation", ROLL_PITCH_YAW),
    "sigma_mm": Field("sigma", _MM),
    "sigma_angle_deg": Field("sigma_angle", DEGREES),
    "priors": Field("sizes", one_of("data", "given", "off")),
    "gravity_m_per_s2": Field("gravity", three()),
    "targets_mm": Field("targets", named(_POINT.read, "targets_mm")),
    "frames": Field("frames", named(_named_frame, "frames")),
    "ties": Field("ties", named(_TIE.read, "ties")),
    "bounds": Field("bounds", named(_bounds, "bounds")),
    "parameter_priors": Field("parameter_priors", named(_change, "parameter_priors")),
    "payload": Field(
        "payload",
        table(
            "payload",
            {"mass_kg": Field("mass", number(), needed=True), "com_mm": Field("com", _POINT)},
            _payload,
        ),
    ),
    "held": Field("held", named(parse_joint_value, "held")),
    "distances": Field(
        "distances",
        tables(
            "distances",
            {
                "first": Field("first", TEXT, needed=True),
                "second": Field("second", TEXT, needed=True),
                "length_mm": Field("length", _MM, needed=True),
                "sigma_mm": Field("sigma", _MM, needed=True),
            },
            GroupDistance,
        ),
    ),
    "tracker": Field(
        "tracker",
        table(
            "tracker",
            {
                "xyz_mm": Field("position", _POINT, needed=True),
                "nearest_mm": Field("nearest", _MM),
                "farthest_mm": Field("farthest", _MM),
                "noise": Field("noise", Form(_NOISE.words, _noise)),
                "repeatability_mm": Field("repeatability", _MM),
            },
            _tracker,
        ),
    ),
    "reflector": Field(
        "reflector",
        table(
            "reflector",
            {
                "normal": Field("normal", three(), needed=True),
                "acceptance_deg": Field("acceptance", DEGREES),
            },
            Reflector,
        ),
    ),
    "boxes": Field(
        "boxes",
        tables(
            "boxes",
            {
                "name": Field("name", TEXT, needed=True),
                "size_mm": Field("size", _POINT, needed=True),
                "xyz_mm": Field("xyz", _POINT, needed=True),
                "rpy_deg": Field("rotation", ROLL_PITCH_YAW),
            },
            _box,
        ),
    ),
    "ranges": Field("ranges", named(parse_joint_range, "ranges")),
}

#: The keys whose tables have names that the user chose.
_NAMED = ("targets_mm", "frames", "ties", "bounds", "parameter_priors", "held", "ranges")


def fields() -> dict[str, Field]:
    """Every key of a cell file: `FIELDS`, and the size of the prior of each family, such as ``prior_length_mm``."""
    priors = {}
    for name, row in FAMILIES.items():
        suffix, to_si = row.unit.cell
        priors[f"prior_{name}{suffix}"] = Field(f"prior_{name}", number(1.0 / to_si))
    return FIELDS | priors


def read_cell_file(path: str | Path) -> dict[str, Any]:
    """The values that a cell file gives, by the names of a cell's attributes, in SI units.

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
    for key in _NAMED:
        # TOML's own trap: what stands below a [table] belongs to it.
        strayed = (
            [name for name in given[key] if name in allowed]
            if isinstance(given.get(key), dict)
            else []
        )
        if strayed:
            raise CalibError(
                f"'{strayed[0]}' stands in the table [{key}]; the cell's own keys must stand above the first line in "
                "brackets."
            )
    values = read_fields(given, allowed)
    frame = values.pop("frame", "known")
    values["estimate_target"] = values.get("estimate_target", "estimate") == "estimate"
    values["estimate_frame"] = frame != "known"
    if isinstance(frame, list):
        values["frame_directions"] = tuple(frame)
    placed = {name: values.pop(name) for name in ("xyz", "rotation") if name in values}
    if placed:
        values["T_frame_base"] = pose(**placed)
    sizes = {name: values.pop(f"prior_{name}") for name in FAMILIES if f"prior_{name}" in values}
    values["priors"] = Priors(values.pop("sizes", "data"), **sizes)
    return values
