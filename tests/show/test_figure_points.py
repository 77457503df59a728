"""Points in space and the uncertainty over the workspace."""

from __future__ import annotations

import numpy as np
import pytest

from calib.identify.uncertainty import workspace_uncertainty
from calib.model.readback import SPREAD
from calib.show.figure_base import styled
from calib.show.figure_points import MOST_POINTS, POSES, points_figure, uncertainty_figure


@pytest.fixture(autouse=True)
def _look():
    with styled():
        yield


def dots(ax):
    """Places of all markers but the base's."""
    return {
        line.get_marker(): np.stack(line.get_data(), axis=1)
        for line in ax.lines
        if line.get_marker() != "+"
    }


def test_the_papers_figure_7_shows_every_point_from_three_sides(calibrations):
    c = calibrations.made("paper")
    figure = points_figure(c)
    assert figure.axes[0].name == "3d"
    scales = [
        np.ptp(limits) / (size * inches)
        for ax in figure.axes[1:]
        for limits, size, inches in zip(
            (ax.get_xlim(), ax.get_ylim()),
            ax.get_position().size,
            figure.get_size_inches(),
            strict=True,
        )
    ]
    np.testing.assert_allclose(scales, scales[0])  # millimetres of the cell for an inch of paper
    for ax, pair in zip(figure.axes[1:], [(0, 1), (0, 2), (1, 2)], strict=True):
        found = dots(ax)
        assert sorted(found) == ["D", "o", "x"]
        np.testing.assert_allclose(found["D"], 1e3 * c.measurements.points[30:][:, pair])
        assert sum(map(len, found.values())) == 35
        low, high = np.array([ax.get_xlim(), ax.get_ylim()]).T
        every = np.concatenate(list(found.values()))
        assert np.all((every > low) & (every < high))
        assert ax.get_aspect() == 1.0
        assert (ax.get_xlabel(), ax.get_ylabel()) == tuple(f"{'xyz'[k]} [mm]" for k in pair)
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == ["28 estimation rows", "5 validation rows", "2 outliers", "base"]


def test_a_base_that_is_not_shown_is_not_in_the_legend(calibrations):
    figure = points_figure(calibrations.made("one_row"))
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["1 estimation row"]


def test_a_flat_cloud_has_some_height(calibrations):
    figure = points_figure(calibrations.made("two_joints"))
    assert np.ptp(figure.axes[2].get_ylim()) > 0.2 * np.ptp(figure.axes[2].get_xlim())


def test_points_that_were_not_measured_are_said_to_be_predicted(calibrations):
    figure = points_figure(calibrations.made("distances"))
    assert figure.get_supxlabel().startswith("All rows measure no position")
    assert points_figure(calibrations.made("mixed")).get_supxlabel() == ""


def test_many_rows_are_thinned_but_not_the_outliers(calibrations):
    c = calibrations.many_rows(6000)
    found = dots(points_figure(c).axes[1])
    assert len(found["x"]) == len(c.outliers) + len(c.suspects) > 0
    assert len(found["o"]) + len(found["D"]) <= MOST_POINTS
    assert len(found["o"]) / len(found["D"]) == pytest.approx(9.0, abs=0.1)


@pytest.mark.parametrize("case", ["paper", "larger"])
def test_cells_show_the_uncertainty_of_their_poses(calibrations, case):
    c = calibrations.made(case)
    figure = uncertainty_figure(c)
    std = 1e3 * workspace_uncertainty(c, POSES, larger=False).std
    for ax in figure.axes[:3]:
        cells = np.asarray(ax.collections[0].get_array())
        assert std.min() <= cells.min() < cells.max() <= std.max()
    share = next(ax for ax in figure.axes if ax.get_ylabel() == "poses below [%]")
    labels = [text.get_text() for text in share.get_legend().get_texts()]
    # The report's numbers, in its digits.
    assert labels[0] == f"{1e3 * c.expected_measured:.3f} mm: rms, measured poses"
    assert labels[1] == f"{1e3 * c.expected_everywhere:.3f} mm: rms, joint limits"
    assert np.sqrt(np.mean(std[:SPREAD] ** 2)) == pytest.approx(1e3 * c.expected_everywhere)
    x, y = share.lines[0].get_data()
    assert np.all(np.diff(x) >= 0.0)
    assert y[-1] == 100.0
    assert x[np.searchsorted(y, 50.0)] == pytest.approx(np.median(std), rel=0.02)
