"""The model and its fit: parameters and their correlations, convergence, what the poses determine, models tried."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

import calib.report.figure_base as base
import calib.text.summary as texts
from calib.model.families import unit_of
from calib.report.figure_base import CALIBRATED, INK, NOMINAL, OUTLIER, SOFT
from calib.result.calibration import CalibrationValues
from calib.result.prediction import ParameterEstimate

#: What the parameters of each unit are called.
_TITLES = {"m": "Lengths", "rad": "Angles", "1": "Gear ratios and sines", "rad/Nm": "Compliances"}

#: How a parameter is drawn, and what that means.
_INTERVAL: dict[str, Any] = {"capsize": 2.0, "ls": "none", "lw": 1.3, "ms": 4.6, "mew": 1.1}
_KNOWN: dict[str, Any] = {"marker": "o", "color": "#b85c06", "label": "change, 95 % interval"}
_TOGETHER: dict[str, Any] = {"marker": "o", "color": SOFT, "mfc": "white"}
_TOGETHER |= {"label": "known in combination with others only"}
_BOUND: dict[str, Any] = {"marker": "s", "color": INK, "label": "stopped by a bound"}

#: What models that were tried were chosen for, and how they are drawn.
_CHOSEN = {
    "geometry": (CALIBRATED, "", "chosen for the URDF"),
    "non_geometric": (CALIBRATED, "////", "chosen for the result file"),
    "": ("#c9d2db", "", "not chosen"),
}


def convergence(c: CalibrationValues) -> Figure:
    """Cost, length of the step and damping over the solver's iterations."""
    history = c.solution.history
    cost = np.array([*(one.cost for one in history), c.solution.cost])
    step = np.array([one.step for one in history])
    mu = np.array([one.mu for one in history])
    accepted = np.array([one.accepted for one in history], dtype=np.bool_)
    series = [("cost E", cost, np.append(accepted, [True]))]
    series += [("step\n[mm, mrad]" if c.solver != "paper" else "step", step, accepted)]
    series += [("damping μ", mu, accepted)] * bool(np.any(mu > 0.0))
    figure = base.new_figure(len(series) + 0.7)
    panels = figure.subplots(len(series), 1, sharex=True)
    cross: dict[str, Any] = {"ls": "none", "marker": "x", "ms": 4.5, "mew": 1.2, "color": OUTLIER}
    cross["label"] = "step not taken: it would have raised the cost"
    for ax, (name, values, taken) in zip(panels, series, strict=True):
        shown = np.maximum(values, max(float(values.max()) * 1e-18, 1e-30))
        at = np.arange(len(values))
        ax.plot(at, shown, color=INK, lw=1.1)
        ax.plot(at[taken], shown[taken], "o", ms=3.6, color=INK, label="step taken")
        if not np.all(taken):
            ax.plot(at[~taken], shown[~taken], **cross)
        base.log_axis(ax, "y")
        ax.xaxis.set_major_locator(base.few_ticks(10, whole=True))
        ax.set_ylabel(name)
    panels[-1].set_xlabel("iteration")
    base.legend_above(figure)
    return figure


def shown_parameters(c: CalibrationValues) -> list[ParameterEstimate]:
    """The robot's parameters and targets that were given, the non-geometric model's own behind them.

    What was not given counts from where registration put it, which says nothing of the robot. Parameters of a kind of
    which no errors were found have no interval; see `calib.text.summary.errorless`.
    """
    none = texts.errorless(c)
    own = [p for p in texts.shown_parameters(c) if p.nominal is not None and p.name not in none]
    more = () if c.non_geometric is None else c.non_geometric.parameters
    return [*own, *(p for p in more if p.name not in c.model.names)]


def changes(c: CalibrationValues) -> Figure:
    """The change of each parameter with its 95 % interval; a panel for each unit, two side by side."""
    shown = shown_parameters(c)
    grouped = [
        [p for p in shown if p.unit == unit] for unit in dict.fromkeys(p.unit for p in shown)
    ]
    pairs = [grouped[k : k + 2] for k in range(0, len(grouped), 2)]
    heights = [0.16 * max(3, *map(len, pair)) + 0.75 for pair in pairs]
    figure = base.new_figure(sum(heights) + 0.4)
    grid = figure.add_gridspec(len(pairs), min(len(grouped), 2), height_ratios=heights)
    for k, parameters in enumerate(grouped):
        unit = parameters[0].unit
        scale, word = (float(np.degrees(1.0)), "deg") if unit == "rad" else unit_of(unit).shown
        ax = figure.add_subplot(grid[k // 2, k % 2])
        for y, p in enumerate(parameters):
            half = 0.0 if p.at_bound else 0.5 * scale * (p.high - p.low)
            look = _BOUND if p.at_bound else _KNOWN if p.identifiable else _TOGETHER
            ax.errorbar(scale * p.delta, y, xerr=half, **_INTERVAL, **look)
        names = base.short_names([p.name for p in parameters])
        ax.axvline(0.0, color=NOMINAL, lw=1.2, ls="--")
        ax.set_yticks(range(len(names)), names, size=7.5 if len(names) <= 40 else 6.5)
        ax.set_ylim(len(names) - 0.4, -0.6)
        ax.xaxis.set_major_locator(base.few_ticks(5))
        ax.set_xlabel(f"change from nominal [{word.replace('urad', 'µrad')}]")
        ax.set_title(_TITLES.get(unit, "Others"))
    base.legend_above(figure, 3)
    return figure


def correlation_indices(c: CalibrationValues) -> list[int]:
    """The parameters whose correlations are drawn: those that the measurements determine, in the model's order."""
    return [k for k, p in enumerate(c.parameters) if p.identifiable and not p.at_bound]


def correlations(c: CalibrationValues) -> Figure:
    """The correlation of each pair of parameters, as a colour."""
    chosen = correlation_indices(c)
    C = c.covariance[np.ix_(chosen, chosen)]
    R = C / np.sqrt(np.outer(np.diag(C), np.diag(C)))
    names = base.short_names([c.parameters[k].name for k in chosen], 18)
    p = len(chosen)
    text = 8.0 if p <= 30 else 6.0 if p <= 50 else 4.6
    room = 0.009 * text * max(map(len, names)) + 0.25  # for the names [in]
    size = float(np.clip(0.27 * p, 1.8, base.WIDTH - room - 0.8))
    figure = base.new_figure(size + room, size + room + 0.8)
    ax = figure.subplots()
    shown = np.ma.masked_array(R, np.triu(np.ones_like(R, dtype=np.bool_)))[1:, :-1]
    image = ax.imshow(shown, cmap="PuOr_r", vmin=-1.0, vmax=1.0)
    figure.colorbar(image, ax=ax, shrink=0.6, label="correlation")
    ax.set_xticks(range(p - 1), names[:-1], rotation=90, size=text)
    ax.set_yticks(range(p - 1), names[1:], size=text)
    ax.grid(visible=False)
    return figure


def singular_values(c: CalibrationValues) -> Figure:
    """The singular values of the scaled Jacobian, and where the rank ends."""
    o = c.observability
    values = 1e3 * o.singular_values
    shown = np.maximum(values, max(float(values.max(initial=0.0)) * 1e-7, 1e-15))
    at = np.arange(1, len(values) + 1)
    seen = at <= o.rank
    figure = base.new_figure(2.9)
    ax = figure.subplots()
    lowest = 0.4 * float(shown.min())
    ax.vlines(at[seen], lowest, shown[seen], color=NOMINAL, lw=1.0, alpha=0.6)
    label = f"{o.rank} combinations that the poses determine"
    ax.plot(at[seen], shown[seen], "o", color=INK, ms=5, label=label)
    if o.rank < o.columns:
        label = f"{o.columns - o.rank} that move nothing measured"
        ax.plot(at[~seen], shown[~seen], "x", color=OUTLIER, ms=5, label=label)
    if o.rank and np.isfinite(o.condition):
        label = f"condition number {o.condition:,.0f}"
        ax.axhline(float(values[0] / o.condition), color=SOFT, ls="--", lw=1.0, label=label)
    base.log_axis(ax, "y")
    ax.set_ylim(lowest, 3.0 * float(shown.max()))
    ax.xaxis.set_major_locator(base.few_ticks(12, whole=True))
    ax.set_xlabel("number")
    ax.set_ylabel("singular value [mm]")
    base.legend_above(figure)
    return figure


def candidates(c: CalibrationValues) -> Figure:
    """The models that were tried: errors on held-out rows, and what the likelihood gains."""
    errors = [one.cross_validation.errors_without_outliers for one in c.candidates]
    rms, unit = 1e3 * np.array([one.rms for one in errors]), "mm"
    if not all(one.n for one in errors):  # where no length was measured
        rms, unit = np.degrees([one.rms_angle for one in errors]), "deg"
    gain = np.array([one.evidence for one in c.candidates])
    figure = base.new_figure(0.24 * len(errors) + 1.35)
    left, right = figure.subplots(1, 2, sharey=True)
    names = [f"{one.name} ({one.parameters})" for one in c.candidates]
    left.set_yticks(np.arange(len(names)), names)
    left.invert_yaxis()
    for ax, values, form in ((left, rms, "{:.3f}"), (right, gain - gain.max(), "{:.1f}")):
        for key, (colour, hatch, label) in _CHOSEN.items():
            at = [k for k, one in enumerate(c.candidates) if one.chosen == key]
            if at:
                look: dict[str, Any] = {"color": colour, "hatch": hatch, "ec": "white"}
                bars = ax.barh(at, values[at], height=0.72, label=label, **look)
                ax.bar_label(bars, [form.format(v) for v in values[at]], padding=2, size=7.5)
        ax.margins(x=0.2)
        ax.grid(visible=False, axis="y")
    left.set(title="Error on held-out rows", xlabel=f"rms [{unit}]")
    right.set(title="Evidence", xlabel="log likelihood, less that of the best")
    base.legend_above(figure)
    return figure
