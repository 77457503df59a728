"""Which point of a list each row of a table means."""

import pytest

from calib.data.points_file import read_points
from calib.errors import MeasurementError


@pytest.mark.parametrize(
    ("names", "rows"),
    [
        (("KR6/P1", "KR6/P2"), ("P1", "P2")),
        (("Station1_P1", "Station1_P2"), ("P1", "P2")),
        (("Run:P1", "Run:P2"), ("P1", "P2")),
        (('"Ball P1"', '"Ball P2"'), ("P1", "P2")),
        (("A::M_P1", "A::M_P2"), ("P1", "P2")),
        (("S1/KR6_P1", "S1/KR6_P2"), ("KR6_P1", "KR6_P2")),
        (("S1_1", "S1_2"), ("1", "2")),
    ],
)
def test_names_are_found_by_their_last_part(listed, names, rows):
    points = read_points(listed(*(f"{name} 100.5 200 300" for name in names)), "mm")
    assert points.of_rows("t.csv", [1, 2], rows[::-1]) == [1, 0]


def test_whole_names_win(listed):
    points = read_points(listed("OLD_P1 1 2 3.5", "P1 1 2 3", "A::P2 1 2 3", "OLD_P2 1 2 3"), "m")
    assert points.of_rows("t.csv", [1, 2], ["P1", "P2"]) == [1, 2]
    # One of the names is there as a whole, so that another's last part is another point.
    with pytest.raises(MeasurementError, match="no point 'P3'"):
        read_points(listed("P1 1 2 3.5", "OLD_P3 1 2 3"), "m").of_rows("t", [1, 2], ["P1", "P3"])


def test_a_last_part_that_several_points_have_is_refused(listed):
    points = read_points(listed("S1_P1 1 2 3.5", "S2_P1 1 2 3", "S1_P2 1 2 3"), "m")
    with pytest.raises(MeasurementError, match=r"'P1', in lines 1, 2; .* 'S1_P1', 'S2_P1'"):
        points.of_rows("t.csv", [1, 2], ["P2", "P1"])
