"""How errors spread: boxes and histograms of the residuals."""

from __future__ import annotations

import numpy as np
import pytest

from calib.show.figure_base import styled
from calib.show.figure_spread import by_axis_figure, histogram_figure, left_over


@pytest.fixture(autouse=True)
def _look():
    with styled():
        yield


def test_boxes_are_of_the_rows(calibrations):
    c = calibrations.made("paper")
    figure = by_axis_figure(c)
    upper, other, lower, _ = figure.axes
    assert upper.get_title(loc="left") == "30 estimation rows"
    assert other.get_title(loc="left") == "5 validation rows"
    assert lower.get_title(loc="left") == "After, without outliers"
    boxes = [patch.get_path().vertices for patch in upper.patches]
    assert len(boxes) == 6
    for k in range(3):
        low, high = np.quantile(1e3 * c.residual_nominal[:30, k], [0.25, 0.75])
        np.testing.assert_allclose([boxes[k][:, 1].min(), boxes[k][:, 1].max()], [low, high])
    dots = np.concatenate([line.get_ydata() for line in lower.lines if line.get_marker() == "o"])
    assert len(dots) == 3 * 28
    assert np.abs(dots).max() < lower.get_ylim()[1]


def test_few_rows_are_dots_and_no_boxes(calibrations):
    figure = by_axis_figure(calibrations.made("three_rows"))
    assert [len(ax.patches) for ax in figure.axes] == [0, 0]


def test_orientations_are_in_degrees(calibrations):
    c = calibrations.made("mixed")
    figure = by_axis_figure(c, angle=True)
    count = int(np.sum(c.measurements.of_kind("pose")))
    assert figure.axes[0].get_title(loc="left") == f"{count} estimation rows"
    assert figure.axes[0].get_ylabel() == "error about the axis [deg]"


def test_every_row_is_in_the_histogram(calibrations):
    for name in ("paper", "distances", "with_outliers", "one_row"):
        c = calibrations.made(name)
        left, right = histogram_figure(c).axes
        for patch in left.patches:
            y = patch.get_xy()[:, 1]  # up and down along the tops, then back along the foot
            assert y[1 : len(y) // 2 : 2].sum() == len(c.measurements)
        assert right.get_title(loc="left") == f"{len(left_over(c))} numbers of estimation rows"


def test_what_is_left_over_is_measured_in_its_noise(calibrations):
    values = left_over(calibrations.many_rows(6000))
    assert len(values) == 3 * 5400
    inside = values[np.abs(values) < 5.0]
    assert abs(np.std(inside) - 1.0) < 0.05
    figure = histogram_figure(calibrations.many_rows(6000))
    labels = [text.get_text() for text in figure.axes[1].get_legend().get_texts()]
    assert labels == ["normal", f"{len(values) - len(inside)} beyond ±5"]
