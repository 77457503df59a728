"""Numbers as text, in the style of the number that they replace.

A plus sign, a missing zero before the point, an exponent and the width of a column stay. There are at least as many
decimals as before, and so many that rounding moves no arm by micrometres.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

#: A number of a program: its sign, digits before and after the point, and exponent.
_NUMBER = re.compile(r"([+-]?)(\s*)(\d*)(?:([.,])(\d*))?(?:([eE])([+-]?)(\d+))?")

#: Binary and hexadecimal constants, as KUKA writes them.
_CONSTANT = re.compile(r"'([BHbh])([0-9A-Fa-f]+)'")

#: Digits after the point of a position [m], an angle [rad] and a component of a quaternion that are written at least.
_RESOLUTION = {"length": 1e-7, "angle": 2e-8, "plain": 1e-8}

#: A mantissa is written below this; beyond it, or close to zero, its exponent would no longer suit.
_LARGEST_MANTISSA = 1e4


@dataclass(frozen=True, slots=True)
class Written:
    """A number as it is written in place of another."""

    text: str
    value: float


def decimals_for(quantity: str, scale: float) -> int:
    """Return the decimals that a number needs.

    Args:
        quantity: ``"length"``, ``"angle"``, or ``"plain"`` for what has no unit.
        scale: SI units in one unit of the number.
    """
    return max(0, math.ceil(-math.log10(_RESOLUTION[quantity] / abs(scale)) - 1e-9))


def written_number(
    old: str, value: float, decimals: int, most_decimals: int | None = None
) -> Written:
    """Write a number in the style of another.

    Args:
        old: The number that is replaced, as it is written.
        value: The new number, in the same unit.
        decimals: Decimals that it needs.
        most_decimals: Decimals that are read at most; None: any number of them.

    Returns:
        The text, and the number that it stands for.
    """
    match = _NUMBER.fullmatch(old)
    if match is None:
        raise ValueError(f"{old!r} is not a number")
    sign, gap, whole, point, fraction, letter, exponent_sign, exponent_digits = match.groups()
    exponent = int((exponent_sign or "") + exponent_digits) if letter else 0
    mantissa = value / 10.0**exponent
    if letter and not 1e-4 <= abs(mantissa) < _LARGEST_MANTISSA:
        exponent, mantissa, letter, fraction = 0, value, None, fraction and ""
    count = max(decimals + exponent, len(fraction or ""), 0)
    if most_decimals is not None:
        count = min(count, most_decimals)
    digits = f"{abs(mantissa):.{count}f}"
    is_zero = not digits.strip("0.")
    if not whole and fraction and digits.startswith("0."):
        digits = digits[1:]
    new_sign = "-" if mantissa < 0.0 and not is_zero else ("+" if sign == "+" else "")
    text = new_sign + (gap if sign and new_sign else "") + digits
    number = float((new_sign or "+") + digits)
    if letter:
        text += f"{letter}{exponent_sign}{exponent_digits}"
        number *= 10.0**exponent
    if point == ",":
        text = text.replace(".", ",")
    return Written(text, number)


def written_integer(old: str, value: int) -> str:
    """Write a whole number in the style of another, which may be a binary or hexadecimal constant.

    Args:
        old: The number that is replaced, as it is written.
        value: The new number.
    """
    match = _CONSTANT.fullmatch(old)
    if match is None:
        return f"+{value}" if old.startswith("+") and value >= 0 else str(value)
    letter, digits = match.groups()
    form = "b" if letter in "Bb" else "X"
    return f"'{letter}{value:0{len(digits)}{form}}'"


def in_column(text: str, start: int, old: str, new: str) -> tuple[int, str]:
    """Return where a number begins and its text such that a column stays one: blanks before it give way, or are added.

    Args:
        text: The text of the file.
        start: Where the old number begins.
        old: The old number.
        new: The new number.
    """
    blanks = 0
    while blanks < start and text[start - blanks - 1] == " ":
        blanks += 1
    if blanks < 2:
        return start, new
    longer = len(new) - len(old)
    if longer <= 0:
        return start, " " * -longer + new
    eaten = min(longer, blanks - 1)
    return start - eaten, new
