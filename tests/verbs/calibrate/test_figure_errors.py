"""Errors before and after in figures are the residuals, of the rows that they name."""

from __future__ import annotations

import numpy as np
import pytest

from calib.show.plotting import styled
from calib.verbs.calibrate.figure_errors import (
    by_axis,
    by_row,
    curve_rows,
    curves,
    histograms,
    scaled_residuals,
)


@pytest.fixture(autouse=True)
def _look():
    with styled():
        yield


def lines(ax):
    """The curves with numbers in them, by colour."""
    curves = [line for line in ax.lines if len(line.get_ydata()) > 2]
    return {line.get_color(): np.asarray(line.get_ydata(), float) for line in curves}


def test_the_papers_figure_8_shows_the_validation_rows(calibrations):
    c = calibrations.made("paper")
    figure = curves(c)
    v = c.fit.measurements.validation
    for k, ax in enumerate(figure.axes[:3]):
        before, after = lines(ax).values()
        np.testing.assert_allclose(before, 1e3 * c.rows.residual_nominal[v, k])
        np.testing.assert_allclose(after, 1e3 * c.rows.residual_calibrated[v, k])
        assert ax.get_title(loc="left") == f"Δ{'xyz'[k]}"
    assert len({ax.get_ylim() for ax in figure.axes[:3]}) == 1
    _, after = lines(figure.axes[3]).values()
    assert after.max() == pytest.approx(1e3 * c.errors["calibrated"]["validation"]["m"].max)
    styles = {line.get_linestyle() for line in figure.axes[3].lines}
    assert styles == {"--", "-"}  # distinguished without colours
    assert figure.axes[3].get_xlabel() == "validation row"


def test_without_validation_rows_held_out_ones_are_shown_else_estimation_rows(calibrations):
    c = calibrations.made("three_rows")
    name, mask, before, after = curve_rows(c)
    assert (name, int(mask.sum())) == ("held-out", 3)
    np.testing.assert_array_equal(after[mask], c.cross_validation.residual)
    np.testing.assert_array_equal(before[mask], c.trust.nominal_cross_validation.residual)
    name, mask, before, after = curve_rows(calibrations.made("one_row"))
    assert name == "estimation"
    np.testing.assert_array_equal(before, calibrations.made("one_row").rows.residual_nominal)


def test_lengths_have_one_panel_and_their_signs(calibrations):
    c = calibrations.made("distances")
    figure = curves(c)
    assert len(figure.axes) == 1
    before, after = lines(figure.axes[0]).values()
    v = c.fit.measurements.validation
    np.testing.assert_allclose(before, 1e3 * c.rows.residual_nominal[v, 0])
    np.testing.assert_allclose(after, 1e3 * c.rows.residual_calibrated[v, 0])
    assert before.min() < 0.0 < before.max()
    low, high = figure.axes[0].get_ylim()
    assert low < before.min() < before.max() < high


def test_dashes_are_the_held_out_errors(calibrations):
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
    upper, upper_right, lower, _ = figure.axes
    assert upper.get_title(loc="left") == "30 estimation rows"
    assert upper_right.get_title(loc="left") == "5 validation rows"
    assert lower.get_title(loc="left") == "After, without outliers"
    boxes = [patch.get_path().vertices for patch in upper.patches]
    assert len(boxes) == 6
    for k in range(3):
        low, high = np.quantile(1e3 * c.rows.residual_nominal[:30, k], [0.25, 0.75])
        np.testing.assert_allclose([boxes[k][:, 1].min(), boxes[k][:, 1].max()], [low, high])


def test_every_row_is_in_the_histogram(calibrations):
    for name in ("paper", "distances", "one_row"):
        c = calibrations.made(name)
        left, right = histograms(c).axes
        for patch in left.patches:
            y = patch.get_xy()[:, 1]  # up and down along the tops, then back along the foot
            assert y[1 : len(y) // 2 : 2].sum() == len(c.fit.measurements)
        assert (
            right.get_title(loc="left") == f"{len(scaled_residuals(c))} scalars of estimation rows"
        )


def test_residuals_are_over_their_noise(calibrations):
    values = scaled_residuals(calibrations.many_rows(6000))
    assert len(values) == 3 * 5400
    inside = values[np.abs(values) < 5.0]
    assert abs(np.std(inside) - 1.0) < 0.05
    figure = histograms(calibrations.many_rows(6000))
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels[2:] == ["normal", f"{len(values) - len(inside)} beyond ±5"]
