"""Noise of readings: each scalar has its own column of the noise."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

import calib.data.kinds as registry
from calib.data.kinds import Kind, Reading
from calib.verbs.simulate.reading_noise import with_pose_noise, with_reading_noise

N = 4
NOISE = {
    "length": np.arange(1.0, 1.0 + 5 * N).reshape(N, 5),
    "angle": 0.01 * np.arange(1.0, 1.0 + 3 * N).reshape(N, 3),
    "pixel": np.full((N, 3), 7.0),
}


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
