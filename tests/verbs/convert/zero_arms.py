"""Simulated arms whose joints have wrong zeros, measured by other code than calib's fit, and their calibrations."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

import calib.example
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.verbs.convert.convert import convert
from calib.verbs.convert.format import Options
from calib.verbs.convert.zeros import (
    DYNAMIXEL_YAML,
    LEROBOT_DYNAMIXEL_JSON,
    LEROBOT_JSON,
    TABLE,
    TRANSMISSION_YAML,
)
from tests.kept import kept

#: How each format stores zeros.
STORED = {
    "zeros": TABLE,
    "dynamixel-hardware": DYNAMIXEL_YAML.stored,
    "ros2-transmission": TRANSMISSION_YAML.stored,
    "lerobot": LEROBOT_JSON.stored,
    "lerobot-dynamixel": LEROBOT_DYNAMIXEL_JSON.stored,
}

TARGET = np.array([0.03, -0.02, 0.05])

#: What the joints of the SO-101 have beyond their readings [deg].
SERVO_ZEROS = np.array([1.7, 2.0, -1.6, 2.2, -1.0])


def points(robot: Robot, q: np.ndarray) -> np.ndarray:
    """The target in the base at true joint values."""
    T = robot.poses(q)
    return T[:, :3, :3] @ TARGET + T[:, :3, 3]


def table(robot: Robot, q: np.ndarray, true: np.ndarray, noise: float = 0.0) -> Measurements:
    """Readings, and where the target is when the joints are at readings + true."""
    measured = points(robot, q + true)
    measured = measured + noise * np.random.default_rng(1).normal(size=measured.shape)
    sliding = [name for name, kind in robot.joint_types.items() if kind == "prismatic"]
    return Measurements(robot.joint_names, q, measured, prismatic=tuple(sliding))


@cache
def servo_arm() -> Robot:
    return Robot.load("so101", tip="gripper_link")


@cache
def servo_readings() -> np.ndarray:
    return random_joint_values(servo_arm(), 24, 3)


@kept
def servo_result() -> Calibration:
    """The SO-101, its target known, so that all five zeros are determined."""
    robot = servo_arm()
    measured = table(robot, servo_readings(), np.radians(SERVO_ZEROS), noise=5e-5)
    cell = Cell(target=TARGET, estimate_target=False, model="zeros", sigma={"m": 5e-5})
    return calibrate(robot, measured, cell=cell)


@kept
def ur3_result() -> Calibration:
    """The paper's UR3, whose target is estimated: the last zero is not determined."""
    robot = Robot.load(calib.example.paper_urdf(), base="base", tip="tool0")
    measured = Measurements.read(
        calib.example.paper_measurements(), robot.joint_names, robot.joint_types
    )
    return calibrate(robot, measured, cell=Cell(target=calib.example.PAPER_TARGET, model="dh"))


def written(path: Path, to: str, **options: object) -> Path:
    """The zeros of the SO-101 in a format."""
    convert(servo_result(), path, to=to, options=Options(**options))  # type: ignore[arg-type]
    return path


def miss(q: np.ndarray) -> float:
    """Rms distance of the nominal SO-101 at readings q from where the target was really [m]."""
    robot = servo_arm()
    true = points(robot, servo_readings() + np.radians(SERVO_ZEROS))
    return float(np.sqrt(np.mean(np.sum((points(robot, q) - true) ** 2, axis=1))))
