"""Joint zeros as `calib convert` prints them: what to add to each reading, what is stored, and the errors with them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

from calib.basics.channels import RESIDUAL_UNITS
from calib.show.lines import fill, number
from calib.show.sizes import shown
from calib.show.tables import Column, name_column, table_lines
from calib.show.words import joint_unit
from calib.verbs.convert.zeros.rms_errors import RmsErrors
from calib.verbs.convert.zeros.rounding import STORED, RoundedZeros, calibration_of, stored_number

if TYPE_CHECKING:
    from calib.verbs.convert.convert import Conversion

#: Decimals of zeros and their standard deviations [deg, mm].
_DIGITS = 4

#: Words for the rows of the errors, by `RmsErrors.rows`.
_ROWS = {
    "held-out": "held-out rows, outliers aside",
    "validation": "validation rows",
    "estimation": "fitted rows, which prove nothing",
}


def has_zeros(conversion: Conversion) -> bool:
    """Tell if a conversion wrote joint zeros."""
    return conversion.format in STORED


def zeros_text(conversion: Conversion) -> list[str]:
    """Word the joint zeros that a conversion wrote.

    Args:
        conversion: The conversion, to one of `calib.verbs.convert.zeros.rounding.STORED`.

    Returns:
        Paragraphs: how the zeros are meant, a table of them, and one of the errors with them.
    """
    stored = stored_number(conversion.format, conversion.options.ticks)
    rounded = RoundedZeros.of(conversion.source, stored)
    rms_errors = RmsErrors.of(calibration_of(conversion.source), rounded)
    meaning = (
        "The best joint zeros where nothing else of the robot is corrected. While the robot stands still, the reading "
        "of each joint must go up by its zero (down where it is negative). Then taught points and the rest of this "
        "result no longer hold: measure again."
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
    return table_lines(columns, _rows(rounded))


def _rows(rounded: RoundedZeros) -> Iterator[list[str]]:
    """Yield the cells of each joint."""
    zeros = rounded.zeros
    for k, (name, unit) in enumerate(zip(zeros.joints, rounded.units, strict=True)):
        factor, symbol = joint_unit(prismatic=bool(rounded.prismatic[k]))
        if not zeros.determined[k]:
            yield [name, "not determined", "", "", "leave as it is", ""]
            continue
        yield [
            name,
            number(factor * zeros.delta[k], _DIGITS, "+"),
            number(factor * zeros.std[k], _DIGITS),
            symbol,
            number(rounded.numbers[k], unit.decimals, "+"),
            unit.name,
        ]


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
