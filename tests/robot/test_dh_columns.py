"""Headings of DH rows, in the spellings that tables have; and what is added to a row."""

from __future__ import annotations

import numpy as np
import pytest

from calib.basics.tables import Table
from calib.errors import MeasurementError
from calib.robot.dh_columns import dh_columns, is_dh_table, value_added


def table_of(tmp_path, *lines):
    path = tmp_path / "rows.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return Table.read(path)


@pytest.mark.parametrize(
    ("header", "is_rows"),
    [
        ("d [mm],a [mm],alpha [deg]", True),
        ("D [mm],A [mm],Alpha [deg]", True),
        ("d_i [mm],a_i [mm],α_i [deg]", True),
        ("d [mm],a(i-1) [mm],alpha(i - 1) [deg]", True),
        ("joint_1 [deg],x [mm],y [mm],z [mm]", False),
        ("d [mm],x [mm]", False),
    ],
)
def test_rows_by_their_headings(tmp_path, header, is_rows):
    assert is_dh_table(table_of(tmp_path, header, ",".join("1" * header.count("[")))) is is_rows


def test_numbers_in_si_units(tmp_path):
    table = table_of(
        tmp_path, "d [cm];a;alpha [deg];offset [deg];offset [mm]", "1,5;2 mm;90;;3", ";0;;4;5"
    )
    columns = dh_columns(table, None)
    assert columns.number(0, "d") == 0.015
    assert columns.number(0, "a") == 0.002
    assert columns.number(0, "alpha") == np.pi / 2
    assert columns.number(0, "offset", slides=True) == 0.003
    assert columns.number(0, "beta") is columns.number(1, "d") is None
    assert columns.number(1, "a") == 0.0
    with pytest.raises(MeasurementError, match=r"line 2.*'3 mm' is a length|'3' is a length"):
        columns.number(0, "offset")
    with pytest.raises(MeasurementError, match=r"the row has a number in 'offset \[mm\]', too"):
        columns.number(1, "offset")


@pytest.fixture
def added_to_j2(tmp_path):
    """Reads what is added to the row of J2, between J1 and J3, by headings and cells of these."""

    def read(heads, cells, *, slides=False):
        path = tmp_path / "arm.csv"
        empty = "," * heads.count(",")
        lines = (
            f"joint,d [mm],a [mm],alpha [deg],{heads}",
            f"J1,1,2,3,{empty}",
            f"J2,0,0,0,{cells}",
            f"J3,0,0,0,{empty}",
        )
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
        return value_added(dh_columns(Table.read(path), None), 1, "J2", slides=slides)

    return read


@pytest.mark.parametrize(
    ("head", "cell", "direction", "offset", "coupling"),
    [
        ("direction", "", 1, 0, {}),
        ("direction", "-1", -1, 0, {}),
        ("offset [deg]", "90", 1, np.pi / 2, {}),
        ("coupling", "1 * J1", 1, 0, {"J1": 1.0}),
        ("coupling", "J1 - 0.5 * J3", 1, 0, {"J1": 1.0, "J3": -0.5}),
        ("value added", "J2", 1, 0, {}),
        ("value added", "-1 * J2 - 90 deg", -1, -np.pi / 2, {}),
        ("value added", "-1 * J2 + 2 * J1 + 180 deg", -1, np.pi, {"J1": -2.0}),
        ("value added", "J2 + J1", 1, 0, {"J1": 1.0}),
        ("value added", "-J2", -1, 0, {}),
    ],
)
def test_direction_offset_and_coupling(added_to_j2, head, cell, direction, offset, coupling):
    added = added_to_j2(head, cell)
    assert added == (direction, pytest.approx(offset), coupling)


def test_the_constant_of_a_sliding_joint_is_a_length(added_to_j2):
    assert added_to_j2("value added", "J2 - 5 mm", slides=True) == (1, -0.005, {})
    assert added_to_j2("offset [mm]", "5", slides=True) == (1, 0.005, {})


FAULTS = [
    ("direction", "2", "column 'direction': '2' is not a direction"),
    ("coupling", "J1 + 3 deg", "column 'coupling': a number without a joint"),
    ("coupling", "J1 + 2 * J1", "'J1 . 2 . J1' names 'J1' twice"),
    ("value added", "held at 3 deg", "'held at 3 deg' is"),
    ("value added", "2 * J2", "'2 . J2' is not 1 or -1 times the value of 'J2'"),
    ("value added", "J2 + 3 mm", "'3 mm' is a length"),
    ("value added,direction", "J2,-1", "column 'direction': the column 'value added' says it"),
]


@pytest.mark.parametrize(("heads", "cells", "says"), FAULTS, ids=[says for *_, says in FAULTS])
def test_faults_name_row_and_column(added_to_j2, heads, cells, says):
    with pytest.raises(MeasurementError, match=rf"arm\.csv, line 3 \(row 2\), .*{says}"):
        added_to_j2(heads, cells)
