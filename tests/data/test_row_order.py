"""The order in which a table's rows were measured: by the rows, by a column, by stated moves."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from openpyxl import Workbook

from calib.data.measurements import Measurements
from calib.errors import MeasurementError
from tests.data.tables import assert_same, refused, write_lines

#: Four rows of two joints; the third was not measured, but the robot was there.
ROWS = ("10,0,1,2,3", "20,-5,1,2,4", "40,-5,,,", "30,1,2,2,4")
MOVES = np.deg2rad([[0.0, 0.0], [10.0, -5.0], [-10.0, 6.0]])

#: The order of these rows in a file that is sorted otherwise.
SHUFFLED = (3, 0, 2, 1)


def read(folder, header: str, *rows: str, **arguments: Any) -> Measurements:
    return Measurements.read(write_lines(folder, header, *rows), **arguments)


def test_a_move_is_from_the_row_before_measured_or_not(tmp_path):
    m = read(tmp_path, "a [deg],b [deg],x [m],y [m],z [m]", *ROWS)
    assert m.joint_names == ("a", "b")
    np.testing.assert_allclose(m.moves, MOVES, atol=1e-15)
    np.testing.assert_allclose(m.moves_for(("b", "a")), MOVES[:, ::-1], atol=1e-15)


def test_rows_are_sorted_by_their_order(tmp_path):
    header = "set,target,sigma [m],kind,order,a [deg],b [deg],x [m],y [m],z [m]"
    words = ("estimate,A,1", "validate,B,2", "estimate,A,3", "estimate,A,4")
    rows = [f"{words[k]},point,{10 * k},{ROWS[k]}" for k in range(4)]
    in_order = read(tmp_path, header, *rows)
    shuffled = read(tmp_path, header, *(rows[k] for k in SHUFFLED))
    np.testing.assert_allclose(shuffled.moves, MOVES, atol=1e-15)
    # Rows are called by their place in the file, or by their own numbers.
    assert (shuffled.rows, shuffled.unmeasured) == ((2, 4, 1), (3,))
    numbered = [f"{k + 1},{rows[k]}" for k in SHUFFLED]
    assert_same(read(tmp_path, f"row,{header}", *numbered), in_order)


def test_rows_of_one_number_stay_in_their_order(tmp_path):
    rows = ("5,30,0,1,2,3", "2,20,0,1,2,4", "5,31,0,1,2,5", "2,21,0,1,2,6")
    m = read(tmp_path, "order,a [deg],b [deg],x [m],y [m],z [m]", *rows)
    assert m.rows == (2, 4, 1, 3)
    np.testing.assert_allclose(np.rad2deg(m.joints[:, 0]), [20.0, 21.0, 30.0, 31.0])


def test_unmeasured_rows_without_a_number_are_passed_over(tmp_path):
    rows = [f"{'' if k == 2 else 10 * k},{ROWS[k]}" for k in SHUFFLED]
    m = read(tmp_path, "order,a [deg],b [deg],x [m],y [m],z [m]", *rows)
    np.testing.assert_allclose(m.moves[-1], np.deg2rad([10.0, 6.0]), atol=1e-15)


@pytest.mark.parametrize("named", [False, True])
def test_points_of_a_list_belong_to_rows_as_the_table_has_them(tmp_path, named):
    points = write_lines(
        tmp_path, "# Units: m", "1 1.0 2 3", "2 1.0 2 4", "3 1.0 2 5", name="l.txt"
    )
    header, rows = "order,a [deg],b [deg]", ("9,10,0", "3,20,0", "6,30,0")
    if named:
        header, rows = f"point,{header}", [f"{k},{row}" for k, row in enumerate(rows, 1)]
    m = read(tmp_path, header, *rows, points=points)
    assert m.rows == (2, 3, 1)
    np.testing.assert_allclose(m.points[:, 2], [4.0, 5.0, 3.0])
    np.testing.assert_allclose(np.rad2deg(m.moves[:, 0]), [0.0, 10.0, -20.0])


#: Tables whose second row is a pose that the robot drove by: kind of all rows, header, and the start and the end of
#: each row around the joint's value.
WAYS = {
    "points": (None, "a [deg],x [m],y [m],z [m]", ("",) * 4, (",1,2,3", ",,,", ",1,2,4", ",1,2,5")),
    "approach, set, target and row": (
        None,
        "row,set,target,approach,a [deg],x [m],y [m],z [m]",
        ("1,estimate,A,,", ",,,via,", "3,validate,A,,", "4,estimate,A,,"),
        (",1,2,3", ",,,", ",1,2,4", ",1,2,5"),
    ),
    "poses": (
        None,
        "a [deg],x [m],y [m],z [m],qx,qy,qz,qw",
        ("",) * 4,
        (",1,2,3,0,0,0,1", ",,,,,,,", ",1,2,4,0,0,0,1", ",1,2,5,0,0,0,1"),
    ),
    "several kinds": (
        None,
        "kind,a [deg],x [m],y [m],z [m],distance [m]",
        ("point,", ",", "distance,", "fixed,", "fixed,"),
        (",1,2,3,", ",,,,", ",,,,2.5", ",,,,", ",,,,"),
    ),
    "sockets": (
        "fixed",
        "set,group,a [deg]",
        ("estimate,A,", ",,", "estimate,A,", "estimate,B,", "estimate,B,"),
        ("",) * 5,
    ),
    "pairs": (
        "pair",
        "pair,a [deg],distance [m]",
        ("p,", ",", "p,", "q,", "q,"),
        (",2.5", ",", ",", ",2.6", ","),
    ),
}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("by", ["rows", "order", "sheet"])
def test_poses_that_the_robot_drove_by_count_as_moves(tmp_path, way, by):
    kind, header, starts, ends = WAYS[way]
    values = (10.0, 50.0, 20.0, 30.0, 45.0)
    rows = [f"{start}{q}{end}" for start, q, end in zip(starts, values, ends, strict=False)]
    path = tmp_path / "data.csv"
    if by == "order":
        header, rows = f"order,{header}", [f"{k},{row}" for k, row in enumerate(rows)][::-1]
    if by == "sheet":
        book = Workbook()
        for line in (header, *rows):
            cells = line.split(",")
            book.active.append([_number(cell) for cell in cells])
        path = tmp_path / "data.xlsx"
        book.save(path)
    else:
        write_lines(tmp_path, header, *rows)
    m = Measurements.read(path, kind=kind)
    assert len(m) == len(rows) - 1
    moves = np.diff(values[: len(rows)], prepend=values[0])
    np.testing.assert_allclose(np.rad2deg(m.moves[:, 0]), np.delete(moves, 1), atol=1e-12)


def _number(cell: str) -> float | str | None:
    """What Excel has in a cell that was typed in."""
    try:
        return float(cell)
    except ValueError:
        return cell or None


def test_rows_without_a_point_are_poses_that_the_robot_drove_by(tmp_path):
    points = write_lines(tmp_path, "# Units: m", "P1 1 2 3", "P2 1 2 4", "REF 0 0 0", name="l.txt")
    rows = ("P1,,10", ",via,50", "P2,,20", ",via,5")
    m = read(tmp_path, "point,approach,a [deg]", *rows, points=points)
    assert (m.rows, m.unmeasured) == ((1, 3), (2, 4))
    np.testing.assert_allclose(np.rad2deg(m.moves[:, 0]), [0.0, -30.0])


def test_several_targets_of_a_stop_have_its_move(tmp_path):
    rows = ("A,10,1,2,3", "B,10,1,2,4", ",50,,,", "A,20,1,2,3", "B,20,1,2,4")
    m = read(tmp_path, "target,a [deg],x [m],y [m],z [m]", *rows)
    np.testing.assert_allclose(np.rad2deg(m.moves[:, 0]), [0.0, 0.0, -30.0, -30.0])


def test_a_measurement_without_its_kind_is_refused(tmp_path):
    header = "kind,a [deg],x [m],y [m],z [m]"
    path = write_lines(tmp_path, header, "point,1,1,2,3", ",2,1,2,3")
    refused(path, ("line 3 (row 2)", "'kind'", "'point'"))


def test_stated_moves_are_taken_and_written(tmp_path):
    m = read(
        tmp_path, "a [deg],a.move [deg],b [deg],x [m],y [m],z [m]", "10,3,0,1,2,3", "20,-7,5,1,2,4"
    )
    assert m.joint_names == ("a", "b")
    np.testing.assert_allclose(np.rad2deg(m.moves), [[3.0, 0.0], [-7.0, 5.0]], atol=1e-12)
    m.write(tmp_path / "again.csv")
    again = Measurements.read(tmp_path / "again.csv")
    np.testing.assert_allclose(again.moves, m.moves, atol=1e-12)


def test_stated_moves_are_sorted_with_the_rows(tmp_path):
    header = "order,a [deg],a.move [deg],x [m],y [m],z [m]"
    m = read(tmp_path, header, "2,20,-7,1,2,4", "1,10,3,1,2,3")
    np.testing.assert_allclose(np.rad2deg(m.moves[:, 0]), [3.0, -7.0], atol=1e-12)


def test_moves_within_the_rows_are_not_written(tmp_path):
    m = read(tmp_path, "a [deg],b [deg],x [m],y [m],z [m]", *ROWS[:2])
    m.write(tmp_path / "again.csv")
    assert ".move" not in (tmp_path / "again.csv").read_text()


def test_some_of_the_rows_keep_their_moves(tmp_path):
    m = read(tmp_path, "a [deg],b [deg],x [m],y [m],z [m]", *ROWS)
    np.testing.assert_allclose(m.select([False, True, True]).moves, MOVES[1:], atol=1e-15)


@pytest.mark.parametrize("shape", [(2, 3), (3, 1)])
def test_moves_of_another_shape_are_refused(shape):
    points = np.zeros((3, 3))
    with pytest.raises(MeasurementError, match="moves"):
        Measurements(("a", "b"), np.zeros((3, 2)), points, moves=np.zeros(shape))


def test_an_order_that_is_no_number_is_refused(tmp_path):
    path = write_lines(tmp_path, "order,a [deg],x [m],y [m],z [m]", "first,10,1,2,3")
    refused(path, ("row 1", "order", "Write it as 123.45."))  # it has no unit
