"""Corners of tags by their edges: where they are, however blurred, and how well."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.boards.corners.markers import find_markers
from calib.boards.corners.tags import tag_corners
from tests.boards.board_views import TAG_BOARD, View, render


def true_corners(view: View, ids: np.ndarray) -> np.ndarray:
    return view.corners(TAG_BOARD).reshape(-1, 4, 2)[ids]


@pytest.mark.parametrize(
    "view",
    [
        View(tilt=(10, 5, 20), middle=(0, 0, 0.4), noise=1),
        View(tilt=(10, 5, 20), middle=(0, 0, 0.4), noise=1, blur=1.6),
        View(tilt=(0, 60, 20), middle=(0, 0, 0.4), noise=1),
    ],
    ids=["sharp", "blurred", "steep"],
)
def test_corners_are_not_rounded_inwards(view: View):
    image = render(TAG_BOARD, view)
    markers = find_markers(image, TAG_BOARD.dictionary)
    assert len(markers.ids) == 12
    found = tag_corners(np.asarray(image, dtype=float), markers.corners)
    true = true_corners(view, markers.ids)
    error = found.pixels.reshape(-1, 4, 2) - true
    assert np.sqrt(np.mean(np.sum(error**2, axis=-1))) < 0.08
    inwards = true.mean(axis=1, keepdims=True) - true
    inwards /= np.linalg.norm(inwards, axis=-1, keepdims=True)
    assert abs(np.mean(np.sum(error * inwards, axis=-1))) < 0.025


def test_the_uncertainty_is_that_of_many_pictures():
    view = View(tilt=(10, 5, 20), middle=(0, 0, 0.4), noise=6, blur=0.8)
    clean = np.asarray(render(TAG_BOARD, replace(view, noise=0)), dtype=float)
    true = true_corners(view, np.arange(12))
    random = np.random.default_rng(0)
    pixels, sigmas = [], []
    for _ in range(8):
        noisy = clean + view.noise * random.normal(size=clean.shape)
        found = tag_corners(noisy, true)
        pixels.append(found.pixels)
        sigmas.append(found.sigma)
    scatter = np.sqrt(np.var(pixels, axis=0, ddof=1).mean())
    assert np.sqrt(np.mean(np.square(sigmas))) == pytest.approx(scatter, rel=0.3)


def test_no_edge_is_no_corner():
    square = np.array([[[20.0, 20.0], [60.0, 20.0], [60.0, 60.0], [20.0, 60.0]]])
    assert not tag_corners(np.full((80, 80), 90.0), square).exist.any()
    small = square / 10.0
    assert not tag_corners(np.full((80, 80), 90.0), small).exist.any()
