"""Parameters and the fit in figures: changes, correlations, convergence, singular values, models tried."""

from __future__ import annotations

import numpy as np
import pytest

from calib.result.calibrate import calibrate
from calib.show.plotting import styled
from calib.verbs.calibrate.figure_model import (
    candidates,
    changed_parameters,
    changes,
    convergence,
    correlation_indices,
    correlations,
    singular_values,
)


@pytest.fixture(autouse=True)
def _look():
    with styled():
        yield


def test_changes_and_intervals_are_those_of_the_result(calibrations):
    c = calibrations.made("paper")
    figure = changes(c)
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


def test_frames_and_targets_that_were_not_given_are_not_shown(calibrations):
    names = [p.name for p in changed_parameters(calibrations.made("poses"))]
    assert len(names) == 24
    assert not [name for name in names if name.startswith(("frame", "target"))]


def test_cells_have_the_correlation_of_their_pair(calibrations):
    c = calibrations.made("paper")
    ax = correlations(c).axes[0]
    shown = ax.images[0].get_array()
    names = [c.parameters[k].name for k in correlation_indices(c)]
    C = c.covariance[np.ix_(*[correlation_indices(c)] * 2)]
    R = C / np.sqrt(np.outer(np.diag(C), np.diag(C)))
    for i, j in zip(*np.tril_indices(len(names), -1), strict=True):
        assert shown[i - 1, j] == pytest.approx(R[i, j], abs=1e-9)
    assert shown.count() == len(names) * (len(names) - 1) / 2
    assert [text.get_text() for text in ax.get_yticklabels()] == names[1:]


def test_the_cost_of_each_iteration_is_drawn(calibrations):
    c = calibrations.made("paper")
    figure = convergence(c)
    panels = figure.axes
    drawn = next(line for line in panels[0].lines if line.get_marker() == "o")
    history = c.method.solution.history
    expected = [step.cost for step in history if step.accepted] + [c.method.solution.cost]
    np.testing.assert_allclose(drawn.get_ydata(), expected)
    assert [ax.get_ylabel() for ax in panels] == [
        "cost E",
        "step\n[mm, mrad]",
        "damping μ",
    ]


@pytest.mark.parametrize(("solver", "panels"), [("paper", 3), ("scipy", 2)])
def test_other_solvers_have_figures_too_with_the_steps_not_taken(calibrations, solver, panels):
    c = calibrations.made("paper")
    solved = calibrate(
        c.nominal, c.fit.measurements, cell=c.fit.cell, solver=solver, validate=False
    )
    figure = convergence(solved)
    assert len(figure.axes) == panels
    crosses = next(line for line in figure.axes[0].lines if line.get_marker() == "x")
    assert len(crosses.get_ydata()) == sum(
        not step.accepted for step in solved.method.solution.history
    )


def test_singular_values_tell_the_rank(calibrations):
    c = calibrations.made("paper")
    ax = singular_values(c).axes[0]
    o = c.trust.observability
    determined = next(line for line in ax.lines if line.get_marker() == "o")
    unobservable = next(line for line in ax.lines if line.get_marker() == "x")
    np.testing.assert_allclose(determined.get_ydata(), 1e3 * o.singular_values[: o.rank])
    assert len(unobservable.get_ydata()) == o.columns - o.rank
    assert np.all(unobservable.get_ydata() > ax.get_ylim()[0])  # zeros stand at the foot
    labels = [text.get_text() for text in ax.figure.legends[0].get_texts()]
    assert labels == [
        f"{o.rank} identifiable combinations",
        f"{o.columns - o.rank} unobservable combinations",
        f"condition number {o.condition:,.0f}",
    ]


@pytest.mark.slow
def test_the_ladder_names_every_model_and_marks_the_chosen(calibrations):
    c = calibrations.made("auto")
    figure = candidates(c)
    left, right = figure.axes
    names = [text.get_text() for text in left.get_yticklabels()]
    assert names == [f"{one.name} ({one.parameters})" for one in c.method.candidates]
    rms = [
        1e3 * one.cross_validation.errors_without_outliers["m"].rms for one in c.method.candidates
    ]
    assert sorted(patch.get_width() for patch in left.patches) == pytest.approx(sorted(rms))
    best = max(one.evidence for one in c.method.candidates)
    gains = [one.evidence - best for one in c.method.candidates]
    assert sorted(patch.get_width() for patch in right.patches) == pytest.approx(sorted(gains))
    assert {text.get_text() for text in left.texts} == {f"{value:.3f}" for value in rms}
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == ["chosen for the URDF", "not chosen"]
