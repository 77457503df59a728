"""What a field of a record says of itself: its key in files, the form of its value there, its meaning, its option.

Files, options and messages are made from it, so that a new field is all that a new flag of a board needs:

    rows: int = field(metadata=key("rows", WHOLE, "Squares along y.", option=Option("--rows", type=int)))

NumPy is not needed, because the command line reads the options at its start.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import Field, dataclass, fields
from decimal import Decimal
from typing import Any

from calib.errors import CalibError, choices

#: Name of the entry in the metadata of a field.
_METADATA = "calib"


@dataclass(frozen=True, slots=True)
class Form:
    """The form of a value in a file."""

    #: What the value must be, for messages: ``"a number [mm]"``.
    words: str
    #: (what the file holds, its place) to the value in SI units. Raises `CalibError` for what it does not take.
    read: Callable[[Any, str], Any]
    #: From the value in SI units to what the file holds.
    write: Callable[[Any], Any]


@dataclass(frozen=True, slots=True)
class Option:
    """An option of the command line that gives a field."""

    #: ``"--first-marker"``.
    flag: str
    #: Stands for the value in the help: ``"LENGTH"``.
    metavar: str | None = None
    #: Type of the words; or the words that are allowed.
    type: Any = str
    #: Help; empty: that of the key.
    help: str = ""
    #: (what was typed, flag) to the value in SI units; None: it is the value.
    parse: Callable[[Any, str], Any] | None = None


@dataclass(frozen=True, slots=True)
class Key:
    """A key of a table, which gives a field."""

    #: As the file has it, with its unit: ``"square_mm"``.
    name: str
    form: Form
    #: What it means, in full sentences.
    help: str
    option: Option | None
    #: Key of the value in SI units in result files; empty: the name of the field.
    json: str


def key(
    name: str, form: Form, help: str, *, option: Option | None = None, json: str = ""
) -> Mapping[str, Key]:
    """Return the metadata of a field.

    Args:
        name: The key, with its unit: ``"square_mm"``.
        form: The form of its value.
        help: What it means, in full sentences; for comments in files.
        option: The option that gives the field too.
        json: Key of the value in SI units in result files; empty: the name of the field.
    """
    return {_METADATA: Key(name, form, help, option, json)}


def keys_of(record: Any) -> Iterator[tuple[Field[Any], Key]]:  # noqa: ANN401  a dataclass or its class
    """Yield the fields of a record in their order, each with its key."""
    for field in fields(record):
        yield field, field.metadata[_METADATA]


def json_key(field: Field[Any]) -> str:
    """Return the key of a field in result files: as its record says, or else its name."""
    key: Key = field.metadata[_METADATA]
    return key.json or field.name


def form(words: str, convert: Callable[[Any], Any], write: Callable[[Any], Any]) -> Form:
    """Return the form of values that ``convert`` gives, or refuses by None, a TypeError or a ValueError."""

    def read(value: Any, place: str) -> Any:  # noqa: ANN401  what TOML holds
        try:
            converted = convert(value)
        except (TypeError, ValueError):
            converted = None
        if converted is None:
            raise CalibError(f"{place} is {value!r}; it must be {words}.")
        return converted

    return Form(words, read, write)


def text(meaning: str) -> Form:
    """Return the form of a text, such as ``"the name of a link"``."""
    return form(
        f"{meaning} in quotes", lambda value: value if isinstance(value, str) else None, str
    )


def one_of(values: Mapping[str, Any]) -> Form:
    """Return the form of one of several words, each of which stands for a value."""
    names = {value: name for name, value in values.items()}
    return form(f"one of {choices(values)}", values.get, names.__getitem__)


def _is_whole(value: object) -> bool:
    """Return whether a value is a whole number."""
    return isinstance(value, int) and not isinstance(value, bool)


WHOLE = form("a whole number", lambda value: value if _is_whole(value) else None, int)


def shift_decimal(value: float, places: int) -> float:
    """Multiply a decimal number by a power of ten without changing its digits: 29.85 mm is 0.02985 m.

    Args:
        value: The number; its digits are those of its shortest representation.
        places: The power of ten, such as -3 for mm in metres.

    Returns:
        The double nearest to the decimal product.
    """
    return float(Decimal(repr(float(value))).scaleb(places))


def decimal(unit: str, places: int) -> Form:
    """Return the form of a number in a unit that is this power of ten of SI; it keeps its digits."""

    def convert(value: Any) -> float | None:  # noqa: ANN401
        is_number = _is_whole(value) or isinstance(value, float)
        return shift_decimal(value, places) if is_number and math.isfinite(value) else None

    return form(f"a number [{unit}]", convert, lambda value: shift_decimal(value, -places))


MM = decimal("mm", -3)
PERCENT = decimal("%", -2)
