from __future__ import annotations

import math

import numpy as np
import pytest

import calib
from calib.errors import DeviceError
from calib.verbs.measure.devices.controllers import (
    CONTROLLERS,
    Controller,
    joints_at_rest,
    open_controller,
    register,
)
from calib.verbs.measure.devices.typed import TypedController
from tests.plugin_files import registries_kept
from tests.verbs.measure.devices.contexts import UR
from tests.verbs.measure.devices.rtde_server import Server


def test_a_controller_is_opened_by_its_name():
    with Server() as server:
        robot = open_controller(f"rtde:127.0.0.1:{server.port}", UR)
        np.testing.assert_array_equal(robot.joints(), server.q)
        robot.close()
    assert isinstance(open_controller("typed", UR), TypedController)
    with pytest.raises(
        DeviceError, match=r"no controller of a robot 'rtd' \(did you mean 'rtde'\?\)"
    ):
        open_controller("rtd:127.0.0.1", UR)


def test_whether_a_robot_stands_still():
    with Server() as server:
        robot = open_controller(f"rtde:127.0.0.1:{server.port}", UR)
        at_rest = joints_at_rest(robot)
        assert at_rest is not None
        np.testing.assert_array_equal(at_rest, server.q)
        server.speed = math.radians(1.0)
        assert joints_at_rest(robot) is None
        server.speed = 0.0
        assert joints_at_rest(robot, timeout=1.0) is not None
        robot.close()


class Moves:
    """A robot that has moved by some angle at each look."""

    def __init__(self, *steps: float) -> None:
        self.steps = list(steps)
        self.q = np.zeros(6)

    def joints(self):
        if self.steps:
            self.q = self.q.copy()
            self.q[5] += math.radians(self.steps.pop(0))
        return self.q

    def close(self) -> None:
        pass


def test_a_thousandth_of_a_degree_is_no_motion():
    assert joints_at_rest(Moves(0.0, 0.0009)) is not None
    assert joints_at_rest(Moves(0.0, -0.0011)) is None
    at_rest = joints_at_rest(Moves(0.0, 5.0, 0.0), timeout=1.0)
    assert at_rest is not None
    assert at_rest[5] == pytest.approx(math.radians(5.0))


def test_an_own_controller_is_registered_once():
    with registries_kept():
        register("statue", Controller("a robot that never moves", lambda _a, _c: Moves()))
        assert calib.controllers.CONTROLLERS["statue"].words == "a robot that never moves"
        np.testing.assert_array_equal(open_controller("statue", UR).joints(), np.zeros(6))
        for name in ("statue", "rtde", "a:b", ""):
            with pytest.raises(DeviceError, match="needs a name"):
                register(name, CONTROLLERS["rtde"])
    assert set(CONTROLLERS) == {"typed", "virtual", "rtde"}
