"""Readers of lines that an instrument sends, a line a row: by standard input, or through a TCP connection.

The lines have a header with units first, as a table, or are numbers in the order of the columns that the context names.
A line ends with a line feed, a carriage return, or both; what has no end yet waits for the rest.
"""

from __future__ import annotations

import contextlib
import os
import queue
import re
import select
import socket
import sys
import threading
import time

from calib.basics.tables import decoded, has_header
from calib.errors import CalibError, DeviceError, MeasurementError
from calib.verbs.measure.devices.reading import Context, Reading
from calib.verbs.measure.devices.rows import has_content, refused, row_below, rows_of
from calib.verbs.measure.devices.waiting import WaitingReader

#: A longer line is none [bytes].
_LONGEST = 65_536

#: Bytes that are taken at once.
_PIECE = 65_536

#: How a browser begins, which any web page may send here.
_HTTP = re.compile(rb"[A-Z]+ \S+ HTTP/")

#: Time between two attempts to connect again [s].
_AGAIN = 1.0

#: How long the first connection may take [s].
_FIRST = 5.0


class LineRows:
    """Rows from bytes as they come: cuts them into lines, and reads these below the header."""

    def __init__(self, source: str, context: Context) -> None:
        self._source = source
        self._context = context
        self._header = ""
        self._number = 0
        #: The beginning of a line whose end has not come.
        self.rest = b""

    def feed(self, data: bytes) -> list[Reading | CalibError]:
        """Take what has come, and return the reading or the error of each line that is complete with it."""
        *lines, self.rest = (self.rest + data).replace(b"\r", b"\n").split(b"\n")
        found: list[Reading | CalibError] = []
        if len(self.rest) > _LONGEST:
            self.rest, fault = b"", f"{self._source}: a line has no end after {_LONGEST} bytes."
            found.append(MeasurementError(f"{fault} End each row with a line feed."))
        for line in filter(None, lines):
            self._number += 1
            try:
                found += self._read(line)
            except CalibError as error:
                found.append(error)
        return found

    def finish(self) -> list[Reading | CalibError]:
        """Take the last line, which nothing follows any more."""
        return self.feed(b"\n")

    def _read(self, data: bytes) -> list[Reading]:
        """Return the reading of a line; none of a header or a remark. MeasurementError if it is malformed."""
        line = decoded(data, self._source)
        if not has_content(line) or line == self._header:
            return []
        if has_header(line):
            self._header = line
            return []
        if self._header:
            row = row_below(self._header, line, self._number, self._source)
        elif self._context.columns:
            above = "\n" * (self._number - 1)  # so that a message names the line
            (row,) = rows_of(f"{above}{line}", self._source, self._context)
        else:
            raise refused(
                line,
                self._number,
                self._source,
                "comes without a header; send one first, 'x [mm],y [mm],z [mm]', or name the columns",
            )
        return [Reading.of(row.cells, source=f"{self._source}, line {self._number}")]


class InputReader(WaitingReader):
    """Gives the lines of standard input."""

    def __init__(self, argument: str, context: Context) -> None:
        super().__init__()
        if argument:
            raise DeviceError(f"The reader 'stdin' takes nothing after its name, not '{argument}'.")
        self._rows = LineRows("standard input", context)
        self._pieces: queue.Queue[bytes] = queue.Queue()
        # A read of Python's own buffer would hold its lock when the program ends.
        descriptor = sys.stdin.fileno()
        threading.Thread(target=self._pump, args=(descriptor,), daemon=True).start()

    def _pump(self, descriptor: int) -> None:
        """Pass on what comes, and an empty piece at the end; in a thread, for Windows cannot wait for a pipe."""
        piece = b"?"
        while piece:
            try:
                piece = os.read(descriptor, _PIECE)
            except OSError:
                piece = b""
            self._pieces.put(piece)

    def _look(self, seconds: float) -> None:
        """Take the next piece, or say that there are no more."""
        try:
            piece = self._pieces.get(timeout=seconds)
        except queue.Empty:
            return
        if piece:
            self._ready.extend(self._rows.feed(piece))
            return
        self._ready.extend(self._rows.finish())
        self._ready.append(DeviceError("Standard input has ended: there are no more readings."))
        self._pieces.put(b"")  # the next call learns the same


class TcpReader(WaitingReader):
    """Gives the lines that come through TCP connections: to an instrument, or from programs on this machine."""

    def __init__(self, argument: str, context: Context) -> None:
        super().__init__()
        self._context = context
        self._name = f"tcp:{argument}"
        self._listening: socket.socket | None = None
        #: The connections, each with its lines.
        self._connections: dict[socket.socket, LineRows] = {}
        self._connecting: socket.socket | None = None
        self._address: tuple[int, tuple[object, ...]] | None = None
        self._tried = time.monotonic()
        #: The port at which programs of this machine can connect; None of a connection to an instrument.
        self.port: int | None = None
        host, _, port = argument.rpartition(":")
        word, is_listening, listening_port = argument.partition("=")
        if is_listening and word == "listen":
            self._listen(_port(listening_port, argument))
        else:
            self._connect_first(host.strip("[]"), _port(port, argument), argument)

    def _listen(self, port: int) -> None:
        """Wait for programs of this machine; DeviceError if the port is taken."""
        try:
            self._listening = socket.create_server(("127.0.0.1", port))
        except OSError as error:
            raise DeviceError(
                f"{self._name}: nobody can connect at port {port}: {error.strerror}. Choose another port."
            ) from error
        self._listening.setblocking(False)
        self.port = self._listening.getsockname()[1]

    def _connect_first(self, host: str, port: int, argument: str) -> None:
        """Connect to an instrument; DeviceError if it does not answer."""
        if not host:
            raise DeviceError(
                f"The reader 'tcp' needs an address, and '{argument}' is none: tcp:192.168.0.20:5000 connects to an "
                "instrument, tcp:listen=5000 waits for a program of this machine."
            )
        try:
            connection = socket.create_connection((host, port), timeout=_FIRST)
        except (OSError, UnicodeError) as error:
            raise DeviceError(
                f"{self._name}: no connection to '{host}', port {port}: {_reason(error)}. Check address and port, and "
                "that the instrument sends."
            ) from error
        self._address = (connection.family, connection.getpeername())
        self._add(connection)

    def _add(self, connection: socket.socket) -> None:
        """Read from a connection from now on."""
        connection.setblocking(False)
        with contextlib.suppress(OSError):
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        self._connections[connection] = LineRows(self._name, self._context)

    def _look(self, seconds: float) -> None:
        """Take what has come through any connection, and connect again where one was lost."""
        if self._address is not None and not self._connections:
            self._connect_again(seconds)
        reading = [*self._connections]
        if self._listening is not None:
            reading.append(self._listening)
        if not reading:
            return
        try:
            ready, _, _ = select.select(reading, [], [], seconds)
        except (OSError, ValueError):  # closed in another thread
            return
        for connection in ready:
            if connection is self._listening:
                with contextlib.suppress(OSError):
                    self._add(connection.accept()[0])
                continue
            self._receive(connection)

    def _connect_again(self, seconds: float) -> None:
        """Try to connect again, once a second, and wait for the answer at most so long."""
        assert self._address is not None
        family, address = self._address
        if self._connecting is None:
            if time.monotonic() - self._tried < _AGAIN:
                self._closed.wait(seconds)
                return
            self._tried = time.monotonic()
            self._connecting = socket.socket(family, socket.SOCK_STREAM)
            self._connecting.setblocking(False)
            self._connecting.connect_ex(address)
        _, writable, failed = select.select([], [self._connecting], [self._connecting], seconds)
        if not writable and not failed:
            return
        connection, self._connecting = self._connecting, None
        if connection.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
            connection.close()
        else:
            self._add(connection)

    def _receive(self, connection: socket.socket) -> None:
        """Take what has come through a connection, or leave it if it has ended."""
        rows = self._connections[connection]
        try:
            data = connection.recv(_PIECE)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if self._listening is not None and _HTTP.match(data):
            self._drop(connection)
            self._ready.append(
                MeasurementError(f"{self._name}: a browser has connected, which is no instrument.")
            )
            return
        if data:
            self._ready.extend(rows.feed(data))
            return
        self._drop(connection)
        self._tried = time.monotonic()
        half = rows.rest.decode("utf-8", "replace").strip()
        if half:
            self._ready.append(
                MeasurementError(
                    f"{self._name}: the connection ended within the line '{half[:80]}'. It is left out; measure this "
                    "point again, and end each row with a line feed."
                )
            )
        if self._address is not None:
            self._ready.append(
                DeviceError(f"{self._name}: the connection was lost. It is sought again by itself.")
            )

    def _drop(self, connection: socket.socket) -> None:
        """Read no longer from a connection."""
        del self._connections[connection]
        connection.close()

    def close(self) -> None:
        """Close all connections."""
        super().close()
        for connection in (*self._connections, self._listening, self._connecting):
            if connection is not None:
                connection.close()


def _port(text: str, argument: str) -> int:
    """Return the number of a port; DeviceError if the text is none."""
    if text.isascii() and text.isdigit() and int(text) < 65_536:
        return int(text)
    raise DeviceError(
        f"The reader 'tcp' needs a port from 1 to 65535, and '{argument}' has none: tcp:192.168.0.20:5000, or "
        "tcp:listen=5000 for a program of this machine."
    )


def _reason(error: Exception) -> str:
    """Return what the system says of a connection."""
    return str(getattr(error, "strerror", None) or error)
