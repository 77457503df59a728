from __future__ import annotations

import pytest

from calib.errors import CalibError, UrdfError, choices, did_you_mean


def test_a_message_is_made_printable():
    error = UrdfError("joint '\x1b[31m\u202e\ud800' of\ttwo\nlines")
    assert str(error) == "joint '\\u001b[31m\\u202e\\ud800' of\ttwo\nlines"
    assert isinstance(error, CalibError)


def test_a_long_message_keeps_its_ends():
    text = "a" * 2000 + "b" * 2000
    assert str(CalibError(text)) == "a" * 1500 + " [...] " + "b" * 1000
    assert str(CalibError(text[:3000])) == text[:3000]


def test_choices_are_quoted_and_those_beyond_the_limit_counted():
    assert choices(["a", "b"]) == "'a', 'b'"
    assert choices("abcd", limit=2) == "'a', 'b' and 2 more"
    assert choices([]) == ""


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("Elbow", " (did you mean 'ELBOW_2' or 'elbow_1'?)"),
        ("wrist", ""),
    ],
)
def test_names_alike_in_any_case(name, text):
    assert did_you_mean(name, ["elbow_1", "ELBOW_2", "x"]) == text
