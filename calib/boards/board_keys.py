"""What a field of a record says of itself: its key in files, the form of its value there, its meaning, its option.

Files, options and messages are made from it, so that a new field is all that a new flag of a board needs:

    rows: int = field(metadata=key("rows", WHOLE, "Squares along y.", option=Option("--rows", "Squares down.", int)))

NumPy is not needed, because the command line reads the options at its start.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import Field, dataclass, fields
from decimal import Decimal
from typing import Any

from calib.errors import choices

#: Name of the entry in the metadata of a field.
_METADATA = "calib"


@dataclass(frozen=True, slots=True)
class Form:
    """The form of a value in a file."""

    #: What the value must be, for messages: ``"a number [mm]"``.
    words: str
    #: From what the file holds to the value in SI units; ValueError or TypeError for what it does not take.
    read: Callable[[Any], Any]
    #: From the value in SI units to what the file holds.
    write: Callable[[Any], Any]


@dataclass(frozen=True, slots=True)
class Option:
    """An option of the command line that gives a field."""

    #: ``"--first-marker"``.
    flag: str
    help: str
    #: Type of the words; or the words that are allowed.
    type: Any = str
    #: Stands for the value in the help: ``"LENGTH"``.
    metavar: str | None = None
    #: Least whole number that is allowed.
    least: int | None = None
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
    #: Key of the value in SI units in result files.
    json: str


def key(
    name: str, form: Form, help: str, *, json: str = "", option: Option | None = None
) -> Mapping[str, Key]:
    """Return the metadata of a field.

    Args:
        name: The key, with its unit: ``"square_mm"``.
        form: The form of its value.
        help: What it means, in full sentences; for comments in files.
        json: Key of the value in SI units in result files; empty: the name.
        option: The option that gives the field too.
    """
    return {_METADATA: Key(name, form, help, option, json or name)}


def keys_of(record: Any) -> Iterator[tuple[Field[Any], Key]]:  # noqa: ANN401  a dataclass or its class
    """Yield the fields of a record in their order, each with its key."""
    for field in fields(record):
        yield field, field.metadata[_METADATA]


def _text(value: Any) -> str:  # noqa: ANN401
    """Return a text; TypeError for anything else."""
    if not isinstance(value, str):
        raise TypeError
    return value


def _whole(value: Any) -> int:  # noqa: ANN401
    """Return a whole number; TypeError for anything else."""
    if isinstance(value, bool) or not isinstance(value, int):
        raise TypeError
    return value


def shift_decimal(value: float, places: int) -> float:
    """Multiply a decimal number by a power of ten without changing its digits: 29.85 mm is 0.02985 m.

    Args:
        value: The number; its digits are those of its shortest representation.
        places: The power of ten, such as -3 for mm in metres.

    Returns:
        The double nearest to the decimal product.
    """
    return float(Decimal(repr(float(value))).scaleb(places))


def _decimal(unit: str, places: int) -> Form:
    """Return the form of a number in a unit that is this power of ten of SI; it keeps its digits."""

    def read(value: Any) -> float:  # noqa: ANN401  what TOML holds
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise TypeError
        if not math.isfinite(value):
            raise ValueError
        return shift_decimal(value, places)

    return Form(f"a number [{unit}]", read, lambda value: shift_decimal(value, -places))


def text(words: str) -> Form:
    """Return the form of a text, such as ``"a text in quotes"``."""
    return Form(words, _text, _text)


def one_of(values: Mapping[str, Any]) -> Form:
    """Return the form of one of several words, each of which stands for a value."""
    names = {value: name for name, value in values.items()}
    return Form(
        f"one of {choices(values)}", lambda word: values[_text(word)], lambda value: names[value]
    )


WHOLE = Form("a whole number", _whole, int)
MM = _decimal("mm", -3)
PERCENT = _decimal("%", -2)
