"""A controller that speaks Universal Robots' RTDE, protocol version 2, with its joints where the test puts them."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
import time
from collections.abc import Sequence
from types import TracebackType

#: Type and format of the variables that the server has; any other is NOT_FOUND.
_VARIABLES = {
    "timestamp": ("DOUBLE", "d"),
    "actual_q": ("VECTOR6D", "6d"),
    "actual_qd": ("VECTOR6D", "6d"),
    "robot_mode": ("INT32", "i"),
}


def package(kind: str, payload: bytes = b"") -> bytes:
    return struct.pack(">HB", 3 + len(payload), ord(kind)) + payload


def message(text: str, level: int = 2) -> bytes:
    words, source = text.encode(), b"server"
    payload = bytes([len(words)]) + words + bytes([len(source)]) + source + bytes([level])
    return package("M", payload)


class Server:
    """Serves one connection after the other on loopback, until the block ends."""

    def __init__(
        self,
        q: Sequence[float] = (0.1, -1.2, 1.3, -0.4, 0.5, 0.6),
        *,
        host: str = "127.0.0.1",
        port: int = 0,
        versions: Sequence[int] = (1, 2),
        has_joints: bool = True,
        starts: bool = True,
    ) -> None:
        self.q = list(q)
        #: Speed of all joints [rad/s], by which they move while the server sends.
        self.speed = 0.0
        #: Sends nothing while it is set, as a controller that hangs.
        self.silent = threading.Event()
        #: Bytes that are sent at once: 1 parts every package.
        self.piece = 10_000
        #: What the clients sent, by the letters of the packages.
        self.asked = ""
        self._versions, self._has_joints, self._starts = versions, has_joints, starts
        self._listening = socket.create_server((host, port))
        self.port: int = self._listening.getsockname()[1]
        self._connection: socket.socket | None = None
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)

    def __enter__(self) -> Server:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._closed.set()
        with contextlib.suppress(OSError):
            self._listening.shutdown(socket.SHUT_RDWR)
        self._listening.close()
        self.drop()
        self._thread.join(5)

    def drop(self) -> None:
        """Break the connection, as when the controller restarts."""
        if self._connection is not None:
            with contextlib.suppress(OSError):
                self._connection.shutdown(socket.SHUT_RDWR)

    def say(self, text: str) -> None:
        """Send a text message to the client that is connected."""
        assert self._connection is not None
        self._connection.sendall(message(text))

    def _serve(self) -> None:
        while not self._closed.is_set():
            try:
                self._connection, _ = self._listening.accept()
            except OSError:
                return
            with self._connection, contextlib.suppress(OSError, struct.error):
                self._connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._talk(self._connection)

    def _talk(self, connection: socket.socket) -> None:
        """Answer the requests of one client; once it has started, send its recipe at the frequency that it wants."""
        received, recipe, interval, is_started = b"", [""], 0.008, False
        sent_at = time.monotonic()
        while not self._closed.is_set():
            connection.settimeout(0.001 if is_started else 0.05)
            with contextlib.suppress(TimeoutError):
                data = connection.recv(4096)
                if not data:
                    return
                received += data
            while len(received) >= 3 and len(received) >= struct.unpack_from(">H", received)[0]:
                size, kind = struct.unpack_from(">HB", received)
                payload, received = received[3:size], received[size:]
                self.asked += chr(kind)
                if chr(kind) == "V":
                    accepted = struct.unpack(">H", payload)[0] in self._versions
                    self._send(connection, package("V", bytes([accepted])))
                elif chr(kind) == "v":
                    self._send(connection, package("v", struct.pack(">4I", 5, 12, 0, 0)))
                elif chr(kind) == "O":
                    interval = 1.0 / struct.unpack_from(">d", payload)[0]
                    recipe = payload[8:].decode().split(",")
                    types = ",".join(self._type(name) for name in recipe)
                    self._send(connection, message("recipe", 3))
                    self._send(connection, package("O", bytes([1]) + types.encode()))
                elif chr(kind) == "S":
                    is_started = self._starts
                    self._send(connection, package("S", bytes([is_started])))
                elif chr(kind) == "P":
                    is_started = False
                    self._send(connection, package("P", bytes([True])))
            now = time.monotonic()
            if is_started and now - sent_at >= interval and not self.silent.is_set():
                self.q = [value + self.speed * (now - sent_at) for value in self.q]
                sent_at = now
                self._send(connection, package("U", bytes([1]) + self._values(recipe, now)))

    def _send(self, connection: socket.socket, data: bytes) -> None:
        for start in range(0, len(data), self.piece):
            connection.sendall(data[start : start + self.piece])

    def _type(self, name: str) -> str:
        if name == "actual_q" and not self._has_joints:
            return "NOT_FOUND"
        return _VARIABLES.get(name, ("NOT_FOUND", ""))[0]

    def _values(self, recipe: Sequence[str], now: float) -> bytes:
        values = {"timestamp": [now], "actual_q": self.q, "actual_qd": [self.speed] * 6}
        data = b""
        for name in recipe:
            data += struct.pack(f">{_VARIABLES[name][1]}", *values.get(name, [7]))
        return data
