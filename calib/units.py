"""Units at the edges: SI inside calib (m, rad, Nm, N), these units in files and commands."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

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
