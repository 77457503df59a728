"""The study of hand-eye methods: what is left out, and that fits of the arm's zeros beat the arm taken as exact."""

from __future__ import annotations

import importlib.util
import sys

import numpy as np
import pytest

from tests.places import ROOT

SCRIPTS = ROOT / "scripts"


@pytest.fixture(scope="module")
def study():
    sys.path.insert(0, str(SCRIPTS))
    spec = importlib.util.spec_from_file_location("hand_eye_study", SCRIPTS / "hand_eye_study.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["hand_eye_study"] = module
    spec.loader.exec_module(module)
    return module


def test_two_poses_of_both_places_are_left_out(study):
    data = study.Data.load()
    left_out = [data.left_out(k) for k in range(study.FOLDS)]
    np.testing.assert_array_equal(np.sum(left_out, axis=0), 1)
    assert [len(data.pictures(out)) for out in left_out] == [4] * study.FOLDS
    assert {picture.place for picture in data.pictures(left_out[2])} == {"a", "b"}


def test_the_pose_of_a_board_is_that_of_its_corners(study):
    data = study.Data.load()
    picture = data.pictures(data.left_out(0))[0]
    T = study.board_pose(picture.points, picture.pixels, data.lens)
    in_camera = picture.points @ T[:3, :3].T + T[:3, 3]
    predicted = study.LENSES["pinhole"].project(in_camera, data.lens)
    assert np.sqrt(np.mean((predicted - picture.pixels) ** 2)) < 0.5


@pytest.mark.slow
def test_the_arm_s_zeros_are_most_of_what_hand_eye_calibration_leaves(study):
    data = study.Data.load()
    pixels, place = study.judge(data, study.by_calib("zeros"))
    assert pixels == pytest.approx(1.63, abs=0.1)
    assert place == pytest.approx(1.17e-3, abs=0.1e-3)
    exact, _ = study.judge(data, study.by_calib("frames"))
    assert exact > 3.0 * pixels
