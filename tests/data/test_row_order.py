"""The order in which a table's rows were measured: by the rows, by a column, by stated moves."""

from __future__ import annotations

import numpy as np
import pytest

from calib.data.measurements import Measurements
from calib.errors import MeasurementError
from tests.data.tables import refused, write_lines

#: Four rows of two joints; the third was not measured, but the robot was there.
ROWS = ("10,0,1,2,3", "20,-5,1,2,4", "40,-5,,,", "30,1,2,2,4")
MOVES = np.deg2rad([[0.0, 0.0], [10.0, -5.0], [-10.0, 6.0]])


def read(folder, header: str, *rows: str) -> Measurements:
    return Measurements.read(write_lines(folder, header, *rows))


def test_a_move_is_from_the_row_before_measured_or_not(tmp_path):
    m = read(tmp_path, "a [deg],b [deg],x [m],y [m],z [m]", *ROWS)
    assert m.joint_names == ("a", "b")
    np.testing.assert_allclose(m.moves, MOVES, atol=1e-15)
    np.testing.assert_allclose(m.moves_for(("b", "a")), MOVES[:, ::-1], atol=1e-15)


def test_a_sorted_table_has_its_order_in_a_column(tmp_path):
    header = "order,a [deg],b [deg],x [m],y [m],z [m]"
    shuffled = [f"{10 * k},{ROWS[k]}" for k in (3, 0, 2, 1)]
    m = read(tmp_path, header, *shuffled)
    np.testing.assert_allclose(m.moves, MOVES[[2, 0, 1]], atol=1e-15)


def test_stated_moves_are_taken_and_written(tmp_path):
    m = read(
        tmp_path, "a [deg],a.move [deg],b [deg],x [m],y [m],z [m]", "10,3,0,1,2,3", "20,-7,5,1,2,4"
    )
    assert m.joint_names == ("a", "b")
    np.testing.assert_allclose(np.rad2deg(m.moves), [[3.0, 0.0], [-7.0, 5.0]], atol=1e-12)
    m.write(tmp_path / "again.csv")
    again = Measurements.read(tmp_path / "again.csv")
    np.testing.assert_allclose(again.moves, m.moves, atol=1e-12)


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
    refused(path, ("row 1", "order"))
