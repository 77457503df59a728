"""What is written, by the program's readers and by others."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from calib.basics.arrays import rigid_inverse
from calib.errors import CalibError, FileError, UrdfError
from calib.robot.robot import Robot
from calib.verbs.convert.camera import readback
from calib.verbs.convert.camera.mount import fixed_pose
from calib.verbs.convert.camera.options import CameraOptions
from calib.verbs.convert.camera.write import mounted, transform_of
from calib.verbs.convert.conversion import convert
from calib.verbs.convert.convert import Options
from calib.verbs.convert.source_kinds import result_source
from tests.verbs.convert.camera.arms import T_TOOL_OPTICAL, calibration, image_calibration

SOURCE = result_source(calibration(), Options(), "result")
MOVED = CameraOptions(camera_frame="color_optical", move="camera_mount_joint")
T_OPTICAL = rigid_inverse(calibration().T_frame_base)


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
        mounted(SOURCE, Options(camera=MOVED))


def test_the_pose_that_is_published():
    transform = transform_of(SOURCE, CameraOptions(camera_frame="color_optical"))
    assert (transform.parent, transform.child) == ("tool0", "color_optical")
    np.testing.assert_array_equal(transform.T_parent_child, T_OPTICAL)
    new = transform_of(SOURCE, CameraOptions(new_camera_frame="cam"))
    assert (new.parent, new.child) == ("tool0", "cam")
    board = transform_of(SOURCE, CameraOptions(new_board_frame="plate"))
    assert (board.parent, board.child) == ("base", "plate")
    np.testing.assert_array_equal(board.T_parent_child, calibration().setup.T_tip_target[0])


def test_of_a_moved_mount_its_child_is_published():
    transform = transform_of(SOURCE, MOVED)
    assert (transform.parent, transform.child) == ("tool0", "camera_mount")
    urdf = SOURCE.robot.urdf
    below = [urdf.joint(name) for name in ("camera_body_joint", "color_optical_joint")]
    T = transform.T_parent_child @ below[0].T_parent_joint @ below[1].T_parent_joint
    np.testing.assert_allclose(T, T_OPTICAL, rtol=0, atol=1e-14)


def test_one_file_publishes_one_frame(tmp_path):
    both = CameraOptions(camera_frame="cam", new_board_frame="plate")
    with pytest.raises(CalibError, match="One file publishes one frame"):
        transform_of(SOURCE, both)
    path = tmp_path / "camera.sh"
    options = Options(camera=CameraOptions(camera_frame="cam"))
    conversion = convert(calibration(), path, options=options)
    assert conversion.format == "static-transform"
    assert path.read_text().count("--child-frame-id cam") == 1
    with pytest.raises(FileError, match="exists already"):
        convert(calibration(), path, options=options)


def test_names_of_a_camera_belong_to_its_formats(tmp_path):
    path = tmp_path / "arm.urdf"
    with pytest.raises(CalibError, match=r"'urdf' has nothing.*'camera-mount'"):
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
