from __future__ import annotations

import socket
import threading
import time

import numpy as np
import pytest

from calib.errors import DeviceError
from calib.verbs.measure.devices import rtde
from calib.verbs.measure.devices.reading import Context
from calib.verbs.measure.devices.rtde import RtdeController
from tests.verbs.measure.devices.contexts import JOINTS, UR
from tests.verbs.measure.devices.rtde_server import Server


def controller_of(server: Server) -> RtdeController:
    return RtdeController(f"127.0.0.1:{server.port}", UR)


def test_the_joints_are_those_of_now():
    with Server() as server:
        controller = controller_of(server)
        np.testing.assert_array_equal(controller.joints(), server.q)
        for value in (0.25, -0.5):
            server.q[2] = value
            assert controller.joints()[2] == value
        controller.close()
        # Nothing flows between two calls; nothing is written to the robot.
        assert server.asked == "VO" + 3 * "SP"


def test_packages_may_come_in_pieces_and_with_messages():
    with Server() as server:
        server.piece = 1
        controller = controller_of(server)
        server.say("something happened")
        np.testing.assert_array_equal(controller.joints(), server.q)
        controller.close()


def test_a_connection_that_was_lost_is_made_again():
    with Server() as server:
        controller = controller_of(server)
        server.drop()
        np.testing.assert_array_equal(controller.joints(), server.q)
        controller.close()
        np.testing.assert_array_equal(controller.joints(), server.q)
        controller.close()
    with pytest.raises(DeviceError, match="does not answer: Connection refused"):
        controller.joints()


def test_a_silent_controller_gives_no_old_joints(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(rtde, "_PATIENCE", 0.2)
    with Server() as server:
        controller = controller_of(server)
        controller.joints()
        server.silent.set()
        begun = time.monotonic()
        with pytest.raises(
            DeviceError, match=r"does not send joint values: nothing came for 0\.2 s"
        ):
            controller.joints()
        assert time.monotonic() - begun < 1.0
        server.silent.clear()
        server.q[0] = 0.75
        assert controller.joints()[0] == 0.75
        controller.close()


def test_a_controller_that_cannot_is_refused():
    with (
        Server(versions=[1]) as server,
        pytest.raises(DeviceError, match="does not speak version 2"),
    ):
        controller_of(server)
    with Server(has_joints=False) as server, pytest.raises(DeviceError, match="'NOT_FOUND'"):
        controller_of(server)
    with Server(starts=False) as server:
        controller = controller_of(server)
        with pytest.raises(DeviceError, match="does not start to send"):
            controller.joints()
        controller.close()


@pytest.mark.parametrize(
    "answer", [b"HTTP/1.1 400 Bad Request\r\n\r\n", b"\0\0\0\0", b"\0\4V", b""]
)
def test_a_server_of_another_kind_is_refused(monkeypatch: pytest.MonkeyPatch, answer: bytes):
    monkeypatch.setattr(rtde, "_PATIENCE", 0.2)
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            connection, _ = server.accept()
            with connection:
                connection.sendall(answer)
                if answer:
                    time.sleep(0.4)

        thread = threading.Thread(target=serve)
        thread.start()
        with pytest.raises(DeviceError, match="does not answer"):
            RtdeController(f"127.0.0.1:{server.getsockname()[1]}", UR)
        thread.join()


def test_other_robots_and_addresses_are_refused():
    for names in (JOINTS[:5], (*JOINTS, "rail")):
        context = Context(names, dict.fromkeys(names, "revolute"))
        with pytest.raises(DeviceError, match="gives the 6 joints"):
            RtdeController("127.0.0.1", context)
    for argument in ("", ":30004", "127.0.0.1:", "127.0.0.1:0", "127.0.0.1:x"):
        with pytest.raises(DeviceError, match="needs the address of the robot"):
            RtdeController(argument, UR)
