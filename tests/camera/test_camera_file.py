"""Files of cameras: TOML written and read back, how well numbers are known, and mistakes."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from calib.camera.camera import UNKNOWN, Camera
from calib.camera.camera_file import (
    camera_info_yaml,
    camera_of_table,
    camera_toml,
    opencv_yaml,
    read_camera,
)
from calib.camera.lenses import LENSES
from calib.errors import CalibError, FileError

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib
from tests.camera.lens_values import WRITTEN as VALUES

#: A table of a camera whose numbers are given as they are needed at least.
TABLE = {"width": 1280, "height": 720, "fx": 634.0, "fy": 641.0, "cx": 652.0, "cy": 349.0}


def camera(lens="pinhole", sigma=None):
    values = np.array(VALUES[lens])
    return Camera(name='le "ft" é', width=1280, height=720, lens=lens, values=values, sigma=sigma)


def assert_same(a, b):
    assert (a.name, a.width, a.height, a.lens) == (b.name, b.width, b.height, b.lens)
    for left, right in ((a.values, b.values), (a.sigma, b.sigma)):
        assert (left is None) == (right is None)
        assert left is None or left.tolist() == right.tolist()


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("sigma", [None, 0.0, UNKNOWN, "each"])
def test_a_camera_is_read_back_exactly(lens, sigma, tmp_path):
    count = len(VALUES[lens])
    each = [0.0, UNKNOWN, *np.geomspace(1e-5, 3.0, count - 2)]
    given = {None: None, "each": each}.get(sigma, np.full(count, sigma or 0.0))
    path = tmp_path / "camera.toml"
    path.write_text(camera_toml(camera(lens, given)), encoding="utf-8")
    assert_same(read_camera(path), camera(lens, given))


def test_a_camera_of_which_only_the_size_is_known_is_read_back(tmp_path):
    path = tmp_path / "camera.toml"
    path.write_text(camera_toml(Camera(width=640, height=480, lens="fisheye")))
    assert_same(read_camera(path), Camera(width=640, height=480, lens="fisheye"))


def test_toml_has_the_numbers_by_their_names():
    table = tomllib.loads(camera_toml(camera(sigma=np.arange(9.0))))
    assert table["fx"] == VALUES["pinhole"][0]
    assert table["p2"] == VALUES["pinhole"][7]
    assert table["sigma_cy_px"] == 3.0
    assert table["sigma_k3"] == 8.0


@pytest.mark.parametrize("write", [camera_info_yaml, opencv_yaml, camera_toml])
@pytest.mark.parametrize("name", ["camera.yaml", "camera", "camera.txt"])
def test_the_content_says_what_a_file_is(write, name, tmp_path):
    path = tmp_path / name
    path.write_text(write(camera()), encoding="utf-8")
    assert_same(read_camera(path), camera())


def test_distortion_that_is_not_given_is_zero():
    made = camera_of_table(TABLE, "cell.toml, [camera]")
    assert made.values.tolist() == [634.0, 641.0, 652.0, 349.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    assert (made.name, made.sigma) == ("camera", None)


@pytest.mark.parametrize(
    ("keys", "sigma"),
    [
        ({"intrinsics": "exact"}, [0.0] * 9),
        ({"intrinsics": "unknown"}, [UNKNOWN] * 9),
        ({"sigma_focal_px": 2}, [2.0, 2.0, 6.4, 6.4, 0.02, 0.02, 0.002, 0.002, 0.02]),
        (
            {"sigma_centre_px": 1.5, "sigma_distortion": 0.0, "sigma_k3": np.inf},
            [6.34, 6.41, 1.5, 1.5, 0.0, 0.0, 0.0, 0.0, np.inf],
        ),
        (
            {"sigma_fy_px": 1.0, "sigma_focal_px": 3.0},
            [3.0, 1.0, 6.4, 6.4, 0.02, 0.02, 0.002, 0.002, 0.02],
        ),
    ],
)
def test_how_well_numbers_are_known(keys, sigma):
    made = camera_of_table({**TABLE, **keys}, "cell.toml, [camera]")
    np.testing.assert_allclose(made.sigma, sigma)


def test_a_size_alone_is_a_camera_whose_images_tell_the_rest():
    for keys in ({}, {"intrinsics": "unknown"}):
        made = camera_of_table({"width": 640, "height": 480, **keys}, "cell.toml, [camera]")
        assert (made.values, made.sigma) == (None, None)


@pytest.mark.parametrize("write", [camera_info_yaml, opencv_yaml])
def test_a_table_names_a_file_beside_it(write, tmp_path):
    (tmp_path / "left.yaml").write_text(write(camera()), encoding="utf-8")
    table = {"file": "left.yaml", "name": "eye", "k3": 0.5, "intrinsics": "exact"}
    made = camera_of_table(table, "cell.toml, [camera]", tmp_path)
    assert (made.name, made.width, made.height) == ("eye", 1280, 720)
    assert made.values.tolist() == [*VALUES["pinhole"][:8], 0.5]
    assert made.sigma.tolist() == [0.0] * 9


def test_standard_deviations_of_a_file_are_kept(tmp_path):
    (tmp_path / "left.toml").write_text(camera_toml(camera(sigma=np.arange(9.0))))
    made = camera_of_table({"file": "left.toml", "sigma_focal_px": 7.0}, "here", tmp_path)
    assert made.sigma.tolist() == [7.0, 7.0, *np.arange(2.0, 9.0)]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"fx": None}, ("'fx'", "lacks", "'fy'")),
        ({"width": None}, ("'width'", "1280")),
        ({"width": "wide"}, ("width", "wide")),
        ({"name": 3}, ("'name'", "3")),
        ({"lens": 3}, ("'lens'", "3")),
        ({"lens": "pin-hole"}, ("did you mean 'pinhole'",)),
        ({"focal": 3.0}, ("'focal'", "'sigma_focal_px'", "'fx'")),
        ({"lens": "fisheye", "p1": 0.0}, ("'p1'", "fisheye")),
        ({"k1": "0.1"}, ("'k1'", "'0.1'")),
        ({"k1": np.nan}, ("'k1'", "nan")),
        ({"intrinsics": "excat"}, ("did you mean 'exact'", "sigma_focal_px")),
        ({"intrinsics": 0}, ("'intrinsics'", "0")),
        ({"intrinsics": "exact", "sigma_k1": 0.1}, ("'intrinsics'", "'sigma_k1'")),
        ({"sigma_focal_px": -1.0}, ("'sigma_focal_px'", "-1.0")),
        ({"sigma_focal_px": True}, ("'sigma_focal_px'", "True")),
        ({"sigma_focal_px": np.nan}, ("'sigma_focal_px'", "nan")),
        ({"file": 3}, ("'file'", "3")),
    ],
)
def test_a_mistake_is_said(changes, words):
    table = {key: value for key, value in {**TABLE, **changes}.items() if value is not None}
    with pytest.raises(CalibError) as error:
        camera_of_table(table, "cell.toml, [camera]")
    for word in ("cell.toml, [camera]", *words):
        assert word in str(error.value)


@pytest.mark.parametrize(
    "keys", [{"intrinsics": "exact"}, {"sigma_focal_px": 1.0}, {"sigma_k1": 0.1}]
)
def test_numbers_that_are_not_given_are_not_known(keys):
    with pytest.raises(CalibError, match="cx"):
        camera_of_table({"width": 640, "height": 480, **keys}, "cell.toml, [camera]")


def test_the_lens_of_a_file_is_not_another_one(tmp_path):
    (tmp_path / "left.yaml").write_text(camera_info_yaml(camera()), encoding="utf-8")
    with pytest.raises(CalibError, match=r"'fisheye'.*'pinhole'"):
        camera_of_table({"file": "left.yaml", "lens": "fisheye"}, "cell.toml", tmp_path)


@pytest.mark.parametrize(
    ("name", "data", "word"),
    [
        ("camera.toml", b"width: 3", "TOML"),
        ("camera.yaml", b"\xff\xfe\x00", "UTF-8"),
        ("camera.yaml", b"width 3", "not the description of a camera"),
    ],
)
def test_other_files_are_refused(name, data, word, tmp_path):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(FileError, match=word):
        read_camera(tmp_path / name)


def test_a_file_that_is_missing_is_named(tmp_path):
    with pytest.raises(FileError, match=r"cell.toml.*left.yaml"):
        camera_of_table({"file": "left.yaml"}, "cell.toml, [camera]", tmp_path)


def test_a_file_of_a_camera_names_no_other_file(tmp_path):
    (tmp_path / "left.toml").write_text('file = "left.toml"')
    with pytest.raises(CalibError, match="'file'"):
        read_camera(tmp_path / "left.toml")
