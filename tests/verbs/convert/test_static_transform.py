"""The pose as static_transform_publisher takes it: parsed by other code, it is the pose."""

from __future__ import annotations

import argparse
import ast
import shlex
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.basics.arrays import rigid_inverse
from calib.errors import CalibError, FileError
from calib.verbs.convert.convert import convert
from calib.verbs.convert.format import CameraOptions, Options
from calib.verbs.convert.static_transform import StaticTransform, file_of, transform_of
from calib.verbs.convert.urdf_formats import result_source
from tests.two_handed import fitted
from tests.verbs.convert.camera_arms import T_TOOL_OPTICAL, calibration, pose, words

#: Half a turn, no turn, turns beyond half a turn, tiny numbers.
POSES = [
    T_TOOL_OPTICAL,
    np.eye(4),
    pose(0.1, 0.0, -0.0, np.pi, 0.0, 0.0),
    pose(-1.5, 2.0, 3.0, 2.2, -2.2, 0.1),
    pose(1e-17, -3e-12, 1e-5, 1e-9, -2e-12, 0.0),
]


def publisher(words: list[str]) -> argparse.Namespace:
    """The arguments as ROS 2's program takes them: all named, none positional."""
    parser = argparse.ArgumentParser(allow_abbrev=False)
    for name in ("x", "y", "z", "qx", "qy", "qz", "qw"):
        parser.add_argument(f"--{name}", type=float, required=True)
    parser.add_argument("--frame-id", required=True)
    parser.add_argument("--child-frame-id", required=True)
    # A number such as -3e-12 is a value there, whatever it begins with.
    pairs = zip(words[::2], words[1::2], strict=True)
    return parser.parse_args([f"{name}={value}" for name, value in pairs])


def words_of_launch_file(data: bytes) -> list[str]:
    """The list ``arguments`` of the only Node, by Python's parser."""
    calls = [node for node in ast.walk(ast.parse(data.decode())) if isinstance(node, ast.Call)]
    node = next(call for call in calls if ast.unparse(call.func) == "Node")
    values = {keyword.arg: ast.literal_eval(keyword.value) for keyword in node.keywords}
    assert (values["package"], values["executable"]) == ("tf2_ros", "static_transform_publisher")
    return values["arguments"]


@pytest.mark.parametrize("T", POSES)
@pytest.mark.parametrize("ending", [".sh", ".launch.py"])
def test_the_arguments_are_the_pose(T, ending):
    transform = StaticTransform("tool0", "color optical's", T)
    data = file_of(transform, "Pose of\nsomething", Path(f"camera{ending}"))
    if ending == ".sh":
        first, comment, line, end = data.decode().split("\n")
        assert (first, comment, end) == ("#!/bin/sh", "# Pose of something", "")
        command, words = shlex.split(line)[:4], shlex.split(line)[4:]
        assert command == ["ros2", "run", "tf2_ros", "static_transform_publisher"]
    else:
        words = words_of_launch_file(data)
    parsed = publisher(words)
    assert (parsed.frame_id, parsed.child_frame_id) == ("tool0", "color optical's")
    R = Rotation.from_quat([parsed.qx, parsed.qy, parsed.qz, parsed.qw])
    np.testing.assert_allclose(R.as_matrix(), T[:3, :3], rtol=0, atol=1e-15)
    np.testing.assert_array_equal([parsed.x, parsed.y, parsed.z], T[:3, 3])
    assert parsed.qw >= 0.0
    assert "-0.0'" not in data.decode()


def test_a_pose_that_does_not_read_back_is_refused():
    """A matrix that is no rotation."""
    T = T_TOOL_OPTICAL.copy()
    T[0, 0] += 1e-8
    with pytest.raises(FileError, match="'cam' does not read back"):
        file_of(StaticTransform("tool0", "cam", T), "", Path("a.sh"))


# Of a calibration


@cache
def source():
    return result_source(calibration(), Options(), "result")


MOVED = CameraOptions(camera_frame="color_optical", move="camera_mount_joint")


def test_the_pose_that_is_published():
    transform = transform_of(source(), CameraOptions(camera_frame="color_optical"))
    assert (transform.parent, transform.child) == ("tool0", "color_optical")
    np.testing.assert_array_equal(
        transform.T_parent_child, rigid_inverse(calibration().T_frame_base)
    )
    new = transform_of(source(), CameraOptions(new_camera_frame="cam"))
    assert (new.parent, new.child) == ("tool0", "cam")
    board = transform_of(source(), CameraOptions(new_board_frame="plate"))
    assert (board.parent, board.child) == ("base", "plate")
    np.testing.assert_array_equal(board.T_parent_child, calibration().setup.T_tip_target[0])


def test_of_a_moved_mount_its_child_is_published():
    transform = transform_of(source(), MOVED)
    assert (transform.parent, transform.child) == ("tool0", "camera_mount")
    urdf = source().robot.urdf
    below = [urdf.joint(name) for name in ("camera_body_joint", "color_optical_joint")]
    T = transform.T_parent_child @ below[0].T_parent_joint @ below[1].T_parent_joint
    np.testing.assert_allclose(T, rigid_inverse(calibration().T_frame_base), rtol=0, atol=1e-14)


def test_one_file_publishes_one_frame(tmp_path):
    both = CameraOptions(camera_frame="cam", new_board_frame="plate")
    with pytest.raises(CalibError, match="One file publishes one frame"):
        transform_of(source(), both)
    path = tmp_path / "camera.sh"
    options = Options(camera=CameraOptions(camera_frame="cam"))
    conversion = convert(calibration(), path, options=options)
    assert conversion.format == "static-transform"
    assert path.read_text().count("--child-frame-id cam") == 1
    with pytest.raises(FileError, match="exists already"):
        convert(calibration(), path, options=options)


def test_a_published_pose():
    text = words(
        "static-transform", "my camera.launch.py", calibration(), camera_frame="color_optical"
    )
    assert text[1] == "ros2 launch 'my camera.launch.py'"
    assert words("static-transform", "c.sh", calibration(), camera_frame="cam")[1] == "sh c.sh"
    place = calibration().T_frame_base[:3, :3].T @ -calibration().T_frame_base[:3, 3]
    shown = text[0].split("x y z = ")[1].split(" mm")[0].split()
    np.testing.assert_allclose([float(n) for n in shown], 1e3 * place, rtol=0, atol=6e-4)


def test_the_pose_of_one_station_in_another_is_published(tmp_path):
    c = fitted()
    path = tmp_path / "pair.launch.py"
    options = Options(camera=CameraOptions(parent="t1", child="right"))
    conversion = convert(c, path, to="static-transform", options=options)
    published = transform_of(conversion.source, options.camera)
    assert (published.parent, published.child) == ("t1", "right/panda_link0")
    np.testing.assert_array_equal(published.T_parent_child, c.transform("t1", "right").pose)
    for wrong in (CameraOptions(parent="t1"), CameraOptions(parent="t1", child="t2", camera="t1")):
        with pytest.raises(CalibError, match="--parent"):
            transform_of(conversion.source, wrong)
    with pytest.raises(CalibError, match="--to static-transform"):
        convert(c, tmp_path / "r.urdf", to="camera-mount", options=options)
