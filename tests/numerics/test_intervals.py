"""Intervals against tables of Student's t."""

from __future__ import annotations

import pytest

from calib.numerics.intervals import interval_factor


@pytest.mark.parametrize(
    ("freedom", "factor"), [(1.0, 12.706), (10.0, 2.228), (63.0, 1.998), (1e9, 1.960)]
)
def test_interval_factor_is_students(freedom, factor):
    assert interval_factor(freedom) == pytest.approx(factor, abs=1e-3)
