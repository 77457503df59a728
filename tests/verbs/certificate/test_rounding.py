"""Rounding of a value to its uncertainty, by the examples of the GUM and by NumPy's own digits."""

from __future__ import annotations

import math

import numpy as np
import pytest

from calib.verbs.certificate.rounding import rounded


@pytest.mark.parametrize(
    ("value", "uncertainty", "texts"),
    [
        (10.05762, 0.027, ("10.058", "0.027")),  # JCGM 100, 7.2.6
        (100.02147, 0.00079, ("100.02147", "0.00079")),  # JCGM 100, 7.2.2
        (0.34049, 0.0562, ("0.340", "0.056")),
        (12.3, 0.0996, ("12.30", "0.10")),
        (350.4, 123.4, ("350", "120")),
        (0.125, 0.10, ("0.12", "0.10")),
        (-0.0001, 0.1, ("0.00", "0.10")),
        (0.5, 9.96, ("0", "10")),
        (0.34, 0.0, ("0.340", "-")),
        (math.nan, 0.0123, ("-", "0.012")),
        (math.nan, math.nan, ("-", "-")),
    ],
)
def test_a_value_is_rounded_to_two_digits_of_its_uncertainty(value, uncertainty, texts):
    assert rounded(value, uncertainty) == texts


def test_any_uncertainty_has_two_significant_digits_and_the_value_its_places():
    random = np.random.default_rng(2)
    for exponent in random.uniform(-9.0, 4.0, 300):
        u = float(10.0**exponent)
        value = float(random.uniform(-100.0, 100.0) * u)
        text, expanded = rounded(value, u)
        assert float(expanded) == pytest.approx(float(f"{u:.1e}"), rel=1e-12)
        step = 10.0 ** (math.floor(math.log10(float(expanded)) + 1e-9) - 1)
        assert abs(float(text) - value) <= 0.5 * step * (1.0 + 1e-9)
        assert len(text.partition(".")[2]) == len(expanded.partition(".")[2])
