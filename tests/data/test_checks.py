import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.spatial.transform import Rotation

from calib.data.checks import no_rotation, to_matrices, to_quaternions, wrong_length

seeds = st.integers(0, 2**32 - 1)


@given(seeds)
def test_matrices_and_quaternions_are_inverses(seed):
    matrices = Rotation.random(5, rng=np.random.default_rng(seed)).as_matrix()
    quaternions = to_quaternions(matrices)
    assert (quaternions[:, 3] >= 0).all()
    np.testing.assert_allclose(np.linalg.norm(quaternions, axis=1), 1, rtol=1e-15)
    for sign in (1, -1):
        np.testing.assert_allclose(to_matrices(sign * quaternions), matrices, atol=2e-15)
    assert not no_rotation(matrices).any()


@pytest.mark.parametrize(
    ("vector", "matrix"),
    [
        ([0, 0, 0], np.eye(3)),
        ([np.pi, 0, 0], np.diag([1, -1, -1])),
        ([0, 0, np.pi / 2], [[0, -1, 0], [1, 0, 0], [0, 0, 1]]),
        ([0, 0, -3 * np.pi / 2], [[0, -1, 0], [1, 0, 0], [0, 0, 1]]),
    ],
)
def test_rotation_vectors(vector, matrix):
    np.testing.assert_allclose(to_matrices(np.array([vector], dtype=float)), [matrix], atol=1e-15)


def test_rows_without_an_orientation_stay_so():
    values = np.array([[np.nan] * 4, [0.0, 0.0, 0.0, 1.0]])
    matrices = to_matrices(values)
    assert np.isnan(matrices[0]).all()
    np.testing.assert_array_equal(matrices[1], np.eye(3))
    np.testing.assert_array_equal(to_quaternions(matrices), values)
    assert np.isnan(to_matrices(values[:1])).all()
    assert wrong_length(values) is None
    assert to_matrices(np.empty((0, 3))).shape == (0, 3, 3)


def test_lengths_other_than_one():
    assert wrong_length(np.array([[0, 0, 0, 1.0009], [0, 0, 0.5, 0]])) == (1, 0.5)


@pytest.mark.parametrize(
    "matrix",
    [
        np.diag([1, 1, -1]),
        np.eye(3) * 1.001,
        np.zeros((3, 3)),
        np.full((3, 3), np.nan),
        np.ones((3, 3)),
    ],
)
def test_what_is_no_rotation(matrix):
    assert no_rotation(np.array([np.eye(3), matrix])).tolist() == [False, True]
