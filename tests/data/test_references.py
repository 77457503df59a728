"""Rows of the set ``reference``: which they are, their order, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from calib.basics.tables import Table
from calib.data.cell_chains import sights_of
from calib.data.measurements import Measurements
from calib.data.references import References, split_references
from calib.errors import MeasurementError

HEADER = "set,target,joint_1 [deg],joint_2 [deg],x [mm],y [mm],z [mm]"
ROWS = (
    "reference,floor 1,,,1000,0,10",
    "estimate,ball,10,20,300.1,5,50",
    "estimate,ball,11,20,300.2,6,50",
    "reference,floor 1,,,1000.01,0,10",
    "reference,floor 2,7,,1000.02,500,10",
    "validate,ball,12,20,301.1,6,50",
    "reference,floor 1,,,1000.02,0,10",
)


def written(tmp_path, *lines, header=HEADER):
    path = tmp_path / "table.csv"
    path.write_text("\n".join((header, *lines)) + "\n", encoding="utf-8")
    return path


def test_references_are_no_rows_of_the_fit(tmp_path):
    m = Measurements.read(written(tmp_path, *ROWS))
    assert m.rows == (2, 3, 6)
    assert set(m.targets) == {"ball"}
    still = m.references
    assert still is not None
    assert still.rows == (1, 4, 5, 7)
    assert still.targets == ("floor 1", "floor 1", "floor 2", "floor 1")
    assert still.sequence == (1, 2, 3, 4, 5, 6, 7)
    np.testing.assert_allclose(still.points[2], [1.00002, 0.5, 0.01], rtol=1e-15)
    assert still.places_of(m.rows).tolist() == [1, 2, 5]
    # The arm moved from row 2 to 3 and from 3 to 6: no joint value of a reference comes between.
    np.testing.assert_allclose(np.degrees(m.moves[:, 0]), [0.0, 1.0, 1.0], atol=1e-12)


def test_a_table_without_references_has_none(tmp_path):
    m = Measurements.read(written(tmp_path, ROWS[1], ROWS[2]))
    assert m.references is None
    assert m.rows == (1, 2)


def test_written_and_read_again(tmp_path):
    m = Measurements.read(written(tmp_path, *ROWS))
    path = tmp_path / "again.csv"
    m.write(path)
    again = Measurements.read(path)
    assert again.rows == m.rows
    assert again.references.sequence == m.references.sequence
    assert again.references.targets == m.references.targets
    np.testing.assert_array_equal(again.references.points, m.references.points)
    frame = m.to_frame()
    assert Measurements.of(frame).references.rows == m.references.rows


def test_some_rows_keep_the_references(tmp_path):
    m = Measurements.read(written(tmp_path, *ROWS))
    some = m.select(m.validation)
    assert some.references.places_of(some.rows).tolist() == [5]
    path = tmp_path / "some.csv"
    m.select(m.estimation).write(path)
    assert Measurements.read(path).references.sequence == (1, 2, 3, 4, 5, 7)


def test_the_column_order_sorts_them_too(tmp_path):
    header = HEADER + ",order,row"
    order = (60, 20, 30, 35, 36, 50, 10)
    lines = [f"{row},{o},{100 + k}" for k, (row, o) in enumerate(zip(ROWS, order, strict=True))]
    m = Measurements.read(written(tmp_path, *lines, header=header))
    assert m.rows == (101, 102, 105)
    assert m.references.sequence == (106, 101, 102, 103, 104, 105, 100)
    assert m.references.rows == (106, 103, 104, 100)


def test_references_are_not_targets_of_the_robot(tmp_path):
    table = Table.read(written(tmp_path, *ROWS))
    assert sights_of(table) == (("", "ball"),)
    poses, references = split_references(table)
    assert len(poses.cells) == 3
    assert references is not None
    assert len(references.cells) == 4


def test_points_of_a_list(tmp_path):
    table = written(
        tmp_path,
        "reference,floor,R1,",
        "estimate,ball,P1,10",
        "estimate,ball,P2,11",
        "reference,floor,R2,",
        header="set,target,point,joint_1 [deg]",
    )
    points = tmp_path / "points.txt"
    points.write_text("// Units: mm\nR1 1 2 3\nP1 4 5 6\nP2 7 8 9\nR2 1 2 4\n", encoding="utf-8")
    m = Measurements.read(table, points=points)
    np.testing.assert_allclose(m.references.points, [[0.001, 0.002, 0.003], [0.001, 0.002, 0.004]])
    np.testing.assert_allclose(m.points, [[0.004, 0.005, 0.006], [0.007, 0.008, 0.009]])


def test_a_reading_that_is_not_there_is_passed_over(tmp_path):
    m = Measurements.read(written(tmp_path, *ROWS, "reference,floor 1,,,,,"))
    assert len(m.references) == 4


@pytest.mark.parametrize(
    ("lines", "header", "place"),
    [
        ([*ROWS, "reference,floor 1,,,1,2,"], HEADER, "row 8"),
        ([*ROWS, "reference,floor 1,,,1,2,x"], HEADER, "column 'z [mm]'"),
        ([ROWS[0], ROWS[3]], HEADER, "all rows"),
        (
            ["estimate,10,1,2,3,point", "reference,,1,2,3,distance"],
            "set,joint_1 [deg],x [mm],y [mm],z [mm],kind",
            "column 'kind'",
        ),
        (
            ["estimate,10,100,200,300,left", "reference,,100,200,300,right"],
            "set,joint_1 [deg],x [mm],y [mm],z [mm],group",
            "station 'right'",
        ),
        (
            ["estimate,10,500", "reference,,500"],
            "set,joint_1 [deg],distance [mm]",
            "column 'x [mm]'",
        ),
        (
            ["1,estimate,10,1,2,3", "1,reference,,1,2,3"],
            "row,set,joint_1 [deg],x [mm],y [mm],z [mm]",
            "row number 1",
        ),
        (
            ["estimate,10,1,2,3,1", "reference,,1,2,3,"],
            "set,joint_1 [deg],x [mm],y [mm],z [mm],order",
            "column 'order'",
        ),
    ],
)
def test_what_is_refused(tmp_path, lines, header, place):
    with pytest.raises(MeasurementError, match=place.replace("[", r"\[")):
        Measurements.read(written(tmp_path, *lines, header=header))


def test_values_in_memory_are_checked():
    one = {"points": np.zeros((1, 3)), "targets": ("a",), "groups": ("",), "rows": (2,)}
    References(**one, sequence=(1, 2))
    with pytest.raises(MeasurementError, match="sequence"):
        References(**one, sequence=(1,))
    with pytest.raises(MeasurementError, match="points"):
        References(**(one | {"points": np.zeros((2, 3))}), sequence=(1, 2))
    with pytest.raises(MeasurementError, match="names"):
        References(**(one | {"targets": ()}), sequence=(1, 2))
    still = References(**one, sequence=(1, 2))
    with pytest.raises(MeasurementError, match="sequence"):
        Measurements(("j",), np.zeros((1, 1)), np.zeros((1, 3)), rows=(3,), references=still)


@pytest.mark.parametrize("word", ["Reference", "REFERENCE", "references"])
def test_the_word_is_to_be_written_as_it_is(tmp_path, word):
    rows = (ROWS[0].replace("reference", word), *ROWS[1:])
    with pytest.raises(MeasurementError, match=f"line 2 .row 1., column 'set': '{word}'"):
        Measurements.read(written(tmp_path, *rows))
