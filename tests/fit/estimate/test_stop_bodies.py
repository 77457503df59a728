"""Bodies of stops: their displacement by hand, and the scale of its effect."""

from __future__ import annotations

import numpy as np
import pytest

from calib.fit.estimate.stop_bodies import of_unit_size, twists_of_bodies, twists_of_joints
from calib.model.error_model import error_model
from calib.model.kinematics import Kinematics, Samples
from calib.robot.robot import Robot
from tests.fits import place


def test_points_of_a_body_turn_about_their_weighted_centroid():
    points = np.array([[1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [4.0, 0.0, 0.0], [5.0, 5.0, 5.0]])
    stops = np.array([3, 3, 3, 8])
    twists = twists_of_bodies(points, points, stops, np.array([1.0, 1.0, 2.0, 1.0]))
    centroid = np.array([2.25, 0.5, 0.0])
    np.testing.assert_array_equal(twists[:, :3, :3], np.tile(np.eye(3), (4, 1, 1)))
    np.testing.assert_array_equal(twists[:, 3:, :3], 0.0)
    np.testing.assert_array_equal(twists[:, 3:, 3:], np.tile(np.eye(3), (4, 1, 1)))
    turn = np.array([0.1, -0.2, 0.3])
    for k in range(3):
        moved = twists[k, :3, 3:] @ turn
        np.testing.assert_allclose(moved, np.cross(turn, points[k] - centroid))
    # The only point of its body stays where it is.
    np.testing.assert_array_equal(twists[3, :3, 3:], 0.0)


def test_corners_of_a_board_turn_its_origin_about_their_centroid():
    corners = np.array([[1.0, 0.0, 0.5], [3.0, 2.0, 0.5]])
    origins = np.array([[5.0, 5.0, 5.0], [5.0, 5.0, 5.0]])
    twists = twists_of_bodies(origins, corners, np.array([0, 0]), np.ones(2))
    turn = np.array([0.1, -0.2, 0.3])
    for k in range(2):
        moved = twists[k, :3, 3:] @ turn
        np.testing.assert_allclose(moved, np.cross(turn, origins[k] - [2.0, 1.0, 0.5]))


def test_each_instrument_has_a_scale_of_its_own():
    rng = np.random.default_rng(1)
    J = rng.normal(size=(40, 2, 6))
    instruments = np.tile(np.array([0, 1], dtype=np.int8), (40, 1))
    instruments[30:, 1] = -1
    J[:, 1, :3] = 0.0  # no translation moves an angle
    counts = rng.uniform(0.5, 1.0, 40)
    scaled = of_unit_size(J, instruments, counts)
    np.testing.assert_array_equal(scaled[30:, 1], 0.0)
    for column, part, expected in (
        (0, slice(0, 3), 1.0),
        (0, slice(3, 6), 1.0),
        (1, slice(0, 3), 0.0),
        (1, slice(3, 6), 1.0),
    ):
        measured = instruments[:, column] >= 0
        squares = np.sum(scaled[measured, column, part] ** 2, axis=1)
        assert np.average(squares, weights=counts[measured]) == pytest.approx(expected)
    np.testing.assert_allclose(scaled[0, 0, :3] / scaled[5, 0, :3], J[0, 0, :3] / J[5, 0, :3])


def kinematics_of(robot):
    """A robot seen from two frames, with two targets, under a model that is not used."""
    frames = np.array([place([1.0, 2.0, 0.5], [0.3, -0.2, 1.0]), np.eye(4)])
    targets = np.array([np.eye(4), place([0.05, 0.1, 0.2], [0.1, 0.2, 0.3])])
    model = error_model(robot, "dh", frame={"a": (), "b": ()}, target=False, targets=("one", "two"))
    return Kinematics(robot, model, frames, targets)


def differences(kinematics, q, frame, target):
    """Twists of targets by joint values, shape (K, 6, m), by differences."""
    x = np.zeros(len(kinematics.model))
    T = kinematics.poses(x, Samples(q, frame, target))
    columns = []
    for step in 1e-6 * np.eye(q.shape[1]):
        change = (kinematics.poses(x, Samples(q + step, frame, target)) - T) / 1e-6
        turn = change[:, :3, :3] @ T[:, :3, :3].swapaxes(1, 2)
        spin = np.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], axis=1)
        columns.append(np.hstack([change[:, :3, 3], spin]))
    return np.stack(columns, axis=2)


@pytest.fixture
def sliding(serial_urdf):
    """Three joints of which the second slides."""
    joints = [
        ("revolute", (0, 0, 0.3), (0, 0, 0), (0, 0, 1)),
        ("prismatic", (0.1, 0, 0.2), (0.3, 0, 0), (0, 1, 0)),
        ("revolute", (0, 0.2, 0.1), (0, 1.0, 0), (1, 0, 0)),
    ]
    return Robot.from_urdf(serial_urdf(joints))


def test_twists_of_joints_are_those_of_differences(ur3, sliding):
    frame, target = np.array([0, 1, 1, 0]), np.array([0, 0, 1, 1])
    for robot, turning in ((ur3, range(6)), (sliding, (0, 2))):
        kinematics = kinematics_of(robot)
        q = np.random.default_rng(5).uniform(-1, 1, (4, len(robot.joint_names)))
        twists = twists_of_joints(kinematics, Samples(q, frame, target))
        expected = differences(kinematics, q, frame, target)[:, :, list(turning)]
        np.testing.assert_allclose(twists, expected, atol=1e-5)
