"""Tables with poses of the flange in place of joint values."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.basics.tables import Table
from calib.data.forms.column_options import ColumnOptions
from calib.data.forms.flange_poses import has_flange_poses
from calib.data.forms.orientations import CONVENTIONS
from calib.data.measurements import Measurements
from calib.errors import MeasurementError
from calib.robot.flange import NAME
from calib.robot.robot import Robot

P = np.array([[0.4, -0.2, 0.7], [0.5, 0.1, 0.6]])
R = Rotation.from_rotvec([[0.3, 2.0, -0.4], [1.0, -0.2, 0.3]]).as_matrix()
CORNER = {"u [px]": "1", "v [px]": "2", "board_x [m]": "0", "board_y [m]": "0", "board_z [m]": "0"}


def written(tmp_path: Path, poses: dict[str, list], others: dict[str, str]) -> Path:
    """A table of two poses, four times: columns of the pose, and others that are the same in all rows."""
    path = tmp_path / "table.csv"
    rows = [
        [str(values[n]) for values in poses.values()] + [*others.values()] for n in range(2)
    ] * 4
    path.write_text("\n".join(",".join(row) for row in [[*poses, *others], *rows]))
    return path


def pose_columns(name: str, prefix: str = "flange_") -> dict[str, list]:
    convention = CONVENTIONS[name]
    numbers = convention.numbers(R)
    unit = " [deg]" if convention.unit else ""
    numbers = np.degrees(numbers) if convention.unit else numbers
    columns = {f"{prefix}{axis} [mm]": list(1e3 * P[:, k]) for k, axis in enumerate("xyz")}
    of_orientation = zip(convention.columns, numbers.T, strict=True)
    return columns | {f"{prefix}{column}{unit}": list(values) for column, values in of_orientation}


def poses_of(path: Path, columns=None) -> np.ndarray:
    robot = Robot.load(NAME)
    measured = Measurements.read(path, robot.joint_names, robot.joint_types, columns)
    return robot.poses(measured.joints)[:2]


@pytest.mark.parametrize("name", CONVENTIONS)
def test_poses_of_each_convention_are_read(tmp_path: Path, name: str):
    path = written(tmp_path, pose_columns(name), CORNER)
    T = poses_of(path, ColumnOptions(orientation=name))
    np.testing.assert_allclose(T[:, :3, 3], P, atol=1e-15)
    np.testing.assert_allclose(T[:, :3, :3], R, atol=1e-14)


def test_in_a_table_of_corners_the_names_may_stand_alone(tmp_path: Path):
    path = written(tmp_path, pose_columns("kuka", ""), CORNER)
    np.testing.assert_allclose(
        poses_of(path, ColumnOptions(brand="kuka"))[:, :3, :3], R, atol=1e-14
    )
    assert has_flange_poses(Table.read(path))
    alone = written(tmp_path, pose_columns("kuka", ""), {"image": "a.png"})
    assert not has_flange_poses(Table.read(alone))


def test_measured_positions_stand_beside_the_flanges(tmp_path: Path):
    path = written(
        tmp_path, pose_columns("quaternion"), {"x [mm]": "100", "y [mm]": "200", "z [mm]": "300"}
    )
    robot = Robot.load(NAME)
    measured = Measurements.read(path, robot.joint_names, robot.joint_types)
    assert measured.kinds == ("point",) * 8
    np.testing.assert_allclose(measured.points[0], [0.1, 0.2, 0.3])


def test_columns_may_be_mapped(tmp_path: Path):
    path = written(tmp_path, pose_columns("rpy", "robot "), CORNER)
    names = {f"robot {axis}": f"flange_{axis}" for axis in (*"xyz", "roll", "pitch", "yaw")}
    np.testing.assert_allclose(poses_of(path, names)[:, :3, :3], R, atol=1e-14)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"flange_x [mm]": None}, r"no pose of the flange.*'flange_x \[mm\]'"),
        ({"flange_qw": None}, "needs one orientation, and the table has none"),
        (
            {"flange_qw": ["0.5", "0.5"]},
            r"row 1\), column 'flange_qx': the quaternion has the length",
        ),
        (
            {"flange_y [mm]": ["5e5", "5e5"]},
            r"row 1\), column 'flange_y \[mm\]': 500000 was read as",
        ),
        ({"flange_y [mm]": ["1", "wide"]}, r"row 2\), column 'flange_y \[mm\]': 'wide'"),
        ({"flange_y [mm]": None, "flange_y": ["1", "2"]}, "'flange_y'.*has no unit"),
    ],
)
def test_what_is_no_pose_is_refused(tmp_path: Path, change: dict, match: str):
    columns = {**pose_columns("quaternion"), **change}
    given = {name: values for name, values in columns.items() if values is not None}
    with pytest.raises(MeasurementError, match=match):
        poses_of(written(tmp_path, given, CORNER))
