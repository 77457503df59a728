"""Units at the edges: SI inside calib (m, rad, Nm, N), these units in files and commands, beside or above numbers."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal, TypeAlias, TypeGuard, get_args

import numpy as np
from numpy.typing import NDArray

from calib.errors import CalibError, choices

#: Arrays of numbers, of truth values, and of whole numbers.
Array: TypeAlias = NDArray[np.float64]
Mask: TypeAlias = NDArray[np.bool_]
Integers: TypeAlias = NDArray[np.int_]

Quantity = Literal["length", "angle", "torque", "force", "mass"]


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit of one quantity: ``value_si = value * to_si``."""

    symbol: str  #: as written in a header, ``"mm"``.
    quantity: Quantity  #: of the SI units m, rad, Nm, N and kg.
    to_si: float  #: what one of this unit is, in the SI unit.


_ROWS: tuple[tuple[str, Quantity, float], ...] = (
    ("m", "length", 1.0),
    ("mm", "length", 1e-3),
    ("um", "length", 1e-6),
    ("cm", "length", 1e-2),
    ("in", "length", 0.0254),
    ("rad", "angle", 1.0),
    ("deg", "angle", math.pi / 180.0),
    ("mrad", "angle", 1e-3),
    ("Nm", "torque", 1.0),
    ("N", "force", 1.0),
    ("kg", "mass", 1.0),
    ("g", "mass", 1e-3),
)
UNITS: Mapping[str, Unit] = MappingProxyType({row[0]: Unit(*row) for row in _ROWS})

# Unicode has two signs for micro, the micro sign and the Greek letter; a product has many.
_SPELLINGS = {
    "\N{MICRO SIGN}m": "um",
    "\N{GREEK SMALL LETTER MU}m": "um",
    **{f"N{sign}m": "Nm" for sign in (" ", ".", "*", "\N{MIDDLE DOT}", "\N{DOT OPERATOR}")},
}

NUMBER = re.compile(r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
"""A number in the files of robots: ASCII digits, at most one point and one exponent; neither nan nor inf."""

_HEADER = re.compile(r"(?P<name>.*?)\s*\[(?P<symbol>[^\[\]]*)\]", re.DOTALL)


class Angle(float):
    """A number that was given in a unit of angle [rad]: held against the joint that it is for, once that is known."""

    __slots__ = ()


class Length(float):
    """A number that was given in a unit of length [m]."""

    __slots__ = ()


def unit_fault(value: float, *, slides: bool) -> str | None:
    """What is wrong with the unit that a joint's value was given in; None if nothing is, or nothing is known of it."""
    if slides and isinstance(value, Angle):
        return 'is an angle, and the joint slides; give a length, such as "0.3 m"'
    if not slides and isinstance(value, Length):
        return 'is a length, and the joint turns; give an angle, such as "30 deg"'
    return None


def symbols(quantity: Quantity) -> tuple[str, ...]:
    """The symbols of the units of one quantity."""
    return tuple(unit.symbol for unit in UNITS.values() if unit.quantity == quantity)


def find_unit(symbol: str) -> Unit:
    """The unit with this symbol; CalibError if there is none."""
    text = symbol.strip()
    unit = UNITS.get(_SPELLINGS.get(text, text))
    if unit is None:
        known = ", ".join(
            f"a{'n' * (one == 'angle')} {one} is in {choices(symbols(one))}"
            for one in get_args(Quantity)
        )
        raise CalibError(f"'{text}' is not a unit that calib knows: {known}")
    return unit


def split_header(text: str) -> tuple[str, str | None]:
    """Split a column header into its name and the text in its last square brackets, if any."""
    match = _HEADER.fullmatch(text.strip())
    return (match["name"].strip(), match["symbol"].strip()) if match else (text.strip(), None)


# Numbers with their unit beside them, as cell files and command lines give them

#: The quantities that a text can be, as a message says them.
LENGTH, ANGLE, MASS, COMPLIANCE = "a length", "an angle", "a mass", "a compliance"
PLAIN = "a number"


def is_number(value: object) -> TypeGuard[float]:
    """Whether a value is a finite number."""
    if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
        return False
    return math.isfinite(value)


def parse_quantity(text: object) -> tuple[float, str]:
    """A number in SI units and its quantity, such as `ANGLE` or `COMPLIANCE`: ``"0.5 mm"``, ``"1e-5 rad/Nm"``.

    Raises:
        CalibError: No number, or an unknown unit.

    Example:
        >>> parse_quantity("0.5 mm")
        (0.0005, 'a length')
    """
    if is_number(text):
        return float(text), PLAIN
    match = re.fullmatch(rf"\s*({NUMBER.pattern})\s*(\S.*?)?\s*", str(text))
    if match is None or not isinstance(text, str) or not math.isfinite(float(match[1])):
        raise CalibError(f'{text!r} is no number with a unit, such as "0.5 mm"')
    number = float(match[1])
    if match[2] is None:
        return number, PLAIN
    top, slash, bottom = (part.strip() for part in match[2].partition("/"))
    if slash:
        if bottom not in ("Nm", "N") or top not in symbols("angle" if bottom == "Nm" else "length"):
            raise CalibError(
                f"'{match[2]}' is no unit of compliance; a joint's is in 'rad/Nm', or 'm/N' where it slides"
            )
        return number * UNITS[top].to_si, COMPLIANCE
    unit = find_unit(match[2])
    return number * unit.to_si, ANGLE if unit.quantity == "angle" else f"a {unit.quantity}"


#: Numbers, and the unit that stands behind them: ``70 -70 22.5 mm``.
_GROUP = re.compile(rf"((?:{NUMBER.pattern}[\s,]*)+?)([A-Za-zµμ]+(?:/[A-Za-z]+)?|$)[\s,]*")


def parse_quantities(
    text: str, option: str, wanted: Mapping[str, int], example: str, *, signed: bool = True
) -> dict[str, list[float]]:
    """Numbers with units, such as ``10 mm 2 deg``, in SI units by what they are; 0 alone needs no unit.

    Args:
        text: As it was written.
        option: To which it was given.
        wanted: What may be there, such as `LENGTH`, once each, and of how many numbers it is.
        example: Of how to write it.
        signed: Whether numbers may be below 0.

    Raises:
        CalibError: Anything else.
    """
    if text.strip() == "0":
        return {kind: [0.0] * count for kind, count in wanted.items()}
    found: dict[str, list[float]] = {}
    good = not _GROUP.sub("", text).strip()
    for numbers, symbol in _GROUP.findall(text) if good else ():
        try:
            read = [
                parse_quantity(f"{one} {symbol}")
                for one in re.split(r"[\s,]+", numbers.strip(", "))
            ]
        except CalibError:
            good = False
            break
        kind, values = read[0][1], [value for value, _ in read]
        good &= wanted.get(kind) == len(values) and kind not in found
        good &= signed or min(values) >= 0.0
        found[kind] = values
    if not good or not found:
        must = [
            k if n == 1 else f"{n} numbers and a unit of {k.split()[1]}" for k, n in wanted.items()
        ]
        below = "" if signed else ", not below 0"
        raise CalibError(
            f'{option} was given as "{text}"; it must be {" or ".join(must)}{below}, such as "{example}".'
        )
    return found


def parse_amount(
    text: str, option: str, wanted: str, example: str, *, signed: bool = False
) -> float:
    """A number with its unit, such as ``0.5 mm``, of what is wanted, such as `LENGTH`, in SI units."""
    return parse_quantities(text, option, {wanted: 1}, example, signed=signed)[wanted][0]


def parse_noise(text: str, option: str) -> tuple[float, float]:
    """``15 um + 6 um/m``, or ``0.05 mm``: a length [m], and one for each metre of distance [m/m]."""
    match = re.fullmatch(r"(.+?[A-Za-zµμ])\s*(?:\+(.+)/\s*m\s*)?", text)
    parts = [part for part in match.groups() if part] if match else [text]
    constant, *per_length = (parse_amount(part, option, LENGTH, "15 um + 6 um/m") for part in parts)
    return constant, sum(per_length)


def parse_joint_value(value: object, where: str) -> float:
    """The value of a joint with its unit, such as ``"30 deg"`` or ``"0.3 m"``, as an `Angle` or a `Length`."""
    hint = 'Write "30 deg" or "0.3 m".'
    try:
        number, kind = parse_quantity(value)
    except CalibError as error:
        raise CalibError(f"{where}: {error}. {hint}") from error
    if kind not in (LENGTH, ANGLE):
        message = f"{where} is {value!r}; a joint's value needs a unit of angle or length. {hint}"
        raise CalibError(message)
    return Length(number) if kind == LENGTH else Angle(number)


def parse_joint_range(value: object, where: str) -> tuple[float, float]:
    """The least and the largest value of a joint, such as ``["-90 deg", "90 deg"]``, [rad] or [m]."""
    ends = value if isinstance(value, (list, tuple)) else ()
    if len(ends) != 2:
        raise CalibError(
            f'{where} is {value!r}; it must be the least and the largest value, such as ["-90 deg", "90 deg"].'
        )
    low, high = (parse_joint_value(one, where) for one in ends)
    if type(low) is not type(high):
        message = f"{where} is from {ends[0]!r} to {ends[1]!r}; one is an angle and one a length."
        raise CalibError(message)
    return low, high
