"""Cameras: edges of image, focus and tilt to a hair, viewpoints spread evenly, images as the kind predicts them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import kstest

from calib.boards.board import Board
from calib.camera import optics
from calib.camera.camera import Camera
from calib.camera.lenses import LENSES
from calib.data.cell import Cell
from calib.errors import CalibError, ModelError
from calib.instruments.camera import (
    CameraInstrument,
    SightLimits,
    assumed_intrinsics,
    board_tilts,
    camera_and_board_places,
    outline,
    usual_distances,
    widest_ray,
)
from calib.instruments.instrument import transform
from calib.model.internals import InternalValues
from tests.instruments.scenes import BOARD, CAMERA, SIZE, at_places, camera_of, in_hand, pose

WIDTH, HEIGHT = 0.27, 0.18


def centred(distance: float, turn=(0.0, 0.0, 0.0)) -> np.ndarray:
    """The board's centre straight ahead, turned about it."""
    T = pose((0.0, 0.0, distance), turn)
    T[:3, 3] -= T[:3, :3] @ BOARD.centre
    return T[None]


# Which poses it sees


def test_the_usual_limits_fill_15_to_80_percent_of_the_image():
    nearest, farthest = usual_distances(CAMERA, BOARD)
    for distance, share in ((nearest, 0.8), (farthest, 0.15)):
        u, v = camera_of().project(transform(centred(distance), outline(BOARD))[0])
        assert np.hypot(np.ptp(u), np.ptp(v)) == pytest.approx(share * 1600.0)
    assert camera_of().limits.distances == (nearest, farthest)
    assert camera_of().limits.tilt == pytest.approx(math.radians(55.0))


def test_pixels_are_the_lens_s_and_u_is_to_the_right():
    u, v = camera_of().project(np.array([[0.1, -0.05, 1.0]]))
    assert u[0] == pytest.approx(639.5 + 0.1 * 1024)
    assert v[0] == pytest.approx(479.5 - 0.05 * 1024)


@pytest.mark.parametrize(
    ("distance", "sharp"), [(0.5, True), (0.5 - 1e-9, False), (0.9, True), (0.9 + 1e-9, False)]
)
def test_the_focus_is_between_two_distances(distance, sharp):
    limited = camera_of(distances=(0.5, 0.9))
    for direction in (np.array([0.0, 0.0, 1.0]), np.array([0.6, 0.0, 0.8])):
        T = centred(0.0)
        T[0, :3, 3] += distance * direction * (1 + (1e-12 if distance == 0.5 else -1e-12))
        assert limited.in_focus(T).tolist() == [sharp]


@pytest.mark.parametrize("angle", [0.0, 0.3, 1.2, 3.0])
def test_the_tilt_is_between_the_normal_and_the_line_of_sight(angle):
    camera = camera_of()
    for axis in ((1.0, 0.0, 0.0), (0.6, -0.8, 0.0)):
        T = centred(0.6, angle * np.array(axis))
        assert board_tilts(BOARD, T)[0] == pytest.approx(angle)
        assert camera.is_facing(T)[0] == (angle <= math.radians(55.0))
    # Turned with the line of sight the board is still seen head on.
    aside = pose((0.0, 0.0, 0.0), (0.0, 0.5, 0.0)) @ centred(0.6)
    assert board_tilts(BOARD, aside)[0] == pytest.approx(0.0, abs=1e-7)


def test_the_whole_pattern_must_be_in_the_image():
    # Its left edge is at u = 639.5 + fx (x - width / 2) / z.
    edge = (12.8 - 0.5 - 639.5) / 1024.0 * 0.6 + 0.5 * WIDTH
    whole = camera_of()
    for moved, seen in ((1e-6, True), (-1e-6, False)):
        T = centred(0.6)
        T[0, 0, 3] += edge + moved
        assert whole.in_image(T).tolist() == [seen]
    # Of 8 columns of corners, the first 30 mm inside the pattern, three may be cut off.
    for cut, seen in ((3.99, True), (4.01, False)):
        T = centred(0.6)
        T[0, 0, 3] += edge - cut * 0.03
        assert camera_of(share=0.6).in_image(T).tolist() == [seen]


def test_neither_the_back_of_the_camera_nor_a_folded_lens_sees_anything():
    assert not camera_of().visible(centred(-0.6), BOARD.corners).any()
    # With k1 = -0.2 the image of a ray turns back at a radius of 1.3: what is at 2.0 comes to lie at 0.4.
    values = np.array([1024.0, 1024.0, 639.5, 479.5, -0.2, 0.0, 0.0, 0.0, 0.0])
    folded = camera_of(replace(CAMERA, values=values))
    T = np.eye(4)[None]
    point = np.array([[2.0, 0.0, 1.0]])
    assert 0.0 < LENSES["pinhole"].project(point, values)[0, 0] < 1280.0
    assert not folded.visible(T, point).any()
    assert folded.visible(T, np.array([[0.5, 0.0, 1.0]])).all()


def test_the_widest_ray_is_that_of_the_image_s_corner():
    assert widest_ray(CAMERA) == pytest.approx(math.atan(800.0 / 1024.0))


def test_conditions_are_of_the_board_s_pose_along_the_chain():
    sightline, camera = in_hand("ur5"), camera_of()
    q = np.random.default_rng(1).uniform(-3.0, 3.0, (200, 6))
    T = sightline.target_poses(q)
    conditions = list(camera.sees([sightline]))
    assert [condition.reason for condition in conditions] == ["focus", "tilt", "image"]
    for condition, expected in zip(
        conditions, (camera.in_focus(T), camera.is_facing(T), camera.in_image(T)), strict=True
    ):
        np.testing.assert_array_equal(condition.passes(q), expected)
        assert expected.any() or condition.reason == "image"


@pytest.mark.parametrize(
    ("limits", "words"),
    [
        ({"distances": (0.5, 0.5)}, "500 to 500 mm"),
        ({"distances": (0.0, 0.5)}, "from 0 to"),
        ({"tilt": math.pi / 2}, "90 deg"),
        ({"tilt": 0.0}, "0 deg"),
        ({"share": 0.0}, "0 of the corners"),
        ({"share": 1.1}, "1.1 of the corners"),
    ],
)
def test_limits_that_no_board_can_keep_are_refused(limits, words):
    with pytest.raises(CalibError, match=words):
        SightLimits(**limits)


def test_a_chessboard_is_wholly_in_the_image():
    board = Board(pattern="chessboard", columns=9, rows=6, square=0.03)
    with pytest.raises(CalibError, match="no markers"):
        camera_of(board=board, share=0.5)


# What a cell gives


def test_a_camera_of_which_nothing_is_known_is_assumed():
    size = Camera(width=1000, height=800)
    camera = camera_of(size).camera
    assert camera.values[:4] == pytest.approx([800.0, 800.0, 499.5, 399.5])
    assert not camera.values[4:].any()
    assert np.isinf(camera.sigma).all()
    known = replace(size, values=assumed_intrinsics(size))
    assert camera_of(known).camera is known


def test_what_is_assumed_is_remarked():
    cell = at_places(Cell(cameras={"": SIZE}, boards={"": BOARD}))
    assert CameraInstrument.of(cell).assumed == (
        ("camera_assumed", (1024.0,)),
        ("image_noise", (0.3,)),
    )
    stated = replace(cell, cameras={"": CAMERA}, sigma={"px": 0.2})
    assert CameraInstrument.of(stated).assumed == ()
    assert CameraInstrument.of(stated).noise(np.ones(2)).tolist() == [0.2, 0.2]


def test_the_measurement_frame_is_the_camera_and_the_target_the_board():
    T_camera_base, T_tip_board = pose((0.1, 0.2, 0.3), (0.1, 0.0, 0.0)), pose((1, 0, 0), (3, 0, 0))
    cell = at_places(Cell(), T_camera_base, T_tip_board)
    np.testing.assert_array_equal(camera_and_board_places(cell)[0], T_camera_base)
    np.testing.assert_array_equal(camera_and_board_places(cell)[1], T_tip_board)
    named = replace(
        cell,
        T_frame_base=None,
        target=None,
        frames={"left": T_camera_base},
        targets={"big": T_tip_board[:3, 3]},
    )
    np.testing.assert_array_equal(camera_and_board_places(named)[0], T_camera_base)
    np.testing.assert_array_equal(camera_and_board_places(named)[1], T_tip_board)
    assert camera_and_board_places(Cell()) == (None, None)
    with pytest.raises(CalibError, match="target_rpy_deg"):
        camera_and_board_places(Cell(target=np.ones(3)))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"cameras": {}}, "--camera 1280x720"),
        ({"boards": {}}, "--board board.toml"),
        ({"boards": {"a": BOARD, "b": BOARD}}, "2 were given"),
        ({"target": None}, "--board-at"),
    ],
)
def test_one_camera_and_one_board_whose_place_is_given(changes, words):
    cell = at_places(Cell(cameras={"": SIZE}, boards={"": BOARD}))
    with pytest.raises(CalibError, match=words):
        CameraInstrument.of(replace(cell, **changes))


# What it reads


def test_images_are_those_of_the_kind_and_nan_outside_of_the_image():
    values = np.array([1010.0, 1015.0, 650.0, 470.0, -0.1, 0.05, 1e-3, -5e-4, 0.0])
    camera = camera_of(replace(CAMERA, values=values))
    T = np.concatenate([centred(0.6, (0.4, -0.2, 0.5)), centred(0.3)])
    T[1, 0, 3] += 0.1
    pixels = camera.predict(T)
    rows = np.repeat(T, len(BOARD.corners), axis=0)
    expected = camera.kind.readings_at(
        rows, InternalValues.fixed(np.tile(camera.internals, (2, 1)))
    )
    seen = camera.visible(T, BOARD.corners)
    assert seen[0].all()
    assert 0 < seen[1].sum() < len(BOARD.corners)
    np.testing.assert_allclose(pixels[seen], expected.reshape(pixels.shape)[seen])
    assert np.isnan(pixels[~seen]).all()


def test_coverage_counts_the_cells_of_the_image_with_corners():
    camera = camera_of()
    T = centred(0.6)
    u, v = camera.predict(T)[0].T
    cells = set(zip((u + 0.5) // 160, (v + 0.5) // 160, strict=True))
    assert camera.coverage(T) == pytest.approx(len(cells) / 48)
    assert camera.coverage(np.concatenate([T, centred(1.2)])) >= camera.coverage(T)
    assert camera.internals.shape == (len(BOARD.corners), optics.COUNT)


def test_images_of_a_table_of_corners_count_once():
    q = np.array([[1.0, 2.0], [0.0, 3.0], [1.0, 2.0]])
    np.testing.assert_array_equal(camera_of().stops(q), [[1.0, 2.0], [0.0, 3.0]])


# Viewpoints


@pytest.fixture(scope="module")
def T() -> np.ndarray:
    """Of a board so small that it is in the image wherever its centre is, but for the edges."""
    small = replace(BOARD, square=1e-5, marker=7e-6)
    unit = np.random.default_rng(1).uniform(size=(4000, CameraInstrument.VIEWPOINT_NUMBERS))
    return camera_of(board=small, distances=(0.4, 1.8)).viewpoints(unit)


def test_viewpoints_are_poses_within_the_limits(T):
    assert len(T) > 3800
    np.testing.assert_allclose(
        T[:, :3, :3] @ T[:, :3, :3].swapaxes(1, 2), np.tile(np.eye(3), (len(T), 1, 1)), atol=1e-12
    )
    assert np.linalg.det(T[:, :3, :3]) == pytest.approx(1.0)
    unit = np.random.default_rng(2).uniform(size=(4000, 6))
    camera = camera_of()
    seen = camera.viewpoints(unit)
    assert 100 < len(seen) < 4000
    assert camera.in_focus(seen).all()
    assert camera.is_facing(seen).all()
    assert camera.in_image(seen).all()


def test_tilts_and_nearness_are_spread_evenly(T):
    camera = camera_of(board=replace(BOARD, square=1e-5, marker=7e-6), distances=(0.4, 1.8))
    assert kstest(board_tilts(camera.board, T) / camera.limits.tilt, "uniform").pvalue > 1e-3
    nearness = 1.0 / camera.board_distances(T)
    low, high = 1.0 / 1.8, 1.0 / 0.4
    assert kstest((nearness - low) / (high - low), "uniform").pvalue > 1e-3


def test_the_centre_of_the_board_is_anywhere_in_the_image(T):
    u, v = camera_of().project(T[:, :3, 3])
    margin = 0.01 * 1280.0
    for pixel, size in ((u, 1280.0), (v, 960.0)):
        inside = (pixel + 0.5 - margin) / (size - 2.0 * margin)
        assert kstest(inside, "uniform").pvalue > 1e-3


def test_it_is_tilted_and_rolled_in_all_directions(T):
    # The normal about the line of sight, and the board's x about the normal.
    rays = T[:, :3, 3] / np.linalg.norm(T[:, :3, 3], axis=1)[:, None]
    for vector in (T[:, :3, 2] - rays * np.sum(T[:, :3, 2] * rays, axis=1)[:, None], T[:, :3, 0]):
        angle = np.arctan2(vector[:, 1], vector[:, 0]) / (2.0 * np.pi) + 0.5
        counts = np.histogram(angle, bins=8, range=(0.0, 1.0))[0]
        assert counts.min() > 0.6 * 500


def test_a_board_that_never_fits_the_image():
    unit = np.random.default_rng(2).uniform(size=(50, 6))
    with pytest.raises(ModelError, match="never in the image"):
        camera_of(distances=(0.05, 0.06)).viewpoints(unit)
