"""Points in space, and the uncertainty over the workspace."""

from __future__ import annotations

import numpy as np
import pytest

from calib.robot.ranges import spread_poses
from calib.show.plotting import styled
from calib.verbs.calibrate.figure_space import (
    POSES,
    measured_places,
    points,
    uncertainty,
)


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
    figure = points(c)
    views = [ax for ax in figure.axes if ax.name != "3d"]
    for ax, pair in zip(views, [(0, 1), (0, 2), (1, 2)], strict=True):
        marks = dots(ax)
        assert sorted(marks) == ["D", "o", "x"]
        np.testing.assert_allclose(marks["D"], 1e3 * c.fit.measurements.points[30:][:, pair])
        assert sum(map(len, marks.values())) == 35
        low, high = np.array([ax.get_xlim(), ax.get_ylim()]).T
        every = np.concatenate(list(marks.values()))
        assert np.all((every > low) & (every < high))
        assert ax.get_aspect() == 1.0
        assert (ax.get_xlabel(), ax.get_ylabel()) == tuple(f"{'xyz'[k]} [mm]" for k in pair)
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == ["28 estimation rows", "5 validation rows", "2 outliers", "base"]


@pytest.mark.parametrize("case", ["paper", pytest.param("non_geometric", marks=pytest.mark.slow)])
def test_cells_show_the_uncertainty_of_their_poses(calibrations, case):
    c = calibrations.made(case)
    figure = uncertainty(c)
    U = 1e3 * c.uncertainty(spread_poses(c.nominal, POSES), non_geometric=False).position
    for ax in figure.axes[:3]:
        cells = np.asarray(ax.collections[0].get_array())
        assert U.min() <= cells.min() < cells.max() <= U.max()
    share = next(ax for ax in figure.axes if ax.get_ylabel() == "poses below [%]")
    labels = [text.get_text() for text in share.get_legend().get_texts()]
    q = c.fit.measurements.joints_for(c.nominal.joint_names)[c.rows.estimation]
    at_measured = 1e3 * c.uncertainty(q, non_geometric=False).position
    for label, value in zip(
        labels, (np.median(at_measured), np.median(U), np.quantile(U, 0.95)), strict=True
    ):
        assert label.startswith(f"{value:.3f} mm: ")
    x, y = share.lines[0].get_data()
    assert x[np.searchsorted(y, 0.5)] == pytest.approx(np.median(U), rel=0.02)


def test_places_are_in_the_base(calibrations):
    c = calibrations.made("paper")
    np.testing.assert_allclose(measured_places(c), c.fit.measurements.points)
    # Measured in a tracker's frame: the calibrated robot is where it was measured, but for its errors.
    tracker = calibrations.made("poses")
    places = measured_places(tracker)
    T = tracker.robot.poses(tracker.fit.measurements.joints)
    expected = T[:, :3, :3] @ tracker.target + T[:, :3, 3]
    np.testing.assert_allclose(places, expected, atol=2e-4)
    assert np.abs(places - tracker.fit.measurements.points).max() > 0.5


def test_places_that_nobody_measured_are_predicted(calibrations):
    c = calibrations.made("distances")
    T = c.robot.poses(c.fit.measurements.joints)
    np.testing.assert_allclose(measured_places(c), T[:, :3, :3] @ c.target + T[:, :3, 3])
