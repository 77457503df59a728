"""Sizes of errors by family."""

import pytest

from calib.errors import CalibError
from calib.measure.cell_parts import Priors
from calib.measure.error_sizes import TYPICAL, ErrorSizes


def test_a_typical_arm():
    assert (TYPICAL.length, TYPICAL.angle, TYPICAL.zero) == (0.3e-3, 3e-3, 5e-3)


def test_the_sizes_of_a_cell_s_priors():
    priors = Priors(length=1.0, angle=2.0, zero=3.0, gain=4.0, eccentricity=5.0, compliance=6.0)
    assert ErrorSizes.of(priors) == ErrorSizes(1.0, 2.0, 3.0, 4.0, 5.0, 6.0)


@pytest.mark.parametrize("value", [-1e-9, float("nan"), float("inf"), "1 mm", True])
def test_what_is_no_size_is_refused(value):
    with pytest.raises(CalibError, match=r"size of errors in angle is .* not below 0"):
        ErrorSizes(angle=value)
