"""A derivative and differences: where they agree, and where the fault is."""

from __future__ import annotations

import numpy as np
import pytest

from calib.numerics.differences import disagreement, mostly_without_value

#: Derivative of two scalars by three parameters at eight samples; the second scalar is constant.
DERIVATIVE = np.random.default_rng(1).uniform(1.0, 2.0, (8, 2, 3)) * [[1.0], [0.0]]


@pytest.mark.parametrize("factor", [1.0, 1.0005])
def test_nearly_the_same_agrees(factor):
    assert disagreement(factor * DERIVATIVE, DERIVATIVE) is None


def test_the_fault_is_named_by_scalar_and_parameter():
    wrong = DERIVATIVE.copy()
    wrong[:, 0, 2] *= -1.0
    fault = disagreement(wrong, DERIVATIVE)
    assert (fault.scalar, fault.parameter) == (0, 2)
    assert fault.given == -fault.expected


@pytest.mark.parametrize(("right", "agrees"), [(2, True), (1, False)])
def test_a_quarter_of_the_samples_suffices(right, agrees):
    given = -DERIVATIVE
    given[:right] = DERIVATIVE[:right]
    assert (disagreement(given, DERIVATIVE) is None) == agrees


def test_only_samples_with_a_value_count():
    expected = DERIVATIVE.copy()
    expected[1:, 0, 0] = np.nan
    assert disagreement(DERIVATIVE, expected) is None
    assert disagreement(-DERIVATIVE, expected) is not None
    assert disagreement(-DERIVATIVE, np.full_like(expected, np.nan)) is None
    assert disagreement(np.full_like(expected, np.nan), DERIVATIVE) is not None


def test_few_values():
    assert mostly_without_value(np.array([1.0, *[np.nan] * 7]))
    assert not mostly_without_value(np.array([1.0, 2.0, *[np.inf] * 6]))
