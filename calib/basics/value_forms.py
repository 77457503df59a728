"""Forms of values in TOML and JSON files: in words, how they are read into SI units, and how they are written.

`calib.basics.records` reads and writes whole tables by the forms of their keys.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

from calib.basics.arrays import Array
from calib.basics.units import UNITS, Length, is_number, parse_joint_range, parse_joint_value
from calib.errors import CalibError, choices, did_you_mean


@dataclass(frozen=True, slots=True)
class Place:
    """The place of a value in a file or on a command line: a key of a table, or an option; for messages."""

    #: For messages: ``"'xyz_mm' in [tracker]"``, ``"--target"``.
    words: str = ""
    #: Heading of the table that stands there, for messages on its keys: ``"[tracker]"``; empty: the outermost table.
    heading: str = ""
    #: Folder at which relative names of files begin.
    folder: Path = Path()
    #: The key alone, such as the name of a parameter.
    name: str = ""

    def __str__(self) -> str:
        """Return the words."""
        return self.words

    def key(self, name: str) -> Place:
        """Return the place of a key of the table at this place."""
        if not self.heading:
            return Place(f"'{name}'", f"[{name}]", self.folder, name)
        words = f"'{name}' in {self.heading}"
        return Place(words, words, self.folder, name)


def same(value: Any) -> Any:  # noqa: ANN401
    """Return the value unchanged: the file has it as it is in memory."""
    return value


@dataclass(frozen=True, slots=True)
class Form:
    """The form of a value in a file: what it must be, how it is read into SI units, and how it is written."""

    #: ``"three numbers [mm]"``, for messages and the documentation.
    words: str
    #: (what the file holds, its place) to the value in SI units. Raises `CalibError` for what it does not take.
    read: Callable[[Any, Place], Any]
    #: From the value in SI units to what the file holds.
    write: Callable[[Any], Any] = same
    #: Meaning of a text, ``"the name of a link"``, for messages on values in memory.
    meaning: str = ""


@dataclass(frozen=True, slots=True)
class Check:
    """A check of a value in memory, in SI units."""

    #: Description of a right value, for messages: ``"a 3 x 3 right-handed rotation"``.
    must: str
    #: Gives the value that is kept, such as a read-only copy; refuses as that of `checked` does.
    convert: Callable[[Any], Any]


def checked(value: Any, what: object, must: str, convert: Callable[[Any], Any]) -> Any:  # noqa: ANN401
    """Check a given value by a conversion, and return it as it is kept.

    Args:
        value: The value as given.
        what: What it is or where it stands, for the message: ``"'target_mm'"``.
        must: What it must be, for the message: ``"three numbers [mm]"``.
        convert: Gives the value that is kept; refuses by None, a TypeError or a ValueError.

    Raises:
        CalibError: ``convert`` refuses the value, or raises one itself.
    """
    try:
        result = convert(value)
    except (TypeError, ValueError) as error:
        if isinstance(error, CalibError):
            raise
        result = None
    if result is None:
        written = value.tolist() if isinstance(value, np.ndarray) else value
        raise CalibError(f"{what} is {written!r}; it must be {must}.")
    return result


def form(
    words: str,
    convert: Callable[[Any], Any],
    write: Callable[[Any], Any] = same,
    meaning: str = "",
) -> Form:
    """Return a `Form` whose values ``convert`` reads, or refuses as that of `checked` does, and ``write`` writes."""
    return Form(words, lambda value, place: checked(value, place, words, convert), write, meaning)


def of_type(kind: type, words: str, meaning: str = "") -> Form:
    """Return the form of values of a type that are the same in the file and in memory; True is not a number."""

    def convert(value: Any) -> Any:  # noqa: ANN401
        is_truth = isinstance(value, bool) and kind is not bool
        return value if isinstance(value, kind) and not is_truth else None

    return form(words, convert, meaning=meaning)


def text(meaning: str) -> Form:
    """Return the form of a text, such as ``"the name of a link"``."""
    return of_type(str, f"{meaning} in quotes", meaning)


def one_of(names: Collection[str] | Mapping[str, Any]) -> Form:
    """Return the form of one of several words; those of a mapping stand for its values."""
    by_name = dict(names) if isinstance(names, Mapping) else {name: name for name in names}
    by_value = {value: name for name, value in by_name.items()}
    words = f"one of {choices(by_name)}"

    def read(value: Any, place: Place) -> Any:  # noqa: ANN401
        """Return the value that a word stands for; CalibError if it is none of the words."""
        if isinstance(value, str) and value in by_name:
            return by_name[value]
        likely = did_you_mean(value, by_name) if isinstance(value, str) else ""
        raise CalibError(f"{place} is {value!r}{likely}; it must be {words}.")

    return Form(words, read, by_value.__getitem__, words)


def to_si(value: Any, unit_in_si: float) -> Any:  # noqa: ANN401  a number or an array
    """Convert numbers to SI, by division by 1000 for mm: a product with 0.001 would be rounded twice."""
    return value / (1.0 / unit_in_si)


def number(
    unit: str = "",
    convert: Callable[[float], float] | None = None,
    unit_in_si: float | None = None,
) -> Form:
    """Return the form of a number in a unit, such as ``"mm"``.

    Args:
        unit: The unit in the file; empty: none.
        convert: From the unit to SI; None: by its size.
        unit_in_si: Its size in SI units; None: as `calib.basics.units.UNITS` says.
    """
    if unit_in_si is None:
        unit_in_si = UNITS[unit].to_si if unit in UNITS else 1.0

    def read(value: Any) -> float | None:  # noqa: ANN401
        if not is_number(value):
            return None
        return float(to_si(value, unit_in_si) if convert is None else convert(value))

    words = f"a number [{unit}]" if unit else "a number"
    return form(words, read, lambda value: float(f"{value / unit_in_si:.15g}"))


def shift_decimal(value: float, places: int) -> float:
    """Multiply a decimal number by a power of ten without changing its digits: 29.85 mm is 0.02985 m.

    Args:
        value: The number; its digits are those of its shortest representation.
        places: The power of ten, such as -3 for mm in metres.

    Returns:
        The double nearest to the decimal product.
    """
    return float(Decimal(repr(float(value))).scaleb(places))


def decimal(unit: str, places: int, least: float = -np.inf) -> Form:
    """Return the form of a number in a unit of 10**places SI units (mm: -3), converted by shifting the decimal point.

    The decimal digits of the file are kept; what is not a number, or is below ``least`` (in the unit), is refused.
    """

    def read(value: Any) -> float | None:  # noqa: ANN401
        return shift_decimal(value, places) if is_number(value) and value >= least else None

    limit = f", {least:g} or more" if np.isfinite(least) else ""
    return form(f"a number [{unit}]{limit}", read, lambda value: shift_decimal(value, -places))


def three_numbers(
    unit: str = "",
    convert: Callable[[Array], Any] | None = None,
    convert_back: Callable[[Any], Array] = same,
) -> Form:
    """Return the form of a list of three numbers in a unit.

    Args:
        unit: The unit in the file, such as ``"mm"``; empty: none.
        convert: From an array of shape (3,) in the unit to what is kept; None: to the array in SI units.
        convert_back: From what is kept to the array of shape (3,) in SI units.
    """
    unit_in_si = UNITS[unit].to_si if unit in UNITS else 1.0

    def read(value: Any) -> Any:  # noqa: ANN401
        """Return three numbers of a file as they are kept; None, or a TypeError, for anything else."""
        if len(value) != 3 or not all(map(is_number, value)):
            return None
        array = np.array(value, dtype=np.float64)
        return to_si(array, unit_in_si) if convert is None else convert(array)

    def write(kept: Any) -> list[float]:  # noqa: ANN401
        values = convert_back(kept).tolist()
        return [float(f"{value / unit_in_si:.15g}") + 0.0 for value in values]

    return form(f"three numbers [{unit}]" if unit else "three numbers", read, write)


TEXT = text("a text")
WHOLE = of_type(int, "a whole number")
TRUTH = of_type(bool, "true or false")
NUMBER = number()
MM = number("mm")
DEGREES = number("deg", np.radians)
POINT_MM = three_numbers("mm")

#: A table, as a dict.
TABLE = of_type(dict, "a table")


def _joint_text(value: float) -> str:
    """Write the value of a joint, an `Angle` [rad] or a `Length` [m], with its unit."""
    return f"{float(value)!r} {'m' if isinstance(value, Length) else 'rad'}"


#: The value of a joint, as an `Angle` [rad] or a `Length` [m].
JOINT_VALUE = Form(
    'the value of a joint, "30 deg" or "0.3 m"',
    lambda value, place: parse_joint_value(value, str(place)),
    _joint_text,
)

#: The least and the largest value of a joint, both an `Angle` or both a `Length`.
JOINT_RANGE = Form(
    'two values of a joint, ["-90 deg", "90 deg"]',
    lambda value, place: parse_joint_range(value, str(place)),
    lambda ends: list(map(_joint_text, ends)),
)


def list_of(entry: Form, words: str, heading: str = "") -> Form:
    """Return the form of a list, as a tuple; of a list of tables ``heading`` is theirs, ``"[[boxes]]"``."""
    whole = of_type(list, words)

    def read(value: Any, place: Place) -> tuple[Any, ...]:  # noqa: ANN401
        """Return the entries of a list of a file, each read by its form; CalibError names the number of a wrong one."""
        entries = []
        for k, given in enumerate(whole.read(value, place), 1):
            words = f"{heading} number {k}" if heading else f"entry {k} of {place}"
            entries.append(entry.read(given, Place(words, words, place.folder)))
        return tuple(entries)

    return Form(words, read, lambda values: [entry.write(value) for value in values])


NAMES = list_of(text("a name"), "a list of names")


def named(entry: Form, write: Callable[[str, Any], Any] | None = None) -> Form:
    """Return the form of a table whose keys are names that the user chooses, as a dict of its values by name.

    Args:
        entry: The form of a value.
        write: From a name and its value to what the file holds, if that depends on the name; None: by the form.
    """

    def read(value: Any, place: Place) -> dict[str, Any]:  # noqa: ANN401
        table = TABLE.read(value, place)
        return {name: entry.read(given, place.key(name)) for name, given in table.items()}

    def write_all(values: Mapping[str, Any]) -> dict[str, Any]:
        return {
            name: entry.write(value) if write is None else write(name, value)
            for name, value in values.items()
        }

    return Form(f"a table of names, each with {entry.words}", read, write_all)
