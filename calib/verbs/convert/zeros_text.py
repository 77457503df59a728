"""Joint zeros as `calib convert` prints them: what to add to each reading, what is stored, and the errors with them."""

from __future__ import annotations

from collections.abc import Mapping

from calib.basics.channels import RESIDUAL_UNITS
from calib.show.lines import fill, number
from calib.show.sizes import shown
from calib.show.tables import Column, name_column, table_lines
from calib.show.words import joint_unit
from calib.verbs.convert.format import Conversion
from calib.verbs.convert.rounded_zeros import (
    RmsErrors,
    RoundedZeros,
    StoredNumber,
    calibration_of,
)

#: Decimals of zeros and their standard deviations [deg, mm].
_DIGITS = 4

#: Words for the rows of the errors, by `RmsErrors.rows`.
_ROWS = {
    "held-out": "held-out rows, outliers aside",
    "validation": "validation rows",
    "estimation": "fitted rows, which prove nothing",
}


def zeros_text(stored: StoredNumber, conversion: Conversion) -> list[str]:
    """Word the joint zeros that a conversion wrote.

    Args:
        stored: How the controller stores zeros.
        conversion: The conversion.

    Returns:
        Paragraphs: how the zeros are meant, a table of them, and one of the errors with them.
    """
    rounded = RoundedZeros.of(conversion.source, stored.with_ticks(conversion.options.ticks))
    rms_errors = RmsErrors.of(calibration_of(conversion.source), rounded)
    meaning = (
        "The best joint zeros if nothing else of the robot is corrected. While the robot stands still, the reading of "
        "each joint must go up by its zero (down if it is negative). After that taught points and the rest of this "
        "result are no longer valid: measure again."
    )
    return [
        fill(meaning),
        "\n".join(_table(rounded)),
        "\n".join(_errors(rms_errors)),
    ]


def _table(rounded: RoundedZeros) -> list[str]:
    """Return the lines of the table of zeros."""
    key = rounded.stored.key
    columns = [
        name_column("Joint"),
        Column("zero", 12, gap=2),
        Column("std", 10),
        Column("", 3, left=True),
        Column("to add" if key == "change" else f"change of {key}", 12, gap=2),
        Column("", 5, left=True),
    ]
    zeros = rounded.zeros
    rows = []
    for k, (name, unit) in enumerate(zip(zeros.joints, rounded.units, strict=True)):
        factor, symbol = joint_unit(prismatic=bool(rounded.prismatic[k]))
        if not zeros.determined[k]:
            rows.append([name, "not determined", "", "", "leave as it is", ""])
            continue
        delta = number(factor * zeros.delta[k], _DIGITS, "+")
        std = number(factor * zeros.std[k], _DIGITS)
        change = number(rounded.numbers[k], unit.decimals, "+")
        rows.append([name, delta, std, symbol, change, unit.name])
    return table_lines(columns, rows)


def _errors(rms_errors: RmsErrors) -> list[str]:
    """Return the lines of the table of errors."""
    units = list(rms_errors.zeros)
    heads = [f"[{RESIDUAL_UNITS[unit].shown}]" for unit in units]
    columns = [
        name_column(f"Rms error of {_ROWS[rms_errors.rows]}"),
        *(Column(h, 10) for h in heads),
    ]
    robots: list[tuple[str, Mapping[str, float] | None]] = [
        ("nominal robot", rms_errors.nominal),
        ("joint zeros alone", rms_errors.zeros),
        ("joint zeros alone, rounded as written", rms_errors.rounded),
        ("whole calibration", rms_errors.calibrated),
        ("with the non-geometric model", rms_errors.non_geometric),
    ]
    rows = []
    for name, errors in robots:
        if errors is not None:
            rows.append([name, *(shown(errors[unit], unit) for unit in units)])
    return table_lines(columns, rows)
