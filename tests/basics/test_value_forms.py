"""Forms of values: read into SI units, refused with what was given and what is allowed."""

from __future__ import annotations

import numpy as np
import pytest

from calib.basics.value_forms import (
    DEGREES,
    MM,
    WHOLE,
    Place,
    checked,
    decimal,
    one_of,
    shift_decimal,
    text,
    three_numbers,
)
from calib.errors import ArgumentError, CalibError


def test_a_value_is_refused_by_none_or_an_error():
    assert checked("2", "'a'", "a number", float) == 2.0
    for convert in (lambda _: None, float, lambda _: len(1)):  # type: ignore[arg-type]
        with pytest.raises(CalibError, match=r"'a' is 'x'; it must be a number\."):
            checked("x", "'a'", "a number", convert)


def test_an_error_of_calib_says_more_and_is_passed_on():
    def refuse(_: object) -> None:
        raise ArgumentError("It must be small.")

    with pytest.raises(ArgumentError, match=r"^It must be small\.$"):
        checked(3, "'a'", "a number", refuse)


def test_numbers_with_units():
    place = Place("'a'")
    assert DEGREES.read(180, place) == np.pi
    assert three_numbers("deg", np.radians).read([180, 0, 0], place)[0] == np.pi
    with pytest.raises(CalibError, match=r"'a' is \[1, 2\]; it must be three numbers"):
        three_numbers().read([1, 2], place)
    with pytest.raises(CalibError, match=r"'a' is nan; it must be a number \[mm\]"):
        MM.read(float("nan"), place)


@pytest.mark.parametrize("wrong", [True, 3.0, "3"])
def test_whole_numbers(wrong):
    assert WHOLE.read(3, Place("'a'")) == 3
    with pytest.raises(CalibError, match=r"'a' is .*; it must be a whole number"):
        WHOLE.read(wrong, Place("'a'"))


def test_the_place_of_a_key():
    table = Place().key("frames")
    inner = table.key("left")
    assert (str(table), table.heading, inner.name) == ("'frames'", "[frames]", "left")
    assert str(inner.key("xyz")) == "'xyz' in 'left' in [frames]"


def test_decimal_numbers_keep_their_digits():
    for hundredths in range(1, 20000, 7):
        assert shift_decimal(shift_decimal(hundredths / 100, -3), 3) == hundredths / 100
        assert shift_decimal(shift_decimal(hundredths / 1e5, 3), -3) == hundredths / 1e5


def test_values_are_written_and_read_back():
    for form, value in (
        (decimal("mm", -3), 0.0221),
        (decimal("%", -2), 0.00123),
        (WHOLE, 3),
        (text("a text"), "x"),
        (MM, 0.0221),
    ):
        assert form.read(form.write(value), Place("here")) == value
    layouts = one_of({"new": False, "legacy": True})
    assert layouts.write(True) == "legacy"
    assert layouts.read("new", Place("here")) is False


@pytest.mark.parametrize(
    ("form", "value"),
    [
        (decimal("mm", -3), "3"),
        (decimal("mm", -3), True),
        (decimal("mm", -3), float("inf")),
        (text("a text"), 3),
        (one_of({"new": False}), "old"),
        (one_of({"new": False}), ["new"]),
    ],
)
def test_values_of_another_form_are_refused(form, value):
    with pytest.raises(CalibError, match=r"^'key' is .*; it must be "):
        form.read(value, Place("'key'"))
