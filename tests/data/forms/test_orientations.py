"""Every convention of orientations is SciPy's rotation of the same name, both ways, at gimbal lock too."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.data.forms.orientations import CONVENTIONS, find_convention
from calib.errors import MeasurementError

#: SciPy's rotation of each convention's numbers, [rad].
SCIPY = {
    "quaternion": Rotation.from_quat,
    "abb": lambda n: Rotation.from_quat(n[:, [1, 2, 3, 0]]),
    "rotation-vector": Rotation.from_rotvec,
    "rpy": lambda n: Rotation.from_euler("xyz", n),
    "fanuc": lambda n: Rotation.from_euler("xyz", n),
    "yaskawa": lambda n: Rotation.from_euler("xyz", n),
    "kuka": lambda n: Rotation.from_euler("ZYX", n),
    "staubli": lambda n: Rotation.from_euler("XYZ", n),
    "matrix": lambda n: Rotation.from_matrix(n.reshape(-1, 3, 3)),
}


def rotations():
    """1,000 at random, and many with the second angle at or beside a right angle, for either kind of axes."""
    right = [
        [first, sign * np.pi / 2 + beside, last]
        for first in (0.0, 0.3, -2.0, np.pi)
        for sign in (-1, 1)
        for beside in (0.0, 1e-13, -1e-9, 1e-6)
        for last in (0.0, 1.0, -2.5)
    ]
    parts = [
        Rotation.random(1000, random_state=1),
        Rotation.from_euler("ZYX", right),
        Rotation.from_euler("XYZ", right),
        Rotation.from_rotvec(np.pi * np.vstack([np.eye(3), np.zeros(3)])),
    ]
    return Rotation.concatenate(parts)


def test_there_is_a_reference_for_each():
    assert SCIPY.keys() == CONVENTIONS.keys()


@pytest.mark.parametrize("name", SCIPY)
def test_numbers_and_matrices_are_scipy_s(name):
    convention = find_convention(name)
    R = rotations().as_matrix()
    numbers = convention.numbers(R)
    assert numbers.shape == (len(R), len(convention.columns))
    np.testing.assert_allclose(SCIPY[name](numbers).as_matrix(), R, rtol=0, atol=1e-12)
    np.testing.assert_allclose(convention.matrices(numbers), R, rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", ["rpy", "fanuc", "yaskawa", "kuka", "staubli"])
def test_three_angles_of_any_size_are_scipy_s(name):
    angles = np.random.default_rng(2).uniform(-7.0, 7.0, (1000, 3))
    angles[:100, 1] = np.pi / 2
    R = SCIPY[name](angles).as_matrix()
    np.testing.assert_allclose(find_convention(name).matrices(angles), R, rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", CONVENTIONS)
def test_what_was_not_measured_stays_so(name):
    convention = find_convention(name)
    R = np.stack([np.eye(3), np.full((3, 3), np.nan)])
    numbers = convention.numbers(R)
    assert np.isnan(numbers).all(axis=1).tolist() == [False, True]
    assert np.isnan(convention.matrices(numbers)).all(axis=(1, 2)).tolist() == [False, True]


def test_a_matrix_of_few_digits_is_the_nearest_rotation():
    R = Rotation.random(20, random_state=3).as_matrix()
    found = find_convention("matrix").matrices(R.round(3).reshape(-1, 9))
    np.testing.assert_allclose(
        found @ found.transpose(0, 2, 1), np.eye(3)[None].repeat(20, 0), atol=1e-14
    )
    assert np.abs(found - R).max() < 1e-3


def test_an_unknown_convention_is_refused():
    with pytest.raises(MeasurementError, match=r"'kuke'.*--orientation.*'kuka'"):
        find_convention("kuke")
