"""Units at the edges: SI inside calib (m, rad, Nm, N), these units in files and commands, beside or above numbers."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal, TypeGuard

import numpy as np

from calib.errors import CalibError, choices

Quantity = Literal["length", "angle", "torque", "force"]


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit of one quantity: ``value_si = value * to_si``.

    Attributes:
        symbol: as written in a header, ``"mm"``.
        quantity: ``"length"`` (SI unit m), ``"angle"`` (rad), ``"torque"`` (Nm) or ``"force"`` (N).
        to_si: what one of this unit is, in the SI unit.
    """

    symbol: str
    quantity: Quantity
    to_si: float


UNITS: Mapping[str, Unit] = MappingProxyType(
    {
        unit.symbol: unit
        for unit in (
            Unit("m", "length", 1.0),
            Unit("mm", "length", 1e-3),
            Unit("um", "length", 1e-6),
            Unit("cm", "length", 1e-2),
            Unit("in", "length", 0.0254),
            Unit("rad", "angle", 1.0),
            Unit("deg", "angle", math.pi / 180.0),
            Unit("mrad", "angle", 1e-3),
            Unit("Nm", "torque", 1.0),
            Unit("N", "force", 1.0),
        )
    }
)

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
    """What is wrong with the unit that a joint's value was given in; None if nothing is, or nothing is known of it.

    Example:
        >>> unit_fault(Length(0.01), slides=False)
        'is a length, and the joint turns; give an angle, such as "30 deg"'
    """
    if slides and isinstance(value, Angle):
        return 'is an angle, and the joint slides; give a length, such as "0.3 m"'
    if not slides and isinstance(value, Length):
        return 'is a length, and the joint turns; give an angle, such as "30 deg"'
    return None


def symbols(quantity: Quantity) -> tuple[str, ...]:
    """The symbols of the units of one quantity.

    Example:
        >>> symbols("angle")
        ('rad', 'deg', 'mrad')
    """
    return tuple(unit.symbol for unit in UNITS.values() if unit.quantity == quantity)


def find_unit(symbol: str) -> Unit:
    """The unit with this symbol.

    Raises:
        CalibError: there is no such unit; the text names those there are.
    """
    text = symbol.strip()
    unit = UNITS.get(_SPELLINGS.get(text, text))
    if unit is None:
        raise CalibError(
            f"'{text}' is not a unit that calib knows: a length is in "
            f"{choices(symbols('length'))}, an angle in {choices(symbols('angle'))}, a torque in "
            f"{choices(symbols('torque'))}, a force in {choices(symbols('force'))}"
        )
    return unit


def split_header(text: str) -> tuple[str, str | None]:
    """Split a column header into its name and the text in its last square brackets, if any.

    Example:
        >>> split_header("load [kg]")
        ('load', 'kg')
    """
    match = _HEADER.fullmatch(text.strip())
    if match is None:
        return text.strip(), None
    return match["name"].strip(), match["symbol"].strip()


def parse_header(text: str) -> tuple[str, Unit | None]:
    """Split a column header into its name and its unit, None when there are no brackets.

    Raises:
        CalibError: what stands in the brackets is not a unit.

    Example:
        >>> parse_header("x [mm]")
        ('x', Unit(symbol='mm', quantity='length', to_si=0.001))
        >>> parse_header("set")
        ('set', None)
    """
    name, symbol = split_header(text)
    return name, None if symbol is None else find_unit(symbol)


# Numbers with their unit beside them, as cell files and command lines give them

#: The quantities that a text can be, as a message says them.
LENGTH, ANGLE, COMPLIANCE, PLAIN = "a length", "an angle", "a compliance", "a number"


def is_number(value: object) -> TypeGuard[float]:
    """Whether a value is a finite number."""
    if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:  # a whole number that no float is
        return False


def parse_quantity(text: object) -> tuple[float, str]:
    """A number and its unit, in SI units, and what quantity it is: ``"0.5 mm"``, ``"1e-5 rad/Nm"``.

    Returns:
        The value [m], [rad], [rad/Nm] or [m/N], or a plain number; and ``"a length"``, ``"an angle"``,
        ``"a compliance"`` or ``"a number"``.

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
        if (bottom, UNITS[top].quantity if top in UNITS else "") in (
            ("Nm", "angle"),
            ("N", "length"),
        ):
            return number * UNITS[top].to_si, COMPLIANCE
        raise CalibError(
            f"'{match[2]}' is no unit of compliance; a joint's is in 'rad/Nm', or 'm/N' where it slides"
        )
    unit = find_unit(match[2])
    return number * unit.to_si, ANGLE if unit.quantity == "angle" else f"a {unit.quantity}"


def parse_joint_value(value: object, where: str) -> float:
    """The value of a joint with its unit, such as ``"30 deg"`` or ``"0.3 m"``, in rad or m.

    Returns:
        An `Angle` or a `Length`: it is known later whether the joint turns or slides.

    Raises:
        CalibError: No number with a unit of length or angle; the text says ``where`` it was given.
    """
    try:
        number, kind = parse_quantity(value)
    except CalibError as error:
        raise CalibError(f'{where}: {error}. Write "30 deg" or "0.3 m".') from error
    if kind not in (LENGTH, ANGLE):
        raise CalibError(
            f'{where} is {value!r}; a joint\'s value needs a unit of angle or length: "30 deg" or "0.3 m".'
        )
    return Length(number) if kind == LENGTH else Angle(number)


def parse_joint_range(value: object, where: str) -> tuple[float, float]:
    """The least and the largest value of a joint, such as ``["-90 deg", "90 deg"]``, [rad] or [m].

    Raises:
        CalibError: Not two values of a joint, or an angle and a length; the text says ``where`` they were given.
    """
    if not isinstance(value, (list, tuple)) or len(value) != 2:
        raise CalibError(
            f'{where} is {value!r}; it must be the least and the largest value, such as ["-90 deg", "90 deg"] or '
            '["0 mm", "300 mm"].'
        )
    low, high = (parse_joint_value(one, where) for one in value)
    if type(low) is not type(high):
        raise CalibError(
            f"{where} is from {value[0]!r} to {value[1]!r}; one is an angle and one a length."
        )
    return low, high
