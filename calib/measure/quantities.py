"""A number with its unit beside it, such as ``"0.5 mm"``, as cell files and command lines give it."""

from __future__ import annotations

import re

import numpy as np

from calib.errors import CalibError
from calib.measure.cell_parts import is_number
from calib.units import UNITS, Angle, Length, find_unit

#: The quantities that a text can be, as a message says them.
LENGTH, ANGLE, COMPLIANCE, NUMBER = "a length", "an angle", "a compliance", "a number"


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
        return float(text), NUMBER  # type: ignore[arg-type]  # it is a number
    match = re.fullmatch(r"\s*([+-]?[\d.]+(?:[eE][+-]?\d+)?)\s*(\S.*?)?\s*", str(text))
    try:
        number = float(match[1]) if match and isinstance(text, str) else np.nan
    except ValueError:
        number = np.nan
    if match is None or not np.isfinite(number):
        raise CalibError(f'{text!r} is no number with a unit, such as "0.5 mm"')
    if match[2] is None:
        return number, NUMBER
    top, slash, bottom = (part.strip() for part in match[2].partition("/"))
    if slash:
        allowed = {"Nm": "angle", "N": "length"}
        if bottom in allowed and top in UNITS and UNITS[top].quantity == allowed[bottom]:
            return number * UNITS[top].to_si, COMPLIANCE
        raise CalibError(
            f"'{match[2]}' is no unit of compliance; a joint's is in 'rad/Nm', or 'm/N' where it slides"
        )
    unit = find_unit(match[2])
    names: dict[str, str] = {"length": LENGTH, "angle": ANGLE}
    return number * unit.to_si, names.get(unit.quantity, f"a {unit.quantity}")


def parse_joint_value(value: object, where: str) -> float:
    """The value of a joint with its unit, such as ``"30 deg"`` or ``"0.3 m"``, in rad or m.

    Args:
        value: The text.
        where: Where it was given, for the message.

    Returns:
        An `Angle` or a `Length`: it is known later whether the joint turns or slides.

    Raises:
        CalibError: No number with a unit of length or angle.
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
    """The least and the largest value of a joint, each with its unit beside it, [rad] or [m].

    Args:
        value: Such as ``["-90 deg", "90 deg"]``.
        where: Where they were given, for the message.

    Raises:
        CalibError: Not two values of a joint, or an angle and a length.
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
