"""Words that several verbs share: robots, rows, parameters and errors."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from calib.basics.channels import RESIDUAL_UNITS
from calib.data.kinds import get as kind_named
from calib.data.measurements import Measurements
from calib.diagnosis.coverage import OutsideRow
from calib.model.families import unit_of
from calib.model.observability import Combination
from calib.numerics.errors import Errors
from calib.result.calibration import Calibration
from calib.robot.robot import Robot
from calib.show.lines import listed, number, plural

#: Rows outside of the measured range that are named one by one; a sentence with more is hard to read.
_NAMED = 3

#: Parameters of a combination that are named; the others are counted.
_MOST_NAMES = 6


def chain_name(robot: Robot) -> str:
    """Return the text that names a robot and its chain, or chains: ``'ur3', base to tool0``."""
    return f"'{robot.name}', {ends_text(robot)}"


def ends_text(robot: Robot) -> str:
    """Return the text that names the links of chains: ``base to tool0``, ``head to left_hand, right_hand``."""
    tips_by_base: dict[str, list[str]] = {}
    for chain in robot.chains:
        tips_by_base.setdefault(chain.base, []).append(chain.tip)
    parts = [f"{base} to {', '.join(tips)}" for base, tips in tips_by_base.items()]
    return "; ".join(parts)


def joint_unit(*, prismatic: bool) -> tuple[float, str]:
    """Return the factor from SI, and the symbol, of the unit in which a joint's values are shown."""
    return (1e3, "mm") if prismatic else (math.degrees(1.0), "deg")


def kinds_text(m: Measurements) -> str:
    """Return the text that lists the kinds of measurements with their numbers of rows."""
    counts = Counter(m.kinds)
    return "; ".join(f"{kind_named(kind).words} ({n:,} rows)" for kind, n in counts.items())


def outside_text(rows: Sequence[OutsideRow], numbers: Sequence[int]) -> str:
    """List the rows outside of the measured range.

    Args:
        rows: The rows; the first few are named with their joints, the furthest joint first.
        numbers: The number of each queried row in its table, by `OutsideRow.index`.

    Returns:
        The rows in one line; empty if there are none.
    """
    parts = []
    for row in rows[:_NAMED]:
        joints = []
        for beyond in row.beyond:
            factor, unit = joint_unit(prismatic=beyond.prismatic)
            joints.append(f"'{beyond.joint}' {factor * beyond.by:.3g} {unit}")
        parts.append(f"row {numbers[row.index]}: {', '.join(joints)} beyond the measured range")
    more = len(rows) - _NAMED
    if more > 0:
        parts.append(f"and {plural(more, 'more row')}")
    return "; ".join(parts)


def combination_text(combination: Combination) -> str:
    """Word a combination of parameters that change together, such as ``d2 and d4 together (+1 mm, -1 mm)``.

    A single one is ``d2 at all``; of many only the first names and the number of the others are given, without amounts.
    """
    names = combination.names
    if len(names) == 1:
        return f"{names[0]} at all"
    if len(names) > _MOST_NAMES:
        return f"{', '.join(names[:_MOST_NAMES])} and {len(names) - _MOST_NAMES} more together"
    amounts = []
    for step, si_unit in zip(combination.steps, combination.units, strict=True):
        factor, unit = unit_of(si_unit).shown
        amounts.append(f"{factor * step:+.3g} {unit}")
    return f"{', '.join(names[:-1])} and {names[-1]} together ({', '.join(amounts)})"


# Errors, in the units that they are shown in


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


def rms_text(errors: Errors) -> str:
    """Word the rms error of some rows in each unit that was measured; a dash without any."""
    return listed([with_unit(errors[unit].rms, unit) for unit in errors.units]) or "-"


def before_and_after(c: Calibration) -> tuple[str, Errors, Errors]:
    """Return the most telling errors of the nominal and of the calibrated robot.

    Args:
        c: The result.

    Returns:
        The rows that they are of, ``"held-out"`` (without outliers), else ``"validation"``, else ``"fitted"`` (of these
        two all rows, outliers too); and the errors of the nominal, then of the calibrated robot, of the geometry alone.
        Those of the nominal robot may be NaN.
    """
    before, after = c.trust.nominal_cross_validation, c.cross_validation
    if before is not None and after is not None:
        return "held-out", before.errors_without_outliers, after.errors_without_outliers
    nominal, calibrated = c.errors["nominal"], c.errors["calibrated"]
    name, rows = "fitted", "estimation"
    if c.rows.validation.any():
        name, rows = "validation", "validation"
    return name, nominal[rows], calibrated[rows]
