"""Sweeps out of tables and lists of points, and what is refused there."""

from pathlib import Path

import numpy as np
import pytest

from calib.errors import MeasurementError
from calib.verbs.base_frame.sweeps import Sweeps, read_sweeps

PLAIN = """sweep,x [mm],y [mm],z [mm]
plane,1,200,3
plane,4,500,6
joint 2,7,800,9
joint 1,10,1100,12
joint 1,13,1400,15
"""

WITH_JOINTS = """row;sweep;x [m];y [m];z [m];sigma [um];q_a [deg];q_b [deg]
11;plane;1,5;2;3;10;;
12;q_a;4;5;6;10;-90;0
13;q_b;7;8;9;20;0;180
"""


def written(folder: Path, text: str, name: str = "s.csv") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def read(folder: Path, text: str, **options: object) -> Sweeps:
    return read_sweeps(written(folder, text), **options)  # type: ignore[arg-type]


def test_a_plain_table(tmp_path: Path):
    sweeps = read(tmp_path, PLAIN)
    assert [s.joint for s in sweeps.sweeps] == [None, 0, 1]
    first = sweeps.sweeps[1]
    assert first.points == pytest.approx(np.array([[0.01, 1.1, 0.012], [0.013, 1.4, 0.015]]))
    assert (first.rows, first.sigma, first.joints) == ((4, 5), None, None)
    assert first.where == "s.csv, sweep 'joint 1' (rows 4 to 5)"
    assert (sweeps.joint_names, sweeps.label(1)) == ((), "joint 2")


def test_joint_values_sigma_and_decimal_commas(tmp_path: Path):
    sweeps = read(tmp_path, WITH_JOINTS)
    assert sweeps.joint_names == ("q_a", "q_b")
    plane, a, b = sweeps.sweeps
    assert plane.joints is None
    assert plane.points[0, 0] == 1.5
    assert a.joints == pytest.approx(np.array([[-np.pi / 2, 0.0]]))
    assert b.joints == pytest.approx(np.array([[0.0, np.pi]]))
    assert b.sigma == pytest.approx([2e-5])
    assert b.where == "s.csv, sweep 'q_b' (rows 13 to 13)"


LIST = """// Units: mm
A::Main::plane_1  1 2 3
A::Main::plane_2  2 2 3
A::Main::joint1_03 40.5 5 6
A::Main::joint1_04 41 5 6
A::joint2::p7 70 8 9
"""


def test_a_tracker_s_list(tmp_path: Path):
    sweeps = read_sweeps(points=written(tmp_path, LIST, "t.txt"))
    assert [(s.name, len(s.points)) for s in sweeps.sweeps] == [
        ("plane", 2),
        ("joint1", 2),
        ("joint2", 1),
    ]
    assert sweeps.sweeps[1].points[0] == pytest.approx([0.0405, 0.005, 0.006])
    assert sweeps.sweeps[1].where == "t.txt, sweep 'joint1' (lines 4 to 5)"


def test_a_list_beside_a_table(tmp_path: Path):
    points = written(tmp_path, "# Units: mm\nP2 1 20 3\nP1 4 50 6\n", "t.txt")
    table = "sweep,point,q [deg]\nplane,P1,\nq,P2,5\n"
    sweeps = read(tmp_path, table, points=points)
    assert sweeps.sweeps[0].points[0] == pytest.approx([0.004, 0.05, 0.006])
    assert sweeps.sweeps[1].joints == pytest.approx(np.radians([[5.0]]))
    in_order = read(tmp_path, "sweep\nplane\n1\n", points=points)
    assert in_order.sweeps[0].points[0] == pytest.approx([0.001, 0.02, 0.003])
    with pytest.raises(MeasurementError, match=r"row 2: .* no point 'P3'"):
        read(tmp_path, table.replace("P2", "P3"), points=points)


NAMES = ("shoulder_pan_joint", "shoulder_lift_joint")


@pytest.mark.parametrize(
    ("word", "joint"),
    [
        (" Plane ", None),
        ("shoulder_lift_joint", 1),
        ("Joint2", 1),
        ("joint_02", 1),
        ("axis 1", 0),
        ("J2", 1),
        ("2", 1),
    ],
)
def test_what_sweeps_may_be_called(tmp_path: Path, word: str, joint: int | None):
    text = f"sweep,x [mm],y [mm],z [mm]\n{word},1,200,3\n"
    (sweep,) = read(tmp_path, text, joint_names=NAMES).sweeps
    assert sweep.joint == joint
