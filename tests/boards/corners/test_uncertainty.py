"""The standard deviation of a corner is that of many pictures which differ in their noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calib.boards.corners.uncertainty as uncertainty_module
from calib.boards.board import Board, corner_signs
from calib.boards.corners.saddles import find_saddles
from tests.boards.board_views import CHARUCO_BOARD, CHESS_BOARD, View, render
from tests.boards.corners.test_saddles import windows

PICTURES = 12


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
    monkeypatch.setattr(uncertainty_module, "FLOOR", 0.0)
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
