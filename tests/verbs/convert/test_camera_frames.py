from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.errors import ModelError
from calib.verbs.convert.camera_frames import estimated_board, estimated_camera
from tests.parts import with_part
from tests.verbs.convert.camera_arms import T_BASE_BOARD, T_TOOL_OPTICAL, calibration, pose


def test_a_camera_is_on_the_first_link_and_a_board_on_the_last():
    """To the noise along, and about z to what the priors leave of wrist_3's and shoulder_pan's zeros."""
    camera = estimated_camera(calibration())
    board = estimated_board(calibration())
    assert (camera.name, camera.link) == ("color", "tool0")
    assert (board.name, board.link) == ("board", "base")
    off = np.linalg.inv(T_TOOL_OPTICAL) @ camera.T_link_frame
    assert np.abs(off[:3, 3]).max() < 3e-4
    assert np.abs(off[:2, 2]).max() < 2e-3
    assert np.abs(camera.T_link_frame - T_TOOL_OPTICAL).max() < 2e-2
    assert np.abs(board.T_link_frame - T_BASE_BOARD).max() < 2e-2
    T = calibration().T_frame_base @ camera.T_link_frame
    np.testing.assert_allclose(T, np.eye(4), rtol=0, atol=1e-14)


def two_of_each():
    """The same with a second camera and a second board, 10 and 20 mm away."""
    result = calibration()
    setup = result.setup
    frames = np.concatenate([setup.T_frame_base, setup.T_frame_base @ pose(0.01, 0, 0, 0, 0, 0)])
    targets = np.concatenate([setup.T_tip_target, setup.T_tip_target @ pose(0.02, 0, 0, 0, 0, 0)])
    both = replace(
        setup,
        groups=("color", "depth"),
        frame_links=("tool0", "base"),
        target_links=("base", "tool0"),
        targets=("board", "other"),
        T_frame_base=frames,
        T_tip_target=targets,
        unknown=setup.unknown * 2,
    )
    return with_part(result, "geometry", setup=both)


def test_of_several_one_is_named():
    result = two_of_each()
    camera = estimated_camera(result, "depth")
    T = np.linalg.inv(estimated_camera(result, "color").T_link_frame) @ camera.T_link_frame
    assert (camera.name, camera.link) == ("depth", "base")
    assert np.linalg.norm(T[:3, 3]) == pytest.approx(0.01)
    board = estimated_board(result, "other")
    assert board.link == "tool0"
    T = np.linalg.inv(estimated_board(result, "board").T_link_frame) @ board.T_link_frame
    np.testing.assert_allclose(T, pose(0.02, 0, 0, 0, 0, 0), rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "words"),
    [(None, "2 cameras: 'color', 'depth'; name one with --camera"), ("dept", "mean 'depth'")],
)
def test_a_camera_that_is_not_named_or_does_not_exist(name, words):
    with pytest.raises(ModelError, match=words):
        estimated_camera(two_of_each(), name)


def test_a_point_is_no_board_and_a_frame_that_no_row_places_is_no_camera():
    result = calibration()
    points = with_part(result, "geometry", setup=replace(result.setup, oriented=False))
    with pytest.raises(ModelError, match="'board' of this result is a point"):
        estimated_board(points)
    rows = replace(result.rows, kinds=("plane",) * len(result.rows))
    plane = replace(result.setup, unknown=(("z", "rx", "ry"),))
    with pytest.raises(ModelError, match="'plane'"):
        estimated_camera(with_part(replace(result, rows=rows), "geometry", setup=plane))
    given = replace(plane, frame_given=np.array([True]))
    for setup in (result.setup, given):
        assert (
            estimated_camera(with_part(replace(result, rows=rows), "geometry", setup=setup)).link
            == "tool0"
        )
