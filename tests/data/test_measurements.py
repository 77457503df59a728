"""Measurements: the tables of the paper and of the documentation, selections, and the way out and back."""

import csv
import hashlib
import pickle
from dataclasses import FrozenInstanceError, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.spatial.transform import Rotation

import calib
from calib.data import kinds
from calib.data.forms.column_options import ColumnOptions
from calib.data.measurements import Measurements
from calib.errors import MeasurementError
from tests.data.tables import assert_same, refused
from tests.places import ROOT

UR3 = Path(calib.__file__).parent / "example" / "ur3_leica.csv"
UR3_JOINTS = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)


# The tables of the paper and of the documentation


def test_the_papers_table():
    m = Measurements.read(UR3, UR3_JOINTS, dict.fromkeys(UR3_JOINTS, "revolute"))
    with UR3.open() as file:
        printed = list(csv.reader(file))[1:]
    numbers = np.array([[float(cell) for cell in line[2:]] for line in printed])
    assert len(m) == 35
    assert m.joint_names == UR3_JOINTS
    np.testing.assert_allclose(m.joints, np.deg2rad(numbers[:, :6]), rtol=1e-15)
    np.testing.assert_allclose(m.points, numbers[:, 6:] / 1000.0, rtol=1e-15)
    assert m.joints[9, 5] == pytest.approx(np.deg2rad(420.75), rel=1e-15)
    assert m.sets == ("estimate",) * 30 + ("validate",) * 5
    assert m.rows == tuple(range(1, 36))
    assert m.sigma == {}
    assert (m.targets, m.groups) == (("target",) * 35, ("",) * 35)
    assert m.source == "ur3_leica.csv"
    assert m.sha256 == hashlib.sha256(UR3.read_bytes()).hexdigest()
    assert m.ignored == ()
    assert_same(Measurements.read(UR3), m, rtol=0)


def examples():
    """The tables and lists that docs/data-format.md shows, in its order."""
    page = ROOT / "docs" / "data-format.md"
    blocks = page.read_text(encoding="utf-8").split("```")[1::2]
    return [block.strip() for block in blocks if not block.startswith(("python", "sh"))]


#: Standard deviations that a table may state.
NOISE = ({}, {"m": 1.3e-4}, {"rad": 1.7e-4}, {"m": 1.3e-4, "rad": 1.7e-4})


def test_the_example_in_the_documentation(table):
    m = Measurements.read(table(examples()[0]), UR3_JOINTS[:3])
    np.testing.assert_array_equal(m.points, Measurements.read(UR3).points[[0, 1, 30]])
    assert m.sets == ("estimate", "estimate", "validate")


def test_the_examples_of_other_kinds(table):
    poses, lengths, sockets = examples()[1:4]
    m = Measurements.read(table(poses))
    assert set(m.kinds) == {"pose"}
    np.testing.assert_allclose(m.sigma["rad"], np.deg2rad([0.1, 0.1]))
    m = Measurements.read(table(lengths))
    assert m.kinds == ("distance", "distance", "pair", "pair")
    np.testing.assert_allclose(m.distances[2:], [0.750002] * 2)
    columns = {"placement": "group", "socket": "group"}
    m = Measurements.read(table(sockets), kind="fixed", columns=columns)
    assert m.groups == ("left/A", "left/A", "left/B", "left/B")


def test_the_example_of_a_list_of_points(table, tmp_path):
    listed, joints = examples()[5:]
    (tmp_path / "tracker.txt").write_text(listed)
    m = Measurements.read(table(joints), UR3_JOINTS[:3], points=tmp_path / "tracker.txt")
    paper = Measurements.read(UR3)
    np.testing.assert_array_equal(m.points, paper.points[[1, 0]])
    np.testing.assert_array_equal(m.joints, paper.joints[[1, 0], :3])


# The value


def test_arrays_are_read_only_copies():
    joints = np.zeros((2, 1))
    m = Measurements(("a",), joints, [[1, 2, 3], [4, 5, 6]], sigma={"m": [0.1, 0.2]})
    joints[0, 0] = 1.0
    assert m.joints[0, 0] == 0.0
    for array in (
        m.joints,
        m.points,
        m.sigma["m"],
        m.estimation,
        m.validation,
        m.joints_for(["a"]),
    ):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1
    with pytest.raises(FrozenInstanceError):
        m.source = "other"


def test_another_process_gets_the_same():
    m = Measurements.read(UR3)
    again = pickle.loads(pickle.dumps(m))
    assert_same(again, m, rtol=0)
    assert (again.source, again.sha256) == (m.source, m.sha256)


def test_select_keeps_row_numbers_and_the_rest():
    m = replace(Measurements.read(UR3), sigma={"m": np.linspace(1e-4, 2e-4, 35)})
    held_back = m.select(m.validation)
    assert len(held_back) == 5
    assert held_back.rows == (31, 32, 33, 34, 35)
    assert held_back.sets == ("validate",) * 5
    np.testing.assert_array_equal(held_back.points, m.points[30:])
    np.testing.assert_array_equal(held_back.joints, m.joints[30:])
    np.testing.assert_array_equal(held_back.sigma["m"], m.sigma["m"][30:])
    assert held_back.sha256 == m.sha256
    assert len(held_back.select(held_back.estimation)) == 0


def test_joints_for_another_order():
    m = Measurements.read(UR3)
    np.testing.assert_array_equal(
        m.joints_for(["wrist_3_joint", "elbow_joint"]), m.joints[:, [5, 2]]
    )
    assert m.joints_for([]).shape == (35, 0)
    with pytest.raises(MeasurementError) as caught:
        m.joints_for(["elbow_joint", "wrist_4_joint"])
    assert "'wrist_4_joint'" in str(caught.value)
    assert "'wrist_3_joint'" in str(caught.value)


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


def test_copies_are_left_out_and_repeats_are_not():
    joints, points = np.array([[1.0], [2.0], [1.0], [1.0], [1.0]]), np.ones((5, 3))
    points[2, 0] += 1e-12  # a repeat has a noise of its own
    groups = ("", "", "", "", "other")
    m = Measurements(("a",), joints, points, groups=groups, rows=(3, 5, 7, 9, 11)).without_copies()
    assert (m.rows, m.copies) == ((3, 5, 7, 11), (9,))
    assert m.without_copies() is m
    held = Measurements(("a",), joints[:2] * 0, points[:2], kinds=("fixed",) * 2)
    assert held.without_copies() is held
    no_point = np.full((2, 3), np.nan)
    read = Measurements(
        ("a",), joints[:1].repeat(2, 0), no_point, kinds=("distance",) * 2, distances=[0.5, 0.5]
    )
    assert read.without_copies().copies == (2,)


@pytest.mark.parametrize("name", ["point", "pose", "distance"])
def test_what_a_kind_measures_as_arguments_and_readings(name):
    kind = kinds.get(name)
    T = np.tile(np.eye(4), (2, 1, 1))
    T[:, :3, 3] = [[1, 2, 2], [0, 3, 4]]
    arguments = Measurements.columns_of(kind, kind.measure(T))
    m = Measurements(("a",), np.zeros((2, 1)), kinds=(name,) * 2, **arguments)
    if kind.position:
        np.testing.assert_array_equal(m.points, T[:, :3, 3])
    if kind.orientation:
        np.testing.assert_array_equal(m.rotations, T[:, :3, :3])
    expected = [3.0, 5.0] if name == "distance" else [np.nan] * 2
    np.testing.assert_array_equal(m.reading("distance"), expected)


# Writing


@given(st.data())
def test_what_is_written_reads_back(tmp_path_factory, data):
    names = data.draw(st.lists(st.sampled_from(kinds.names()), min_size=1, max_size=5))
    fewest = {name: kinds.get(name).fewest for name in kinds.names()}
    for kind, count in {**fewest, "pair": 2}.items():
        if kind in names:
            names = [k for k in names if k != kind] + [kind] * count
    count = len(names)
    random = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    torques = np.where([[True, data.draw(st.booleans())]], random.normal(size=(count, 2)), np.nan)
    m = Measurements(
        ("a", "rail"),
        random.uniform(-3, 3, (count, 2)),
        random.uniform(1, 2, (count, 3)),
        kinds=tuple(names),
        rotations=Rotation.random(count, rng=random).as_matrix(),
        distances=np.ones(count),
        sigma={
            unit: np.full(count, std) for unit, std in data.draw(st.sampled_from(NOISE)).items()
        },
        pairs=tuple("p" if kind == "pair" else "" for kind in names),
        groups=data.draw(st.just(()) | st.just(("A/1",) * count)),
        approaches=data.draw(st.just(()) | st.just(("from above",) * count)),
        torques=data.draw(st.none() | st.just(torques)),
        prismatic=("rail",),
        readings={
            "u": random.uniform(0, 999, count),
            "v": random.uniform(0, 999, count),
            "stop": random.uniform(-3, 3, count),
        },
        board_points=random.uniform(0, 0.2, (count, 3)),
        images=data.draw(st.just(()) | st.just(("left.png",) * count)),
        corners=data.draw(st.just(()) | st.just(tuple(map(str, range(count))))),
    )
    path = tmp_path_factory.mktemp("written") / "data.csv"
    m.write(path)
    again = Measurements.read(path, m.joint_names)
    assert_same(again, m, rtol=4e-15, atol=4e-15)
    inferred = set(names) == {"point"}
    assert ("kind" in path.read_text().splitlines()[0].split(",")) != inferred


# Tables as users bring them, one quirk each

TURN = Rotation.from_euler("ZYX", [20, -30, 40], degrees=True)
XYZ = "1992.4945,-300.5,1250"


def degrees(sequence):
    return ",".join(map(repr, TURN.as_euler(sequence, degrees=True).tolist()))


TABLES = {
    "KUKA's columns": ("A1,A2,X,Y,Z,A,B,C", f"10,-20,{XYZ},{degrees('ZYX')}", {"brand": "kuka"}),
    "FANUC's columns": ("J1,J2,X,Y,Z,W,P,R", f"10,-20,{XYZ},{degrees('xyz')}", {"brand": "fanuc"}),
    "Stäubli's columns": (
        "J1,J2,X,Y,Z,RX,RY,RZ",
        f"10,-20,{XYZ},{degrees('XYZ')}",
        {"brand": "staubli"},
    ),
    "Yaskawa's columns": (
        "S,L,X,Y,Z,Rx,Ry,Rz",
        f"10,-20,{XYZ},{degrees('xyz')}",
        {"brand": "yaskawa"},
    ),
    "ABB's columns": (
        "rax_1;rax_2;x;y;z;q1;q2;q3;q4",
        "10;-20;1992,4945;-300,5;1250;"
        + ";".join(
            repr(number).replace(".", ",") for number in TURN.as_quat()[[3, 0, 1, 2]].tolist()
        ),
        {"brand": "abb"},
    ),
    "joints without a unit": (
        "j1,j2,x [mm],y [mm],z [mm],yaw [deg],pitch [deg],roll [deg]",
        f"10,-20,{XYZ},{degrees('ZYX')}",
        {"joint_unit": "deg"},
    ),
    "a matrix": (
        "j1 [deg],j2 [deg],x [mm],y [mm],z [mm],r11,r12,r13,r21,r22,r23,r31,r32,r33",
        f"10,-20,{XYZ}," + ",".join(map(repr, TURN.as_matrix().ravel().tolist())),
        {},
    ),
}


@pytest.mark.parametrize("quirk", TABLES)
def test_tables_that_are_read(table, quirk):
    header, row, options = TABLES[quirk]
    m = Measurements.read(table(header, row), ["j1", "j2"], columns=ColumnOptions(**options))
    np.testing.assert_allclose(np.degrees(m.joints), [[10, -20]], rtol=1e-14)
    np.testing.assert_allclose(m.points, [[1.9924945, -0.3005, 1.25]], rtol=1e-14)
    np.testing.assert_allclose(m.rotations, [TURN.as_matrix()], atol=1e-14)


@pytest.mark.parametrize(
    ("header", "row", "says"),
    [
        ("A1,A2,A3,A4,A5,A6,X,Y,Z", f"1,2,3,4,5,6,{XYZ}", "--columns kuka"),
        ("J1 [deg],J2 [deg],J3 [deg],J4 [deg],x [mm]", "1,2,3,4,5", "--columns fanuc"),
        ("j1,j2,x [mm],y [mm],z [mm]", f"1,2,{XYZ}", "--joint-unit deg"),
        (
            "j1 [deg],j2 [deg],x [mm],y [mm],z [mm],Rx [deg],Ry [deg],Rz [deg]",
            f"1,2,{XYZ},170,80,-100",
            "--orientation staubli",
        ),
        ("sep=;\nj1 [deg];j2 [deg];x;y;z", "1;2;3;4;5", '--columns "x=x [mm]"'),
    ],
)
def test_tables_that_are_refused(table, header, row, says):
    refused(table(header, row), ["data.csv", says], joint_names=["j1", "j2"])
