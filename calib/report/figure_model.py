"""The model and its fit: parameters and their correlations, convergence, what the poses determine, models tried."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from calib.model.families import unit_of
from calib.model.parameters import FRAME, TARGET
from calib.report.figure_base import (
    WIDTH,
    area,
    few_ticks,
    legend_above,
    line,
    log_axis,
    new_figure,
    short_names,
)
from calib.report.label_rows import CALIBRATED, INK, NOMINAL, OUTLIER, SOFT
from calib.result.calibration import Calibration
from calib.result.prediction import ParameterEstimate
from calib.text.summary import errorless

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: A singular value below this share of the largest is drawn there.
_FLOOR = 1e-7

#: More iterations than this get no dots.
_MOST_DOTS = 60

#: The sizes of squares are explained from so many parameters on: fewer leave no room for it.
_FEWEST_FOR_SCALE = 8

#: What the parameters of each unit are called.
_TITLES = {"m": "Lengths", "rad": "Angles", "1": "Gear ratios and sines", "rad/Nm": "Compliances"}


def shown_parameters(c: Calibration) -> tuple[ParameterEstimate, ...]:
    """The robot's parameters and targets that were given, the larger model's own behind them.

    Frames, targets' orientations and targets that were not given count from where registration put them, which says
    nothing of the robot. Parameters of a kind of which no errors were found have no interval; see
    `calib.text.summary.errorless`.
    """
    none = errorless(c)
    own = [
        p
        for p, m in zip(c.parameters, c.model.parameters, strict=True)
        if m.family != FRAME
        and not (m.family == TARGET and (m.unit == "rad" or p.nominal is None))
        and p.name not in none
    ]
    more = () if c.larger is None else c.larger.parameters
    return (*own, *(p for p in more if p.name not in c.model.names))


def _look(marker: str, colour: str, face: str) -> dict[str, Any]:
    """A dot on its interval."""
    dot = {"marker": marker, "markersize": 4.6, "markerfacecolor": face, "markeredgewidth": 1.1}
    return {
        "linestyle": "none",
        "markeredgecolor": colour,
        "color": colour,
        "linewidth": 1.4,
        **dot,
    }


#: How a parameter is drawn, and what that means.
_KNOWN = _look("o", "#b85c06", "#b85c06"), "change, 95 % interval"
_TOGETHER = _look("o", SOFT, "white"), "known in combination with others only"
_BOUND = _look("s", INK, INK), "stopped by a bound"


def _kind(p: ParameterEstimate) -> tuple[dict[str, Any], str]:
    """How a parameter is drawn."""
    return _BOUND if p.at_bound else _KNOWN if p.identifiable else _TOGETHER


def changes(c: Calibration) -> Figure:
    """The change of each parameter with its 95 % interval; a panel for each unit, two side by side."""
    shown = shown_parameters(c)
    units = list(dict.fromkeys(p.unit for p in shown))
    grouped = [[p for p in shown if p.unit == unit] for unit in units]
    pairs = [grouped[k : k + 2] for k in range(0, len(grouped), 2)]
    heights = [0.16 * max(3, *map(len, pair)) + 0.75 for pair in pairs]
    figure = new_figure(sum(heights) + 0.4)
    grid = figure.add_gridspec(len(pairs), min(len(units), 2), height_ratios=heights)
    for row, pair in enumerate(pairs):
        for column, parameters in enumerate(pair):
            _changes(figure.add_subplot(grid[row, column]), parameters)
    kinds = [_kind(p) for p in shown]
    handles = [
        line(label, **{**look, "linestyle": "-"})
        for look, label in (_KNOWN, _TOGETHER, _BOUND)
        if (look, label) in kinds
    ]
    legend_above(figure, handles, 3)
    return figure


def _changes(ax: Axes, parameters: Sequence[ParameterEstimate]) -> None:
    """One unit's parameters from above downwards."""
    unit = parameters[0].unit
    scale, word = (float(np.degrees(1.0)), "deg") if unit == "rad" else unit_of(unit).shown
    names = short_names([p.name for p in parameters])
    for y, p in enumerate(parameters):
        half = 0.0 if p.at_bound else 0.5 * scale * (p.high - p.low)
        look, _ = _kind(p)
        ax.errorbar(scale * p.delta, y, xerr=half, capsize=2.0, elinewidth=1.2, zorder=3, **look)
    ax.axvline(0.0, color=NOMINAL, lw=1.2, ls="--", zorder=2)
    ax.set_yticks(range(len(names)), names, size=7.5 if len(names) <= 40 else 6.5)
    ax.set_ylim(len(names) - 0.4, -0.6)
    ax.xaxis.set_major_locator(few_ticks(5))
    ax.grid(visible=False, axis="y")
    for y in range(0, len(names), 2):
        ax.axhspan(y - 0.5, y + 0.5, color="#f3f5f7", lw=0, zorder=0)
    ax.set_xlabel(f"change from nominal [{word.replace('urad', 'µrad')}]")
    ax.set_title(_TITLES.get(unit, "Others"))


def correlation_indices(c: Calibration) -> list[int]:
    """The parameters whose correlations are drawn: those that the measurements determine, in the model's order."""
    return [k for k, p in enumerate(c.parameters) if p.identifiable and not p.at_bound]


def correlations(c: Calibration) -> Figure:
    """The correlation of each pair of parameters, as squares whose area is its size."""
    from matplotlib.collections import PolyCollection

    chosen = correlation_indices(c)
    C = c.covariance[np.ix_(chosen, chosen)]
    std = np.sqrt(np.diag(C))
    R = C / np.outer(std, std)
    names = short_names([c.parameters[k].name for k in chosen], 18)
    p = len(chosen)
    text = 8.0 if p <= 30 else 6.0 if p <= 50 else 4.6
    room = 0.009 * text * max(map(len, names)) + 0.25  # for the names [in]
    size = float(np.clip(0.27 * p, 1.8, WIDTH - room))
    figure = new_figure(size + room + 0.35, size + room)
    ax = figure.subplots()
    i, j = np.tril_indices(p, -1)
    value = R[i, j]
    half = 0.47 * np.sqrt(np.abs(value))
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    squares = np.stack([j, i], axis=1)[:, None, :] + half[:, None, None] * corners
    looks = (("positive", 1.0, CALIBRATED, CALIBRATED), ("negative", -1.0, "white", NOMINAL))
    for _, sign, face, edge in looks:
        part = list(squares[sign * value >= 0.02])
        ax.add_collection(PolyCollection(part, facecolors=face, edgecolors=edge, linewidths=1.0))
    ax.set_xlim(-0.6, p - 1.4)
    ax.set_ylim(p - 0.4, 0.4)
    ax.set_aspect("equal")
    if p >= _FEWEST_FOR_SCALE:  # what the sizes of squares mean, where no squares are
        cell = 72.0 * size / p
        mark = {"ls": "none", "marker": "s", "mfc": CALIBRATED, "mec": CALIBRATED}
        ax.legend(
            handles=[line(f"{v:g}", ms=0.94 * cell * np.sqrt(v), **mark) for v in (1.0, 0.5, 0.1)],
            loc="upper right",
            title="size of the correlation",
            frameon=True,
            facecolor="white",
            edgecolor="none",
            framealpha=1.0,
            labelspacing=max(cell / 8.0 - 0.4, 0.4),
        )
    ax.set_xticks(range(p - 1), names[:-1], rotation=90, size=text)
    ax.set_yticks(range(1, p), names[1:], size=text)
    ax.grid(linewidth=0.4)
    legend_above(figure, [area(word, facecolor=face, ec=edge) for word, _, face, edge in looks])
    return figure


def convergence(c: Calibration) -> Figure:
    """Cost, length of the step and damping over the solver's iterations."""
    history = c.solution.history
    cost = np.array([*(one.cost for one in history), c.solution.cost])
    step = np.array([one.step for one in history])
    mu = np.array([one.mu for one in history])
    accepted = np.array([one.accepted for one in history], dtype=np.bool_)
    series = [("cost E", cost, np.append(accepted, [True]))]
    series += [("step\n[mm, mrad]" if c.solver != "paper" else "step", step, accepted)]
    series += [("damping μ", mu, accepted)] * bool(np.any(mu > 0.0))
    starts = _stage_starts(c)
    figure = new_figure(len(series) + 0.7)
    panels = figure.subplots(len(series), 1, sharex=True)
    for ax, (name, values, taken) in zip(panels, series, strict=True):
        _over_iterations(ax, values, taken, starts)
        ax.set_ylabel(name)
    panels[-1].set_xlabel("iteration")
    room = 0.3 + 0.01 * len(history)
    panels[-1].set_xlim(-room, len(history) + room)
    dot = "" if len(history) > _MOST_DOTS else "o"
    handles = [line("step taken", color=INK, marker=dot, ms=4, lw=1.1)]
    if not np.all(accepted):
        label = "step not taken: it would have raised the cost"
        handles.append(line(label, ls="none", marker="x", ms=5, mew=1.3, color=OUTLIER))
    if starts:
        handles.append(line("weights and noise set anew", color=SOFT, lw=0.9, ls=":"))
    legend_above(figure, handles)
    return figure


def _stage_starts(c: Calibration) -> list[int]:
    """The iterations, but for the first, at which the solver was started anew with other weights and noise.

    The damping then is what it was first; solvers without one have a cost that rises.
    """
    history = c.solution.history
    if c.solver == "paper":
        return []
    if any(one.mu > 0.0 for one in history):
        return [k for k in range(1, len(history)) if history[k].mu == history[0].mu]
    return [k for k in range(1, len(history)) if history[k].cost > 1.000001 * history[k - 1].cost]


def _over_iterations(ax: Axes, values: Array, taken: Mask, starts: Sequence[int]) -> None:
    """A curve on a logarithmic scale, broken where the solver started anew."""
    shown = np.maximum(values, max(float(values.max(initial=0.0)) * 1e-18, 1e-30))
    at = np.arange(len(values))
    for start in starts:
        ax.axvline(start - 0.5, color=SOFT, lw=0.9, ls=":", zorder=1)
    for part in np.split(at, starts):
        ax.plot(part, shown[part], color=INK, lw=1.1)
    if len(values) <= _MOST_DOTS:
        ax.plot(at[taken], shown[taken], ls="none", marker="o", ms=3.6, color=INK)
    ax.plot(at[~taken], shown[~taken], ls="none", marker="x", ms=4.5, mew=1.2, color=OUTLIER)
    log_axis(ax, "y")
    ax.xaxis.set_major_locator(few_ticks(10, whole=True))


def singular_values(c: Calibration) -> Figure:
    """The singular values of the scaled Jacobian, and where the rank ends."""
    o = c.observability
    values = 1e3 * o.singular_values
    floor = max(float(values.max(initial=0.0)) * _FLOOR, 1e-15)  # zeros stand there
    at = np.arange(1, len(values) + 1)
    figure = new_figure(2.9)
    ax = figure.subplots()
    seen, tiny = at <= o.rank, values < floor
    shown = np.maximum(values, floor)
    lowest = 0.4 * float(shown.min(initial=floor if np.any(tiny) else np.inf))
    ax.vlines(at[seen], lowest, shown[seen], color=NOMINAL, lw=1.0, alpha=0.6)
    dot: dict[str, Any] = {"marker": "o", "mew": 0.4, "mec": "white", "mfc": INK}
    cross = {"marker": "x", "mew": 1.4, "mec": OUTLIER}
    for mask, look, label in (
        (seen, dot, f"{o.rank} combinations that the poses determine"),
        (~seen, cross, f"{o.columns - o.rank} that move nothing measured"),
    ):
        if np.any(mask):
            ax.plot(at[mask], shown[mask], ls="none", ms=5, label=label, **look)
    if np.any(seen & ~tiny):
        label = f"condition number {o.condition:,.0f}"
        ax.axhline(float(values[0] / o.condition), color=SOFT, ls="--", lw=1.0, label=label)
    log_axis(ax, "y")
    ax.set_ylim(lowest, 3.0 * float(shown.max()))
    ax.set_xlim(0.2, len(values) + 0.8)
    ax.xaxis.set_major_locator(few_ticks(12, whole=True))
    ax.set_xlabel("number")
    ax.set_ylabel("singular value [mm]")
    legend_above(figure, ax.get_legend_handles_labels()[0])
    return figure


#: What models that were tried were chosen for, and how they are drawn.
_CHOSEN = {
    "geometry": (CALIBRATED, "", "chosen for the URDF"),
    "larger": (CALIBRATED, "////", "chosen for the result file"),
    "": ("#c9d2db", "", "not chosen"),
}


def candidates(c: Calibration) -> Figure:
    """The models that were tried: errors on left-out rows, and what the likelihood gains."""
    errors = [one.cross_validation.errors_without_outliers for one in c.candidates]
    rms, unit = 1e3 * np.array([one.rms for one in errors]), "mm"
    if not all(one.n for one in errors):  # where no length was measured
        rms, unit = np.degrees([one.rms_angle for one in errors]), "deg"
    gain = np.array([one.log_likelihood for one in c.candidates])
    figure = new_figure(0.24 * len(errors) + 1.35)
    left, right = figure.subplots(1, 2, sharey=True)
    names = [f"{one.name} ({one.parameters})" for one in c.candidates]
    left.set_yticks(np.arange(len(names)), names)
    left.set_title("Error on left-out rows")
    left.set_xlabel(f"rms [{unit}]")
    right.set_title("Evidence")
    right.set_xlabel("log likelihood, less that of the best")
    _bars(left, rms, c, ".3f")
    _bars(right, gain - gain.max(), c, ".1f")
    left.invert_yaxis()
    chosen = {one.chosen for one in c.candidates}
    handles = [
        area(label, facecolor=colour, hatch=hatch, ec="white")
        for key, (colour, hatch, label) in _CHOSEN.items()
        if key in chosen
    ]
    legend_above(figure, handles)
    return figure


def _bars(ax: Axes, values: Array, c: Calibration, form: str) -> None:
    """A bar and its number for each candidate, to the right or, of values below zero, to the left."""
    widest = float(np.max(np.abs(values)))
    room = 1.25 * widest if widest > 0.0 else 1.0
    down = bool(np.any(values < 0.0))
    for y, (value, one) in enumerate(zip(values, c.candidates, strict=True)):
        colour, hatch, _ = _CHOSEN[one.chosen]
        ax.barh(y, value, color=colour, hatch=hatch, ec="white", height=0.72)
        at = value + 0.015 * widest * (-1 if down else 1)
        text = f"{value:{form}}".replace("-", "−")
        ax.text(at, y, text, va="center", ha="right" if down else "left", size=7.5)
    ax.set_xlim(*((-room, 0.02 * room) if down else (0.0, room)))
    ax.grid(visible=False, axis="y")
