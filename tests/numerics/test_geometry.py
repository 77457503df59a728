"""Vectors, rotations and poses as given, and conversions of rotations against scipy's and against series."""

from __future__ import annotations

from math import factorial

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.errors import CalibError
from calib.numerics.geometry import (
    FARTHEST,
    FARTHEST_IN_TIP,
    inverse_right_jacobian,
    not_rotations,
    pose_of,
    pose_or_none,
    position_in_tip,
    rotation_or_none,
    to_matrices,
    to_quaternions,
    vector,
)

TURN = Rotation.from_rotvec([0.1, -0.2, 0.3]).as_matrix()


def test_a_vector_is_three_numbers_within_reach():
    result = vector([1, -FARTHEST, 0], "target")
    np.testing.assert_array_equal(result, [1.0, -FARTHEST, 0.0])
    assert not result.flags.writeable
    for value in ([1, 2], [[1, 2, 3]], [0, np.nan, 0], [0, np.inf, 0], [0, 1.001 * FARTHEST, 0]):
        with pytest.raises(CalibError, match="The target is "):
            vector(value, "target")


def test_a_position_in_the_tip_is_within_metres_of_it():
    result = position_in_tip([0, -FARTHEST_IN_TIP, 0.1], "target")
    np.testing.assert_array_equal(result, [0.0, -FARTHEST_IN_TIP, 0.1])
    assert not result.flags.writeable
    for value in ([0, 0, 100], [-20.001, 0, 0], [1, 2]):
        with pytest.raises(CalibError):
            position_in_tip(value, "target")


def test_poses_and_rotations_as_given():
    R = rotation_or_none(TURN)
    assert R is not None
    assert not R.flags.writeable
    np.testing.assert_array_equal(R, TURN)
    for value in (-TURN, TURN[:2], np.eye(4), 1.1 * TURN):
        assert rotation_or_none(value) is None
    T = pose_of([1, 2, 3], TURN)
    kept = pose_or_none(T)
    assert kept is not None
    np.testing.assert_array_equal(kept, T)
    sheared, far = T.copy(), T.copy()
    sheared[3, 0], far[0, 3] = 1e-3, 2 * FARTHEST
    for value in (TURN, sheared, far, pose_of([np.nan, 0, 0]), pose_of(rotation=-TURN)):
        assert pose_or_none(value) is None


def test_a_pose_of_nothing_is_the_identity():
    np.testing.assert_array_equal(pose_of(), np.eye(4))
    np.testing.assert_array_equal(pose_of([1, 2, 3]) @ [0, 0, 0, 1], [1, 2, 3, 1])
    np.testing.assert_array_equal(pose_of(rotation=TURN)[:3, :3], TURN)


def test_matrices_of_quaternions_and_of_rotation_vectors():
    turns = Rotation.random(4, rng=np.random.default_rng(2))
    for values in (turns.as_quat(), turns.as_rotvec()):
        result = to_matrices(np.vstack([values, [np.nan] * values.shape[1]]))
        np.testing.assert_allclose(result[:4], turns.as_matrix(), atol=1e-14)
        assert np.isnan(result[4]).all()


def test_quaternions_of_matrices():
    turned = Rotation.random(5, rng=np.random.default_rng(1))
    quaternions = to_quaternions(np.concatenate([turned.as_matrix(), np.full((1, 3, 3), np.nan)]))
    assert (quaternions[:5, 3] >= 0).all()
    assert np.isnan(quaternions[5]).all()
    again = Rotation.from_quat(quaternions[:5])
    np.testing.assert_allclose((again * turned.inv()).magnitude(), 0.0, atol=1e-14)


@pytest.mark.parametrize(
    "matrix",
    [np.diag([1, 1, -1]), np.eye(3) * 1.001, np.full((3, 3), np.nan), np.ones((3, 3))],
)
def test_what_is_not_rotations(matrix):
    assert not_rotations(np.array([np.eye(3), matrix])).tolist() == [False, True]


@pytest.mark.parametrize(
    "angle", [0.0, 1e-12, 1e-6, 0.9e-4, 1.1e-4, 0.1, 1.0, 3.0, np.pi - 1e-3, np.pi - 1e-7, np.pi]
)
def test_the_derivative_of_the_logarithm_against_its_inverse_series(angle):
    """d exp(r) by its power series, sum (-1)^k [r]x^k / (k + 1)!, inverted; log has no limit but its own at pi."""
    turned = Rotation.from_rotvec(angle * np.array([[0.48, -0.6, 0.64]]))
    x, y, z = turned.as_rotvec()[0]
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    series = sum(
        (-1.0) ** k * np.linalg.matrix_power(cross, k) / factorial(k + 1) for k in range(40)
    )
    np.testing.assert_allclose(inverse_right_jacobian(turned)[0], np.linalg.inv(series), atol=1e-7)


@pytest.mark.parametrize("angle", [2e-5, 0.9e-4, 1.1e-4])
def test_the_inverse_right_jacobian_of_small_rotations_is_its_series(angle):
    """To the second order, on both sides of the angle below which the closed form loses its digits."""
    r = angle * np.array([0.6, -0.48, 0.64])
    cross = np.cross(r, np.eye(3)).T
    J = inverse_right_jacobian(Rotation.from_rotvec(r[None]))[0]
    second = J - np.eye(3) - 0.5 * cross
    np.testing.assert_allclose(second, cross @ cross / 12.0, atol=0.02 * angle**2)
