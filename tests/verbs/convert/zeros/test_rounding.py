"""Rounded zeros: a step's half at most away, of the right sign, in the unit of the joint."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.errors import CalibError, ModelError
from calib.robot.robot import Robot
from calib.verbs.convert.source import Source
from calib.verbs.convert.zeros.rounding import STORED, RoundedZeros, stored_number
from tests.verbs.convert.zeros.arms import servo_arm, servo_result

#: (type, xyz, rpy, axis)
SLIDING = [
    ("prismatic", (0.0, 0.0, 0.1), (0.0, 0.0, 0.0), (0, 0, 1)),
    ("revolute", (0.2, 0.0, 0.0), (0.0, 0.0, 0.0), (0, 1, 0)),
]


def source(robot: Robot, delta: list[float]) -> Source:
    """A result whose zeros are these."""
    m = len(delta)
    zeros = replace(
        servo_result().zeros,
        joints=robot.joint_names,
        delta=np.array(delta),
        std=np.full(m, 1e-4),
        determined=np.array([True] * (m - 1) + [False]),
    )
    return Source("result", robot, robot, calibration=replace(servo_result(), zeros=zeros))


@pytest.mark.parametrize(
    ("name", "ticks", "step"),
    [
        ("zeros", 4096, np.radians(1e-4)),
        ("dynamixel-hardware", 4096, 1e-6),
        ("ros2-transmission", 4096, 1e-6),
        ("lerobot", 4096, 2 * np.pi / 4096),
        ("lerobot-dynamixel", 1000, 2 * np.pi / 1000),
    ],
)
def test_rounding_moves_a_zero_by_half_a_step_at_most(name: str, ticks: int, step: float):
    delta = np.random.default_rng(2).uniform(-0.1, 0.1, 5).tolist()
    rounded = RoundedZeros.of(source(servo_arm(), delta), stored_number(name, ticks))
    assert np.abs(rounded.rounding).max() <= step / 2 * (1 + 1e-9)
    assert rounded.change == pytest.approx(np.array(delta) + rounded.rounding, abs=1e-15)
    steps = rounded.change / step
    assert steps == pytest.approx(np.round(steps), abs=1e-6)
    assert np.array_equal(np.sign(rounded.numbers), STORED[name].sign * np.sign(delta))


def test_a_sliding_joint_is_in_mm(serial_urdf):
    robot = Robot.from_urdf(serial_urdf(SLIDING), "l0", "tip")
    rounded = RoundedZeros.of(source(robot, [0.0123456, 0.02]), stored_number("zeros", 4096))
    assert rounded.by_joint() == {"j1": 12.346}  # the second is not determined
    assert [unit.name for unit in rounded.units] == ["mm", "deg"]
    assert rounded.undetermined == ("j2",)
    assert rounded.change[0] == pytest.approx(0.012346)
    in_metres = RoundedZeros.of(
        source(robot, [0.0123456, 0.02]), stored_number("dynamixel-hardware", 1)
    )
    assert in_metres.by_joint() == {"j1": -0.012346}
    with pytest.raises(ModelError, match="'j1' slides"):
        RoundedZeros.of(source(robot, [0.0, 0.0]), stored_number("lerobot", 4096))


def test_what_has_no_zeros():
    with pytest.raises(CalibError, match="result"):
        RoundedZeros.of(Source("robot", servo_arm(), None), stored_number("zeros", 4096))
    with pytest.raises(CalibError, match="--ticks -1"):
        stored_number("lerobot", -1)
