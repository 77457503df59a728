"""What `calib convert` prints of a camera: poses, distances from the URDF's, and what starts ROS."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calib.verbs.convert.camera.options import CameraOptions
from calib.verbs.convert.camera.text import handover_text
from calib.verbs.convert.convert import Conversion, Options, Source
from calib.verbs.convert.source_kinds import result_source
from calib.verbs.convert.text import text as text_of
from tests.verbs.convert.camera.arms import calibration, image_calibration

IMAGES = result_source(image_calibration(), Options(), "result")
SOURCE = result_source(calibration(), Options(), "result")


def words(to: str, path: str, source: Source = SOURCE, **names: str) -> list[str]:
    options = Options(camera=CameraOptions(**names))
    conversion = Conversion(source, to, Path(path), (), options=options)
    return [" ".join(paragraph.split()) for paragraph in handover_text(conversion)]


def test_a_moved_mount():
    text = words("camera-mount", "a.urdf", camera_frame="color_optical", move="camera_mount_joint")
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
    text = words("camera-mount", "a.urdf", camera_frame="camera_body", move="camera_mount_joint")
    assert "Is 'camera_body' the optical frame" in text[1]
    angle = float(text[0].split(" mm and ")[1].split()[0])
    assert 115.0 < angle < 125.0


def test_new_links():
    text = words("camera-mount", "a.urdf", new_camera_frame="cam", new_board_frame="plate")
    assert "in 'tool0': a new link, fixed by the joint 'cam_joint'" in text[0]
    assert "in 'base': a new link, fixed by the joint 'plate_joint'" in text[1]
    assert "frame_id 'cam'" in text[2]
    assert len(words("camera-mount", "a.urdf", new_board_frame="plate")) == 1


def test_a_published_pose():
    text = words("static-transform", "my camera.launch.py", camera_frame="color_optical")
    assert text[1] == "ros2 launch 'my camera.launch.py'"
    assert words("static-transform", "c.sh", camera_frame="cam")[1] == "sh c.sh"
    place = calibration().T_frame_base[:3, :3].T @ -calibration().T_frame_base[:3, 3]
    shown = text[0].split("x y z = ")[1].split(" mm")[0].split()
    np.testing.assert_allclose([float(n) for n in shown], 1e3 * place, rtol=0, atol=6e-4)
    assert words("urdf", "a.urdf") == []


def test_intrinsics_with_their_standard_deviations():
    camera = image_calibration().optics.cameras["color"]
    assert camera.values is not None
    assert camera.sigma is not None
    text = words("camera-info", "camera.yaml", IMAGES)
    assert "1280 x 720 px, pinhole" in text[0]
    assert f"fx {camera.values[0]:.2f} ± {camera.sigma[0]:.2f}, fy" in text[0]
    assert f"k1 {camera.values[4]:.5f} ± {camera.sigma[4]:.5f}, k2" in text[0]
    assert text[1].endswith(f"file://{Path('camera.yaml').resolve()}.")
    assert "cv2.FileStorage" in words("opencv", "camera.yaml", IMAGES)[1]


def test_the_tip_is_not_spoken_of_where_the_camera_alone_is_written():
    written = Conversion(IMAGES, "camera-info", Path("c.yaml"), ())
    assert "'base' lies" not in " ".join(text_of(written, "result.json").split())
    mount = Options(camera=CameraOptions(new_camera_frame="cam"))
    moved = Conversion(IMAGES, "camera-mount", Path("a.urdf"), (), options=mount)
    assert "'base' lies" in " ".join(text_of(moved, "result.json").split())
