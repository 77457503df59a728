"""Messages about wrong arguments: the name, what was given, what is allowed."""

from __future__ import annotations

import numpy as np
import pytest

from calib.basics.arguments import check_number, check_type, check_whole, finite_numbers, numbers
from calib.errors import ArgumentError, CalibError, ModelError


def test_a_wrong_type_is_both_a_type_error_and_one_of_calib():
    for base in (TypeError, CalibError):
        with pytest.raises(
            base, match=r"^The argument 'robot' is of the type int \(3\); it must be a Robot\.$"
        ):
            check_type("robot", 3, str, "a Robot")
    check_type("robot", "ur3", str, "a Robot")


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (None, "is None;"),
        ("x" * 99, "is of the type str;"),
        (np.zeros((2, 3)), r"is of the type ndarray \(shape \(2, 3\)\);"),
        (object(), "is of the type object;"),
        ([1, 2], r"is of the type list \(\[1, 2\]\);"),
    ],
)
def test_what_was_given_is_said_in_one_line(given, words):
    with pytest.raises(ArgumentError, match=words) as caught:
        check_type("a", given, int, "a number")
    assert "\n" not in str(caught.value)


def test_whole_numbers():
    check_whole("count", np.int64(3), 0)
    for wrong in (1.5, True, "3"):
        with pytest.raises(ArgumentError, match="'count'"):
            check_whole("count", wrong, 0)
    with pytest.raises(ModelError, match="'count' is -1"):
        check_whole("count", -1, 0)


def test_arrays_of_numbers():
    array = np.arange(3.0)
    assert numbers("q", array, "numbers") is array
    assert numbers("q", [1, 2], "numbers").dtype == np.float64
    for wrong in ("abc", [1.0, None], [[1.0], [1.0, 2.0]], [1j], [True], {"a": 1}):
        with pytest.raises(ArgumentError, match="'q'"):
            numbers("q", wrong, "numbers")


def test_finite_numbers_of_a_shape():
    assert finite_numbers("p", [[1, 2, 3]], (None, 3), "(N, 3)").shape == (1, 3)
    with pytest.raises(ModelError, match=r"'p' has the shape \(2,\)"):
        finite_numbers("p", [1, 2], (None, 3), "(N, 3)")
    with pytest.raises(ModelError, match="NaN or infinite"):
        finite_numbers("p", [[1, 2, np.nan]], (None, 3), "(N, 3)")


@pytest.mark.parametrize(
    ("limits", "allowed"),
    [
        ({"least": 1}, "a finite number, 1 or more"),
        ({"largest": 5}, "a finite number, 5 or less"),
        ({"least": 1, "largest": 5}, "a finite number from 1 to 5"),
    ],
)
def test_limits_of_a_number_are_said(limits, allowed):
    with pytest.raises(ModelError, match=f"'a' is nan; it must be {allowed}\\."):
        check_number("a", np.nan, **limits)
