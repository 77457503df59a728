from __future__ import annotations

import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator

import pytest

from calib.errors import CalibError, DeviceError, MeasurementError
from calib.verbs.measure.devices.lines import LineRows, TcpReader
from calib.verbs.measure.devices.reading import Reading
from tests.verbs.measure.devices.contexts import BARE, UR

#: Prints what it reads from standard input as lines that a test compares: first coordinates, or an error.
READS = """
import sys
from calib.errors import CalibError
from calib.verbs.measure.devices.readers import open_reader
from tests.verbs.measure.devices.contexts import BARE, UR
reader = open_reader("stdin", BARE if sys.argv[1] == "bare" else UR)
print("open", flush=True)
while True:
    try:
        reading = reader.read(10.0)
    except CalibError as error:
        print(type(error).__name__, error, flush=True)
        if "has ended" in str(error):
            break
    else:
        print(reading.rows[0]["x [mm]"] if reading else "nothing", flush=True)
"""


def fed(rows: LineRows, data: bytes) -> list[object]:
    """First coordinates [mm], or the classes of errors."""
    return [
        entry.rows[0]["x [mm]"] if isinstance(entry, Reading) else type(entry)
        for entry in rows.feed(data)
    ]


@pytest.mark.parametrize("end", [b"\n", b"\r\n", b"\r"])
def test_lines_are_cut_wherever_they_come_apart(end: bytes):
    text = end.join([b"x [mm];y [mm];z [mm]", b"1,5;2;3", b"", b"# remark", b"4,5;5;6", b""])
    for size in (1, 2, 7, 1000):
        rows = LineRows("tcp", UR)
        found = [
            value
            for start in range(0, len(text), size)
            for value in fed(rows, text[start : start + size])
        ]
        assert found == [1.5, 4.5]
        assert rows.rest == b""


def test_malformed_lines_are_refused_and_reading_goes_on():
    rows = LineRows("tcp", BARE)
    assert fed(rows, b"1 2 3\nbeam broken\n4 5 6\n7 8") == [1.0, MeasurementError, 4.0]
    assert fed(rows, b" 9\n") == [7.0]
    # A header may come, and come again, as when the instrument connects again.
    assert fed(rows, b"z [mm],y [mm],x [mm]\n1,2,3\nz [mm],y [mm],x [mm]\n4,5,6\n") == [3.0, 6.0]
    (error,) = rows.feed(b"1,2\n")
    assert "tcp, line 9: '1,2' does not fit the header" in str(error)
    assert fed(LineRows("tcp", UR), b"1 2 3\n") == [
        MeasurementError
    ]  # whose columns nobody has said


def test_a_line_without_an_end_is_dropped():
    rows = LineRows("tcp", BARE)
    assert fed(rows, b"1" * 70_000) == [MeasurementError]
    assert fed(rows, b"\n1 2 3\n") == [1.0]


# Standard input


def test_standard_input():
    with subprocess.Popen(
        [sys.executable, "-c", READS, "bare"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        assert process.stdout.readline() == "open\n"
        process.stdin.write("1,5 2 3\n4")
        process.stdin.flush()
        assert process.stdout.readline() == "1.5\n"
        process.stdin.write(" 5 6\nbroken\n7 8 9")
        process.stdin.close()
        assert process.stdout.readline() == "4.0\n"
        assert process.stdout.readline().startswith("MeasurementError standard input, line 3")
        assert process.stdout.readline() == "7.0\n"
        assert process.stdout.readline().startswith("DeviceError Standard input has ended")
        assert process.wait(5.0) == 0


# TCP


def first(reading: Reading | None) -> object:
    assert reading is not None
    return reading.rows[0]["x [mm]"]


def eventually(reader: TcpReader, seconds: float = 3.0) -> Reading:
    """The next reading, past the errors before it."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        try:
            reading = reader.read(0.2)
        except CalibError:
            continue
        if reading is not None:
            return reading
    raise AssertionError("nothing came")


@pytest.fixture
def instrument() -> Iterator[socket.socket]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield server


def connected(instrument: socket.socket, context=BARE) -> tuple[TcpReader, socket.socket]:
    """A reader, and the instrument's end of its connection."""
    host, port = instrument.getsockname()
    reader = TcpReader(f"{host}:{port}", context)
    return reader, instrument.accept()[0]


def test_an_instrument_that_sends_lines(instrument: socket.socket):
    reader, connection = connected(instrument)
    with connection:
        assert reader.read(0.0) is None
        connection.sendall(b"1 2 3\r\n4 5")
        reading = reader.read(1.0)
        assert first(reading) == 1.0
        assert reading is not None
        assert reading.source.endswith(", line 1")
        assert reader.read(0.15) is None  # half a line waits
        connection.sendall(b" 6\r\nbeam broken\r\n7 8 9\r\n")
        assert first(reader.read(1.0)) == 4.0
        with pytest.raises(MeasurementError, match="beam broken"):
            reader.read(1.0)
        assert first(reader.read(1.0)) == 7.0
    reader.close()
    assert reader.read(1.0) is None


def test_a_connection_that_was_lost_is_made_again(instrument: socket.socket):
    reader, connection = connected(instrument)
    connection.sendall(b"1 2 3\n4 5 6")
    assert first(reader.read(1.0)) == 1.0
    connection.close()
    with pytest.raises(MeasurementError, match="within the line '4 5 6'"):
        reader.read(1.0)
    with pytest.raises(DeviceError, match="connection was lost"):
        reader.read(1.0)
    answers: list[Reading] = []
    thread = threading.Thread(target=lambda: answers.append(eventually(reader)))
    thread.start()
    again, _ = instrument.accept()
    with again:
        again.sendall(b"7 8 9\n")
        thread.join(3.0)
    assert [first(reading) for reading in answers] == [7.0]
    reader.close()


@pytest.mark.slow
def test_an_instrument_that_is_off_for_a_while():
    with socket.create_server(("127.0.0.1", 0)) as instrument:
        port = instrument.getsockname()[1]
        reader, connection = connected(instrument)
        connection.close()
    with pytest.raises(DeviceError, match="connection was lost"):
        reader.read(1.0)
    assert reader.read(2.5) is None  # refused twice
    with socket.create_server(("127.0.0.1", port)) as instrument:

        def send() -> None:
            connection, _ = instrument.accept()
            with connection:
                connection.sendall(b"7 8 9\n")

        thread = threading.Thread(target=send)
        thread.start()
        assert first(eventually(reader)) == 7.0
        thread.join()
    reader.close()


def test_programs_of_this_machine_can_connect():
    reader = TcpReader("listen=0", UR)
    assert reader.port is not None
    for start in (1, 2):  # one after the other
        with socket.create_connection(("127.0.0.1", reader.port)) as program:
            program.sendall(b"x [mm],y [mm],z [mm]\n" + f"{start},0,0\n".encode())
            assert first(eventually(reader)) == start
    with socket.create_connection(("127.0.0.1", reader.port)) as page:
        page.sendall(b"POST / HTTP/1.1\r\n\r\nx [mm],y [mm],z [mm]\r\n1,2,3\r\n")
        with pytest.raises(MeasurementError, match="a browser"):
            reader.read(1.0)
        assert reader.read(0.2) is None
    with pytest.raises(DeviceError, match="nobody can connect"):
        TcpReader(f"listen={reader.port}", UR)
    reader.close()
    with pytest.raises(OSError, match="refused"):
        socket.create_connection(("127.0.0.1", reader.port), 1.0)


@pytest.mark.parametrize(
    "argument", ["", "127.0.0.1", ":5000", "127.0.0.1:x", "127.0.0.1:70000", "listen=x", "listen="]
)
def test_what_is_no_address_is_refused(argument: str):
    with pytest.raises(DeviceError, match=r"tcp:listen=5000"):
        TcpReader(argument, BARE)


def test_an_instrument_that_does_not_answer_is_said_at_once():
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    with pytest.raises(DeviceError, match=f"no connection to '127.0.0.1', port {port}"):
        TcpReader(f"127.0.0.1:{port}", BARE)
