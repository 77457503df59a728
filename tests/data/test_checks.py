"""Rows that do not fit together are refused; what a kind does not measure is not kept."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.data.checks import by_word
from calib.data.measurements import Measurements
from calib.errors import MeasurementError
from tests.data.tables import HEADER, ROWS, refused

TURNED = Rotation.from_rotvec([[0.1, -0.2, 0.3], [3.0, 0.2, -0.4]])
GOOD = {"joint_names": ("a",), "joints": np.ones((2, 1)), "points": np.ones((2, 3))}
NONE = np.full((2, 3), np.nan)


def test_rows_by_word():
    assert by_word(("a", "b", "a", "b"), np.array([True, True, True, False])) == {
        "a": [0, 2],
        "b": [1],
    }


def test_what_a_kind_does_not_measure_is_not_kept():
    turned = TURNED.as_matrix()
    m = Measurements(**GOOD, kinds=("fixed", "fixed"), rotations=turned, pairs=("p", "p"))
    assert np.isnan(m.points).all()
    assert m.rotations is None
    assert m.pairs == ("", "")
    m = Measurements(**GOOD, kinds=("point", "pose"), rotations=turned, distances=[1, 2])
    np.testing.assert_array_equal(m.rotations[1], turned[1])
    assert np.isnan(m.rotations[0]).all()
    assert m.distances is None
    for array in (m.rotations, m.of_kind("pose"), m.pair_rows):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1
    assert m.select(np.array([True, False])).rotations is None


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"kinds": ("point", "ball")}, "row 2: column 'kind': 'ball'"),
        ({"pairs": ("p",)}, "'pairs' has 1 entries"),
        ({"kinds": ("fixed", "point"), "points": NONE}, "row 2: 'points' is nan"),
        ({"kinds": ("pose", "pose")}, "row 1: a row of the kind 'pose' needs 'rotations'"),
        ({"kinds": ("point", "distance")}, "row 2: a row of the kind 'distance' needs 'distance'"),
        (
            {"kinds": ("pose", "pose"), "rotations": [np.eye(3), -np.eye(3)]},
            "row 2: 'rotations' holds no rotation",
        ),
        (
            {"kinds": ("pose", "pose"), "rotations": [np.eye(3), np.eye(3) * np.nan]},
            "row 2: 'rotations' is nan",
        ),
        (
            {"kinds": ("pose",) * 2, "rotations": [np.eye(3)] * 2, "sigma": {"rad": [0.1, 0.0]}},
            "row 2: 'sigma_angle' is 0;",
        ),
        ({"kinds": ("distance",) * 2, "distances": [1, -1]}, "row 2: 'distance' is -1;"),
        (
            {"kinds": ("pair",) * 2, "distances": [1, 2], "pairs": ("p", "p")},
            "row 1: its pair has 1 m here and 2 m in row 2",
        ),
        ({"torques": [[1], [np.nan]]}, "row 2: joint 'a' has no torque here"),
        ({"joint_names": ("distance",)}, "given were 'distance'"),
    ],
)
def test_what_does_not_fit_together_is_refused(change, says):
    with pytest.raises(MeasurementError) as caught:
        Measurements(**(GOOD | change))
    assert says in str(caught.value)


@pytest.mark.parametrize(
    ("lines", "says"),
    [
        (("1,p,500", "2,q,", "3,p,"), "row 2: 'distance' is nan"),
        (
            ("1,p,500", "2,q,600", "3,p,"),
            "the pair 'q' is in row 2; a distance is between",
        ),
        (("1,p,500", "2,p,500", "3,p,500"), "the pair 'p' is in rows 1, 2, 3; a distance"),
        (
            ("1,p,500", "2,p,501"),
            "row 1: its pair has 0.5 m here and 0.501 m in row 2",
        ),
        (("1,p,500", "2,,501"), "line 3 (row 2), column 'pair': the cell is empty"),
        (("1,p,no", "2,p,"), "column 'distance [mm]': 'no' is not a finite number"),
    ],
)
def test_pairs_that_are_refused(table, lines, says):
    refused(table("a [deg],pair,distance [mm]", *lines), says)


def test_groups_with_too_few_rows(table):
    path = table("row,group,a [deg]", "7,A,1", "8,B,2", "9,A,3")
    refused(path, ["the group 'B' of the kind 'fixed' is in row 8;", "2 rows"], kind="fixed")
    text = refused(path, ["the group 'A' of the kind 'plane' is in rows 7, 9"], kind="plane")
    assert "4 rows or more" in text
    m = Measurements.read(table("a [deg]", "1", "2", "3", "4"), kind="plane")
    assert m.kinds == ("plane",) * 4
    assert m.select(np.array([True, False, False, False])).kinds == ("plane",)


def test_a_table_without_a_row_to_estimate_from(table):
    path = table(HEADER, ROWS[1])
    refused(path, says=["column 'set'", "no measured row is 'estimate'", "all 1"])
