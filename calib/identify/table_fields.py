"""Which attribute of a value stands under which key of a table, and how it is read back."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from calib.model.robot import read_only

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Json = Mapping[str, Any]
T = TypeVar("T")


def number(value: Any) -> float:  # noqa: ANN401  JSON values are of any kind
    """A number; NaN where it is missing."""
    return float("nan") if value is None else float(value)


def numbers(values: Any) -> Array:  # noqa: ANN401
    """An array of numbers, NaN where one is missing."""
    return read_only(np.array(values, dtype=np.float64))


def flags(values: Any) -> Mask:  # noqa: ANN401
    """An array of true and false."""
    return np.array(values, dtype=bool)


def words(values: Sequence[Any]) -> tuple[str, ...]:
    """A list of texts."""
    return tuple(map(str, values))


#: Attribute, key and what reads it, of the values whose fields stand in a table of their own.
Field = tuple[str, str, Callable[[Any], Any]]
ERRORS: tuple[Field, ...] = (
    ("n", "n", int),
    ("max", "max_m", number),
    ("mean", "mean_m", number),
    ("rms", "rms_m", number),
    ("mean_axis", "mean_xyz_m", numbers),
    ("rms_axis", "rms_xyz_m", numbers),
    ("span_axis", "span_xyz_m", numbers),
)
ANGLES: tuple[Field, ...] = (
    ("n_angle", "n_rad", int),
    ("max_angle", "max_rad", number),
    ("mean_angle", "mean_rad", number),
    ("rms_angle", "rms_rad", number),
)
PARAMETER: tuple[Field, ...] = (
    ("name", "name", str),
    ("unit", "unit", str),
    ("nominal", "nominal", lambda value: None if value is None else float(value)),
    ("value", "value", number),
    ("delta", "delta", number),
    ("std", "std", number),
    ("low", "low", number),
    ("high", "high", number),
    ("identifiable", "identifiable", bool),
    ("at_bound", "at_bound", bool),
    ("prior_std", "prior_std", number),
    ("push", "push", number),
)
OUTLIER: tuple[Field, ...] = (
    ("row", "row", int),
    ("residual", "residual_m", number),
    ("score", "score", number),
)
STEP: tuple[Field, ...] = (
    ("cost", "cost", float),
    ("mu", "mu", number),
    ("gain", "gain", number),
    ("step", "step", float),
    ("accepted", "accepted", bool),
)
BEYOND: tuple[Field, ...] = (
    ("joint", "joint", str),
    ("prismatic", "prismatic", bool),
    ("by", "by", float),
)
COMBINATION: tuple[Field, ...] = (
    ("names", "names", words),
    ("steps", "steps", lambda values: tuple(map(float, values))),
    ("units", "units", words),
)


TERM: tuple[Field, ...] = (
    ("name", "name", str),
    ("unit", "unit", str),
    ("place", "place", str),
    ("direction", "direction", numbers),
    ("family", "family", str),
    ("nominal", "nominal", float),
)


def to_table(value: object, fields: tuple[Field, ...]) -> dict[str, Any]:
    """A value as a table."""
    return {key: getattr(value, attribute) for attribute, key, _ in fields}


def from_table(kind: Callable[..., T], table: Json, fields: tuple[Field, ...]) -> T:
    """A value from its table."""
    return kind(**{attribute: read(table[key]) for attribute, key, read in fields})
