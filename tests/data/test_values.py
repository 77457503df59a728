"""What rows hold: those that are planned and not measured yet, lists of points, cells that are refused."""

from __future__ import annotations

import numpy as np
import pytest

from calib.data.measurements import Measurements
from tests.data.tables import HEADER, ROWS, refused

PLAN_HEADER = (
    "row,set,point,a [deg],x [mm],y [mm],z [mm],expected x [mm],expected y [mm],expected z [mm]"
)
PLAN = (
    "1,estimate,P1,1,100,200,300,101,201,301",
    "2,estimate,P2,2,,,,102,202,302",
    "3,validate,P3,3,103,200,300,103,203,303",
    "4,estimate,P4,4,,,,104,204,304",
)


def test_poses_that_are_still_to_come_are_left_out(table):
    m = Measurements.read(table(PLAN_HEADER, *PLAN))
    assert m.unmeasured == (2, 4)
    assert m.rows == (1, 3)
    assert m.sets == ("estimate", "validate")
    np.testing.assert_allclose(m.points, [[0.1, 0.2, 0.3], [0.103, 0.2, 0.3]], rtol=1e-14)
    np.testing.assert_allclose(np.degrees(m.joints[:, 0]), [1.0, 3.0], rtol=1e-14)
    assert m.select(np.array([True, False])).unmeasured == (2, 4)
    whole = Measurements.read(table(PLAN_HEADER, PLAN[0], PLAN[2]))
    assert whole.unmeasured == ()


def test_poses_that_are_only_driven_through_are_known_by_the_moves(table, listed):
    """Whatever their cells hold; a list of points has none of them, by its names or in its order."""
    header, row = "set,point,a [deg],x [mm],y [mm],z [mm]", "estimate,P1,3,100,200,300"
    m = Measurements.read(table(header, "via,,1,,,", row, "via,,8,1,2,3", "validate,P2,6,1,2,3"))
    assert (m.rows, m.unmeasured, m.sets) == ((2, 4), (), ("estimate", "validate"))
    np.testing.assert_allclose(np.degrees(m.moves[:, 0]), [2.0, -2.0])
    named = table("set,point,a [deg]", "via,,1", "estimate,P1,3", "via,,8", "validate,P2,6")
    bare = table("set,a [deg]", "via,1", "estimate,3", "via,8", "validate,6", name="bare.csv")
    for path, prefix in ((named, "P"), (bare, "")):
        lines = ("1 100 200 300", "2 1 2 3") if prefix else (" 100 200 300", " 1 2 3")
        points = listed("# Units: mm", *(prefix + line for line in lines))
        m = Measurements.read(path, ["a"], points=points)
        assert (m.rows, m.unmeasured) == ((2, 4), ())
        np.testing.assert_allclose(m.points[:, 0], [0.1, 0.001])
        np.testing.assert_allclose(np.degrees(m.moves[:, 0]), [2.0, -2.0])


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
    refused(
        table(PLAN_HEADER, PLAN[1], PLAN[3]), f"{says}, or give the instrument's list of points"
    )
    refused(table("a [deg],distance [mm]", "1,", "2,"), f"{says}.")


def test_a_list_of_points_that_is_not_complete_yet(table, listed):
    path = table(PLAN_HEADER, *PLAN)
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


# Words and cells that are refused


def test_a_word_that_is_no_set_is_named_with_its_column_and_remedy(table):
    rows = [row.replace("estimate", "teach_pendant") for row in PLAN]
    file = table(PLAN_HEADER.replace("set", "Set"), *rows)
    refused(
        file, "line 2 (row 1), column 'Set': 'teach_pendant' is not a set; allowed are 'estimate'"
    )
    refused(file, '--columns "Set=-" leaves it out')
    m = Measurements.read(file, columns={"Set": "-"})
    assert m.sets == ("estimate", "estimate")


def test_a_row_that_is_not_measured_may_be_of_no_set(table):
    rows = [PLAN[0], PLAN[1].replace("estimate", "later"), *PLAN[2:]]
    assert Measurements.read(table(PLAN_HEADER, *rows)).sets == ("estimate", "validate")


@pytest.mark.parametrize(
    ("row", "says"),
    [
        ("7,estimate,1,2,3,4", ["has 6 cells, the header has 7"]),
        ("7,estimate,1,2,3,4,5,6", ["has 8 cells, the header has 7", "decimal comma"]),
        ("7,estimate,1,,3,4,5", ["column 'b [deg]'", "the cell is empty"]),
        ("7,estimate,1,2,3,nan,5", ["column 'y [mm]'", "holds no number ('nan')"]),
        ("7,estimate,1,2,3,4,5 mm", ["column 'z [mm]'", "'5 mm' is not a finite number"]),
        ("7,estimate,1,2,3,4,1_000", ["column 'z [mm]'", "'1_000' is not a finite number"]),
        ('7,estimate,1,2,3,4,"5,5"', ["column 'z [mm]'", "decimal comma", "semicolons"]),
        ("7,estimate,1,2,3e8,4,5", ["column 'x [mm]'", "further from the origin than 100 m"]),
    ],
)
def test_cells_that_are_refused(table, row, says):
    path = table(HEADER, "# remark", ROWS[0], row)
    refused(path, says=["data.csv, line 4 (row ", *says])


def test_without_a_row_column_rows_are_counted(table):
    path = table("", "a [deg],x [mm],y [mm],z [mm]", "1,2,3,4", "", "1,2,3,no")
    refused(path, says="line 5 (row 2), column 'z [mm]'")


def test_row_numbers_are_whole(table):
    refused(
        table(HEADER, ROWS[0], "2.0,estimate,1,2,3,4,5"),
        "column 'row': '2.0' is not a whole number",
    )


@pytest.mark.parametrize(
    "text", ["5-Jan", "May-01", "1. Mai", "01.05.2026", "1/5/2026", "1/5", "2026-05-01 00:00:00"]
)
def test_a_date_in_a_cell_is_called_one(table, text):
    refused(table("a [deg],x [mm],y [mm],z [mm]", f"{text},1,2,300"), f"the date '{text}'")


@pytest.mark.parametrize("text", ["abc", "1.5.", "n.b.", "1-2"])
def test_other_words_are_no_dates(table, text):
    refused(table("a [deg],x [mm],y [mm],z [mm]", f"{text},1,2,300"), "is not a finite number")


def test_the_units_of_the_file_are_kept(table, listed):
    m = Measurements.read(table("a [deg],x [mm],y [cm],z [mm]", "1,100,20,300"))
    assert m.units == {"a": "deg", "x": "mm", "y": "cm", "z": "mm"}
    points = listed("# Units: mm", "100.5 200 300")
    assert Measurements.read(table("a [rad]", "1"), points=points).units["y"] == "mm"
