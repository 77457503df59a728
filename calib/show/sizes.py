"""Errors as text, in the units that they are shown in."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from calib.basics.channels import RESIDUAL_UNITS
from calib.show.lines import number


def shown(value: float, unit: str, digits: int | None = None) -> str:
    """Format an error in the unit that its residual unit is shown in, without that unit; see `number`.

    Args:
        value: The error, in its SI unit, or [px].
        unit: Symbol of this unit, of `calib.basics.channels.RESIDUAL_UNITS`.
        digits: Digits after the decimal point; None: as many as the unit usually has.
    """
    of_unit = RESIDUAL_UNITS[unit]
    return number(of_unit.to_shown * value, of_unit.digits if digits is None else digits)


def with_unit(value: float, unit: str) -> str:
    """Format an error with the unit that it is shown in: ``"0.123 mm"``; see `shown`."""
    return f"{shown(value, unit)} {RESIDUAL_UNITS[unit].shown}"


def sizes_of(values: Mapping[str, Any], name: str, form: str = ".3f") -> list[str]:
    """Format the size in each unit in which there is one: ``["2.350 mm", "0.573 deg"]``.

    Args:
        values: The values of a reason, in SI units.
        name: Their common name: of ``"before"`` the length is ``before_m`` and the angle ``before_rad``.
        form: Format of the numbers.
    """
    sizes = []
    for symbol, unit in RESIDUAL_UNITS.items():
        key = f"{name}_{symbol}"
        if key in values:
            sizes.append(f"{unit.to_shown * values[key]:{form}} {unit.shown}")
    return sizes


def absurd_size(values: Mapping[str, Any], name: str) -> str:
    """Format the first size that is beyond any arm, without decimals: ``"264 mm"``.

    Args:
        values: The values of a reason, in SI units.
        name: Their common name, as for `sizes_of`.

    Returns:
        The size with its unit; empty if none is.
    """
    for symbol, unit in RESIDUAL_UNITS.items():
        value = values.get(f"{name}_{symbol}", 0.0)
        if isinstance(value, float) and value > unit.absurd:
            return f"{unit.to_shown * value:.0f} {unit.shown}"
    return ""
