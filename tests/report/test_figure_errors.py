"""Errors before and after in figures are the residuals, of the rows that they name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.report.figure_base import styled
from calib.report.figure_errors import (
    along_joints,
    by_axis,
    by_row,
    curve_rows,
    curves,
    histograms,
    joints,
    scaled_residuals,
)


@pytest.fixture(autouse=True)
def _look():
    with styled():
        yield


def lines(ax):
    """The curves with numbers in them, by colour."""
    found = [line for line in ax.lines if len(line.get_ydata()) > 2]
    return {line.get_color(): np.asarray(line.get_ydata(), float) for line in found}


def test_the_papers_figure_8_shows_the_validation_rows(calibrations):
    c = calibrations.made("paper")
    figure = curves(c)
    v = c.measurements.validation
    for k, ax in enumerate(figure.axes[:3]):
        before, after = lines(ax).values()
        np.testing.assert_allclose(before, 1e3 * c.residual_nominal[v, k])
        np.testing.assert_allclose(after, 1e3 * c.residual_calibrated[v, k])
        assert ax.get_title(loc="left") == f"Δ{'xyz'[k]}"
    assert len({ax.get_ylim() for ax in figure.axes[:3]}) == 1
    _, after = lines(figure.axes[3]).values()
    assert after.max() == pytest.approx(1e3 * c.errors["calibrated"]["validation"].max)
    styles = {line.get_linestyle() for line in figure.axes[3].lines}
    assert styles == {"--", "-"}  # told apart without colours
    assert figure.axes[3].get_xlabel() == "validation row"


def test_without_validation_rows_left_out_ones_are_shown_then_estimation_rows(calibrations):
    c = calibrations.made("three_rows")
    word, mask, before, after = curve_rows(c)
    assert (word, int(mask.sum())) == ("held-out", 3)
    np.testing.assert_array_equal(after[mask], c.cross_validation.residual)
    np.testing.assert_array_equal(before[mask], c.nominal_cross_validation.residual)
    word, mask, before, after = curve_rows(calibrations.made("one_row"))
    assert word == "estimation"
    np.testing.assert_array_equal(before, calibrations.made("one_row").residual_nominal)


def test_lengths_have_one_panel_and_their_signs(calibrations):
    c = calibrations.made("distances")
    figure = curves(c)
    assert len(figure.axes) == 1
    before, after = lines(figure.axes[0]).values()
    v = c.measurements.validation
    np.testing.assert_allclose(before, 1e3 * c.residual_nominal[v, 0])
    np.testing.assert_allclose(after, 1e3 * c.residual_calibrated[v, 0])
    assert before.min() < 0.0 < before.max()
    low, high = figure.axes[0].get_ylim()
    assert low < before.min() < before.max() < high


def test_by_pose_shows_what_left_out_rows_show(calibrations):
    c = calibrations.made("paper")
    _, below = by_row(c).axes
    dashes = next(line for line in below.lines if line.get_marker() == "_")
    shown = np.asarray(dashes.get_ydata(), float)
    expected = 1e3 * np.linalg.norm(c.cross_validation.residual, axis=1)
    good = ~np.isin(np.arange(1, 31), [11, 14])  # the outliers
    np.testing.assert_allclose(shown[:30][good], expected[good])
    assert np.all(np.isnan(shown[:30][~good]))
    assert np.all(np.isnan(shown[30:]))


def test_boxes_are_of_the_rows(calibrations):
    c = calibrations.made("paper")
    figure = by_axis(c)
    upper, other, lower, _ = figure.axes
    assert upper.get_title(loc="left") == "30 estimation rows"
    assert other.get_title(loc="left") == "5 validation rows"
    assert lower.get_title(loc="left") == "After, without outliers"
    boxes = [patch.get_path().vertices for patch in upper.patches]
    assert len(boxes) == 6
    for k in range(3):
        low, high = np.quantile(1e3 * c.residual_nominal[:30, k], [0.25, 0.75])
        np.testing.assert_allclose([boxes[k][:, 1].min(), boxes[k][:, 1].max()], [low, high])


def test_every_row_is_in_the_histogram(calibrations):
    for name in ("paper", "distances", "one_row"):
        c = calibrations.made(name)
        left, right = histograms(c).axes
        for patch in left.patches:
            y = patch.get_xy()[:, 1]  # up and down along the tops, then back along the foot
            assert y[1 : len(y) // 2 : 2].sum() == len(c.measurements)
        assert (
            right.get_title(loc="left") == f"{len(scaled_residuals(c))} numbers of estimation rows"
        )


def test_what_is_left_over_is_measured_in_its_noise(calibrations):
    values = scaled_residuals(calibrations.many_rows(6000))
    assert len(values) == 3 * 5400
    inside = values[np.abs(values) < 5.0]
    assert abs(np.std(inside) - 1.0) < 0.05
    figure = histograms(calibrations.many_rows(6000))
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels[2:] == ["normal", f"{len(values) - len(inside)} beyond ±5"]


def with_residual(c, residual):
    return replace(c, residual_calibrated=residual)


@pytest.mark.parametrize("j", [0, 2, 5])
def test_an_error_of_a_joint_stands_in_its_own_panel_in_full(calibrations, j):
    """If a joint turned 0.1 mrad too far, what is left over is all along its motion."""
    c = calibrations.made("paper")
    q = c.measurements.joints_for(c.nominal.joint_names)
    off = c.predict(q + 1e-4 * np.eye(6)[j]) - c.predict(q)
    parts = along_joints(with_residual(c, off))
    np.testing.assert_allclose(parts[:, j], np.linalg.norm(off, axis=1), rtol=1e-3)
    prior_std = np.linalg.norm(off, axis=1)[:, None]
    assert np.all(np.abs(parts) <= prior_std * (1 + 1e-6))


def test_of_a_distance_all_is_along_the_beam(calibrations):
    c = calibrations.made("distances")
    parts = along_joints(c)
    prior_std = np.abs(c.residual_calibrated[:, 0])
    there = np.isfinite(parts[:, 1])
    np.testing.assert_allclose(np.abs(parts[there, 1]), prior_std[there])


def test_a_joint_that_does_not_move_the_target_has_no_part(calibrations):
    """The target on the last axis."""
    c = calibrations.made("paper")
    on_axis = np.array(c.setup.T_tip_target)
    on_axis[:, :2, 3] = 0.0
    moved = replace(c, robot=c.nominal, setup=replace(c.setup, T_tip_target=on_axis))
    parts = along_joints(moved)
    assert np.all(np.isnan(parts[:, 5]))
    assert np.all(np.isfinite(parts[:, 0]))


def test_the_mean_is_that_of_the_estimation_rows_without_outliers(calibrations):
    c = calibrations.made("paper")
    # Wherever a row for validation or an outlier lies, the band is the same.
    moved = c.residual_calibrated.copy()
    moved[[10, 13, *range(30, 35)]] += 0.1
    bands = [
        joints(one).axes[0].collections[-1].get_paths()[0].vertices
        for one in (c, with_residual(c, moved))
    ]
    np.testing.assert_array_equal(*bands)
