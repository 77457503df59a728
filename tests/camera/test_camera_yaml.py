"""Cameras as YAML: files of ROS and OpenCV, read back by readers that are not calib's, and mistakes in them."""

from __future__ import annotations

import re

import cv2
import numpy as np
import pytest
import yaml

from calib.camera.camera import Camera
from calib.camera.camera_yaml import camera_info_yaml, camera_of_yaml, opencv_yaml
from calib.camera.lenses import LENSES
from calib.errors import CalibError, FileError
from tests.camera.lens_values import WRITTEN as VALUES

#: A file of ROS by its calibrator, with a number as YAML 1.1 does not read it.
ROS = """\
image_width: 640
image_height: 480
camera_name: wrist
camera_matrix:
  rows: 3
  cols: 3
  data: [ 580.5,    0.     ,  315.25,
            0.     ,  576.75,  247.5,
            0.     ,    0.     ,    1.     ]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [0.134462, -0.311908, 0.002304, 3e-05, 0.5]
rectification_matrix: {rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}
projection_matrix: {rows: 3, cols: 4, data: [587.7, 0, 316.8, 0, 0, 585.7, 248.3, 0, 0, 0, 1, 0]}
"""

#: A CameraInfo message as ``ros2 topic echo`` prints it.
ECHO = """\
header:
  stamp: {sec: 1, nanosec: 2}
  frame_id: camera
height: 480
width: 640
distortion_model: equidistant
d: [0.1, 0.2, 0.3, 0.4]
k: [580.5, 0.0, 315.25, 0.0, 576.75, 247.5, 0.0, 0.0, 1.0]
r: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
p: [580.5, 0.0, 315.25, 0.0, 0.0, 576.75, 247.5, 0.0, 0.0, 0.0, 1.0, 0.0]
binning_x: 0
binning_y: 0
roi: {x_offset: 0, y_offset: 0, height: 0, width: 0, do_rectify: false}
---
header:
"""


def camera(lens):
    return Camera(
        name='left "eye"', width=1280, height=720, lens=lens, values=np.array(VALUES[lens])
    )


def camera_info(text):
    """Parse a camera_info file line by line, without YAML: the fields of the message CameraInfo."""
    plain = dict(re.findall(r"^(image_width|image_height|distortion_model): (\S+)$", text, re.M))
    matrices = {}
    pattern = r"^(\w+):\n\s+rows: (\d+)\n\s+cols: (\d+)\n\s+data: \[([^\]]*)\]$"
    for name, rows, columns, data in re.findall(pattern, text, re.M):
        shape = (int(rows), int(columns))
        matrices[name] = np.array([float(word) for word in data.split(",")]).reshape(shape)
    return {
        "width": int(plain["image_width"]),
        "height": int(plain["image_height"]),
        "distortion_model": plain["distortion_model"],
        "D": matrices["distortion_coefficients"][0],
        "K": matrices["camera_matrix"],
        "R": matrices["rectification_matrix"],
        "P": matrices["projection_matrix"],
    }


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("write", [camera_info_yaml, opencv_yaml])
def test_a_camera_is_read_back_exactly(lens, write):
    read = camera_of_yaml(write(camera(lens)), "camera.yaml")
    assert (read.name, read.width, read.height, read.lens) == ('left "eye"', 1280, 720, lens)
    assert read.values.tolist() == VALUES[lens]
    assert read.sigma is None


@pytest.mark.parametrize("lens", LENSES)
def test_ros_reads_the_same_numbers(lens):
    info = camera_info(camera_info_yaml(camera(lens)))
    fx, fy, cx, cy, *coefficients = VALUES[lens]
    assert (info["width"], info["height"]) == (1280, 720)
    models = {"pinhole": "plumb_bob", "fisheye": "equidistant"}
    assert info["distortion_model"] == models.get(lens, "rational_polynomial")
    assert info["D"].tolist() == coefficients
    assert info["K"].tolist() == [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]
    np.testing.assert_array_equal(info["R"], np.eye(3))
    np.testing.assert_array_equal(info["P"], np.column_stack([info["K"], np.zeros(3)]))


@pytest.mark.parametrize("lens", LENSES)
def test_plain_yaml_reads_numbers_as_numbers(lens):
    table = yaml.safe_load(camera_info_yaml(camera(lens)))
    assert table["camera_name"] == 'left "eye"'
    assert table["distortion_coefficients"]["data"] == VALUES[lens][4:]
    assert table["projection_matrix"]["rows"] == 3


@pytest.mark.parametrize("lens", LENSES)
def test_opencv_reads_the_same_numbers(lens, tmp_path):
    path = tmp_path / "camera.yaml"
    path.write_text(opencv_yaml(camera(lens)))
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    fx, fy, cx, cy, *coefficients = VALUES[lens]
    assert storage.getNode("image_width").real() == 1280
    assert storage.getNode("image_height").real() == 720
    assert storage.getNode("camera_name").string() == 'left "eye"'
    assert storage.getNode("fisheye_model").real() == (lens == "fisheye")
    assert storage.getNode("camera_matrix").mat().tolist() == [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]
    assert storage.getNode("distortion_coefficients").mat().tolist() == [coefficients]
    storage.release()


@pytest.mark.parametrize("suffix", [".yaml", ".json"])
@pytest.mark.parametrize("key", ["distortion_coefficients", "dist_coeffs", "distCoeffs"])
def test_what_opencv_writes_is_read(key, suffix, tmp_path):
    path = tmp_path / f"camera{suffix}"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 640)
    storage.write("image_height", 480)
    storage.write("camera_matrix", np.array([[580.5, 0, 315.25], [0, 576.75, 247.5], [0, 0, 1]]))
    storage.write(key, np.array([[0.1], [1e-5], [0.3], [0.4]]))
    storage.release()
    read = camera_of_yaml(path.read_text(), "camera.yaml")
    assert (read.width, read.height, read.lens) == (640, 480, "pinhole")
    assert read.values.tolist() == [580.5, 576.75, 315.25, 247.5, 0.1, 1e-5, 0.3, 0.4, 0.0]


@pytest.mark.parametrize(
    ("further", "lens"),
    [
        ("0, 0, 0", "pinhole"),
        ("0, 0.25, 0", "rational"),
        ("0, 0.25, 0, 0, 0, 0, 0", "rational"),
        ("0, 0, 0, 0, 0, 0.1, 0", "tilted"),
        ("0, 0.25, 0, 0, 0, 0.1, 0, 0.02, 0", "tilted"),
    ],
)
def test_the_lens_is_that_of_the_fewest_coefficients(further, lens):
    text = ROS.replace("3e-05, 0.5]", f"3e-05, 0.5, {further}]")
    assert text != ROS
    read = camera_of_yaml(text, "camera.yaml")
    assert read.lens == lens
    given = [float(word) for word in further.split(",")]
    count = len(read.values) - 9
    assert read.values[9:].tolist() == np.pad(given, (0, 9))[:count].tolist()


def test_files_of_the_ros_calibrator_are_read():
    read = camera_of_yaml(ROS, "camera.yaml")
    assert (read.name, read.width, read.height, read.lens) == ("wrist", 640, 480, "pinhole")
    assert read.values.tolist() == [
        *(580.5, 576.75, 315.25, 247.5),
        *(0.134462, -0.311908, 0.002304, 3e-05, 0.5),
    ]


@pytest.mark.parametrize("text", [ECHO, ECHO.replace("d:", "D:").replace("k:", "K:")])
def test_echoed_messages_are_read(text):
    read = camera_of_yaml(text, "camera.yaml")
    assert (read.name, read.width, read.height, read.lens) == ("camera", 640, 480, "fisheye")
    assert read.values.tolist() == [580.5, 576.75, 315.25, 247.5, 0.1, 0.2, 0.3, 0.4]


def test_of_an_uncalibrated_camera_the_size_is_known():
    zero = ECHO.replace(
        "580.5, 0.0, 315.25, 0.0, 576.75, 247.5, 0.0, 0.0, 1.0", "0, 0, 0, 0, 0, 0, 0, 0, 0"
    )
    read = camera_of_yaml(zero.replace("[0.1, 0.2, 0.3, 0.4]", "[]"), "camera.yaml")
    assert (read.width, read.height, read.values) == (640, 480, None)


@pytest.mark.parametrize(
    ("model", "coefficients", "expected"),
    [
        ("rational_polynomial", "[0.1, 0.2, 0.3, 0.4, 0.5, 0, 0, 0]", [0.1, 0.2, 0.3, 0.4, 0.5]),
        ("plumb_bob", "[]", [0.0] * 5),
        ("''", "[]", [0.0] * 5),
        ("Plumb_Bob", "[0.1, 0.2, 0.3, 0.4]", [0.1, 0.2, 0.3, 0.4, 0.0]),
        ("equidistant", "[]", [0.0] * 4),
    ],
)
def test_models_of_ros(model, coefficients, expected):
    text = ECHO.replace("equidistant", model).replace("[0.1, 0.2, 0.3, 0.4]", coefficients)
    assert camera_of_yaml(text, "camera.yaml").values[4:].tolist() == expected


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("image_width: 640\n", "", ("'image_width'", "lacks")),
        ("image_width: 640", "image_width: wide", ("'image_width'", "wide", "1280")),
        ("image_width: 640", "image_width: 640.5", ("'image_width'", "640.5")),
        ("image_width: 640", "image_width: -640", ("'image_width'", "-640")),
        ("plumb_bob", "plumb_bop", ("plumb_bop", "did you mean 'plumb_bob'", "equidistant")),
        ("plumb_bob", "equidistant", ("5 numbers", "4: k1, k2, k3, k4")),
        ("plumb_bob", "thin_prism", ("thin_prism", "rational_polynomial")),
        (
            "[0.134462,",
            "[0, 0, 0.134462,",
            ("7 numbers", "4, 5, 8, 12 or 14", "k1, k2, p1, p2, k3"),
        ),
        ("3e-05, 0.5]", "3e-05, .nan]", ("distortion_coefficients",)),
        ("[ 580.5,", "[ 580.5, 1.0,", ("10 numbers", "nine")),
        ("[ 580.5,    0. ", "[ 580.5,    1.5", ("skew", "1.5")),
        ("580.5", "-580.5", ("fx = -580.5",)),
        ("580.5", "x", ("'camera_matrix'", "x")),
    ],
)
def test_a_mistake_is_said(old, new, words):
    assert old in ROS
    with pytest.raises(CalibError) as error:
        camera_of_yaml(ROS.replace(old, new), "left.yaml")
    for word in ("left.yaml", *words):
        assert word in str(error.value)


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [("binning_x: 0", "binning_x: 2", "'binning_x'"), ("x_offset: 0", "x_offset: 40", "'roi'")],
)
def test_a_part_of_the_image_is_refused(old, new, word):
    with pytest.raises(CalibError, match=word):
        camera_of_yaml(ECHO.replace(old, new), "camera.yaml")


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("a: [1", "neither YAML nor TOML"),
        ("", "not the description of a camera"),
        ("1280", "not the description of a camera"),
        ("<?xml version='1.0'?>", "XML"),
        ("a: !!python/object/apply:os.getcwd []", "neither YAML nor TOML"),
    ],
)
def test_other_files_are_refused(text, word):
    with pytest.raises(FileError, match=word):
        camera_of_yaml(text, "camera.yaml")


@pytest.mark.parametrize("write", [camera_info_yaml, opencv_yaml])
def test_without_numbers_there_is_nothing_to_write(write):
    with pytest.raises(CalibError, match="'wrist'"):
        write(Camera(name="wrist", width=640, height=480))
