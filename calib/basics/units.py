"""Units at the edges: SI inside calib (m, rad, Nm, N); other units in files and commands, next to or above numbers."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal, TypeGuard, get_args

import numpy as np

from calib.basics.arrays import Array, read_only
from calib.errors import CalibError, choices

Quantity = Literal["length", "angle", "torque", "force", "mass", "pixel"]


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit of one quantity: ``value_si = value * to_si``."""

    #: Its symbol in a header, ``"mm"``.
    symbol: str
    #: Of the SI units m, rad, Nm, N and kg, and of px.
    quantity: Quantity
    #: One of this unit, in the SI unit.
    to_si: float


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
    ("px", "pixel", 1.0),
)

#: All units by symbol.
UNITS: Mapping[str, Unit] = MappingProxyType({row[0]: Unit(*row) for row in _ROWS})

#: Other spellings of units, by the symbol: words, signs, and the letters of other scripts. Unicode has two signs for
#: micro, the micro sign and the Greek letter, and signs of one character for some units.
_SPELLINGS = {
    spelling: symbol
    for symbol, spellings in {
        "m": "meter meters metre metres \N{CYRILLIC SMALL LETTER EM} \u7c73",
        "mm": "millimeter millimeters millimetre millimetres \N{SQUARE MM} \u043c\u043c \u6beb\u7c73",
        "cm": "centimeter centimeters centimetre centimetres \N{SQUARE CM} \u0441\u043c \u5398\u7c73",
        "um": "\N{MICRO SIGN}m \N{GREEK SMALL LETTER MU}m \N{SQUARE MU M} micron microns micrometer micrometers "
        "micrometre micrometres \u043c\u043a\u043c \u5fae\u7c73",
        "in": "inch inches",
        "rad": "radian radians \u0440\u0430\u0434 \u5f27\u5ea6",
        "deg": "deg. degree degrees Deg DEG \N{DEGREE SIGN} \N{MASCULINE ORDINAL INDICATOR} "
        "\u0433\u0440\u0430\u0434 \u5ea6",
        "mrad": "milliradian milliradians",
        "Nm": "N\N{NO-BREAK SPACE}m N.m N*m N-m N\N{MIDDLE DOT}m N\N{DOT OPERATOR}m",
        "px": "pixel pixels",
    }.items()
    for spelling in spellings.split(" ")
} | {"N m": "Nm"}

NUMBER = re.compile(r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
"""A number in the files of robots: ASCII digits, at most one point and one exponent; neither nan nor inf."""

_HEADER = re.compile(r"(?P<name>.*?)\s*\[(?P<symbol>[^\[\]]*)\]", re.DOTALL)
_HEADER_ROUND = re.compile(r"(?P<name>.*?)\s*\((?P<symbol>[^()]*)\)", re.DOTALL)

#: Brackets of East Asian keyboards, as those that units stand in.
_BRACKETS = str.maketrans(
    "\uff3b\uff3d\u3010\u3011\uff08\uff09",
    "[][]()",
)


class Angle(float):
    """A number that was given in a unit of angle [rad], to be checked against the joint that it is for."""

    __slots__ = ()


class Length(float):
    """A number that was given in a unit of length [m], to be checked against the joint that it is for."""

    __slots__ = ()


def unit_fault(value: float, *, slides: bool) -> str | None:
    """Return the fault in the unit of a joint's value, as text for a message after the joint's name.

    Args:
        value: An `Angle` or a `Length`, which are checked; any other number is taken as it is.
        slides: True for a joint that slides, False for one that turns.

    Returns:
        The fault; None if the unit fits the joint, or is not known.
    """
    if slides and isinstance(value, Angle):
        return 'is an angle, and the joint slides; give a length, such as "0.3 m"'
    if not slides and isinstance(value, Length):
        return 'is a length, and the joint turns; give an angle, such as "30 deg"'
    return None


def symbols(quantity: Quantity) -> tuple[str, ...]:
    """Return the symbols of the units of one quantity: ``("m", "mm", ...)`` of ``"length"``."""
    return tuple(unit.symbol for unit in UNITS.values() if unit.quantity == quantity)


def find_unit(symbol: str) -> Unit:
    """Return the unit with this symbol, in any of its spellings; CalibError if there is none."""
    text = symbol.strip()
    unit = UNITS.get(_SPELLINGS.get(text, text))
    if unit is None:
        known = []
        for quantity in get_args(Quantity):
            article = "an" if quantity == "angle" else "a"
            known.append(f"{article} {quantity} is in {choices(symbols(quantity))}")
        raise CalibError(f"'{text}' is not a unit that calib knows: {', '.join(known)}")
    return unit


def is_unit(symbol: str) -> bool:
    """Return True if calib knows a unit by this symbol, in any of its spellings."""
    text = symbol.strip()
    return _SPELLINGS.get(text, text) in UNITS


def split_header(text: str) -> tuple[str, str | None]:
    """Split a column header into its name and the unit's symbol in brackets at its end.

    Args:
        text: Such as ``"x [mm]"``; or ``"x (mm)"``, in round brackets if calib knows the unit, for ``"force (raw)"`` is
            a name.

    Returns:
        Name and symbol, as written; None if no brackets end the header.
    """
    plain = text.translate(_BRACKETS).strip()
    match = _HEADER.fullmatch(plain)
    if match is None:
        match = _HEADER_ROUND.fullmatch(plain)
        if match is None or not is_unit(match["symbol"]):
            return plain, None
    return match["name"].strip(), match["symbol"].strip()


# Numbers followed by their unit, as cell files and command lines give them. Their quantities, as `parse_quantity`
# returns them and messages name them:

#: In m.
LENGTH = "a length"

#: In rad.
ANGLE = "an angle"

#: In kg.
MASS = "a mass"

#: Of a joint, in rad/Nm or m/N.
COMPLIANCE = "a compliance"

#: Without a unit.
PLAIN = "a number"


def is_number(value: object) -> TypeGuard[float]:
    """Return True for a finite number other than a truth value."""
    if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
        return False
    return math.isfinite(value)


def parse_quantity(text: object) -> tuple[float, str]:
    """Return a number in SI units and its quantity, such as `ANGLE`, `COMPLIANCE`, or `PLAIN` without a unit.

    Args:
        text: Such as ``"0.5 mm"`` or ``"1e-5 rad/Nm"``, or a number.

    Raises:
        CalibError: It is not a number, or has an unknown unit.

    Example:
        >>> parse_quantity("0.5 mm")
        (0.0005, 'a length')
    """
    if is_number(text):
        return float(text), PLAIN
    match = re.fullmatch(rf"\s*({NUMBER.pattern})\s*(\S.*?)?\s*", str(text))
    if match is None or not isinstance(text, str) or not math.isfinite(float(match[1])):
        raise CalibError(f'{text!r} is not a number with a unit, such as "0.5 mm"')
    number = float(match[1])
    symbol = match[2]
    if symbol is None:
        return number, PLAIN
    motion, slash, load = (part.strip() for part in symbol.partition("/"))
    if not slash:
        unit = find_unit(symbol)
        return number * unit.to_si, quantity_name(unit.quantity)

    motions = {"Nm": symbols("angle"), "N": symbols("length")}
    if motion not in motions.get(load, ()):
        raise CalibError(
            f"'{symbol}' is not a unit of compliance; a joint's is in 'rad/Nm', or 'm/N' if it slides"
        )
    return number * UNITS[motion].to_si, COMPLIANCE


def quantity_name(quantity: Quantity) -> str:
    """Return the name of a quantity in messages, such as `ANGLE`."""
    return ANGLE if quantity == "angle" else f"a {quantity}"


#: Numbers, and the unit after them: ``70 -70 22.5 mm``.
_GROUP = re.compile(rf"((?:{NUMBER.pattern}[\s,]*)+?)([A-Za-zµμ]+(?:/[A-Za-z]+)?|$)[\s,]*")


def parse_quantities(
    text: str,
    option: str,
    counts: Mapping[str, int],
    example: str,
    *,
    signed: bool = True,
) -> dict[str, list[float]]:
    """Return numbers with units, such as ``10 mm 2 deg``, in SI units by their quantity; 0 alone needs no unit.

    Args:
        text: The numbers, as they were written.
        option: Name of the option that they were given to, for messages.
        counts: How many numbers each quantity that may be given has, such as ``{LENGTH: 3}``.
        example: An example of how to write it, for messages.
        signed: True if numbers may be below 0.

    Returns:
        The numbers of each quantity that was given, at least one.

    Raises:
        CalibError: Anything else was written.
    """
    if text.strip() == "0":
        return {quantity: [0.0] * count for quantity, count in counts.items()}
    values = _values_by_quantity(text, counts, signed=signed)
    if not values:
        allowed = []
        for quantity, count in counts.items():
            _, name = quantity.split()
            many = f"{count} numbers and a unit of {name}"
            allowed.append(quantity if count == 1 else many)
        below = "" if signed else ", not below 0"
        raise CalibError(
            f'{option} was given as "{text}"; it must be {" or ".join(allowed)}{below}, such as "{example}".'
        )
    return values


def _values_by_quantity(
    text: str, counts: Mapping[str, int], *, signed: bool
) -> dict[str, list[float]]:
    """Return the numbers of a text in SI units by their quantity; empty if they are not as `parse_quantities` wants."""
    if _GROUP.sub("", text).strip():
        return {}
    by_quantity: dict[str, list[float]] = {}
    for numbers, symbol in _GROUP.findall(text):
        words = re.split(r"[\s,]+", numbers.strip(", "))
        try:
            parsed = [parse_quantity(f"{word} {symbol}") for word in words]
        except CalibError:
            return {}
        quantity = parsed[0][1]
        values = [value for value, _ in parsed]
        if counts.get(quantity) != len(values) or quantity in by_quantity:
            return {}
        if not signed and min(values) < 0.0:
            return {}
        by_quantity[quantity] = values
    return by_quantity


def parse_amount(
    text: str,
    option: str,
    quantity: str,
    example: str,
    *,
    signed: bool = False,
) -> float:
    """Return a number with its unit, such as ``0.5 mm``, in SI units; 0 alone needs no unit.

    Args:
        text: The number, as it was written.
        option: Name of the option that it was given to, for messages.
        quantity: Its quantity, such as `LENGTH`.
        example: An example of how to write it, for messages.
        signed: True if it may be below 0.

    Raises:
        CalibError: Anything else was written.
    """
    return parse_quantities(text, option, {quantity: 1}, example, signed=signed)[quantity][0]


def parse_point(text: str, option: str, example: str = "70 -70 22.5 mm") -> Array:
    """Return a point as typed, such as ``70 -70 22.5 mm``, shape (3,), read-only [m]; CalibError for anything else.

    Args:
        text: Three numbers and a unit of length.
        option: Name of the option that it was given to, for messages.
        example: A text that would be right, for messages.
    """
    return read_only(parse_quantities(text, option, {LENGTH: 3}, example)[LENGTH])


def parse_noise(text: str, option: str) -> tuple[float, float]:
    """Return the constant [m] and the part per metre of distance [m/m] of an instrument's noise.

    Args:
        text: Such as ``15 um + 6 um/m``, or ``0.05 mm``.
        option: Name of the option or key that it was given to, for messages.

    Raises:
        CalibError: Anything else was written.
    """
    match = re.fullmatch(r"(.+?[A-Za-zµμ])\s*(?:\+(.+)/\s*m\s*)?", text)
    parts = [text]
    if match:
        parts = [part for part in match.groups() if part]
    lengths = [parse_amount(part, option, LENGTH, "15 um + 6 um/m") for part in parts]
    return lengths[0], sum(lengths[1:])


def noise_text(constant: float, per_length: float) -> str:
    """Return an instrument's noise, a constant [m] and a part per metre [m/m], as `parse_noise` reads it."""
    return f"{1e6 * constant:.15g} um + {1e6 * per_length:.15g} um/m"


def parse_joint_value(value: object, where: str) -> float:
    """Return the value of a joint with its unit as an `Angle` [rad] or a `Length` [m].

    Args:
        value: Such as ``"30 deg"`` or ``"0.3 m"``.
        where: Name of its place in a file or command, for messages.

    Raises:
        CalibError: It is not a number with a unit of angle or length.
    """
    hint = 'Write "30 deg" or "0.3 m".'
    try:
        number, quantity = parse_quantity(value)
    except CalibError as error:
        raise CalibError(f"{where}: {error}. {hint}") from error
    if quantity not in (LENGTH, ANGLE):
        message = f"{where} is {value!r}; a joint's value needs a unit of angle or length. {hint}"
        raise CalibError(message)
    return Length(number) if quantity == LENGTH else Angle(number)


def parse_joint_values(pairs: Iterable[str], option: str) -> dict[str, float]:
    """Return joint values as typed, such as ``lift=0.3 m`` each, by name [rad or m]; CalibError for anything else.

    Args:
        pairs: As typed, one for each joint.
        option: Name of the option that they were given to, for messages.
    """
    wanted = "'joint=value' with a unit, such as 'torso_lift_joint=0.3 m', and each joint once"
    values = {}
    for name, text in parse_pairs(pairs, option, wanted).items():
        values[name] = parse_joint_value(text, f"{option} '{name}={text}'")
    return values


def parse_pairs(pairs: Iterable[str], option: str, wanted: str) -> dict[str, str]:
    """Return texts ``name=value`` as a dict; a name may contain an equals sign, a value may not.

    Args:
        pairs: As typed.
        option: Name of the option that they were given to, for messages.
        wanted: What is allowed, for messages.

    Raises:
        CalibError: One is not of that form, or a name is there twice.
    """
    values: dict[str, str] = {}
    for pair in pairs:
        # rpartition leaves all of a text without an equals sign in the last part.
        name, _, value = (part.strip() for part in pair.rpartition("="))
        if not (name and value) or name in values:
            raise CalibError(f"{option} was given '{pair}'; it must be {wanted}.")
        values[name] = value
    return values


def parse_joint_range(value: object, where: str) -> tuple[float, float]:
    """Return the least and the largest value of a joint, both an `Angle` [rad] or both a `Length` [m].

    Args:
        value: Such as ``["-90 deg", "90 deg"]``.
        where: Name of its place in a file, for messages.

    Raises:
        CalibError: It is not two values of a joint in units of one quantity.
    """
    ends = value if isinstance(value, (list, tuple)) else ()
    if len(ends) != 2:
        raise CalibError(
            f'{where} is {value!r}; it must be the least and the largest value, such as ["-90 deg", "90 deg"].'
        )
    low = parse_joint_value(ends[0], where)
    high = parse_joint_value(ends[1], where)
    if type(low) is not type(high):
        message = f"{where} is from {ends[0]!r} to {ends[1]!r}; one is an angle and one a length."
        raise CalibError(message)
    return low, high
