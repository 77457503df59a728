"""Internals of instruments: changes by parameters, and the derivatives by them."""

from __future__ import annotations

import numpy as np

from calib.model.error_model import Parameter
from calib.model.internals import FIXED, InternalValues, changed_internals

#: Three rows, with the number of the instrument and of the point, and two numbers of the instrument.
BEFORE = np.array([[0.0, 0.0, 5.0, 1.0], [0.0, 1.0, 5.0, 2.0], [1.0, 1.0, 7.0, 3.0]])


def parameter(column: int, *samples: tuple[int, int]) -> Parameter:
    return Parameter("a", "px", "", np.zeros(6), "camera", internal=column, samples=samples)


def test_a_parameter_changes_the_rows_of_its_instrument_or_of_one_point():
    of_first, of_point = parameter(2, (0, 0)), parameter(3, (0, 0), (1, 1))
    assert not of_first.of_one_point
    assert of_point.of_one_point
    found = changed_internals(BEFORE, [(of_first, 0.5, 4), (of_point, -1.0, 6)])
    np.testing.assert_array_equal(found.values[:, 2:], [[5.5, 1.0], [5.5, 1.0], [7.0, 3.0]])
    np.testing.assert_array_equal(found.values[:, :2], BEFORE[:, :2])
    expected = np.full((3, 4), FIXED)
    expected[:2, 2], expected[1, 3] = 4, 6
    np.testing.assert_array_equal(found.parameter, expected)


def test_instruments_without_internals_have_none_to_change():
    assert changed_internals(None, [(parameter(0), 1.0, 0)]) is None


def test_derivatives_by_internals_are_added_to_the_columns_of_their_parameters():
    values = InternalValues(BEFORE, np.array([[-1, -1, 0, -1], [-1, -1, 0, 1], [-1, -1, -1, 1]]))
    by_internals = np.arange(24.0).reshape(3, 2, 4)
    jacobian = np.ones((3, 2, 2))
    values.add_derivative(jacobian, by_internals)
    expected = np.ones((3, 2, 2))
    expected[:2, :, 0] += by_internals[:2, :, 2]
    expected[1:, :, 1] += by_internals[1:, :, 3]
    np.testing.assert_array_equal(jacobian, expected)
    # Of fixed internals nothing is added.
    fixed = InternalValues.fixed(BEFORE).select(np.array([0, 2]))
    fixed.add_derivative(jacobian[:2], by_internals[:2])
    np.testing.assert_array_equal(jacobian, expected)
