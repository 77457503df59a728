"""Record of a measurement: who measured what for whom, where, when and with what, for reports and result files.

Nothing is computed from it. What is not given stays blank, to be filled in by hand on the printed report.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields

from calib.basics.units import is_number
from calib.errors import CalibError

#: Letters of an entry at most: a report's first page has to hold all of them.
LONGEST = 60

#: Letters of the note at most.
LONGEST_NOTE = 160

#: Least and greatest air temperature [°C]: a number outside is in another unit.
TEMPERATURES_C = (-50.0, 80.0)

#: The two temperatures of a range: at the start and at the end.
_ENDS = 2


@dataclass(frozen=True, slots=True)
class Record:
    """The record of a measurement, ``[record]`` of a cell file; an entry that is not given is empty.

    Raises:
        CalibError: An entry is longer than `LONGEST` characters, the note than `LONGEST_NOTE`, or a temperature is no
            number or out of range.
    """

    #: Who the report is for
    customer: str = ""
    #: Number of the order
    order: str = ""
    #: Serial number of the arm
    robot_serial: str = ""
    #: Serial number of its controller
    controller_serial: str = ""
    #: What the robot carried: ``"5 kg, 60 mm from the flange"``
    load: str = ""
    #: Speed between the poses
    speed: str = ""
    #: How the robot was warmed up
    warm_up: str = ""
    #: The measuring instrument
    instrument: str = ""
    #: Its serial number
    instrument_serial: str = ""
    #: Until when its calibration is valid
    calibration_due: str = ""
    #: Where the measuring uncertainty is from: a certificate, a budget
    uncertainty_from: str = ""
    #: Where the robot was measured
    place: str = ""
    #: When
    date: str = ""
    #: Air temperature [°C]: one, or those at the start and at the end; empty: not given
    temperature_C: tuple[float, ...] = ()
    #: Who measured
    operator: str = ""
    #: Anything else
    note: str = ""

    def __post_init__(self) -> None:
        """Join the lines of each text, and check lengths and temperatures."""
        for name in TEXTS:
            text = getattr(self, name)
            if not isinstance(text, str):
                raise CalibError(f"A record's {name} is {text!r}; it must be a text.")
            text = " ".join(text.split())
            room = LONGEST_NOTE if name == "note" else LONGEST
            if len(text) > room:
                raise CalibError(
                    f"A record's {name} has {len(text)} characters; there is room for {room}."
                )
            object.__setattr__(self, name, text)
        object.__setattr__(self, "temperature_C", _temperatures(self.temperature_C))

    @property
    def given(self) -> dict[str, str | tuple[float, ...]]:
        """The entries that are not empty, by name, in the order of the fields."""
        return {name: value for name, value in asdict(self).items() if value}


#: Names of the entries that are texts.
TEXTS = tuple(entry.name for entry in fields(Record) if entry.name != "temperature_C")


def _temperatures(values: object) -> tuple[float, ...]:
    """Return no, one or two temperatures [°C] as a tuple; `CalibError` for anything else."""
    low, high = TEMPERATURES_C
    given = tuple(values) if isinstance(values, (tuple, list)) else (values,)
    if len(given) <= _ENDS and all(is_number(value) and low <= value <= high for value in given):
        return tuple(float(value) for value in given)
    raise CalibError(
        f"A record's temperature_C is {values!r}; it must be one number or two, at the start and at the end, from "
        f"{low:g} to {high:g} °C."
    )


#: A record without any entry.
BLANK = Record()
