"""Tables of poses in YAML: dumps with nested and joined keys, several robots, numbers that stay as they were."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
import yaml

from calib.errors import FileError
from calib.verbs.convert.kinematics_tables import (
    POSE_KEYS,
    find_table,
    names_in,
    pose_entry,
    pose_of,
    robot_number,
    tables_in,
)

POSE = {"x": 0.1, "y": -0.2, "z": 0.3, "roll": 0.4, "pitch": -0.5, "yaw": 0.6}
TABLE = {"shoulder": POSE, "hash": "calib_1"}

#: As rosparam dump, ros2 param dump, rosparam list, parameters of ROS 2, and a description's file have them.
DUMPS = {
    "plain": {"kinematics": TABLE},
    "rosparam": {"ur_hardware_interface": {"kinematics": TABLE, "joints": [1]}},
    "ros2": {"/**": {"ros__parameters": {"kinematics": TABLE}}},
    "node": {"/left/ur_robot_driver": {"ros__parameters": {"kinematics": TABLE}}},
    "slashes": {
        f"/ur_hardware_interface/kinematics/{key}": value
        for key, value in {
            **{f"shoulder/{k}": v for k, v in POSE.items()},
            "hash": "calib_1",
        }.items()
    },
    "points": {
        "node": {"ros__parameters": {f"kinematics.shoulder.{k}": v for k, v in POSE.items()}}
    },
    "bare": TABLE,
}


@pytest.mark.parametrize("form", DUMPS)
def test_the_same_numbers_in_every_dump(form: str):
    content = yaml.safe_load(yaml.safe_dump(DUMPS[form]))
    table = find_table("d.yaml", content, None)
    assert table is not None
    np.testing.assert_array_equal(table.numbers("d.yaml", "shoulder"), list(POSE.values()))
    assert table.entries.get("hash", "calib_1") == "calib_1"
    assert {"kinematics", "shoulder"} <= set(names_in(content))
    robots = {"plain": "", "bare": "", "ros2": "", "node": "left/ur_robot_driver", "points": "node"}
    assert table.robot == robots.get(form, "ur_hardware_interface")


def test_one_of_several_robots_is_named():
    other = {"shoulder": {**POSE, "x": 0.9}}
    content = {
        "left": {"ur_hardware_interface": {"kinematics": TABLE}},
        "right": {"ur_hardware_interface": {"kinematics": other}},
    }
    for section, x in (("left", 0.1), ("right", 0.9), ("right/ur_hardware_interface", 0.9)):
        table = find_table("d.yaml", content, section)
        assert table is not None
        assert table.numbers("d.yaml", "shoulder")[0] == x
    for section in (None, "middle", "ur_hardware_interface"):
        with pytest.raises(FileError, match="left/ur_hardware_interface") as error:
            find_table("d.yaml", content, section)
        assert "--section" in str(error.value)
    # A file of one arm that names none is that arm's.
    assert find_table("d.yaml", {"kinematics": TABLE}, "left") is not None
    with pytest.raises(FileError, match="no kinematics of 'right'"):
        find_table("d.yaml", {"left": {"kinematics": TABLE}}, "right")
    assert find_table("d.yaml", {"kinematics": {"shoulder": {"x": 1}}}, None) is None
    assert tables_in({"a": 1, "b": ["x"]}) == ()
    endless = yaml.safe_load("a: &a {b: *a, kinematics: {shoulder: {x: 1}}}")
    assert tables_in(endless) == ()


def test_numbers_of_the_robots_own_file_stay_digit_for_digit():
    T = pose_of(np.array(list(POSE.values())))
    R = pin.rpy.rpyToMatrix(0.4, -0.5, 0.6)
    np.testing.assert_allclose(T[:3, :3], R, rtol=0, atol=1e-15)
    assert pose_entry(T) == pytest.approx(POSE, abs=1e-15)
    assert list(pose_entry(T)) == list(POSE_KEYS)
    own = np.array([0.1, -0.2, 0.3, 0.4 - np.pi, np.pi + 0.5, 0.6 - np.pi])  # by other angles
    assert list(pose_entry(T, own).values()) == own.tolist()
    T[0, 3] += 1e-13
    assert pose_entry(T, np.array(list(POSE.values())))["x"] == 0.1
    T[0, 3] += 1e-6
    assert pose_entry(T, np.array(list(POSE.values())))["x"] == pytest.approx(0.100001, abs=1e-12)


def test_numbers():
    assert robot_number("file: key", "-1e-3", 1.0) == -1e-3
    for word in ("nan", "inf", "1_0", "", "1.001"):
        with pytest.raises(FileError, match=r"file: key: '.*' is not a number up to 1"):
            robot_number("file: key", word, 1.0)
    table = find_table("d.yaml", {"kinematics": {"joint1": {**POSE, "yaw": 57}}}, None)
    assert table is not None
    with pytest.raises(FileError, match=r"yaw of 'joint1': '57' is not a number up to 12\.57"):
        table.numbers("d.yaml", "joint1")
