from __future__ import annotations

import numpy as np
import pytest

from calib.errors import ModelError
from calib.robot.payload import Payload, finite_vector


def test_a_payload_keeps_a_copy_of_its_centre_of_mass():
    com = np.array([0.1, 0.2, 0.3])
    payload = Payload(2.0, com)
    com[0] = 9.0
    np.testing.assert_array_equal(payload.com, [0.1, 0.2, 0.3])
    assert not payload.com.flags.writeable
    np.testing.assert_array_equal(Payload(0.0).com, np.zeros(3))


@pytest.mark.parametrize("mass", [-1e-9, np.nan, np.inf])
def test_a_mass_that_cannot_be(mass):
    with pytest.raises(ModelError, match="The mass of a payload"):
        Payload(mass)


@pytest.mark.parametrize("values", [(0.0, 1.0), (0.0, 1.0, np.nan), np.zeros((1, 3)), 1.0])
def test_what_is_no_vector_of_three_finite_numbers(values):
    with pytest.raises(ModelError, match=r"The force is .*; give three finite numbers \[N\]"):
        finite_vector(values, "force", "[N]")
