"""Errors that calib raises on purpose, with texts that tell the reader how to mend the cause.

Every one is a `CalibError`, whose text says what was given and where, what is allowed, and what to do. The command line
prints that text alone; a program catches the class.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable

#: Characters that a terminal obeys or cannot print: controls, changes of the reading direction, lone surrogates.
_UNPRINTABLE = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069\ud800-\udfff]"
)

#: A longer message quotes a file that is none, and is shortened [characters].
_LONGEST = 3000

#: Characters kept of the beginning of a shortened message.
_HEAD = 1500

#: Characters kept of the end of a shortened message.
_TAIL = 1000


class CalibError(Exception):
    """Something given to calib cannot be used; the text says what, where and how to mend it.

    What it quotes of a file is made printable, and the middle of a very long text is left out.
    """

    def __init__(self, message: str = "") -> None:
        text = _UNPRINTABLE.sub(lambda match: f"\\u{ord(match[0]):04x}", message)
        if len(text) > _LONGEST:
            text = f"{text[:_HEAD]} [...] {text[-_TAIL:]}"
        super().__init__(text)


class ArgumentError(CalibError, TypeError):
    """An argument of a function has a wrong type; the text names it, what was given, and what is allowed."""


class UrdfError(CalibError):
    """A URDF cannot be read, has no such link or joint, or cannot be written back faithfully."""


class MeasurementError(CalibError):
    """A table of measurements cannot be read; the text names the file, the row and the column."""


class ModelError(CalibError):
    """The error model given does not exist or does not fit the robot and the measurements."""


class SolverError(CalibError):
    """A solver did not reach a result that can be given out."""


class FileError(CalibError):
    """A file cannot be read or written: it exists already, its folder does not, or it changed."""


class DeviceError(CalibError):
    """An instrument or a robot that a session reads cannot be opened, does not answer, or was lost."""


class PluginError(CalibError):
    """A plugin cannot be loaded, or a name that it registers is needed and it is not loaded."""


class VerdictError(CalibError):
    """A result whose verdict is ``do not use`` was to be made into something for a robot, and was not accepted."""


def choices(names: Iterable[str], limit: int = 12) -> str:
    """Return the allowed names as text for a message, each in quotes.

    Args:
        names: The names, in the order in which they are listed.
        limit: The largest number of names listed; of more, the number of the others follows.
    """
    names = list(names)
    text = ", ".join(f"'{name}'" for name in names[:limit])
    if len(names) > limit:
        return f"{text} and {len(names) - limit} more"
    return text


def did_you_mean(name: str, names: Iterable[str]) -> str:
    """Return a question with the names most like the one given, as the end of a message.

    Args:
        name: The name that does not exist.
        names: The names that do; upper and lower case count as the same.

    Returns:
        Such as ``" (did you mean 'elbow_joint'?)"``; empty if no name is like it.
    """
    by_folded = {known.casefold(): known for known in names}
    matches = difflib.get_close_matches(str(name).casefold(), by_folded, n=3)
    if not matches:
        return ""
    quoted = [repr(by_folded[match]) for match in matches]
    return f" (did you mean {' or '.join(quoted)}?)"
