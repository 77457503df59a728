"""Turns about three axes come back in their own letters, at the poles too, near the angles that stood there."""

from __future__ import annotations

from itertools import product as pairs

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.robot.mjcf_elements import euler_matrix, moving_sequence
from calib.robot.mjcf_orientation import makes_all, turns_of

SEQUENCES = ["xyz", "XYZ", "zyx", "ZYX", "xYz", "XyZ", "zyz", "ZYZ", "XZX", "xzy"]


@pytest.mark.parametrize("eulerseq", SEQUENCES)
def test_turns_make_the_rotation_to_rounding(eulerseq: str):
    rng = np.random.default_rng(0)
    quarter = np.pi / 2.0
    before = [rng.uniform(-4.0, 4.0, 3) for _ in range(20)]
    before += [np.array(angles) * quarter for angles in pairs((-1, 0, 1), repeat=3)]
    for angles in before:
        for size in (0.0, 1e-12, 1e-8, 1e-3):
            turn = Rotation.from_rotvec(size * rng.normal(size=3)).as_matrix()
            R = euler_matrix(eulerseq, angles) @ turn
            found = turns_of(R, eulerseq, angles)
            np.testing.assert_allclose(euler_matrix(eulerseq, found), R, rtol=0.0, atol=3e-15)
    ordinary = np.array([0.3, 0.5, -0.4])
    np.testing.assert_allclose(
        turns_of(euler_matrix(eulerseq, ordinary), eulerseq, ordinary), ordinary, atol=1e-14
    )
    whole = ordinary + np.array([2.0 * np.pi, 0.0, -4.0 * np.pi])
    np.testing.assert_allclose(
        turns_of(euler_matrix(eulerseq, whole), eulerseq, whole), whole, atol=1e-14
    )


def test_two_turns_about_one_axis_make_no_full_orientation():
    assert [makes_all(eulerseq) for eulerseq in ("yxY", "xxz", "zyz", "xYz")] == [
        False,
        False,
        True,
        True,
    ]


def test_letters_that_stay_come_before_those_that_were_made():
    assert moving_sequence("xyz") == ("xyz", (0, 1, 2))
    assert moving_sequence("XYZ") == ("zyx", (2, 1, 0))
    assert moving_sequence("xYz") == ("yxz", (1, 0, 2))
    # Scipy's small letters turn about axes that stay, its capitals about those that move.
    angles = np.array([0.2, -0.7, 1.1])
    np.testing.assert_allclose(
        euler_matrix("XYZ", angles), Rotation.from_euler("xyz", angles).as_matrix(), atol=1e-15
    )
    np.testing.assert_allclose(
        euler_matrix("xyz", angles), Rotation.from_euler("XYZ", angles).as_matrix(), atol=1e-15
    )
