"""Which attribute of a value stands under which key of a JSON file: a table of fields, walked to write and to read.

A field is an attribute (or a function of the value), its key, and the `Part` that says how it is written and read. Dots
in a key name the tables around it; a key that is empty, or ends in a dot, puts the part's own keys beside the others.
"""

from __future__ import annotations

import importlib.metadata
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.estimate.selection import Candidate
from calib.estimate.setup import Setup
from calib.estimate.solvers import Iteration
from calib.estimate.statistics import CrossValidation, Errors, Repeats
from calib.model.families import FAMILIES
from calib.model.observability import Combination
from calib.model.parameters import ErrorModel, Parameter
from calib.result.prediction import Outlier, ParameterEstimate
from calib.result.support import Beyond, OutsideRow
from calib.result.verdict import Reason, Verdict, Why
from calib.robot.robot import read_only
from calib.robot.torques import Payload
from calib.version import __version__

Array = NDArray[np.float64]
Json = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Part:
    """How a value stands in a file: what reads it, None where it is written only, and what it is written as."""

    value: Callable[[Any], Any] | None = None
    table: Callable[[Any], Any] = lambda value: value


Field = tuple[str | Callable[[Any], Any], str, Part]


def table(value: object, fields: Sequence[Field]) -> dict[str, Any]:
    """A value as a table."""
    result: dict[str, Any] = {}
    for attribute, key, part in fields:
        found = attribute(value) if callable(attribute) else attrgetter(attribute)(value)
        *folders, last = key.split(".")
        place = result
        for folder in folders:
            place = place.setdefault(folder, {})
        place.update({last: part.table(found)} if last else part.table(found))
    return result


def values(table: Json, fields: Sequence[Field]) -> dict[str, Any]:
    """The attributes of a value that are read from its table, by name."""
    result = {}
    for attribute, key, part in fields:
        if part.value is not None:
            found: Any = table
            for one in filter(None, key.split(".")):
                found = found[one]
            result[str(attribute)] = part.value(found)
    return result


def record(kind: Callable[..., Any], *fields: Field) -> Part:
    """A value that is a table."""
    return Part(lambda found: kind(**values(found, fields)), lambda value: table(value, fields))


def many(part: Part) -> Part:
    """A list of such values."""
    read = part.value
    return Part(
        read and (lambda found: tuple(map(read, found))), lambda value: list(map(part.table, value))
    )


def optional(part: Part) -> Part:
    """Such a value, or none."""
    read = part.value
    return Part(
        read and (lambda found: None if found is None else read(found)),
        lambda value: None if value is None else part.table(value),
    )


def number(found: float | None) -> float:
    """A number; NaN where it is missing."""
    return float("nan") if found is None else float(found)


def numbers(found: Any) -> Array:  # noqa: ANN401  JSON values are of any kind
    """An array of numbers, of any shape, NaN where one is missing."""
    return read_only(np.array(found, dtype=np.float64))


ONLY = Part()  # written, and not read
TEXT, WHOLE, FLAG, EXACT = Part(str), Part(int), Part(bool), Part(float)
NUMBER, NUMBERS = Part(number), Part(numbers)
FLAGS = Part(lambda found: np.array(found, dtype=bool))
WORDS = many(TEXT)


def plain(part: Part, *names: str) -> tuple[Field, ...]:
    """Attributes that stand under their own names."""
    return tuple((name, name, part) for name in names)


_LENGTHS: tuple[Field, ...] = (
    ("n", "n", WHOLE),
    *((name, f"{name}_m", NUMBER) for name in ("max", "mean", "rms")),
    *((f"{name}_axis", f"{name}_xyz_m", NUMBERS) for name in ("mean", "rms", "span")),
)
_ANGLES: tuple[Field, ...] = (
    ("n_angle", "n_rad", WHOLE),
    *((f"{name}_angle", f"{name}_rad", NUMBER) for name in ("max", "mean", "rms")),
)
#: Of one set of rows: angles only where there are any.
ERRORS = Part(
    lambda found: Errors(**values(found, _LENGTHS + _ANGLES * ("n_rad" in found))),
    lambda value: table(value, _LENGTHS + _ANGLES * bool(value.n_angle)),
)
#: Errors on left-out rows: those of the flagged ones included at the top, left out below.
LEFT_OUT: tuple[Field, ...] = (
    ("method", "method", TEXT),
    ("folds", "folds", WHOLE),
    ("errors", "", ERRORS),
    ("errors_without_outliers", "without_outliers", ERRORS),
)
#: The size of each family's errors, the unit in the key.
SIZES = Part(
    lambda found: {
        name: float(found[key])
        for name, row in FAMILIES.items()
        if (key := f"{name}_{row.unit.key}") in found
    },
    lambda sizes: {f"{name}_{FAMILIES[name].unit.key}": size for name, size in sizes.items()},
)
PARAMETER = record(
    ParameterEstimate,
    *plain(TEXT, "name", "unit"),
    ("nominal", "nominal", optional(EXACT)),
    *plain(NUMBER, "value", "delta", "std", "low", "high"),
    *plain(FLAG, "identifiable", "at_bound"),
    *plain(NUMBER, "prior_std", "push"),
)
OUTLIER = record(
    Outlier, ("row", "row", WHOLE), ("residual", "residual_m", NUMBER), ("score", "score", NUMBER)
)
BEYOND = record(Beyond, *plain(TEXT, "joint"), *plain(FLAG, "prismatic"), *plain(EXACT, "by"))
OUTSIDE = record(OutsideRow, ("index", "index", WHOLE), ("beyond", "joints", many(BEYOND)))
REASON = record(
    Reason,
    ("why", "code", Part(lambda code: Why[code.upper()], lambda why: why.name.lower())),
    (str, "text", ONLY),
    (
        "values",
        "values",
        Part(
            lambda found: {one["name"]: one["value"] for one in found},
            lambda values: [{"name": name, "value": value} for name, value in values.items()],
        ),
    ),
)
VERDICT = record(Verdict, ("use", "use", TEXT), ("reasons", "reasons", many(REASON)))
PAYLOAD = record(Payload, ("mass", "mass_kg", NUMBER), ("com", "com_m", NUMBERS))
REPEATS = record(
    lambda within, freedoms, rho: Repeats(within, freedoms, float(freedoms.sum()), rho),
    ("within", "scatter", NUMBERS),
    ("freedoms", "freedom", NUMBERS),
    ("rho", "correlation", EXACT),
)
CANDIDATE = record(
    Candidate,
    ("name", "set", TEXT),
    ("parameters", "parameters", WHOLE),
    ("log_likelihood", "log_likelihood", NUMBER),
    ("sizes", "sizes", SIZES),
    (
        "cross_validation",
        "cross_validation",
        Part(
            lambda found: left_out_of(found, np.zeros(0, dtype=int), read_only(np.zeros((0, 0)))),
            lambda value: table(value, LEFT_OUT),
        ),
    ),
    ("chosen", "chosen", TEXT),
    ("needed", "needed", EXACT),
)
#: The fit with the weights of doubtful rows lowered and the one without, compared.
ROBUSTNESS: tuple[Field, ...] = (
    ("lowered", "weights_lowered", FLAG),
    *((name, f"{name}_m", ONLY) for name in ("moved_rms", "moved_max")),
    ("errors_lowered", "lowered", ERRORS),
    ("errors_full", "full", ERRORS),
    ("flagged", "flagged", FLAGS),
    ("moved", "moved_m", NUMBERS),
    *plain(NUMBERS, "change", "std"),
)
COMBINATION = record(
    Combination,
    *plain(WORDS, "names", "units"),
    ("steps", "steps", many(EXACT)),
    (str, "text", ONLY),
)
OBSERVABILITY: tuple[Field, ...] = (
    *plain(WHOLE, "rank", "columns"),
    ("condition", "condition", Part(lambda found: np.inf if found is None else float(found))),
    ("indices", "indices", Part(lambda found: {k: number(v) for k, v in found.items()})),
    ("singular_values", "singular_values", NUMBERS),
    ("unidentifiable", "unidentifiable", many(COMBINATION)),
)
STEP = record(
    Iteration, *plain(EXACT, "cost", "step"), *plain(NUMBER, "mu", "gain"), *plain(FLAG, "accepted")
)
SOLUTION: tuple[Field, ...] = (
    ("iterations", "iterations", ONLY),
    ("evaluations", "evaluations", WHOLE),
    *plain(TEXT, "status", "message"),
    ("cost", "cost", EXACT),
    ("history", "history", many(STEP)),
)
_TERM: tuple[Field, ...] = (
    *plain(TEXT, "name", "unit", "place", "family"),
    ("direction", "direction", NUMBERS),
    ("nominal", "nominal", EXACT),
    ("factor", "factor", Part(table=lambda factor: None if factor is None else factor.name)),
)
#: An error model: where each of its terms acts, and which parameters they follow; `model_of` reads it.
MODEL: tuple[Field, ...] = (
    ("name", "set", ONLY),
    ("places", "places", ONLY),
    ("terms", "terms", Part(table=lambda terms: [table(one, _TERM) for one in terms])),
    (lambda m: None if m.terms is m.parameters else m.mixing, "mixing", ONLY),
)


def left_out_of(found: Json, poses: NDArray[np.int_], residual: Array) -> CrossValidation:
    """A cross-validation from its table and what stands in the rows: their poses (N,), and residuals (N, D) [m]."""
    return CrossValidation(poses=poses, residual=residual, **values(found, LEFT_OUT))


def model_of(found: Json, names: Sequence[str]) -> ErrorModel:
    """An error model with these parameters from its table; further terms follow them."""
    factors = {f.name: f for row in FAMILIES.values() for f in row.factors}
    terms = tuple(
        Parameter(factor=one["factor"] and factors[one["factor"]], **values(one, _TERM))
        for one in found["terms"]
    )
    places = tuple(found["places"])
    if found["mixing"] is None:
        return ErrorModel(found["set"], places, terms)
    by_name = {one.name: one for one in terms}
    mixing = np.array(found["mixing"], dtype=np.float64).reshape(len(terms), len(names))
    parameters = tuple(by_name[name] for name in names)
    return ErrorModel(found["set"], places, parameters, terms, read_only(mixing))


def pose_table(T: Array, prefix: str = "") -> dict[str, Any]:
    """A pose, shape (4, 4), as position [m] and roll, pitch, yaw [rad]."""
    return {f"{prefix}xyz_m": T[:3, 3], f"{prefix}rpy_rad": pin.rpy.matrixToRpy(T[:3, :3])}


def pose_of(found: Json, prefix: str = "") -> Array:
    """The same back, shape (4, 4); a missing orientation is none."""
    T, rpy = np.eye(4), found[f"{prefix}rpy_rad"]
    if rpy is not None:
        T[:3, :3] = Rotation.from_euler("xyz", np.array(rpy, dtype=np.float64)).as_matrix()
    T[:3, 3] = np.array(found[f"{prefix}xyz_m"], dtype=np.float64)
    if not np.isfinite(T).all():
        raise ValueError("a number of a pose is missing")
    return T


def places_table(s: Setup) -> dict[str, Any]:
    """Frames and targets."""
    frames = zip(s.groups, s.T_frame_base, s.unknown, s.frame_given, s.own_axes, strict=True)
    targets = zip(s.targets, s.T_tip_target, s.target_unknown, s.target_given, strict=True)
    return {
        "set_ups": [
            {"group": group, **pose_table(T, "frame_base_")}
            | {"estimated": list(unknown), "given": bool(given), "own_axes": bool(own)}
            for group, T, unknown, given, own in frames
        ],
        "targets": [
            {"target": name, **pose_table(T), **({} if s.oriented else {"rpy_rad": None})}
            | {"estimated": bool(unknown), "given": bool(given)}
            for name, T, unknown, given in targets
        ],
    }


def places_of(found: Json, *, rotation: bool) -> Setup:
    """The same back, where orientations were measured or not; at least one frame and one target."""
    frames, targets = found["set_ups"], found["targets"]
    if not frames or not targets:
        raise ValueError("no set-ups or no targets")
    return Setup(
        groups=tuple(str(one["group"]) for one in frames),
        targets=tuple(str(one["target"]) for one in targets),
        T_frame_base=read_only([pose_of(one, "frame_base_") for one in frames]),
        T_tip_target=read_only([pose_of(one) for one in targets]),
        unknown=tuple(tuple(map(str, one["estimated"])) for one in frames),
        frame_given=np.array([one["given"] for one in frames], dtype=bool),
        target_unknown=np.array([one["estimated"] for one in targets], dtype=bool),
        target_given=np.array([one["given"] for one in targets], dtype=bool),
        rotation=rotation,
        own_axes=np.array([one["own_axes"] for one in frames], dtype=bool),
        oriented=all(one["rpy_rad"] is not None for one in targets),
    )


def versions() -> dict[str, str]:
    """What computed the result."""
    packages = {name: importlib.metadata.version(name) for name in ("pin", "numpy", "scipy")}
    return {"calib": __version__, "python": platform.python_version(), **packages}
