"""Headings of DH rows, in the spellings that tables have."""

from __future__ import annotations

import numpy as np
import pytest

from calib.basics.tables import Table
from calib.errors import MeasurementError
from calib.robot.dh.columns import dh_columns, is_dh_table


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
