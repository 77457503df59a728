"""Errors as text, in the units that they are shown in."""

from __future__ import annotations

from calib.channels import RESIDUAL_UNITS
from calib.text.layout.lines import number


def shown(value: float, unit: str, digits: int | None = None) -> str:
    """Format an error in the unit that its residual unit is shown in, without that unit; see `number`.

    Args:
        value: The error, in its SI unit, or [px].
        unit: Symbol of this unit, of `calib.channels.RESIDUAL_UNITS`.
        digits: How many digits stand after the point; None: as many as the unit usually has.
    """
    of_unit = RESIDUAL_UNITS[unit]
    return number(of_unit.to_shown * value, of_unit.digits if digits is None else digits)


def with_unit(value: float, unit: str) -> str:
    """Format an error with the unit that it is shown in: ``"0.123 mm"``; see `shown`."""
    return f"{shown(value, unit)} {RESIDUAL_UNITS[unit].shown}"
