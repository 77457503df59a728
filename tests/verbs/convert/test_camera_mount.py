"""The URDF with a camera and a board: where it has them by other readers, and what is printed of it."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from calib.errors import CalibError, UrdfError
from calib.robot import readback
from calib.robot.robot import Robot
from calib.verbs.convert.camera_frames import check_names
from calib.verbs.convert.camera_mount import Handover, mounted
from calib.verbs.convert.convert import convert
from calib.verbs.convert.fixed_frames import fixed_pose
from calib.verbs.convert.format import CameraOptions, Conversion, Options
from calib.verbs.convert.text import text as text_of
from calib.verbs.convert.urdf_formats import result_source, robot_source
from tests.verbs.convert.camera_arms import (
    T_TOOL_OPTICAL,
    calibration,
    image_calibration,
    urdf_with_camera,
    words,
)


@cache
def source():
    return result_source(calibration(), Options(), "result")


def handover(**names: str) -> Handover:
    return Handover.of(source(), CameraOptions(**names))


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
    assert result.urdf.links == source().robot.urdf.links
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
    for joint in source().robot.joints:
        origin = result.urdf.joint(joint.name).T_parent_joint
        np.testing.assert_array_equal(origin, source().robot.urdf.joint(joint.name).T_parent_joint)
    assert source().require_calibration() is source().calibration


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
    with pytest.raises(CalibError, match="Give the result of calib calibrate"):
        Handover.of(source, CameraOptions(new_camera_frame="cam"))
    assert Options().camera == CameraOptions()


# Written

MOVED = CameraOptions(camera_frame="color_optical", move="camera_mount_joint")


def test_the_urdf_predicts_what_the_calibration_predicts(tmp_path):
    """Board in the optical frame, by Pinocchio on the file alone."""
    result = calibration()
    options = Options(camera=CameraOptions(**{**names(MOVED), "new_board_frame": "plate"}))
    convert(result, tmp_path / "arm.urdf", to="camera-mount", options=options)
    model = pin.buildModelFromUrdf(str(tmp_path / "arm.urdf"))
    data = model.createData()
    frames = [model.getFrameId(name, pin.FrameType.BODY) for name in ("color_optical", "plate")]
    q = np.random.default_rng(1).uniform(-2, 2, (10, 6))
    for row, wanted in zip(q, result.predict_poses(q), strict=True):
        values = pin.neutral(model)
        for name, value in zip(result.robot.joint_names, row, strict=True):
            joint = model.joints[model.getJointId(name)]
            values[joint.idx_q : joint.idx_q + joint.nq] = (
                value if joint.nq == 1 else (np.cos(value), np.sin(value))
            )
        pin.framesForwardKinematics(model, data, values)
        T_optical_board = data.oMf[frames[0]].inverse() * data.oMf[frames[1]]
        np.testing.assert_allclose(T_optical_board.homogeneous, wanted, rtol=0, atol=1e-9)


def names(options: CameraOptions) -> dict[str, str]:
    return {"camera_frame": options.camera_frame or "", "move": options.move or ""}


def test_the_corrected_urdf_s_other_bytes_stay(tmp_path):
    convert(calibration(), tmp_path / "arm.urdf", to="camera-mount", options=Options(camera=MOVED))
    before = calibration().robot.urdf.data.splitlines()
    after = (tmp_path / "arm.urdf").read_bytes().splitlines()
    pairs = zip(before, after, strict=True)
    different = [(old, new) for old, new in pairs if old != new]
    assert len(different) == 1
    assert different[0][0].strip() == b"<origin  rpy='0 -1.5707963 0' xyz='0.05 0 0.03' />"


def test_a_hand_over_on_the_urdf_of_an_earlier_one(tmp_path):
    """--robot with the URDF that has the mount already: the same bytes again."""
    first, second = tmp_path / "first.urdf", tmp_path / "second.urdf"
    convert(calibration(), first, to="camera-mount", options=Options(camera=MOVED))
    options = Options(camera=MOVED, robot=str(first))
    convert(calibration(), second, to="camera-mount", options=options)
    T = Robot.load(second, "tool0", "base").urdf.joint("camera_mount_joint").T_parent_joint
    wanted = Robot.load(first, "tool0", "base").urdf.joint("camera_mount_joint").T_parent_joint
    np.testing.assert_allclose(T, wanted, rtol=0, atol=1e-14)


def test_a_frame_that_is_read_elsewhere_is_refused(monkeypatch):
    monkeypatch.setattr(readback, "TOLERANCE", -1.0)
    with pytest.raises(UrdfError, match="read back by Pinocchio"):
        mounted(source(), Options(camera=MOVED))


def test_names_of_a_camera_belong_to_its_formats(tmp_path):
    path = tmp_path / "arm.urdf"
    with pytest.raises(CalibError, match=r"'urdf' has neither.*'camera-mount'"):
        convert(calibration(), path, options=Options(camera=MOVED))
    assert not path.exists()


def test_a_calibration_by_images_that_was_read_from_its_file(tmp_path):
    result = image_calibration()
    result.write_json(tmp_path / "result.json")
    path = tmp_path / "arm.urdf"
    convert(tmp_path / "result.json", path, to="camera-mount", options=Options(camera=MOVED))
    read = Robot.load(path, "tool0", "base").urdf
    T_optical = fixed_pose(read, "tool0", "color_optical")
    np.testing.assert_allclose(T_optical @ result.T_frame_base, np.eye(4), rtol=0, atol=1e-9)
    # to a tenth of a millimetre along; about z as well as the priors know the last joint's zero
    np.testing.assert_allclose(T_optical[:3, 3], T_TOOL_OPTICAL[:3, 3], rtol=0, atol=2e-4)
    np.testing.assert_allclose(T_optical[:3, 2], T_TOOL_OPTICAL[:3, 2], rtol=0, atol=5e-4)


# In words


def test_a_moved_mount():
    text = words(
        "camera-mount",
        "a.urdf",
        calibration(),
        camera_frame="color_optical",
        move="camera_mount_joint",
    )
    assert text[0].startswith("'color_optical' is at x y z = ")
    # from (62, 1, 64) to (70, -5, 50) mm
    length = float(text[0].split(" deg in 'tool0', ")[1].split()[0])
    assert length == pytest.approx(17.2, abs=0.2)
    assert "the origin of 'camera_mount_joint' was changed" in text[0]
    assert text[1] == "Fixed to it, and moved along: 'depth_optical'."
    assert "'camera_mount', which has one parent" in text[2]
    assert len(text) == 3


def test_a_frame_that_is_not_optical():
    """The camera's body is named: it would be turned by 120 deg."""
    text = words(
        "camera-mount",
        "a.urdf",
        calibration(),
        camera_frame="camera_body",
        move="camera_mount_joint",
    )
    assert "Is 'camera_body' the optical frame" in text[1]
    angle = float(text[0].split(" mm and ")[1].split()[0])
    assert 115.0 < angle < 125.0


def test_new_links():
    text = words(
        "camera-mount", "a.urdf", calibration(), new_camera_frame="cam", new_board_frame="plate"
    )
    assert "in 'tool0': a new link, fixed by the joint 'cam_joint'" in text[0]
    assert "in 'base': a new link, fixed by the joint 'plate_joint'" in text[1]
    assert "frame_id 'cam'" in text[2]
    assert len(words("camera-mount", "a.urdf", calibration(), new_board_frame="plate")) == 1


def test_the_tip_is_not_spoken_of_where_the_camera_alone_is_written():
    images = result_source(image_calibration(), Options(), "result")
    written = Conversion(images, "camera-info", Path("c.yaml"), ())
    assert "'base' lies" not in " ".join(text_of(written, "result.json").split())
    mount = Options(camera=CameraOptions(new_camera_frame="cam"))
    moved = Conversion(images, "camera-mount", Path("a.urdf"), (), options=mount)
    assert "'base' lies" in " ".join(text_of(moved, "result.json").split())
