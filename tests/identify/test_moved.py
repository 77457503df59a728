"""Fresh rows from a tracker that was carried away, or with a target that was mounted anew."""

from __future__ import annotations

import numpy as np
import pytest

from calib.identify.evaluation import Known
from calib.identify.moved import moved
from calib.measure.cell import Cell
from calib.measure.measurements import Measurements
from calib.model.readback import random_joint_values
from calib.model.robot import Robot

TARGET = np.array([0.05, 0.06, 0.07])


def at(point: np.ndarray) -> np.ndarray:
    T = np.eye(4)
    T[:3, 3] = point
    return T


KNOWN = Known({"": np.eye(4)}, {"target": at(TARGET)})


def rows(robot: Robot, target: np.ndarray, shift: np.ndarray, count: int = 12) -> Measurements:
    """Points with 0.05 mm of noise, of a target and in a frame that may not be those of `KNOWN`."""
    q = random_joint_values(robot, count, 1)
    poses = robot.poses(q)
    noise = np.random.default_rng(1).normal(0.0, 5e-5, (count, 3))
    points = poses[:, :3, :3] @ target + poses[:, :3, 3] + shift + noise
    return Measurements(robot.joint_names, q, points)


def test_a_tracker_that_moved_is_named(ur3: Robot):
    said = moved(ur3, rows(ur3, TARGET, np.array([2e-3, 0.0, 1e-3])), Cell(), KNOWN)
    assert said.startswith(
        "The rms is 2.24 mm with frame and target of the result, and only 0.0779 mm if "
    )
    assert said.endswith("move since the calibration? Then add --frame estimate.")


def test_a_target_that_was_mounted_anew_is_named(ur3: Robot):
    m = rows(ur3, TARGET + np.array([2e-3, 0.0, 0.0]), np.zeros(3))
    said = moved(ur3, m, Cell(), KNOWN)
    assert said.startswith(
        "The rms is 2.02 mm with frame and target of the result, and only 0.0782 mm if "
    )
    assert said.endswith("since the calibration? Then give its place with --target.")


@pytest.mark.parametrize(
    ("shift", "count", "known"),
    [
        (0.0, 12, KNOWN),  # nothing to explain
        (2e-3, 2, KNOWN),  # too few rows to find a frame
        (2e-3, 4, KNOWN),  # enough to find it, and not to say that this means much
        (2e-3, 12, Known({"": np.eye(4)}, {})),  # the target was found from the rows already
    ],
)
def test_nothing_is_said_where_nothing_is_known(ur3: Robot, shift: float, count: int, known: Known):
    m = rows(ur3, TARGET, np.array([shift, 0.0, 0.0]), count)
    assert moved(ur3, m, Cell(), known) == ""


def test_errors_of_the_robot_are_not_explained_away(ur3: Robot):
    m = rows(ur3, TARGET, np.zeros(3))
    off = np.random.default_rng(4).normal(0.0, 1e-3, (12, 3))
    assert moved(ur3, Measurements(m.joint_names, m.joints, m.points + off), Cell(), KNOWN) == ""
