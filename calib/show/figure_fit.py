"""The fit itself: how the solver converged, what the poses determine, which models were tried."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from calib.identify.result import Calibration
from calib.identify.selection import Candidate
from calib.show.figure_base import legend_above, log_axis, new_figure
from calib.show.palette import CALIBRATED, INK, NOMINAL, OUTLIER, SOFT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

#: A singular value below this share of the largest is drawn there.
_FLOOR = 1e-7

#: More iterations than this get no dots.
_MOST_DOTS = 60


def convergence_figure(c: Calibration) -> Figure:
    """Cost, length of the step and damping over the solver's iterations."""
    from matplotlib.lines import Line2D

    history = c.solution.history
    cost = np.array([*(one.cost for one in history), c.solution.cost])
    step = np.array([one.step for one in history])
    mu = np.array([one.mu for one in history])
    accepted = np.array([one.accepted for one in history], dtype=np.bool_)
    series = [("cost E", cost, np.append(accepted, [True]))]
    series += [("step\n[mm, mrad]" if c.solver != "paper" else "step", step, accepted)]
    if np.any(mu > 0.0):
        series.append(("damping μ", mu, accepted))
    starts = stage_starts(c)
    figure = new_figure(len(series) + 0.7)
    panels = figure.subplots(len(series), 1, sharex=True)
    for ax, (name, values, taken) in zip(panels, series, strict=True):
        _over_iterations(ax, values, taken, starts)
        ax.set_ylabel(name)
    panels[-1].set_xlabel("iteration")
    panels[-1].set_xlim(-0.3 - 0.01 * len(history), len(history) + 0.3 + 0.01 * len(history))
    many = len(history) > _MOST_DOTS
    handles = [
        Line2D([], [], color=INK, marker="" if many else "o", ms=4, lw=1.1, label="step taken")
    ]
    if not np.all(accepted):
        none = Line2D([], [], ls="none", marker="x", ms=5, mew=1.3, color=OUTLIER)
        none.set_label("step not taken: it would have raised the cost")
        handles.append(none)
    if len(starts):
        anew = Line2D([], [], color=SOFT, lw=0.9, ls=":", label="weights and noise set anew")
        handles.append(anew)
    legend_above(figure, handles)
    return figure


def stage_starts(c: Calibration) -> list[int]:
    """The iterations, but for the first, at which the solver was started anew with other weights and noise.

    The damping then is what it was first; solvers without one have a cost that rises.
    """
    history = c.solution.history
    if c.solver == "paper":
        return []
    if any(one.mu > 0.0 for one in history):
        return [k for k in range(1, len(history)) if history[k].mu == history[0].mu]
    return [k for k in range(1, len(history)) if history[k].cost > 1.000001 * history[k - 1].cost]


def _over_iterations(
    ax: Axes, values: Array, taken: NDArray[np.bool_], starts: Sequence[int]
) -> None:
    """A curve on a logarithmic scale, broken where the solver started anew."""
    from matplotlib.ticker import MaxNLocator

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
    ax.xaxis.set_major_locator(MaxNLocator(nbins=10, integer=True, min_n_ticks=1))


def singular_values_figure(c: Calibration) -> Figure:
    """The singular values of the scaled Jacobian, and where the rank ends."""
    from matplotlib.ticker import MaxNLocator

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
    parts = [(seen, "o", INK, f"{o.rank} combinations that the poses determine")]
    parts.append((~seen, "x", OUTLIER, f"{o.columns - o.rank} that move nothing measured"))
    for mask, marker, colour, label in parts:
        if np.any(mask):
            ax.plot(
                at[mask],
                shown[mask],
                ls="none",
                marker=marker,
                ms=5,
                mew=1.4 if marker == "x" else 0.4,
                mec=colour if marker == "x" else "white",
                mfc=colour,
                label=label,
            )
    if np.any(seen & ~tiny):
        limit = float(values[0] / o.condition)
        text = f"condition number {o.condition:,.0f}"
        ax.axhline(limit, color=SOFT, ls="--", lw=1.0, label=text)
    log_axis(ax, "y")
    ax.set_ylim(lowest, 3.0 * float(shown.max()))
    ax.set_xlim(0.2, len(values) + 0.8)
    ax.xaxis.set_major_locator(MaxNLocator(nbins=12, integer=True, min_n_ticks=1))
    ax.set_xlabel("number")
    ax.set_ylabel("singular value [mm]")
    legend_above(figure, ax.get_legend_handles_labels()[0])
    return figure


def candidates_figure(c: Calibration) -> Figure:
    """The models that were tried: errors on left-out rows, and what the likelihood gains."""
    from matplotlib.patches import Patch

    names = [one.name for one in c.candidates]
    scale, unit, rms = _left_out_rms(c.candidates)
    gain = np.array([one.log_likelihood for one in c.candidates])
    gain = gain - gain.max()
    figure = new_figure(0.24 * len(names) + 1.35)
    left, right = figure.subplots(1, 2, sharey=True)
    at = np.arange(len(names))
    look = {
        "geometry": (CALIBRATED, "", "chosen for the URDF"),
        "larger": (CALIBRATED, "////", "chosen for the result file"),
        "": ("#c9d2db", "", "not chosen"),
    }
    chosen = [one.chosen for one in c.candidates]
    for ax, values, text in (
        (left, scale * rms, "{:.3f}"),
        (right, gain, "{:.1f}"),
    ):
        for key, (colour, hatch, _) in look.items():
            mine = np.array([word == key for word in chosen])
            ax.barh(at[mine], values[mine], color=colour, hatch=hatch, ec="white", height=0.72)
        widest = float(np.max(np.abs(values)))
        for y, value in zip(at, values, strict=True):
            side = "left" if ax is left else "right"
            away = 0.015 * widest * (1 if ax is left else -1)
            ax.text(
                value + away,
                y,
                text.format(value).replace("-", "−"),
                va="center",
                ha=side,
                size=7.5,
            )
        room = 1.25 * widest if widest > 0.0 else 1.0
        ax.set_xlim(*((0.0, room) if ax is left else (-room, 0.02 * room)))
        ax.grid(visible=False, axis="y")
    left.set_yticks(
        at, [f"{n} ({one.parameters})" for n, one in zip(names, c.candidates, strict=True)]
    )
    left.invert_yaxis()
    left.set_title("Error on left-out rows")
    left.set_xlabel(f"rms [{unit}]")
    right.set_title("Evidence")
    right.set_xlabel("log likelihood, less that of the best")
    legend_above(
        figure,
        [
            Patch(facecolor=colour, hatch=hatch, ec="white", label=label)
            for key, (colour, hatch, label) in look.items()
            if key in chosen
        ],
    )
    return figure


def _left_out_rms(candidates: tuple[Candidate, ...]) -> tuple[float, str, Array]:
    """Scale, unit and errors on left-out rows; of lengths, or of angles where no length was measured."""
    errors = [one.cross_validation.errors_without_outliers for one in candidates]
    if all(one.n for one in errors):
        return 1e3, "mm", np.array([one.rms for one in errors])
    return float(np.degrees(1.0)), "deg", np.array([one.rms_angle for one in errors])
