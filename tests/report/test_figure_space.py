"""Points in space, the uncertainty over the workspace, and what is left over along each joint's motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.report.figure_base import styled
from calib.report.figure_space import (
    MOST_ROWS,
    POSES,
    along_joints,
    drawn_rows,
    joints,
    points,
    uncertainty,
)
from calib.result.uncertainty import workspace_uncertainty
from calib.robot.readback import SPREAD


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


def test_points_of_many_rows_are_thinned(calibrations):
    c = calibrations.many_rows(6000)
    found = dots(points(c).axes[1])
    assert len(found["x"]) == len(c.outliers) + len(c.suspects) > 0
    assert all(len(places) <= MOST_ROWS for places in found.values())


@pytest.mark.parametrize("case", ["paper", "larger"])
def test_cells_show_the_uncertainty_of_their_poses(calibrations, case):
    c = calibrations.made(case)
    figure = uncertainty(c)
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


def every(c):
    return np.ones(len(c.measurements), dtype=bool)


def with_residual(c, residual):
    return replace(c, residual_calibrated=residual)


@pytest.mark.parametrize("j", range(6))
def test_an_error_of_a_joint_stands_in_its_own_panel_in_full(calibrations, j):
    """If a joint turned 0.1 mrad too far, what is left over is all along its motion."""
    c = calibrations.made("paper")
    q = c.measurements.joints_for(c.nominal.joint_names)
    off = c.predict(q + 1e-4 * np.eye(6)[j]) - c.predict(q)
    parts = along_joints(with_residual(c, off), every(c))
    np.testing.assert_allclose(parts[:, j], np.linalg.norm(off, axis=1), rtol=1e-3)
    sizes = np.linalg.norm(off, axis=1)[:, None]
    assert np.all(np.abs(parts) <= sizes * (1 + 1e-6))


def test_of_a_distance_all_is_along_the_beam(calibrations):
    c = calibrations.made("distances")
    parts = along_joints(c, every(c))
    sizes = np.abs(c.residual_calibrated[:, 0])
    there = np.isfinite(parts[:, 1])
    np.testing.assert_allclose(np.abs(parts[there, 1]), sizes[there])


def test_of_a_plane_all_is_along_its_normal(calibrations):
    c = calibrations.made("distances")
    kinds = ("plane",) * len(c.measurements)
    plane = calibrations.with_rows(c, replace(c.measurements, kinds=kinds))
    q = c.measurements.joints_for(c.nominal.joint_names)
    anchor = c.measurements.groups[0]
    up = c.predict(q + 1e-5 * np.eye(6)[1], group=anchor) - c.predict(q, group=anchor)
    expected = np.sign(up[:, 2]) * c.residual_calibrated[:, 0]
    np.testing.assert_allclose(along_joints(plane, every(c))[:, 1], expected)


def test_a_joint_that_does_not_move_the_target_has_no_part(calibrations):
    """The target on the last axis."""
    c = calibrations.made("paper")
    on_axis = np.array(c.setup.T_tip_target)
    on_axis[:, :2, 3] = 0.0
    moved = replace(c, robot=c.nominal, setup=replace(c.setup, T_tip_target=on_axis))
    parts = along_joints(moved, every(c))
    assert np.all(np.isnan(parts[:, 5]))
    assert np.all(np.isfinite(parts[:, 0]))
    words = [text.get_text() for text in joints(moved).axes[5].texts]
    assert words == ["does not move the target"]


def test_panels_are_of_the_joints_in_their_units(calibrations):
    figure = joints(calibrations.made("prismatic"))
    labels = [ax.get_xlabel() for ax in figure.axes]
    assert labels == ["joint value [mm]"] * 3 + ["joint value [deg]"]
    assert [ax.get_title(loc="left") for ax in figure.axes] == [
        "slide_x",
        "slide_y",
        "slide_z",
        "turn",
    ]


def test_outliers_do_not_set_the_scale_and_stand_at_its_edge(calibrations):
    c = calibrations.made("with_outliers")
    ax = joints(c).axes[0]
    assert ax.get_ylim()[1] < 0.3
    crosses = next(line for line in ax.lines if line.get_marker() == "x")
    assert len(crosses.get_ydata()) == len(c.outliers) + len(c.suspects)
    assert np.all(np.abs(crosses.get_ydata()) < ax.get_ylim()[1])


def test_the_mean_is_that_of_the_estimation_rows_without_outliers(calibrations):
    c = calibrations.made("paper")
    figure = joints(c)
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels[-1] == "mean of the estimation rows ± 2 standard errors"
    # Wherever a row for validation or an outlier lies, the band is the same.
    moved = c.residual_calibrated.copy()
    moved[[10, 13, *range(30, 35)]] += 0.1
    bands = [
        joints(one).axes[0].collections[-1].get_paths()[0].vertices
        for one in (c, with_residual(c, moved))
    ]
    np.testing.assert_array_equal(*bands)
    few = joints(calibrations.made("two_joints"))  # 20 rows to estimate, 25 in all
    assert not few.axes[0].collections


def test_many_rows_are_thinned_but_not_the_outliers(calibrations):
    c = calibrations.many_rows(6000)
    chosen = drawn_rows(c)
    assert np.count_nonzero(chosen) <= MOST_ROWS + len(c.outliers) + len(c.suspects)
    rows = set(np.array(c.measurements.rows)[chosen])
    assert {one.row for one in c.outliers} <= rows
