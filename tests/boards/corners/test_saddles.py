"""Corners of squares to a hundredth of a pixel, as uncertain as many pictures show; none in other colours."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calib.boards.corners.saddles as saddles_module
from calib.basics.arrays import Array
from calib.boards.board import Board, corner_signs
from calib.boards.corners.chessboards import window_size
from calib.boards.corners.planar_map import fit_planar_map
from calib.boards.corners.saddles import (
    Saddles,
    find_saddles,
    interpolate,
    patches_at,
    saddle_colours,
    uncertainties,
    window_weights,
)
from tests.boards.board_views import CHARUCO_BOARD, CHESS_BOARD, View, render

#: A window that is sheared and narrow.
WINDOW = np.array([[3.0, 0.5], [0.8, 1.5]])

#: Pictures that differ in their noise.
PICTURES = 12


def windows(board: Board, view: View) -> Array:
    """The windows around the true corners."""
    return window_size(board) * jacobians(board, view)


def jacobians(board: Board, view: View) -> Array:
    """The derivatives of the corners' pixels by x and y of the board."""
    points = board.corners[:, :2]
    planar_map = fit_planar_map(points, view.corners(board), view.size)
    return planar_map.jacobians(points, 0.25 * board.square)


def saddles(board: Board, view: View, offset: float = 0.0, sign: float = 1.0) -> Saddles:
    """The saddles next to the true corners."""
    image = np.asarray(render(board, view), dtype=float)
    expected = view.corners(board) + offset
    return find_saddles(image, expected, windows(board, view), sign * corner_signs(board))


@pytest.mark.parametrize("board", [CHARUCO_BOARD, CHESS_BOARD], ids=["charuco", "chessboard"])
@pytest.mark.parametrize(
    "view",
    [
        View(noise=0, tilt=(5, 3, 20)),
        View(noise=0, tilt=(5, 3, 20), blur=1.5),
        View(noise=0, tilt=(0, 60, 20), blur=0.8),
    ],
    ids=["frontal", "blurred", "steep"],
)
def test_without_noise_a_corner_is_exact(board: Board, view: View):
    found = saddles(board, view, offset=1.5)
    assert found.exist.all()
    error = found.pixels - view.corners(board)
    assert np.sqrt(np.mean(error**2)) < 0.013
    assert np.abs(error.mean(axis=0)).max() < 0.005


def test_other_colours_are_no_corner():
    assert not saddles(CHARUCO_BOARD, View(noise=0, tilt=(5, 3, 20)), sign=-1.0).exist.any()


def test_one_edge_or_nothing_is_no_corner():
    image = np.full((60, 60), 50.0)
    window = 3.0 * np.eye(2)[None]
    place = np.array([[30.0, 30.0]])
    assert not find_saddles(image, place, window, np.ones(1)).exist.any()
    image[:, 30:] = 200.0
    assert not find_saddles(image, place, window, np.ones(1)).exist.any()


def test_a_corner_at_the_image_s_edge_is_none():
    image = np.full((60, 60), 50.0)
    image[:3, :30] = 200.0
    image[3:, 30:] = 200.0
    window = 3.0 * np.eye(2)[None]
    sign = np.ones(1)
    assert not find_saddles(image, np.array([[29.5, 2.5]]), window, sign).exist.any()
    inside = np.roll(image, 20, axis=0)
    inside[:20, :30] = 200.0
    inside[:20, 30:] = 50.0
    found = find_saddles(inside, np.array([[29.0, 23.0]]), window, sign)
    np.testing.assert_allclose(found.pixels, [[29.5, 22.5]], atol=0.01)


def weights_at(offsets: Array) -> Array:
    """The weights at offsets (n, 2) from a corner, each in a window of its own."""
    d_u, d_v = offsets.T[:, :, None, None]
    return window_weights(d_u, d_v, np.tile(WINDOW, (len(offsets), 1, 1)))[:, 0, 0]


def test_across_an_edge_the_weights_are_even():
    for axis in (0, 1):
        along = WINDOW[:, axis] / np.hypot(*WINDOW[:, axis])
        across = np.array([-along[1], along[0]])
        for distance in (1.0, 2.5):
            offsets = distance * along + np.array([[-0.05], [0.05]]) * across
            before, behind = weights_at(offsets)
            assert before == pytest.approx(behind, rel=1e-3)


def test_weights_end_where_the_window_does():
    along_x = WINDOW[:, 0]
    weights = weights_at(np.array([0.0 * along_x, 2.79 * along_x, 2.81 * along_x]))
    assert weights[0] == 1.0
    assert weights[1] > 0.0
    assert weights[2] == 0.0


def test_a_patch_has_central_differences():
    u, v = np.meshgrid(np.arange(40.0), np.arange(30.0))
    q = np.array([[20.3, 14.8], [11.1, 12.2]])
    patches = patches_at(3.0 * u - 2.0 * v, q, np.stack([WINDOW, 0.6 * WINDOW]))
    assert patches.are_inside.all()
    inside = patches.weights > 0.0
    np.testing.assert_allclose(patches.g_u[inside], 3.0)
    np.testing.assert_allclose(patches.g_v[inside], -2.0)
    total = patches.weights.sum(axis=(1, 2))[:, None, None]
    np.testing.assert_allclose(patches.normal_matrices(), total * np.array([[9, -6], [-6, 4]]))
    # Offsets are from the place to the pixels.
    np.testing.assert_allclose(np.round(patches.d_u[:, 0] + q[:, :1], 9) % 1.0, 0.0)
    np.testing.assert_allclose(np.round(patches.d_v[:, :, 0] + q[:, 1:], 9) % 1.0, 0.0)
    # Beside a larger window, the smaller one has no more pixels than alone.
    alone = patches_at(3.0 * u - 2.0 * v, q[1:], 0.6 * WINDOW[None])
    assert np.count_nonzero(patches.weights[1]) == np.count_nonzero(alone.weights[0])
    assert patches.weights[1].sum() == pytest.approx(alone.weights[0].sum(), rel=1e-12)


@pytest.mark.parametrize("place", [(2.0, 15.0), (38.0, 15.0), (20.0, 1.0), (np.nan, 3.0)])
def test_a_patch_that_leaves_the_image_has_no_weight(place: tuple[float, float]):
    patches = patches_at(np.zeros((30, 40)), np.array([place]), WINDOW[None])
    assert not patches.are_inside.any()
    assert not patches.weights.any()
    assert uncertainties(np.zeros((30, 40)), np.array([place]), WINDOW[None]) == np.inf


def test_the_other_colours_are_told_from_none():
    view = View(noise=0, tilt=(5, 3, 20))
    image = np.asarray(render(CHESS_BOARD, view), dtype=float)
    signs = corner_signs(CHESS_BOARD)
    expected = view.corners(CHESS_BOARD)
    _, colours = saddle_colours(image, expected, windows(CHESS_BOARD, view))
    assert (colours == signs).all()
    _, negative = saddle_colours(255.0 - image, expected, windows(CHESS_BOARD, view))
    assert (negative == -signs).all()
    # In the middle of a square there is none.
    middles = expected + 0.5 * CHESS_BOARD.square * jacobians(CHESS_BOARD, view).sum(axis=2)
    _, none = saddle_colours(image, middles, windows(CHESS_BOARD, view))
    assert not none.any()


def test_interpolation_is_exact_for_a_parabola_and_averages_noise():
    u, v = np.meshgrid(np.arange(40.0), np.arange(30.0))
    places = np.array([[10.3, 12.9], [20.0, 7.5]])
    values, gain = interpolate(u**2 + u * v, places)
    np.testing.assert_allclose(values, places[:, 0] ** 2 + places[:, 0] * places[:, 1])
    noise = np.random.default_rng(0).normal(size=(400, 400))
    rows = np.arange(5.0, 390.0, 5.0)
    many = np.stack(np.meshgrid(rows + 0.5, rows), axis=-1).reshape(-1, 2)
    values, gain = interpolate(noise, many)
    assert np.var(values) == pytest.approx(gain[0], rel=0.1)
    assert gain[0] == pytest.approx(0.6406, abs=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("board", "view"),
    [
        (CHESS_BOARD, View(tilt=(5, 3, 20), blur=1.5)),
        (CHESS_BOARD, View(tilt=(5, 3, 20), blur=2.5)),
        (CHARUCO_BOARD, View(tilt=(0, 60, 20), blur=0.8, noise=4)),
        (CHARUCO_BOARD, View(tilt=(20, -30, 0), noise=8)),
        (CHARUCO_BOARD, View(tilt=(5, 3, 20), middle=(0, 0, 0.9), noise=6)),
    ],
    ids=["blurred", "very blurred", "steep", "noisy", "small"],
)
def test_as_many_pictures_say(board: Board, view: View, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(saddles_module, "FLOOR", 0.0)
    clean = np.asarray(render(board, replace(view, noise=0.0)), dtype=float)
    random = np.random.default_rng(1)
    pixels, sigmas = [], []
    for _ in range(PICTURES):
        image = np.clip(np.rint(clean + view.noise * random.normal(size=clean.shape)), 0, 255)
        found = find_saddles(image, view.corners(board), windows(board, view), corner_signs(board))
        assert found.exist.all()
        pixels.append(found.pixels)
        sigmas.append(found.sigma)
    scatter = np.sqrt(np.var(pixels, axis=0, ddof=1).mean())
    stated = np.sqrt(np.mean(np.square(sigmas)))
    assert stated == pytest.approx(scatter, rel=0.2)


def test_a_speck_beside_a_corner_makes_it_doubtful():
    view = View(tilt=(5, 3, 20), noise=1.0)
    image = np.array(render(CHARUCO_BOARD, view), dtype=float)
    corners = view.corners(CHARUCO_BOARD)
    arguments = (corners, windows(CHARUCO_BOARD, view), corner_signs(CHARUCO_BOARD))
    clean = find_saddles(image, *arguments)
    u, v = np.rint(corners[7]).astype(int)
    image[v + 2 : v + 5, u + 2 : u + 5] = 120.0
    dirty = find_saddles(image, *arguments)
    assert dirty.sigma[7] > 3.0 * clean.sigma[7]
    assert dirty.sigma[8] == clean.sigma[8]
