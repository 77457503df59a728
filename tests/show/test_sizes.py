"""Errors in the units that they are shown in."""

from __future__ import annotations

import math

import pytest

from calib.show.sizes import absurd_size, shown, sizes_of, with_unit


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [(2.5e-3, "m", "2.500 mm"), (0.01, "rad", "0.5730 deg"), (1.25, "px", "1.250 px")],
)
def test_each_unit_has_its_own(value, unit, text):
    assert with_unit(value, unit) == text
    assert shown(value, unit, 1) == f"{float(text.split()[0]):.1f}"


def test_what_does_not_exist_is_a_dash():
    assert shown(math.nan, "m") == "-"


def test_the_sizes_of_a_reason_are_in_the_order_of_the_units():
    values = {"after_px": 0.5, "after_m": 1e-3, "before_m": 2e-3}
    assert sizes_of(values, "after") == ["1.000 mm", "0.500 px"]
    assert sizes_of(values, "after", ".0f") == ["1 mm", "0 px"]
    assert sizes_of(values, "noise") == []


def test_only_what_no_arm_does_is_absurd():
    values = {"before_m": 0.019, "before_rad": 0.2, "after_m": 0.021}
    assert absurd_size(values, "before") == "11 deg"
    assert absurd_size(values, "after") == "21 mm"
    assert absurd_size({"after_m": 0.0199}, "after") == ""
