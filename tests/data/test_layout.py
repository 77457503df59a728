"""Rows that are planned and not measured yet."""

from __future__ import annotations

import re

import numpy as np
import pytest

from calib.data.measurements import Measurements
from calib.errors import MeasurementError

HEADER = (
    "row,set,point,a [deg],x [mm],y [mm],z [mm],expected x [mm],expected y [mm],expected z [mm]"
)
ROWS = (
    "1,estimate,P1,1,100,200,300,101,201,301",
    "2,estimate,P2,2,,,,102,202,302",
    "3,validate,P3,3,103,200,300,103,203,303",
    "4,estimate,P4,4,,,,104,204,304",
)


@pytest.fixture
def table(tmp_path):
    """Writes a table's lines to a file and gives its path."""

    def write(*lines):
        path = tmp_path / "plan.csv"
        path.write_text("\n".join([*lines, ""]), encoding="utf-8")
        return path

    return write


@pytest.fixture
def listed(tmp_path):
    """Writes a list of points and gives its path."""

    def write(*lines):
        path = tmp_path / "tracker.txt"
        path.write_text("\n".join(["# Units: mm", *lines, ""]), encoding="utf-8")
        return path

    return write


def refused(path, says, **arguments):
    with pytest.raises(MeasurementError, match=re.escape(says)) as caught:
        Measurements.read(path, **arguments)
    assert "\n" not in str(caught.value)


def test_poses_that_are_still_to_come_are_left_out(table):
    m = Measurements.read(table(HEADER, *ROWS))
    assert m.unmeasured == (2, 4)
    assert m.rows == (1, 3)
    assert m.sets == ("estimate", "validate")
    np.testing.assert_allclose(m.points, [[0.1, 0.2, 0.3], [0.103, 0.2, 0.3]], rtol=1e-14)
    np.testing.assert_allclose(np.degrees(m.joints[:, 0]), [1.0, 3.0], rtol=1e-14)
    assert m.select(np.array([True, False])).unmeasured == (2, 4)
    whole = Measurements.read(table(HEADER, ROWS[0], ROWS[2]))
    assert whole.unmeasured == ()


COMMANDS = "a [deg],x [mm],y [mm],z [mm],correction a [deg],correction position [mm],status"
SENT = ("1,100,200,300,0.1,1.5,ok", ',,,,,,"no command: out of reach"', "3,103,200,300,0.1,2,ok")


def test_rows_of_commands_that_were_never_sent_are_left_out(table, listed):
    """`calib compensate --skip` leaves them empty, and the instrument has no point of them."""
    m = Measurements.read(table(COMMANDS, *SENT), ["a"])
    assert (m.rows, m.unmeasured) == ((1, 3), (2,))
    assert m.ignored == ("correction a [deg]", "correction position [mm]")
    points = listed("100.5 200 300", "103.5 200 300")
    m = Measurements.read(table(COMMANDS, *SENT), ["a"], points=points)
    assert (m.rows, m.unmeasured) == ((1, 3), (2,))
    np.testing.assert_allclose(m.points[:, 0], [0.1005, 0.1035], rtol=1e-14)


def test_every_kind_that_measures_may_be_empty(table):
    pose = table("a [deg],x [mm],y [mm],z [mm],qx,qy,qz,qw", "1,100,200,300,0,0,0,1", "2,,,,,,,")
    assert Measurements.read(pose).unmeasured == (2,)
    distance = table("a [deg],distance [mm],expected distance [mm]", "1,,500", "2,501,502")
    m = Measurements.read(distance)
    assert (m.kinds, m.unmeasured, m.ignored) == (("distance",), (1,), ())
    mixed = table(
        "kind,a [deg],x [mm],y [mm],z [mm],group", "fixed,1,,,,A", "fixed,2,,,,A",
        "point,3,,,,", "point,4,100,200,300,",
    )  # fmt: skip
    m = Measurements.read(mixed)
    assert (m.kinds, m.unmeasured) == (("fixed", "fixed", "point"), (3,))


@pytest.mark.parametrize(
    ("row", "says"),
    [
        ("2,estimate,P2,2,100,,,,,", "line 3 (row 2), column 'y [mm]': the cell is empty"),
        ("2,estimate,P2,,100,200,300,,,", "line 3 (row 2), column 'a [deg]': the cell is empty"),
    ],
)
def test_half_a_row_is_refused(table, row, says):
    refused(table(HEADER, ROWS[0], row), says)


def test_a_plan_of_which_nothing_is_measured(table):
    says = "plan.csv: nothing is measured yet in its 2 rows. Fill in what was measured at each pose"
    refused(table(HEADER, ROWS[1], ROWS[3]), f"{says}, or give the instrument's list of points")
    refused(table("a [deg],distance [mm]", "1,", "2,"), f"{says}.")


def test_a_list_of_points_that_is_not_complete_yet(table, listed):
    path = table(HEADER, *ROWS)
    m = Measurements.read(path, points=listed("A::P3 1 2 300", "A::P1 4 5 600"))
    assert (m.rows, m.unmeasured) == ((1, 3), (2, 4))
    np.testing.assert_allclose(m.points, [[0.004, 0.005, 0.6], [0.001, 0.002, 0.3]], rtol=1e-14)
    # A point that no row names: a name is more likely misspelt than a pose left out.
    refused(
        path,
        "row 2: in tracker.txt there is no point 'P2'",
        points=listed("P1 4 5 600", "P22 1 2 300"),
    )
    only = listed("P3 1 2 300")
    refused(path, "no measured row is 'estimate', all 1 are 'validate'", points=only)


def test_points_in_the_order_of_the_rows(table, listed):
    path = table(HEADER, *ROWS)
    points = listed(*(f"Q{k} {k} 2 300" for k in range(4)))
    refused(
        path, 'where the points are in the order of the rows, --columns "point=-"', points=points
    )
    m = Measurements.read(path, points=points, columns={"point": "-"})
    np.testing.assert_allclose(1e3 * m.points[:, 0], [0.0, 1.0, 2.0, 3.0], atol=1e-12)
