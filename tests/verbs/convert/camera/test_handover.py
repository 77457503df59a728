from __future__ import annotations

import numpy as np
import pytest

from calib.errors import CalibError, UrdfError
from calib.robot.robot import Robot
from calib.verbs.convert.camera.handover import Handover, calibration_of, check_names
from calib.verbs.convert.camera.options import NOTHING_NAMED, CameraOptions
from calib.verbs.convert.source import Options
from calib.verbs.convert.source_kinds import result_source, robot_source
from tests.verbs.convert.camera.arms import calibration, urdf_with_camera

SOURCE = result_source(calibration(), Options(), "result")


def handover(**names: str) -> Handover:
    return Handover.of(SOURCE, CameraOptions(**names))


def test_a_camera_that_the_urdf_has():
    result = handover(camera_frame="color_optical", move="camera_mount_joint")
    assert result.board is None
    assert result.camera is not None
    assert (result.camera.link, result.camera.joint.name) == (
        "color_optical",
        "camera_mount_joint",
    )
    # as the URDF has it: 84 mm in front of the flange, seen along its z
    assert result.camera.T_link_before is not None
    np.testing.assert_allclose(
        result.camera.T_link_before[:3, 3], [0.062, 0.001, 0.064], rtol=0, atol=1e-6
    )
    assert result.urdf.links == SOURCE.robot.urdf.links
    assert result.frames == (result.camera,)


def test_a_camera_and_a_board_that_it_lacks():
    result = handover(new_camera_frame="cam", new_board_frame="plate")
    assert result.urdf.links[-2:] == ("cam", "plate")
    camera, board = result.frames
    assert (camera.joint.parent, board.joint.parent) == ("tool0", "base")
    assert camera.T_link_before is board.T_link_before is None
    np.testing.assert_allclose(
        camera.joint.T_parent_joint, camera.estimated.T_link_frame, rtol=0, atol=1e-14
    )


def test_the_urdf_is_the_corrected_one():
    result = handover(new_camera_frame="cam")
    for joint in SOURCE.robot.joints:
        origin = result.urdf.joint(joint.name).T_parent_joint
        np.testing.assert_array_equal(origin, SOURCE.robot.urdf.joint(joint.name).T_parent_joint)
    assert calibration_of(SOURCE) is SOURCE.calibration


@pytest.mark.parametrize(
    ("names", "words"),
    [
        ({}, "--new-camera-frame NAME"),
        ({"camera": "color"}, "--camera-frame LINK with --move JOINT"),
        ({"camera_frame": "a", "new_camera_frame": "b"}, "give one of them"),
        ({"move": "camera_mount_joint"}, "--move camera_mount_joint: name the link"),
        ({"new_camera_frame": "b", "move": "j"}, "--move j: name the link"),
        ({"camera_frame": "a", "board": "board"}, "--new-board-frame NAME"),
    ],
)
def test_names_that_do_not_go_together(names, words):
    with pytest.raises(CalibError, match=words):
        check_names(CameraOptions(**names))
    with pytest.raises(CalibError, match=words):
        handover(**names)


def test_a_link_that_the_urdf_lacks_can_be_added():
    with pytest.raises(UrdfError, match="--new-camera-frame cam adds it to 'tool0'"):
        handover(camera_frame="cam")


def test_a_joint_of_the_arm_is_no_mount():
    """A camera on the base, which is named as if the world's joint mounted it."""
    source = result_source(calibration(), Options(), "result")
    with pytest.raises(UrdfError, match="'wrist_3_joint'"):
        Handover.of(source, CameraOptions(camera_frame="wrist_3_link", move="wrist_3_joint"))


def test_a_robot_has_no_camera():
    source = robot_source(Robot.from_urdf(urdf_with_camera(), "tool0", "base"), Options())
    with pytest.raises(CalibError, match="give the result of calib calibrate --json"):
        Handover.of(source, CameraOptions(new_camera_frame="cam"))
    assert Options().camera is NOTHING_NAMED
