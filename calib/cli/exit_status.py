"""The exit statuses of the program, in one place; docs/command-line.md has them as a table."""

from __future__ import annotations

from enum import IntEnum


class ExitStatus(IntEnum):
    """Exit status of a call of the program."""

    DONE = 0  #: Everything was done.
    REFUSED = 1  #: An error, or a robot of a fleet that failed.
    WRONG_CALL = 2  #: An unknown option or argument, or a value that it does not take.
    #: Something for a robot was withheld because of a verdict ``do not use``, a tolerance was not shown to be kept,
    #: something has moved since a calibration, or a result that was made again is not equal.
    NOT_ACCEPTED = 3
    INTERRUPTED = 130  #: Ctrl-C.
