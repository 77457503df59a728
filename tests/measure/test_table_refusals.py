"""What readers of tables and lists of points refuse, in full: what was given, where, what is allowed, the fix."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from calib.base_frame.sweeps import read_sweeps
from calib.errors import CalibError, MeasurementError
from calib.units import parse_joint_value

POSE = "a [deg],x [mm],y [mm],z [mm],qx,qy,qz,qw"


def refused(kind: type[CalibError], text: str):
    """The whole message, as it is printed."""
    return pytest.raises(kind, match=f"^{re.escape(text)}$")


def written(folder: Path, *lines: str, name: str = "t.csv") -> Path:
    path = folder / name
    path.write_text("\n".join([*lines, ""]))
    return path


def test_points_without_names_beside_a_table_with_names(tmp_path):
    table = written(tmp_path, "point,sweep", "P1,plane")
    points = written(tmp_path, "# Units: mm", "100 200 300", name="p.txt")
    with refused(
        MeasurementError,
        "p.txt: the points have no names, and t.csv has a column 'point' to match them by. Add names "
        'to the points, or leave the column out: --columns "point=-".',
    ):
        read_sweeps(table, points=points)
    with refused(
        MeasurementError,
        "p.txt: the points have no names, which would say what sweep they are of. Name them "
        "'plane_1', 'joint1_01' and so on, or give a table with a column 'sweep'.",
    ):
        read_sweeps(points=points)


def test_points_in_a_unit_that_is_no_length(tmp_path):
    points = written(tmp_path, "plane_1 1 2 3", name="p.txt")
    with refused(
        MeasurementError,
        "p.txt: 'deg' is not a unit of length; allowed are 'm', 'mm', 'um', 'cm', 'in'",
    ):
        read_sweeps(points=points, points_unit="deg")


def test_a_point_whose_name_is_no_sweep(tmp_path):
    points = written(
        tmp_path, "# Units: mm", "plane_1 100 200 300", "ring_1 100 200 300", name="p.txt"
    )
    with refused(
        MeasurementError,
        "p.txt, line 3: the point 'ring_1': 'ring' is not a sweep; allowed are 'plane', a joint's "
        "number, 'joint 1'. Correct it, or map it: --sweep \"ring=joint 1\".",
    ):
        read_sweeps(points=points)


def test_a_joint_value_without_a_number():
    with refused(
        CalibError,
        "[held] 'elbow': 'half a turn' is no number with a unit, such as \"0.5 mm\". Write \"30 deg\" or "
        '"0.3 m".',
    ):
        parse_joint_value("half a turn", "[held] 'elbow'")
