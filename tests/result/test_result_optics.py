"""Cameras and boards of a result: as estimated, in memory and in its file."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from calib.camera import optics
from calib.camera.camera import UNKNOWN
from calib.camera.lenses import LENSES
from calib.fit.registration.table_rows import rows_and_setup
from calib.model.kinematics import Samples
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from tests.images import BOARD, BODY, VALUES, arm, camera, cell, poses, table
from tests.parts import of_an_earlier_version
from tests.result.test_calibration_file import (
    WHOLE,
    differences,
    documented,
    leaves,
)

#: Errors of the print that the images have: of the scale along x and y.
SCALE = (0.004, 0.002)


def printed():
    """The corners of the board as printed [m]."""
    return BOARD.corners * [1.0 + SCALE[0], 1.0 + SCALE[1], 1.0]


def calibrated(m, c, model="frames", *, validate=False):
    return calibrate(arm(), m, cell=replace(c, model=model), validate=validate)


@pytest.fixture(scope="module")
def measurements():
    return table(poses(12), points=printed(), noise=0.1, seed=1)


@pytest.fixture(scope="module")
def result(measurements):
    # The camera is given with errors that the images correct.
    given = VALUES["pinhole"] + [4.0, -3.0, 2.0, 1.0, 0.01, 0.0, 0.0, 0.0, 0.0]
    return calibrated(measurements, cell(cameras={"": camera(values=given)}))


def test_a_camera_has_the_numbers_as_estimated(result):
    (key,), (found,) = result.optics.cameras, result.optics.cameras.values()
    assert (key, found.width, found.height, found.lens) == ("", 2400, 2000, "pinhole")
    estimates = [result.parameter(name) for name in LENSES["pinhole"].names]
    np.testing.assert_allclose(found.values, [p.value for p in estimates], rtol=1e-12)
    np.testing.assert_allclose(found.sigma, [p.std for p in estimates], rtol=1e-12)
    off = (found.values - VALUES["pinhole"]) / found.sigma
    assert np.abs(off).max() < 4.0
    given = result.optics.nominal_cameras[""]
    assert given.values[:2].tolist() == [704.0, 702.0]
    assert given.sigma[0] == pytest.approx(7.04)


def test_a_board_has_the_mean_scale_as_estimated(result):
    found = result.optics.boards[""]
    x, y = (result.parameter(f"board_scale_{axis}") for axis in "xy")
    assert found.square == pytest.approx(
        BOARD.square * (1.0 + 0.5 * (x.value + y.value)), rel=1e-12
    )
    assert found.marker / found.square == pytest.approx(BOARD.marker / BOARD.square, rel=1e-12)
    k = [result.model.index(p.name) for p in (x, y)]
    half = np.full(2, 0.5)
    variance = half @ result.covariance[np.ix_(k, k)] @ half
    assert found.sigma_scale == pytest.approx(np.sqrt(variance), rel=1e-12)
    assert found.sigma_scale < BOARD.sigma_scale
    assert result.optics.nominal_boards[""].square == BOARD.square


def test_a_body_has_the_mean_scale_as_estimated():
    found = calibrated(table(poses(8), board=BODY, noise=0.1), cell(boards={"": BODY}))
    mean = np.mean([found.parameter(f"board_scale_{axis}").value for axis in "xyz"])
    board = found.optics.boards[""]
    np.testing.assert_allclose(board.corners, BODY.corners * (1.0 + mean), rtol=1e-12)
    assert 0.0 < board.sigma_scale < BODY.sigma_scale
    assert abs(mean) > 1e-6


def test_what_is_exact_stays(measurements):
    exact = camera(sigma=[0.0] * 9)
    stiff = replace(BOARD, sigma_scale=0.0)
    found = calibrated(measurements, cell(cameras={"": exact}, boards={"": stiff}))
    assert found.optics.cameras[""].values.tolist() == exact.values.tolist()
    assert found.optics.cameras[""].sigma.tolist() == [0.0] * 9
    assert (found.optics.boards[""].square, found.optics.boards[""].sigma_scale) == (
        BOARD.square,
        0.0,
    )


def test_a_frozen_number_stays_as_well_known_as_it_was(measurements):
    found = calibrated(measurements, cell(frozen=("k3",))).optics.cameras[""]
    assert found.values[8] == VALUES["pinhole"][8]
    assert found.sigma[8] == 0.02


def test_what_nothing_was_known_of_is_what_the_images_tell(measurements):
    found = calibrated(measurements, cell(cameras={"": camera(values=None)}))
    assert np.all(found.optics.nominal_cameras[""].sigma == UNKNOWN)
    np.testing.assert_allclose(
        found.optics.cameras[""].values[:2], VALUES["pinhole"][:2], rtol=0.02
    )
    assert np.all(found.optics.cameras[""].sigma < 20.0)


def test_cameras_and_boards_have_the_names_of_the_cell(measurements):
    two = tuple("left" if int(i[:-4]) % 2 else "right" for i in measurements.images)
    sides = tuple("a" if name == "left" else "b" for name in two)
    m = replace(measurements, groups=two, targets=sides)
    wide = camera(values=VALUES["pinhole"] + [3.0, *[0.0] * 8])
    given = cell(
        cameras={"left": wide, "": camera(sigma=[0.0] * 9), "unused": camera()},
        boards={"b": BOARD},
        estimate_frame=True,
    )
    found = calibrated(m, given)
    assert set(found.optics.cameras) == {"left", ""}
    assert found.optics.cameras["left"].values[0] == pytest.approx(
        found.parameter("fx[left]").value
    )
    assert found.optics.cameras["left"].values[0] != 703.0
    assert found.optics.cameras[""].values.tolist() == VALUES["pinhole"].tolist()
    assert set(found.optics.boards) == {"b"}
    mean = 0.5 * sum(found.parameter(f"board_scale_{axis}[b]").value for axis in "xy")
    assert found.optics.boards["b"].square == pytest.approx(BOARD.square * (1.0 + mean), rel=1e-12)


def test_without_images_there_are_none(default_result):
    assert (dict(default_result.optics.cameras), dict(default_result.optics.boards)) == ({}, {})
    assert default_result.rows.metres_per_pixel is None


def residual_of_images(c, m):
    """Images as measured minus those that a result predicts, from its own cameras and boards alone."""
    given = cell(cameras=c.optics.nominal_cameras, boards=c.optics.nominal_boards)
    rows, _ = rows_and_setup(c.nominal, m, given)
    T_camera_board = c.geometry.kinematics.poses(c.geometry.x, rows.samples)
    changed = c.geometry.kinematics.internals(c.geometry.x, rows.samples).values
    predicted = optics.images(T_camera_board, changed)
    at_solution = c.setup.sightings(c.robot.poses(m.joints), rows.samples)
    np.testing.assert_allclose(at_solution.T_frame_target, T_camera_board, atol=1e-9)
    np.testing.assert_allclose(at_solution.internals.values, changed, rtol=1e-12)
    return np.column_stack([m.reading("u"), m.reading("v")]) - predicted


@pytest.mark.parametrize(
    "case", ["given", "unknown", "fisheye", pytest.param("dh", marks=pytest.mark.slow)]
)
def test_a_result_read_back_predicts_the_same_images(case, result, measurements, tmp_path):
    m, c = measurements, result
    if case == "unknown":
        c = calibrated(m, cell(cameras={"": camera(values=None)}))
    if case == "fisheye":
        m = table(poses(12), lens="fisheye", noise=0.1)
        c = calibrated(m, cell("fisheye"))
    if case == "dh":
        m = table(poses(25), noise=0.1)
        c = calibrated(m, cell(), model="dh", validate=True)
    read = Calibration.read_json(c.write_json(tmp_path / "r.json"))
    assert differences(c, read) == []
    assert differences(dict(c.optics.cameras), dict(read.optics.cameras)) == []
    assert differences(dict(c.optics.boards), dict(read.optics.boards)) == []
    assert read.summary() == c.summary()
    residual = residual_of_images(read, m)
    np.testing.assert_allclose(residual, c.rows.residual_calibrated[:, :2], atol=1e-9)
    assert np.sqrt(np.mean(residual**2)) < 0.15
    np.testing.assert_allclose(read.tip_poses(m.joints), c.tip_poses(m.joints), atol=1e-12)
    np.testing.assert_array_equal(read.samples(m.joints).q, Samples.at(m.joints).q)


def test_the_file_has_both_cameras_in_plain_words(result, tmp_path):
    written = json.loads(result.write_json(tmp_path / "r.json").read_text())
    (before,), (after,) = written["nominal_cameras"], written["cameras"]
    assert before["lens_names"] == list(LENSES["pinhole"].names)
    assert before["values"] == result.optics.nominal_cameras[""].values.tolist()
    assert after["values"] == result.optics.cameras[""].values.tolist()
    assert (after["station"], after["width_px"], after["height_px"]) == ("", 2400, 2000)
    assert written["nominal_boards"][0]["square_m"] == BOARD.square
    assert written["boards"][0]["square_m"] == result.optics.boards[""].square
    # The document names the keys of lengths and angles, and says that those of pixels are alike.
    found = {re.sub(r"\.px\b", ".m", path) for path, _ in leaves(written)}
    assert found - documented("Keys") - WHOLE == {
        "nominal_cross_validation",
        "noise.pose_noise",
        "scale",
    }


def test_a_file_of_before_cameras_is_read(default_result, tmp_path):
    path = default_result.write_json(tmp_path / "r.json")
    written = of_an_earlier_version(json.loads(path.read_text()))
    for key in ("cameras", "boards", "nominal_cameras", "nominal_boards"):
        del written[key]
    del written["rows"]["metres_per_pixel"]
    path.write_text(json.dumps(written))
    read = Calibration.read_json(path)
    assert (dict(read.optics.cameras), dict(read.optics.boards)) == ({}, {})
