"""A table with poses of the flange, and the same table with joint values."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from calib.basics.tables import Table
from calib.data.forms.column_options import ColumnOptions
from calib.data.measurements import Measurements
from calib.robot.flange import NAME
from calib.robot.robot import Robot
from calib.verbs.joints.pose_table import PoseTable

HEAD = (
    "image,flange_x [mm],flange_y [mm],flange_z [mm],flange_rx [rad],flange_ry [rad],flange_rz [rad],"
    "x [mm],y [mm],z [mm]"
)
POSES = f"""{HEAD}
a.png,400,-200,700,0.1,3.0,0.2,100,200,300
b.png,410,-200,700,0.1,3.0,0.2,101,200,300
c.png,400,-200,700,0.1,3.0,0.2,102,200,300
d.png,,,,,,,,,
"""


def read(tmp_path: Path, text: str = POSES) -> PoseTable:
    path = tmp_path / "poses.csv"
    path.write_text(text)
    return PoseTable.read(Table.read(path), ColumnOptions())


def test_each_pose_counts_once(tmp_path: Path):
    table = read(tmp_path)
    np.testing.assert_array_equal(table.pose, [0, 1, 0, -1])
    np.testing.assert_allclose(table.T_base_flange[:, :3, 3], [[0.4, -0.2, 0.7], [0.41, -0.2, 0.7]])
    assert table.measures
    measured, pose = table.measurements(None)
    np.testing.assert_array_equal(pose, [0, 1, 0])
    np.testing.assert_allclose(measured.points[:, 0], [0.1, 0.101, 0.102])


def test_without_measurements_there_are_poses_alone(tmp_path: Path):
    text = "\n".join(line.rsplit(",", 3)[0] for line in POSES.splitlines())
    assert not read(tmp_path, text).measures


def test_joint_values_are_written_to_the_last_digit(tmp_path: Path):
    table = read(tmp_path)
    q = np.array([[0.1, np.pi / 3.0], [-2.0, 1e-9]])
    path = tmp_path / "with.csv"
    path.write_bytes(table.with_joints(["j1", "slide"], q, ["slide"]))
    measured = Measurements.read(path, ["j1", "slide"], {"slide": "prismatic"})
    np.testing.assert_array_equal(measured.joints, q[[0, 1, 0]])
    # The poses are there as well, for the robot that stands for them.
    robot = Robot.load(NAME)
    poses = Measurements.read(path, robot.joint_names, robot.joint_types)
    np.testing.assert_allclose(
        robot.poses(poses.joints), table.T_base_flange[[0, 1, 0]], atol=1e-15
    )
