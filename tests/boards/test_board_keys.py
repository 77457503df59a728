"""Keys of a board: every field has one, and numbers keep their digits."""

from __future__ import annotations

from dataclasses import fields

import pytest

from calib.boards.board import Board
from calib.boards.board_keys import (
    MM,
    PERCENT,
    WHOLE,
    json_key,
    keys_of,
    one_of,
    shift_decimal,
    text,
)
from calib.errors import CalibError


def test_lengths_keep_their_digits():
    for hundredths in range(1, 20000, 7):
        assert shift_decimal(shift_decimal(hundredths / 100, -3), 3) == hundredths / 100
        assert shift_decimal(shift_decimal(hundredths / 1e5, 3), -3) == hundredths / 1e5


def test_every_field_of_a_board_has_a_key_of_its_own():
    rows = list(keys_of(Board))
    assert [field.name for field, _ in rows] == [field.name for field in fields(Board)]
    for names in ([row.name for _, row in rows], [json_key(field) for field, _ in rows]):
        assert len(set(names)) == len(names)
    flags = [row.option.flag for _, row in rows if row.option is not None]
    assert "--first-marker" in flags
    assert len(set(flags)) == len(flags)


def test_values_are_written_and_read_back():
    for form, value in ((MM, 0.0221), (PERCENT, 0.00123), (WHOLE, 3), (text("a text"), "x")):
        assert form.read(form.write(value), "here") == value
    layouts = one_of({"new": False, "legacy": True})
    assert layouts.write(True) == "legacy"
    assert layouts.read("new", "here") is False


@pytest.mark.parametrize(
    ("form", "value"),
    [
        (MM, "3"),
        (MM, True),
        (MM, float("inf")),
        (WHOLE, 3.0),
        (WHOLE, False),
        (text("a text"), 3),
        (one_of({"new": False}), "old"),
        (one_of({"new": False}), ["new"]),
    ],
)
def test_values_of_another_form_are_refused(form, value):
    with pytest.raises(CalibError, match=r"^'key' is .*; it must be "):
        form.read(value, "'key'")
