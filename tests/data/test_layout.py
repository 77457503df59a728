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
    points = listed("# Units: mm", "100.5 200 300", "103.5 200 300")
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


def test_a_plan_of_which_nothing_is_measured(table):
    says = "data.csv: nothing is measured yet in its 2 rows. Fill in what was measured at each pose"
    refused(table(HEADER, ROWS[1], ROWS[3]), f"{says}, or give the instrument's list of points")
    refused(table("a [deg],distance [mm]", "1,", "2,"), f"{says}.")


def test_a_list_of_points_that_is_not_complete_yet(table, listed):
    path = table(HEADER, *ROWS)
    m = Measurements.read(path, points=listed("# Units: mm", "A::P3 1 2 300", "A::P1 4 5 600"))
    assert (m.rows, m.unmeasured) == ((1, 3), (2, 4))
    np.testing.assert_allclose(m.points, [[0.004, 0.005, 0.6], [0.001, 0.002, 0.3]], rtol=1e-14)
    # A point that no row names: a name is more likely misspelt than a pose left out.
    refused(
        path,
        "row 2: in tracker.txt there is no point 'P2'",
        points=listed("# Units: mm", "P1 4 5 600", "P22 1 2 300"),
    )
    only = listed("# Units: mm", "P3 1 2 300")
    refused(path, "no measured row is 'estimate', all 1 are 'validate'", points=only)


# Excel's first line


@pytest.mark.parametrize("line", ["sep=;", '"sep=;"', "SEP=;", "sep=;;;"])
def test_a_line_that_names_the_separator_is_no_header(table, line: str):
    rows = [row.replace(",", ";").replace("100", "100,5") for row in (HEADER, *ROWS)]
    m = Measurements.read(table(line, *rows))
    assert m.rows == (1, 3)
    assert m.points[0, 0] == pytest.approx(0.1005)


def test_the_line_is_counted_and_a_separator_that_does_not_occur_is_not_believed(table):
    m = Measurements.read(table("sep=;", HEADER, *ROWS))
    assert m.rows == (1, 3)
    refused(
        table("sep=,", HEADER, "1,estimate,P1,x,1,2,3,4,5,6"), "line 3 (row 1), column 'a [deg]'"
    )


# What is no set


def test_a_word_that_is_no_set_is_named_with_its_column_and_remedy(table):
    rows = [row.replace("estimate", "teach_pendant") for row in ROWS]
    file = table(HEADER.replace("set", "Set"), *rows)
    refused(file, "line 2 (row 1), column 'Set': 'teach_pendant' is no set; allowed are 'estimate'")
    refused(file, '--columns "Set=-" leaves it out')
    m = Measurements.read(file, columns={"Set": "-"})
    assert m.sets == ("estimate", "estimate")


def test_a_row_that_is_not_measured_may_be_of_no_set(table):
    rows = [ROWS[0], ROWS[1].replace("estimate", "later"), *ROWS[2:]]
    assert Measurements.read(table(HEADER, *rows)).sets == ("estimate", "validate")
