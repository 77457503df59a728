"""The pose as static_transform_publisher takes it: parsed by other code, it is the pose."""

from __future__ import annotations

import argparse
import ast
import shlex
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.errors import FileError
from calib.verbs.convert.camera.static_transform import StaticTransform, file_of
from tests.verbs.convert.camera.arms import T_TOOL_OPTICAL, pose

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
