"""Readers: how a session gets what instruments measure; yours is one more.

A reader is named on the command line with what it reads, ``--reader watch:exports/``. Its entry opens an instrument: an
object that is asked for one reading after the other.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import calib.basics.plugins as plugins
from calib.errors import DeviceError, choices
from calib.verbs.measure.devices.files import FileReader, FolderReader
from calib.verbs.measure.devices.lines import InputReader, TcpReader
from calib.verbs.measure.devices.reading import Context, Reading
from calib.verbs.measure.devices.virtual import virtual_instrument
from calib.verbs.measure.devices.webcam import WebcamReader

__all__ = ["READERS", "Context", "Instrument", "Reader", "Reading", "open_reader", "register"]


class Instrument(Protocol):
    """An instrument that is open; one with a method ``propose(joints)`` is told each pose before it is read."""

    def read(self, timeout: float | None = None) -> Reading | None:
        """Return the next reading; wait for it at most ``timeout`` seconds, and return None if nothing came.

        A CalibError says what is wrong; the next call goes on after it.
        """
        ...

    def close(self) -> None:
        """Give the instrument back."""
        ...


@dataclass(frozen=True, slots=True)
class Reader:
    """A way to open an instrument."""

    #: What it reads, for help texts: ``"new rows of a file"``.
    words: str
    #: Opens it: from what stands after the name on the command line, perhaps empty, and from the context.
    open: Callable[[str, Context], Instrument]
    #: True if it measures at each call of ``read``, as a camera does: it is called when the robot stands at a pose.
    #: False if ``read`` waits for what a person, or another program, measures.
    is_asked: bool = False


#: The readers by name.
READERS: dict[str, Reader] = {
    "file": Reader("new rows of a table or of a list of points, file:points.txt", FileReader),
    "watch": Reader(
        "tables, lists and pictures that appear in a folder, watch:exports/", FolderReader
    ),
    "stdin": Reader("lines of standard input", InputReader),
    "tcp": Reader(
        "lines of an instrument, tcp:192.168.0.20:5000, or of programs of this machine, tcp:listen=5000",
        TcpReader,
    ),
    "webcam": Reader("pictures of a camera at this machine, webcam:0", WebcamReader, is_asked=True),
    "virtual": Reader(
        "a virtual robot with errors of a seed, to rehearse: virtual:3, or virtual:3,mistakes",
        virtual_instrument,
    ),
}

plugins.watch("readers", READERS)


def register(name: str, reader: Reader) -> None:
    """Add a reader, which sessions can then name.

    Args:
        name: Its name, which no other reader has, without a colon.
        reader: What it reads, and how it is opened.

    Raises:
        DeviceError: The name is taken or has a colon.
    """
    if name in READERS or ":" in name or not name:
        raise DeviceError(
            f"The reader '{name}' needs a name without a colon, other than {choices(READERS, 60)}."
        )
    READERS[name] = reader


def open_reader(text: str, context: Context) -> Instrument:
    """Open an instrument.

    Args:
        text: Name of a reader and what it reads, ``"watch:exports/"``.
        context: What it may need to know of the session.

    Returns:
        The instrument, to be closed by the caller.

    Raises:
        DeviceError: There is no such reader, or the instrument cannot be opened.
    """
    name, _, argument = text.partition(":")
    if name not in READERS:
        raise DeviceError(plugins.unknown("readers", name, READERS))
    return READERS[name].open(argument, context)
