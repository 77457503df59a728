"""The joints of a robot of Universal Robots, by its Real-Time Data Exchange (RTDE), protocol version 2.

The controller serves RTDE at port 30004; nothing has to be installed or started there, and the robot is not moved. A
package is

    size (16 bits, with these three bytes), type (8 bits), payload

with numbers in network order. The client requests the protocol version (V), asks for the variable ``actual_q`` (O), and
starts (S) and pauses (P) the data packages (U); text messages (M) may come at any time. Here data flow only while joint
values are asked for: so they are never old ones, whatever waited in a buffer.
Source: Universal Robots, Real-Time Data Exchange (RTDE) Guide.

This client is calib's own. The package ``ur_rtde`` (1.6.5) repeats the last joint values without an error when the
controller is silent or the connection is lost, ends the whole program if the controller lacks a variable, stops all
threads while it connects, and has no wheels for Python 3.13, macOS and ARM.
"""

from __future__ import annotations

import contextlib
import socket
import struct
import time

import numpy as np

from calib.basics.arrays import Array, read_only
from calib.errors import DeviceError
from calib.verbs.measure.devices.reading import Context

#: Port of the controller.
PORT = 30_004

#: Version of the protocol, which controllers have from software 3.4 on.
_VERSION = 2

#: Data packages a second while they flow [Hz]; both series of controllers can.
_FREQUENCY = 125.0

#: How long the controller may take to connect, and to answer [s].
_PATIENCE = 2.0

#: Joints of every robot of Universal Robots.
_JOINTS = 6

#: Size and type of a package.
_HEADER = struct.Struct(">HB")

#: Payload of a data package: number of the recipe, joint values.
_DATA = struct.Struct(">B6d")

#: Kinds of text messages that say that something is wrong: exceptions, errors, warnings.
_BAD_NEWS = (0, 1, 2)


class RtdeController:
    """A connection to a controller, which is made again when it was lost."""

    def __init__(self, argument: str, context: Context) -> None:
        self._host, self._port = _address(argument)
        names = context.joint_names
        turning = [name for name in names if context.joint_types.get(name) != "prismatic"]
        if names and len(turning) != _JOINTS:
            raise DeviceError(
                f"The controller 'rtde' gives the {_JOINTS} joints of a robot of Universal Robots, and this robot has "
                f"{len(names)}, {len(turning)} of which turn. Choose base and tip of the arm alone, or type the joint "
                "values (--controller typed)."
            )
        self._socket: socket.socket | None = None
        self._received = b""
        #: What the controller said last that is wrong, for messages.
        self._said = ""
        self._connect()

    def joints(self) -> Array:
        """Return the joint values as the robot measures them now, shape (6,), [rad].

        Raises:
            DeviceError: The controller does not answer, even after connecting again.
        """
        try:
            return self._measured()
        except (OSError, DeviceError):
            self._connect()
        try:
            return self._measured()
        except OSError as error:
            self.close()
            raise self._failure("does not send joint values", error) from error

    def close(self) -> None:
        """End the connection."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _connect(self) -> None:
        """Connect, and agree on version and variable; DeviceError if that fails."""
        self.close()
        self._received = b""
        self._said = ""
        try:
            self._socket = socket.create_connection((self._host, self._port), timeout=_PATIENCE)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._agree()
        except (OSError, UnicodeError) as error:
            self.close()
            raise self._failure("does not answer", error) from error
        except DeviceError:
            self.close()
            raise

    def _agree(self) -> None:
        """Agree on version and variable; DeviceError if the controller lacks one, OSError if it does not answer."""
        if self._ask("V", struct.pack(">H", _VERSION)) != b"\x01":
            raise DeviceError(
                f"The controller at '{self._host}' does not speak version {_VERSION} of RTDE. Update its software to "
                "3.4 or newer, or type the joint values (--controller typed)."
            )
        kind = self._ask("O", struct.pack(">d", _FREQUENCY) + b"actual_q")[1:]
        if kind != b"VECTOR6D":
            given = kind.decode("ascii", "replace")
            raise DeviceError(
                f"The controller at '{self._host}' does not give 'actual_q' as six numbers, but '{given}'. Update its "
                "software, or type the joint values (--controller typed)."
            )

    def _measured(self) -> Array:
        """Let data flow, and return the first joint values; OSError or DeviceError if none come."""
        if self._socket is None:
            raise ConnectionError("not connected")
        if self._ask("S") != b"\x01":
            raise self._failure("does not start to send", None)
        payload = self._wait_for("U")
        self._ask("P")
        if len(payload) != _DATA.size:
            raise ConnectionError("it sends something else")
        values = np.array(_DATA.unpack(payload)[1:])
        if not np.isfinite(values).all():
            raise self._failure("sends joint values that are no numbers", None)
        return read_only(values)

    def _ask(self, kind: str, payload: bytes = b"") -> bytes:
        """Send a package, and return the payload of the answer, which has the same type."""
        assert self._socket is not None
        self._socket.sendall(_HEADER.pack(_HEADER.size + len(payload), ord(kind)) + payload)
        return self._wait_for(kind)

    def _wait_for(self, kind: str) -> bytes:
        """Return the payload of the next package of a type; others are left out. OSError if it does not come."""
        deadline = time.monotonic() + _PATIENCE
        while True:
            found, payload = self._package(deadline)
            if found == kind:
                return payload
            if found == "M":
                self._hear(payload)

    def _package(self, deadline: float) -> tuple[str, bytes]:
        """Return type and payload of the next package; OSError if the connection ends or the time is up."""
        assert self._socket is not None
        while True:
            if len(self._received) >= _HEADER.size:
                size, kind = _HEADER.unpack_from(self._received)
                if size < _HEADER.size:
                    raise ConnectionError("it does not speak RTDE")
                if len(self._received) >= size:
                    payload = self._received[_HEADER.size : size]
                    self._received = self._received[size:]
                    return chr(kind), payload
            left = deadline - time.monotonic()
            if left <= 0.0:
                raise TimeoutError(f"nothing came for {_PATIENCE:g} s")
            self._socket.settimeout(left)
            try:
                data = self._socket.recv(4096)
            except TimeoutError as error:
                raise TimeoutError(f"nothing came for {_PATIENCE:g} s") from error
            if not data:
                raise ConnectionError("it closed the connection")
            self._received += data

    def _hear(self, payload: bytes) -> None:
        """Keep a text message that says that something is wrong: length, text, length, source, level."""
        with contextlib.suppress(IndexError):
            length = payload[0]
            text = payload[1 : 1 + length].decode("utf-8", "replace")
            if payload[2 + length + payload[1 + length]] in _BAD_NEWS:
                self._said = text

    def _failure(self, fault: str, error: Exception | None) -> DeviceError:
        """Return the error of a controller; ``fault`` says what it does not do."""
        cause = f": {getattr(error, 'strerror', None) or error}" if error else ""
        said = f" It says '{self._said}'." if self._said else ""
        return DeviceError(
            f"The controller at '{self._host}', port {self._port}, {fault}{cause}.{said} Check the address, that the "
            "controller is on, and that its security settings allow RTDE."
        )


def _address(argument: str) -> tuple[str, int]:
    """Return host and port of an address; DeviceError if it is none."""
    host, mark, port = argument.rpartition(":")
    if not mark or argument.endswith("]"):
        host, port = argument, str(PORT)
    if not host or not (port.isascii() and port.isdigit() and 0 < int(port) < 65_536):
        raise DeviceError(
            f"The controller 'rtde' needs the address of the robot, and '{argument}' is none: rtde:192.168.0.5"
        )
    return host.strip("[]"), int(port)
