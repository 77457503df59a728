"""Everything that calib refuses, said so that the reader can mend it.

Every error that calib raises on purpose is a `CalibError`, whose text says what was given and where, what is allowed,
and what to do. The command line prints that text alone; a program catches the class.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable

#: What a terminal would obey or cannot print: control characters, turns of the reading direction, half characters.
_UNPRINTABLE = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069\ud800-\udfff]"
)

#: A longer message quotes a file that is none; the middle is left out [characters].
_LONGEST, _HEAD, _TAIL = 3000, 1500, 1000


class CalibError(Exception):
    """Something given to calib cannot be used; the text says what, where and how to mend it.

    What it quotes of a file is made printable, and the middle of a very long text is left out.
    """

    def __init__(self, message: str = "") -> None:
        text = _UNPRINTABLE.sub(lambda found: f"\\u{ord(found[0]):04x}", message)
        if len(text) > _LONGEST:
            text = f"{text[:_HEAD]} [...] {text[-_TAIL:]}"
        super().__init__(text)


class UrdfError(CalibError):
    """A URDF cannot be read, has no such link or joint, or cannot be written back faithfully."""


class MeasurementError(CalibError):
    """A table of measurements cannot be read; the text names the file, the row and the column."""


class ModelError(CalibError):
    """The error model asked for does not exist or does not fit the robot and the measurements."""


class SolverError(CalibError):
    """A solver did not reach a result that can be given out."""


class FileError(CalibError):
    """A file cannot be read or written: it exists already, its folder does not, or it changed."""


class VerdictError(CalibError):
    """A result whose verdict is ``do not use`` was to be made into something for a robot, and was not accepted."""


def choices(names: Iterable[str], limit: int = 12) -> str:
    """The allowed names as text for a message: at most ``limit`` of them, then how many more."""
    listed = list(names)
    text = ", ".join(f"'{name}'" for name in listed[:limit])
    return text if len(listed) <= limit else f"{text} and {len(listed) - limit} more"


def did_you_mean(name: str, names: Iterable[str]) -> str:
    """The names most like the one given, in any case, as the end of a message; empty if none is like it."""
    plain = {one.casefold(): one for one in names}
    close = [plain[match] for match in difflib.get_close_matches(name.casefold(), plain, n=3)]
    return f" (did you mean {' or '.join(map(repr, close))}?)" if close else ""
