"""What a conversion has to say: codes with values; `calib.text.convert` has the sentences."""

from __future__ import annotations

from typing import Literal, NamedTuple

Code = Literal[
    "arm not certain",
    "nominal hash",
    "not linearised",
    "base displaced",
    "flange displaced",
    "other lines kept",
    "other lines left out",
    "joints without origin",
    "geometry alone",
    "nearly parallel axes",
    "joints without value",
]


class Note(NamedTuple):
    """A code and its values, in SI units."""

    code: Code
    values: tuple[str | float, ...] = ()
