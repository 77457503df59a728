"""Tables of every kind: read, refused, selected, written."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.spatial.transform import Rotation

from calib.data.kinds import names
from calib.data.measurements import Measurements
from calib.errors import MeasurementError

TURNED = Rotation.from_rotvec([[0.1, -0.2, 0.3], [3.0, 0.2, -0.4]])
FIELDS = ("joints", "points", "sigma", "rotations", "distances", "sigma_angle", "torques")
WORDS = ("joint_names", "sets", "targets", "groups", "rows", "kinds", "pairs", "prismatic")


def refused(path, says, **arguments):
    """The text with which a table is refused; it holds each of the words."""
    with pytest.raises(MeasurementError) as caught:
        Measurements.read(path, **arguments)
    text = str(caught.value)
    for word in [says] if isinstance(says, str) else says:
        assert word in text
    assert "\n" not in text
    return text


def assert_same(one, other, tolerance=1e-15):
    for name in FIELDS:
        first, second = getattr(one, name), getattr(other, name)
        assert (first is None) == (second is None), name
        if first is not None:
            np.testing.assert_allclose(first, second, rtol=tolerance, atol=tolerance, err_msg=name)
    for name in WORDS:
        assert getattr(one, name) == getattr(other, name)


# Poses


@pytest.mark.parametrize(
    ("columns", "values"),
    [
        ("qx,qy,qz,qw", TURNED.as_quat()),
        ("qx,qy,qz,qw", -TURNED.as_quat()),
        ("qx [-],QY,qz [1],qw []", TURNED.as_quat() * 1.0009),
        ("rx [rad],ry [rad],rz [rad]", TURNED.as_rotvec()),
        ("rx [deg],ry [mrad],rz [rad]", TURNED.as_rotvec() * [180 / np.pi, 1000, 1]),
    ],
)
def test_a_complete_orientation_makes_poses(table, columns, values):
    rows = [f"1,{','.join(map(repr, row.tolist()))},100,200,300,0.05" for row in values]
    path = table(f"a [deg],{columns},x [mm],y [mm],z [mm],sigma_angle [deg]", *rows)
    m = Measurements.read(path)
    assert m.kinds == ("pose", "pose")
    np.testing.assert_allclose(m.rotations, TURNED.as_matrix(), atol=1e-14)
    np.testing.assert_allclose(m.points, [[0.1, 0.2, 0.3]] * 2)
    np.testing.assert_allclose(m.sigma_angle, np.deg2rad([0.05, 0.05]))
    assert m.ignored == ()
    points = Measurements.read(path, kind="point")
    assert points.kinds == ("point", "point")
    assert points.rotations is None
    assert points.sigma_angle is None
    assert len(points.ignored) == columns.count(",") + 2
    as_poses = Measurements.read(path, kind="pose")
    assert_same(as_poses, m)


POSE = "a [deg],x [mm],y [mm],z [mm],"


@pytest.mark.parametrize(
    ("header", "row", "says"),
    [
        ("qx,qy,qz,qw", "0,0,0,0.9", ["line 2 (row 1)", "length 0.9", "is 1"]),
        ("qx,qy,qz,qw [rad]", "0,0,0,1", ["column 'qw [rad]'", "'rad' cannot be"]),
        ("rx,ry,rz,b", "0,0,1,1", ["column 'rx' (a rotation vector", "no unit", "'rx [rad]'"]),
        ("rx [mm],ry [rad],rz [rad],b", "0,0,1,1", ["'mm' is not a unit of angle"]),
        ("rx [rad],ry [rad],rz [rad],b", "0,0,90,1", ["'rx [rad]'", "look like degrees"]),
        (
            "qx,qy,qz,qw,rx [rad],ry [rad],rz [rad]",
            "0,0,0,1,0,0,0",
            ["need one orientation", '--columns "rx=-"'],
        ),
        ("qx,qy,qz,qw,sigma_angle [rad]", "0,0,0,1,0.0", ["row 1: 'sigma_angle' is 0;"]),
    ],
)
def test_orientations_that_are_refused(table, header, row, says):
    refused(table(POSE + header, "1,100,200,300," + row), says)


# Distances


def test_distances(table):
    path = table("a [deg],distance [mm],group,sigma [um]", "1,500,A,10", "2,510.5,B,10")
    m = Measurements.read(path)
    assert m.kinds == ("distance", "distance")
    np.testing.assert_allclose(m.distances, [0.5, 0.5105])
    assert np.isnan(m.points).all()
    assert m.groups == ("A", "B")
    assert Measurements.read(path, kind="distance").kinds == m.kinds


def test_pairs(table):
    header = "row,a [deg],pair,distance [mm]"
    m = Measurements.read(table(header, "11,1,p,500", "12,2,q,", "13,3,p,500", "14,4,q,700"))
    assert m.kinds == ("pair",) * 4
    assert m.pairs == ("p", "q", "p", "q")
    np.testing.assert_allclose(m.distances, [0.5, 0.7, 0.5, 0.7])
    np.testing.assert_array_equal(m.pair_rows, [[0, 2], [1, 3]])
    half = m.select(np.array([True, True, False, True]))
    np.testing.assert_array_equal(half.pair_rows, [[1, 2]])
    np.testing.assert_allclose(half.distances, [0.5, 0.7, 0.7])
    assert half.select(np.array([True, False, False])).pair_rows.shape == (0, 2)


@pytest.mark.parametrize(
    ("lines", "says"),
    [
        (("1,p,500", "2,q,", "3,p,"), "row 2: 'distance' is nan"),
        (
            ("1,p,500", "2,q,600", "3,p,"),
            "the pair 'q' stands in row 2; a distance is between",
        ),
        (("1,p,500", "2,p,500", "3,p,500"), "the pair 'p' stands in rows 1, 2, 3; a distance"),
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


# Fixed points and planes


def test_fixed_points_in_groups_of_several_columns(table):
    lines = ("left,0,1", "left,1,2", "right,0,3", "left,0,4", "left,1,5", "right,0,6")
    path = table("place,socket,a [deg]", *lines)
    columns = {"socket": "group", "place": "group"}
    m = Measurements.read(path, kind="fixed", columns=columns)
    assert m.groups == ("left/0", "left/1", "right/0", "left/0", "left/1", "right/0")
    assert m.kinds == ("fixed",) * 6
    assert np.isnan(m.points).all()
    assert m.ignored == ()
    one = Measurements.read(path, kind="fixed")
    assert one.groups == ("",) * 6
    assert one.ignored == ("place", "socket")
    mixed = Measurements.read(
        table("Group,socket,a [deg]", *lines), kind="fixed", columns={"socket": "group"}
    )
    assert mixed.groups == m.groups


def test_groups_with_too_few_rows(table):
    path = table("row,group,a [deg]", "7,A,1", "8,B,2", "9,A,3")
    refused(path, ["the group 'B' of the kind 'fixed' stands in row 8;", "2 rows"], kind="fixed")
    text = refused(path, ["the group 'A' of the kind 'plane' stands in rows 7, 9"], kind="plane")
    assert "4 rows or more" in text
    m = Measurements.read(table("a [deg]", "1", "2", "3", "4"), kind="plane")
    assert m.kinds == ("plane",) * 4
    assert m.select(np.array([True, False, False, False])).kinds == ("plane",)


def test_what_is_missing_is_asked_for(table):
    path = table("a [deg],place", "1,left")
    refused(path, ["need a column 'x [mm]'", "--kind fixed", '"name in the table=x [mm]"'])
    refused(path, "need a column 'distance [mm]'", kind="distance")
    refused(path, "'socket' is not a kind of measurement; allowed are 'point', ", kind="socket")
    path = table("a [deg],distance [mm]", "1,500")
    refused(path, ["need a column 'pair'", "'distance [mm]'"], kind="pair")


# A column for the kind


def test_rows_of_several_kinds(table):
    header = (
        "kind,a [deg],x [mm],y [mm],z [mm],qx,qy,qz,qw,distance [mm],pair,group,sigma_angle [deg]"
    )
    path = table(
        header,
        "point,1,100,200,300,,,,,,,,",
        "pose,2,100,200,300,0,0,0,-1,,,,0.1",
        "distance,3,,,,,,,,500,,A,",
        "pair,4,,,,,,,,,p,,",
        "pair,5,,,,,,,,600,p,,",
        "fixed,6,not,read,,,,,,,,B,",
        "fixed,7,,,,,,,,,not read,B,",
    )
    m = Measurements.read(path)
    assert m.kinds == ("point", "pose", "distance", "pair", "pair", "fixed", "fixed")
    assert m.pairs == ("", "", "", "p", "p", "", "")
    np.testing.assert_allclose(m.points[:2], [[0.1, 0.2, 0.3]] * 2)
    assert np.isnan(m.points[2:]).all()
    np.testing.assert_array_equal(m.rotations[1], np.eye(3))
    assert np.isnan(m.rotations[[0, *range(2, 7)]]).all()
    np.testing.assert_allclose(m.distances, [np.nan, np.nan, 0.5, 0.6, 0.6, np.nan, np.nan])
    np.testing.assert_allclose(m.sigma_angle[1], np.deg2rad(0.1))
    np.testing.assert_array_equal(
        m.of_kind("fixed", "pose"), [False, True, *[False] * 3, True, True]
    )
    every = Measurements.read(path, kind="fixed", columns={"group": "-"})
    assert every.kinds == ("fixed",) * 7
    assert "kind" in every.ignored


@pytest.mark.parametrize(
    ("lines", "says"),
    [
        (("kind,a [deg]", "ball,1"), ["line 2 (row 1), column 'kind'", "'ball'", '"kind=-"']),
        (("Kind,a [deg]", ",1"), ["'' is not a kind of measurement", '"Kind=-"']),
        (("kind,a [deg]", "fixed,1", "point,2"), "need a column 'x [mm]'"),
        (("kind,a [deg]",), "need a column 'x [mm]'"),
        (
            ("kind,a [deg],x [mm],y [mm],z [mm]", "fixed,1,,,", "point,2,1,,3"),
            "line 3 (row 2), column 'y [mm]': the cell is empty",
        ),
    ],
)
def test_kinds_that_are_refused(table, lines, says):
    refused(table(*lines), says)


# Torques


def test_torques(table):
    header = (
        "a [deg],b [deg],rail [mm],rail.torque [N],a.torque [N m],b.torque,x [mm],y [mm],z [mm]"
    )
    path = table(header, "1,2,3,4,-5,,100,200,300", "1,2,3,6,7,,100,200,300")
    names = ["rail", "a"]
    m = Measurements.read(path, names)
    np.testing.assert_array_equal(m.torques, [[4, -5], [6, 7]])
    assert m.ignored == ("b [deg]", "b.torque")
    text = refused(path, ["column 'b.torque' (revolute joint 'b')", "no unit", "'b.torque [Nm]'"])
    assert "'Nm'." in text
    with_unit = {"b.torque": "b.torque [Nm]"}
    refused(path, "column 'b.torque': the cell is empty", joint_names=["b"], columns=with_unit)
    assert m.select(np.array([False, True])).torques.tolist() == [[6, 7]]


# The value


GOOD = {"joint_names": ("a",), "joints": np.ones((2, 1)), "points": np.ones((2, 3))}
NONE = np.full((2, 3), np.nan)


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
            {"kinds": ("pose",) * 2, "rotations": [np.eye(3)] * 2, "sigma_angle": [0.1, 0.0]},
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


# Writing


@given(st.data())
def test_what_is_written_reads_back(tmp_path_factory, data):
    kinds = data.draw(st.lists(st.sampled_from(names()), min_size=1, max_size=5))
    for kind, count in (("pair", 2), ("fixed", 2), ("plane", 4)):
        if kind in kinds:
            kinds = [k for k in kinds if k != kind] + [kind] * count
    count = len(kinds)
    random = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    torques = np.where([[True, data.draw(st.booleans())]], random.normal(size=(count, 2)), np.nan)
    m = Measurements(
        ("a", "rail"),
        random.uniform(-3, 3, (count, 2)),
        random.uniform(1, 2, (count, 3)),
        kinds=tuple(kinds),
        rotations=Rotation.random(count, rng=random).as_matrix(),
        distances=np.ones(count),
        sigma=data.draw(st.none() | st.just(np.full(count, 1.3e-4))),
        sigma_angle=data.draw(st.none() | st.just(np.full(count, 1.7e-4))),
        pairs=tuple("p" if kind == "pair" else "" for kind in kinds),
        groups=data.draw(st.just(()) | st.just(("A/1",) * count)),
        torques=data.draw(st.none() | st.just(torques)),
        prismatic=("rail",),
    )
    path = tmp_path_factory.mktemp("written") / "data.csv"
    m.write(path)
    again = Measurements.read(path, m.joint_names)
    assert_same(again, m, 4e-15)
    inferred = set(kinds) == {"point"}
    assert ("kind" in path.read_text().splitlines()[0].split(",")) != inferred
