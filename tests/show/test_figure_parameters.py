"""Changes of parameters with their intervals, and correlations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.identify.correlations import correlations
from calib.show.figure_base import styled
from calib.show.figure_parameters import (
    changes_figure,
    correlation_indices,
    correlations_figure,
    shown_parameters,
)


@pytest.fixture(autouse=True)
def _look():
    with styled():
        yield


def test_changes_and_intervals_are_those_of_the_result(calibrations):
    c = calibrations.made("paper")
    figure = changes_figure(c)
    assert [ax.get_xlabel() for ax in figure.axes] == [
        "change from nominal [mm]",
        "change from nominal [deg]",
    ]
    scales = {"m": 1e3, "rad": np.degrees(1.0)}
    for ax, unit in zip(figure.axes, scales, strict=True):
        shown = [p for p in c.parameters if p.unit == unit]
        assert [text.get_text() for text in ax.get_yticklabels()] == [p.name for p in shown]
        for p, bar in zip(shown, ax.containers, strict=True):
            dot, _, (interval,) = bar
            assert dot.get_xdata()[0] == pytest.approx(scales[unit] * p.delta)
            ends = interval.get_segments()[0][:, 0]
            half = 0.5 * scales[unit] * (p.high - p.low)
            np.testing.assert_allclose(ends - scales[unit] * p.delta, [-half, half])
            assert (dot.get_markerfacecolor() == "white") == (not p.identifiable)


def test_a_parameter_at_a_bound_has_no_interval(calibrations):
    c = calibrations.made("paper")
    held = replace(c.parameters[0], at_bound=True)
    figure = changes_figure(replace(c, parameters=(held, *c.parameters[1:])))
    dot, _, (interval,) = figure.axes[0].containers[0]
    assert dot.get_marker() == "s"
    assert np.ptp(interval.get_segments()[0][:, 0]) == 0.0
    assert "stopped by a bound" in [t.get_text() for t in figure.legends[0].get_texts()]


def test_frames_and_targets_that_nobody_gave_are_left_out(calibrations):
    names = [p.name for p in shown_parameters(calibrations.made("poses"))]
    assert len(names) == 24
    assert not [name for name in names if name.startswith(("frame", "target"))]


def test_the_larger_models_own_parameters_have_a_panel(calibrations):
    figure = changes_figure(calibrations.made("larger"))
    assert [ax.get_title(loc="left") for ax in figure.axes] == ["Lengths", "Angles", "Compliances"]
    assert figure.axes[2].get_xlabel() == "change from nominal [µrad/Nm]"


def test_squares_are_as_large_as_the_correlations(calibrations):
    c = calibrations.made("paper")
    ax = correlations_figure(c).axes[0]
    positive, negative = ax.collections
    found = {}
    for sign, squares in ((1, positive), (-1, negative)):
        for path in squares.get_paths():
            low, high = path.vertices.min(axis=0), path.vertices.max(axis=0)
            j, i = np.round(0.5 * (low + high)).astype(int)
            found[(j, i)] = sign * ((high[0] - low[0]) / 0.94) ** 2
    names = [c.parameters[k].name for k in correlation_indices(c)]
    strong = correlations(c, 0.5)
    assert strong
    for pair in strong:
        at = names.index(pair.first), names.index(pair.second)
        assert found[at] == pytest.approx(pair.value, abs=1e-9)
    assert all(j < i for j, i in found)
    assert [text.get_text() for text in ax.get_yticklabels()] == names[1:]


def test_what_the_poses_do_not_determine_has_no_correlation(calibrations):
    c = calibrations.made("paper")
    chosen = correlation_indices(c)
    assert [p.identifiable for p in c.parameters].count(True) == len(chosen)
    assert correlation_indices(calibrations.made("three_rows")) == []


def test_names_of_every_kind_stand_at_the_axes(calibrations):
    c = calibrations.made("hostile_names")
    for figure in (changes_figure(c), correlations_figure(c)):
        for ax in figure.axes:
            labels = [text.get_text() for text in ax.get_yticklabels()]
            assert len(set(labels)) == len(labels)
            assert all(len(label) <= 30 for label in labels)
            assert not any(text.get_parse_math() for text in ax.get_yticklabels())
