"""Figures of the model and its fit: parameters, correlations, convergence, singular values, models tried."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

import calib.verbs.calibrate.text as texts
from calib.basics.arrays import Array
from calib.basics.channels import RESIDUAL_UNITS
from calib.model.families import unit_of
from calib.numerics.solvers import has_weights_and_priors
from calib.result.calibration import Calibration
from calib.result.fitted_model import ParameterEstimate
from calib.show.look import CALIBRATED, INK, NOMINAL, OUTLIER, SOFT, short_names
from calib.show.plotting import WIDTH, few_ticks, legend_above, log_axis, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Title of the panel of the parameters of each unit.
_TITLES = {"m": "Lengths", "rad": "Angles", "1": "Gear ratios and sines", "rad/Nm": "Compliances"}

#: Look of every parameter's marker and interval.
_INTERVAL: dict[str, Any] = {"capsize": 2.0, "ls": "none", "lw": 1.3, "ms": 4.6, "mew": 1.1}

#: Look of a parameter that the measurements determine by itself.
_IDENTIFIABLE: dict[str, Any] = {
    "marker": "o",
    "color": "#b85c06",
    "label": "change, 95 % interval",
}

#: Look of a parameter that they determine in combination with others only.
_JOINTLY: dict[str, Any] = {
    "marker": "o",
    "color": SOFT,
    "mfc": "white",
    "label": "known in combination with others only",
}

#: Look of a parameter at one of its bounds.
_AT_BOUND: dict[str, Any] = {"marker": "s", "color": INK, "label": "stopped by a bound"}

#: Look of the solver's rejected steps.
_REJECTED: dict[str, Any] = {
    "ls": "none",
    "marker": "x",
    "ms": 4.5,
    "mew": 1.2,
    "color": OUTLIER,
    "label": "rejected step: it would have raised the cost",
}

#: Colour, hatch and label of the bars of models tried, by what they were chosen for.
_CHOSEN = {
    "geometry": (CALIBRATED, "", "chosen for the URDF"),
    "non_geometric": (CALIBRATED, "////", "chosen for the result file"),
    "": ("#c9d2db", "", "not chosen"),
}

#: Values below this part of the largest are drawn at it: a logarithmic axis has no zero.
_LEAST_OF_ITERATIONS = 1e-18

#: The same for singular values.
_LEAST_SINGULAR_VALUE = 1e-7

#: With more parameters than this in a panel their names are smaller.
_MANY_NAMES = 40


def convergence(c: Calibration) -> Figure:
    """Draw cost, length of the step and damping over the solver's iterations."""
    history = c.method.solution.history
    cost = np.array([*(iteration.cost for iteration in history), c.method.solution.cost])
    step = np.array([iteration.step for iteration in history])
    damping = np.array([iteration.mu for iteration in history])
    accepted = np.array([iteration.accepted for iteration in history], dtype=np.bool_)
    # The paper's steps are in units of their own.
    step_label = "step\n[mm, mrad]" if has_weights_and_priors(c.method.solver) else "step"
    series = [("cost E", cost, np.append(accepted, [True])), (step_label, step, accepted)]
    if np.any(damping > 0.0):
        series.append(("damping μ", damping, accepted))
    figure = new_figure(len(series) + 0.7)
    panels = figure.subplots(len(series), 1, sharex=True)
    for ax, (label, values, taken) in zip(panels, series, strict=True):
        least = max(float(values.max()) * _LEAST_OF_ITERATIONS, 1e-30)
        shown = np.maximum(values, least)
        iterations = np.arange(len(values))
        ax.plot(iterations, shown, color=INK, lw=1.1)
        ax.plot(iterations[taken], shown[taken], "o", ms=3.6, color=INK, label="accepted step")
        if not np.all(taken):
            ax.plot(iterations[~taken], shown[~taken], **_REJECTED)
        log_axis(ax, "y")
        ax.xaxis.set_major_locator(few_ticks(10, integers=True))
        ax.set_ylabel(label)
    panels[-1].set_xlabel("iteration")
    legend_above(figure)
    return figure


def changed_parameters(c: Calibration) -> list[ParameterEstimate]:
    """Return the parameters whose changes are drawn: of the robot and given targets, then of the non-geometric model.

    Targets that were not given are left out, because their change from the registered value is not an error of the
    robot, and so are parameters of families without errors, which have no interval; see `errorless`.
    """
    errorless = texts.errorless(c)
    given = [p for p in texts.shown_parameters(c) if p.nominal is not None]
    shown = [p for p in given if p.name not in errorless]
    if c.non_geometric is not None:
        shown += [p for p in c.non_geometric.parameters if p.name not in c.model.names]
    return shown


def changes(c: Calibration) -> Figure:
    """Draw the change of each parameter with its 95 % interval; a panel for each unit, two side by side."""
    groups: dict[str, list[ParameterEstimate]] = {}
    for p in changed_parameters(c):
        groups.setdefault(p.unit, []).append(p)
    grouped = list(groups.values())
    pairs = [grouped[k : k + 2] for k in range(0, len(grouped), 2)]
    heights = []
    for pair in pairs:
        most = max(len(parameters) for parameters in pair)
        heights.append(0.16 * max(3, most) + 0.75)
    figure = new_figure(sum(heights) + 0.4)
    grid = figure.add_gridspec(len(pairs), min(len(grouped), 2), height_ratios=heights)
    for k, parameters in enumerate(grouped):
        ax = figure.add_subplot(grid[k // 2, k % 2])
        unit = parameters[0].unit
        scale, unit_text = unit_of(unit).shown
        if unit == "rad":
            scale, unit_text = float(np.degrees(1.0)), "deg"
        for y, p in enumerate(parameters):
            half = 0.5 * scale * (p.high - p.low)
            look = _IDENTIFIABLE if p.identifiable else _JOINTLY
            if p.at_bound:
                half, look = 0.0, _AT_BOUND
            ax.errorbar(scale * p.delta, y, xerr=half, **_INTERVAL, **look)
        names = short_names([p.name for p in parameters])
        ax.axvline(0.0, color=NOMINAL, lw=1.2, ls="--")
        font_size = 7.5 if len(names) <= _MANY_NAMES else 6.5
        ax.set_yticks(range(len(names)), names, size=font_size)
        ax.set_ylim(len(names) - 0.4, -0.6)
        ax.xaxis.set_major_locator(few_ticks(5))
        ax.set_xlabel(f"change from nominal [{unit_text.replace('urad', 'µrad')}]")
        ax.set_title(_TITLES.get(unit, "Others"))
    legend_above(figure, 3)
    return figure


def correlation_indices(c: Calibration) -> list[int]:
    """Return the indices of the parameters whose correlations are drawn: identifiable ones, not at a bound.

    The places of single corners on a board are left out: there are many, and the figure of the board has them.
    """
    of_corners = [parameter.of_one_point for parameter in c.model.parameters]
    return [
        k
        for k, (p, of_corner) in enumerate(zip(c.parameters, of_corners, strict=True))
        if p.identifiable and not p.at_bound and not of_corner
    ]


def correlations(c: Calibration) -> Figure:
    """Draw the correlation of each pair of identifiable parameters as a colour."""
    chosen = correlation_indices(c)
    covariance = c.covariance[np.ix_(chosen, chosen)]
    variance = np.diag(covariance)
    correlation = np.asarray(covariance / np.sqrt(np.outer(variance, variance)))

    names = short_names([c.parameters[k].name for k in chosen], 18)
    count = len(chosen)
    font_size = 8.0
    if count > 30:
        font_size = 6.0 if count <= 50 else 4.6
    # Length of the longest name [in], and the space beside it.
    room = 0.009 * font_size * max(map(len, names)) + 0.25
    edge = float(np.clip(0.27 * count, 1.8, WIDTH - room - 0.8))
    figure = new_figure(edge + room, edge + room + 0.8)
    ax = figure.subplots()
    # Each pair once: the lower triangle without the diagonal.
    upper = np.triu(np.ones_like(correlation, dtype=np.bool_))
    shown = np.ma.masked_array(correlation, upper)[1:, :-1]
    image = ax.imshow(shown, cmap="PuOr_r", vmin=-1.0, vmax=1.0)
    figure.colorbar(image, ax=ax, shrink=0.6, label="correlation")
    ax.set_xticks(range(count - 1), names[:-1], rotation=90, size=font_size)
    ax.set_yticks(range(count - 1), names[1:], size=font_size)
    ax.grid(visible=False)
    return figure


def singular_values(c: Calibration) -> Figure:
    """Draw the singular values of the scaled Jacobian [mm], and the numerical rank."""
    o = c.trust.observability
    values = 1e3 * o.singular_values
    largest = float(values.max(initial=0.0))
    shown = np.maximum(values, max(largest * _LEAST_SINGULAR_VALUE, 1e-15))
    at = np.arange(1, len(values) + 1)
    determined = at <= o.rank
    figure = new_figure(2.9)
    ax = figure.subplots()
    foot = 0.4 * float(shown.min())
    ax.vlines(at[determined], foot, shown[determined], color=NOMINAL, lw=1.0, alpha=0.6)
    label = f"{o.rank} identifiable combinations"
    ax.plot(at[determined], shown[determined], "o", color=INK, ms=5, label=label)
    if o.rank < o.columns:
        label = f"{o.columns - o.rank} unobservable combinations"
        ax.plot(at[~determined], shown[~determined], "x", color=OUTLIER, ms=5, label=label)
    if o.rank and np.isfinite(o.condition):
        label = f"condition number {o.condition:,.0f}"
        ax.axhline(float(values[0] / o.condition), color=SOFT, ls="--", lw=1.0, label=label)
    log_axis(ax, "y")
    ax.set_ylim(foot, 3.0 * float(shown.max()))
    ax.xaxis.set_major_locator(few_ticks(12, integers=True))
    ax.set_xlabel("number")
    ax.set_ylabel("singular value [mm]")
    legend_above(figure)
    return figure


def candidates(c: Calibration) -> Figure:
    """Draw the models that were tried: their errors on held-out rows, and their evidence relative to the best."""
    errors = [
        candidate.cross_validation.errors_without_outliers for candidate in c.method.candidates
    ]
    unit = RESIDUAL_UNITS[errors[0].leading.unit]
    rms = unit.to_shown * np.array([one[unit.symbol].rms for one in errors])
    evidence = np.array([candidate.evidence for candidate in c.method.candidates])
    figure = new_figure(0.24 * len(c.method.candidates) + 1.35)
    left, right = figure.subplots(1, 2, sharey=True)
    names = [f"{candidate.name} ({candidate.parameters})" for candidate in c.method.candidates]
    left.set_yticks(np.arange(len(names)), names)
    left.invert_yaxis()
    chosen_for = [candidate.chosen for candidate in c.method.candidates]
    _bars(left, rms, chosen_for, "{:.3f}")
    _bars(right, evidence - evidence.max(), chosen_for, "{:.1f}")
    left.set(title="Error on held-out rows", xlabel=f"rms [{unit.shown}]")
    right.set(title="Evidence", xlabel="penalised log-likelihood, relative to the best")
    legend_above(figure)
    return figure


def _bars(ax: Axes, values: Array, chosen_for: Sequence[str], number_format: str) -> None:
    """Draw a bar for each of k models, of values (k,), with the value as a format such as ``"{:.3f}"`` writes it.

    Colour and hatch are by what the model was chosen for, a key of `_CHOSEN`.
    """
    for key, (colour, hatch, label) in _CHOSEN.items():
        at = [k for k, use in enumerate(chosen_for) if use == key]
        if at:
            look: dict[str, Any] = {"color": colour, "hatch": hatch, "ec": "white"}
            bars = ax.barh(at, values[at], height=0.72, label=label, **look)
            numbers = [number_format.format(value) for value in values[at]]
            ax.bar_label(bars, numbers, padding=2, size=7.5)
    ax.margins(x=0.2)
    ax.grid(visible=False, axis="y")
