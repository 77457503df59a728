"""How well an instrument measures: the standard deviation of one coordinate.

Of a laser tracker, at a distance d, with the robot's own repeatability beside it:

    sigma^2 = (constant + per_length d)^2 + repeatability^2

Both of its numbers are taken as standard deviations of each coordinate. Data sheets print largest errors; what follows
from them here is on the safe side.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from calib.errors import CalibError, choices
from calib.measure.cell_parts import is_number
from calib.units import UNITS, symbols

Length = TypeVar("Length", float, NDArray[np.float64])

_NUMBER = r"([\d.]+(?:[eE][+-]?\d+)?)\s*([A-Za-zµμ]+)"
_PATTERN = re.compile(rf"\s*{_NUMBER}\s*(?:\+\s*{_NUMBER}\s*/\s*m\s*)?", re.UNICODE)


@dataclass(frozen=True, slots=True)
class TrackerNoise:
    """The noise of a laser tracker and of the robot that it looks at; see the module's text.

    The default is a Leica AT901's 15 um + 6 um/m and a robot's 0.02 mm (the paper, section 2).

    Attributes:
        constant: [m].
        per_length: [m/m].
        repeatability: Of the robot, [m].
    """

    constant: float = 15e-6
    per_length: float = 6e-6
    repeatability: float = 20e-6

    def __post_init__(self) -> None:
        """Refuse what is no standard deviation, and three zeros."""
        values = (self.constant, self.per_length, self.repeatability)
        if not all(is_number(v) and v >= 0.0 for v in values) or not any(values):
            raise CalibError(
                f"The noise is {self.constant!r} m + {self.per_length!r} m/m, the repeatability {self.repeatability!r} "
                "m; they must be numbers, none below 0 and not all 0."
            )

    def std(self, distance: Length) -> Length:
        """Standard deviation of one coordinate at a distance from the instrument, a float or an array [m]."""
        result: Length = (
            (self.constant + self.per_length * distance) ** 2 + self.repeatability**2
        ) ** 0.5
        return result


def parse_noise(text: str, what: str, repeatability: float = 0.0) -> TrackerNoise:
    """``15 um + 6 um/m``, or ``0.05 mm``, as a noise.

    Args:
        text: One length, or two of which the second is for each metre of distance.
        what: Where it was given, for the message.
        repeatability: Of the robot, [m].

    Raises:
        CalibError: Anything else.
    """
    match = _PATTERN.fullmatch(text)
    units = [] if match is None else [u for u in (match[2], match[4]) if u is not None]
    units = ["um" if u in ("µm", "μm") else u for u in units]
    if match is None or not set(units) <= set(symbols("length")):
        raise CalibError(
            f'{what} was given as "{text}"; it must be a length, such as "0.05 mm", or a length and one for each metre '
            f'of distance, such as "15 um + 6 um/m". The units are {choices(symbols("length"))}.'
        )
    try:
        values = [
            float(v) * UNITS[u].to_si for v, u in zip((match[1], match[3]), units, strict=False)
        ]
    except ValueError as error:
        raise CalibError(
            f'{what} was given as "{text}", where a number cannot be read; write it such as "0.05 mm" or '
            '"15 um + 6 um/m".'
        ) from error
    return TrackerNoise(values[0], values[1] if len(values) > 1 else 0.0, repeatability)
