"""Tables of errors: titles, columns that follow from what the sets of rows have, and a column more in every drawing."""

from __future__ import annotations

import numpy as np
import pytest

from calib.basics.channels import channels_of
from calib.data.kinds import get
from calib.numerics.errors import Errors
from calib.show.as_text import blocks_text
from calib.show.errors import (
    ERROR_COLUMNS,
    ErrorColumn,
    ErrorRow,
    error_table,
    error_title,
    measured_lengths,
)


@pytest.mark.parametrize(
    ("kinds", "title"),
    [
        (["point", "fixed"], "Position error"),
        (["distance", "plane"], "Length error"),
        (["pose", "pair"], "Position or length error"),
        ([], "Position error"),
    ],
)
def test_an_error_of_a_length_is_none_of_a_position(kinds: list[str], title: str):
    units = [get(kind).units for kind in kinds]
    vector_units = [get(kind).vector_units for kind in kinds]
    channels = channels_of(units, vector_units, np.arange(len(kinds)))
    assert error_title("m", channels) == title
    assert error_title("rad", channels) == "Orientation error"


@pytest.mark.parametrize(
    ("kinds", "of"),
    [
        (["point", "fixed"], "coordinate"),
        (["distance", "plane"], "length"),
        (["pose", "pair"], "coordinate or length"),
        ([], "coordinate"),
    ],
)
def test_measured_lengths_are_those_of_the_kinds(kinds: list[str], of: str):
    units = [get(kind).units for kind in kinds]
    vector_units = [get(kind).vector_units for kind in kinds]
    assert measured_lengths(channels_of(units, vector_units, np.arange(len(kinds)))) == of


def drawn(
    rows: list[ErrorRow | str], columns: tuple[ErrorColumn, ...] = ERROR_COLUMNS
) -> list[str]:
    return blocks_text([error_table("Error", "m", rows, columns)]).splitlines()


def test_errors_have_a_span_if_positions_were_measured():
    rng = np.random.default_rng(1)
    positions, lengths = (Errors.of(1e-3 * rng.normal(size=(5, n))) for n in (3, 1))
    for errors, columns in ((positions, 7), (lengths, 4)):
        head, row = drawn([ErrorRow("rows", errors)])
        assert ("span" in head) is (columns == 7)
        assert len(row.split()) == 1 + columns
    both = drawn(
        [ErrorRow("a", lengths), "text", ErrorRow("b", positions), ErrorRow("c", Errors({}))]
    )
    assert "span" in both[0]
    assert both[1].split()[-3:] == ["-"] * 3
    assert both[2] == "text"
    assert len(both) == 4  # a set without errors has no row


def test_a_table_with_a_column_more_is_not_wider_than_a_terminal():
    positions = Errors.of(np.random.default_rng(1).normal(size=(5, 3)))
    further = ErrorColumn("95 %", lambda errors: errors.max, "95th percentile")
    head, row = drawn(
        [ErrorRow("held-out rows*, calibrated", positions)], (*ERROR_COLUMNS, further)
    )
    assert head.split()[-2:] == ["95", "%"]
    assert row.split()[-1] == row.split()[4]
    assert max(len(head), len(row)) <= 100
