"""The targets of a table's rows: as measured, carried into the base, or predicted."""

from __future__ import annotations

import numpy as np
import pytest

from calib import example
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.errors import MeasurementError
from calib.verbs.workspace.region_rows import read_rows, row_points

TARGET = np.array(example.PAPER_TARGET)
HIGHER = TARGET + np.array([0.0, 0.0, 0.1])
T_FRAME_BASE = np.array([[0.0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]])


@pytest.fixture(scope="module")
def paper(ur3):
    return Measurements.read(example.paper_measurements(), ur3.joint_names, ur3.joint_types)


def test_measured_points_are_taken_as_they_are_or_carried_into_the_base(ur3, paper):
    points, measured = row_points(ur3, paper, Cell(), TARGET)
    np.testing.assert_array_equal(points, paper.points)
    assert measured.all()
    points = paper.points @ T_FRAME_BASE[:3, :3].T + T_FRAME_BASE[:3, 3]
    moved = Measurements(paper.joint_names, paper.joints, points)
    back, measured = row_points(ur3, moved, Cell(T_frame_base=T_FRAME_BASE), TARGET)
    np.testing.assert_allclose(back, paper.points, atol=1e-12)
    assert measured.all()
    groups = ("a",) * 20 + ("b",) * 15
    where = np.where(np.arange(35)[:, None] < 20, points, paper.points)
    two = Measurements(paper.joint_names, paper.joints, where, groups=groups)
    cell = Cell(frames={"a": T_FRAME_BASE, "b": np.eye(4)})
    np.testing.assert_allclose(row_points(ur3, two, cell, TARGET)[0], paper.points, atol=1e-12)


def test_in_an_unknown_frame_each_target_is_predicted_at_its_place(ur3, paper):
    names = ("low", "high") * 17 + ("other",)
    two = Measurements(paper.joint_names, paper.joints, paper.points, targets=names)
    cell = Cell(targets={"low": TARGET, "high": HIGHER}, estimate_frame=True)
    points, measured = row_points(ur3, two, cell, np.zeros(3))
    assert not measured.any()
    poses = ur3.poses(paper.joints)
    np.testing.assert_allclose(points[34], poses[34, :3, 3], atol=1e-12)
    at = poses[1, :3, :3] @ HIGHER + poses[1, :3, 3]
    np.testing.assert_allclose(points[1], at, atol=1e-12)
    # The nominal robot is a few mm off.
    assert 1e-4 < np.linalg.norm(points - paper.points, axis=1)[:34:2].max() < 6e-3


def test_tables_without_positions(ur3, paper, tmp_path):
    path = tmp_path / "poses.csv"
    header = ",".join(f"{name} [deg]" for name in paper.joint_names)
    rows = [",".join(f"{v:.6f}" for v in row) for row in np.degrees(paper.joints)]
    expected = row_points(ur3, paper, Cell(estimate_frame=True), TARGET)[0]
    xyz = ",x [mm],y [mm],z [mm]"
    # A plan that is not filled in has the columns, and nothing in them.
    for more, cells in (("", ""), (xyz, ",,,")):
        path.write_text("\n".join([header + more, *[row + cells for row in rows]]))
        points, measured = row_points(ur3, read_rows(path, ur3), Cell(), TARGET)
        assert not measured.any()
        np.testing.assert_allclose(points, expected, atol=1e-6)
    # With a cell that is no number the table is read as it is, and refused.
    path.write_text("\n".join([header + xyz, *[f"{row},a,b,c" for row in rows]]))
    with pytest.raises(MeasurementError, match="is not a finite number"):
        read_rows(path, ur3)
