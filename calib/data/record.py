"""Record of a measurement: who measured what for whom, where, when and with what, for reports and result files.

Nothing is computed from it. What is not given stays blank, to be filled in by hand on the printed report.
"""

from __future__ import annotations

import re
from dataclasses import asdict, dataclass, fields
from datetime import date
from typing import Any

from calib.basics.records import keep_checked, key
from calib.basics.units import is_number
from calib.basics.value_forms import Check, form
from calib.errors import CalibError

#: Letters of an entry at most: a report's first page has to hold all of them.
LONGEST = 60

#: Letters of the note at most.
LONGEST_NOTE = 160

#: Least and greatest air temperature [°C]: a number outside is in another unit.
TEMPERATURES_C = (-50.0, 80.0)

#: Least and greatest relative humidity [%].
HUMIDITIES_PERCENT = (0.0, 100.0)

#: The two values of a range: at the start and at the end.
_ENDS = 2


def _text_or_none(value: Any) -> str | None:  # noqa: ANN401
    """Return a text, a whole number such as a serial number, or a date of a file as text; None for others."""
    if isinstance(value, date):
        return value.isoformat()
    is_count = isinstance(value, int) and not isinstance(value, bool)
    return str(value) if is_count or isinstance(value, str) else None


_TEXT = form("a text in quotes, a whole number or a date", _text_or_none)


def _entry(name: str, meaning: str, room: int = LONGEST) -> Any:  # noqa: ANN401  a field
    """Return the field of an entry that is a text, kept in one line; CalibError for more than ``room`` characters."""

    def one_line(value: object) -> str | None:
        """Return a text in one line, None for anything else; CalibError if it is too long."""
        if not isinstance(value, str):
            return None
        line = " ".join(value.split())
        if len(line) > room:
            raise CalibError(
                f"A record's {name} has {len(line)} characters; there is room for {room}."
            )
        return line

    check = Check("a text", one_line)
    return key(name, _TEXT, meaning, default="", absent="blank", check=check)


def _ends_or_none(value: Any) -> tuple[Any, ...] | None:  # noqa: ANN401
    """Return one number of a file, or a list of two, as a tuple; None for others."""
    values = value if isinstance(value, list) else [value]
    return tuple(values) if all(map(is_number, values)) else None


def _ends(name: str, meaning: str, least: float, most: float, unit: str) -> Any:  # noqa: ANN401  a field
    """Return the field of an entry that is a number, or two: at the start and at the end; CalibError out of range."""

    def within(values: object) -> tuple[float, ...] | None:
        """Return a tuple of no, one or two numbers in the range; None for anything else."""
        given = tuple(values) if isinstance(values, (tuple, list)) else (values,)
        if len(given) <= _ENDS and all(
            is_number(value) and least <= value <= most for value in given
        ):
            return tuple(float(value) for value in given)
        return None

    what = f"one number or two, at the start and at the end, from {least:g} to {most:g} {unit}"
    return key(
        name,
        form("a number, or a list of two: [21.5, 23.0]", _ends_or_none),
        meaning,
        absent="blank",
        check=Check(what, within),
        default=(),
    )


def _country_or_none(value: object) -> str | None:
    """Return a country's code of two capital letters, or an empty text; None for anything else."""
    is_code = isinstance(value, str) and (not value or re.fullmatch("[A-Z]{2}", value))
    return str(value) if is_code else None


@dataclass(frozen=True, slots=True)
class Record:
    """The record of a measurement, ``[record]`` of a cell file; an entry that is not given is empty.

    The entries after the note are those that only a certificate has.

    Raises:
        CalibError: An entry is longer than `LONGEST` characters, the note than `LONGEST_NOTE`; a temperature or
            humidity is not a number or out of range; or the country is not of two letters.
    """

    customer: str = _entry("customer", "Who the report is for.")
    order: str = _entry("order", "Number of the order.")
    robot_serial: str = _entry("robot_serial", "Serial number of the arm.")
    controller_serial: str = _entry("controller_serial", "Serial number of its controller.")
    load: str = _entry("load", 'What the robot carried, such as "5 kg, 60 mm from the flange".')
    speed: str = _entry("speed", "Speed between the poses.")
    warm_up: str = _entry("warm_up", "How the robot was warmed up.")
    instrument: str = _entry("instrument", "The measuring instrument.")
    instrument_serial: str = _entry("instrument_serial", "Its serial number.")
    calibration_due: str = _entry("calibration_due", "Date until which its calibration is valid.")
    uncertainty_from: str = _entry(
        "uncertainty_from", "Source of the measurement uncertainty: a certificate, a budget."
    )
    place: str = _entry("place", "Where the robot was measured.")
    date: str = _entry("date", "When it was measured; histories read 2026-03-01.")
    #: [°C], one, or those at the start and at the end; empty: not given
    temperature_C: tuple[float, ...] = _ends(
        "temperature_C",
        "Air temperature [°C]: one, or those at the start and at the end.",
        *TEMPERATURES_C,
        "°C",
    )
    operator: str = _entry("operator", "Who measured.")
    note: str = _entry("note", "Anything else.", LONGEST_NOTE)
    certificate_number: str = _entry("certificate_number", "Number of the certificate.")
    laboratory: str = _entry("laboratory", "The laboratory that signs the certificate.")
    country: str = key(
        "country",
        _TEXT,
        'The laboratory\'s country, two letters of ISO 3166-1: "DE".',
        default="",
        absent="blank",
        check=Check("two capital letters, such as 'DE'", _country_or_none),
    )
    responsible: str = _entry("responsible", "Who answers for the certificate.")
    robot: str = _entry("robot", "Maker and model of the robot.")
    instrument_certificate: str = _entry(
        "instrument_certificate", "Number of the instrument's own certificate."
    )
    instrument_calibrated: str = _entry(
        "instrument_calibrated", "When the instrument was calibrated."
    )
    traceability: str = _entry(
        "traceability", "The standards that the instrument is traceable to, and by whom."
    )
    sequence: str = _entry("sequence", "Order in which the poses were measured.")
    valid_until: str = _entry("valid_until", "Until when, as agreed with the customer.")
    #: [%], one, or those at the start and at the end; empty: not given
    humidity_percent: tuple[float, ...] = _ends(
        "humidity_percent",
        "Relative humidity of the air [%]: one, or those at the start and at the end.",
        *HUMIDITIES_PERCENT,
        "%",
    )

    def __post_init__(self) -> None:
        """Join the lines of each text, and check lengths and temperatures."""
        keep_checked(self, "record")

    @property
    def given(self) -> dict[str, str | tuple[float, ...]]:
        """The entries that are not empty, by name, in the order of the fields."""
        return {name: value for name, value in asdict(self).items() if value}


#: Names of the entries that are texts.
TEXTS = tuple(entry.name for entry in fields(Record) if not isinstance(entry.default, tuple))

#: Names of the texts that only a certificate has.
FOR_CERTIFICATES = TEXTS[TEXTS.index("note") + 1 :]


#: A record without any entry.
BLANK = Record()
