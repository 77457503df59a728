"""Numbers of a certificate: U with two significant digits, and the value to the same place (JCGM 100, 7.2.6)."""

from __future__ import annotations

import math
from decimal import ROUND_HALF_EVEN, Decimal

#: Significant digits of an uncertainty.
_DIGITS = 2


def rounded(value: float, uncertainty: float) -> tuple[str, str]:
    """Write a value and its expanded uncertainty as a certificate states them.

    Args:
        value: The value, in the unit in which it is shown.
        uncertainty: Its expanded uncertainty in the same unit.

    Returns:
        The value, rounded to the last digit of the uncertainty, and the uncertainty with two significant digits; a dash
        for what is not finite. Without an uncertainty above 0 the value has three digits after the point.

    Example:
        >>> rounded(0.34049, 0.0562)
        ('0.340', '0.056')
        >>> rounded(12.3, 0.0996)
        ('12.30', '0.10')
    """
    if not (math.isfinite(uncertainty) and uncertainty > 0.0):
        return ("-" if not math.isfinite(value) else f"{value:.3f}"), "-"
    exact = Decimal(repr(float(uncertainty)))
    # Rounded first: 0.0996 is 0.10, whose second digit is one place further left.
    place = Decimal(f"{exact:.{_DIGITS - 1}e}").adjusted() - (_DIGITS - 1)
    step = Decimal(1).scaleb(place)
    written = f"{_to_step(exact, step):f}"
    if not math.isfinite(value):
        return "-", written
    return f"{_to_step(Decimal(repr(float(value))), step):f}", written


def _to_step(value: Decimal, step: Decimal) -> Decimal:
    """Return a number rounded to a multiple of a power of ten, halves to even (ISO 80000-1, B.3), without -0."""
    nearest = value.quantize(step, ROUND_HALF_EVEN)
    if step >= 1:
        nearest = Decimal(int(nearest))
    return nearest if nearest else abs(nearest)
