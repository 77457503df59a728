"""Convergence, singular values and the ladder of models."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.identify.calibration import calibrate
from calib.show.figure_base import styled
from calib.show.figure_fit import (
    candidates_figure,
    convergence_figure,
    singular_values_figure,
    stage_starts,
)


@pytest.fixture(autouse=True)
def _look():
    with styled():
        yield


def test_the_cost_of_each_iteration_is_drawn(calibrations):
    c = calibrations.made("paper")
    figure = convergence_figure(c)
    cost, step, damping = figure.axes
    drawn = next(line for line in cost.lines if line.get_marker() == "o")
    history = c.solution.history
    expected = [one.cost for one in history if one.accepted] + [c.solution.cost]
    np.testing.assert_allclose(drawn.get_ydata(), expected)
    assert [ax.get_ylabel() for ax in (cost, step, damping)] == [
        "cost E",
        "step\n[mm, mrad]",
        "damping μ",
    ]


def test_where_weights_are_set_anew_the_curve_is_broken(calibrations):
    c = calibrations.made("paper")
    starts = stage_starts(c)
    assert starts
    assert all(c.solution.history[k].mu == c.solution.history[0].mu for k in starts)
    # Inside of a stage the cost never rises.
    cost = np.array([one.cost for one in c.solution.history])
    for part in np.split(cost, starts):
        assert np.all(np.diff(part) <= 1e-9 * part[:-1])
    labels = [t.get_text() for t in convergence_figure(c).legends[0].get_texts()]
    assert "weights and noise set anew" in labels


@pytest.mark.parametrize(("solver", "panels"), [("paper", 3), ("scipy", 2)])
def test_other_solvers_have_figures_too_with_the_steps_not_taken(calibrations, solver, panels):
    c = calibrations.made("paper")
    found = calibrate(c.nominal, c.measurements, cell=c.cell, solver=solver, validate=False)
    figure = convergence_figure(found)
    assert len(figure.axes) == panels
    crosses = next(line for line in figure.axes[0].lines if line.get_marker() == "x")
    assert len(crosses.get_ydata()) == sum(not one.accepted for one in found.solution.history)
    cost = np.array([one.cost for one in found.solution.history])
    for part in np.split(cost, stage_starts(found)):
        assert np.all(np.diff(part) <= 1e-5 * part[:-1])


def test_singular_values_tell_the_rank(calibrations):
    c = calibrations.made("paper")
    ax = singular_values_figure(c).axes[0]
    o = c.observability
    seen = next(line for line in ax.lines if line.get_marker() == "o")
    unseen = next(line for line in ax.lines if line.get_marker() == "x")
    np.testing.assert_allclose(seen.get_ydata(), 1e3 * o.singular_values[: o.rank])
    assert len(unseen.get_ydata()) == o.columns - o.rank
    assert np.all(unseen.get_ydata() > ax.get_ylim()[0])  # zeros stand at the foot
    labels = [text.get_text() for text in ax.figure.legends[0].get_texts()]
    assert labels == [
        f"{o.rank} combinations that the poses determine",
        f"{o.columns - o.rank} that move nothing measured",
        f"condition number {o.condition:,.0f}",
    ]


def test_the_ladder_names_every_model_and_marks_the_chosen(calibrations):
    c = calibrations.made("auto")
    figure = candidates_figure(c)
    left, right = figure.axes
    names = [text.get_text() for text in left.get_yticklabels()]
    assert names == [f"{one.name} ({one.parameters})" for one in c.candidates]
    rms = [1e3 * one.cross_validation.errors_without_outliers.rms for one in c.candidates]
    assert sorted(patch.get_width() for patch in left.patches) == pytest.approx(sorted(rms))
    best = max(one.log_likelihood for one in c.candidates)
    gains = [one.log_likelihood - best for one in c.candidates]
    assert sorted(patch.get_width() for patch in right.patches) == pytest.approx(sorted(gains))
    assert {text.get_text() for text in left.texts} == {f"{value:.3f}" for value in rms}
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == ["chosen for the URDF", "not chosen"]


def test_models_of_orientations_alone_are_compared_in_degrees(calibrations):
    c = calibrations.made("auto")
    turned = tuple(
        replace(
            one,
            cross_validation=replace(
                one.cross_validation,
                errors_without_outliers=replace(
                    one.cross_validation.errors_without_outliers, n=0, rms=np.nan, rms_angle=0.01
                ),
            ),
        )
        for one in c.candidates
    )
    left = candidates_figure(replace(c, candidates=turned)).axes[0]
    assert left.get_xlabel() == "rms [deg]"
    assert left.patches[0].get_width() == pytest.approx(np.degrees(0.01))
