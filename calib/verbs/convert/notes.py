"""Notes of a conversion: what is not as it seems, or has no place in a file, as codes and values."""

from __future__ import annotations

from typing import Literal, NamedTuple

#: What a note is about; `calib.verbs.convert.text` has a sentence for each.
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
    "coupled readings",
    "rows read",
    "rows written",
    "zeros not determined",
    "zeros not validated",
    "zeros no better",
    "changes alone",
    "comments not kept",
    "times gear ratio",
    "end positions move",
]


class Note(NamedTuple):
    """A note of a conversion."""

    #: What it is about.
    code: Code
    #: What its sentence names, in SI units [m], [rad].
    values: tuple[str | float, ...] = ()
