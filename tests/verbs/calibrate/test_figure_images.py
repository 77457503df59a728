"""Figures of image residuals: means over cells, images, corners of boards, and what the figures draw of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.quiver import Quiver

from calib.show.plotting import styled
from calib.verbs.calibrate.figure_images import (
    board_corners,
    by_image,
    cell_means,
    corner_errors,
    image_rms,
    over_image,
)
from calib.verbs.calibrate.seen_corners import seen_corners
from tests.verbs.calibrate.seen import by_images, corners


@pytest.fixture(autouse=True)
def _look():
    with styled():
        yield


def arrows(ax):
    """What the arrows of a panel stand for, shape (n, 2)."""
    return [
        np.column_stack([drawn.U, drawn.V]) for drawn in ax.collections if isinstance(drawn, Quiver)
    ]


def test_each_image_counts_once_in_a_cell():
    """Cells are 100 px wide: in the first, one image has two corners; in the second there are two images only."""
    measured = [[10, 10], [20, 20], [30, 30], [40, 40], [110, 10], [120, 20]]
    residual = [[1.0, 0.0], [3.0, 0.0], [2.2, 0.0], [1.8, 0.0], [1.0, 1.0], [1.0, 1.0]]
    seen = corners(residual, measured=measured, images=("a", "a", "b", "c", "a", "b"))
    centres, means, is_clear = cell_means(seen)
    np.testing.assert_allclose(centres, [[25.0, 25.0]])
    np.testing.assert_allclose(means, [[2.0, 0.0]])
    assert is_clear.tolist() == [True]
    flagged = replace(seen, flagged=np.arange(6) == 3)
    assert [len(values) for values in cell_means(flagged)] == [0, 0, 0]


@pytest.mark.parametrize(("shift", "clear"), [(0.5, False), (2.0, True)])
def test_a_mean_is_clear_beyond_three_standard_errors(shift, clear):
    """Of three images with the standard deviation 1: 3 / sqrt(3) = 1.73."""
    residual = np.array([[-1.0, 0.0], [0.0, 0.0], [1.0, 0.0]]) + np.array([shift, 0.0])
    _, means, is_clear = cell_means(corners(residual, images=("a", "b", "c")))
    np.testing.assert_allclose(means, [[shift, 0.0]])
    assert is_clear.tolist() == [clear]


def test_the_rms_of_an_image_is_over_the_lengths_of_its_residuals():
    residual = np.array([[3.0, 4.0], [0.0, 0.0], [np.nan, np.nan]])
    images = {"a": np.array([0, 1]), "b": np.array([2])}
    np.testing.assert_allclose(image_rms(images, residual), [np.sqrt(12.5), np.nan])


def test_errors_of_corners_are_beyond_a_shift_of_the_whole_print():
    seen = corners(
        [[2.0, 0.0], [0.0, 4.0], [9.0, 9.0], [np.pi, np.pi]],
        printed=np.array([[1e-4, 0, 0], [0.03 - 1e-4, 0, 2e-4], [0.06, 0, 0], [0, 0.03, 0]]),
        flagged=np.array([False, False, True, False]),
    )
    seen = replace(seen, boards=("sheet", "sheet", "sheet", "other"))
    places, printed, residual = corner_errors([seen], "sheet")
    np.testing.assert_allclose(places, [[0, 0], [0.03, 0], [0.06, 0]])
    np.testing.assert_allclose(printed, [[1e-4, 0, 0], [-1e-4, 0, 2e-4], [0, 0, 0]], atol=1e-12)
    np.testing.assert_allclose(residual, [[1e-3, 0], [0, 2e-3], [np.nan, np.nan]], atol=1e-12)


def test_arrows_over_the_image_are_the_residuals_of_the_calibrated_robot():
    c = by_images()
    (seen,) = seen_corners(c)
    upper, lower, *_ = over_image(c).axes
    (drawn,) = arrows(upper)
    np.testing.assert_allclose(drawn, seen.calibrated)
    _, means, _ = cell_means(seen)
    drawn = np.concatenate(arrows(lower))
    np.testing.assert_allclose(np.sort(drawn, axis=0), np.sort(means, axis=0))
    assert (upper.get_xlim(), upper.get_ylim()) == ((-0.5, 2399.5), (1999.5, -0.5))


def test_bars_are_images_and_dashes_their_held_out_residuals():
    c = by_images()
    (seen,) = seen_corners(c)
    (ax,) = by_image(c).axes
    np.testing.assert_allclose(
        [bar.get_height() for bar in ax.patches], image_rms(seen.by_image, seen.calibrated)
    )
    np.testing.assert_allclose(ax.lines[0].get_ydata(), image_rms(seen.by_image, seen.held_out))
    assert [label.get_text() for label in ax.get_xticklabels()] == list(seen.by_image)


def test_a_board_is_drawn_as_seen_from_its_front_in_millimetres():
    c = by_images()
    places, printed, residual = corner_errors(seen_corners(c), "sheet")
    left, right, *_ = board_corners(c).axes
    np.testing.assert_allclose(arrows(left)[0], 1e3 * printed[:, :2], atol=1e-9)
    np.testing.assert_allclose(arrows(right)[0], 1e3 * residual, atol=1e-9)
    assert left.get_ylim()[0] > 1e3 * places[:, 1].max() > left.get_ylim()[1]  # y down
