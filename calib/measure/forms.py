"""Forms: what a value of a TOML file must be, and how it is read into SI units; a table is read by its fields."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.errors import CalibError, choices, did_you_mean
from calib.measure.cell_parts import is_number

#: What the value of a key must be, as messages say it.
NUMBER, THREE, NAME = "a number", "three numbers", "a name in quotes"


@dataclass(frozen=True, slots=True)
class Form:
    """What a value must be, in words, and what reads it: from the value and where it stands, in SI units.

    What reads it raises a `CalibError` for anything else.
    """

    words: str
    read: Callable[[Any, str], Any]


@dataclass(frozen=True, slots=True)
class Field:
    """A key of a table: the attribute that it gives, what its value must be, and whether it must be there."""

    name: str
    form: Form
    needed: bool = False


def form(
    words: str, fits: Callable[[Any], bool], convert: Callable[[Any], Any] = lambda value: value
) -> Form:
    """A form of values that a test tells."""

    def read(value: Any, where: str) -> Any:  # noqa: ANN401  TOML values are of any kind
        if not fits(value):
            raise CalibError(f"{where} is {value!r}; it must be {words}.")
        return convert(value)

    return Form(words, read)


def _is_three(value: object) -> bool:
    """Whether a value is a list of three finite numbers."""
    return isinstance(value, list) and len(value) == 3 and all(is_number(v) for v in value)


def is_names(value: object) -> bool:
    """Whether a value is a list of texts."""
    return isinstance(value, list) and all(isinstance(v, str) for v in value)


def number(per_si: float = 1.0) -> Form:
    """A number, so many of whose unit are one in SI."""
    return form(NUMBER, is_number, lambda value: value / per_si)


def three(per_si: float = 1.0) -> Form:
    """Three numbers, shape (3,), so many of whose unit are one in SI."""
    return form(THREE, _is_three, lambda value: np.asarray(value, dtype=np.float64) / per_si)


def one_of(*words: str) -> Form:
    """One of some words in quotes."""
    listed = [f"'{word}'" for word in words]
    return form(f"{', '.join(listed[:-1])} or {listed[-1]}", words.__contains__)


TEXT = form(NAME, lambda value: isinstance(value, str))
NAMES = form("a list of names", is_names, tuple)
DEGREES = form(NUMBER, is_number, lambda value: float(np.radians(value)))
#: Roll, pitch, yaw about fixed axes [deg], as a matrix, shape (3, 3).
ROLL_PITCH_YAW = form(
    THREE,
    _is_three,
    lambda rpy: np.asarray(Rotation.from_euler("xyz", np.radians(rpy)).as_matrix()),
)
_TABLE = form("a table", lambda value: isinstance(value, dict))


def named(read: Callable[[Any, str], Any], where: str) -> Form:
    """A table whose keys are names that the user chose, each with a value that ``read`` reads."""

    def values(value: Any, place: str) -> dict[str, Any]:  # noqa: ANN401
        table = _TABLE.read(value, place)
        return {name: read(one, f"'{name}' in [{where}]") for name, one in table.items()}

    return Form(_TABLE.words, values)


def table(header: str, fields: Mapping[str, Field], build: Callable[..., Any]) -> Form:
    """A table with keys of its own, whose values build something."""

    def read(value: Any, where: str) -> Any:  # noqa: ANN401
        return build(**read_fields(_TABLE.read(value, where), fields, f"[{header}]"))

    return Form(_TABLE.words, read)


def tables(header: str, fields: Mapping[str, Field], build: Callable[..., Any]) -> Form:
    """A list of such tables."""
    whole = form(
        f"a list of tables, each headed [[{header}]]",
        lambda value: isinstance(value, list) and all(isinstance(v, dict) for v in value),
    )

    def read(value: Any, where: str) -> tuple[Any, ...]:  # noqa: ANN401
        return tuple(
            build(**read_fields(one, fields, f"[[{header}]] number {k}"))
            for k, one in enumerate(whole.read(value, where), 1)
        )

    return Form(whole.words, read)


def read_fields(
    values: Mapping[str, Any], fields: Mapping[str, Field], where: str = ""
) -> dict[str, Any]:
    """The values of a table, by the names of their fields.

    Args:
        values: As TOML has them.
        fields: The keys that there may be.
        where: The table's header; "" for the file itself.

    Raises:
        CalibError: An unknown key, a value that is not of its form, or one that is missing.
    """
    found = {}
    for key, value in values.items():
        if key not in fields:
            own = f"{where} has an" if where else "there is an"
            raise CalibError(
                f"{own} unknown key '{key}'{did_you_mean(key, fields)}. It may have {choices(fields, limit=40)}."
            )
        place = f"'{key}' in {where}" if where else f"'{key}'"
        found[fields[key].name] = fields[key].form.read(value, place)
    missing = [key for key, field in fields.items() if field.needed and key not in values]
    if missing:
        raise CalibError(f"{where} lacks {choices(missing)}.")
    return found


def pose(
    xyz: NDArray[np.float64] | None = None, rotation: NDArray[np.float64] | None = None
) -> NDArray[np.float64]:
    """A pose, shape (4, 4), of a place and a rotation; what is left out is zero."""
    T = np.eye(4)
    if rotation is not None:
        T[:3, :3] = rotation
    if xyz is not None:
        T[:3, 3] = xyz
    return T
