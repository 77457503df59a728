"""Sheets of Excel files are read as tables, programs and lists of points."""

from __future__ import annotations

import hashlib
import sys
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
from openpyxl import Workbook

from calib.basics.tables import Table
from calib.basics.workbook import sheet_names, split_sheet
from calib.data.measurements import Measurements
from calib.data.points_file import read_points
from calib.errors import FileError, MeasurementError
from tests.data.tables import refused


@pytest.fixture
def saved(tmp_path: Path):
    """Saves rows as a sheet behind an empty row, and a second sheet ``Notes``."""

    def save(*rows, name="t.xlsx"):
        book = Workbook()
        sheet = book.active
        sheet.title = "Poses"
        for number, row in enumerate(rows, 2):
            for column, value in enumerate(row, 1):
                sheet.cell(number, column, value)
        book.create_sheet("Notes")["A1"] = "note"
        book.save(tmp_path / name)
        return tmp_path / name

    return save


HEADER = ("row", "a [deg]", "x [mm]", "y [mm]", "z [mm]", "measured at")
DAY = datetime(2026, 5, 1, 12)


def test_a_sheet_is_a_table(saved):
    path = saved(HEADER, (4, 10.125, 1e3 / 7, -200, 300.5, DAY), (), (9, 1e-5, 1, 2, 300, None))
    m = Measurements.read(path)
    np.testing.assert_allclose(m.points[:, 0], [1 / 7, 1e-3], rtol=1e-15)
    np.testing.assert_allclose(np.degrees(m.joints[:, 0]), [10.125, 1e-5], rtol=1e-15)
    assert (m.rows, m.source) == ((4, 9), "t.xlsx#Poses")
    assert m.sha256 == Table.read(path).sha256 != hashlib.sha256(path.read_bytes()).hexdigest()
    table = Table.read(f"{path}#Poses")
    assert (table.lines, table.source) == ((3, 5), "t.xlsx#Poses")
    assert Table.read(f"{path}#Notes").header == ("note",)


def test_a_table_is_called_by_its_sheet_where_there_are_others(saved, tmp_path):
    assert Table.read(saved(["a [deg]"], [1])).source == "t.xlsx#Poses"
    book = Workbook()
    book.active.append(["a [deg]"])
    book.active.append([1])
    book.save(tmp_path / "one.xlsx")
    assert Table.read(tmp_path / "one.xlsx").source == "one.xlsx"


def test_two_sheets_of_a_file_are_two_tables(saved):
    path = saved(["a [deg]"], [1])
    first, notes = Table.read(path), Table.read(f"{path}#Notes")
    assert first.sha256 == Table.read(f"{path}#Poses").sha256 != notes.sha256


def test_sheets_are_listed(saved, tmp_path):
    assert sheet_names(saved(("a",))) == ("Poses", "Notes")
    with pytest.raises(FileError, match="does not exist"):
        sheet_names(tmp_path / "none.xlsx")


def test_a_sheet_is_a_list_of_points(saved):
    path = saved(("name", "x [mm]", "y [mm]", "z [mm]"), ("P1", 1, 2.5, -3), (7, 4.5, 5, 6))
    points = read_points(path)
    assert (points.names, points.lines) == (("P1", "7"), (3, 4))
    np.testing.assert_allclose(points.points, [[1e-3, 2.5e-3, -3e-3], [4.5e-3, 5e-3, 6e-3]])


def test_cells_that_are_refused(saved):
    number = (4, 10, 100, 200, 300)
    path = saved(HEADER, number, (5, 10, DAY, 200, 300))
    refused(path, ["line 4 (row 5)", "column 'x [mm]'", "date '2026-05-01"])
    refused(saved(HEADER, (4, 10, "=B3*2", 200, 300)), ["sheet 'Poses', cell C3"])
    refused(saved(HEADER, (4, 10, True, 200, 300)), ["line 3 (row 4)", "'TRUE'"])


def test_files_and_sheets_that_are_refused(saved, tmp_path):
    path = saved(HEADER)
    refused(f"{path}#Pose", ["'Pose'", "'Poses'", "'Notes'", '"t.xlsx#Poses"'])
    refused(tmp_path / "none.xlsx#A", "none.xlsx' does not exist")
    (tmp_path / "text.xlsx").write_text("a [deg],x [mm]\n")
    refused(tmp_path / "text.xlsx", "not an Excel file")


def test_without_openpyxl_the_message_says_what_to_install(saved, monkeypatch):
    path = saved(HEADER)
    monkeypatch.setitem(sys.modules, "openpyxl", None)
    refused(path, ["t.xlsx", "pip install 'robot-calib[xlsx]'"])
    with pytest.raises(MeasurementError, match=r"pip install 'robot-calib\[xlsx\]'"):
        read_points(path)


@pytest.mark.parametrize(
    ("path", "parts"),
    [
        ("a/t.xlsx", ("a/t.xlsx", "")),
        ("t.XLSM#My sheet", ("t.XLSM", "My sheet")),
        ("t#1.xlsx#", ("t#1.xlsx", "")),
        ("t.csv#A", ("t.csv#A", None)),
        ("-", ("-", None)),
    ],
)
def test_a_sheet_is_named_behind_the_file(path, parts):
    assert split_sheet(path) == parts
