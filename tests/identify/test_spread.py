"""Predicted uncertainty, and what of it is nobody's business where the base's place is not measured."""

from __future__ import annotations

import numpy as np
import pytest

from calib.identify.calibration import Calibration, calibrate
from calib.identify.spread import own_moves, position_std, without_rigid_motion
from calib.identify.uncertainty import bootstrap
from calib.kinds import best_fit
from calib.measure.cell import Cell
from calib.measure.measurements import Measurements
from calib.model.kinematics import Samples
from calib.model.readback import random_joint_values
from calib.model.robot import Robot

TARGET = np.array([0.05, -0.06, 0.04])


def seen(robot: Robot, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Joint values, and where a nominal robot has its target."""
    q = random_joint_values(robot, count, 1)
    poses = robot.poses(q)
    return q, poses[:, :3, :3] @ TARGET + poses[:, :3, 3]


@pytest.fixture(scope="module")
def by_points(ur3: Robot) -> Calibration:
    q, points = seen(ur3, 30)
    points = points + 1e-4 * np.random.default_rng(1).normal(size=points.shape)
    table = Measurements(ur3.joint_names, q, points)
    return calibrate(ur3, table, cell=Cell(model="zeros"), validate=False)


@pytest.fixture(scope="module")
def by_lengths(ur3: Robot) -> Calibration:
    """A draw wire, from an anchor whose place is not known."""
    q, points = seen(ur3, 60)
    lengths = np.linalg.norm(points - [0.9, 0.2, 0.1], axis=1)
    table = Measurements(
        ur3.joint_names,
        q,
        np.full((60, 3), np.nan),
        kinds=("distance",) * 60,
        distances=lengths + 1e-4 * np.random.default_rng(1).normal(size=60),
    )
    cell = Cell(model="zeros", target=TARGET)
    return calibrate(ur3, table, cell=cell, validate=False)


def test_of_points_it_is_what_fits_to_other_noise_scatter_by(ur3: Robot, by_points: Calibration):
    """Monte Carlo: the same poses measured 60 times."""
    q, points = seen(ur3, 30)
    rng = np.random.default_rng(2)
    where = random_joint_values(ur3, 40, 9)
    found = []
    for _ in range(60):
        table = Measurements(ur3.joint_names, q, points + 1e-4 * rng.normal(size=points.shape))
        cell = Cell(model="frames")
        found.append(calibrate(ur3, table, cell=cell, validate=False).predict(where))
    scatter = np.sqrt(np.mean(np.sum(np.var(found, axis=0, ddof=1), axis=1)))
    table = Measurements(ur3.joint_names, q, points + 1e-4 * rng.normal(size=points.shape))
    one = calibrate(ur3, table, cell=Cell(model="frames"), validate=False)
    std = position_std(one.fitted, Samples.at(where))
    assert np.sqrt(np.mean(std**2)) == pytest.approx(scatter, rel=0.2)
    assert np.allclose(
        position_std(by_points.fitted, Samples.at(where)), by_points.position_std(where)
    )


def test_moves_of_measured_points_stay(by_points: Calibration):
    rng = np.random.default_rng(3)
    points, moves = rng.normal(size=(20, 3)), rng.normal(size=(20, 3, 4))
    assert own_moves(by_points.fitted, points, moves) is moves


def test_a_rigid_motion_is_nothing_where_only_lengths_were_measured(by_lengths: Calibration):
    rng = np.random.default_rng(4)
    points, shift, turn = rng.normal(size=(20, 3)), rng.normal(size=3), rng.normal(size=3)
    rigid = shift + np.cross(turn, points)
    moves = np.stack([rigid, np.eye(20)[:, :3]], axis=2)
    left = own_moves(by_lengths.fitted, points, moves)
    assert np.abs(left[:, :, 0]).max() < 1e-12
    assert np.abs(left[:, :, 1]).max() > 0.1
    # What is left has no rigid part: neither a mean nor a turn about the origin.
    assert np.abs(left[:, :, 1].sum(axis=0)).max() < 1e-12
    assert np.abs(np.cross(points, left[:, :, 1]).sum(axis=0)).max() < 1e-12


def test_a_rigid_motion_is_that_of_the_measured_poses(by_lengths: Calibration):
    """What is left at one point does not depend on the others that are asked, and is not nothing."""
    rng = np.random.default_rng(5)
    seen, asked = rng.normal(size=(20, 3)), rng.normal(size=(7, 3))
    shift, turn = rng.normal(size=3), rng.normal(size=3)
    bent = 1e-3 * rng.normal(size=(20, 3))
    of_seen = (shift + np.cross(turn, seen) + bent)[:, :, None]
    of_asked = (shift + np.cross(turn, asked) + 0.1)[:, :, None]
    left = own_moves(by_lengths.fitted, asked, of_asked, (seen, of_seen))
    assert np.abs(left - 0.1).max() < 5e-3
    alone = [
        own_moves(by_lengths.fitted, asked[[k]], of_asked[[k]], (seen, of_seen))[0]
        for k in range(7)
    ]
    np.testing.assert_allclose(alone, left, atol=1e-13)


def test_points_on_a_line_and_two_points_keep_what_no_rigid_motion_does():
    """A stretch of the line is none; a turn about it cannot be told and is left alone."""
    line = np.outer([0.0, 1.0], [0.3, 0.4, 0.0])
    stretch = (line - line.mean(axis=0))[:, :, None]
    np.testing.assert_allclose(without_rigid_motion(line, stretch), stretch, atol=1e-14)
    about = np.array([0.6, 0.8, 0.0])
    off = np.array([[0.0, 0.0, 1.0]])
    turned = np.cross(about, off)[:, :, None]
    nothing = np.zeros((2, 3, 1))
    np.testing.assert_allclose(without_rigid_motion(off, turned, (line, nothing)), turned)


def test_one_pose_asked_alone_is_as_uncertain_as_among_others(ur3: Robot, by_lengths: Calibration):
    fitted, q = by_lengths.fitted, random_joint_values(ur3, 12, 9)
    together = position_std(fitted, Samples.at(q))
    alone = [position_std(fitted, Samples.at(q[[k]]))[0] for k in range(12)]
    np.testing.assert_allclose(alone, together, rtol=1e-9)
    assert together.min() > 1e-5
    drawn = bootstrap(by_lengths, 40, seed=1)
    together = drawn.position_std(q)
    alone = [drawn.position_std(q[[k]])[0] for k in range(12)]
    np.testing.assert_allclose(alone, together, rtol=1e-9)
    assert together.min() > 1e-5


def test_where_only_lengths_were_measured_it_is_what_fits_scatter_by_as_one_body(ur3: Robot):
    """Monte Carlo: moved onto the truth by the measured poses, other poses are off by what is expected there."""
    q, points = seen(ur3, 60)
    exact = np.linalg.norm(points - [0.9, 0.2, 0.1], axis=1)
    where = random_joint_values(ur3, 40, 9)
    wanted = ur3.poses(where)[:, :3, :3] @ TARGET + ur3.poses(where)[:, :3, 3]
    rng, ratios = np.random.default_rng(6), []
    for _ in range(25):
        table = Measurements(
            ur3.joint_names,
            q,
            np.full((60, 3), np.nan),
            kinds=("distance",) * 60,
            distances=exact + 1e-4 * rng.normal(size=60),
        )
        cell = Cell(model="frames", target=TARGET)
        result = calibrate(ur3, table, cell=cell, validate=False)
        here, there = result.predict(q), result.predict(where)
        T = best_fit(here, points)
        error = there @ T[:3, :3].T + T[:3, 3] - wanted
        std = position_std(result.fitted, Samples.at(where))
        ratios.append(np.mean(np.sum(error**2, axis=1)) / np.mean(std**2))
    assert np.sqrt(np.mean(ratios)) == pytest.approx(1.0, abs=0.2)


def test_what_is_left_is_the_least_that_a_rigid_motion_leaves():
    """Against least squares: the six numbers of the motion that takes away most."""
    rng = np.random.default_rng(5)
    points, moves = rng.normal(1.0, 2.0, size=(15, 3)), rng.normal(size=(15, 3, 4))
    left = without_rigid_motion(points, moves)
    assert left.shape == moves.shape
    for k in range(4):
        columns = [np.tile(e, (15, 1)) for e in np.eye(3)]
        columns += [np.cross(e, points) for e in np.eye(3)]
        motions = np.stack([c.ravel() for c in columns], axis=1)
        move = moves[:, :, k].ravel()
        best = np.linalg.lstsq(motions, move, rcond=None)[0]
        np.testing.assert_allclose(left[:, :, k].ravel(), move - motions @ best, atol=1e-12)
    np.testing.assert_allclose(without_rigid_motion(points, left), left, atol=1e-12)


def test_lengths_tell_less_of_places_than_of_shapes(ur3: Robot, by_lengths: Calibration):
    samples = Samples.at(random_joint_values(ur3, 100, 9))
    fitted = by_lengths.fitted
    points, jacobian = fitted.kinematics.points_jacobian(fitted.estimate.x, samples)
    place = np.einsum("nij,jk,nik->n", jacobian, fitted.estimate.covariance, jacobian)
    std = position_std(fitted, samples)
    assert len(points) == len(std) == 100
    assert np.mean(std**2) < 0.8 * np.mean(place)
    assert by_lengths.expected_everywhere < 0.9 * np.sqrt(np.mean(place))
