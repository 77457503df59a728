"""The intrinsics of a calibration in files of ROS and OpenCV, read by others."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from calib.camera.camera import Camera
from calib.errors import CalibError, FileError, ModelError
from calib.verbs.convert.camera_intrinsics import camera_of_station, write_intrinsics
from calib.verbs.convert.convert import convert
from calib.verbs.convert.format import CameraOptions, Options
from calib.verbs.convert.urdf_formats import result_source
from tests.verbs.convert.camera_arms import INTRINSICS, calibration, image_calibration, words


def test_ros_has_the_camera_that_was_estimated(tmp_path):
    """Its size alone was known before: to half a pixel, and a few thousandths of the distortion."""
    path = tmp_path / "camera_info.yaml"
    convert(image_calibration(), path, to="camera-info")
    table = yaml.safe_load(path.read_text())
    K = np.reshape(table["camera_matrix"]["data"], (3, 3))
    D = table["distortion_coefficients"]["data"]
    assert (table["image_width"], table["image_height"]) == (1280, 720)
    assert table["distortion_model"] == "plumb_bob"
    np.testing.assert_allclose(K[[0, 1], [0, 1]], INTRINSICS[:2], rtol=0, atol=0.5)
    np.testing.assert_allclose(K[:2, 2], INTRINSICS[2:4], rtol=0, atol=0.8)
    np.testing.assert_allclose(D, INTRINSICS[4:], rtol=0, atol=0.02)
    np.testing.assert_array_equal(
        [K[0, 0], K[1, 1], K[0, 2], K[1, 2], *D], image_calibration().optics.cameras["color"].values
    )


def test_opencv_reads_its_file(tmp_path):
    cv2 = pytest.importorskip("cv2")
    path = tmp_path / "camera.yaml"
    convert(image_calibration(), path, to="opencv", options=named("color"))
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    K = storage.getNode("camera_matrix").mat()
    D = storage.getNode("distortion_coefficients").mat()
    values = image_calibration().optics.cameras["color"].values
    np.testing.assert_array_equal([K[0, 0], K[1, 1], K[0, 2], K[1, 2], *D.ravel()], values)


def named(name: str) -> Options:
    return Options(camera=CameraOptions(camera=name))


def cameras(**stations: str) -> dict[str, Camera]:
    """Cameras of these names by their stations."""
    return {station: Camera(name=name, width=4, height=3) for station, name in stations.items()}


STATIONS = ("color", "depth")


def test_a_camera_is_chosen_by_its_station():
    two = cameras(color="a", depth="b")
    assert camera_of_station(two, STATIONS, "color").name == "a"
    assert camera_of_station(two, STATIONS, "depth").name == "b"
    with pytest.raises(ModelError, match="2 cameras: 'color', 'depth'; name one"):
        camera_of_station(two, STATIONS, None)
    with pytest.raises(ModelError, match="no camera 'depht'"):
        camera_of_station(two, STATIONS, "depht")


def test_one_camera_at_several_stations_needs_no_name():
    moved = cameras(**{"": "a"})
    assert camera_of_station(moved, STATIONS, None).name == "a"
    assert camera_of_station(moved, STATIONS, "depth").name == "a"
    mixed = cameras(**{"color": "a", "": "b"})
    assert camera_of_station(mixed, STATIONS, "depth").name == "b"
    tracked = cameras(color="a", third="b")
    with pytest.raises(ModelError, match="'depth' has no camera; one has 'color', 'third'"):
        camera_of_station(tracked, STATIONS, "depth")


def test_what_is_refused(tmp_path):
    path = tmp_path / "camera.yaml"
    with pytest.raises(ModelError, match=r"no camera.*'pixel'"):
        convert(calibration(), path, to="camera-info")
    links = Options(camera=CameraOptions(camera="color", camera_frame="color_optical"))
    with pytest.raises(CalibError, match="it takes --camera alone"):
        convert(image_calibration(), path, to="camera-info", options=links)
    source = result_source(image_calibration(), Options(), "result")

    def mirrored(camera: Camera) -> str:
        return TEXT.format(camera.height, camera.width)

    with pytest.raises(FileError, match="'color' does not read back"):
        write_intrinsics(mirrored, source, path, Options())
    assert not path.exists()


TEXT = """\
image_width: {}
image_height: {}
camera_matrix: {{rows: 3, cols: 3, data: [900, 0, 360, 0, 900, 640, 0, 0, 1]}}
distortion_model: plumb_bob
distortion_coefficients: {{rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}}
"""


def test_intrinsics_with_their_standard_deviations():
    camera = image_calibration().optics.cameras["color"]
    assert camera.values is not None
    assert camera.sigma is not None
    text = words("camera-info", "camera.yaml", image_calibration())
    assert "1280 x 720 px, pinhole" in text[0]
    assert f"fx {camera.values[0]:.2f} ± {camera.sigma[0]:.2f}, fy" in text[0]
    assert f"k1 {camera.values[4]:.5f} ± {camera.sigma[4]:.5f}, k2" in text[0]
    assert text[1].endswith(f"file://{Path('camera.yaml').resolve()}.")
    assert "cv2.FileStorage" in words("opencv", "camera.yaml", image_calibration())[1]
