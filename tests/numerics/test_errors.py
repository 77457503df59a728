"""Error figures against the paper's own tables."""

from __future__ import annotations

import numpy as np
import pytest

from calib.basics.channels import Channels
from calib.errors import CalibError
from calib.numerics.errors import Errors, interval_factor
from tests.residuals import lengths_and_angles

# The paper's Table 4: errors of rows 31 to 35 before and after calibration [mm].
BEFORE = np.array(
    [
        [0.83, -2.71, -0.88],
        [-0.91, 0.89, 0.08],
        [-0.96, -0.56, -1.04],
        [3.12, -0.97, -1.28],
        [3.39, 1.09, 0.16],
    ]
)


AFTER = np.array(
    [
        [-1.10, 0.44, 0.39],
        [-1.46, 0.99, 0.90],
        [-0.93, -0.16, -0.39],
        [1.02, 1.37, 0.69],
        [-0.58, 1.43, 1.06],
    ]
)


def test_lengths_and_angles_of_several_kinds():
    """A pose, a point and a distance: what a row lacks does not count as an error of nothing."""
    residual = np.array(
        [[3.0, 0, 4.0, 0, 0.1, 0], [0, 2.0, 0, 0, 0, 0], [-1.0, 0, 0, 0, 0, 0], [0] * 6]
    )
    used = np.array([[1] * 6, [1, 1, 1, 0, 0, 0], [1, 0, 0, 0, 0, 0], [0] * 6], dtype=bool)
    errors = Errors.of(residual, lengths_and_angles(used))
    assert (errors["m"].n, errors["rad"].n) == (3, 1)
    assert errors["m"].mean == pytest.approx(8 / 3)
    assert errors["m"].rms == pytest.approx(np.sqrt(30 / 3))
    assert (errors["m"].max, errors["rad"].max) == pytest.approx((5.0, 0.1))
    assert np.all(np.isnan(errors["m"].mean_axis))  # not all have axes
    whole = Errors.of(residual[:2], lengths_and_angles(used[:2]))
    np.testing.assert_allclose(whole["m"].mean_axis, [1.5, 1.0, 2.0])
    np.testing.assert_allclose(whole["m"].rms_axis, np.sqrt([4.5, 2.0, 8.0]))
    np.testing.assert_allclose(whole["m"].span_axis, [3.0, 2.0, 4.0])
    np.testing.assert_allclose(whole["rad"].mean_axis, [0.0, 0.1, 0.0])
    assert errors.units == ("m", "rad")
    assert errors.leading is errors["m"]


def test_a_unit_that_was_not_measured_has_no_figures():
    errors = Errors.of(np.full((2, 1), 3.0), Channels.of_unit(np.ones((2, 1), dtype=bool), "px"))
    assert (errors.units, errors.leading.unit, errors["px"].max) == (("px",), "px", 3.0)
    assert errors["m"].n == 0
    assert np.isnan([errors["m"].max, errors["m"].mean, errors["m"].rms]).all()
    assert Errors.of(np.zeros((0, 3))).leading.n == 0
    with pytest.raises(CalibError, match="'deg' is not a unit of residuals"):
        errors["deg"]


def test_a_length_alone_has_no_mean_along_an_axis():
    errors = Errors.of(np.array([[3e-3], [-1e-3]]))
    assert (errors["m"].n, errors["m"].mean, errors["m"].max) == (2, pytest.approx(2e-3), 3e-3)
    assert np.all(np.isnan(errors["m"].mean_axis))
    assert np.all(np.isnan(errors["m"].rms_axis))


@pytest.mark.parametrize(
    ("freedom", "factor"), [(1.0, 12.706), (10.0, 2.228), (63.0, 1.998), (1e9, 1.960)]
)
def test_interval_factor_is_students(freedom, factor):
    assert interval_factor(freedom) == pytest.approx(factor, abs=1e-3)
