"""Numbers of an orientation near those written, against SciPy's rotations."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.data.forms.orientations import CONVENTIONS, find_convention
from calib.verbs.compensate.programs.nearest_numbers import nearest_numbers

SMALL = np.array([1e-3, -2e-3, 1.5e-3])

#: Order of SciPy for the numbers as they are written.
ANGLES = {"kuka": ("ZYX", [0, 1, 2]), "fanuc": ("xyz", [0, 1, 2]), "staubli": ("XYZ", [0, 1, 2])}


@pytest.mark.parametrize("name", ANGLES)
@pytest.mark.parametrize(
    "written", [(179.999, 10, -179.999), (-180, 170, 20), (350, 20, -350), (30, 89.99, -20)]
)
def test_angles_stay_in_their_turn_and_triple(name, written):
    order, _ = ANGLES[name]
    R = Rotation.from_euler(order, written, degrees=True) * Rotation.from_rotvec(1e-2 * SMALL)
    found = nearest_numbers(find_convention(name), R.as_matrix(), np.radians(written))
    again = Rotation.from_euler(order, found)
    assert (again.inv() * R).magnitude() < 1e-9
    assert np.abs(np.degrees(found) - written).max() < 20.0
    if written[1] < 80:
        assert np.abs(np.degrees(found) - written).max() < 0.01


@pytest.mark.parametrize("name", ANGLES)
@pytest.mark.parametrize("right", [90.0, -90.0])
def test_a_right_angle_keeps_the_first(name, right):
    order, _ = ANGLES[name]
    written = np.radians([40.0, right, -30.0])
    R = (Rotation.from_euler(order, written)).as_matrix()
    found = nearest_numbers(find_convention(name), R, written)
    np.testing.assert_allclose(found, written, atol=1e-7)
    other = Rotation.from_euler(order, [40.0, right, -29.0], degrees=True).as_matrix()
    moved = np.degrees(nearest_numbers(find_convention(name), other, written))
    np.testing.assert_allclose(moved, [40.0, right, -29.0], atol=1e-6)


def test_a_quaternion_keeps_its_sign():
    q = -Rotation.from_euler("xyz", [10, 20, 30], degrees=True).as_quat()[[3, 0, 1, 2]]
    R = Rotation.from_quat(q[[1, 2, 3, 0]]) * Rotation.from_rotvec(SMALL)
    found = nearest_numbers(find_convention("abb"), R.as_matrix(), q)
    assert found @ q > 0.99
    assert np.linalg.norm(found) == pytest.approx(1.0, abs=1e-15)


@pytest.mark.parametrize("length", [3.1415, 3.2, 2 * np.pi + 0.5, -3.2])
def test_a_rotation_vector_stays_in_its_turn(length):
    written = length * np.array([0.6, 0.0, 0.8])
    R = Rotation.from_rotvec(written) * Rotation.from_rotvec(SMALL)
    found = nearest_numbers(find_convention("rotation-vector"), R.as_matrix(), written)
    assert np.abs(found - written).max() < 0.1
    assert (Rotation.from_rotvec(found).inv() * R).magnitude() < 1e-9


def test_all_conventions_mean_the_same():
    R = Rotation.from_euler("xyz", [10, 20, 30], degrees=True).as_matrix()
    for convention in CONVENTIONS.values():
        written = convention.numbers(R[None])[0]
        np.testing.assert_allclose(nearest_numbers(convention, R, written), written, atol=1e-14)
