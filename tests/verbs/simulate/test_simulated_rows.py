"""Readings: the target, the group, the pose and the partner of each row, and the noise of each scalar."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import calib.data.kinds as registry
from calib.data.cell import Cell
from calib.data.kinds import Kind, Reading
from calib.errors import CalibError
from calib.verbs.simulate.simulated_rows import Tour, with_pose_noise, with_reading_noise
from calib.verbs.simulate.truth import draw_truth

SETS = ("estimate",) * 4

N = 4
NOISE = {
    "length": np.arange(1.0, 1.0 + 5 * N).reshape(N, 5),
    "angle": 0.01 * np.arange(1.0, 1.0 + 3 * N).reshape(N, 3),
    "pixel": np.full((N, 3), 7.0),
}


@pytest.fixture
def truth(ur3):
    """A truth of two targets in two stations."""
    pose = np.eye(4)
    targets = {"A": np.array([0.0, 0.0, 0.1]), "B": np.array([0.0, 0.1, 0.1])}
    return draw_truth(ur3, cell=Cell(targets=targets, frames={"1": pose, "2": pose}))


def test_all_targets_are_measured_at_each_stop_and_poses_dealt_out_among_the_groups(truth):
    tour = Tour.of(truth, SETS, visits=2)
    assert len(tour) == 16
    assert tour.route.tolist() == [0, 1, 2, 3] * 2
    assert tour.stop.tolist() == np.repeat(np.arange(8), 2).tolist()
    assert tour.target.tolist() == [0, 1] * 8
    assert tour.group.tolist() == [0, 0, 1, 1] * 4
    assert tour.sets == ("estimate",) * 16
    assert set(tour.pairs) == {""}


def test_pairs_are_of_consecutive_poses_of_one_target(truth):
    tour = Tour.of(truth, SETS, paired=True)
    assert tour.partner.tolist() == [2, 3, 0, 1, 6, 7, 4, 5]
    assert tour.pairs[0] == tour.pairs[2] != tour.pairs[1]
    T = np.arange(8.0)[:, None, None] * np.ones((8, 4, 4))
    assert tour.with_partners(T)[:, :, 0, 0].tolist()[:2] == [[0.0, 2.0], [1.0, 3.0]]
    with pytest.raises(CalibError):
        Tour.of(truth, SETS[:3], paired=True)


def test_a_pose_is_moved_and_turned_along_the_axes_of_the_frame():
    R = Rotation.random(N, rng=1).as_matrix()
    readings = np.hstack([np.full((N, 3), 100.0), R.reshape(-1, 9)])
    noisy = with_pose_noise(registry.get("pose"), readings, R, NOISE)
    np.testing.assert_array_equal(noisy[:, :3], 100.0 + NOISE["length"][:, :3])
    turned = Rotation.from_matrix(noisy[:, 3:].reshape(-1, 3, 3) @ R.transpose(0, 2, 1))
    np.testing.assert_allclose(turned.as_rotvec(), NOISE["angle"], atol=1e-12)


def test_readings_take_the_columns_behind_those_of_a_position():
    kind = Kind(
        name="point_and_two",
        words="a position and two numbers",
        units=("m", "m", "m", "m", "px"),
        position=True,
        readings=(Reading("depth", "length"), Reading("column", "pixel")),
        measure=lambda T: np.zeros((len(T), 5)),
        derivative=lambda _measured, _T, twists: twists,
    )
    noisy = with_reading_noise(kind, np.zeros((N, 5)), NOISE)
    np.testing.assert_array_equal(noisy[:, :3], 0.0)
    np.testing.assert_array_equal(noisy[:, 3], NOISE["length"][:, 3])
    np.testing.assert_array_equal(noisy[:, 4], 7.0)


def test_a_positive_reading_stays_positive():
    noise = {"length": np.full((N, 3), -5.0)}
    noisy = with_reading_noise(registry.get("distance"), np.full((N, 1), 2.0), noise)
    np.testing.assert_array_equal(noisy, 3.0)
